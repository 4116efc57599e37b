//! Three projections that proj-core does not have: cylindrical equal area (EASE-Grid 2.0), sinusoidal (MODIS)
//! and Mollweide.
//!
//! Formulas: J. P. Snyder, Map Projections, USGS Professional Paper 1395 (1987): sections 10 (10-14 to 10-18),
//! 30 (30-6 to 30-11), 31 (31-1 to 31-8), meridian distance 3-21 and 3-26, authalic latitude 3-12 and 3-18 (the
//! inverse by Newton's steps 3-16). Mollweide is spherical: on an ellipsoid the sphere of its semi-major axis
//! and the geographic latitude are taken, as PROJ does.

use super::definition::{Definition, Ellipsoid, Method};
use crate::base::Result;

#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Kind {
    /// `lat_ts` in degrees.
    CylindricalEqualArea {
        lat_ts: f64,
    },
    Sinusoidal,
    Mollweide,
}

/// Longitude of the origin in degrees, false origin in metres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Own {
    pub kind: Kind,
    pub lon0: f64,
    x0: f64,
    y0: f64,
}

/// As the start of a PROJ string.
impl std::fmt::Display for Own {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self.kind {
            Kind::CylindricalEqualArea { lat_ts } => write!(f, "+proj=cea +lat_ts={lat_ts}")?,
            Kind::Sinusoidal => write!(f, "+proj=sinu")?,
            Kind::Mollweide => write!(f, "+proj=moll")?,
        }
        write!(f, " +lon_0={} +x_0={} +y_0={}", self.lon0, self.x0, self.y0)
    }
}

/// The definition of a PROJ string with one of these projections; None for any other string.
///
/// # Errors
/// If datum, unit or a number cannot be read.
pub(super) fn read(text: &str) -> Result<Option<Definition>> {
    let words: Vec<(&str, &str)> = text
        .split_whitespace()
        .map(|w| w.trim_start_matches('+').split_once('=').unwrap_or((w.trim_start_matches('+'), "")))
        .collect();
    let value = |key: &str| words.iter().find(|(k, _)| *k == key).map(|(_, v)| *v);
    let number = |key: &str| -> Result<f64> {
        let Some(v) = value(key) else { return Ok(0.0) };
        v.parse()
            .ok()
            .filter(|n: &f64| n.is_finite())
            .ok_or_else(|| crate::base::Error::invalid(text, format!("+{key}={v} is not a number")))
    };
    let kind = match value("proj") {
        Some("cea") => Kind::CylindricalEqualArea { lat_ts: number("lat_ts")? },
        Some("sinu") => Kind::Sinusoidal,
        Some("moll") => Kind::Mollweide,
        _ => return Ok(None),
    };
    // Datum and unit are read from the same words under a projection that the library knows.
    let rest: Vec<String> = words
        .iter()
        .filter(|(k, _)| !["proj", "lat_ts", "lon_0", "x_0", "y_0", "lat_0"].contains(k))
        .map(|(k, v)| if v.is_empty() { format!("+{k}") } else { format!("+{k}={v}") })
        .collect();
    let mut definition = super::notation::core_of(&format!("+proj=merc {}", rest.join(" ")))?;
    let own = Own { kind, lon0: number("lon_0")?, x0: number("x_0")?, y0: number("y_0")? };
    definition.projection = Some(Method::Own(own));
    Ok(Some(definition))
}

/// A projection on its ellipsoid, in its unit.
pub(super) struct Plane {
    own: Own,
    e: Ellipsoid,
    e2: f64,
    unit_m: f64,
}

impl Plane {
    pub fn new(own: Own, e: Ellipsoid, unit_m: f64) -> Plane {
        Plane { own, e, e2: e.f * (2.0 - e.f), unit_m }
    }

    /// Degrees to units.
    pub fn project(&self, [lon, lat]: [f64; 2]) -> Option<[f64; 2]> {
        if !(-90.0..=90.0).contains(&lat) || !lon.is_finite() {
            return None;
        }
        let turned = lon - self.own.lon0;
        let lambda = if turned.abs() <= 180.0 {
            turned.to_radians()
        } else {
            (turned - 360.0 * (turned / 360.0).round()).to_radians()
        };
        let phi = lat.to_radians();
        let a = self.e.a;
        let [x, y] = match self.own.kind {
            Kind::CylindricalEqualArea { lat_ts } => {
                let k = self.parallel(lat_ts);
                [a * k * lambda, a * self.q(phi) / (2.0 * k)]
            }
            Kind::Sinusoidal => {
                let (s, c) = phi.sin_cos();
                [a * lambda * c / (1.0 - self.e2 * s * s).sqrt(), self.meridian(phi)]
            }
            Kind::Mollweide => {
                let theta = mollweide_angle(phi);
                let root = 8f64.sqrt() / std::f64::consts::PI;
                [root * a * lambda * theta.cos(), 2f64.sqrt() * a * theta.sin()]
            }
        };
        Some([(x + self.own.x0) / self.unit_m, (y + self.own.y0) / self.unit_m])
    }

    /// Units to degrees; None outside the map.
    pub fn unproject(&self, p: [f64; 2]) -> Option<[f64; 2]> {
        let (x, y) = (p[0] * self.unit_m - self.own.x0, p[1] * self.unit_m - self.own.y0);
        let a = self.e.a;
        let (lambda, phi) = match self.own.kind {
            Kind::CylindricalEqualArea { lat_ts } => {
                let k = self.parallel(lat_ts);
                (x / (a * k), self.latitude_of_q(2.0 * k * y / a)?)
            }
            Kind::Sinusoidal => {
                let phi = self.latitude_of_meridian(y)?;
                let (s, c) = phi.sin_cos();
                let radius = a * c / (1.0 - self.e2 * s * s).sqrt();
                (if radius > 1e-9 { x / radius } else { 0.0 }, phi)
            }
            Kind::Mollweide => {
                let theta = unit_sine(y / (2f64.sqrt() * a))?.asin();
                let phi = unit_sine((2.0 * theta + (2.0 * theta).sin()) / std::f64::consts::PI)?.asin();
                let radius = 8f64.sqrt() / std::f64::consts::PI * a * theta.cos();
                (if radius > 1e-9 { x / radius } else { 0.0 }, phi)
            }
        };
        let lambda = lambda.to_degrees();
        if lambda.is_nan() || lambda.abs() > 180.0 + 1e-9 {
            return None;
        }
        let lon = lambda + self.own.lon0;
        Some([if lon.abs() > 180.0 { lon - 360.0 * (lon / 360.0).round() } else { lon }, phi.to_degrees()])
    }

    /// Radius of a parallel over the semi-major axis (Snyder 14-15 without a).
    fn parallel(&self, lat: f64) -> f64 {
        let (s, c) = lat.to_radians().sin_cos();
        c / (1.0 - self.e2 * s * s).sqrt()
    }

    /// Snyder 3-12.
    fn q(&self, phi: f64) -> f64 {
        let s = phi.sin();
        if self.e2 == 0.0 {
            return 2.0 * s;
        }
        let e = self.e2.sqrt();
        (1.0 - self.e2) * (s / (1.0 - self.e2 * s * s) + (e * s).atanh() / e)
    }

    /// Inverse of [`Plane::q`]: series 3-18 to start with, then Snyder 3-16.
    fn latitude_of_q(&self, q: f64) -> Option<f64> {
        let pole = self.q(std::f64::consts::FRAC_PI_2);
        let beta = unit_sine(q / pole)?.asin();
        let e2 = self.e2;
        let mut phi = beta
            + (e2 / 3.0 + 31.0 * e2 * e2 / 180.0) * (2.0 * beta).sin()
            + 23.0 * e2 * e2 / 360.0 * (4.0 * beta).sin();
        for _ in 0..3 {
            let (s, c) = phi.sin_cos();
            if c < 1e-9 {
                break;
            }
            let w = 1.0 - e2 * s * s;
            phi += (q - self.q(phi)) * w * w / (2.0 * c * (1.0 - e2));
        }
        Some(phi)
    }

    /// Distance from the equator along a meridian: series in the third flattening (as 3-21, to n^5).
    fn meridian(&self, phi: f64) -> f64 {
        let n = self.e.f / (2.0 - self.e.f);
        let n2 = n * n;
        let radius = self.e.a / (1.0 + n) * (1.0 + n2 / 4.0 + n2 * n2 / 64.0);
        let c2 = -1.5 * n + 9.0 / 16.0 * n * n2 - 3.0 / 32.0 * n * n2 * n2;
        let c4 = 15.0 / 16.0 * n2 - 15.0 / 32.0 * n2 * n2;
        let c6 = -35.0 / 48.0 * n * n2 + 105.0 / 256.0 * n * n2 * n2;
        let c8 = 315.0 / 512.0 * n2 * n2;
        let c10 = -693.0 / 1280.0 * n * n2 * n2;
        let terms = [(2.0, c2), (4.0, c4), (6.0, c6), (8.0, c8), (10.0, c10)];
        radius * (phi + terms.iter().map(|(k, c)| c * (k * phi).sin()).sum::<f64>())
    }

    fn latitude_of_meridian(&self, y: f64) -> Option<f64> {
        let quarter = self.meridian(std::f64::consts::FRAC_PI_2);
        let part = unit_sine(y / quarter)?;
        let mut phi = part * std::f64::consts::FRAC_PI_2;
        for _ in 0..6 {
            let s = phi.sin();
            let w = 1.0 - self.e2 * s * s;
            phi += (y - self.meridian(phi)) * w * w.sqrt() / (self.e.a * (1.0 - self.e2));
        }
        Some(phi.clamp(-std::f64::consts::FRAC_PI_2, std::f64::consts::FRAC_PI_2))
    }
}

/// Within [-1, 1], rounding forgiven.
fn unit_sine(v: f64) -> Option<f64> {
    (v.abs() <= 1.0 + 1e-12).then(|| v.clamp(-1.0, 1.0))
}

/// Solves 2 t + sin 2t = pi sin(phi) (Snyder 31-4) by Newton's steps; near the pole, where they stall, the
/// steps are halvings of what is left.
fn mollweide_angle(phi: f64) -> f64 {
    let target = std::f64::consts::PI * phi.sin();
    let (mut low, mut high) = (-std::f64::consts::FRAC_PI_2, std::f64::consts::FRAC_PI_2);
    let mut t = phi;
    for _ in 0..60 {
        let rest = 2.0 * t + (2.0 * t).sin() - target;
        if rest > 0.0 {
            high = t;
        } else {
            low = t;
        }
        let slope = 2.0 + 2.0 * (2.0 * t).cos();
        let newton = t - rest / slope;
        let next = if slope > 1e-9 && newton > low && newton < high { newton } else { (low + high) / 2.0 };
        if (next - t).abs() < 1e-16 {
            return next;
        }
        t = next;
    }
    t
}
