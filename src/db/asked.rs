//! What a question takes of the nodes that it meets: the same patches as if every record were held against the region and
//! the tolerance by exact clipping, most of them decided by a few comparisons.
//!
//! A record is stored in every node whose cell its domain meets, and is to be taken once. Where the tolerance is the same everywhere,
//! and the domain lies inside the region, whether it is needed depends on the record alone, and none of the nodes that hold it
//! is passed over: then the node takes it whose cell holds its middle ([`own`](crate::store::quadtree::Summary::own)). Otherwise that node may
//! be passed over, as its cell lies outside of the region or the tolerance over it is another; then whoever comes first
//! takes it, and ids tell who that is. Records whose domain lies within one cell are in one node only and need neither.

use super::found::Found;
use crate::base::Result;
use crate::base::lattice::{Bounds, Quad};
use crate::height::lod::PatchId;
use crate::height::lod::cut::{Boxes, Clip, Cut, LOT, Lies};
use crate::height::surface::KAPPA;
use crate::store::quadtree::{Below, Domains, Question, Range, Record, Spot, bits, first};
use std::collections::HashSet;
use std::hash::{BuildHasherDefault, Hasher};

/// Ids of records that were taken.
pub type Met = HashSet<PatchId, BuildHasherDefault<OfContent>>;

/// Ids are hashes already: their first bytes serve as they are.
#[derive(Default)]
pub struct OfContent(u64);

impl Hasher for OfContent {
    fn write(&mut self, id: &[u8]) {
        self.0 = id.first_chunk::<8>().map_or(self.0, |c| u64::from_le_bytes(*c));
    }

    // The length of an id says nothing.
    fn write_usize(&mut self, _: usize) {}

    fn finish(&self) -> u64 {
        self.0
    }
}

/// The corners of a quad, CRS units.
pub fn corners(quad: &Quad, size: f64) -> [[f64; 2]; 4] {
    quad.0.map(|p| [p.x as f64 * size, p.y as f64 * size])
}

/// A question, and what was found so far.
pub struct Asked<'a> {
    pub domains: &'a dyn Domains,
    pub size: f64,
    pub cut: &'a dyn Cut,
    /// Weights in LOD space: floors count, and tops reach further by the fade.
    pub exact: bool,
    pub clip: Clip,
    pub met: Met,
    pub found: Found,
}

impl Asked<'_> {
    fn kappa(&self) -> f64 {
        if self.exact { KAPPA } else { 1.0 }
    }

    /// Floors among the records of a spot that count.
    fn floors(&self, spot: &Spot) -> u64 {
        if self.exact { spot.summary.floors } else { 0 }
    }

    /// A disc around a cell.
    fn disc(&self, cell: &Bounds) -> ([f64; 2], f64) {
        let (a, b) = (cell.min, cell.max);
        let middle = [a.x.midpoint(b.x), a.y.midpoint(b.y)].map(|v| v as f64 * self.size);
        let half = [b.x - a.x, b.y - a.y].map(|v| v as f64 * self.size / 2.0);
        (middle, half[0].hypot(half[1]))
    }

    /// The borders of the region that the domains of a spot come near; none: every single one [`Lies::Inside`].
    #[inline]
    fn borders(&self, spot: &Spot) -> u64 {
        let [x, y, radius] = spot.summary.reach;
        self.clip.borders([x, y], radius)
    }

    /// The first `n` records of a spot whose domains lie inside the region, those with their middle in it, and those that may meet
    /// it.
    fn sort(&self, spot: &Spot, n: usize) -> [u64; 3] {
        match self.borders(spot) {
            0 => [first(n); 3],
            borders => {
                let b = spot.shelf.boxes(n);
                self.clip.sort(b.x, b.y, b.radius, borders)
            }
        }
    }

    /// The corners of a record's domain.
    fn domain(&self, r: &Record) -> [[f64; 2]; 4] {
        corners(&self.domains.domain(r), self.size)
    }

    /// The part of a record's domain in the region; empty if they do not meet.
    fn part(&mut self, spot: &Spot, k: usize) -> &[[f64; 2]] {
        let domain = self.domain(&spot.records[k]);
        let b = spot.shelf.boxes(spot.records.len());
        self.clip.part_within(&domain, [b.x[k], b.y[k]], b.radius[k])
    }

    /// Of the records in a mask those that were not taken before.
    fn new_ones(&mut self, spot: &Spot, mask: u64) -> u64 {
        let again = bits(mask & !spot.summary.alone).filter(|k| !self.met.insert(spot.records[*k].id));
        mask & !again.fold(0, |m, k| m | 1 << k)
    }
}

/// A question whose tolerance is the same everywhere.
pub struct Even<'a> {
    pub asked: Asked<'a>,
    range: Range,
    /// The least top that is looked at, and the least that is needed.
    looked_at: f32,
    needed: f32,
    /// The greatest bot that is needed.
    most: f32,
}

impl<'a> Even<'a> {
    pub fn new(asked: Asked<'a>, tolerance: f64) -> Even<'a> {
        let kappa = asked.kappa();
        let lo = tolerance / kappa;
        Even {
            range: Range { lo, hi: tolerance, inside: false },
            looked_at: least(|top| f64::from(top) > lo),
            needed: least(|top| tolerance < kappa * f64::from(top)),
            most: -least(|minus| f64::from(-minus) <= tolerance),
            asked,
        }
    }
}

/// The least float for which a rule holds that holds for all greater ones; NaN (which is at most or at least nothing) where it
/// holds for none.
fn least(rule: impl Fn(f32) -> bool) -> f32 {
    if !rule(f32::INFINITY) {
        return f32::NAN;
    }
    // Floats in ascending order are whole numbers in ascending order.
    let float = |n: i32| f32::from_bits(if n < 0 { !n as u32 | 1 << 31 } else { n as u32 });
    let number =
        |v: f32| if v.is_sign_negative() { !(v.to_bits() as i32 & i32::MAX) } else { v.to_bits() as i32 };
    let (mut below, mut holds) = (i64::from(number(f32::NEG_INFINITY)) - 1, i64::from(number(f32::INFINITY)));
    while holds - below > 1 {
        let middle = below.midpoint(holds);
        if rule(float(middle as i32)) { holds = middle } else { below = middle }
    }
    float(holds as i32)
}

impl Question for Even<'_> {
    #[inline]
    fn range(&mut self, cell: &Bounds, above: Option<&Range>, below: Option<&Below>) -> Option<Range> {
        if below.is_some_and(|b| !self.range.meets(b)) {
            return None;
        }
        if above.is_some_and(|a| a.inside) {
            return Some(Range { inside: true, ..self.range });
        }
        let (middle, radius) = self.asked.disc(cell);
        let lies = self.asked.clip.lies(middle, radius);
        let met = match lies {
            Lies::Inside | Lies::Middle => true,
            Lies::Outside => false,
            Lies::Unclear => {
                let quad = corners(&cell.quad(), self.asked.size);
                !self.asked.clip.part_within(&quad, middle, radius).is_empty()
            }
        };
        met.then_some(Range { inside: lies == Lies::Inside, ..self.range })
    }

    #[inline]
    fn visit(&mut self, spot: &Spot, number: Option<u32>, _: &Range) -> Result<bool> {
        let looked_at = spot.of_top(self.looked_at);
        let (high, low) = (spot.of_top(self.needed), spot.of_bot(self.most));
        self.asked.found.tested += u64::from(looked_at.count_ones());
        let mut taken = looked_at & high & (low | self.asked.floors(spot));
        if taken != 0 {
            let [inside, middle, met] = self.asked.sort(spot, spot.summary.all.count_ones() as usize);
            let mut across = taken & met & !inside;
            for k in bits(across & !middle) {
                if self.asked.part(spot, k).is_empty() {
                    across &= !(1 << k);
                }
            }
            taken = taken & inside & spot.summary.own | self.asked.new_ones(spot, across);
        }
        self.asked.found.take(spot, number, taken);
        Ok(looked_at == spot.summary.all)
    }
}

/// A question whose tolerance varies.
pub struct Uneven<'a> {
    pub asked: Asked<'a>,
}

impl Uneven<'_> {
    /// Whether a record is needed, by the corners of its domain; `inside`: all of that is in the region.
    fn needs(&mut self, spot: &Spot, k: usize, floor: bool, inside: bool) -> bool {
        let (r, cut) = (&spot.records[k], self.asked.cut);
        let (lo, hi) = if inside {
            cut.bounds(&self.asked.domain(r))
        } else {
            let part = self.asked.part(spot, k);
            if part.is_empty() {
                return false;
            }
            cut.bounds(part)
        };
        lo < self.asked.kappa() * f64::from(r.top) && (f64::from(r.bot) <= hi || floor)
    }
}

impl Question for Uneven<'_> {
    fn range(&mut self, cell: &Bounds, above: Option<&Range>, below: Option<&Below>) -> Option<Range> {
        let (middle, radius) = self.asked.disc(cell);
        let inside = above.is_some_and(|a| a.inside);
        let lies = if inside { Lies::Inside } else { self.asked.clip.lies(middle, radius) };
        if lies == Lies::Outside {
            return None;
        }
        let quad = corners(&cell.quad(), self.asked.size);
        let part =
            if lies == Lies::Inside { &quad } else { self.asked.clip.part_within(&quad, middle, radius) };
        if part.is_empty() {
            return None;
        }
        let (lo, hi) = self.asked.cut.bounds(part);
        let range = Range { lo: lo / self.asked.kappa(), hi, inside: lies == Lies::Inside };
        below.is_none_or(|b| range.meets(b)).then_some(range)
    }

    /// Boxes around what lies below tell of most cells at once that they need not be asked about.
    fn ranges(
        &mut self,
        cells: &[Bounds; 4],
        above: &Range,
        below: &[Option<Below>; 4],
    ) -> [Option<Range>; 4] {
        let (mut x, mut y) = ([0.0; LOT], [0.0; LOT]);
        let (mut top, mut bot) = ([0.0; LOT], [0.0; LOT]);
        for (k, (cell, below)) in cells.iter().zip(below).enumerate() {
            ([x[k], y[k]], _) = self.asked.disc(cell);
            (top[k], bot[k]) = below.map_or((0.0, 0.0), |b| (b.top_max, b.bot_min));
        }
        let (_, radius) = self.asked.disc(&cells[0]);
        let first = corners(&cells[0].quad(), self.asked.size);
        let arms = [first[0][0] - x[0], first[0][1] - y[0], first[1][0] - x[0], first[1][1] - y[0]];
        let arms = arms.map(|v| [v as f32; LOT]);
        let boxes = Boxes {
            x: &x,
            y: &y,
            radius: &[radius; LOT],
            top: &top,
            bot: &bot,
            arms: arms.each_ref().map(|v| &v[..]),
        };
        let f = self.asked.cut.foresee(&boxes, self.asked.kappa());
        std::array::from_fn(|k| {
            let b = below[k].as_ref()?;
            let needless = f.not_above_lo >> k & 1 == 1 || f.not_below_hi >> k & 1 == 1 && !b.floor;
            if needless { None } else { self.range(&cells[k], Some(above), Some(b)) }
        })
    }

    fn visit(&mut self, spot: &Spot, number: Option<u32>, range: &Range) -> Result<bool> {
        let shelf = &*spot.shelf;
        let n = shelf.tops().partition_point(|t| f64::from(*t) > range.lo);
        self.asked.found.tested += n as u64;
        let (floors, kappa) = (self.asked.floors(spot), self.asked.kappa());
        let boxes = shelf.boxes(n);
        let f = self.asked.cut.foresee(&boxes, kappa);
        let mut taken = first(n) & !(f.not_above_lo | f.not_below_hi & !floors);
        if taken != 0 {
            let [inside, middle, met] = self.asked.sort(spot, n);
            taken &= met;
            let mut unclear = taken & !(inside & f.above_lo & (f.below_hi | floors));
            // Of a domain across a border the part in the region holds the middle, or is to be found.
            if unclear & middle & !inside != 0 {
                let m = self.asked.cut.foresee_middles(&boxes, kappa);
                unclear &= !(middle & m.above_lo & (m.below_hi | floors));
            }
            for k in bits(unclear) {
                if !self.needs(spot, k, floors >> k & 1 == 1, inside >> k & 1 == 1) {
                    taken &= !(1 << k);
                }
            }
        }
        taken = self.asked.new_ones(spot, taken);
        self.asked.found.take(spot, number, taken);
        Ok(n == shelf.records.len())
    }
}

#[cfg(test)]
mod tests;
