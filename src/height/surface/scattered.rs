//! The surface at scattered points: in order of place, so that neighbours share what they need.

use super::lanes::RUN;
use super::run::Runs;
use super::{Band, Sheet, Surface};
use crate::base::Result;

/// Points in the order in which a surface is best asked for them.
pub struct Ordered {
    /// Those with the same list of patches side by side, among themselves as they were.
    pub points: Vec<[f64; 2]>,
    /// Which they are.
    pub numbers: Vec<u32>,
}

impl Surface {
    fn square(&self, p: [f64; 2]) -> u32 {
        self.index.number([p[0] - self.origin[0], p[1] - self.origin[1]])
    }

    /// Brings points into order, at most 2^32. Costs a pass over points and lists; of few points, a sort.
    pub fn order(&self, points: &[[f64; 2]]) -> Ordered {
        let squares = self.index.len();
        if points.len() < squares / 4 {
            let key = |(k, p): (usize, &[f64; 2])| u64::from(self.square(*p)) << 32 | k as u64;
            let mut keys: Vec<u64> = points.iter().enumerate().map(key).collect();
            keys.sort_unstable();
            let numbers: Vec<u32> = keys.into_iter().map(|k| k as u32).collect();
            return Ordered { points: numbers.iter().map(|k| points[*k as usize]).collect(), numbers };
        }
        let found: Vec<u32> = points.iter().map(|p| self.square(*p)).collect();
        let mut next = vec![0u32; squares.max(1)];
        found.iter().for_each(|s| next[*s as usize] += 1);
        let mut total = 0;
        for n in &mut next {
            (*n, total) = (total, total + *n);
        }
        let mut ordered = Ordered { points: vec![[0.0; 2]; points.len()], numbers: vec![0; points.len()] };
        for (k, (s, p)) in found.iter().zip(points).enumerate() {
            let at = next[*s as usize] as usize;
            next[*s as usize] += 1;
            (ordered.points[at], ordered.numbers[at]) = (*p, k as u32);
        }
        ordered
    }
}

impl Sheet<'_> {
    /// Heights at points (CRS units), in order, into a band of as many. Fastest where points that are near each other follow
    /// each other ([`Surface::order`]).
    pub fn scattered(&self, points: &[[f64; 2]], band: &mut Band) -> Result<()> {
        let (surface, mut s) = (self.surface, Runs::default());
        let mut first = 0;
        while first < points.len() {
            let here = surface.square(points[first]);
            let most = RUN.min(points.len() - first);
            let n = (1..most).find(|k| surface.square(points[first + k]) != here).unwrap_or(most);
            self.run(&points[first..first + n], surface.index.list(here), &mut s, band, |k| first + k)?;
            first += n;
        }
        Ok(())
    }
}
