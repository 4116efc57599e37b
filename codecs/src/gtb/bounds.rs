//! How wrong each prefix of the first layer is at the posts of the grid, measured where it is made.
//!
//! A prefix that ends in a pass holds a part of its posts. Each post of the pass is then its midpoint or its height; every finer post
//! lies between what the two give. The interval of these, carried down by the midpoint rule, holds all prefixes that end in
//! the pass; the greatest distance of a height from the ends of its interval is the bound.

use super::field::{Field, Status};
use super::header::Header;

/// Of each pass, and of the whole first layer: the greatest error in units, rounded up. `z`: the heights on the lattice.
pub(super) fn measure(header: &Header, z: &[i32], field: &Field) -> Vec<u32> {
    let passes = 2 * header.lattice.n();
    (0..=passes).map(|k| hull(header, z, field, Some(k))).collect()
}

/// The greatest error of the whole file, in units.
pub(super) fn greatest(header: &Header, z: &[i32], field: &Field) -> u32 {
    hull(header, z, field, None)
}

/// The greatest error of prefixes that end in pass `number`; `None`: of the whole.
fn hull(header: &Header, z: &[i32], field: &Field, number: Option<u32>) -> u32 {
    let (lattice, side) = (header.lattice, header.lattice.side());
    let rec: Vec<f64> = field.z.iter().map(|v| f64::from(*v)).collect();
    let (mut low, mut high) = (rec.clone(), rec);
    let chosen = |at: usize| field.selected.is_empty() || field.selected[at];
    for (k, pass) in lattice.passes().enumerate() {
        let now = number.map_or(std::cmp::Ordering::Less, |n| (k as u32).cmp(&n));
        for post in pass.posts(lattice) {
            let at = post[0] * side + post[1];
            if now.is_lt() && chosen(at) || field.status(at) == Status::Given {
                continue;
            }
            let ([a, b], _) = pass.parents(lattice, post);
            let (a, b) = (a[0] * side + a[1], b[0] * side + b[1]);
            let mid = [(low[a] + low[b]) / 2.0, (high[a] + high[b]) / 2.0];
            let own = now.is_eq() && chosen(at);
            low[at] = if own { low[at].min(mid[0]) } else { mid[0] };
            high[at] = if own { high[at].max(mid[1]) } else { mid[1] };
        }
    }
    let worst = (0..side * side)
        .filter(|at| at % side < header.cols && at / side < header.rows && field.status(*at) != Status::Free)
        .map(|at| (f64::from(z[at]) - low[at]).abs().max((f64::from(z[at]) - high[at]).abs()))
        .fold(0.0, f64::max);
    worst.ceil() as u32
}
