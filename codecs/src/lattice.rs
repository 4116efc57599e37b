//! The square lattice of 2^n + 1 posts a side and its passes from coarse to fine (specification of GTB, section 1).
//!
//! After the four corners, each pass halves one diagonal: first *centres* of squares (y and x odd multiples of the step), then
//! *edges* (y/step + x/step odd). Together that is every post once, in 2n passes. A post is named by its pass and its place in the
//! raster order of the pass; no connectivity is stored anywhere.

/// Greatest n: 8193 posts a side.
pub const N_MAX: u32 = 13;

/// Row and column of a post.
pub type Post = [usize; 2];

/// A lattice of 2^n + 1 posts a side.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Lattice {
    n: u32,
}

/// Which posts of a step a pass brings.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Midpoints of diagonals: y and x odd multiples of the step.
    Centres,
    /// Midpoints of sides: y/step + x/step odd.
    Edges,
}

/// One pass.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Pass {
    /// Distance in posts between neighbours of the lattice that the pass completes (with its [`Kind::Edges`]).
    pub step: usize,
    /// Which posts.
    pub kind: Kind,
}

impl Lattice {
    /// The lattice of 2^n + 1 posts a side; `None` beyond [`N_MAX`].
    pub fn new(n: u32) -> Option<Lattice> {
        (n <= N_MAX).then_some(Lattice { n })
    }

    /// The smallest lattice that holds `cols` x `rows` posts.
    pub fn around(cols: usize, rows: usize) -> Option<Lattice> {
        (0..=N_MAX).map(|n| Lattice { n }).find(|l| l.side() >= cols.max(rows))
    }

    /// n.
    pub fn n(self) -> u32 {
        self.n
    }

    /// Posts along a side.
    pub fn side(self) -> usize {
        (1 << self.n) + 1
    }

    /// The last row and column.
    pub fn last(self) -> usize {
        1 << self.n
    }

    /// The corners in the order in which they are coded.
    pub fn corners(self) -> [Post; 4] {
        let n = self.last();
        [[0, 0], [0, n], [n, 0], [n, n]]
    }

    /// All passes, coarse to fine: 2n.
    pub fn passes(self) -> impl DoubleEndedIterator<Item = Pass> + Clone {
        (0..2 * self.n).map(move |k| self.pass(k))
    }

    /// The pass of a number, 0 to 2n - 1.
    pub fn pass(self, number: u32) -> Pass {
        let kind = if number.is_multiple_of(2) { Kind::Centres } else { Kind::Edges };
        Pass { step: 1 << (self.n - 1 - number / 2), kind }
    }

    /// The pass that brings a post; `None` for corners.
    pub fn pass_of(self, [y, x]: Post) -> Option<Pass> {
        let step = 1 << (y | x | self.last()).trailing_zeros();
        let kind = if (y & x) & step != 0 { Kind::Centres } else { Kind::Edges };
        (step < self.last()).then_some(Pass { step, kind })
    }

    /// The number of a pass, 0 to 2n - 1.
    pub fn number(self, pass: Pass) -> u32 {
        2 * (self.n - 1 - pass.step.trailing_zeros()) + u32::from(pass.kind == Kind::Edges)
    }
}

impl Pass {
    /// The rows that the pass has posts in.
    pub fn rows(self, lattice: Lattice) -> impl Iterator<Item = usize> + Clone {
        let (from, by) = match self.kind {
            Kind::Centres => (self.step, 2 * self.step),
            Kind::Edges => (0, self.step),
        };
        (from..lattice.side()).step_by(by)
    }

    /// The columns of the pass in one of its rows.
    pub fn columns(self, lattice: Lattice, row: usize) -> impl Iterator<Item = usize> + Clone {
        let from = match self.kind {
            Kind::Edges if row / self.step % 2 == 1 => 0,
            _ => self.step,
        };
        (from..lattice.side()).step_by(2 * self.step)
    }

    /// All posts of the pass in raster order.
    pub fn posts(self, lattice: Lattice) -> impl Iterator<Item = Post> {
        self.rows(lattice).flat_map(move |y| self.columns(lattice, y).map(move |x| [y, x]))
    }

    /// The ends of the hypotenuse whose midpoint a post of this pass is, and the apexes of the two triangles on it: those of
    /// an edge on the border lie outside and are `None`.
    pub fn parents(self, lattice: Lattice, [y, x]: Post) -> ([Post; 2], [Option<Post>; 2]) {
        let s = self.step;
        let inside = |y: Option<usize>, x: Option<usize>| match (y, x) {
            (Some(y), Some(x)) if y <= lattice.last() && x <= lattice.last() => Some([y, x]),
            _ => None,
        };
        match self.kind {
            Kind::Centres => {
                let main = [[y - s, x - s], [y + s, x + s]];
                let anti = [[y - s, x + s], [y + s, x - s]];
                let (ends, apexes) =
                    if (y / (2 * s) + x / (2 * s)).is_multiple_of(2) { (main, anti) } else { (anti, main) };
                (ends, apexes.map(Some))
            }
            Kind::Edges if y / s % 2 == 1 => (
                [[y - s, x], [y + s, x]],
                [inside(Some(y), x.checked_sub(s)), inside(Some(y), x.checked_add(s))],
            ),
            Kind::Edges => (
                [[y, x - s], [y, x + s]],
                [inside(y.checked_sub(s), Some(x)), inside(y.checked_add(s), Some(x))],
            ),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Every post comes in exactly one pass, after its hypotenuse ends and apexes.
    #[test]
    fn every_post_once_and_after_its_parents() {
        for n in 0..=7 {
            let l = Lattice::new(n).unwrap();
            let mut order = vec![usize::MAX; l.side() * l.side()];
            let at = |[y, x]: Post| y * l.side() + x;
            let mut count = 0;
            for c in l.corners() {
                order[at(c)] = count;
                count += 1;
                assert_eq!(l.pass_of(c), None);
            }
            for (k, pass) in l.passes().enumerate() {
                assert_eq!(l.number(pass), k as u32);
                let first = count;
                for p in pass.posts(l) {
                    assert_eq!(order[at(p)], usize::MAX, "{p:?} twice");
                    assert_eq!(l.pass_of(p), Some(pass));
                    let (ends, apexes) = pass.parents(l, p);
                    for q in ends.into_iter().chain(apexes.into_iter().flatten()) {
                        assert!(order[at(q)] < first, "{q:?} is no earlier than {p:?}");
                    }
                    assert_eq!([0, 1].map(|k| ends[0][k] + ends[1][k]), p.map(|v| 2 * v));
                    order[at(p)] = count;
                    count += 1;
                }
            }
            assert_eq!(count, l.side() * l.side());
        }
    }
}
