//! Least squares in a window around a post that moves with it.

use super::squares::{NONE, Row, Sums, add, blend, solve};

/// What a row north counts of the next, and a block of the one beside it.
const FADE: f32 = 0.75;
/// Posts of the whole pass that draw a window.
const DRAW: f32 = 20.0;
/// Posts of the coarser pass that draw a pass.
const INHERITED: f32 = 30.0;
/// Part of the mean diagonal that draws weights to the cubic.
const RIDGE: f32 = 1e-5;

/// The least squares of one pass. A row of it is cut in blocks of posts that share their weights.
///
/// Memory: 4608 bytes a block. Cost: one solution and about four passes over the sums a block.
pub(super) struct Window {
    /// Weights where nothing is known.
    prior: Row,
    /// Per block: sums of the rows so far, faded by row.
    columns: Vec<Sums>,
    /// Per block: sums of the rows above, faded to both sides.
    above: Vec<Sums>,
    /// Sums of the blocks to the west, faded.
    west: Sums,
    /// Sums of the block at work.
    block: Sums,
    posts: f32,
    /// A post's worth of the coarser pass of the same kind.
    inherited: Sums,
    /// Sums of the pass, and of how many posts.
    all: Sums,
    count: f32,
    /// A post's worth of all that was known where the row began.
    worth: Sums,
}

/// Weights for the posts of a block.
#[derive(Clone, Copy)]
pub(super) struct Weights {
    /// By what lies around.
    pub local: Row,
    /// By the whole pass.
    pub broad: Row,
}

impl Window {
    /// For rows of so many blocks, after the coarser pass of the same kind.
    pub fn new(blocks: usize, coarser: Option<&Window>, prior: Row) -> Window {
        Window {
            prior,
            columns: vec![NONE; blocks],
            above: vec![NONE; blocks],
            west: NONE,
            block: NONE,
            posts: 0.0,
            inherited: coarser.map_or(NONE, Window::worth),
            all: NONE,
            count: 0.0,
            worth: NONE,
        }
    }

    /// A post's worth of all sums so far.
    fn worth(&self) -> Sums {
        let part = 1.0 / (self.count + INHERITED);
        let mut out = self.inherited;
        blend(&mut out, INHERITED * part, &self.all, part);
        out
    }

    /// A row begins: the weights of the whole pass.
    pub fn start_row(&mut self) -> Weights {
        self.west = NONE;
        self.worth = self.worth();
        let broad = solve([&self.worth, &NONE, &NONE], 1.0, &self.prior, RIDGE);
        Weights { local: broad, broad }
    }

    /// The weights for block `k` of the row.
    pub fn around(&self, k: usize) -> Row {
        solve([&self.worth, &self.above[k], &self.west], DRAW, &self.prior, RIDGE)
    }

    /// A post of the block is known.
    #[inline(always)]
    pub fn learn(&mut self, v: &Row, weight: f32) {
        add(&mut self.block, v, weight);
        self.posts += 1.0;
    }

    /// Block `k` ends.
    pub fn end_block(&mut self, k: usize) {
        blend(&mut self.columns[k], FADE, &self.block, 1.0);
        blend(&mut self.west, FADE, &self.block, FADE);
        blend(&mut self.all, 1.0, &self.block, 1.0);
        self.count += self.posts;
        self.block = NONE;
        self.posts = 0.0;
    }

    /// A row ends: what the next one finds above it, to both sides.
    pub fn end_row(&mut self) {
        let mut run = NONE;
        for (column, above) in self.columns.iter().zip(&mut self.above).rev() {
            blend(&mut run, FADE, column, FADE);
            *above = run;
        }
        let mut run = NONE;
        for (column, above) in self.columns.iter().zip(&mut self.above) {
            blend(above, 1.0, &run, 1.0);
            blend(&mut run, FADE, column, FADE * FADE);
        }
    }
}
