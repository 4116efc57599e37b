//! Pieces of border between a survey and better ones.

use super::{RAMP_SLOPE, REACH_MAX, REACH_MIN, SLOPE, SPREAD, Spans, ramp, square};

/// A piece of border between a survey and better ones.
#[derive(Clone, Debug, PartialEq)]
pub struct Piece {
    /// Its middle, in cells from the corner of the place it belongs to.
    pub at: [f64; 2],
    pub length: f64,
    /// Half the cell it is a side of.
    pub ease: f64,
    /// What the better survey has above this one, metres; NaN where this one has no height, or for a piece of its own
    /// border inside the better ones: such a piece only counts for distances and for what is shown.
    pub gap: f64,
    /// The two surveys differ by more than both state.
    pub contradicted: bool,
    pub spans: Spans,
}

/// The pieces of one place.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Border {
    pub pieces: Vec<Piece>,
}

/// Pieces of one place, at most: where a border is more ragged, neighbouring pieces become one.
const PIECES_MAX: usize = 2048;
/// Pieces shorter than this become one with their neighbours, in cells: nodes carry no finer detail.
const PIECE_MIN: f64 = 0.125;

/// Pieces that are held before they are joined.
const RAW_MAX: usize = 8 * PIECES_MAX;

/// Gathers the pieces of a place, in a fixed order. However fine the better survey is, few are held: whenever there are
/// more than [`RAW_MAX`], they are joined. So the numbers of a border depend on the order of its pieces only.
pub struct Gathering {
    pieces: Vec<Piece>,
    /// Of the squares whose pieces are joined, in cells.
    side: f64,
    /// Some pieces are shorter than [`PIECE_MIN`].
    short: bool,
    /// Join when there are more.
    limit: usize,
}

impl Default for Gathering {
    fn default() -> Gathering {
        Gathering { pieces: Vec::new(), side: PIECE_MIN, short: false, limit: RAW_MAX }
    }
}

impl Gathering {
    pub fn push(&mut self, piece: Piece) {
        self.short |= piece.length < PIECE_MIN * 0.999;
        self.pieces.push(piece);
        if self.pieces.len() > self.limit {
            self.join();
            // Pieces in whole cells that differ in what is shown cannot be fewer.
            self.limit = RAW_MAX.max(2 * self.pieces.len());
        }
    }

    fn join(&mut self) {
        if self.short {
            self.pieces = join(&self.pieces, self.side);
        }
        while self.pieces.len() > PIECES_MAX && self.side < 1.0 {
            self.side *= 2.0;
            self.pieces = join(&self.pieces, self.side);
        }
    }

    /// Pieces that are much shorter than a cell are joined.
    pub fn border(mut self) -> Border {
        self.join();
        Border { pieces: self.pieces }
    }
}

impl Border {
    /// Bytes it holds, for caches.
    pub fn weight(&self) -> u64 {
        64 + (std::mem::size_of::<Piece>() * self.pieces.len()) as u64
    }

    /// How far each gap is carried, in cells (B of section 15.1): the larger the gaps around, the further, so that no
    /// slope above [`SLOPE`] is added. `around`: this border and its eight neighbours, each with the place of its corner.
    pub fn reaches(&self, around: &[([f64; 2], &Border)], metres_per_cell: f64) -> Vec<f64> {
        // At a pole a cell of degrees has no width.
        let metres_per_cell = metres_per_cell.max(1e-9);
        let mut near: Vec<([f64; 2], f64)> = Vec::new();
        for (corner, border) in around {
            for p in border.pieces.iter().filter(|p| !p.gap.is_nan()) {
                let at = [corner[0] + p.at[0], corner[1] + p.at[1]];
                if at.iter().all(|c| (-SPREAD..=REACH_MAX + SPREAD).contains(c)) {
                    near.push((at, p.gap.abs()));
                }
            }
        }
        self.pieces
            .iter()
            .map(|p| {
                let most = near.iter().fold(0.0f64, |most, (at, gap)| {
                    let r2 = square(p.at, *at);
                    if *gap <= most || r2 >= SPREAD * SPREAD {
                        return most;
                    }
                    most.max(gap * (1.0 - ramp(r2.sqrt() / SPREAD)))
                });
                (RAMP_SLOPE / SLOPE * most / metres_per_cell).clamp(REACH_MIN, REACH_MAX)
            })
            .collect()
    }
}

/// Joins the pieces within squares of a side: lengths add, gaps and places are means by length.
fn join(pieces: &[Piece], side: f64) -> Vec<Piece> {
    let mut squares: std::collections::BTreeMap<_, Piece> = Default::default();
    for p in pieces {
        let bits: Vec<[u32; 2]> = p.spans.iter().map(|s| s.map(f32::to_bits)).collect();
        let key = (p.at.map(|c| (c / side).floor() as i32), p.gap.is_nan(), bits);
        match squares.entry(key) {
            std::collections::btree_map::Entry::Vacant(e) => {
                e.insert(Piece { ease: p.ease.max(side / 2.0), ..p.clone() });
            }
            std::collections::btree_map::Entry::Occupied(mut e) => {
                let q = e.get_mut();
                let t = p.length / (q.length + p.length);
                q.at = [0, 1].map(|k| q.at[k] + (p.at[k] - q.at[k]) * t);
                q.gap += (p.gap - q.gap) * t;
                q.length += p.length;
                q.ease = q.ease.max(p.ease);
                q.contradicted |= p.contradicted;
            }
        }
    }
    squares.into_values().collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn border(pieces: Vec<Piece>) -> Border {
        let mut all = Gathering::default();
        pieces.into_iter().for_each(|p| all.push(p));
        all.border()
    }

    #[test]
    fn few_pieces_are_held_of_a_survey_that_is_far_finer() {
        // A comb of posts of 0.5 m over cells of 90 m: 180 sides a cell.
        let mut all = Gathering::default();
        let (mut held, mut length, mut gaps) = (0, 0.0, 0.0);
        for k in 0..1_000_000 {
            let at = f64::from(k) / 1e6 * 28.0;
            let p = piece(at, at * 97.0 % 28.0, 1.0 / 180.0, f64::from(k % 11));
            length += p.length;
            gaps += p.length * p.gap;
            all.push(p);
            held = held.max(all.pieces.len());
        }
        let b = all.border();
        assert!(held <= RAW_MAX && b.pieces.len() <= PIECES_MAX, "{held} held, {} left", b.pieces.len());
        assert!((b.pieces.iter().map(|p| p.length).sum::<f64>() / length - 1.0).abs() < 1e-9);
        assert!((b.pieces.iter().map(|p| p.length * p.gap).sum::<f64>() / gaps - 1.0).abs() < 1e-9);
    }

    fn piece(x: f64, y: f64, length: f64, gap: f64) -> Piece {
        let spans = super::super::spans(vec![[0.0, f32::INFINITY]], 0.0);
        Piece { at: [x, y], length, ease: length / 2.0, gap, contradicted: gap > 5.0, spans }
    }

    #[test]
    fn ragged_borders_become_fewer_pieces_of_the_same_length_and_mean() {
        let fine: Vec<Piece> = (0..5000)
            .map(|k| piece(f64::from(k % 500) * 0.05, f64::from(k / 500), 0.05, f64::from(k % 7)))
            .collect();
        let length: f64 = fine.iter().map(|p| p.length).sum();
        let mean = |p: &[Piece]| p.iter().map(|p| p.length * p.gap).sum::<f64>() / length;
        let whole = mean(&fine);
        let joined = border(fine);
        assert!(joined.pieces.len() <= PIECES_MAX && joined.pieces.len() > 1000);
        assert!((joined.pieces.iter().map(|p| p.length).sum::<f64>() - length).abs() < 1e-9);
        assert!((mean(&joined.pieces) - whole).abs() < 1e-9);
        assert!(joined.pieces.iter().any(|p| p.contradicted));
        // Pieces of a fifth of a cell are left as they are.
        let few = border((0..100).map(|k| piece(f64::from(k) * 0.2, 3.0, 0.2, 1.0)).collect());
        assert_eq!(few.pieces.len(), 100);
    }

    #[test]
    fn a_gap_is_carried_as_far_as_its_slope_allows() {
        let border = border(vec![piece(1.0, 1.0, 1.0, 0.2), piece(20.0, 1.0, 1.0, -16.0)]);
        let none = Border::default();
        let near: Vec<([f64; 2], &Border)> = vec![([-28.0, 0.0], &none), ([0.0, 0.0], &border)];
        // Cells of 10 m: 16 m over 200 m is a slope of 0.15 at its steepest.
        assert_eq!(border.reaches(&near, 10.0), [4.0, 20.0]);
        assert_eq!(border.reaches(&near, 1.0), [4.0, 28.0]);
    }
}
