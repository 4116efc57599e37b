//! The order of the four quadrants of a block by their means: 24 classes.
//!
//! The class of a block is the list of its quadrants from the least mean to the greatest, equal ones by their number. An isometry moves the
//! quadrants, and the list with them: of the eight one gives a domain the list of the range (for s > 0), one the reversed list (for s < 0), if
//! the classes are in the same of the three orbits; otherwise none does.

use super::super::isometry::Isometry;
use super::frame::Frame;

/// Quadrants from the least mean to the greatest; quadrant 1 lies along the first axis, 2 along the second.
type Order = [usize; 4];

/// How many there are.
pub const CLASSES: usize = 24;

/// The classes of blocks of one side.
pub struct Classes {
    side: usize,
    orders: Vec<Order>,
    /// The isometries, for each class of the range and then of the domain.
    met: Vec<Vec<usize>>,
}

impl Classes {
    /// For blocks of a side.
    pub fn new<const D: usize>(isometries: &[Isometry<D>], side: usize) -> Classes {
        let all = (0..256).map(|k| [k >> 6, k >> 4 & 3, k >> 2 & 3, k & 3]);
        let orders: Vec<Order> = all.filter(|o| (0..4).all(|q| o.contains(&q))).collect();
        let mut met = vec![Vec::new(); CLASSES * CLASSES];
        let places: Vec<Vec<u32>> = isometries.iter().map(|i| i.places(2)).collect();
        for (r, range) in orders.iter().enumerate() {
            for (d, domain) in orders.iter().enumerate() {
                for (k, places) in places.iter().enumerate() {
                    let turned = domain.map(|q| places.iter().position(|p| *p as usize == q).unwrap_or(q));
                    let reversed = [turned[3], turned[2], turned[1], turned[0]];
                    if turned == *range || reversed == *range {
                        met[r * CLASSES + d].push(k);
                    }
                }
            }
        }
        Classes { side, orders, met }
    }

    /// The class of a block.
    pub fn of(&self, block: &[f64]) -> usize {
        let half = self.side / 2;
        let mut sums = [0.0; 4];
        for (k, v) in block.iter().enumerate() {
            sums[usize::from(k % self.side >= half) + 2 * usize::from(k / self.side >= half)] += v;
        }
        let mut order: Order = [0, 1, 2, 3];
        order.sort_by(|a, b| f64::total_cmp(&sums[*a], &sums[*b]));
        self.orders.iter().position(|o| *o == order).unwrap_or(0)
    }

    /// In which isometries a range meets a domain, by their classes.
    pub fn met(&self, range: usize, domain: usize) -> &[usize] {
        &self.met[range * CLASSES + domain]
    }
}

/// How many pairs of a domain and an isometry the ranges meet.
pub fn pairs<const D: usize>(frame: &Frame<D>, ranges: &[[usize; D]]) -> u64 {
    let Some(classes) = &frame.classes else { return 0 };
    let mut domains = [0; CLASSES];
    (0..frame.level.domains.len()).for_each(|k| domains[classes.of(&frame.raw(k))] += 1);
    let mut block = vec![0.0; frame.samples];
    let mut met = |range: &[usize; D]| {
        frame.level.grid.block(*range, frame.level.domains.side, &mut block);
        let class = classes.of(&block);
        domains.iter().enumerate().map(|(d, n)| n * classes.met(class, d).len() as u64).sum::<u64>()
    };
    ranges.iter().map(&mut met).sum()
}
