//! Signs far from the surface, by what is connected.

use super::field::{FULL, Field, UNITS};
use super::report::Report;
use super::sets::{join, root};
use super::vector::Vector;

/// A row's saturated voxels without a gap.
struct Run {
    from: usize,
    end: usize,
}

/// Makes voxels beyond `bounds` (in voxels) outside, gives each connected part of saturated voxels one sign, and counts what was changed and where the
/// field is torn. The surface is 16 voxels from any saturated one, so connected ones lie on one side of it: where a closed mesh does not cross
/// itself, nothing changes.
pub fn settle(field: &mut Field, bounds: [Vector; 2], report: &mut Report) {
    beyond(field, bounds, report);
    let (runs, mut together) = saturated(field);
    // Votes: inside less outside. A part that reaches beyond the mesh is outside.
    let mut votes = vec![0i64; runs.len()];
    for (k, run) in runs.iter().enumerate() {
        let head = root(&mut together, k as u32) as usize;
        votes[head] += field.values[run.from..run.end].iter().map(|v| i64::from(v.signum())).sum::<i64>();
        if reaches(field, run, bounds) {
            votes[head] -= i64::from(u32::MAX);
        }
    }
    for (k, run) in runs.iter().enumerate() {
        let value = if votes[root(&mut together, k as u32) as usize] > 0 { FULL } else { -FULL };
        for v in &mut field.values[run.from..run.end] {
            report.resigned += usize::from(*v != value);
            *v = value;
        }
    }
    report.torn = torn(field);
}

/// Whether the middle of a voxel along an axis lies beyond the bounds.
fn is_beyond(k: usize, axis: usize, bounds: [Vector; 2]) -> bool {
    let middle = k as f64 + 0.5;
    middle < bounds[0][axis] || middle > bounds[1][axis]
}

/// Makes the voxels beyond the bounds outside.
fn beyond(field: &mut Field, bounds: [Vector; 2], report: &mut Report) {
    let [cols, rows, layers] = field.window.size;
    let across: Vec<bool> = (0..cols).map(|x| is_beyond(x, 0, bounds)).collect();
    for z in 0..layers {
        for y in 0..rows {
            let row = is_beyond(y, 1, bounds) || is_beyond(z, 2, bounds);
            let at = field.window.at([0, y, z]);
            for (v, across) in field.values[at..at + cols].iter_mut().zip(&across) {
                if *v > 0 && (row || *across) {
                    *v = -*v;
                    report.resigned += 1;
                }
            }
        }
    }
}

/// The runs of saturated voxels, and which of them are connected over faces.
fn saturated(field: &Field) -> (Vec<Run>, Vec<u32>) {
    let [cols, rows, layers] = field.window.size;
    let (mut runs, mut together): (Vec<Run>, Vec<u32>) = (Vec::new(), Vec::new());
    // Where the runs of each row begin.
    let mut begins = Vec::with_capacity(rows * layers + 1);
    let full = |v: &i8| v.unsigned_abs() == FULL as u8;
    for row in 0..rows * layers {
        begins.push(runs.len());
        let values = &field.values[row * cols..][..cols];
        let mut x = 0;
        while let Some(skip) = values[x..].iter().position(full) {
            let from = x + skip;
            x = from + values[from..].iter().take_while(|v| full(v)).count();
            together.push(runs.len() as u32);
            runs.push(Run { from: row * cols + from, end: row * cols + x });
        }
        let before = [(row % rows > 0).then(|| row - 1), row.checked_sub(rows)];
        for other in before.into_iter().flatten() {
            let away = (row - other) * cols;
            let (mut a, mut b) = (begins[row], begins[other]);
            let b_end = begins[other + 1];
            while a < runs.len() && b < b_end {
                if runs[a].from < runs[b].end + away && runs[b].from + away < runs[a].end {
                    join(&mut together, a as u32, b as u32);
                }
                if runs[a].end <= runs[b].end + away { a += 1 } else { b += 1 }
            }
        }
    }
    (runs, together)
}

/// Whether a run has a voxel beyond the bounds.
fn reaches(field: &Field, run: &Run, bounds: [Vector; 2]) -> bool {
    let [cols, rows, _] = field.window.size;
    let (row, first, last) = (run.from / cols, run.from % cols, (run.end - 1) % cols);
    is_beyond(row % rows, 1, bounds)
        || is_beyond(row / rows, 2, bounds)
        || is_beyond(first, 0, bounds)
        || is_beyond(last, 0, bounds)
}

/// Neighbours whose values differ by more than one voxel and the rounding of both.
fn torn(field: &Field) -> usize {
    let size = field.window.size;
    let most = UNITS as i32 + 1;
    let mut count = 0;
    for (axis, step) in [(0, 1), (1, size[0]), (2, size[0] * size[1])] {
        let pairs = field.values.iter().zip(field.values.iter().skip(step)).enumerate();
        let inner = |k: usize| k / step % size[axis] + 1 < size[axis];
        count +=
            pairs.filter(|(k, (a, b))| (i32::from(**a) - i32::from(**b)).abs() > most && inner(*k)).count();
    }
    count
}
