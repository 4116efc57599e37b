//! Bounds by their definition: each pass on the whole lattice. For lattices that the quick way does not take, and to check it.

use super::super::field::{Field, SHOWN_WHOLE, Status};
use super::super::header::Header;
use std::cmp::Ordering;

/// The greatest error, in units, of prefixes that end in pass `number` of the first layer; of `2 n`: of the whole layer. Costs a walk
/// over the lattice, 16 bytes a post.
pub fn hull(header: &Header, z: &[i32], field: &Field, number: u32) -> f64 {
    let (lattice, side) = (header.lattice, header.lattice.side());
    let mut low: Vec<f64> = field.z.iter().map(|v| f64::from(*v)).collect();
    let mut high = low.clone();
    let chosen = |at: usize| field.selected.is_empty() || field.selected[at];
    for (k, pass) in lattice.passes().enumerate() {
        let now = (k as u32).cmp(&number);
        for post in pass.posts(lattice) {
            let at = post[0] * side + post[1];
            if now == Ordering::Less && chosen(at) || field.status(at) == Status::Given {
                continue;
            }
            let ([a, b], _) = pass.parents(lattice, post);
            let (a, b) = (a[0] * side + a[1], b[0] * side + b[1]);
            let mid = [(low[a] + low[b]) / 2.0, (high[a] + high[b]) / 2.0];
            let own = now == Ordering::Equal && number >= SHOWN_WHOLE && chosen(at);
            low[at] = if own { low[at].min(mid[0]) } else { mid[0] };
            high[at] = if own { high[at].max(mid[1]) } else { mid[1] };
        }
    }
    (0..side * side)
        .filter(|at| at % side < header.cols && at / side < header.rows && field.status(*at) != Status::Free)
        .map(|at| (f64::from(z[at]) - low[at]).abs().max((f64::from(z[at]) - high[at]).abs()))
        .fold(0.0, f64::max)
}
