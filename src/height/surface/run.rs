//! The surface at a run of points that share a list of patches: any surveys, tolerance, fades and seams, with the bits of
//! [`Sheet::evaluate`]. Patch after patch, the formula is worked out for all points of the run ([`lanes`]).

use super::eval::{Blend, Patch, SHARE_MIN, Scratch, Sheet};
use super::lanes::{self, Along, Lane, RUN, Sums, WIDTH};
use super::{Band, Hood, Planes, outside};
use crate::base::Result;
use crate::base::round::add_up;
use crate::height::lod::KERNEL;
use crate::height::patch::Shape;

/// What a survey is over a run of points.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Cover {
    /// No cell of core' is near any of the points: 1 - v is 1.
    Outside,
    /// All points lie in cells of core': 1 - v is 0.
    Inside,
    /// Some here, some there.
    Mixed,
}

/// A survey over the run.
#[derive(Clone)]
struct Met {
    /// The run for which this was found.
    run: u64,
    i: Lane,
    j: Lane,
    /// Lowest and highest of both.
    range: [[f64; 2]; 2],
    cover: Cover,
    /// 1 - v at each point, where some are in and some are out.
    outside: Lane,
    /// Corrections of seams at each point, whether contradicting surveys made them, and where they are known.
    correction: Lane,
    contradicted: [bool; RUN],
    corrected: [bool; RUN],
}

/// A patch that contributes to some points of the run.
struct Part {
    weights: Lane,
    /// Its error, without corrections of seams.
    bound: f64,
    survey: usize,
}

/// Memory of one thread between runs.
pub(super) struct Runs {
    pub points: Scratch,
    run: u64,
    met: Vec<Met>,
    parts: Vec<Part>,
    x: Lane,
    y: Lane,
    tolerance: Lane,
    level: Lane,
    mask: Lane,
    a: Along,
    b: Along,
    f: Lane,
    sums: Sums,
}

impl Default for Runs {
    fn default() -> Runs {
        Runs {
            points: Scratch::default(),
            run: 0,
            met: Vec::new(),
            parts: Vec::new(),
            x: [0.0; RUN],
            y: [0.0; RUN],
            tolerance: [0.0; RUN],
            level: [0.0; RUN],
            mask: [0.0; RUN],
            a: Along::NONE,
            b: Along::NONE,
            f: [0.0; RUN],
            sums: Sums::NONE,
        }
    }
}

/// Runs shorter than this are worked point by point.
const SHORT: usize = 4;
/// Blocks of cells that are looked at to see whether a survey is the same at all points, at most; or one a point.
const BLOCKS_MAX: f64 = 16.0;

/// A tolerance over a run.
#[derive(Clone, Copy)]
enum Allowed {
    Everywhere(f64),
    Varying,
}

impl Sheet<'_> {
    /// Evaluates up to [`RUN`] points for which `near` lists every patch that may contain one of them, ascending, and writes
    /// what is found to the band: the k-th point to place `place(k)`.
    pub(super) fn run(
        &self,
        points: &[[f64; 2]],
        near: &[u32],
        s: &mut Runs,
        band: &mut Band,
        place: impl Fn(usize) -> usize,
    ) -> Result<()> {
        let finite = points.iter().all(|p| p.iter().all(|v| v.is_finite()));
        if points.len() < SHORT || !finite {
            for (k, p) in points.iter().enumerate() {
                let found = self.evaluate::<f64>(*p, &mut s.points, None)?;
                band.set(place(k), found.as_ref().map(|(e, _)| e));
            }
            return Ok(());
        }
        // Whole vectors: the last point is repeated.
        let count = points.len().next_multiple_of(WIDTH);
        for k in 0..count {
            [s.x[k], s.y[k]] = points[k.min(points.len() - 1)];
        }
        let allowed = match self.cut.everywhere() {
            Some(z) => Allowed::Everywhere(z),
            None => {
                for k in 0..count {
                    s.tolerance[k] = self.cut.at([s.x[k], s.y[k]]);
                }
                Allowed::Varying
            }
        };
        s.run += 1;
        s.parts.clear();
        s.sums.weights[..count].fill(0.0);
        s.sums.sum[..count].fill(0.0);
        for k in near {
            self.contribute(*k, allowed, count, s)?;
        }
        self.finish(points.len(), count, s, band, place)
    }

    /// Adds one patch to the sums.
    fn contribute(&self, number: u32, allowed: Allowed, count: usize, s: &mut Runs) -> Result<()> {
        let surface = self.surface;
        let patch = &surface.patches[number as usize];
        self.meet(patch.survey, count, s)?;
        let (survey, met) = (&surface.surveys[patch.survey], &s.met[patch.survey]);
        let (domain, r) = (patch.place.domain(), f64::from(1u32 << patch.place.level));
        let (lo, hi) = ([domain.i0 as f64, domain.j0 as f64], [domain.i1 as f64, domain.j1 as f64]);
        let beside = (0..2).any(|k| met.range[k][1] <= lo[k] || met.range[k][0] >= hi[k]);
        if beside || met.cover == Cover::Outside {
            return Ok(());
        }
        let exact = surface.blend == Blend::Exact;
        let level = if exact { self.level_of(patch, allowed, count, s)? } else { Some(1.0) };
        if level.is_some_and(|l| l <= 0.0) {
            return Ok(());
        }
        let kind = surface.kind;
        let met = &s.met[patch.survey];
        lanes::along(&met.i, count, lo[0], 1.0 / r, kind, &mut s.a);
        lanes::along(&met.j, count, lo[1], 1.0 / r, kind, &mut s.b);
        let volume = kind.volume() / (survey.half[0] * r * (survey.half[1] * r));
        let mut weights = [0.0; RUN];
        // The factors of `evaluate`, in its order; those that are 1 change nothing.
        let mixed = met.cover == Cover::Mixed;
        lanes::weights(
            &s.a,
            &s.b,
            count,
            volume,
            if mixed { 1.0 } else { level.unwrap_or(1.0) },
            &mut weights,
        );
        if mixed {
            for k in 0..count {
                s.f[k] = 1.0 - met.outside[k];
                if !exact {
                    // The plain blend only asks whether the survey is there.
                    s.f[k] = if s.f[k] > 0.0 { 1.0 } else { 0.0 };
                }
            }
            lanes::fade(&mut weights, &s.f, count);
            if let Some(level) = level {
                s.f[..count].fill(level);
                lanes::fade(&mut weights, &s.f, count);
            }
        }
        if level.is_none() {
            lanes::fade(&mut weights, &s.level, count);
        }
        if weights[..count].iter().all(|w| *w <= 0.0) {
            return Ok(());
        }
        match self.shape(number, &mut s.points)? {
            Shape::Bilinear(z) => lanes::bilinear(z, &s.a, &s.b, count, &mut s.f),
            Shape::Bicubic(spline) => {
                for k in (0..count).filter(|k| weights[*k] > 0.0) {
                    s.f[k] = spline.height(s.a.cell[k] as usize, s.a.x[k], s.b.cell[k] as usize, s.b.x[k]);
                }
            }
        }
        lanes::add(&mut s.sums, &weights, &s.f, count);
        let bound = f64::from(patch.bot);
        if surface.corrected {
            self.bend(patch.survey, allowed, &weights, count, s)?;
        }
        s.parts.push(Part { weights, bound, survey: patch.survey });
        Ok(())
    }

    /// up' dn of a patch: `None` if it is not the same at all points; then it is in `s.level`.
    fn level_of(&self, patch: &Patch, allowed: Allowed, count: usize, s: &mut Runs) -> Result<Option<f64>> {
        let kind = self.surface.kind;
        let one = match allowed {
            Allowed::Everywhere(z) => {
                let (down, up) = (patch.down(kind, z), patch.up(kind, z));
                if down <= 0.0 {
                    return Ok(Some(down));
                }
                if !(patch.floor && up < 1.0) {
                    return Ok(Some(up * down));
                }
                Some((up, down))
            }
            Allowed::Varying => None,
        };
        let any = one.is_some() || (0..count).any(|k| patch.floor && patch.up(kind, s.tolerance[k]) < 1.0);
        let mut mask = Some(1.0);
        if any {
            mask = self.mask(patch, count, s)?;
        }
        let level = |up: f64, down: f64, mask: f64| patch.masked(up, mask) * down;
        if let (Some((up, down)), Some(mask)) = (one, mask) {
            return Ok(Some(level(up, down, mask)));
        }
        for k in 0..count {
            let (up, down) =
                one.unwrap_or_else(|| (patch.up(kind, s.tolerance[k]), patch.down(kind, s.tolerance[k])));
            // A patch that has faded out has no level, whatever its lower side says.
            s.level[k] = if down <= 0.0 { down } else { level(up, down, mask.unwrap_or(s.mask[k])) };
        }
        Ok(None)
    }

    /// How far no better survey is there, for a floor patch: `None` if it is not the same at all points; then it is in
    /// `s.mask`.
    fn mask(&self, patch: &Patch, count: usize, s: &mut Runs) -> Result<Option<f64>> {
        let mut same = true;
        for (n, survey) in self.surface.surveys.iter().enumerate() {
            if survey.accuracy >= patch.bot {
                continue;
            }
            self.meet(n, count, s)?;
            let met = &s.met[n];
            match met.cover {
                Cover::Outside => {}
                Cover::Inside => return Ok(Some(0.0)),
                Cover::Mixed => {
                    for k in 0..count {
                        s.mask[k] = (if same { 1.0 } else { s.mask[k] }) * met.outside[k];
                    }
                    same = false;
                }
            }
        }
        Ok(same.then_some(1.0))
    }

    /// Finds the corrections of a survey where it contributes.
    fn bend(
        &self,
        survey: usize,
        allowed: Allowed,
        weights: &Lane,
        count: usize,
        s: &mut Runs,
    ) -> Result<()> {
        let met = &mut s.met[survey];
        for k in (0..count).filter(|k| weights[*k] > 0.0) {
            if !met.corrected[k] {
                let z = match allowed {
                    Allowed::Everywhere(z) => z,
                    Allowed::Varying => s.tolerance[k],
                };
                let (c, contradicted) = self.correction(survey, [met.i[k], met.j[k]], z, &mut s.points)?;
                (met.correction[k], met.contradicted[k], met.corrected[k]) = (c, contradicted, true);
            }
        }
        Ok(())
    }

    /// Finds a survey over the run, unless that was done.
    fn meet(&self, survey: usize, count: usize, s: &mut Runs) -> Result<()> {
        if s.met.is_empty() {
            let none = Met {
                run: 0,
                i: [0.0; RUN],
                j: [0.0; RUN],
                range: [[0.0; 2]; 2],
                cover: Cover::Outside,
                outside: [0.0; RUN],
                correction: [0.0; RUN],
                contradicted: [false; RUN],
                corrected: [false; RUN],
            };
            s.met.resize(self.surface.surveys.len(), none);
        }
        let met = &mut s.met[survey];
        if met.run == s.run {
            return Ok(());
        }
        met.run = s.run;
        met.corrected[..count].fill(false);
        lanes::index(&self.surface.surveys[survey], &s.x, &s.y, count, &mut met.i, &mut met.j);
        met.range = [lanes::range(&met.i[..count]), lanes::range(&met.j[..count])];
        met.cover = self.cover(survey, met.range, count, &mut s.points)?;
        if met.cover == Cover::Mixed {
            for k in 0..count {
                met.outside[k] = self.outside(survey, [met.i[k], met.j[k]], &mut s.points)?;
            }
        }
        Ok(())
    }

    /// What a survey is over a box of its index space, as far as a few blocks of cells tell: what is mixed may turn out to
    /// be the same everywhere.
    pub(super) fn cover(
        &self,
        survey: usize,
        range: [[f64; 2]; 2],
        points: usize,
        s: &mut Scratch,
    ) -> Result<Cover> {
        let f = &self.surface.surveys[survey];
        if (0..2).any(|k| range[k][1] < f.reach[0][k] || range[k][0] > f.reach[1][k]) {
            return Ok(Cover::Outside);
        }
        if (0..2).any(|k| range[k][0] < f.reach[0][k] || range[k][1] > f.reach[1][k]) {
            return Ok(Cover::Mixed);
        }
        let blocks = range.map(|r| r.map(|c| (c / KERNEL as f64).floor()));
        let [cols, rows] = blocks.map(|b| b[1] - b[0] + 1.0);
        if cols * rows > BLOCKS_MAX.max(points as f64) {
            return Ok(Cover::Mixed);
        }
        let (mut empty, mut full) = (true, true);
        for j in blocks[1][0] as i32..=blocks[1][1] as i32 {
            for i in blocks[0][0] as i32..=blocks[0][1] as i32 {
                let hood = self.hood(survey, i, j, s)?;
                empty &= *hood == Hood::Empty;
                full &= *hood == Hood::Full;
                if !empty && !full {
                    return Ok(Cover::Mixed);
                }
            }
        }
        Ok(if full { Cover::Inside } else { Cover::Outside })
    }

    /// 1 - v of a survey at a point of its index space.
    fn outside(&self, survey: usize, index: [f64; 2], s: &mut Scratch) -> Result<f64> {
        let f = &self.surface.surveys[survey];
        if (0..2).any(|k| index[k] < f.reach[0][k] || index[k] > f.reach[1][k]) {
            return Ok(1.0);
        }
        let block = index.map(|c| (c / KERNEL as f64).floor());
        let hood = self.hood(survey, block[0] as i32, block[1] as i32, s)?;
        let [x, y] = [0, 1].map(|k| index[k] - block[k] * KERNEL as f64);
        Ok(outside(hood, self.surface.kind, x, y))
    }

    /// What came out, point by point.
    fn finish(
        &self,
        points: usize,
        count: usize,
        s: &mut Runs,
        band: &mut Band,
        place: impl Fn(usize) -> usize,
    ) -> Result<()> {
        let surface = self.surface;
        lanes::heights(&s.sums, count, &mut s.f);
        let mut errors = [f64::NEG_INFINITY; RUN];
        let (mut contradiction, mut correction) = ([false; RUN], [0.0; RUN]);
        if surface.corrected {
            for k in (0..points).filter(|k| s.sums.weights[*k] > 0.0) {
                let total = s.sums.weights[k];
                let mut sum = 0.0;
                for part in s.parts.iter().filter(|part| part.weights[k] > 0.0) {
                    let (w, met) = (part.weights[k], &s.met[part.survey]);
                    sum += w * met.correction[k];
                    if w > SHARE_MIN * total {
                        errors[k] = errors[k].max(add_up(part.bound, met.correction[k].abs()));
                        contradiction[k] |= met.contradicted[k];
                    }
                }
                let plain = s.f[k];
                s.f[k] = plain + sum / total;
                correction[k] = s.f[k] - plain;
            }
        } else {
            for part in &s.parts {
                lanes::raise(&mut errors, &s.sums, &part.weights, part.bound, count);
            }
        }
        let mut certified = [false; RUN];
        let mut accuracy = [f32::INFINITY; RUN];
        for (n, survey) in surface.surveys.iter().enumerate() {
            self.meet(n, count, s)?;
            let met = &s.met[n];
            for k in 0..count {
                let here = match met.cover {
                    Cover::Outside => break,
                    Cover::Inside => true,
                    Cover::Mixed => met.outside[k] == 0.0,
                };
                if here {
                    certified[k] = true;
                    accuracy[k] = accuracy[k].min(survey.accuracy);
                }
            }
        }
        if certified[..count].contains(&false) {
            for part in &s.parts {
                for k in (0..count).filter(|k| !certified[*k] && part.weights[*k] > 0.0) {
                    accuracy[k] = accuracy[k].min(surface.surveys[part.survey].accuracy);
                }
            }
        }
        for k in 0..points {
            let to = place(k);
            if s.sums.weights[k] <= 0.0 {
                band.set(to, None);
                continue;
            }
            band.z[to] = s.f[k];
            band.error_m[to] = errors[k];
            band.accuracy_m[to] = accuracy[k];
            band.marks[to] = Planes::marks(certified[k], contradiction[k]);
            if surface.corrected {
                band.correction_m[to] = correction[k];
            }
        }
        Ok(())
    }
}
