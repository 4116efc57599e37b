//! Evaluating the surface: which patches reach a point, their weights, their blend.

use super::bent::{Corrections, MetField};
use super::buckets::Buckets;
use super::seam::Field;
use super::{Dual, Hood, Jet, KAPPA, Real, SurveyField, outside};
use crate::base::round::add_up;
use crate::base::{Error, Result};
use crate::height::frame::LatticeUnit;
use crate::height::lod::cut::Cut;
use crate::height::lod::{KERNEL, MARGIN, PatchId, Place};
use crate::height::patch::{Kind, Shape};
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

impl Patch {
    /// dn: how much of it is still there at a tolerance, before coarser ones take over.
    #[inline]
    pub(super) fn down<T: Real>(&self, kind: Kind, z: T) -> T {
        let (one, top) = (T::constant(1.0), f64::from(self.top));
        if top.is_infinite() {
            return one;
        }
        one - (z - T::constant(top)).scale(1.0 / ((KAPPA - 1.0) * top)).ramp(kind)
    }

    /// up': a floor patch stays in as far as no better survey is there (`mask`).
    #[inline]
    pub(super) fn masked(&self, up: f64, mask: f64) -> f64 {
        if self.floor && up < 1.0 { up + (1.0 - up) * mask } else { up }
    }

    /// up: how much of it is there already, its error being allowed.
    #[inline]
    pub(super) fn up<T: Real>(&self, kind: Kind, z: T) -> T {
        let bot = f64::from(self.bot);
        if bot == 0.0 || z.value().is_infinite() {
            return T::constant(1.0);
        }
        (z - T::constant(bot)).scale(1.0 / ((KAPPA - 1.0) * bot)).ramp(kind)
    }
}

/// Where heights and cells come from.
pub trait Source: Sync {
    /// The n-th patch of the surface, ready to be evaluated.
    fn shape(&self, patch: usize) -> Result<Shape>;
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

/// Second derivatives of the height by xx, xy and yy, metres per squared CRS unit.
pub type Hessian = [f64; 3];

/// A selected set of patches over a region, ready to be evaluated.
pub struct Surface {
    /// What lies between vertices; weights and fades are as smooth.
    pub kind: Kind,
    /// The lists of patches near a point are found from there.
    pub(super) origin: [f64; 2],
    pub surveys: Vec<SurveyField>,
    /// Ascending by id: the order of every sum.
    pub patches: Vec<Patch>,
    pub blend: Blend,
    /// Surveys are bent towards better ones along their borders.
    pub corrected: bool,
    pub(super) index: Buckets,
}

/// Surface, tolerance and data together: what can be asked for heights.
pub struct Sheet<'a> {
    pub surface: &'a Surface,
    pub cut: &'a dyn Cut,
    pub source: &'a dyn Source,
}

impl Surface {
    /// Patches must be those of the needed set of the region (any superset gives the same surface).
    pub fn new(
        kind: Kind,
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
        Surface { kind, origin, surveys, patches, blend, corrected: false, index }
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
    /// Blocks met lately, by survey and indices modulo their count.
    hoods: Vec<Option<MetHood>>,
    /// Patches met lately, by number modulo their count.
    last: Vec<Option<(u32, Shape)>>,
    /// Weights and errors of the contributors at the point, and whether contradicting surveys bent them.
    shares: Vec<(f64, f64, bool)>,
    /// Per survey: the block of its correction met last.
    pub(super) seams: Vec<Option<MetField>>,
}

/// Survey and indices of a level-0 block, and its cells.
type MetHood = ((usize, i32, i32), Arc<Hood>);

/// An evaluation, and who contributed: patch number and weight.
pub type Explained = (Evaluation, Vec<(usize, f64)>);

/// Shares of the sum of weights below this are rounding: such a patch does not count as a contributor.
pub(super) const SHARE_MIN: f64 = 1e-12;

/// Patches, and blocks of cells, that a thread keeps at hand.
const LATELY: usize = 256;
/// Surveys whose state at a point needs no allocation.
pub(super) const FEW: usize = 8;

impl Sheet<'_> {
    /// Heights at points (CRS units), in order; `None` where there is no data.
    pub fn heights(&self, points: &[[f64; 2]]) -> Result<Vec<Option<Evaluation>>> {
        self.each(points, |s, p| Ok(self.evaluate::<f64>(p, s, None)?.map(|(e, _)| e)))
    }

    /// Heights with analytic gradients.
    pub fn slopes(&self, points: &[[f64; 2]]) -> Result<Vec<Option<Evaluation>>> {
        self.each(points, |s, p| Ok(self.evaluate::<Dual>(p, s, None)?.map(|(e, _)| e)))
    }

    /// Heights with analytic gradients and second derivatives. Refused where patches are bilinear: their surface has
    /// kinks, and between them no bend of the ground.
    pub fn curvatures(&self, points: &[[f64; 2]]) -> Result<Vec<Option<(Evaluation, Hessian)>>> {
        if self.surface.kind == Kind::Bilinear {
            return Err(Error::unsupported(
                "curvature",
                "the patches of this database are bilinear: their surface has kinks instead of curvature",
                "make a database with `terraquilt init DB --patch bicubic` and ingest the surveys there",
            ));
        }
        self.each(points, |s, p| self.evaluate::<Jet>(p, s, None))
    }

    /// A height and who contributed to it: patch number and normalised weight, largest first.
    pub fn explain(&self, p: [f64; 2]) -> Result<Option<Explained>> {
        let mut who = Vec::new();
        let Some((e, _)) = self.evaluate::<f64>(p, &mut Scratch::default(), Some(&mut who))? else {
            return Ok(None);
        };
        let sum: f64 = who.iter().map(|(_, w)| w).sum();
        who.iter_mut().for_each(|(_, w)| *w /= sum);
        who.sort_by(|a, b| b.1.total_cmp(&a.1).then(a.0.cmp(&b.0)));
        Ok(Some((e, who)))
    }

    fn each<E>(
        &self,
        points: &[[f64; 2]],
        mut f: impl FnMut(&mut Scratch, [f64; 2]) -> Result<Option<E>>,
    ) -> Result<Vec<Option<E>>> {
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
        let hood = self.hood(survey, block[0] as i32, block[1] as i32, s)?;
        let x = index[0] - T::constant(block[0] * KERNEL as f64);
        let y = index[1] - T::constant(block[1] * KERNEL as f64);
        Ok(At { index, outside: outside(hood, self.surface.kind, x, y) })
    }

    /// The cells around a level-0 block of a survey.
    pub(super) fn hood<'s>(&self, survey: usize, i: i32, j: i32, s: &'s mut Scratch) -> Result<&'s Hood> {
        let key = (survey, i, j);
        s.hoods.resize(LATELY, None);
        let at = i.wrapping_add(j.wrapping_mul(8)).wrapping_add(survey as i32 * 29) as u32 as usize;
        let slot = &mut s.hoods[at % LATELY];
        if slot.as_ref().is_none_or(|(k, _)| *k != key) {
            *slot = Some((key, self.source.hood(survey, i, j)?));
        }
        Ok(&slot.as_ref().expect("it was there or has just been put there").1)
    }

    /// A patch, ready to be evaluated.
    pub(super) fn shape<'s>(&self, patch: u32, s: &'s mut Scratch) -> Result<&'s Shape> {
        s.last.resize(LATELY, None);
        let slot = &mut s.last[patch as usize % LATELY];
        if slot.as_ref().is_none_or(|(n, _)| *n != patch) {
            *slot = Some((patch, self.source.shape(patch as usize)?));
        }
        Ok(&slot.as_ref().expect("it was there or has just been put there").1)
    }

    fn tolerance<T: Real>(&self, p: [f64; 2]) -> T {
        let z = self.cut.at(p);
        match T::ORDER {
            0 => T::constant(z),
            1 => T::with_hessian(z, self.cut.gradient(p), [0.0; 3]),
            _ => T::with_hessian(z, self.cut.gradient(p), self.cut.hessian(p)),
        }
    }

    /// What the surface is at a point, and its second derivatives (0 where `T` does not carry them).
    pub(super) fn evaluate<T: Real>(
        &self,
        p: [f64; 2],
        s: &mut Scratch,
        mut who: Option<&mut Vec<(usize, f64)>>,
    ) -> Result<Option<(Evaluation, Hessian)>> {
        let surface = self.surface;
        let near = surface.index.at([p[0] - surface.origin[0], p[1] - surface.origin[1]]);
        let (mut few, mut many) = ([None; FEW], Vec::new());
        let at: &mut [Option<At<T>>] = if surface.surveys.len() <= FEW {
            &mut few
        } else {
            many.resize(surface.surveys.len(), None);
            &mut many
        };
        let tolerance = self.tolerance::<T>(p);
        let volume = surface.kind.volume();
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
            let bump = |c: T| {
                let t = c.scale(1.0 / half) - T::constant(1.0);
                let inwards = if t.value() < 0.0 { T::constant(1.0) + t } else { T::constant(1.0) - t };
                inwards.bump(surface.kind)
            };
            let (wa, wb) = (bump(a), bump(b));
            if wa.value() <= 0.0 || wb.value() <= 0.0 {
                continue;
            }
            let mut weight = (wa * wb).scale(volume / (survey.half[0] * r * (survey.half[1] * r)));
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
            let f = T::of_patch(self.shape(k, s)?.at(a.value(), b.value()), a, b);
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
        let (mut z, mut correction_m) = (zero + f.value(), 0.0);
        let (mut gradient, mut hessian) = (f.gradient(), f.hessian());
        if surface.corrected {
            let c = seams.sum / weights;
            let plain = z;
            z += c.value();
            correction_m = z - plain;
            gradient = [0, 1].map(|k| gradient[k] + c.gradient()[k]);
            hessian = [0, 1, 2].map(|k| hessian[k] + c.hessian()[k]);
        }
        let evaluation = Evaluation {
            z,
            gradient,
            error_m: error,
            accuracy_m: f64::from(if certified { best } else { accuracy }),
            certified,
            correction_m,
            contradiction,
        };
        Ok(Some((evaluation, hessian)))
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
        let down = patch.down(self.surface.kind, z);
        if down.value() <= 0.0 {
            return Ok(down);
        }
        let mut up = patch.up(self.surface.kind, z);
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
