//! Which rows of an upload are there: a bit a row.

use crate::wire::v1::RowSpan;

/// Which rows of each grid are there.
pub struct RowSet {
    /// Rows of each grid, and a bit for each.
    grids: Vec<(u64, Vec<u64>)>,
    there: u64,
}

impl RowSet {
    /// None of them. `rows`: of each grid; their sum was held against its limit.
    pub fn new(rows: impl IntoIterator<Item = u64>) -> RowSet {
        let grids = rows.into_iter().map(|n| (n, vec![0; n.div_ceil(64) as usize])).collect();
        RowSet { grids, there: 0 }
    }

    /// Rows that are there.
    pub fn there(&self) -> u64 {
        self.there
    }

    pub fn is_complete(&self) -> bool {
        self.there == self.grids.iter().map(|(n, _)| n).sum::<u64>()
    }

    /// Whether the grid exists and has these rows.
    pub fn holds(&self, s: &RowSpan) -> bool {
        let end = s.row.checked_add(s.rows);
        self.grids.get(s.grid as usize).zip(end).is_some_and(|((n, _), end)| s.rows > 0 && end <= *n)
    }

    /// The spans of these rows that are not there yet; the rows must exist.
    pub fn absent(&self, s: &RowSpan) -> Vec<RowSpan> {
        let mut out = Vec::new();
        self.runs(s.grid, s.row, s.row + s.rows, false, &mut |span| {
            out.push(span);
            true
        });
        out
    }

    /// Notes that rows are there; they must exist.
    pub fn add(&mut self, s: &RowSpan) {
        let bits = &mut self.grids[s.grid as usize].1;
        for row in s.row..s.row + s.rows {
            let (word, bit) = (row as usize / 64, 1 << (row % 64));
            self.there += u64::from(bits[word] & bit == 0);
            bits[word] |= bit;
        }
    }

    /// Up to `most` spans of rows that are there (or not), in order.
    pub fn spans(&self, there: bool, most: usize) -> Vec<RowSpan> {
        let mut out = Vec::new();
        for (grid, (n, _)) in (0u32..).zip(&self.grids) {
            self.runs(grid, 0, *n, there, &mut |span| {
                out.push(span);
                out.len() < most
            });
            if out.len() >= most {
                break;
            }
        }
        out
    }

    /// Calls with each run of rows in `[from, to)` that are there (or not), until told to stop.
    fn runs(&self, grid: u32, from: u64, to: u64, there: bool, each: &mut dyn FnMut(RowSpan) -> bool) {
        let bits = &self.grids[grid as usize].1;
        let is = |row: u64| (bits[row as usize / 64] >> (row % 64) & 1 == 1) == there;
        let mut row = from;
        while row < to {
            // Whole words that hold no such row are passed over at once.
            let passed = if there { 0 } else { u64::MAX };
            if row.is_multiple_of(64) && row + 64 <= to && bits[row as usize / 64] == passed {
                row += 64;
                continue;
            }
            if !is(row) {
                row += 1;
                continue;
            }
            let first = row;
            while row < to && is(row) {
                row += 1;
            }
            if !each(RowSpan { grid, row: first, rows: row - first }) {
                return;
            }
        }
    }
}

/// Spans with those joined that touch.
pub fn joined(mut spans: Vec<RowSpan>) -> Vec<RowSpan> {
    spans.sort_unstable_by_key(|s| (s.grid, s.row));
    let mut out: Vec<RowSpan> = Vec::with_capacity(spans.len());
    for s in spans {
        match out.last_mut() {
            Some(last) if last.grid == s.grid && last.row + last.rows == s.row => last.rows += s.rows,
            _ => out.push(s),
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    fn span(grid: u32, row: u64, rows: u64) -> RowSpan {
        RowSpan { grid, row, rows }
    }

    #[test]
    fn rows_are_counted_once() {
        let mut r = RowSet::new([200, 3]);
        assert!(r.holds(&span(0, 0, 200)) && r.holds(&span(1, 2, 1)));
        for bad in [span(0, 1, 200), span(1, 3, 1), span(2, 0, 1), span(0, 5, 0), span(0, u64::MAX, 2)] {
            assert!(!r.holds(&bad), "{bad:?}");
        }
        r.add(&span(0, 10, 120));
        r.add(&span(0, 100, 50));
        assert_eq!(r.there(), 140);
        assert_eq!(r.absent(&span(0, 0, 200)), [span(0, 0, 10), span(0, 150, 50)]);
        assert_eq!(r.absent(&span(0, 20, 100)), []);
        assert_eq!(r.spans(true, 9), [span(0, 10, 140)]);
        assert_eq!(r.spans(false, 2), [span(0, 0, 10), span(0, 150, 50)]);
        assert_eq!(r.spans(false, 9).len(), 3);
        r.add(&span(0, 0, 200));
        assert!(!r.is_complete());
        r.add(&span(1, 0, 3));
        assert!(r.is_complete());
        assert_eq!(r.spans(false, 9), []);
    }

    #[test]
    fn spans_that_touch_are_joined() {
        let spans = vec![span(1, 0, 1), span(0, 4, 2), span(0, 0, 4), span(0, 7, 1)];
        assert_eq!(joined(spans), [span(0, 0, 6), span(0, 7, 1), span(1, 0, 1)]);
    }
}
