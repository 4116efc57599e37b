//! What lies around a candidate.

use super::Known;
use crate::lattice::{Kind, Lattice, Pass, Post};

/// A post nearby.
#[derive(Clone, Copy, Default)]
pub(super) struct Near {
    pub there: bool,
    pub needed: bool,
    pub selected: bool,
    /// Surplus in units.
    pub surplus: f64,
}

/// What a surplus is guessed from.
pub(super) const FEATURES: usize = 6;

/// What both sides know around a candidate.
pub(super) struct Around {
    pub pass: Pass,
    /// The apexes.
    pub apexes: [Near; 2],
    /// The ends of the hypotenuse.
    pub ends: [Near; 2],
    /// Posts of the pass to the west, north, north-west, north-east.
    pub own: [Near; 4],
    /// In units: how far the apexes and the eight outer posts lie above the midpoint in the mean; mean surpluses of apexes and ends,
    /// of the posts of the pass in line and across.
    pub features: [f64; FEATURES],
    /// Of each apex that is fictitious and has no needed child yet: how many children of it come after this one.
    pub debt: usize,
}

type Away<const N: usize> = [[isize; 2]; N];

impl Around {
    pub fn new(lattice: Lattice, known: &Known, pass: Pass, post: Post) -> Around {
        let side = lattice.side();
        let near = |at: usize| Near {
            there: true,
            needed: known.needed[at],
            selected: known.selected[at],
            surplus: f64::from(known.surplus[at]),
        };
        let number = |[y, x]: Post| y * side + x;
        let ([a, b], apexes) = pass.parents(lattice, post);
        let s = pass.step as isize;
        let (own, outer): (Away<4>, Away<8>) = match pass.kind {
            Kind::Centres => (
                [[0, -2 * s], [-2 * s, 0], [-2 * s, -2 * s], [-2 * s, 2 * s]],
                [
                    [-s, -3 * s],
                    [-s, 3 * s],
                    [s, -3 * s],
                    [s, 3 * s],
                    [-3 * s, -s],
                    [-3 * s, s],
                    [3 * s, -s],
                    [3 * s, s],
                ],
            ),
            Kind::Edges => (
                [[0, -2 * s], [-2 * s, 0], [-s, -s], [-s, s]],
                [
                    [-s, -2 * s],
                    [-s, 2 * s],
                    [s, -2 * s],
                    [s, 2 * s],
                    [-2 * s, -s],
                    [-2 * s, s],
                    [2 * s, -s],
                    [2 * s, s],
                ],
            ),
        };
        let inside = |[dy, dx]: [isize; 2]| {
            let (v, u) = (post[0] as isize + dy, post[1] as isize + dx);
            (v >= 0 && u >= 0 && v < side as isize && u < side as isize)
                .then(|| v as usize * side + u as usize)
        };
        let own = own.map(|d| inside(d).map_or(Near::default(), near));
        let middle = (known.surface[number(a)] + known.surface[number(b)]) / 2.0;
        let mean = |sum: f64, count: f64| if count > 0.0 { sum / count } else { 0.0 };
        let (mut sum, mut count) = (0.0, 0.0);
        for p in apexes.into_iter().flatten() {
            sum += known.surface[number(p)] - middle;
            count += 1.0;
        }
        let twist = if count == 2.0 { sum / 2.0 } else { 0.0 };
        let (mut sum, mut count) = (0.0, 0.0);
        for at in outer.into_iter().filter_map(inside) {
            sum += known.surface[at] - middle;
            count += 1.0;
        }
        let outer = if count == 8.0 { mean(sum, count) } else { 0.0 };
        let mut debt = 0;
        for apex in apexes.into_iter().flatten() {
            debt = debt.max(owes(lattice, known, pass, apex, post));
        }
        let apexes = apexes.map(|p| p.map_or(Near::default(), |p| near(number(p))));
        let ends = [near(number(a)), near(number(b))];
        let features = [
            twist,
            outer,
            (apexes[0].surplus + apexes[1].surplus) / 2.0,
            (ends[0].surplus + ends[1].surplus) / 2.0,
            (own[0].surplus + own[1].surplus) / 2.0,
            (own[2].surplus + own[3].surplus) / 2.0,
        ];
        Around { pass, apexes, ends, own, features, debt }
    }

    /// How large surpluses are around here, in units.
    pub fn activity(&self) -> f64 {
        let (mut sum, mut weight) = (0.0, 0.0);
        for (all, w) in [(&self.own[..], 1.0), (&self.apexes[..], 0.7), (&self.ends[..], 0.3)] {
            for p in all.iter().filter(|p| p.there) {
                sum += w * p.surplus.abs();
                weight += w;
            }
        }
        (sum / weight) + 0.25 * self.features[0].abs()
    }
}

/// Whether a fictitious apex still needs a child: 0 no; 1 to 4: one of so many.
fn owes(lattice: Lattice, known: &Known, pass: Pass, apex: Post, post: Post) -> usize {
    let side = lattice.side();
    let at = apex[0] * side + apex[1];
    if known.selected[at] {
        return 0;
    }
    let s = pass.step as isize;
    let children: Away<4> = match pass.kind {
        Kind::Centres => [[-s, -s], [-s, s], [s, -s], [s, s]],
        Kind::Edges => [[-s, 0], [0, -s], [0, s], [s, 0]],
    };
    let mut open = 0;
    for [dy, dx] in children {
        let (v, u) = (apex[0] as isize + dy, apex[1] as isize + dx);
        if v < 0 || u < 0 || v >= side as isize || u >= side as isize {
            continue;
        }
        let child = [v as usize, u as usize];
        let (ends, others) = pass.parents(lattice, child);
        if ends.contains(&apex) {
            continue;
        }
        if known.needed[child[0] * side + child[1]] {
            return 0;
        }
        let later = (child[0], child[1]) >= (post[0], post[1]);
        if later && others.into_iter().flatten().all(|[y, x]| known.needed[y * side + x]) {
            open += 1;
        }
    }
    open
}
