//! Which samples are voids: row by row, each by the ten around that came before.

use crate::mixing::Count;
use crate::range::Coder;

/// The samples that are looked at: columns to the right, rows up.
const AROUND: [(isize, usize); 10] =
    [(-1, 0), (-2, 0), (-3, 0), (-2, 1), (-1, 1), (0, 1), (1, 1), (2, 1), (-1, 2), (0, 2)];

/// Codes the marks. Returns `false` if the bytes end before; what is missing is void: nothing is known of it.
pub(super) fn code<C: Coder>(void: &mut [bool], cols: usize, c: &mut C) -> bool {
    let mut counts = vec![Count::NEW; 1 << AROUND.len()];
    for at in 0..void.len() {
        let (x, y) = (at % cols, at / cols);
        let context = AROUND.iter().fold(0, |k, (dx, dy)| {
            let inside = y >= *dy && (0..cols as isize).contains(&(x as isize + dx));
            k << 1 | usize::from(inside && void[(at - dy * cols).wrapping_add_signed(*dx)])
        });
        void[at] = counts[context].code(c, void[at]);
        if c.ended() {
            void[at..].fill(true);
            return false;
        }
    }
    true
}

/// Gives voids the mean of what is around, from ever larger cells: nothing is asked of them, but maps shall not see a cliff.
pub(super) fn filled(values: &mut [f64], void: &[bool], cols: usize) {
    if !void.contains(&true) {
        return;
    }
    let rows = values.len() / cols;
    let sums: Vec<(f64, f64)> =
        (values.iter().zip(void)).map(|(v, void)| if *void { (0.0, 0.0) } else { (*v, 1.0) }).collect();
    let mut levels = vec![(cols, rows, sums)];
    while let Some((cols, rows, fine)) = levels.last().filter(|l| l.0 * l.1 > 1) {
        let (w, h) = (cols.div_ceil(2), rows.div_ceil(2));
        let mut coarse = vec![(0.0, 0.0); w * h];
        for (k, v) in fine.iter().enumerate() {
            let c = &mut coarse[k / cols / 2 * w + k % cols / 2];
            *c = (c.0 + v.0, c.1 + v.1);
        }
        levels.push((w, h, coarse));
    }
    for (k, v) in values.iter_mut().enumerate().filter(|(k, _)| void[*k]) {
        let (mut x, mut y) = (k % cols, k / cols);
        *v = 0.0;
        for (w, _, level) in &levels {
            let (sum, count) = level[y * w + x];
            if count > 0.0 {
                *v = sum / count;
                break;
            }
            (x, y) = (x / 2, y / 2);
        }
    }
}
