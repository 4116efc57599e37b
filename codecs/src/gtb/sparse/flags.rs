//! The two flags of a candidate.

use super::around::Around;
use super::counts::Counts;
use crate::lattice::Kind;
use crate::range::Coder;

/// The models of both flags.
pub(super) struct Flags {
    needed: Counts,
    selected: Counts,
}

/// What the flags look at, as numbers.
struct View {
    /// How many apexes there are, and how many of them are selected.
    apexes: usize,
    /// How many of the four posts of the pass before are needed.
    near: usize,
    /// Magnitude of surpluses around, times the step of the pass: one class an octave.
    size: usize,
    /// Which pass: the last six apart, the ones before as two.
    pass: usize,
    /// Which of the four posts before are selected.
    pattern: usize,
}

const DEBTS: usize = 5;
const APEXES: usize = 6;
const NEAR: usize = 5;
const SIZES: usize = 16;
const PASSES: usize = 8;
const PATTERNS: usize = 16;

impl Flags {
    pub fn new() -> Flags {
        Flags {
            needed: Counts::new([DEBTS, APEXES, SIZES, NEAR, PASSES, PATTERNS]),
            selected: Counts::new([PASSES, APEXES, SIZES, NEAR, PATTERNS, 1]),
        }
    }

    /// Whether the post is needed.
    pub fn needed<C: Coder>(&mut self, c: &mut C, around: &Around, bit: bool) -> bool {
        let v = View::new(around);
        self.needed.code(c, [around.debt, v.apexes, v.size, v.near, v.pass, v.pattern], bit)
    }

    /// Whether a needed post is selected.
    pub fn selected<C: Coder>(&mut self, c: &mut C, around: &Around, bit: bool) -> bool {
        let v = View::new(around);
        self.selected.code(c, [v.pass, v.apexes, v.size, v.near, v.pattern, 0], bit)
    }
}

impl View {
    fn new(a: &Around) -> View {
        let selected = a.apexes.iter().filter(|p| p.selected).count();
        let there = a.apexes.iter().filter(|p| p.there).count();
        let size = (a.activity() * a.pass.step as f64).min(65_535.0) as u32;
        View {
            apexes: (there - 1) * 3 + selected,
            near: a.own.iter().filter(|p| p.needed).count(),
            size: (32 - size.leading_zeros()).min(15) as usize,
            pass: (a.pass.step.trailing_zeros().min(3) * 2) as usize
                + usize::from(a.pass.kind == Kind::Edges),
            pattern: a.own.iter().fold(0, |n, p| n * 2 + usize::from(p.selected)),
        }
    }
}
