//! Each range meets the domains round it.

use super::frame::Frame;
use super::screen::Answer;
use super::sought::{Range, Sought};
use super::strip::Strip;
use super::{BATCH, collect};
use crate::Result;
use crate::fractal::grid::points;
use crate::work::{self, Workers};

/// Numbers of domains that are laid out at once by one part of the work: 4 MiB. In tests small grids shall fall into parts as well.
const NUMBERS: usize = if cfg!(test) { 5000 } else { 1 << 20 };

/// Sides of ranges along a side of the cell whose ranges share what is laid out, and the least cell, in samples.
const CELL: (usize, usize) = (4, 32);

/// Fills in the best matches among the `width` x `width` domains round each range.
pub fn search<const D: usize>(
    frame: &Frame<D>,
    width: usize,
    sought: &mut [Sought<D>],
    workers: &dyn Workers,
) -> Result<()> {
    let cell = (CELL.0 * frame.level.domains.side).max(CELL.1);
    sought.sort_by_key(|s| (s.range.map(|v| v / cell), s.index));
    let groups: Vec<&[Sought<D>]> =
        sought.chunk_by(|a, b| a.range.map(|v| v / cell) == b.range.map(|v| v / cell)).collect();
    // What a range costs, and about as much again its share of the domains.
    let met = frame.level.domains.count.iter().map(|n| width.min(*n)).fold(1, usize::saturating_mul);
    let each = met.saturating_mul(2 * frame.poses.poses.len() * frame.poses.rows);
    let mut out = Vec::with_capacity(sought.len());
    let mut next = 0;
    while next < groups.len() {
        work::check(workers, next as f64 / groups.len() as f64)?;
        let mut cost = 0_usize;
        let many = groups[next..].iter().take_while(|g| {
            let fits = cost < BATCH;
            cost = cost.saturating_add(each.saturating_mul(g.len()));
            fits
        });
        let batch = &groups[next..next + many.count()];
        out.extend(collect(workers, batch.len(), &|k| group(frame, width, batch[k])).flatten());
        next += batch.len();
    }
    sought.clone_from_slice(&out);
    Ok(())
}

/// The ranges of one cell.
fn group<const D: usize>(frame: &Frame<D>, width: usize, sought: &[Sought<D>]) -> Vec<Sought<D>> {
    let domains = &frame.level.domains;
    let mut sought = sought.to_vec();
    let boxes: Vec<([usize; D], [usize; D])> =
        sought.iter().map(|s| domains.near(s.range, width)).map(|(a, n)| (a, sum(a, n))).collect();
    let ranges: Vec<Option<Range>> = sought.iter().map(|s| s.screened.then(|| frame.range(s))).collect();
    let chosen: Vec<usize> = (0..frame.poses.poses.len()).collect();
    let first: [usize; D] = std::array::from_fn(|a| boxes.iter().map(|b| b.0[a]).min().unwrap_or(0));
    let end: [usize; D] = std::array::from_fn(|a| boxes.iter().map(|b| b.1[a]).max().unwrap_or(0));
    let count: [usize; D] = std::array::from_fn(|a| end[a] - first[a]);
    let mut rows = count;
    rows[0] = 1;
    let rows: Vec<[usize; D]> = points(rows).map(|p| sum(first, p)).collect();
    let mut answer = Answer::default();
    for some in rows.chunks((NUMBERS / (count[0] * frame.poses.rows).max(1)).max(1)) {
        // A window that begins in the last lanes ends beyond the domains.
        let strip = |row: &[usize; D]| {
            let number = frame.number(*row);
            Strip::new(frame, (number..number + count[0]).collect(), super::strip::LANES)
        };
        let strips: Vec<Strip> = some.iter().map(strip).collect();
        for ((sought, (from, to)), range) in sought.iter_mut().zip(&boxes).zip(&ranges) {
            let Some(range) = range else { continue };
            for (row, strip) in some.iter().zip(&strips) {
                if (1..D).all(|a| (from[a]..to[a]).contains(&row[a])) {
                    let lanes = from[0] - first[0]..to[0] - first[0];
                    sought.meet(frame, range, &chosen, strip, lanes, &mut answer);
                }
            }
        }
    }
    sought
}

fn sum<const D: usize>(a: [usize; D], b: [usize; D]) -> [usize; D] {
    std::array::from_fn(|k| a[k] + b[k])
}
