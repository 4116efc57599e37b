//! Datums: which ones are taken as the same, which shift is applied between the others, and who chose it.
//!
//! Modern datums (WGS 84, ITRF, ETRS89, NAD83, GDA ...) count as one: the EPSG registry ties each of them to
//! WGS 84 by a null transformation and states how well that holds. Between an old datum (NAD27, Pulkovo 1942,
//! Potsdam ...) and anything else there are many operations, metres apart, and no library picks the same one:
//! so nothing is picked here. The system's own text states the shift (`+towgs84`), or the user does.

use super::definition::Ellipsoid;
use crate::base::{Error, Result};

/// Datums with a null transformation to WGS 84: EPSG datum codes by the accuracy in metres that the registry
/// states for it (at least 1). Source: EPSG v11.022 as in PROJ 9.5.1, and the realisations of WGS 84, ITRF,
/// ETRF and NAD83, for which it states 1 to 2 m against the ensemble.
const MODERN: [(f64, &[u32]); 5] = [
    (
        1.0,
        &[
            1026, 1029, 1032, 1033, 1034, 1035, 1036, 1038, 1041, 1042, 1047, 1056, 1057, 1058, 1060, 1062,
            1063, 1066, 1067, 1068, 1069, 1073, 1078, 1095, 1100, 1113, 1120, 1128, 1132, 1159, 1160, 1167,
            1174, 1178, 1179, 1180, 1181, 1182, 1183, 1184, 1185, 1186, 1187, 1204, 1206, 1208, 1209, 1214,
            1218, 1220, 1223, 1251, 1305, 1312, 1313, 1329, 1355, 1357, 1358, 1367, 1382, 1389, 6126, 6130,
            6148, 6151, 6163, 6167, 6171, 6173, 6176, 6180, 6189, 6190, 6258, 6612, 6619, 6624, 6627, 6659,
            6661, 6667, 6670, 6674, 6686, 6687, 6694, 6702, 6737, 6742, 6747, 6749, 6755, 6757, 6758, 6761,
            6762, 6763, 6764, 6765,
        ],
    ),
    (1.5, &[1065]),
    (
        2.0,
        &[
            1061, 1076, 1116, 1117, 1118, 1133, 1141, 1147, 1152, 1153, 1154, 1155, 1156, 1165, 1166, 1191,
            1192, 1193, 1194, 1195, 1196, 1197, 1198, 1211, 1212, 1221, 1244, 1245, 1247, 1249, 1309, 1322,
            1333, 1365, 1383, 6140, 6152, 6166, 6170, 6326, 6647, 6648, 6649, 6650, 6651, 6652, 6653, 6654,
            6655, 6656, 6759, 6896,
        ],
    ),
    (3.0, &[1168, 6283]),
    (4.0, &[6269]),
];

/// A similarity to WGS 84 in geocentric space, position vector convention (EPSG 9606; what `+towgs84` means).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Helmert {
    pub shift_m: [f64; 3],
    pub turn_arcsec: [f64; 3],
    pub scale_ppm: f64,
}

impl Helmert {
    /// Three or seven numbers, `dx,dy,dz[,rx,ry,rz,s]`: metres, arc seconds, parts per million.
    pub fn parse(text: &str) -> Option<Helmert> {
        let numbers: Option<Vec<f64>> =
            text.split(',').map(|t| t.trim().parse().ok().filter(|v: &f64| v.is_finite())).collect();
        match numbers?[..] {
            [x, y, z] => Some(Helmert { shift_m: [x, y, z], turn_arcsec: [0.0; 3], scale_ppm: 0.0 }),
            [x, y, z, rx, ry, rz, s] => {
                Some(Helmert { shift_m: [x, y, z], turn_arcsec: [rx, ry, rz], scale_ppm: s })
            }
            _ => None,
        }
    }

    fn is_null(&self) -> bool {
        self.shift_m == [0.0; 3] && self.turn_arcsec == [0.0; 3] && self.scale_ppm == 0.0
    }

    /// Scaled small-angle rotation matrix, as PROJ's towgs84 has it.
    fn matrix(&self) -> [[f64; 3]; 3] {
        let [x, y, z] = self.turn_arcsec.map(|s| (s / 3600.0).to_radians());
        let m = 1.0 + self.scale_ppm * 1e-6;
        [[m, -m * z, m * y], [m * z, m, -m * x], [-m * y, m * x, m]]
    }

    /// Geocentric metres on the datum to geocentric metres on WGS 84.
    fn apply(&self, p: [f64; 3]) -> [f64; 3] {
        let m = self.matrix();
        [0, 1, 2].map(|i| self.shift_m[i] + m[i][0] * p[0] + m[i][1] * p[1] + m[i][2] * p[2])
    }

    /// The exact inverse of [`Helmert::apply`].
    fn undo(&self, p: [f64; 3]) -> [f64; 3] {
        let m = self.matrix();
        let q = [0, 1, 2].map(|i| p[i] - self.shift_m[i]);
        let cofactor = |i: usize, j: usize| {
            let (a, b, c, d) = ((i + 1) % 3, (i + 2) % 3, (j + 1) % 3, (j + 2) % 3);
            m[a][c] * m[b][d] - m[a][d] * m[b][c]
        };
        let determinant = m[0][0] * cofactor(0, 0) + m[0][1] * cofactor(0, 1) + m[0][2] * cofactor(0, 2);
        [0, 1, 2]
            .map(|i| (cofactor(0, i) * q[0] + cofactor(1, i) * q[1] + cofactor(2, i) * q[2]) / determinant)
    }
}

/// `dx,dy,dz` or `dx,dy,dz,rx,ry,rz,s`.
impl std::fmt::Display for Helmert {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let [x, y, z] = self.shift_m;
        write!(f, "{x},{y},{z}")?;
        let [rx, ry, rz] = self.turn_arcsec;
        match (self.turn_arcsec, self.scale_ppm) {
            ([0.0, 0.0, 0.0], 0.0) => Ok(()),
            (_, s) => write!(f, ",{rx},{ry},{rz},{s}"),
        }
    }
}

/// What the user says about a shift between two datums that are not taken as the same.
#[derive(Clone, Debug, Default, PartialEq)]
pub enum DatumChoice {
    /// Nothing: a shift that nobody states is refused.
    #[default]
    None,
    /// Parameters from the one old datum to WGS 84.
    ToWgs84(Helmert),
    /// Longitude and latitude are taken over as they are: wrong by up to some hundred metres.
    Ballpark,
}

impl DatumChoice {
    /// Reads `none`, `ballpark` or `dx,dy,dz[,rx,ry,rz,s]` (position vector convention, as `+towgs84`).
    pub fn parse(text: &str) -> Result<DatumChoice> {
        match text.trim() {
            "none" => Ok(DatumChoice::None),
            "ballpark" => Ok(DatumChoice::Ballpark),
            numbers => Helmert::parse(numbers).map(DatumChoice::ToWgs84).ok_or_else(|| {
                Error::invalid(
                    "datum shift",
                    format!(
                        "'{text}' is neither 'ballpark' nor dx,dy,dz or dx,dy,dz,rx,ry,rz,s (metres, arc \
                         seconds, parts per million; position vector convention)"
                    ),
                )
            }),
        }
    }
}

/// What [`DatumChoice::parse`] reads.
impl std::fmt::Display for DatumChoice {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            DatumChoice::None => write!(f, "none"),
            DatumChoice::ToWgs84(h) => write!(f, "{h}"),
            DatumChoice::Ballpark => write!(f, "ballpark"),
        }
    }
}

/// The datum of a definition.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Datum {
    /// Taken as WGS 84; off by as many metres at most, by the registry.
    Modern { code: u32, name: String, accuracy_m: f64 },
    /// The definition itself states the way to WGS 84.
    Declared(Helmert),
    /// Known by name, not tied to WGS 84.
    Old { code: u32, name: String },
    /// An ellipsoid and no word about the datum. A modern ellipsoid is taken as WGS 84.
    Unnamed { modern: bool },
}

impl Datum {
    /// `code`: of the EPSG datum, 0 for none. `null`: the text itself states that it agrees with WGS 84.
    pub fn new(
        code: u32,
        name: Option<String>,
        declared: Option<Helmert>,
        null: bool,
        ellipsoid: Ellipsoid,
    ) -> Datum {
        let name = name.unwrap_or_else(|| match code {
            6267 => "NAD27".to_string(),
            6269 => "NAD83".to_string(),
            6326 => "WGS 84".to_string(),
            6258 => "ETRS89".to_string(),
            code => format!("datum EPSG:{code}"),
        });
        let modern = MODERN.iter().find(|(_, codes)| codes.contains(&code));
        match (modern, declared) {
            (_, Some(helmert)) if !helmert.is_null() => Datum::Declared(helmert),
            (Some((accuracy_m, _)), _) => Datum::Modern { code, name, accuracy_m: *accuracy_m },
            (None, _) if code != 0 => Datum::Old { code, name },
            _ => Datum::Unnamed { modern: ellipsoid.is_modern() && (null || declared.is_none()) },
        }
    }

    /// Taken as WGS 84 without a shift.
    fn is_modern(&self) -> bool {
        matches!(self, Datum::Modern { .. } | Datum::Unnamed { modern: true })
    }

    /// One and the same datum; the ellipsoids are compared elsewhere. Of two nameless datums on an old ellipsoid
    /// nobody knows: on Bessel's there are dozens, hundreds of metres apart.
    pub fn same(&self, other: &Datum) -> bool {
        match (self, other) {
            (Datum::Old { code: x, .. }, Datum::Old { code: y, .. })
            | (Datum::Modern { code: x, .. }, Datum::Modern { code: y, .. }) => x == y,
            (Datum::Declared(x), Datum::Declared(y)) => x == y,
            (Datum::Unnamed { modern: x }, Datum::Unnamed { modern: y }) => *x && *y,
            _ => false,
        }
    }

    fn words(&self) -> String {
        match self {
            Datum::Modern { name, .. } | Datum::Old { name, .. } => name.clone(),
            Datum::Declared(h) => format!("a datum with +towgs84={h}"),
            Datum::Unnamed { modern: true } => "an unnamed datum on WGS 84's ellipsoid".to_string(),
            Datum::Unnamed { modern: false } => "an unnamed datum".to_string(),
        }
    }
}

/// The way from one datum to another: up to WGS 84, down again.
#[derive(Clone, Debug)]
pub(super) struct Shift {
    up: Option<(Ellipsoid, Helmert)>,
    down: Option<(Ellipsoid, Helmert)>,
    /// What is done, for the record.
    pub text: String,
    /// What a user should know.
    pub notes: Vec<String>,
}

impl Shift {
    /// Between two systems on one datum.
    pub fn none_on(datum: &Datum) -> Shift {
        Shift { up: None, down: None, text: format!("one datum ({})", datum.words()), notes: Vec::new() }
    }

    /// # Errors
    /// If nobody states the shift, or the user's choice does not fit the two datums.
    pub fn between(
        what: &str,
        (from, from_ellipsoid): (&Datum, Ellipsoid),
        (to, to_ellipsoid): (&Datum, Ellipsoid),
        choice: &DatumChoice,
    ) -> Result<Shift> {
        let none = |text: String, notes: Vec<String>| Shift { up: None, down: None, text, notes };
        let (a, b) = (from.words(), to.words());
        if from.same(to) && from_ellipsoid.same(to_ellipsoid) {
            return Ok(Shift::none_on(from));
        }
        if from.is_modern() && to.is_modern() {
            let within = [from, to]
                .into_iter()
                .map(|d| match d {
                    Datum::Modern { accuracy_m, .. } => *accuracy_m,
                    _ => 2.0,
                })
                .fold(0.0, f64::max);
            let note = format!(
                "{a} and {b} are taken as one datum: the EPSG registry ties both to WGS 84 by null \
                 transformations, the coarser good to {within} m"
            );
            return Ok(none(format!("{a} to {b}: taken as one datum"), vec![note]));
        }
        if *choice == DatumChoice::Ballpark {
            let note = format!(
                "longitude and latitude on {a} are taken over to {b} as they are: wrong by up to some hundred \
                 metres"
            );
            return Ok(none(format!("{a} to {b}: ballpark, coordinates taken over"), vec![note]));
        }
        let step = |datum: &Datum, words: &str, other: &Datum| match (datum, choice) {
            (d, _) if d.is_modern() => Ok(None),
            (Datum::Declared(_), DatumChoice::ToWgs84(h)) if other.is_modern() => Ok(Some(*h)),
            (Datum::Declared(h), _) => Ok(Some(*h)),
            (_, DatumChoice::ToWgs84(h)) if other.is_modern() || matches!(other, Datum::Declared(_)) => {
                Ok(Some(*h))
            }
            (_, DatumChoice::ToWgs84(_)) => Err(Error::unsupported(
                what,
                format!("a shift from {a} to {b}, neither tied to WGS 84, takes two sets of parameters"),
                "go by way of EPSG:4326, or choose 'ballpark'",
            )),
            _ => Err(Error::unsupported(
                what,
                format!(
                    "{words} is not tied to WGS 84: the shifts in use for it differ by metres, so none is \
                     taken unasked"
                ),
                "state it with --datum-shift dx,dy,dz[,rx,ry,rz,s] (as +towgs84), or with --datum-shift \
                 ballpark take the coordinates over as they are (wrong by up to some hundred metres)",
            )),
        };
        let (up, down) = (step(from, &a, to)?, step(to, &b, from)?);
        let say = |h: Option<Helmert>, declared: bool| {
            h.map(|h| {
                let who = if declared { "stated by the system" } else { "chosen by the user" };
                format!("towgs84={h} (position vector, {who})")
            })
        };
        let is_declared =
            |d: &Datum, h: Option<Helmert>| matches!(d, Datum::Declared(own) if Some(*own) == h);
        let parts: Vec<String> = [
            say(up, is_declared(from, up)),
            say(down, is_declared(to, down)).map(|t| format!("back by {t}")),
        ]
        .into_iter()
        .flatten()
        .collect();
        Ok(Shift {
            up: up.map(|h| (from_ellipsoid, h)),
            down: down.map(|h| (to_ellipsoid, h)),
            text: format!("{a} to {b}: {}", parts.join(", ")),
            notes: Vec::new(),
        })
    }

    /// Longitude and latitude in degrees, from the first datum to the second; heights are taken as 0.
    pub fn forward(&self, p: [f64; 2]) -> [f64; 2] {
        Shift::walk(p, &self.up, &self.down)
    }

    pub fn inverse(&self, p: [f64; 2]) -> [f64; 2] {
        Shift::walk(p, &self.down, &self.up)
    }

    fn walk(p: [f64; 2], up: &Option<(Ellipsoid, Helmert)>, down: &Option<(Ellipsoid, Helmert)>) -> [f64; 2] {
        let p = up.as_ref().map_or(p, |(ellipsoid, h)| to_wgs84(p, *ellipsoid, h));
        down.as_ref().map_or(p, |(ellipsoid, h)| from_wgs84(p, *ellipsoid, h))
    }
}

/// The point on the datum's ellipsoid, moved to WGS 84; the height it gets there is dropped.
fn to_wgs84(p: [f64; 2], ellipsoid: Ellipsoid, h: &Helmert) -> [f64; 2] {
    geographic(h.apply(geocentric(p, ellipsoid)), Ellipsoid::WGS84)
}

/// The inverse of [`to_wgs84`]. Undoing the similarity alone would be millimetres off, as heights were
/// dropped; what is left over is taken off until it is gone.
fn from_wgs84(p: [f64; 2], ellipsoid: Ellipsoid, h: &Helmert) -> [f64; 2] {
    let mut q = geographic(h.undo(geocentric(p, Ellipsoid::WGS84)), ellipsoid);
    for _ in 0..3 {
        let r = to_wgs84(q, ellipsoid, h);
        let turn = p[0] - r[0];
        q = [q[0] + turn - 360.0 * (turn / 360.0).round(), q[1] + p[1] - r[1]];
    }
    q
}

/// Degrees on the ellipsoid's surface to geocentric metres.
fn geocentric([lon, lat]: [f64; 2], e: Ellipsoid) -> [f64; 3] {
    let (lon, lat) = (lon.to_radians(), lat.to_radians());
    let e2 = e.f * (2.0 - e.f);
    let n = e.a / (1.0 - e2 * lat.sin().powi(2)).sqrt();
    [n * lat.cos() * lon.cos(), n * lat.cos() * lon.sin(), n * (1.0 - e2) * lat.sin()]
}

/// Geocentric metres to degrees, by Bowring's formula; the height is dropped. Exact to 1e-12 degrees near
/// the surface.
fn geographic([x, y, z]: [f64; 3], e: Ellipsoid) -> [f64; 2] {
    let e2 = e.f * (2.0 - e.f);
    let b = e.a * (1.0 - e.f);
    let p = x.hypot(y);
    let mut reduced = (z * e.a).atan2(p * b);
    let mut lat = 0.0;
    for _ in 0..3 {
        let (s, c) = reduced.sin_cos();
        lat = (z + e2 / (1.0 - e2) * b * s.powi(3)).atan2(p - e2 * e.a * c.powi(3));
        reduced = ((1.0 - e.f) * f64::sin(lat)).atan2(f64::cos(lat));
    }
    [y.atan2(x).to_degrees(), lat.to_degrees()]
}
