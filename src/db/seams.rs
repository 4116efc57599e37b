//! Correction fields of surveys (section 15 of the LOD-space specification), derived on demand and cached.
//!
//! - A field is a pure function of the surveys of a version: it is in no id, hash, file or law of `verify`, and may be
//!   dropped at any time. So it cannot depend on the order of arrival, and leaves with the survey that caused it.
//! - It is derived place by place: border pieces of a level-0 place, then their reaches (from nine places), then the
//!   nodes of a place (from nine again).
//! - A field asks for the fields of surveys of greater authority only. Authority is a strict total order, so nobody
//!   waits for himself, however many threads ask.

use super::triangles::metres_per_unit;
use super::view::{Rules, Tables, View};
use crate::base::Result;
use crate::base::lattice::Point;
use crate::height::cells::{Block, Fill};
use crate::height::crs::AxisUnit;
use crate::height::frame::{CellRect, Frame, LatticeUnit};
use crate::height::lod::cover::rects;
use crate::height::lod::{Cells, Geometry, KERNEL, Place, SurveyNumber, World};
use crate::height::surface::seam::{
    BAND, Border, Field, Gathering, Piece, Spans, Spot, outline, spans, union,
};
use quick_cache::Weighter;
use quick_cache::sync::Cache;
use std::cmp::Ordering;
use std::sync::Arc;

/// A level-0 place of a survey.
type Block0 = (SurveyNumber, i32, i32);
/// The same under a policy: gaps are held to the stated accuracies.
type Held = (Block0, bool);

/// Bytes of fields kept.
const FIELD_BYTES_CACHED: u64 = 64 << 20;
/// Bytes of borders kept.
const BORDER_BYTES_CACHED: u64 = 32 << 20;

#[derive(Clone)]
struct ByBytes;

impl Weighter<Held, Arc<Field>> for ByBytes {
    fn weight(&self, _: &Held, f: &Arc<Field>) -> u64 {
        f.weight()
    }
}

impl Weighter<Held, Arc<Border>> for ByBytes {
    fn weight(&self, _: &Held, b: &Arc<Border>) -> u64 {
        b.weight()
    }
}

impl Weighter<Held, Arc<Reached>> for ByBytes {
    fn weight(&self, _: &Held, r: &Arc<Reached>) -> u64 {
        64 + 8 * r.reaches.len() as u64
    }
}

/// A border whose reaches are known.
struct Reached {
    border: Arc<Border>,
    reaches: Vec<f64>,
}

/// What was derived lately, for one version.
pub struct SeamCache {
    fields: Cache<Held, Arc<Field>, ByBytes>,
    reached: Cache<Held, Arc<Reached>, ByBytes>,
    borders: Cache<Held, Arc<Border>, ByBytes>,
    /// 29 x 29 posts of a place, voids as NaN.
    posts: Cache<Block0, Arc<Vec<f64>>>,
    cells: Cache<Block0, Block>,
    spans: Cache<Block0, Spans>,
}

impl SeamCache {
    pub fn new() -> SeamCache {
        SeamCache {
            fields: Cache::with_weighter(2048, FIELD_BYTES_CACHED, ByBytes),
            reached: Cache::with_weighter(4096, BORDER_BYTES_CACHED, ByBytes),
            borders: Cache::with_weighter(4096, BORDER_BYTES_CACHED, ByBytes),
            posts: Cache::new(4096),
            cells: Cache::new(65536),
            spans: Cache::new(65536),
        }
    }
}

/// A point in half lattice units: middles of sides and half steps are exact.
#[derive(Clone, Copy)]
struct Halves {
    x: i64,
    y: i64,
}

impl Halves {
    fn of(p: Point) -> Halves {
        Halves { x: 2 * p.x, y: 2 * p.y }
    }
    /// Moved by `num / den` steps of half units.
    fn moved(self, by: Point, num: i64, den: i64) -> Halves {
        let part = |v: i64| (i128::from(v) * i128::from(num)).div_euclid(i128::from(den)) as i64;
        Halves { x: self.x + part(by.x), y: self.y + part(by.y) }
    }
}

/// The cell that holds a point, and how far in it is: exact.
fn locate(frame: &Frame, p: Halves) -> ([i64; 2], [f64; 2]) {
    let d = 2 * frame.determinant();
    let (dx, dy) =
        (i128::from(p.x) - 2 * i128::from(frame.anchor.x), i128::from(p.y) - 2 * i128::from(frame.anchor.y));
    let along = [
        dx * i128::from(frame.v.y) - dy * i128::from(frame.v.x),
        i128::from(frame.u.x) * dy - i128::from(frame.u.y) * dx,
    ]
    .map(|n| n * d.signum());
    let d = d.abs();
    (along.map(|n| n.div_euclid(d) as i64), along.map(|n| n.rem_euclid(d) as f64 / d as f64))
}

/// The fields of one version under one policy.
pub struct Fields<'a> {
    pub view: &'a View,
    pub unit: LatticeUnit,
    pub axis: AxisUnit,
    /// Gaps are held to what both surveys state.
    pub consistent: bool,
    /// Corrections are cubic B-splines between their nodes, of class C2 like the patches; else bilinear.
    pub smooth: bool,
}

impl Fields<'_> {
    fn geometry(&self, n: SurveyNumber) -> &Geometry {
        self.view.geometry_of(n)
    }

    /// Precedence, accuracy, step, declaration: greater is believed more.
    pub(super) fn authority(&self, a: SurveyNumber, b: SurveyNumber) -> Ordering {
        let entry = |n| &self.view.entries()[&n];
        let (x, y) = (&entry(a).geometry, &entry(b).geometry);
        let step = |g: &Geometry| g.steps[0] * g.steps[1];
        x.precedence
            .cmp(&y.precedence)
            .then(y.accuracy.total_cmp(&x.accuracy))
            .then(step(y).total_cmp(&step(x)))
            .then(entry(a).id.cmp(&entry(b).id))
    }

    /// Surveys of greater authority near a rectangle of cells, the greatest first.
    pub(super) fn above(&self, survey: SurveyNumber, cells: &CellRect) -> Vec<SurveyNumber> {
        let bounds = self.geometry(survey).frame.bounds(cells);
        let mut found = Rules(self.view).meeting(&bounds);
        found.retain(|h| *h != survey && self.authority(*h, survey).is_gt());
        found.sort_by(|a, b| self.authority(*b, *a));
        found
    }

    /// Rows of places around one that have a say in its field. Splines reach half a cell further, into one more row.
    pub(super) fn rows(&self) -> i32 {
        if self.smooth { 2 } else { 1 }
    }

    /// The correction of a survey over a level-0 place.
    pub fn field(&self, survey: SurveyNumber, i: i32, j: i32) -> Result<Arc<Field>> {
        let key = ((survey, i, j), self.consistent);
        self.view.seams.fields.get_or_insert_with(&key, || self.derive(survey, i, j))
    }

    fn derive(&self, survey: SurveyNumber, i: i32, j: i32) -> Result<Arc<Field>> {
        let place = Place { level: 0, i, j };
        let (rect, g) = (place.rect(), self.geometry(survey));
        if !rect.grow(1).overlaps(&g.core) {
            return Ok(Arc::default());
        }
        let rows = self.rows();
        let above = self.above(survey, &rect.grow(i64::from(rows) * KERNEL));
        if above.is_empty() {
            return Ok(Arc::default());
        }
        let mut near = Vec::new();
        for (a, b) in around(rows) {
            let corner = [a, b].map(|k| f64::from(k) * KERNEL as f64);
            near.push((corner, self.reached(survey, i + a, j + b)?));
        }
        let near: Vec<_> = near.iter().map(|(c, r)| (*c, &r.border.pieces[..], &r.reaches[..])).collect();
        let corner = Halves::of(g.frame.post(rect.i0, rect.j0));
        let field = Field::new(&near, self.smooth, |a, b| {
            let p = corner.moved(g.frame.u, a, 1).moved(g.frame.v, b, 1);
            self.spot(survey, &above, p)
        })?;
        Ok(Arc::new(field))
    }

    /// What the better surveys say at a node.
    fn spot(&self, survey: SurveyNumber, above: &[SurveyNumber], p: Halves) -> Result<Spot> {
        let Some(h) = self.first_with(above, p, true)? else { return Ok(Spot::Outside) };
        let (gap, contradicted) = self.gap(survey, h, p)?;
        Ok(if gap.is_nan() { Spot::Outside } else { Spot::Inside { gap, contradicted } })
    }

    /// How far the corrected surface of a better survey is above that of a survey, and whether both say otherwise. NaN where one
    /// of them has no height.
    fn gap(&self, survey: SurveyNumber, better: SurveyNumber, p: Halves) -> Result<(f64, bool)> {
        let raw = self.height(better, p)? - self.height(survey, p)?;
        if raw.is_nan() {
            return Ok((raw, false));
        }
        let [gap] = self.held(survey, better, [raw + self.correction(better, p)?]);
        Ok((gap, raw.abs() > self.stated(survey, better)))
    }

    /// What two surveys may differ by, metres.
    fn stated(&self, survey: SurveyNumber, better: SurveyNumber) -> f64 {
        f64::from(self.geometry(survey).accuracy) + f64::from(self.geometry(better).accuracy)
    }

    /// Gaps between two surveys as the policy lets them be.
    pub(super) fn held<const N: usize>(
        &self,
        survey: SurveyNumber,
        better: SurveyNumber,
        gaps: [f64; N],
    ) -> [f64; N] {
        let stated = self.stated(survey, better);
        gaps.map(|g| if self.consistent { g.clamp(-stated, stated) } else { g })
    }

    fn correction(&self, survey: SurveyNumber, p: Halves) -> Result<f64> {
        let (cell, part) = locate(&self.geometry(survey).frame, p);
        let [a, b] = cell.map(|c| c.rem_euclid(KERNEL) as f64);
        let place = Place::of_cell(0, cell[0], cell[1]);
        Ok(self.field(survey, place.i, place.j)?.whole(a + part[0], b + part[1]))
    }

    /// The level-0 surface of a survey; NaN where one of the four posts around is void.
    fn height(&self, survey: SurveyNumber, p: Halves) -> Result<f64> {
        let g = self.geometry(survey);
        let ([i, j], [x, y]) = locate(&g.frame, p);
        if !g.core.grow(2).contains(&CellRect::new(i, j, i + 1, j + 1)) {
            return Ok(f64::NAN);
        }
        let place = Place::of_cell(0, i, j);
        let r = place.rect();
        let z = self.view.seams.posts.get_or_insert_with(&(survey, place.i, place.j), || {
            let posts = CellRect::new(r.i0, r.j0, r.i1 + 1, r.j1 + 1);
            self.view.with_samples(survey, |s| s.posts(&posts)).map(Arc::new)
        })?;
        const SIDE: usize = KERNEL as usize + 1;
        let k = (j - r.j0) as usize * SIDE + (i - r.i0) as usize;
        let left = z[k] + (z[k + SIDE] - z[k]) * y;
        let right = z[k + 1] + (z[k + SIDE + 1] - z[k + 1]) * y;
        Ok(left + (right - left) * x)
    }

    /// Whether a cell is in core' of a survey.
    fn shows(&self, survey: SurveyNumber, i: i64, j: i64) -> Result<bool> {
        if !self.geometry(survey).core.contains(&CellRect::new(i, j, i + 1, j + 1)) {
            return Ok(false);
        }
        let place = Place::of_cell(0, i, j);
        let block = self.view.seams.cells.get_or_insert_with(&(survey, place.i, place.j), || {
            let rules = Rules(self.view);
            Ok::<_, crate::base::Error>(match rules.fill(survey, Cells::CorePrime, place)? {
                Fill::Empty => Block::EMPTY,
                Fill::Full => Block::FULL,
                Fill::Mixed => rules.block(survey, Cells::CorePrime, place.i, place.j)?,
            })
        })?;
        Ok(block.get(i.rem_euclid(KERNEL) as usize, j.rem_euclid(KERNEL) as usize))
    }

    /// The first of some surveys whose core' holds a point; with `closed`, its border counts.
    fn first_with(&self, surveys: &[SurveyNumber], p: Halves, closed: bool) -> Result<Option<SurveyNumber>> {
        for h in surveys {
            let ([i, j], part) = locate(&self.geometry(*h).frame, p);
            let beside = |k: usize| closed && part[k] == 0.0;
            let found = self.shows(*h, i, j)?
                || (beside(0) && self.shows(*h, i - 1, j)?)
                || (beside(1) && self.shows(*h, i, j - 1)?)
                || (beside(0) && beside(1) && self.shows(*h, i - 1, j - 1)?);
            if found {
                return Ok(Some(*h));
            }
        }
        Ok(None)
    }

    /// The tolerances at which a survey is shown at a point.
    fn spans(&self, survey: SurveyNumber, p: Halves) -> Result<Spans> {
        let g = self.geometry(survey);
        let ([i, j], _) = locate(&g.frame, p);
        let place = Place::of_cell(0, i, j);
        self.view.seams.spans.get_or_insert_with(&(survey, place.i, place.j), || {
            let mut live = Vec::new();
            for level in 0..=g.level_max {
                let place = Place::of_cell(level, i, j);
                let (Some(p), Some(t)) = (self.view.patch(survey, place)?, self.view.top(survey, place)?)
                else {
                    continue;
                };
                if t.standing.top > p.fact.bot {
                    live.push([p.fact.bot, t.standing.top]);
                }
            }
            Ok(spans(live, g.accuracy))
        })
    }

    /// The tolerances at which better surveys are shown at a side of their border or behind it, as deep as the lower one
    /// may show through. A better survey's patch on the very border may be covered by what is left of the lower one there, and
    /// its neighbour be shown.
    fn spans_behind(&self, above: &[SurveyNumber], g: &Frame, p: Halves, across: Point) -> Result<Spans> {
        let step = cells_long(g, across);
        let mut found = Vec::new();
        for depth in [0.0, BAND[0] / 2.0, BAND[0]] {
            let hairs = ((2.0 * depth / step * HAIR as f64).round() as i64).max(1);
            let q = p.moved(across, -hairs, HAIR);
            if let Some(h) = self.first_with(above, q, false)? {
                found.push(self.spans(h, q)?);
            }
        }
        Ok(union(&found))
    }

    /// The pieces of a place with their reaches.
    fn reached(&self, survey: SurveyNumber, i: i32, j: i32) -> Result<Arc<Reached>> {
        let key = ((survey, i, j), self.consistent);
        self.view.seams.reached.get_or_insert_with(&key, || {
            let border = self.border(survey, i, j)?;
            if border.pieces.is_empty() {
                return Ok(Arc::new(Reached { border, reaches: Vec::new() }));
            }
            let mut near = Vec::new();
            for (a, b) in around(1) {
                let corner = [a, b].map(|k| f64::from(k) * KERNEL as f64);
                near.push((corner, self.border(survey, i + a, j + b)?));
            }
            let near: Vec<_> = near.iter().map(|(c, b)| (*c, &**b)).collect();
            let g = self.geometry(survey);
            let corner = g.frame.post(i64::from(i) * KERNEL, i64::from(j) * KERNEL);
            let at = [corner.x, corner.y].map(|v| v as f64 * self.unit.size());
            let metres = metres_per_unit(self.axis, at);
            let length = |s: Point| {
                let d = [s.x, s.y].map(|v| v as f64 * self.unit.size());
                (d[0] * metres[0]).hypot(d[1] * metres[1])
            };
            let reaches = border.reaches(&near, length(g.frame.u).min(length(g.frame.v)));
            Ok(Arc::new(Reached { border, reaches }))
        })
    }

    /// The pieces of border between a survey and better ones whose middle lies in a place.
    fn border(&self, survey: SurveyNumber, i: i32, j: i32) -> Result<Arc<Border>> {
        let key = ((survey, i, j), self.consistent);
        self.view.seams.borders.get_or_insert_with(&key, || {
            let rect = Place { level: 0, i, j }.rect();
            let above = self.above(survey, &rect);
            let mut pieces = Gathering::default();
            for h in &above {
                self.pieces_of(survey, *h, &above, &rect, &mut pieces)?;
            }
            if !above.is_empty() {
                self.own_pieces(survey, &above, &rect, &mut pieces)?;
            }
            Ok(Arc::new(pieces.border()))
        })
    }

    /// Sides of core' of a better survey that no other better one covers.
    fn pieces_of(
        &self,
        survey: SurveyNumber,
        better: SurveyNumber,
        above: &[SurveyNumber],
        rect: &CellRect,
        out: &mut Gathering,
    ) -> Result<()> {
        let (g, h) = (&self.geometry(survey).frame, &self.geometry(better).frame);
        let window = h.cells_meeting(&g.quad(rect)).grow(1);
        let others: Vec<SurveyNumber> = above.iter().copied().filter(|o| *o != better).collect();
        let cells = rects(&Rules(self.view), better, Cells::CorePrime, &window.grow(1))?;
        for side in outline(&cells, &window) {
            let (from, along, across) = side.of(h);
            let length = cells_long(g, along);
            // Sides longer than a cell of the lower survey would hide its detail.
            let parts = (length - 1e-9).ceil().max(1.0) as i64;
            for k in 0..parts {
                let p = Halves::of(from).moved(along, 2 * k + 1, parts);
                let (cell, part) = locate(g, p);
                if !rect.contains(&CellRect::new(cell[0], cell[1], cell[0] + 1, cell[1] + 1)) {
                    continue;
                }
                if self.first_with(&others, p.moved(across, 1, HAIR), false)?.is_some() {
                    continue;
                }
                let inner = p.moved(across, -1, HAIR);
                let best = self.first_with(above, inner, false)?.unwrap_or(better);
                let (gap, contradicted) = self.gap(survey, best, p)?;
                out.push(Piece {
                    at: [(cell[0] - rect.i0) as f64 + part[0], (cell[1] - rect.j0) as f64 + part[1]],
                    length: length / parts as f64,
                    ease: length / parts as f64 / 2.0,
                    gap,
                    contradicted,
                    spans: self.spans_behind(above, g, p, across)?,
                });
            }
        }
        Ok(())
    }

    /// Sides of the survey's own core' inside better ones: there, too, one gives way to the other.
    fn own_pieces(
        &self,
        survey: SurveyNumber,
        above: &[SurveyNumber],
        rect: &CellRect,
        out: &mut Gathering,
    ) -> Result<()> {
        let g = &self.geometry(survey).frame;
        let window = rect.grow(1);
        let cells = rects(&Rules(self.view), survey, Cells::CorePrime, &window.grow(1))?;
        for side in outline(&cells, &window) {
            let (from, along, across) = side.of(g);
            let p = Halves::of(from).moved(along, 1, 1);
            let (cell, part) = locate(g, p);
            if !rect.contains(&CellRect::new(cell[0], cell[1], cell[0] + 1, cell[1] + 1)) {
                continue;
            }
            let outer = p.moved(across, 1, HAIR);
            let Some(best) = self.first_with(above, outer, false)? else { continue };
            out.push(Piece {
                at: [(cell[0] - rect.i0) as f64 + part[0], (cell[1] - rect.j0) as f64 + part[1]],
                length: 1.0,
                ease: 0.5,
                gap: f64::NAN,
                contradicted: false,
                spans: self.spans(best, outer)?,
            });
        }
        Ok(())
    }
}

/// A point is on a side of a border if it is there when moved across by this part of half a step.
const HAIR: i64 = 512;

/// A place and its neighbours, row by row.
fn around(rows: i32) -> impl Iterator<Item = (i32, i32)> {
    (-rows..=rows).flat_map(move |b| (-rows..=rows).map(move |a| (a, b)))
}

/// Length of a vector in cells of a frame.
fn cells_long(frame: &Frame, v: Point) -> f64 {
    let d = frame.determinant() as f64;
    let (x, y) = (v.x as f64, v.y as f64);
    let a = (x * frame.v.y as f64 - y * frame.v.x as f64) / d;
    let b = (frame.u.x as f64 * y - frame.u.y as f64 * x) / d;
    a.hypot(b)
}
