//! Patterns: windows of one class, small pictures of what it looks like (specification of GTB, section 6.3).

use super::Cells;

/// Cells along a side of a pattern.
pub const PATTERN: usize = 32;
/// Least part of a window's cells that are of its class.
const PURITY: f64 = 0.9;
/// Windows are sought at every so many cells.
const STRIDE: usize = 4;

/// A window: its north-west cell.
pub type Window = [usize; 2];

/// Gives each class (from 1) its purest window, and dissolves classes without any into that of the nearest mean colour. Returns
/// the window of each class; none at all if the picture is smaller than a window, or nothing is pure.
pub fn windows(cells: &Cells, labels: &mut [u8]) -> Vec<Option<Window>> {
    let side = 1usize << cells.n;
    let classes = usize::from(labels.iter().copied().max().unwrap_or(0)) + 1;
    let mut windows = vec![None; classes];
    if side >= PATTERN {
        (1..classes).for_each(|class| windows[class] = purest(labels, side, class as u8));
    }
    let means = means(cells, labels, classes);
    let have: Vec<usize> = (1..classes).filter(|k| windows[*k].is_some()).collect();
    if have.is_empty() {
        return windows;
    }
    let into: Vec<u8> = (0..classes)
        .map(|k| {
            let near = |other: &&usize| {
                let d: f64 = (0..3)
                    .map(|ch| (means[k][ch] - means[**other][ch]) * (means[k][ch] - means[**other][ch]))
                    .sum();
                d
            };
            let nearest = have.iter().min_by(|a, b| near(a).total_cmp(&near(b))).copied().unwrap_or(k);
            (if k == 0 || windows[k].is_some() { k } else { nearest }) as u8
        })
        .collect();
    labels.iter_mut().for_each(|l| *l = into[usize::from(*l)]);
    windows
}

/// The cells of a window.
pub fn cut(cells: &Cells, [y, x]: Window) -> Vec<[u8; 3]> {
    let side = 1usize << cells.n;
    (0..PATTERN).flat_map(|v| cells.rgb[(y + v) * side + x..][..PATTERN].iter().copied()).collect()
}

/// Mean colours of classes.
pub fn means(cells: &Cells, labels: &[u8], classes: usize) -> Vec<[f64; 3]> {
    let mut sums = vec![[0u64; 4]; classes];
    for (label, rgb) in labels.iter().zip(&cells.rgb) {
        let sum = &mut sums[usize::from(*label)];
        (0..3).for_each(|ch| sum[ch] += u64::from(rgb[ch]));
        sum[3] += 1;
    }
    sums.iter().map(|s| [0, 1, 2].map(|ch| s[ch] as f64 / s[3].max(1) as f64)).collect()
}

/// The window with most cells of a class, if it is pure enough; of equals the first.
fn purest(labels: &[u8], side: usize, class: u8) -> Option<Window> {
    // Sums over the rectangles from the first cell.
    let width = side + 1;
    let mut sums = vec![0u32; width * width];
    for y in 0..side {
        let mut row = 0;
        for x in 0..side {
            row += u32::from(labels[y * side + x] == class);
            sums[(y + 1) * width + x + 1] = sums[y * width + x + 1] + row;
        }
    }
    let count = |[y, x]: Window| {
        let s = |y: usize, x: usize| sums[y * width + x];
        s(y + PATTERN, x + PATTERN) + s(y, x) - s(y, x + PATTERN) - s(y + PATTERN, x)
    };
    let places = || (0..=side - PATTERN).step_by(STRIDE);
    let all = places().flat_map(|y| places().map(move |x| [y, x]));
    let best = all.max_by_key(|w| (count(*w), usize::MAX - (w[0] * side + w[1])))?;
    (f64::from(count(best)) >= PURITY * (PATTERN * PATTERN) as f64).then_some(best)
}
