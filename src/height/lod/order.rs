//! The strict total order of patches (section 1 of the LOD-space specification).

use super::PatchId;
use std::cmp::Ordering;

/// What decides which of two patches is greater: nominal area, then smaller error, then smaller key.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rank {
    pub area: f64,
    pub bot: f32,
    pub id: PatchId,
}

impl Eq for Rank {}

impl PartialOrd for Rank {
    fn partial_cmp(&self, other: &Rank) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl Ord for Rank {
    fn cmp(&self, other: &Rank) -> Ordering {
        self.area
            .total_cmp(&other.area)
            .then_with(|| other.bot.total_cmp(&self.bot))
            .then_with(|| other.id.cmp(&self.id))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn larger_then_more_accurate_then_smaller_key_is_greater() {
        let r = |area, bot, k| Rank { area, bot, id: PatchId([k; 16]) };
        assert!(r(2.0, 9.0, 9) > r(1.0, 0.0, 0));
        assert!(r(1.0, 1.0, 9) > r(1.0, 2.0, 0));
        assert!(r(1.0, 1.0, 1) > r(1.0, 1.0, 2));
        assert_eq!(r(1.0, 1.0, 1).cmp(&r(1.0, 1.0, 1)), Ordering::Equal);
    }
}
