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
use crate::height::lod::cut::{Clip, Cut, Foreseen, Lies};
use crate::height::surface::KAPPA;
use crate::store::quadtree::{Below, Domains, Question, Range, Record, SHELF, Spot, bits, first, mask};
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

    /// Whether all domains of a spot lie inside the region. Then every single one [`Lies::Inside`].
    fn holds(&self, spot: &Spot) -> bool {
        let [x, y, radius] = spot.summary.reach;
        self.clip.lies([x, y], radius, 3.0) == Lies::Inside
    }

    /// Of the records in a mask, those whose discs lie inside the region, have their middle in it, and may meet it.
    fn lie(&self, spot: &Spot, mask: u64) -> (u64, u64, u64) {
        let d = spot.shelf.discs(spot.shelf.records.len());
        let (mut inside, mut middle, mut met) = (0, 0, 0);
        for k in bits(mask) {
            let lies = self.clip.lies([d.x[k], d.y[k]], d.radius[k], 1.0);
            inside |= u64::from(lies == Lies::Inside) << k;
            middle |= u64::from(matches!(lies, Lies::Inside | Lies::Middle)) << k;
            met |= u64::from(lies != Lies::Outside) << k;
        }
        (inside, middle, met)
    }

    /// The part of a record's domain in the region; empty if they do not meet.
    fn part(&mut self, r: &Record) -> &[[f64; 2]] {
        self.clip.part(&corners(&self.domains.domain(r), self.size))
    }

    /// Of the records in a mask those that were not taken before.
    fn new_ones(&mut self, spot: &Spot, mask: u64) -> u64 {
        let again = bits(mask & !spot.summary.alone).filter(|k| !self.met.insert(spot.shelf.records[*k].id));
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
    let number = |v: f32| if v.is_sign_negative() { !(v.to_bits() as i32 & i32::MAX) } else { v.to_bits() as i32 };
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
        let lies = self.asked.clip.lies(middle, radius, 1.0);
        let met = match lies {
            Lies::Inside | Lies::Middle => true,
            Lies::Outside => false,
            Lies::Unclear => !self.asked.clip.part(&corners(&cell.quad(), self.asked.size)).is_empty(),
        };
        met.then_some(Range { inside: lies == Lies::Inside, ..self.range })
    }

    #[inline]
    fn visit(&mut self, spot: &Spot, number: Option<u32>, _: &Range) -> Result<bool> {
        let (shelf, all) = (&*spot.shelf, spot.summary.all);
        let on = spot.summary.top_least >= self.looked_at;
        let looked_at = if on { all } else { first(shelf.of_top(self.looked_at)) };
        let high = if spot.summary.top_least >= self.needed { all } else { first(shelf.of_top(self.needed)) };
        let low = shelf.of_bot(self.most);
        self.asked.found.tested += u64::from(looked_at.count_ones());
        let mut taken = looked_at & high & (low | self.asked.floors(spot));
        if self.asked.holds(spot) {
            taken &= spot.summary.own;
        } else if taken != 0 {
            let (inside, middle, met) = self.asked.lie(spot, taken);
            let mut across = taken & met & !inside;
            for k in bits(across & !middle) {
                if self.asked.part(&shelf.records[k]).is_empty() {
                    across &= !(1 << k);
                }
            }
            taken = taken & inside & spot.summary.own | self.asked.new_ones(spot, across);
        }
        self.asked.found.take(spot, number, taken);
        Ok(on)
    }
}

/// A question whose tolerance varies.
pub struct Uneven<'a> {
    pub asked: Asked<'a>,
    foreseen: Box<[Foreseen; SHELF]>,
}

impl<'a> Uneven<'a> {
    pub fn new(asked: Asked<'a>) -> Uneven<'a> {
        Uneven { asked, foreseen: Box::new([Foreseen::NOTHING; SHELF]) }
    }

    fn foresee(&mut self, n: usize, x: &[f64], y: &[f64], radius: &[f64]) {
        self.foreseen[..n].fill(Foreseen::NOTHING);
        self.asked.cut.foresee(x, y, radius, &mut self.foreseen[..n]);
    }

    /// Whether a record is needed, by clipping its domain.
    fn needs(&mut self, r: &Record, floor: bool) -> bool {
        let kappa = self.asked.kappa();
        let cut = self.asked.cut;
        let part = self.asked.part(r);
        if part.is_empty() {
            return false;
        }
        let (lo, hi) = cut.bounds(part);
        lo < kappa * f64::from(r.top) && (f64::from(r.bot) <= hi || floor)
    }
}

impl Question for Uneven<'_> {
    fn range(&mut self, cell: &Bounds, above: Option<&Range>, below: Option<&Below>) -> Option<Range> {
        let kappa = self.asked.kappa();
        let (middle, radius) = self.asked.disc(cell);
        let inside = above.is_some_and(|a| a.inside);
        let lies = if inside { Lies::Inside } else { self.asked.clip.lies(middle, radius, 1.0) };
        if lies == Lies::Outside {
            return None;
        }
        if let Some(b) = below {
            self.foresee(1, &[middle[0]], &[middle[1]], &[radius]);
            let f = self.foreseen[0];
            if !(Range { lo: f.lo_least / kappa, hi: f.hi_most, inside }).meets(b) {
                return None;
            }
        }
        let quad = corners(&cell.quad(), self.asked.size);
        let part = if lies == Lies::Inside { &quad } else { self.asked.clip.part(&quad) };
        if part.is_empty() {
            return None;
        }
        let (lo, hi) = self.asked.cut.bounds(part);
        let range = Range { lo: lo / kappa, hi, inside: lies == Lies::Inside };
        below.is_none_or(|b| range.meets(b)).then_some(range)
    }

    fn visit(&mut self, spot: &Spot, number: Option<u32>, range: &Range) -> Result<bool> {
        let shelf = &*spot.shelf;
        let n = shelf.tops().partition_point(|t| f64::from(*t) > range.lo);
        self.asked.found.tested += n as u64;
        let d = shelf.discs(n);
        self.foresee(n, d.x, d.y, d.radius);
        let (kappa, floors) = (self.asked.kappa(), self.asked.floors(spot));
        let records = || self.foreseen[..n].iter().zip(shelf.tops()).zip(shelf.bots());
        // Needed for certain if the region holds the middle of the domain; needed for certain not.
        let sure = mask(records().map(|((f, t), _)| f.lo_most < kappa * f64::from(*t)))
            & (mask(records().map(|((f, _), b)| f64::from(*b) <= f.hi_least)) | floors);
        let out = mask(records().map(|((f, t), _)| f.lo_least >= kappa * f64::from(*t)))
            | (mask(records().map(|((f, _), b)| f64::from(*b) > f.hi_most)) & !floors);
        let mut taken = first(n) & !out;
        let mut certain = sure;
        if !self.asked.holds(spot) {
            let (_, middle, met) = self.asked.lie(spot, taken);
            certain &= middle;
            taken &= met;
        }
        for k in bits(taken & !certain) {
            if !self.needs(&shelf.records[k], floors >> k & 1 == 1) {
                taken &= !(1 << k);
            }
        }
        taken = self.asked.new_ones(spot, taken);
        self.asked.found.take(spot, number, taken);
        Ok(n == shelf.records.len())
    }
}
