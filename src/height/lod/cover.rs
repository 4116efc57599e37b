//! Kernels and cores as rectangles of cells, and what precedence leaves of a core (section 12).

use super::{Cells, KERNEL, Place, SurveyNumber, World, places_meeting};
use crate::base::Result;
use crate::base::lattice::{Quad, covered};
use crate::height::cells::{Block, Fill, merge};
use crate::height::frame::CellRect;

/// The cells of a survey's set inside a window, as disjoint rectangles. Cost follows the pieces, not the area.
pub fn rects(
    world: &dyn World,
    survey: SurveyNumber,
    cells: Cells,
    window: &CellRect,
) -> Result<Vec<CellRect>> {
    let g = world.geometry(survey);
    let window = window.intersect(&g.core);
    let mut out = Vec::new();
    if window.is_empty() {
        return Ok(out);
    }
    let span = window.width().max(window.height());
    let level = (0..=g.level_max).find(|l| KERNEL << l >= span).unwrap_or(g.level_max);
    let range = places_meeting(level, &window);
    for j in range.j0..range.j1 {
        for i in range.i0..range.i1 {
            descend(world, survey, cells, Place::new(level, i, j), &window, &mut out)?;
        }
    }
    merge(&mut out);
    Ok(out)
}

fn descend(
    world: &dyn World,
    survey: SurveyNumber,
    cells: Cells,
    place: Place,
    window: &CellRect,
    out: &mut Vec<CellRect>,
) -> Result<()> {
    let rect = place.rect().intersect(window);
    if rect.is_empty() {
        return Ok(());
    }
    match world.fill(survey, cells, place)? {
        Fill::Empty => {}
        Fill::Full => out.push(rect),
        Fill::Mixed if place.level == 0 => {
            world.block(survey, cells, place.i, place.j)?.rects(place.i, place.j, window, out);
        }
        Fill::Mixed => {
            for child in place.children() {
                descend(world, survey, cells, child, window, out)?;
            }
        }
    }
    Ok(())
}

/// The kernel of a patch: its rectangle without what is not in core'.
pub fn kernel(world: &dyn World, survey: SurveyNumber, place: Place) -> Result<Vec<CellRect>> {
    rects(world, survey, Cells::CorePrime, &place.rect())
}

/// Quads of the cells of `survey` that may meet `near` (a quad in lattice units).
pub fn quads_near(world: &dyn World, survey: SurveyNumber, cells: Cells, near: &Quad) -> Result<Vec<Quad>> {
    let frame = &world.geometry(survey).frame;
    Ok(rects(world, survey, cells, &frame.cells_meeting(near))?.iter().map(|r| frame.quad(r)).collect())
}

/// core' of one level-0 block: its core without the cells that lie inside the union of the cores of the
/// surveys of higher precedence. Exact.
pub fn core_prime(world: &dyn World, survey: SurveyNumber, i: i32, j: i32) -> Result<Block> {
    let place = Place { level: 0, i, j };
    let mut block = world.block(survey, Cells::Core, i, j)?;
    if block == Block::EMPTY {
        return Ok(block);
    }
    let g = world.geometry(survey);
    let quad = g.frame.quad(&place.rect());
    let above: Vec<SurveyNumber> = world
        .meeting(&quad.bounds())
        .into_iter()
        .filter(|h| world.geometry(*h).precedence > g.precedence)
        .collect();
    let mut cover: Vec<Quad> = Vec::new();
    for h in above {
        cover.extend(quads_near(world, h, Cells::Core, &quad)?);
    }
    cover.retain(|c| c.overlaps(&quad));
    if cover.is_empty() {
        return Ok(block);
    }
    if cover.iter().any(|c| c.contains(&quad)) {
        return Ok(Block::EMPTY);
    }
    let boxes: Vec<_> = cover.iter().map(Quad::bounds).collect();
    let mut near = Vec::new();
    for b in 0..KERNEL as usize {
        for a in 0..KERNEL as usize {
            if !block.get(a, b) {
                continue;
            }
            let (ci, cj) = (place.rect().i0 + a as i64, place.rect().j0 + b as i64);
            let cell = g.frame.quad(&CellRect::new(ci, cj, ci + 1, cj + 1));
            let cb = cell.bounds();
            near.clear();
            near.extend(cover.iter().zip(&boxes).filter(|(_, x)| x.overlaps(&cb)).map(|(c, _)| *c));
            if covered(&cell, &near) {
                block.clear(a, b);
            }
        }
    }
    Ok(block)
}
