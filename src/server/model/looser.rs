//! A tolerance times a factor.

use crate::wire::v1;
use crate::wire::v1::tolerance::Kind;
use bytes::Bytes;

/// Tolerances below this cannot be made looser by multiplying; they count as this, metres.
const LEAST_M: f64 = 1e-3;

/// A checked tolerance made looser: `factor` times as much error everywhere, at least [`LEAST_M`] of it where the factor is
/// above 1.
pub fn looser(t: &v1::Tolerance, factor: f64) -> v1::Tolerance {
    let mut t = t.clone();
    if factor == 1.0 {
        return t;
    }
    let times = |e: &mut f64| *e = (e.max(LEAST_M) * factor).min(f64::MAX);
    match &mut t.kind {
        None => {}
        Some(Kind::ErrorM(e)) => times(e),
        Some(Kind::Camera(c)) => c.pixels = (c.pixels * factor).min(f64::MAX),
        Some(Kind::Foci(f)) => {
            for f in &mut f.foci {
                times(&mut f.error_m);
                f.growth = (f.growth * factor).min(f64::MAX);
            }
        }
        Some(Kind::Raster(r)) => {
            let looser: Vec<u8> = r
                .errors_m
                .chunks_exact(4)
                .map(|b| f32::from_le_bytes(b.try_into().expect("4 bytes were cut")))
                .flat_map(|e| {
                    let e = f64::from(e).max(LEAST_M) * factor;
                    (e.min(f64::from(f32::MAX)) as f32).to_le_bytes()
                })
                .collect();
            r.errors_m = Bytes::from(looser);
        }
    }
    t
}
