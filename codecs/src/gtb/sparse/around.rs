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
    pub surplus: f32,
}

/// What both sides know around a candidate.
pub(super) struct Around {
    pub pass: Pass,
    /// The apexes.
    pub apexes: [Near; 2],
    /// Posts of the pass to the west, north, north-west, north-east.
    pub own: [Near; 4],
    /// By how much the mean of the apexes lies above the midpoint.
    pub twist: f64,
    /// Of each apex that is fictitious and has no needed child yet: how many children of it come after this one.
    pub debt: u8,
}

impl Around {
    pub fn new(lattice: Lattice, known: &Known, pass: Pass, post: Post) -> Around {
        let side = lattice.side();
        let near = |at: usize| Near {
            there: true,
            needed: known.needed[at],
            selected: known.selected[at],
            surplus: known.surplus[at],
        };
        let number = |[y, x]: Post| y * side + x;
        let ([a, b], apexes) = pass.parents(lattice, post);
        let s = pass.step as isize;
        let away: [[isize; 2]; 4] = match pass.kind {
            Kind::Centres => [[0, -2 * s], [-2 * s, 0], [-2 * s, -2 * s], [-2 * s, 2 * s]],
            Kind::Edges => [[0, -2 * s], [-2 * s, 0], [-s, -s], [-s, s]],
        };
        let inside = |[dy, dx]: [isize; 2]| {
            let (v, u) = (post[0] as isize + dy, post[1] as isize + dx);
            (v >= 0 && u >= 0 && v < side as isize && u < side as isize)
                .then(|| v as usize * side + u as usize)
        };
        let own = away.map(|d| inside(d).map_or(Near::default(), near));
        let middle = (known.surface[number(a)] + known.surface[number(b)]) / 2.0;
        let heights = apexes.map(|p| p.map(|p| known.surface[number(p)]));
        let twist = match heights {
            [Some(c), Some(d)] => (c + d) / 2.0 - middle,
            _ => 0.0,
        };
        let mut debt = 0;
        for apex in apexes.into_iter().flatten() {
            debt = debt.max(owes(lattice, known, pass, apex, post));
        }
        Around {
            pass,
            apexes: apexes.map(|p| p.map_or(Near::default(), |p| near(number(p)))),
            own,
            twist,
            debt,
        }
    }
}

/// Whether a fictitious apex still needs a child: 0 no; 1 to 4: one of so many.
fn owes(lattice: Lattice, known: &Known, pass: Pass, apex: Post, post: Post) -> u8 {
    let side = lattice.side();
    let at = apex[0] * side + apex[1];
    if known.selected[at] {
        return 0;
    }
    let s = pass.step as isize;
    let children: [[isize; 2]; 4] = match pass.kind {
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
