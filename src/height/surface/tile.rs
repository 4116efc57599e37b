//! The surface on a grid along the axes, in tiles of up to 64 x 64 points, with the bits of [`Sheet::evaluate`].
//!
//! Where the posts of a survey run along the axes as well, weights and cells of a patch belong to a column or to a row of the
//! tile: they are found once for all its points. Each row of the grid then meets a patch along one line through its
//! vertices, and heights, weights and sums are worked out along the row. That is done for plain tiles: one tolerance,
//! no seams to correct, and each survey either fills the tile or is not there. Other tiles are cut in halves, down to runs of
//! points ([`run`](super::run)).

// Loops run over several arrays side by side: by index they read as the formula does.
#![allow(clippy::needless_range_loop)]

use super::eval::{Blend, Patch, SHARE_MIN, Sheet};
use super::lanes::{self, Along, Lane, RUN, Sums, WIDTH};
use super::run::{Cover, Runs};
use super::{Band, Planes, SurveyField};
use crate::base::Result;
use crate::height::lod::SIDE;
use crate::height::patch::{Shape, bicubic, bilinear};
use multiversion::multiversion;

/// Columns and rows of a tile, at most.
pub const TILE: usize = RUN;
/// Patches of a plain tile, at most: with more, smaller tiles cost less.
const PARTS_MAX: usize = 64;

/// A patch that contributes to a plain tile; where its columns and rows lie in it is in `Tiles::along`.
struct Part {
    shape: Shape,
    /// Columns and rows in its domain: first, and end.
    cols: [usize; 2],
    rows: [usize; 2],
    /// Lowest and highest cell among its columns; `straight`: each column is one cell further than the one before.
    cells: [usize; 2],
    straight: bool,
    /// The factors of its weights that are the same everywhere.
    volume: f64,
    level: f64,
    bound: f64,
    /// The least that it weighs anywhere, and whether that is more than a rounding error's share.
    least: f64,
    counts: bool,
}

/// What the work on a row of a tile needs, kept between rows.
struct Line {
    sums: Sums,
    errors: Lane,
    heights: Lane,
    /// Along a bilinear patch: heights at its vertices, with room for columns before the first and behind the last.
    values: [f64; SIDE + 2 * WIDTH],
    /// Along a bicubic one, second derivatives as well.
    bends: [f64; SIDE + 2 * WIDTH],
}

impl Default for Line {
    fn default() -> Line {
        let (values, bends) = ([0.0; SIDE + 2 * WIDTH], [0.0; SIDE + 2 * WIDTH]);
        Line { sums: Sums::NONE, errors: [0.0; RUN], heights: [0.0; RUN], values, bends }
    }
}

/// Index coordinates of a survey by column and by row of the tile.
struct Met {
    cover: Cover,
    i: Lane,
    j: Lane,
}

/// Memory of one thread between tiles.
#[derive(Default)]
pub(super) struct Tiles {
    pub runs: Runs,
    near: Vec<u32>,
    met: Vec<Met>,
    parts: Vec<Part>,
    /// Of each part: by column and by row. Longer than `parts` where there were more of them before.
    along: Vec<[Along; 2]>,
    line: Line,
}

/// Where a block of the grid lies in the band that is filled, and how long rows of the band are.
#[derive(Clone, Copy)]
struct Site {
    col: usize,
    row: usize,
    width: usize,
}

fn sorted(v: &[f64]) -> bool {
    v.iter().all(|v| v.is_finite()) && (v.is_sorted() || v.is_sorted_by(|a, b| a >= b))
}

impl SurveyField {
    /// Posts run along the axes: the first index coordinate depends on x alone, the second on y alone, bit for bit, as the
    /// other axis adds a zero to a number that is not -0.
    fn is_upright(&self) -> bool {
        let plain = |v: f64| v != 0.0 || v.is_sign_positive();
        self.by_y[0] == 0.0 && self.by_x[1] == 0.0 && self.middle_index.into_iter().all(plain)
    }
}

impl Sheet<'_> {
    /// Heights at the points `(xs[c], ys[r])` (CRS units), row by row, into a band of as many points. Fastest where both
    /// ascend or descend.
    pub fn grid(&self, xs: &[f64], ys: &[f64], band: &mut Band) -> Result<()> {
        let mut s = Tiles::default();
        let plain = sorted(xs) && sorted(ys) && self.cut.everywhere().is_some() && !self.surface.corrected;
        for (r, ys) in ys.chunks(TILE).enumerate() {
            for (c, part) in xs.chunks(TILE).enumerate() {
                let site = Site { col: c * TILE, row: r * TILE, width: xs.len() };
                self.block(part, ys, site, plain, &mut s, band)?;
            }
        }
        Ok(())
    }

    fn block(
        &self,
        xs: &[f64],
        ys: &[f64],
        site: Site,
        plain: bool,
        s: &mut Tiles,
        band: &mut Band,
    ) -> Result<()> {
        let (x, y) = (lanes::range(xs), lanes::range(ys));
        let o = self.surface.origin;
        let mut near = std::mem::take(&mut s.near);
        self.surface.index.within([x[0] - o[0], y[0] - o[1]], [x[1] - o[0], y[1] - o[1]], &mut near);
        let (cols, rows) = (xs.len(), ys.len());
        let mut done = plain && near.len() <= PARTS_MAX && self.tile(xs, ys, site, &near, s, band)?;
        if !done && cols * rows <= RUN {
            let mut points = [[0.0; 2]; RUN];
            for (k, p) in points[..cols * rows].iter_mut().enumerate() {
                *p = [xs[k % cols], ys[k / cols]];
            }
            let place = |k: usize| (site.row + k / cols) * site.width + site.col + k % cols;
            self.run(&points[..cols * rows], &near, &mut s.runs, band, place)?;
            done = true;
        }
        s.near = near;
        if done {
            return Ok(());
        }
        if cols >= rows {
            let (left, right) = xs.split_at(cols / 2);
            self.block(left, ys, site, plain, s, band)?;
            self.block(right, ys, Site { col: site.col + cols / 2, ..site }, plain, s, band)
        } else {
            let (low, high) = ys.split_at(rows / 2);
            self.block(xs, low, site, plain, s, band)?;
            self.block(xs, high, Site { row: site.row + rows / 2, ..site }, plain, s, band)
        }
    }

    /// Works a tile, if it is plain; says whether it was.
    fn tile(
        &self,
        xs: &[f64],
        ys: &[f64],
        site: Site,
        near: &[u32],
        s: &mut Tiles,
        band: &mut Band,
    ) -> Result<bool> {
        if !self.meet_all(xs, ys, s)? {
            return Ok(false);
        }
        s.parts.clear();
        let mut most = 0.0;
        for k in near {
            let patch = &self.surface.patches[*k as usize];
            if s.met[patch.survey].cover == Cover::Outside {
                continue;
            }
            let level =
                if self.surface.blend == Blend::Exact { self.plain_level(patch, &s.met) } else { 1.0 };
            if level <= 0.0 {
                continue;
            }
            let Some(part) = self.part(*k, level, [xs.len(), ys.len()], s)? else { continue };
            if part.least <= 0.0 {
                return Ok(false);
            }
            most += part.volume * part.level;
            s.parts.push(part);
        }
        for part in &mut s.parts {
            // Twice: the sum of weights is less than that, however it was rounded.
            part.counts = part.least > 2.0 * SHARE_MIN * most;
        }
        let inside = |n: &usize| s.met[*n].cover == Cover::Inside;
        let surveys = self.surface.surveys.iter().enumerate().filter(|(n, _)| inside(n));
        let best = surveys.map(|(_, survey)| survey.accuracy).fold(f32::INFINITY, f32::min);
        for r in 0..ys.len() {
            let first = (site.row + r) * site.width + site.col;
            let here = first..first + xs.len();
            let (z, error) = (&mut band.z[here.clone()], &mut band.error_m[here.clone()]);
            let (accuracy, marks) = (&mut band.accuracy_m[here.clone()], &mut band.marks[here]);
            accuracy.fill(best);
            marks.fill(Planes::DATA | Planes::CERTIFIED);
            if !row(&s.parts, &s.along, r, &mut s.line, z, error) {
                for k in (0..xs.len()).filter(|k| z[*k].is_nan()) {
                    (error[k], accuracy[k], marks[k]) = (f64::NAN, f32::NAN, 0);
                }
            }
        }
        Ok(true)
    }

    /// Finds all surveys over a tile; false if one is neither absent nor fills it with posts along the axes.
    fn meet_all(&self, xs: &[f64], ys: &[f64], s: &mut Tiles) -> Result<bool> {
        let surveys = &self.surface.surveys;
        s.met.resize_with(surveys.len(), || Met { cover: Cover::Outside, i: [0.0; RUN], j: [0.0; RUN] });
        for (n, (survey, met)) in surveys.iter().zip(&mut s.met).enumerate() {
            // Each index coordinate rises or falls with x and with y: its extremes are at the corners.
            let [(x0, x1), (y0, y1)] = [xs, ys].map(|v| (v[0], v[v.len() - 1]));
            let corners = [[x0, y0], [x1, y0], [x0, y1], [x1, y1]].map(|p| survey.index::<f64>(p));
            let range = [0, 1].map(|k| lanes::range(&corners.map(|c| c[k])));
            met.cover = self.cover(n, range, xs.len() * ys.len(), &mut s.runs.points)?;
            if met.cover == Cover::Mixed || (met.cover == Cover::Inside && !survey.is_upright()) {
                return Ok(false);
            }
            if met.cover == Cover::Inside {
                for (i, x) in met.i.iter_mut().zip(xs) {
                    *i = survey.index::<f64>([*x, y0])[0];
                }
                for (j, y) in met.j.iter_mut().zip(ys) {
                    *j = survey.index::<f64>([x0, *y])[1];
                }
            }
        }
        Ok(true)
    }

    /// up' dn of a patch in a plain tile.
    fn plain_level(&self, patch: &Patch, met: &[Met]) -> f64 {
        let (kind, z) = (self.surface.kind, self.cut.everywhere().unwrap_or(0.0));
        let (down, up) = (patch.down(kind, z), patch.up(kind, z));
        if down <= 0.0 {
            return down;
        }
        let better = self.surface.surveys.iter().zip(met).filter(|(s, _)| s.accuracy < patch.bot);
        let mask = if better.into_iter().any(|(_, m)| m.cover == Cover::Inside) { 0.0 } else { 1.0 };
        patch.masked(up, mask) * down
    }

    /// A patch in a plain tile; `None` if no point lies in its domain.
    fn part(&self, number: u32, level: f64, [cols, rows]: [usize; 2], s: &mut Tiles) -> Result<Option<Part>> {
        let kind = self.surface.kind;
        let patch = &self.surface.patches[number as usize];
        let (survey, met) = (&self.surface.surveys[patch.survey], &s.met[patch.survey]);
        let (domain, r) = (patch.place.domain(), f64::from(1u32 << patch.place.level));
        if s.along.len() == s.parts.len() {
            s.along.push([Along::NONE, Along::NONE]);
        }
        let [a, b] = &mut s.along[s.parts.len()];
        lanes::along(&met.i, cols, domain.i0 as f64, 1.0 / r, kind, a);
        lanes::along(&met.j, rows, domain.j0 as f64, 1.0 / r, kind, b);
        // Rows are worked in whole vectors: a column behind the last one weighs nothing.
        a.weight[cols..cols.next_multiple_of(WIDTH)].fill(0.0);
        // Weights rise to the middle and fall again: those above 0 are next to each other, the least is at an end.
        let within = |w: &[f64]| {
            let first = w.iter().position(|w| *w > 0.0)?;
            let end = w.iter().rposition(|w| *w > 0.0)? + 1;
            Some(([first, end], w[first].min(w[end - 1])))
        };
        let (Some((cols, wa)), Some((rows, wb))) = (within(&a.weight[..cols]), within(&b.weight[..rows]))
        else {
            return Ok(None);
        };
        let volume = kind.volume() / (survey.half[0] * r * (survey.half[1] * r));
        let cells = &a.cell[cols[0]..cols[1]];
        let ends = [cells[0], cells[cells.len() - 1]].map(|c| c as usize);
        let straight = cells.windows(2).all(|c| c[1] == c[0] + 1);
        Ok(Some(Part {
            shape: self.shape(number, &mut s.runs.points)?.clone(),
            straight,
            cells: [ends[0].min(ends[1]), ends[0].max(ends[1])],
            cols,
            rows,
            volume,
            level,
            bound: f64::from(patch.bot),
            least: (wa * wb) * volume * level,
            counts: false,
        }))
    }
}

/// One row of a tile: heights, NaN where no patch contributes, and errors. Says whether all points have a height.
#[multiversion(targets("x86_64+avx512f+avx512dq+avx512vl", "x86_64+avx2"))]
fn row(
    parts: &[Part],
    along: &[[Along; 2]],
    r: usize,
    line: &mut Line,
    z: &mut [f64],
    error: &mut [f64],
) -> bool {
    row_of(parts, along, r, line, z, error)
}

#[inline(always)]
fn row_of(
    parts: &[Part],
    along: &[[Along; 2]],
    r: usize,
    line: &mut Line,
    z: &mut [f64],
    error: &mut [f64],
) -> bool {
    let count = z.len().min(RUN);
    let whole = count.next_multiple_of(WIDTH).min(RUN);
    line.sums.weights[..whole].fill(0.0);
    line.sums.sum[..whole].fill(0.0);
    line.errors[..whole].fill(f64::NEG_INFINITY);
    let here = || parts.iter().zip(along).filter(|(p, _)| p.rows[0] <= r && r < p.rows[1]);
    for (part, [a, b]) in here() {
        part.heights(a, b.cell[r] as usize, b.x[r], line);
        let (first, end) = part.vectors();
        let wb = b.weight[r];
        let bound = if part.counts { part.bound } else { f64::NEG_INFINITY };
        for k in first..end {
            let w = (a.weight[k] * wb) * part.volume * part.level;
            lanes::add_one(&mut line.sums, k, w, line.heights[k]);
            let raised = w > 0.0 && bound > line.errors[k];
            line.errors[k] = if raised { bound } else { line.errors[k] };
        }
    }
    for (part, [a, b]) in here().filter(|(p, _)| !p.counts) {
        for k in part.cols[0]..part.cols[1].min(RUN) {
            let w = (a.weight[k] * b.weight[r]) * part.volume * part.level;
            if w > SHARE_MIN * line.sums.weights[k] && part.bound > line.errors[k] {
                line.errors[k] = part.bound;
            }
        }
    }
    let mut all = true;
    for k in 0..count {
        let w = line.sums.weights[k];
        let height = line.sums.zero[k] + line.sums.sum[k] / w;
        z[k] = if w > 0.0 { height } else { f64::NAN };
        all &= w > 0.0;
    }
    error[..count].copy_from_slice(&line.errors[..count]);
    all
}

impl Part {
    /// The columns in its domain, in whole vectors: where the first begins and the last ends.
    #[inline(always)]
    fn vectors(&self) -> (usize, usize) {
        (self.cols[0] / WIDTH * WIDTH, self.cols[1].next_multiple_of(WIDTH).min(RUN))
    }

    /// Heights of the patch at the columns in its domain, at `y` in its row `b` of cells. What comes out beside the domain, to
    /// whole vectors, is no height and weighs nothing.
    #[inline(always)]
    fn heights(&self, a: &Along, b: usize, y: f64, line: &mut Line) {
        let (first, end) = self.vectors();
        let f = &mut line.heights;
        let [lo, hi] = self.cells;
        // A line through the vertices of the row pays where columns share them.
        let lined = 2 * (self.cols[1] - self.cols[0]) >= hi - lo;
        // The vertex before column `first`, were the patch longer.
        let from = (lo + WIDTH + first).wrapping_sub(self.cols[0]);
        match &self.shape {
            Shape::Bilinear(z) if lined => {
                bilinear::line(z, b, y, &mut line.values[WIDTH..]);
                let v = &line.values;
                if self.straight && from + (end - first) < v.len() {
                    let (v, w) = (&v[from..from + (end - first)], &v[from + 1..from + 1 + (end - first)]);
                    for (((f, x), v), w) in f[first..end].iter_mut().zip(&a.x[first..end]).zip(v).zip(w) {
                        *f = v + (w - v) * x;
                    }
                } else {
                    for k in first..end {
                        let at = (a.cell[k] as usize).min(SIDE - 2) + WIDTH;
                        f[k] = v[at] + (v[at + 1] - v[at]) * a.x[k];
                    }
                }
            }
            Shape::Bilinear(z) => {
                for k in self.cols[0]..self.cols[1] {
                    f[k] = bilinear::height(z, a.cell[k] as usize, a.x[k], b, y);
                }
            }
            Shape::Bicubic(spline) if lined => {
                spline.along(b, y, &mut line.values[WIDTH..], &mut line.bends[WIDTH..]);
                let (v, m) = (&line.values, &line.bends);
                if self.straight && from + (end - first) < v.len() {
                    let n = end - first;
                    let (v, w) = (&v[from..from + n], &v[from + 1..from + 1 + n]);
                    let (m, n) = (&m[from..from + n], &m[from + 1..from + 1 + n]);
                    for (k, (f, x)) in f[first..end].iter_mut().zip(&a.x[first..end]).enumerate() {
                        *f = bicubic::value(*x, v[k], w[k], m[k], n[k]);
                    }
                } else {
                    for k in first..end {
                        let at = (a.cell[k] as usize).min(SIDE - 2) + WIDTH;
                        f[k] = bicubic::value(a.x[k], v[at], v[at + 1], m[at], m[at + 1]);
                    }
                }
            }
            Shape::Bicubic(spline) => {
                for k in self.cols[0]..self.cols[1] {
                    f[k] = spline.height(a.cell[k] as usize, a.x[k], b, y);
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::height::patch::Kind;

    /// Numbers from 0 to 1.
    fn random(seed: u64) -> impl FnMut() -> f64 {
        let mut state = seed;
        move || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 11) as f64 / (1u64 << 53) as f64
        }
    }

    /// The widest vectors of this machine against none: rows of tiles over random patches, in all steps.
    #[test]
    fn vectors_have_the_bits_of_plain_numbers() {
        for seed in 0..200 {
            let mut unit = random(seed);
            let kind = Kind::ALL[seed as usize % 2];
            let count = 1 + (unit() * 64.0) as usize;
            // At whole posts, finer, coarser; towards lower indices, too.
            let step = [1.0, 1.0, 0.3 * unit(), 5.0 * unit(), -1.0][seed as usize % 5];
            let from = unit() * 60.0 - 10.0;
            let from = if step.abs() == 1.0 { from.floor() } else { from };
            let index: Lane = std::array::from_fn(|k| from + step * k as f64);
            let (mut parts, mut along) = (Vec::new(), Vec::new());
            for place in 0..6 {
                let [mut a, mut plain] = [Along::NONE, Along::NONE];
                let first = f64::from(place) * 14.0 - 20.0;
                lanes::along(&index, count, first, 1.0, kind, &mut a);
                lanes::along_of(&index, count, first, 1.0, kind, &mut plain);
                for k in 0..count {
                    assert_eq!(a.cell[k], plain.cell[k]);
                    assert_eq!(a.x[k].to_bits(), plain.x[k].to_bits());
                    assert_eq!(a.weight[k].to_bits(), plain.weight[k].to_bits());
                }
                let inside = |w: &f64| *w > 0.0;
                let Some(low) = a.weight[..count].iter().position(inside) else { continue };
                let end = a.weight[..count].iter().rposition(inside).expect("one is there") + 1;
                let cells = &a.cell[low..end];
                let ends = [cells[0] as usize, cells[cells.len() - 1] as usize];
                let mut b = Along::NONE;
                (b.cell[0], b.x[0], b.weight[0]) = ((unit() * 32.0) as u32, unit(), unit());
                parts.push(Part {
                    shape: Shape::new(kind, Box::new(std::array::from_fn(|_| 100.0 * unit()))),
                    cols: [low, end],
                    rows: [0, 1],
                    cells: [ends[0].min(ends[1]), ends[0].max(ends[1])],
                    straight: cells.windows(2).all(|c| c[1] == c[0] + 1),
                    volume: 1.0 / 256.0,
                    level: unit(),
                    bound: unit(),
                    least: 0.0,
                    counts: place % 3 > 0,
                });
                along.push([a, b]);
            }
            type Row<'a> = &'a dyn Fn(&mut Line, &mut [f64], &mut [f64]) -> bool;
            let work = |f: Row| {
                let (mut z, mut error) = (vec![0.0; count], vec![0.0; count]);
                let all = f(&mut Line::default(), &mut z, &mut error);
                let bits = |v: Vec<f64>| v.into_iter().map(f64::to_bits).collect::<Vec<_>>();
                (all, bits(z), bits(error))
            };
            let wide = work(&|l, z, e| row(&parts, &along, 0, l, z, e));
            let plain = work(&|l, z, e| row_of(&parts, &along, 0, l, z, e));
            assert_eq!(wide, plain, "{kind:?} seed {seed}");
        }
    }
}
