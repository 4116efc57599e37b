//! Evaluating the surface: which patches reach a point, their weights, their blend.

use super::bent::{Corrections, MetField};
use super::seam::Field;
use super::{Dual, Hood, KAPPA, Real, outside};
use crate::base::Result;
use crate::base::lattice::Point;
use crate::base::round::add_up;
use crate::height::frame::{Frame, LatticeUnit};
use crate::height::lod::cut::Cut;
use crate::height::lod::{Geometry, KERNEL, MARGIN, PatchId, Place};
use crate::height::patch::{Vertices, evaluate};
use std::sync::Arc;

/// How patches are blended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Blend {
    /// Weights in LOD space: every contributor is within the tolerance, no popping, same from any region.
    Exact,
    /// The paper's equation (1) over the patches whose box the tolerance cuts.
    Plain,
}

/// What is done where surveys disagree (LOD-space specification, section 15).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Seams {
    /// Nothing: every survey as it was delivered.
    #[default]
    Off,
    /// The lower survey is bent towards the higher one along the border, however far apart they are.
    All,
    /// The same, by no more than the two stated accuracies allow; the rest stays a step.
    Consistent,
}

impl Seams {
    pub fn name(self) -> &'static str {
        match self {
            Seams::Off => "off",
            Seams::All => "all",
            Seams::Consistent => "consistent",
        }
    }
}

/// How a surface is made of its patches.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct How {
    pub blend: Blend,
    pub seams: Seams,
}

impl From<Blend> for How {
    /// Without correction of seams.
    fn from(blend: Blend) -> How {
        How { blend, seams: Seams::Off }
    }
}

/// A survey as the surface sees it.
#[derive(Clone, Debug)]
pub struct SurveyField {
    pub accuracy: f32,
    frame: Frame,
    /// Index coordinates of the local origin, and of one CRS unit in x and y.
    origin: [f64; 2],
    by_x: [f64; 2],
    by_y: [f64; 2],
    /// Half the side of a level-0 domain, CRS units.
    half: [f64; 2],
    /// Where core' can be, in cells, and the ring around it: lowest and highest index.
    reach: [[f64; 2]; 2],
}

/// A patch that may contribute.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Patch {
    pub id: PatchId,
    /// Index into the surface's surveys.
    pub survey: usize,
    pub place: Place,
    pub bot: f32,
    pub top: f32,
    pub floor: bool,
}

/// Where heights and cells come from.
pub trait Source: Sync {
    /// The vertices of the n-th patch of the surface.
    fn vertices(&self, patch: usize) -> Result<Arc<Vertices>>;
    /// Cells of core' around a level-0 block of the n-th survey.
    fn hood(&self, survey: usize, i: i32, j: i32) -> Result<Arc<Hood>>;
    /// The correction of the n-th survey over a level-0 block.
    fn seam(&self, survey: usize, i: i32, j: i32) -> Result<Arc<Field>>;
}

/// What the surface is at a point.
#[derive(Clone, Debug, PartialEq)]
pub struct Evaluation {
    pub z: f64,
    /// Height metres per CRS unit, by x and y (0 unless asked for).
    pub gradient: [f64; 2],
    /// Largest error of the contributing patches, metres.
    pub error_m: f64,
    /// Stated accuracy of the best survey there, metres.
    pub accuracy_m: f64,
    /// False in the rim outside every core: the height is given, its error is not promised.
    pub certified: bool,
    /// What the correction of seams added (section 15), metres; `z - correction_m` is the surface without it: bit for bit
    /// where the two are within a factor of two, else up to the last bit of the larger.
    pub correction_m: f64,
    /// The correction comes from surveys that contradict each other: it is invented ground.
    pub contradiction: bool,
}

/// A selected set of patches over a region, ready to be evaluated.
pub struct Surface {
    pub(super) origin: [f64; 2],
    pub surveys: Vec<SurveyField>,
    /// Ascending by id: the order of every sum.
    pub patches: Vec<Patch>,
    pub blend: Blend,
    /// Surveys are bent towards better ones along their borders.
    pub corrected: bool,
    index: Buckets,
}

/// Which patches may contain a point: a uniform grid of lists, about two squares a patch.
struct Buckets {
    min: [f64; 2],
    per_unit: [f64; 2],
    count: [usize; 2],
    /// Ends of the lists, row by row; the lists themselves, each ascending.
    ends: Vec<u32>,
    lists: Vec<u32>,
}

impl Buckets {
    /// `boxes`: xmin, ymin, xmax, ymax of each patch.
    fn new(boxes: &[[f64; 4]]) -> Buckets {
        let b = boxes
            .iter()
            .fold([f64::INFINITY, f64::INFINITY, f64::NEG_INFINITY, f64::NEG_INFINITY], |b, x| {
                [b[0].min(x[0]), b[1].min(x[1]), b[2].max(x[2]), b[3].max(x[3])]
            });
        if boxes.is_empty() {
            return Buckets {
                min: [0.0; 2],
                per_unit: [0.0; 2],
                count: [0; 2],
                ends: Vec::new(),
                lists: Vec::new(),
            };
        }
        let (w, h) = ((b[2] - b[0]).max(1e-12), (b[3] - b[1]).max(1e-12));
        let squares = (2 * boxes.len()).clamp(1, 1 << 20) as f64;
        let nx = ((squares * w / h).sqrt().ceil().clamp(1.0, squares)) as usize;
        let ny = ((squares / nx as f64).ceil().clamp(1.0, squares)) as usize;
        let mut grid = Buckets {
            min: [b[0], b[1]],
            per_unit: [nx as f64 / w, ny as f64 / h],
            count: [nx, ny],
            ends: vec![0; nx * ny],
            lists: Vec::new(),
        };
        let spans: Vec<([usize; 2], [usize; 2])> =
            boxes.iter().map(|x| (grid.square([x[0], x[1]]), grid.square([x[2], x[3]]))).collect();
        for (lo, hi) in &spans {
            for y in lo[1]..=hi[1] {
                for x in lo[0]..=hi[0] {
                    grid.ends[y * nx + x] += 1;
                }
            }
        }
        let mut total = 0;
        for e in &mut grid.ends {
            total += *e;
            *e = total - *e;
        }
        grid.lists = vec![0; total as usize];
        for (k, (lo, hi)) in spans.iter().enumerate() {
            for y in lo[1]..=hi[1] {
                for x in lo[0]..=hi[0] {
                    let at = &mut grid.ends[y * nx + x];
                    grid.lists[*at as usize] = k as u32;
                    *at += 1;
                }
            }
        }
        grid
    }

    fn square(&self, p: [f64; 2]) -> [usize; 2] {
        [0, 1].map(|k| {
            let t = (p[k] - self.min[k]) * self.per_unit[k];
            (t.max(0.0) as usize).min(self.count[k].saturating_sub(1))
        })
    }

    fn at(&self, p: [f64; 2]) -> &[u32] {
        if self.ends.is_empty() {
            return &[];
        }
        let s = self.square(p);
        let k = s[1] * self.count[0] + s[0];
        let from = if k == 0 { 0 } else { self.ends[k - 1] };
        &self.lists[from as usize..self.ends[k] as usize]
    }
}

/// Surface, tolerance and data together: what can be asked for heights.
pub struct Sheet<'a> {
    pub surface: &'a Surface,
    pub cut: &'a dyn Cut,
    pub source: &'a dyn Source,
}

impl SurveyField {
    /// `origin` in CRS units: local coordinates are taken from there, so that digits are kept.
    pub fn new(g: &Geometry, unit: LatticeUnit, origin: [f64; 2]) -> SurveyField {
        let (frame, steps, accuracy) = (&g.frame, g.steps, g.accuracy);
        let size = unit.size();
        let at = Point::new((origin[0] / size).round() as i64, (origin[1] / size).round() as i64);
        let (i, j) = frame.index(at);
        let d = frame.determinant() as f64 * size * size;
        let (u, v) = (frame.u, frame.v);
        let half = (KERNEL / 2 + MARGIN) as f64;
        SurveyField {
            accuracy,
            frame: *frame,
            origin: [i, j],
            by_x: [v.y as f64 * size / d, -(u.y as f64) * size / d],
            by_y: [-(v.x as f64) * size / d, u.x as f64 * size / d],
            half: [half * steps[0], half * steps[1]],
            reach: [[g.core.i0 - 2, g.core.j0 - 2], [g.core.i1 + 2, g.core.j1 + 2]]
                .map(|r| r.map(|v| v as f64)),
        }
    }

    /// Index coordinates of a point given relative to the local origin.
    #[inline]
    pub(super) fn index<T: Real>(&self, p: [f64; 2]) -> [T; 2] {
        [0, 1].map(|k| {
            let v = self.origin[k] + (self.by_x[k] * p[0] + self.by_y[k] * p[1]);
            T::with_gradient(v, self.by_x[k], self.by_y[k])
        })
    }
}

impl Surface {
    /// Patches must be those of the needed set of the region (any superset gives the same surface).
    pub fn new(
        origin: [f64; 2],
        unit: LatticeUnit,
        surveys: Vec<SurveyField>,
        mut patches: Vec<Patch>,
        blend: Blend,
    ) -> Surface {
        patches.sort_unstable_by_key(|p| p.id);
        let size = unit.size();
        let boxes: Vec<[f64; 4]> = patches
            .iter()
            .map(|p| {
                let b = surveys[p.survey].frame.quad(&p.place.domain()).bounds();
                let local = |x: i64, o: f64| x as f64 * size - o;
                // A box may be a hair too large, never too small.
                let pad = ((b.max.x - b.min.x) as f64 + (b.max.y - b.min.y) as f64) * size * 1e-6;
                [
                    local(b.min.x, origin[0]) - pad,
                    local(b.min.y, origin[1]) - pad,
                    local(b.max.x, origin[0]) + pad,
                    local(b.max.y, origin[1]) + pad,
                ]
            })
            .collect();
        let index = Buckets::new(&boxes);
        Surface { origin, surveys, patches, blend, corrected: false, index }
    }
}

/// One survey at one point: index coordinates and 1 - v.
#[derive(Clone, Copy)]
struct At<T> {
    index: [T; 2],
    outside: T,
}

/// Memory of one thread between points.
#[derive(Default)]
pub(super) struct Scratch {
    /// Per survey: the block met last.
    hoods: Vec<Option<MetHood>>,
    /// Vertices met lately, by patch number modulo their count.
    last: Vec<Option<(u32, Arc<Vertices>)>>,
    /// Weights and errors of the contributors at the point, and whether contradicting surveys bent them.
    shares: Vec<(f64, f64, bool)>,
    /// Per survey: the block of its correction met last.
    pub(super) seams: Vec<Option<MetField>>,
}

/// Indices of a level-0 block, and its cells.
type MetHood = ((i32, i32), Arc<Hood>);

/// An evaluation, and who contributed: patch number and weight.
pub type Explained = (Evaluation, Vec<(usize, f64)>);

/// Shares of the sum of weights below this are rounding: such a patch does not count as a contributor.
const SHARE_MIN: f64 = 1e-12;

/// Patches whose vertices a thread keeps at hand.
const LATELY: usize = 64;
/// Surveys whose state at a point needs no allocation.
pub(super) const FEW: usize = 8;

impl Sheet<'_> {
    /// Heights at points (CRS units), in order; `None` where there is no data.
    pub fn heights(&self, points: &[[f64; 2]]) -> Result<Vec<Option<Evaluation>>> {
        self.each(points, |s, p| self.evaluate::<f64>(p, s, None))
    }

    /// Heights with analytic gradients.
    pub fn slopes(&self, points: &[[f64; 2]]) -> Result<Vec<Option<Evaluation>>> {
        self.each(points, |s, p| self.evaluate::<Dual>(p, s, None))
    }

    /// A height and who contributed to it: patch number and normalised weight, largest first.
    pub fn explain(&self, p: [f64; 2]) -> Result<Option<Explained>> {
        let mut who = Vec::new();
        let Some(e) = self.evaluate::<f64>(p, &mut Scratch::default(), Some(&mut who))? else {
            return Ok(None);
        };
        let sum: f64 = who.iter().map(|(_, w)| w).sum();
        who.iter_mut().for_each(|(_, w)| *w /= sum);
        who.sort_by(|a, b| b.1.total_cmp(&a.1).then(a.0.cmp(&b.0)));
        Ok(Some((e, who)))
    }

    fn each(
        &self,
        points: &[[f64; 2]],
        mut f: impl FnMut(&mut Scratch, [f64; 2]) -> Result<Option<Evaluation>>,
    ) -> Result<Vec<Option<Evaluation>>> {
        let mut scratch = Scratch::default();
        points.iter().map(|p| f(&mut scratch, *p)).collect()
    }

    fn survey_at<T: Real>(&self, survey: usize, p: [f64; 2], s: &mut Scratch) -> Result<At<T>> {
        let f = &self.surface.surveys[survey];
        let index: [T; 2] = f.index(p);
        if [0, 1].iter().any(|k| index[*k].value() < f.reach[0][*k] || index[*k].value() > f.reach[1][*k]) {
            return Ok(At { index, outside: T::constant(1.0) });
        }
        let block = index.map(|c| (c.value() / KERNEL as f64).floor());
        let key = (block[0] as i32, block[1] as i32);
        if s.hoods.len() < self.surface.surveys.len() {
            s.hoods.resize(self.surface.surveys.len(), None);
        }
        let slot = &mut s.hoods[survey];
        let hood = match slot {
            Some((k, h)) if *k == key => h.clone(),
            _ => {
                let h = self.source.hood(survey, key.0, key.1)?;
                *slot = Some((key, h.clone()));
                h
            }
        };
        let x = index[0] - T::constant(block[0] * KERNEL as f64);
        let y = index[1] - T::constant(block[1] * KERNEL as f64);
        Ok(At { index, outside: outside(&hood, x, y) })
    }

    fn evaluate<T: Real>(
        &self,
        point: [f64; 2],
        s: &mut Scratch,
        mut who: Option<&mut Vec<(usize, f64)>>,
    ) -> Result<Option<Evaluation>> {
        let surface = self.surface;
        let p = [point[0] - surface.origin[0], point[1] - surface.origin[1]];
        let near = surface.index.at(p);
        let (mut few, mut many) = ([None; FEW], Vec::new());
        let at: &mut [Option<At<T>>] = if surface.surveys.len() <= FEW {
            &mut few
        } else {
            many.resize(surface.surveys.len(), None);
            &mut many
        };
        let tolerance = {
            let g = self.cut.gradient(point);
            T::with_gradient(self.cut.at(point), g[0], g[1])
        };
        let mut weights = T::constant(0.0);
        let mut sum = T::constant(0.0);
        let mut reference = None;
        let mut error = f64::NEG_INFINITY;
        let mut seams = Corrections::new(surface);
        s.shares.clear();
        let mut accuracy = f32::INFINITY;
        for &k in near {
            let patch = &surface.patches[k as usize];
            let survey = &surface.surveys[patch.survey];
            let here = match at[patch.survey] {
                Some(a) => a,
                None => *at[patch.survey].insert(self.survey_at(patch.survey, p, s)?),
            };
            let inside = T::constant(1.0) - here.outside;
            if inside.value() <= 0.0 {
                continue;
            }
            let domain = patch.place.domain();
            let r = f64::from(1u32 << patch.place.level);
            let cell = |k: usize, first: i64| (here.index[k] - T::constant(first as f64)).scale(1.0 / r);
            let (a, b) = (cell(0, domain.i0), cell(1, domain.j0));
            let half = (KERNEL / 2 + MARGIN) as f64;
            let hat = |c: T| {
                let t = c.scale(1.0 / half) - T::constant(1.0);
                if t.value() < 0.0 { T::constant(1.0) + t } else { T::constant(1.0) - t }
            };
            let (wa, wb) = (hat(a), hat(b));
            if wa.value() <= 0.0 || wb.value() <= 0.0 {
                continue;
            }
            let mut weight = (wa * wb).scale(1.0 / (survey.half[0] * r * (survey.half[1] * r)));
            if surface.blend == Blend::Exact {
                let level = self.level::<T>(patch, tolerance, p, s, at)?;
                if level.value() <= 0.0 {
                    continue;
                }
                weight = weight * inside * level;
            }
            if weight.value() <= 0.0 {
                continue;
            }
            s.last.resize(LATELY, None);
            let slot = &mut s.last[k as usize % LATELY];
            let z = match slot {
                Some((n, z)) if *n == k => z,
                _ => &slot.insert((k, self.source.vertices(k as usize)?)).1,
            };
            let (f, fa, fb) = evaluate(z, a.value(), b.value());
            let (ga, gb) = (a.gradient(), b.gradient());
            let f = T::with_gradient(f, fa * ga[0] + fb * gb[0], fa * ga[1] + fb * gb[1]);
            // Sums are taken relative to the first height: no digits are lost on high ground.
            let zero = *reference.get_or_insert(f.value());
            weights = weights + weight;
            sum = sum + weight * (f - T::constant(zero));
            let (mut bound, mut contradicted) = (f64::from(patch.bot), false);
            if surface.corrected {
                let c;
                (c, contradicted) = seams.of(self, patch.survey, here.index, tolerance, s)?;
                seams.sum = seams.sum + weight * c;
                bound = add_up(bound, c.value().abs());
            }
            s.shares.push((weight.value(), bound, contradicted));
            accuracy = accuracy.min(survey.accuracy);
            if let Some(w) = who.as_deref_mut() {
                w.push((k as usize, weight.value()));
            }
        }
        let Some(zero) = reference else { return Ok(None) };
        let f = sum / weights;
        // At the edge of its support a patch may weigh a rounding error, or nothing: that must not decide the answer.
        let mut contradiction = false;
        for (weight, bound, contradicted) in &s.shares {
            if *weight > SHARE_MIN * weights.value() {
                error = error.max(*bound);
                contradiction |= contradicted;
            }
        }
        let mut certified = false;
        let mut best = f32::INFINITY;
        for (k, survey) in surface.surveys.iter().enumerate() {
            let here = match at[k] {
                Some(a) => a,
                None => self.survey_at::<T>(k, p, s)?,
            };
            if here.outside.value() == 0.0 {
                certified = true;
                best = best.min(survey.accuracy);
            }
        }
        let (mut z, mut gradient, mut correction_m) = (zero + f.value(), f.gradient(), 0.0);
        if surface.corrected {
            let c = seams.sum / weights;
            let plain = z;
            z += c.value();
            correction_m = z - plain;
            gradient = [0, 1].map(|k| gradient[k] + c.gradient()[k]);
        }
        Ok(Some(Evaluation {
            z,
            gradient,
            error_m: error,
            accuracy_m: f64::from(if certified { best } else { accuracy }),
            certified,
            correction_m,
            contradiction,
        }))
    }

    /// up' dn: how much of a patch is there at a tolerance.
    fn level<T: Real>(
        &self,
        patch: &Patch,
        z: T,
        p: [f64; 2],
        s: &mut Scratch,
        at: &mut [Option<At<T>>],
    ) -> Result<T> {
        let one = T::constant(1.0);
        let (bot, top) = (f64::from(patch.bot), f64::from(patch.top));
        let down = if top.is_infinite() {
            one
        } else {
            one - (z - T::constant(top)).scale(1.0 / ((KAPPA - 1.0) * top)).ramp()
        };
        if down.value() <= 0.0 {
            return Ok(down);
        }
        let mut up = if bot == 0.0 || z.value().is_infinite() {
            one
        } else {
            (z - T::constant(bot)).scale(1.0 / ((KAPPA - 1.0) * bot)).ramp()
        };
        if patch.floor && up.value() < 1.0 {
            let mut mask = one;
            for (k, survey) in self.surface.surveys.iter().enumerate() {
                if survey.accuracy < patch.bot {
                    let here = match at[k] {
                        Some(a) => a,
                        None => *at[k].insert(self.survey_at(k, p, s)?),
                    };
                    mask = mask * here.outside;
                    if mask.value() <= 0.0 {
                        break;
                    }
                }
            }
            up = up + (one - up) * mask;
        }
        Ok(up * down)
    }
}
