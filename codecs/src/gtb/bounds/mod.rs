//! How wrong each prefix of the first layer is at the posts of the grid, measured where it is made.
//!
//! A prefix that ends in pass k has all posts of the passes before, a part of pass k in raster order, and of the later ones none but
//! those that were given. A post of pass k is then its decoded height or the midpoint of its hypotenuse, whose ends are of
//! earlier passes and therefore the same in all these prefixes: it lies in the interval of the two. Every later post is
//! the mean of two earlier ones, and a mean is monotone in both: carried down by the midpoint rule, the low ends and the high
//! ends enclose all these prefixes at every post. The greatest distance of a height from the ends of its interval is the
//! bound. So it is for posts that are left out (they are midpoints in every prefix), for voids (their prediction counts as decoded height,
//! as in the receiver) and for posts that were given (their interval is one height, from the beginning). Only posts with data
//! are compared. Of the first [`SHOWN_WHOLE`] passes a prefix shows whole ones alone: there all posts of pass k are midpoints.
//!
//! The quick way: near the end (steps up to [`FINE`]), the interval of each post, in fixed point, row by row. Before that, the intervals are
//! taken at every [`FINE`]-th post; the surface S of all posts of that step differs from a prefix P by what it differs at
//! those posts and by means of that, and z - S within each cell is measured once: z - P is at most the greatest z - S of the
//! cell and the greatest S - P of its four corners, or 0 where posts within were given. Only cells that could be worse than the worst so far are
//! evaluated post by post. The result is that of the definition, but for the rounding of [`hull`].

mod hull;
mod plain;

use super::field::{Field, SHOWN_WHOLE, Status};
use super::header::Header;
use crate::lattice::{Kind, Pass};
use hull::{Between, FRACTION, Ground, Hull};
use multiversion::multiversion;

/// Distance of the corners of a cell that is looked at as a whole: two halvings.
const FINE: usize = 4;
/// Greatest magnitude in units that fixed point takes: four of them, in 16ths, are added in [`corners`].
const MAGNITUDE_MAX: u32 = (1 << 25) - 1;

/// Of each pass, and of the whole first layer: the greatest error in units, rounded up. `z`: the heights on the lattice.
///
/// Memory: 4 bytes a post (12 where posts are left out), and 2.
pub(super) fn measure(header: &Header, z: &[i32], field: &Field) -> Vec<u32> {
    let passes = 2 * header.lattice.n();
    if field.z.iter().chain(z).any(|v| v.unsigned_abs() > MAGNITUDE_MAX) {
        return (0..=passes).map(|k| plain::hull(header, z, field, k).ceil() as u32).collect();
    }
    let side = header.lattice.side();
    let low: Vec<i32> = field.z.iter().map(|v| v << FRACTION).collect();
    let ends = (!field.selected.is_empty()).then(|| left_out(header, field, &low));
    let (low, high) = ends.as_ref().map_or((&low, &low), |(low, high)| (low, high));
    let given = if header.given.is_some() { &field.status[..] } else { &[] };
    let all = All { header, z, status: &field.status, ground: Ground { side, low, high, status: given } };
    let cells = (header.lattice.last() > FINE).then(|| Cells::new(&all));
    let mut out: Vec<u32> = header
        .lattice
        .passes()
        .enumerate()
        .map(|(number, pass)| {
            let between = match (pass.kind, number < SHOWN_WHOLE as usize) {
                (Kind::Centres, true) => Between::Nothing,
                (Kind::Centres, false) => Between::SomeCentres,
                (Kind::Edges, true) => Between::Centres,
                (Kind::Edges, false) => Between::SomeEdges,
            };
            let hull = Hull::known(&all.ground, 2 * pass.step);
            match &cells {
                Some(cells) if pass.step > FINE => {
                    let mut hull = hull.halved(&all.ground, between);
                    while hull.step > FINE {
                        hull = hull.halved(&all.ground, Between::Nothing);
                    }
                    cells.worst(&all, &hull)
                }
                _ => all.worst(hull, between),
            }
        })
        .collect();
    let rows = low.chunks_exact(side).zip(high.chunks_exact(side)).take(header.rows).enumerate();
    out.push(rows.map(|(y, (low, high))| all.row(y, low, high)).max().unwrap_or(0));
    out.into_iter().map(|v| v.div_ceil(1 << FRACTION)).collect()
}

/// The greatest error of all heights as they are, in units.
pub(super) fn greatest(header: &Header, z: &[i32], field: &Field) -> u32 {
    let side = header.lattice.side();
    (0..header.rows)
        .flat_map(|y| y * side..y * side + header.cols)
        .filter(|at| field.status(*at) != Status::Free)
        .map(|at| z[at].abs_diff(field.z[at]))
        .max()
        .unwrap_or(0)
}

/// The ends of posts that are left out: of the midpoint of their hypotenuse.
fn left_out(header: &Header, field: &Field, decoded: &[i32]) -> (Vec<i32>, Vec<i32>) {
    let (lattice, side) = (header.lattice, header.lattice.side());
    let (mut low, mut high) = (decoded.to_vec(), decoded.to_vec());
    for pass in lattice.passes() {
        for post in pass.posts(lattice) {
            let at = post[0] * side + post[1];
            if !field.selected[at] && field.status(at) != Status::Given {
                let ([a, b], _) = pass.parents(lattice, post);
                let (a, b) = (a[0] * side + a[1], b[0] * side + b[1]);
                low[at] = (low[a] + low[b]) >> 1;
                high[at] = (high[a] + high[b] + 1) >> 1;
            }
        }
    }
    (low, high)
}

/// Heights, what they were decoded to, and which count.
struct All<'a> {
    header: &'a Header,
    z: &'a [i32],
    status: &'a [Status],
    ground: Ground<'a>,
}

impl All<'_> {
    /// The greatest distance in a row from its ends, in fixed point.
    fn row(&self, y: usize, low: &[i32], high: &[i32]) -> u32 {
        let cols = self.header.cols;
        let z = &self.z[y * self.ground.side..][..cols];
        match self.status.get(y * self.ground.side..) {
            Some(status) if !status.is_empty() => row_with(z, &low[..cols], &high[..cols], &status[..cols]),
            _ => row(z, &low[..cols], &high[..cols]),
        }
    }

    /// The greatest distance of all, from ends at some step.
    fn worst(&self, hull: Hull, between: Between) -> u32 {
        let (mut hull, mut between) = (hull, between);
        while hull.step > 2 {
            hull = hull.halved(&self.ground, between);
            between = Between::Nothing;
        }
        let mut worst = 0;
        hull.rows(&self.ground, between, |y, low, high| {
            if y < self.header.rows {
                worst = worst.max(self.row(y, low, high));
            }
        });
        worst
    }
}

/// Of each cell of [`FINE`] posts a side: how far heights lie above and below the surface of its corners.
struct Cells {
    /// Along a side.
    cells: usize,
    above: Vec<i32>,
    below: Vec<i32>,
    /// Every [`FINE`]-th post as it was decoded.
    known: Hull,
}

/// The ends of the interval of heights less surface in a cell without any.
const EMPTY: i32 = -(1 << 30);

impl Cells {
    fn new(all: &All) -> Cells {
        let cells = (all.ground.side - 1) / FINE;
        let known = Hull::known(&all.ground, FINE);
        let hull = known.halved(&all.ground, Between::Nothing);
        let empty = vec![EMPTY; cells * cells];
        let mut out = Cells { cells, above: empty.clone(), below: empty, known };
        let side = all.ground.side;
        let mut above = vec![EMPTY; side];
        let mut below = vec![EMPTY; side];
        hull.rows(&all.ground, Between::Nothing, |y, low, high| {
            if y >= all.header.rows {
                return;
            }
            above.fill(EMPTY);
            below.fill(EMPTY);
            let cols = all.header.cols;
            let z = &all.z[y * side..][..cols];
            let status = all.status.get(y * side..).filter(|s| !s.is_empty()).map_or(&[][..], |s| &s[..cols]);
            distances(z, low, high, status, &mut above, &mut below);
            // A row between two rows of cells belongs to both.
            let last = y / FINE;
            let first = if y % FINE == 0 { last.saturating_sub(1) } else { last };
            for i in first..=last.min(cells - 1) {
                gather(&above, &mut out.above[i * cells..][..cells]);
                gather(&below, &mut out.below[i * cells..][..cells]);
            }
        });
        out
    }

    /// The greatest distance of heights from ends at every [`FINE`]-th post.
    fn worst(&self, all: &All, hull: &Hull) -> u32 {
        let (cells, side) = (self.cells, hull.side);
        let mut bounds = vec![0; cells * cells];
        // At a given post within the cell S and P are the same.
        let least = if all.ground.status.is_empty() { EMPTY } else { 0 };
        for (i, bounds) in bounds.chunks_exact_mut(cells).enumerate() {
            let rows = i * side..(i + 2) * side;
            let up = [&self.known.low[rows.clone()], &hull.low[rows.clone()]];
            let down = [&hull.high[rows.clone()], &self.known.high[rows]];
            corners(up, &self.above[i * cells..][..cells], least, bounds);
            corners(down, &self.below[i * cells..][..cells], least, bounds);
        }
        // The cell that promises to be the worst, then all that could be worse.
        let most = bounds.iter().fold(0, |m, b| m.max(*b));
        let first = bounds.iter().position(|b| *b == most).unwrap_or(0);
        let mut worst = cell(all, hull, first / cells, first % cells);
        for (k, bound) in bounds.iter().enumerate() {
            if *bound > worst {
                worst = worst.max(cell(all, hull, k / cells, k % cells));
            }
        }
        worst as u32
    }
}

/// Of each cell of a row the greatest of what `of` differs by at its four corners (at least `least`), and its own distance; two rows of
/// corners each.
#[multiversion(targets("x86_64+avx512f+avx512bw+avx512vl", "x86_64+avx2", "x86_64+sse4.1"))]
fn corners(of: [&[i32]; 2], own: &[i32], least: i32, most: &mut [i32]) {
    let n = most.len();
    let [(a, b), (c, d)] = of.map(|two| two.split_at(n + 1));
    let at = |j: usize| (a[j] - c[j]).max(b[j] - d[j]);
    for j in 0..n {
        // A 16th for each halving within the cell.
        most[j] = most[j].max(at(j).max(at(j + 1)).max(least) + own[j] + FINE.ilog2() as i32);
    }
}

/// The greatest distance in one cell, post by post.
fn cell(all: &All, hull: &Hull, i: usize, j: usize) -> i32 {
    const SIDE: usize = FINE + 1;
    let (side, lattice) = (all.ground.side, all.header.lattice);
    let (mut low, mut high) = ([[0; SIDE]; SIDE], [[0; SIDE]; SIDE]);
    for (y, x) in [(0, 0), (0, 1), (1, 0), (1, 1)] {
        low[y * FINE][x * FINE] = hull.low[(i + y) * hull.side + j + x];
        high[y * FINE][x * FINE] = hull.high[(i + y) * hull.side + j + x];
    }
    let mut step = FINE / 2;
    while step > 0 {
        for kind in [Kind::Centres, Kind::Edges] {
            let pass = Pass { step, kind };
            for y in (0..SIDE).step_by(step) {
                for x in (0..SIDE).step_by(step) {
                    let centre = y / step % 2 == 1 && x / step % 2 == 1;
                    let edge = (y / step + x / step) % 2 == 1;
                    if !(centre && kind == Kind::Centres || edge && kind == Kind::Edges) {
                        continue;
                    }
                    let post = [i * FINE + y, j * FINE + x];
                    let at = post[0] * side + post[1];
                    if all.ground.status.get(at) == Some(&Status::Given) {
                        (low[y][x], high[y][x]) = (all.ground.low[at], all.ground.high[at]);
                        continue;
                    }
                    let ends = pass.parents(lattice, post).0.map(|[v, u]| [v - i * FINE, u - j * FINE]);
                    let [[a, b], [c, d]] = ends;
                    low[y][x] = (low[a][b] + low[c][d]) >> 1;
                    high[y][x] = (high[a][b] + high[c][d] + 1) >> 1;
                }
            }
        }
        step /= 2;
    }
    let mut worst = 0;
    for y in 0..SIDE {
        for x in 0..SIDE {
            let [v, u] = [i * FINE + y, j * FINE + x];
            let at = v * side + u;
            let counts =
                v < all.header.rows && u < all.header.cols && all.status.get(at) != Some(&Status::Free);
            if counts {
                let z = all.z[at] << FRACTION;
                worst = worst.max(z - low[y][x]).max(high[y][x] - z);
            }
        }
    }
    worst
}

/// The greatest of every [`FINE`] + 1 posts, the last of one group the first of the next.
fn gather(row: &[i32], out: &mut [i32]) {
    for (k, most) in out.iter_mut().enumerate() {
        *most = row[k * FINE..][..FINE + 1].iter().fold(*most, |m, v| m.max(*v));
    }
}

#[multiversion(targets("x86_64+avx512f+avx512bw+avx512vl", "x86_64+avx2", "x86_64+sse4.1"))]
fn row(z: &[i32], low: &[i32], high: &[i32]) -> u32 {
    let mut worst = 0;
    for (z, (low, high)) in z.iter().zip(low.iter().zip(high)) {
        let z = z << FRACTION;
        worst = worst.max(z - low).max(high - z);
    }
    worst as u32
}

#[multiversion(targets("x86_64+avx512f+avx512bw+avx512vl", "x86_64+avx2", "x86_64+sse4.1"))]
fn row_with(z: &[i32], low: &[i32], high: &[i32], status: &[Status]) -> u32 {
    let mut worst = 0;
    for ((z, s), (low, high)) in z.iter().zip(status).zip(low.iter().zip(high)) {
        let z = z << FRACTION;
        let d = (z - low).max(high - z);
        worst = worst.max(if *s == Status::Free { 0 } else { d });
    }
    worst as u32
}

/// How far heights lie above their low ends and below their high ones; posts that do not count stay as they are.
#[multiversion(targets("x86_64+avx512f+avx512bw+avx512vl", "x86_64+avx2", "x86_64+sse4.1"))]
fn distances(z: &[i32], low: &[i32], high: &[i32], status: &[Status], above: &mut [i32], below: &mut [i32]) {
    let n = z.len();
    let (low, high, above, below) = (&low[..n], &high[..n], &mut above[..n], &mut below[..n]);
    for k in 0..n {
        let z = z[k] << FRACTION;
        above[k] = z - low[k];
        below[k] = high[k] - z;
    }
    for ((s, above), below) in status.iter().zip(above).zip(below) {
        if *s == Status::Free {
            (*above, *below) = (EMPTY, EMPTY);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::field::{Given, spread};
    use super::super::{Heights, Profile};
    use super::*;
    use crate::lattice::Lattice;
    use proptest::prelude::*;

    /// A grid, what a receiver made of it, and the bounds both ways.
    fn check(cols: usize, rows: usize, seed: u32, rough: i32, void: bool, given: bool, selected: bool) {
        let mut state = seed | 1;
        let mut random = move |n: i32| {
            state ^= state << 13;
            state ^= state >> 17;
            state ^= state << 5;
            (state >> 8) as i32 % n.max(1)
        };
        let z = (0..cols * rows).map(|k| random(rough) + (k % cols * 3) as i32 - (k / cols) as i32).collect();
        let mut heights = Heights::new(cols, rows, z);
        if void {
            heights.void = (0..cols * rows).map(|k| random(5) == 0 || k % cols > cols / 2 + 3).collect();
        }
        let lattice = Lattice::around(cols, rows).expect("a small grid");
        let posts = lattice.side() * lattice.side();
        let held = Given {
            z: (0..posts).map(|_| random(rough)).collect(),
            known: (0..posts).map(|_| random(3) == 0).collect(),
        };
        let header = Header {
            cols,
            rows,
            lattice,
            profile: if selected { Profile::Sparse } else { Profile::Cubic },
            layers: vec![4],
            mask: void,
            texture: None,
            given: given.then(|| held.state()),
            place: Default::default(),
            bounds: Vec::new(),
            body: 0,
        };
        let z = spread(&heights, lattice);
        let mut field = Field::new(&header, Some(&held)).expect("the same state");
        for (at, z) in z.iter().enumerate() {
            let (y, x) = (at / lattice.side(), at % lattice.side());
            if void && y < rows && x < cols && heights.void[y * cols + x] && field.status(at) == Status::Coded
            {
                field.status[at] = Status::Free;
            }
            match field.status(at) {
                Status::Given => {}
                Status::Free => field.z[at] = random(3 * rough) - rough,
                Status::Coded => field.z[at] = z + random(9) - 4,
            }
        }
        if selected {
            field.selected = (0..posts).map(|_| random(2) == 0).collect();
        }
        let quick = measure(&header, &z, &field);
        for (k, quick) in quick.iter().enumerate() {
            let plain = plain::hull(&header, &z, &field, k as u32).ceil() as u32;
            // Halvings of at most ten steps, a 16th each.
            assert!(
                plain <= *quick && *quick <= plain + 1,
                "{cols} x {rows}, pass {k}: {plain} by definition, {quick}"
            );
            assert!(
                selected || field.lattice.n() > 5 || plain == *quick,
                "{cols} x {rows}, pass {k}: {plain}, {quick}"
            );
        }
        if !selected {
            assert_eq!(quick.last(), Some(&greatest(&header, &z, &field)));
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]
        #[test]
        fn the_quick_way_gives_what_the_definition_does(
            cols in 1usize..150, rows in 1usize..150, seed: u32, rough in 1i32..5000,
            void: bool, given: bool, selected: bool,
        ) {
            check(cols, rows, seed, rough, void, given, selected);
        }
    }

    #[test]
    fn all_sizes_of_small_grids() {
        for cols in 1..12 {
            for rows in 1..12 {
                for kind in 0..8 {
                    check(cols, rows, 7 + kind, 100, kind & 1 != 0, kind & 2 != 0, kind & 4 != 0);
                }
            }
        }
    }

    /// Heights that fixed point does not take.
    #[test]
    fn heights_beyond_fixed_point() {
        check(40, 30, 3, 40_000_000, true, true, false);
    }
}
