//! Patches: 33 x 33 vertices, a surface between them, and an error measured at every sample
//! (sections 1 and 8 of the LOD-space specification; "Patchwork Terrains", section 4.1).
//!
//! A database has one kind of patches: [`bilinear`], continuous, or [`bicubic`], splines with continuous curvature.
//! Floating point is part of the definition here: the order of operations in this folder fixes the bits of every
//! stored error and id on every machine (IEEE 754 doubles, no fused multiply-add).

pub mod bicubic;
pub mod bilinear;
mod residual;

pub use residual::{Residuals, worst};

use super::lod::{PatchId, Place, SIDE};
use crate::base::bytes::Put;
use crate::base::round::{add_up, up_f32};
use bicubic::Spline;
use std::sync::Arc;

/// Heights of the 33 x 33 vertices of a patch, row-major from its lowest indices, metres.
pub type Vertices = [f64; SIDE * SIDE];

/// What lies between vertices, and how smooth weights and fades are: one for a whole database.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Kind {
    /// Bilinear patches, hat weights, linear fades: a continuous surface.
    #[default]
    Bilinear,
    /// Natural bicubic splines, weights and fades of class C2: slope and curvature are continuous, too.
    Bicubic,
}

impl Kind {
    pub const ALL: [Kind; 2] = [Kind::Bilinear, Kind::Bicubic];

    /// As the constant `patch` of a database says it.
    pub fn name(self) -> &'static str {
        match self {
            Kind::Bilinear => "bilinear",
            Kind::Bicubic => "bicubic",
        }
    }

    /// As the constant `weight` of a database says it.
    pub fn weight_name(self) -> &'static str {
        match self {
            Kind::Bilinear => "hat, unit volume",
            Kind::Bicubic => "C2, unit volume",
        }
    }

    pub fn parse(name: &str) -> Option<Kind> {
        Kind::ALL.into_iter().find(|k| k.name() == name)
    }

    /// What a weight is multiplied with to have unit volume: 1 over the squared integral of `w` from -1 to 1 (section 7).
    pub fn volume(self) -> f64 {
        match self {
            Kind::Bilinear => 1.0,
            Kind::Bicubic => 25.0 / 16.0,
        }
    }

    /// What patch ids begin with: patches of two kinds are never the same patch.
    fn id_domain(self) -> &'static [u8] {
        match self {
            Kind::Bilinear => b"terraquilt patch 1",
            Kind::Bicubic => b"terraquilt bicubic patch 1",
        }
    }
}

/// A patch at a point. Functions that make one are always inlined: who needs the height alone does not pay for the rest.
/// Its height and derivatives by the two index coordinates, in cells of the patch.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Local {
    pub z: f64,
    /// By s and t.
    pub first: [f64; 2],
    /// By ss, st and tt.
    pub second: [f64; 3],
}

/// A patch ready to be evaluated. A clone is the same patch, not another one in memory.
#[derive(Clone)]
pub enum Shape {
    Bilinear(Arc<Vertices>),
    Bicubic(Arc<Spline>),
}

impl Shape {
    pub fn new(kind: Kind, z: Box<Vertices>) -> Shape {
        match kind {
            Kind::Bilinear => Shape::Bilinear(Arc::from(z)),
            Kind::Bicubic => Shape::Bicubic(Arc::new(Spline::new(&z))),
        }
    }

    /// At (s, t) in cells from the first vertex, `0 <= s, t <= 32`.
    #[inline(always)]
    pub fn at(&self, s: f64, t: f64) -> Local {
        match self {
            Shape::Bilinear(z) => bilinear::evaluate(z, s, t),
            Shape::Bicubic(spline) => spline.evaluate(s, t),
        }
    }
}

/// The cell of one index coordinate and the position in it: the last vertex belongs to the last cell.
#[inline]
fn cell(s: f64) -> (usize, f64) {
    let a = (s.floor().max(0.0) as usize).min(SIDE - 2);
    (a, s - a as f64)
}

/// Bottom of the box: accuracy plus measured error, rounded up to the stored type.
pub fn bottom(accuracy_m: f64, delta: f64) -> f32 {
    up_f32(add_up(accuracy_m, delta))
}

/// The content key of a patch: blake3 over the message drawn in `docs/format.md`.
///
/// The message lies in one piece before it is hashed, since blake3 takes several chunks of a kilobyte side by side.
pub fn id(kind: Kind, declaration: &[u8; 16], place: Place, z: &Vertices, bot: f32) -> PatchId {
    let mut head = Vec::with_capacity(64);
    head.put(kind.id_domain());
    head.put(declaration);
    head.put_u8(place.level);
    head.put_i32(place.i);
    head.put_i32(place.j);
    head.put_f32(bot);
    let mut message = [0u8; 64 + SIDE * SIDE * 8];
    let (start, heights) = message.split_at_mut(head.len());
    start.copy_from_slice(&head);
    for (out, v) in heights.chunks_exact_mut(8).zip(z) {
        // One zero: -0 and +0 are the same height.
        out.copy_from_slice(&(v + 0.0).to_le_bytes());
    }
    let hash = blake3::hash(&message[..head.len() + SIDE * SIDE * 8]);
    PatchId(hash.as_bytes()[..16].try_into().expect("a hash has 32 bytes"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_kind_is_part_of_the_id() {
        let (z, place) = ([0.0; SIDE * SIDE], Place::new(3, -2, 5));
        let [a, b] = Kind::ALL.map(|k| id(k, &[7; 16], place, &z, 1.0));
        assert_ne!(a, b);
        assert_eq!(Kind::ALL.map(|k| Kind::parse(k.name())), Kind::ALL.map(Some));
        assert_eq!(Kind::parse("biquintic"), None);
    }

    /// Field by field and height by height, as the message is drawn.
    #[test]
    fn the_id_is_the_hash_of_its_message() {
        let z: Vertices =
            std::array::from_fn(|k| (k as f64 - 500.0) * 0.25 * if k % 3 == 0 { -0.0 } else { 1.0 });
        for kind in Kind::ALL {
            let place = Place::new(5, -7, 1 << 20);
            let mut h = blake3::Hasher::new();
            h.put(kind.id_domain());
            h.put(&[9; 16]);
            h.put_u8(place.level);
            h.put_i32(place.i);
            h.put_i32(place.j);
            h.put_f32(2.5);
            z.iter().for_each(|v| h.put_f64(if *v == 0.0 { 0.0 } else { *v }));
            assert_eq!(id(kind, &[9; 16], place, &z, 2.5).0, h.finalize().as_bytes()[..16]);
        }
    }
}
