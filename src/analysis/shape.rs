//! Slope, aspect and hillshade from the gradient of the surface.
//!
//! The gradient is the analytic one of the surface at the point, in metres per metre: of bilinear patches and their
//! weights, not a difference over a raster. Horn's 3 x 3 differences (1981), which other programs use, smooth over two
//! cells in each axis; on ground that is quadratic within them both give the same.

use serde::Serialize;

/// What is drawn of the ground's shape.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub enum Shape {
    /// Steepest slope, degrees from level.
    SlopeDegrees,
    /// Steepest slope, rise over run in percent.
    SlopePercent,
    /// Where the slope faces (downhill), degrees clockwise from north; -1 where level.
    Aspect,
    /// Light that a matt surface throws back, 0 (in the shade) to 255 (facing the sun).
    Hillshade(Sun),
}

/// Where the light comes from.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Sun {
    /// Clockwise from north, degrees.
    pub azimuth_deg: f64,
    /// Above the horizon, degrees.
    pub altitude_deg: f64,
    /// Heights are multiplied by this before they are lit.
    pub exaggeration: f64,
}

impl Default for Sun {
    fn default() -> Sun {
        Sun { azimuth_deg: 315.0, altitude_deg: 45.0, exaggeration: 1.0 }
    }
}

impl Shape {
    /// The value for a gradient: rise towards east and north, metres per metre.
    pub fn of(&self, [east, north]: [f64; 2]) -> f64 {
        match self {
            Shape::SlopeDegrees => east.hypot(north).atan().to_degrees(),
            Shape::SlopePercent => east.hypot(north) * 100.0,
            Shape::Aspect if east == 0.0 && north == 0.0 => -1.0,
            Shape::Aspect => {
                // Downhill is against the gradient.
                let a = (-east).atan2(-north).to_degrees();
                let a = if a < 0.0 { a + 360.0 } else { a };
                if a >= 360.0 { 0.0 } else { a }
            }
            Shape::Hillshade(sun) => {
                let (e, n) = (east * sun.exaggeration, north * sun.exaggeration);
                let (az, alt) = (sun.azimuth_deg.to_radians(), sun.altitude_deg.to_radians());
                let light = [az.sin() * alt.cos(), az.cos() * alt.cos(), alt.sin()];
                let dot = (light[2] - e * light[0] - n * light[1]) / (e * e + n * n + 1.0).sqrt();
                255.0 * dot.max(0.0)
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_slope_faces_downhill() {
        for (gradient, faces) in
            [([0.0, -1.0], 0.0), ([-1.0, 0.0], 90.0), ([0.0, 1.0], 180.0), ([1.0, 0.0], 270.0)]
        {
            assert!((Shape::Aspect.of(gradient) - faces).abs() < 1e-12, "{gradient:?}");
        }
        assert_eq!(Shape::Aspect.of([0.0, 0.0]), -1.0);
        assert!((Shape::Aspect.of([1e-300, -1.0]) - 360.0).abs() > 1.0, "360 is written 0");
        assert!((Shape::SlopeDegrees.of([0.6, 0.8]) - 45.0).abs() < 1e-12);
        assert!((Shape::SlopePercent.of([0.3, 0.4]) - 50.0).abs() < 1e-12);
    }

    #[test]
    fn the_side_towards_the_sun_is_bright() {
        let shade = Shape::Hillshade(Sun::default());
        let level = shade.of([0.0, 0.0]);
        assert!((level - 255.0 * 0.5f64.sqrt()).abs() < 1e-9);
        // Rising towards the south-east: facing north-west at 45 degrees.
        let facing = shade.of([0.5f64.sqrt(), -(0.5f64.sqrt())]);
        assert!((facing - 255.0).abs() < 1e-9, "{facing}");
        assert!(shade.of([-1.0, 1.0]) < 1e-6);
    }
}
