//! Tops and floors of patches: Algorithm 1 of the paper, read as section 2 of the LOD-space specification reads it.
//!
//! - above(P, z) is every stored patch greater than P with bot <= z, dormant ones too;
//! - top(P) is the least z at which their kernels cover kernel(P), +infinity if none;
//! - a patch emptied by precedence has top 0;
//! - top never reads another top, so tops can be computed in any order and in parallel.

use super::cover::{kernel, quads_near, rects};
use super::{Cells, Fact, Geometry, Place, Rank, Standing, SurveyNumber, World, places_meeting};
use crate::base::Result;
use crate::base::lattice::{Quad, all_covered};
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
    let mut candidates = Vec::new();
    for (k, &h) in others.iter().enumerate() {
        let gh = world.geometry(h);
        // No patch of a survey has a smaller error than the survey.
        if gh.accuracy >= bound
            || gh.area(gh.level_max).total_cmp(&rank.area).is_lt()
            || !gh.quad().overlaps(&quad)
        {
            continue;
        }
        let window = gh.frame.cells_meeting(&quad);
        for level in 0..=gh.level_max {
            if gh.area(level).total_cmp(&rank.area).is_lt() {
                continue;
            }
            let range = places_meeting(level, &window.intersect(&gh.core));
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
                    candidates.push(Candidate { bot: f.bot, survey: k, place: q });
                }
            }
        }
    }
    candidates.retain(|c| c.bot < bound);
    if candidates.is_empty() {
        return Ok(bound);
    }
    // core' of the surveys that are left.
    let mut cores: Vec<Vec<CellRect>> = vec![Vec::new(); others.len()];
    for of_one in candidates.chunk_by(|a, b| a.survey == b.survey) {
        let k = of_one[0].survey;
        let window = world.geometry(others[k]).frame.cells_meeting(&quad);
        cores[k] = rects(world, others[k], Cells::CorePrime, &window)?;
    }
    candidates.sort_by(|a, b| a.bot.total_cmp(&b.bot));
    let mut steps: Vec<f32> = candidates.iter().map(|c| c.bot).collect();
    steps.dedup();
    let covered_at = |z: f32| -> bool {
        let n = candidates.partition_point(|c| c.bot <= z);
        all_covered(pieces, &cover_of(world, others, &candidates[..n], &cores))
    };
    if !covered_at(*steps.last().expect("there is a candidate")) {
        return Ok(bound);
    }
    // Coverage is monotone in z: find the least step that covers.
    let (mut lo, mut hi) = (0, steps.len() - 1);
    while lo < hi {
        let mid = (lo + hi) / 2;
        if covered_at(steps[mid]) {
            hi = mid;
        } else {
            lo = mid + 1;
        }
    }
    Ok(steps[lo])
}

/// Quads of the union of the candidates' kernels. Per survey it is core' inside the union of their rectangles, and
/// rectangles of one survey nest or are disjoint, so only the greatest of them count.
fn cover_of(
    world: &dyn World,
    others: &[SurveyNumber],
    candidates: &[Candidate],
    cores: &[Vec<CellRect>],
) -> Vec<Quad> {
    let mut out = Vec::new();
    for (k, &h) in others.iter().enumerate() {
        let mut outer: Vec<CellRect> = Vec::new();
        for c in candidates.iter().filter(|c| c.survey == k) {
            let r = c.place.rect();
            if outer.iter().any(|o| o.contains(&r)) {
                continue;
            }
            outer.retain(|o| !r.contains(o));
            outer.push(r);
        }
        if outer.is_empty() {
            continue;
        }
        let frame = &world.geometry(h).frame;
        let mut parts: Vec<CellRect> = cores[k]
            .iter()
            .flat_map(|c| outer.iter().map(|o| c.intersect(o)))
            .filter(|r| !r.is_empty())
            .collect();
        crate::height::cells::merge(&mut parts);
        out.extend(parts.iter().map(|r| frame.quad(r)));
    }
    out
}

/// Whether the kernel lies inside the union of core' of the surveys that are better than `bot`.
fn inside_better(world: &dyn World, others: &[SurveyNumber], bot: f32, pieces: &[Quad]) -> Result<bool> {
    let better: Vec<SurveyNumber> =
        others.iter().copied().filter(|h| world.geometry(*h).accuracy < bot).collect();
    if better.is_empty() {
        return Ok(false);
    }
    for piece in pieces {
        let mut cover = Vec::new();
        for &h in &better {
            cover.extend(quads_near(world, h, Cells::CorePrime, piece)?);
        }
        if !crate::base::lattice::covered(piece, &cover) {
            return Ok(false);
        }
    }
    Ok(true)
}
