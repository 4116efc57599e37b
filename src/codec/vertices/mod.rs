//! The 33 x 33 vertices of a patch in some hundred bytes, drawn in `docs/payload.md`.
//!
//! Heights are whole steps of a sample (a power of two, or a decimal place rounded to float32). Each whole number is predicted
//! from six neighbours, and what is left is written in Golomb-Rice codes whose parameter follows the neighbourhood
//! (after LOCO-I, Weinberger, Seroussi and Sapiro 2000). Vertices between two steps carry the rest; those that hold
//! nothing (height 0 beside the data) cost a bit or less.

pub(super) mod code;
mod step;

use crate::base::bytes::{Put, Reader};
use crate::base::{Error, Result};
use crate::height::lod::SIDE;
use crate::height::patch::Vertices;
use code::{Coefficients, Grid};
use step::Step;

const COUNT: usize = SIDE * SIDE;

/// Flags of the first byte.
const DECIMAL: u8 = 1;
const SCALED: u8 = 2;
const CLASSES: u8 = 4;
const FLAT: u8 = 8;
/// Stands alone: 1089 float64 follow.
const RAW: u8 = 0x80;

/// Bytes of a patch that no code makes smaller: the most that one may have.
pub const BYTES_MAX: usize = 1 + 8 * COUNT;

/// How far an unpacked height may be from the packed one, metres: half of the finest step.
pub const ERROR_M: f64 = step::FINEST / 2.0;

/// What a vertex is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub(super) enum Class {
    /// A whole number of steps.
    Whole = 0,
    /// Between two steps: the rest follows, in [`step::FINEST`].
    Between = 1,
    /// Height 0, not coded.
    Nothing = 2,
}

/// Packs heights (finite, metres). `scale` and `offset` are the survey's: heights are samples times one plus the other.
/// [`unpack`] gives back the same heights, or others within [`ERROR_M`] where a sample is finer than 2^-21 m.
pub fn pack(z: &Vertices, scale: f64, offset: f64) -> Vec<u8> {
    let raw = || {
        let mut out = vec![RAW];
        z.iter().for_each(|z| out.put_f64(*z));
        out
    };
    let mut best = packed(z, scale, offset, false);
    let zeros = z.iter().filter(|z| **z == 0.0).count();
    if zeros > 0 && zeros < COUNT {
        let other = packed(z, scale, offset, true);
        if best.as_ref().is_none_or(|b| other.as_ref().is_some_and(|o| o.len() < b.len())) {
            best = other.or(best);
        }
    }
    best.filter(|b| b.len() < BYTES_MAX).unwrap_or_else(raw)
}

/// With one choice: zeros are heights, or nothing. `None` if a height is too large for the codes.
fn packed(z: &Vertices, scale: f64, offset: f64, zeros_are_nothing: bool) -> Option<Vec<u8>> {
    let nothing = |z: f64| zeros_are_nothing && z == 0.0;
    let step = Step::of(z.iter().copied().filter(|z| !nothing(*z)), scale, offset);
    let mut grid = Grid::new();
    for (k, z) in z.iter().enumerate() {
        if nothing(*z) {
            grid.class[k] = Class::Nothing;
            continue;
        }
        let q = step.nearest(*z)?;
        grid.q[k] = q;
        let off = z - step.height(q);
        if off == 0.0 {
            continue;
        }
        let rest = (off / step::FINEST).round();
        if rest.abs() > step::REST_MAX {
            return None;
        }
        if rest != 0.0 {
            grid.class[k] = Class::Between;
            grid.rest[k] = rest as i64;
        }
    }
    let classes = grid.class.iter().any(|c| *c != Class::Whole);
    let flat = !classes && grid.q.iter().all(|q| *q == grid.q[0]);
    let first = grid.class.iter().position(|c| *c != Class::Nothing).map_or(0, |k| grid.q[k]);
    let flags = [(DECIMAL, step.decimal), (SCALED, step.scaled()), (CLASSES, classes), (FLAT, flat)];
    let mut head = vec![flags.iter().fold(0, |f, (bit, set)| if *set { f | bit } else { f })];
    head.put_u8(step.exponent as u8);
    if step.scaled() {
        head.put_f64(step.scale);
        head.put_f64(step.offset);
    }
    put_whole(&mut head, first);
    if flat {
        return Some(head);
    }
    let plane = code::encode(head.clone(), &mut grid, first, &code::PLANE, classes);
    let fitted = code::fit(&grid);
    if fitted == code::PLANE {
        return Some(plane);
    }
    let fitted = code::encode(head, &mut grid, first, &fitted, classes);
    Some(if fitted.len() < plane.len() { fitted } else { plane })
}

/// Unpacks heights. Holds no more than one patch, whatever the bytes say.
///
/// # Errors
/// If the bytes are none that [`pack`] makes, or some of them are missing.
pub fn unpack(bytes: &[u8]) -> Result<Box<Vertices>> {
    if bytes.len() > BYTES_MAX {
        return Err(Error::limit("bytes of a packed patch", BYTES_MAX as u64, bytes.len() as u64));
    }
    let mut r = Reader::new(bytes, "payload", "packed vertices");
    let mut z: Box<Vertices> = vec![0.0; COUNT].into_boxed_slice().try_into().expect("COUNT values");
    let flags = r.u8()?;
    if flags == RAW {
        for z in z.iter_mut() {
            *z = r.f64()?;
            if !z.is_finite() {
                return Err(r.bad(format!("height {z}")));
            }
        }
        r.end()?;
        return Ok(z);
    }
    if flags & !(DECIMAL | SCALED | CLASSES | FLAT) != 0 || flags & (CLASSES | FLAT) == CLASSES | FLAT {
        return Err(r.bad(format!("flags {flags:#04x}")));
    }
    let exponent = r.u8()? as i8;
    let (scale, offset) = if flags & SCALED != 0 { (r.f64()?, r.f64()?) } else { (1.0, 0.0) };
    let step = Step { decimal: flags & DECIMAL != 0, exponent, scale, offset };
    if !step.is_sound() {
        return Err(r.bad(format!("step {step:?}")));
    }
    let first = read_whole(&mut r)?;
    if flags & FLAT != 0 {
        r.end()?;
        z.fill(step.height(first));
        return Ok(z);
    }
    let coefficients: Coefficients = {
        let c = r.take(code::COEFFICIENTS)?;
        std::array::from_fn(|k| i64::from(c[k] as i8))
    };
    let rest = r.take(r.remaining())?;
    let grid = code::decode(rest, first, &coefficients, flags & CLASSES != 0)?;
    for (k, z) in z.iter_mut().enumerate() {
        *z = match grid.class[k] {
            Class::Whole => step.height(grid.q[k]),
            Class::Between => step.height(grid.q[k]) + grid.rest[k] as f64 * step::FINEST,
            Class::Nothing => 0.0,
        };
        if !z.is_finite() {
            return Err(r.bad(format!("height {z} at vertex {k}")));
        }
    }
    Ok(z)
}

/// A whole number: zigzag, then LEB128 (seven bits a byte, the lowest first, the highest bit set where more follow).
fn put_whole(out: &mut Vec<u8>, q: i64) {
    let mut v = code::zigzag(q);
    while v >= 0x80 {
        out.push(v as u8 | 0x80);
        v >>= 7;
    }
    out.push(v as u8);
}

fn read_whole(r: &mut Reader) -> Result<i64> {
    let mut v = 0u64;
    for k in 0..7 {
        let b = r.u8()?;
        v |= u64::from(b & 0x7f) << (7 * k);
        if b < 0x80 {
            let q = code::unzigzag(v);
            return if q.abs() <= code::WHOLE_MAX { Ok(q) } else { Err(r.bad(format!("first number {q}"))) };
        }
    }
    Err(r.bad("a number of more than seven bytes"))
}

#[cfg(test)]
mod tests;
