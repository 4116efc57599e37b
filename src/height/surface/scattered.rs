//! The surface at scattered points: in order of place, so that neighbours share what they need.

use super::lanes::RUN;
use super::run::Runs;
use super::{Band, Sheet, Surface};
use crate::base::Result;

impl Surface {
    /// The numbers of points in the order in which [`Sheet::scattered`] wants them: those with the same list of patches side by
    /// side, among themselves as they were. At most 2^32 points. Costs a pass over points and lists; of few points, a sort.
    pub fn order(&self, points: &[[f64; 2]]) -> Vec<u32> {
        let square = |p: &[f64; 2]| self.index.number([p[0] - self.origin[0], p[1] - self.origin[1]]);
        let squares = self.index.len();
        if points.len() < squares / 4 {
            let mut keys: Vec<u64> =
                points.iter().enumerate().map(|(k, p)| u64::from(square(p)) << 32 | k as u64).collect();
            keys.sort_unstable();
            return keys.into_iter().map(|k| k as u32).collect();
        }
        let found: Vec<u32> = points.iter().map(square).collect();
        let mut next = vec![0u32; squares.max(1)];
        found.iter().for_each(|s| next[*s as usize] += 1);
        let mut total = 0;
        for n in &mut next {
            (*n, total) = (total, total + *n);
        }
        let mut order = vec![0; points.len()];
        for (k, s) in found.iter().enumerate() {
            let at = &mut next[*s as usize];
            order[*at as usize] = k as u32;
            *at += 1;
        }
        order
    }
}

impl Sheet<'_> {
    /// Heights at the points (CRS units) that `order` names, in that order, into a band of as many. Fastest where points
    /// that are near each other follow each other ([`Surface::order`]).
    pub fn scattered(&self, points: &[[f64; 2]], order: &[u32], band: &mut Band) -> Result<()> {
        let (surface, mut s) = (self.surface, Runs::default());
        let mut run = [[0.0; 2]; RUN];
        let mut first = 0;
        let square = |p: [f64; 2]| surface.index.number([p[0] - surface.origin[0], p[1] - surface.origin[1]]);
        while first < order.len() {
            let here = square(points[order[first] as usize]);
            let mut n = 0;
            for k in order[first..].iter().take(RUN) {
                run[n] = points[*k as usize];
                if square(run[n]) != here {
                    break;
                }
                n += 1;
            }
            self.run(&run[..n], surface.index.list(here), &mut s, band, |k| first + k)?;
            first += n;
        }
        Ok(())
    }
}
