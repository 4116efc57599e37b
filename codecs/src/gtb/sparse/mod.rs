//! Stream G1, the published scheme: a part of the posts, the others by midpoints (specification of GTB, section 4).
//!
//! Passes in order. A post is a *candidate* when all its apexes inside the lattice are needed. Of each candidate, in raster
//! order: is it needed (its triangles split); if so, is it selected; if so, by how many steps its height differs from the midpoint
//! of its hypotenuse. Fictitious heights never travel.
//!
//! Posts without data are never selected. Posts that the receiver has are selected and nothing of them travels; what their closure
//! needs is needed without a flag.

use super::bitree;
use super::companion::Companion;
use super::dense::{Mark, Reached, corners};
use super::field::{Field, Status};
use super::header::Header;
use crate::Result;
use crate::lattice::{Lattice, Pass, Post};
use crate::range::Coder;

mod around;
mod counts;
mod flags;
mod guess;
mod least;
mod shape;
mod steps;

use around::Around;
use flags::Flags;
use steps::Steps;

/// What both sides know of the posts while they are coded.
struct Known {
    /// Which are needed; corners are.
    needed: Vec<bool>,
    /// Which are selected.
    selected: Vec<bool>,
    /// Heights where selected, else midpoints: exact, for 26 bits and at most 26 halvings fit.
    surface: Vec<f64>,
    /// By how much the height of a selected post differs from its midpoint, in units; else 0.
    surplus: Vec<f32>,
}

/// What the encoder knows beforehand.
struct Plan<'a> {
    z: &'a [i32],
    needed: Vec<bool>,
    selected: Vec<bool>,
    /// Of each pass the least magnitude of its steps.
    least: Vec<u32>,
}

/// Both directions: an encoder gives the heights of the lattice as `source` and the selection in the field, a decoder finds them
/// there. Layer 0 alone; `header.layers[0]` is the step of heights, 1 for exact ones.
pub(super) fn code<C: Coder, T: Companion<C>>(
    header: &Header,
    source: Option<&[i32]>,
    field: &mut Field,
    c: &mut C,
    companion: &mut T,
    mark: Mark<C>,
) -> Result<Reached> {
    let (lattice, step) = (header.lattice, header.layers[0]);
    let given: Vec<bool> = field.status.iter().map(|s| *s == Status::Given).collect();
    let forced = if header.given.is_some() { bitree::needed(lattice, &given) } else { Vec::new() };
    if !corners::code(header, source, field, c) {
        return Ok(Reached::NOTHING);
    }
    let plan = source.map(|z| Plan::new(lattice, step, z, field));
    let mut known = Known::new(lattice, field);
    let (mut flags, mut steps) = (Flags::new(), Steps::new(step));
    for (number, pass) in lattice.passes().enumerate() {
        let number = number as u32;
        let at_post = |k| Reached { layer: 0, passes: number, posts: k, corners: true };
        steps.start(c, pass, plan.as_ref().map_or(0, |p| p.least[number as usize]));
        if c.ended() {
            break_off(&mut known, field);
            return Ok(at_post(0));
        }
        for (k, post) in pass.posts(lattice).enumerate() {
            let at = post[0] * lattice.side() + post[1];
            let (middle, candidate) = known.meet(lattice, pass, post);
            if field.status(at) == Status::Given {
                known.put(at, middle, field.z[at]);
            } else {
                field.z[at] = base(middle);
            }
            let forced = forced.get(at).copied().unwrap_or(false);
            if candidate && field.status(at) != Status::Given {
                let around = Around::new(lattice, &known, pass, post);
                let needed = forced || flags.needed(c, &around, plan.as_ref().is_some_and(|p| p.needed[at]));
                let selected = needed
                    && field.status(at) == Status::Coded
                    && flags.selected(c, &around, plan.as_ref().is_some_and(|p| p.selected[at]));
                let mut height = field.z[at];
                if selected {
                    let q = plan.as_ref().map_or(0, |p| quantize(p.z[at], middle, step));
                    let q = steps.code(c, &around, middle, q);
                    height = base(middle).wrapping_add(q.wrapping_mul(step as i32));
                }
                if c.ended() {
                    break_off(&mut known, field);
                    return Ok(at_post(k));
                }
                known.needed[at] = needed;
                if selected {
                    field.z[at] = height;
                    known.put(at, middle, height);
                }
            }
            known.needed[at] |= forced;
            if T::ACTIVE {
                companion.after_post(pass, post, c);
                if c.ended() {
                    break_off(&mut known, field);
                    return Ok(at_post(k + 1));
                }
            }
        }
        if T::ACTIVE {
            companion.after_pass(pass, c);
        }
        if !mark(0, number, c)? {
            break_off(&mut known, field);
            return Ok(Reached { layer: 0, passes: number + 1, posts: 0, corners: true });
        }
    }
    break_off(&mut known, field);
    let first = Reached { layer: 0, passes: 2 * lattice.n(), posts: 0, corners: true };
    companion.finish(c);
    Ok(if c.ended() { first } else { Reached { layer: 1, passes: 0, posts: 0, corners: true } })
}

/// The field takes the selection as far as it is known.
fn break_off(known: &mut Known, field: &mut Field) {
    field.selected = std::mem::take(&mut known.selected);
}

/// The height that 0 steps stand for.
fn base(middle: f64) -> i32 {
    (middle + 0.5).floor() as i32
}

/// How many steps from there to a height, to the nearest.
fn quantize(z: i32, middle: f64, step: u32) -> i32 {
    let (away, step) = (i64::from(z) - i64::from(base(middle)), i64::from(step));
    (2 * away + step).div_euclid(2 * step) as i32
}

impl Known {
    fn new(lattice: Lattice, field: &Field) -> Known {
        let posts = lattice.side() * lattice.side();
        let mut known = Known {
            needed: vec![false; posts],
            selected: vec![false; posts],
            surface: vec![0.0; posts],
            surplus: vec![0.0; posts],
        };
        for [y, x] in lattice.corners() {
            let at = y * lattice.side() + x;
            known.put(at, f64::from(field.z[at]), field.z[at]);
        }
        known
    }

    /// The midpoint of a post's hypotenuse, which it takes for now, and whether all its apexes are needed.
    fn meet(&mut self, lattice: Lattice, pass: Pass, post: Post) -> (f64, bool) {
        let number = |[y, x]: Post| y * lattice.side() + x;
        let ([a, b], apexes) = pass.parents(lattice, post);
        let middle = (self.surface[number(a)] + self.surface[number(b)]) / 2.0;
        self.surface[number(post)] = middle;
        (middle, apexes.into_iter().flatten().all(|p| self.needed[number(p)]))
    }

    /// A post that is selected.
    fn put(&mut self, at: usize, middle: f64, z: i32) {
        self.needed[at] = true;
        self.selected[at] = true;
        self.surface[at] = f64::from(z);
        self.surplus[at] = (f64::from(z) - middle) as f32;
    }
}

impl<'a> Plan<'a> {
    /// Goes ahead over all passes: which heights would travel. Where 0 steps are all that is left, and the surface stays the same
    /// or steps are coarse, a post is not selected after all.
    fn new(lattice: Lattice, step: u32, z: &'a [i32], field: &Field) -> Plan<'a> {
        let mut known = Known::new(lattice, field);
        let mut least = Vec::new();
        for pass in lattice.passes() {
            let mut smallest = u32::MAX;
            for post in pass.posts(lattice) {
                let at = post[0] * lattice.side() + post[1];
                let (middle, _) = known.meet(lattice, pass, post);
                match field.status(at) {
                    Status::Given => known.put(at, middle, field.z[at]),
                    Status::Coded if field.selected[at] => {
                        let q = quantize(z[at], middle, step);
                        if q != 0 || step == 1 && f64::from(z[at]) != middle {
                            smallest = smallest.min(q.unsigned_abs());
                            known.put(at, middle, base(middle) + q * step as i32);
                        }
                    }
                    _ => {}
                }
            }
            least.push(if smallest == u32::MAX { 0 } else { smallest });
        }
        let needed = bitree::needed(lattice, &known.selected);
        Plan { z, needed, selected: known.selected, least }
    }
}
