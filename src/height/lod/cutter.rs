//! Tops and floors of patches: Algorithm 1 of the paper, read as section 2 of the LOD-space specification reads it.
//!
//! - above(P, z) is every stored patch greater than P with bot <= z, dormant ones too;
//! - top(P) is the least z at which their kernels cover kernel(P), +infinity if none;
//! - a patch emptied by precedence has top 0;
//! - top never reads another top, so tops can be computed in any order and in parallel.

use super::cover::{kernel, quads_near, rects};
use super::{Cells, Fact, Geometry, Place, Rank, Standing, SurveyNumber, World, places_meeting};
use crate::base::Result;
use crate::base::lattice::{Quad, all_covered, covered};
use crate::height::cells::Fill;
use crate::height::frame::CellRect;

/// A patch of another survey that is greater and may meet the kernel.
struct Candidate {
    bot: f32,
    survey: usize,
    place: Place,
}

/// Computes top and floor of one patch.
pub fn standing(world: &dyn World, survey: SurveyNumber, place: Place, fact: &Fact) -> Result<Standing> {
    let g = world.geometry(survey);
    let fill = world.fill(survey, Cells::CorePrime, place)?;
    if fill == Fill::Empty {
        return Ok(Standing { top: 0.0, floor: false });
    }
    let bounds = g.frame.bounds(&place.rect().intersect(&g.core));
    let others: Vec<SurveyNumber> = world.meeting(&bounds).into_iter().filter(|s| *s != survey).collect();
    let ancestors = least_ancestor(world, survey, g, place)?;
    if others.is_empty() {
        let live = ancestors > fact.bot;
        return Ok(Standing { top: ancestors, floor: live && fact.bot <= g.accuracy });
    }
    let pieces: Vec<Quad> = kernel(world, survey, place)?.iter().map(|r| g.frame.quad(r)).collect();
    let top = top(world, &others, g, place, fact, &pieces, ancestors)?;
    let live = top > fact.bot;
    let floor = live && fact.bot <= g.accuracy && !inside_better(world, &others, fact.bot, &pieces)?;
    Ok(Standing { top, floor })
}

/// The least error of the patches of the same survey that hold this one's kernel: pure index arithmetic.
fn least_ancestor(world: &dyn World, survey: SurveyNumber, g: &Geometry, place: Place) -> Result<f32> {
    let mut least = f32::INFINITY;
    let mut p = place;
    while p.level < g.level_max {
        p = p.parent();
        if let Some(f) = world.fact(survey, p)? {
            least = least.min(f.bot);
        }
    }
    Ok(least)
}

/// The least z at which greater patches cover the kernel. The surveys are asked from the best down, and what they have is
/// tried whenever there is twice as much of it: a cover found bounds the top, and neither patches nor surveys above a bound
/// can lower it. So a deep pile of surveys costs what lies below the top, not what lies at the place.
fn top(
    world: &dyn World,
    others: &[SurveyNumber],
    g: &Geometry,
    place: Place,
    fact: &Fact,
    pieces: &[Quad],
    ancestors: f32,
) -> Result<f32> {
    let rank = Rank { area: g.area(place.level), bot: fact.bot, id: fact.id };
    let mut bound = ancestors;
    let quad = g.frame.quad(&place.rect().intersect(&g.core));
    let mut best: Vec<&Geometry> = Vec::with_capacity(others.len());
    best.extend(others.iter().map(|h| world.geometry(*h)));
    let mut order: Vec<usize> = (0..others.len()).collect();
    order.sort_by(|a, b| best[*a].accuracy.total_cmp(&best[*b].accuracy));
    let mut cover = Cover { world, others, quad, pieces, candidates: Vec::new(), cores: Vec::new() };
    cover.cores.resize(others.len(), None);
    let mut enough = FIRST_TRY;
    for k in order {
        let (h, gh) = (others[k], best[k]);
        // No patch of a survey has a smaller error than the survey.
        if gh.accuracy >= bound {
            break;
        }
        if gh.area(gh.level_max).total_cmp(&rank.area).is_lt() || !gh.quad().overlaps(&quad) {
            continue;
        }
        let window = gh.frame.cells_meeting(&quad).intersect(&gh.core);
        for level in 0..=gh.level_max {
            if gh.area(level).total_cmp(&rank.area).is_lt() {
                continue;
            }
            let range = places_meeting(level, &window);
            for j in range.j0..range.j1 {
                for i in range.i0..range.i1 {
                    let q = Place::new(level, i, j);
                    let Some(f) = world.fact(h, q)? else { continue };
                    let greater = (Rank { area: gh.area(level), bot: f.bot, id: f.id }) > rank;
                    if f.bot >= bound || !greater {
                        continue;
                    }
                    match world.fill(h, Cells::CorePrime, q)? {
                        Fill::Empty => continue,
                        Fill::Full => {
                            let kernel = gh.frame.quad(&q.rect());
                            if pieces.iter().all(|p| kernel.contains(p)) {
                                bound = f.bot;
                                continue;
                            }
                        }
                        Fill::Mixed => {}
                    }
                    cover.candidates.push(Candidate { bot: f.bot, survey: k, place: q });
                }
            }
        }
        if cover.candidates.len() >= enough {
            bound = cover.least(bound)?;
            enough = 2 * cover.candidates.len().max(FIRST_TRY);
        }
    }
    cover.least(bound)
}

/// Candidates at which a cover is tried for the first time.
const FIRST_TRY: usize = 16;

/// What may cover a kernel.
struct Cover<'a> {
    world: &'a dyn World,
    others: &'a [SurveyNumber],
    /// The rectangle of the patch.
    quad: Quad,
    /// The kernel.
    pieces: &'a [Quad],
    candidates: Vec<Candidate>,
    /// core' of each of the others near the patch, once it is asked for.
    cores: Vec<Option<Vec<CellRect>>>,
}

impl Cover<'_> {
    /// The least step below `bound` at which the candidates cover the kernel, or `bound`. Lets go of those not below it.
    fn least(&mut self, bound: f32) -> Result<f32> {
        self.candidates.retain(|c| c.bot < bound);
        self.candidates.sort_by(|a, b| a.bot.total_cmp(&b.bot));
        if !self.reaches_corners() {
            return Ok(bound);
        }
        // Steps as ends of the candidates that count there.
        let mut ends: Vec<usize> = self.candidates.chunk_by(|a, b| a.bot == b.bot).map(<[_]>::len).collect();
        let mut end = 0;
        ends.iter_mut().for_each(|n| {
            end += *n;
            *n = end;
        });
        // Coverage is monotone: ever more from the best on until they cover, then the least step that does.
        let (mut lo, mut hi, mut reach) = (0, ends.len(), 8);
        while lo < ends.len() {
            let k = ends.partition_point(|n| *n < reach).min(ends.len() - 1);
            if self.covers(ends[k])? {
                hi = k;
                break;
            }
            lo = k + 1;
            reach = 2 * ends[k];
        }
        if lo == ends.len() {
            return Ok(bound);
        }
        while lo < hi {
            let mid = (lo + hi) / 2;
            if self.covers(ends[mid])? {
                hi = mid;
            } else {
                lo = mid + 1;
            }
        }
        let least = self.candidates[ends[lo] - 1].bot;
        self.candidates.truncate(ends[lo]);
        self.candidates.retain(|c| c.bot < least);
        Ok(least)
    }

    /// Whether every corner of the kernel lies in the rectangle of some candidate: without that, nothing covers it, and that is
    /// how most kernels at the rim of a pile are told.
    fn reaches_corners(&self) -> bool {
        let rect = |c: &Candidate| {
            let g = self.world.geometry(self.others[c.survey]);
            g.frame.quad(&c.place.rect().intersect(&g.core))
        };
        let rects: Vec<Quad> = self.candidates.iter().map(rect).collect();
        self.pieces.iter().flat_map(|p| p.0).all(|corner| rects.iter().any(|r| r.contains_point(corner)))
    }

    /// Whether the first so many candidates cover the kernel. Per survey their union is core' inside the union of their
    /// rectangles, and rectangles of one survey nest or are disjoint, so only the greatest of them count.
    fn covers(&mut self, count: usize) -> Result<bool> {
        let mut chosen: Vec<(usize, Place)> =
            self.candidates[..count].iter().map(|c| (c.survey, c.place)).collect();
        // The greater ones of a survey first.
        chosen.sort_unstable_by_key(|(k, p)| (*k, std::cmp::Reverse(p.level)));
        let mut quads = Vec::new();
        let (mut outer, mut parts): (Vec<CellRect>, Vec<CellRect>) = (Vec::new(), Vec::new());
        for of_one in chosen.chunk_by(|a, b| a.0 == b.0) {
            let k = of_one[0].0;
            let frame = &self.world.geometry(self.others[k]).frame;
            if self.cores[k].is_none() {
                let window = frame.cells_meeting(&self.quad);
                self.cores[k] = Some(rects(self.world, self.others[k], Cells::CorePrime, &window)?);
            }
            outer.clear();
            for (_, place) in of_one {
                let r = place.rect();
                if !outer.iter().any(|o| o.contains(&r)) {
                    outer.push(r);
                }
            }
            parts.clear();
            let core = self.cores[k].iter().flatten();
            parts.extend(core.flat_map(|c| outer.iter().map(|o| c.intersect(o))).filter(|r| !r.is_empty()));
            crate::height::cells::merge(&mut parts);
            quads.extend(parts.iter().map(|r| frame.quad(r)));
        }
        Ok(all_covered(self.pieces, &quads))
    }
}

/// Whether the kernel lies inside the union of core' of the surveys that are better than `bot`. Asks ever more of them, and ends
/// as soon as they cover.
fn inside_better(world: &dyn World, others: &[SurveyNumber], bot: f32, pieces: &[Quad]) -> Result<bool> {
    let better: Vec<SurveyNumber> =
        others.iter().copied().filter(|h| world.geometry(*h).accuracy < bot).collect();
    if better.is_empty() {
        return Ok(false);
    }
    for piece in pieces {
        let (mut cover, mut tried) = (Vec::new(), 0);
        for (k, &h) in better.iter().enumerate() {
            cover.extend(quads_near(world, h, Cells::CorePrime, piece)?);
            let last = k + 1 == better.len();
            if last || cover.len() >= 2 * tried.max(4) {
                tried = cover.len();
                if covered(piece, &cover) {
                    break;
                }
                if last {
                    return Ok(false);
                }
            }
        }
    }
    Ok(true)
}
