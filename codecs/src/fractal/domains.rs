//! Where domains lie: cubes of side 2r at multiples of the jump, wholly inside the tile.

/// The domains for ranges of one side.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Domains<const D: usize> {
    /// Side r of the ranges; domains are twice as large.
    pub side: usize,
    /// Distance of neighbours along each axis; even.
    pub jump: usize,
    /// How many there are along each axis.
    pub count: [usize; D],
}

impl<const D: usize> Domains<D> {
    /// Those of a tile of `size`. None where the tile is smaller than one.
    pub fn new(size: [usize; D], side: usize, jump: usize) -> Domains<D> {
        let count = size.map(|n| if n < 2 * side { 0 } else { (n - 2 * side) / jump + 1 });
        let count = if count.contains(&0) { [0; D] } else { count };
        Domains { side, jump, count }
    }

    /// How many.
    pub fn len(&self) -> usize {
        self.count.iter().product()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The corner, in cells of the tile, of a domain by its place among the others.
    #[inline(always)]
    pub fn corner(&self, place: [usize; D]) -> [usize; D] {
        place.map(|p| p * self.jump)
    }

    /// The first place of the `width` x `width` domains round a range; fewer where the tile ends.
    pub fn near(&self, range: [usize; D], width: usize) -> ([usize; D], [usize; D]) {
        let mut first = [0; D];
        let mut count = [0; D];
        for a in 0..D {
            let n = width.min(self.count[a]);
            // A domain is centred on the range if it begins half a range before it.
            let centre = (range[a] + self.jump / 2).saturating_sub(self.side / 2) / self.jump;
            first[a] = centre.saturating_sub(width / 2).min(self.count[a] - n);
            count[a] = n;
        }
        (first, count)
    }
}
