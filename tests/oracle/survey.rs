//! What follows from one survey alone: its core, its patches, their errors (sections 1, 8, 9).

use super::{KERNEL, MARGIN, OracleSurvey};
use std::collections::BTreeSet;

/// A set of level-0 cells of one survey; cell (i, j) has the posts (i, j) and (i + 1, j + 1).
#[derive(Clone, Debug, PartialEq)]
pub struct Cells {
    pub first: [i64; 2],
    pub cols: usize,
    pub rows: usize,
    pub inside: Vec<bool>,
}

impl Cells {
    /// Number of cell (i, j) in `inside`, row by row.
    pub fn number(&self, [i, j]: [i64; 2]) -> Option<usize> {
        let (i, j) = (i - self.first[0], j - self.first[1]);
        let within = (0..self.cols as i64).contains(&i) && (0..self.rows as i64).contains(&j);
        within.then(|| j as usize * self.cols + i as usize)
    }

    pub fn contains(&self, at: [i64; 2]) -> bool {
        self.number(at).is_some_and(|n| self.inside[n])
    }

    pub fn index(&self, number: usize) -> [i64; 2] {
        [self.first[0] + (number % self.cols) as i64, self.first[1] + (number / self.cols) as i64]
    }

    /// Indices of the cells in the set, row by row.
    pub fn iter(&self) -> impl Iterator<Item = [i64; 2]> + '_ {
        (0..self.inside.len()).filter(|&n| self.inside[n]).map(|n| self.index(n))
    }

    pub fn count(&self) -> usize {
        self.inside.iter().filter(|&&x| x).count()
    }
}

pub fn sample(survey: &OracleSurvey, i: i64, j: i64) -> Option<f64> {
    let (i, j) = (i - survey.first[0], j - survey.first[1]);
    let within = (0..survey.cols as i64).contains(&i) && (0..survey.rows as i64).contains(&j);
    if within { survey.heights[j as usize * survey.cols + i as usize] } else { None }
}

/// Cells whose 3 x 3 block has four valid corners everywhere.
pub fn core(survey: &OracleSurvey) -> Cells {
    assert_eq!(survey.heights.len(), survey.cols * survey.rows, "one height or void a post");
    let (cols, rows) = (survey.cols.saturating_sub(1), survey.rows.saturating_sub(1));
    let mut cells = Cells { first: survey.first, cols, rows, inside: vec![false; cols * rows] };
    for n in 0..cols * rows {
        let [i, j] = cells.index(n);
        let block = (-1..3).flat_map(|dj| (-1..3).map(move |di| (i + di, j + dj)));
        cells.inside[n] = block.into_iter().all(|(i, j)| sample(survey, i, j).is_some());
    }
    cells
}

/// Level and index of every patch the survey must have, given its core.
pub fn patches(core: &Cells) -> BTreeSet<(u32, [i64; 2])> {
    let mut all = BTreeSet::new();
    for level in 0..56 {
        let side = KERNEL << level;
        let here: BTreeSet<[i64; 2]> =
            core.iter().map(|[i, j]| [i.div_euclid(side), j.div_euclid(side)]).collect();
        all.extend(here.iter().map(|&at| (level, at)));
        let span = |axis: usize| {
            let least = here.iter().map(|at| at[axis]).min();
            let most = here.iter().map(|at| at[axis]).max();
            most.zip(least).map_or(0, |(most, least)| most - least + 1)
        };
        if span(0) <= 2 && span(1) <= 2 {
            break;
        }
    }
    all
}

/// Nominal area of a patch of `level`. All factors but the steps are powers of two: one rounding.
pub fn area(survey: &OracleSurvey, level: u32) -> f64 {
    let side = KERNEL + 2 * MARGIN;
    (side * side) as f64 * 4f64.powi(level as i32) * (survey.nominal_step[0] * survey.nominal_step[1])
}

/// Height of a vertex of stride `r`: its sample, else the mean of the valid ones nearer than `r`, else 0.
fn vertex(survey: &OracleSurvey, r: i64, i: i64, j: i64) -> f64 {
    sample(survey, i, j).or_else(|| mean_near(survey, r, i, j)).unwrap_or(0.0)
}

/// The mean, as stored, of the valid samples nearer than `r` to a post in both axes.
pub fn mean_near(survey: &OracleSurvey, r: i64, i: i64, j: i64) -> Option<f64> {
    let range = |at: i64, axis: usize, posts: usize| {
        let first = survey.first[axis];
        (at - r + 1).max(first)..(at + r).min(first + posts as i64)
    };
    let (mut sum, mut count) = (0.0, 0u32);
    for j in range(j, 1, survey.rows) {
        for i in range(i, 0, survey.cols) {
            if let Some(height) = sample(survey, i, j) {
                sum += height;
                count += 1;
            }
        }
    }
    (count > 0).then(|| f64::from((sum / f64::from(count)) as f32))
}

/// Largest distance of a valid sample in the closed domain from the patch. Level 0 is exact.
pub fn delta(survey: &OracleSurvey, level: u32, [i, j]: [i64; 2]) -> f64 {
    if level == 0 {
        return 0.0;
    }
    let (r, count) = (1i64 << level, (KERNEL + 2 * MARGIN + 1) as usize);
    let [i0, j0] = [i, j].map(|k| (KERNEL * k - MARGIN) * r);
    let vertices: Vec<f64> = (0..count * count)
        .map(|n| vertex(survey, r, i0 + (n % count) as i64 * r, j0 + (n / count) as i64 * r))
        .collect();
    let side = (count as i64 - 1) * r;
    let mut worst = 0f64;
    for y in 0..=side {
        for x in 0..=side {
            let Some(height) = sample(survey, i0 + x, j0 + y) else {
                continue;
            };
            // The last row and column belong to the last cell.
            let (cx, cy) = ((x / r).min(count as i64 - 2), (y / r).min(count as i64 - 2));
            let (tx, ty) = ((x - cx * r) as f64 / r as f64, (y - cy * r) as f64 / r as f64);
            let at = |x: i64, y: i64| vertices[y as usize * count + x as usize];
            let (v00, v10, v01, v11) = (at(cx, cy), at(cx + 1, cy), at(cx, cy + 1), at(cx + 1, cy + 1));
            let a = v00 + (v01 - v00) * ty;
            let b = v10 + (v11 - v10) * ty;
            worst = worst.max((height - (a + (b - a) * tx)).abs());
        }
    }
    worst
}

/// The smallest `f32` that is not below the exact sum.
pub fn error_up(accuracy: f64, delta: f64) -> f32 {
    let sum = accuracy + delta;
    let part = sum - accuracy;
    let lost = (accuracy - (sum - part)) + (delta - part); // sum + lost is exact
    let enough = |y: f32| f64::from(y) - sum >= lost;
    let mut y = (sum as f32).next_down().next_down();
    while !enough(y) {
        y = y.next_up();
    }
    y
}
