//! Surveys that were delivered in another system: their posts, block by block, from the union of their tiles.

use super::build::Builder;
use super::change::Progress;
use super::head::Declaration;
use super::tile::blocks_of;
use crate::base::Result;
use crate::height::block::encode;
use crate::height::crs::{AxisUnit, Crs, DatumChoice, Transform};
use crate::height::frame::{CellRect, LatticeUnit};
use crate::height::resample::Warp;
use crate::store::segment::{Files, SegmentWriter};
use crate::store::table::{PageAddress, block_slot};
use rayon::prelude::*;
use std::collections::BTreeSet;

/// The way from a survey's delivered posts to its own; `None` if they are the same.
pub fn warp_of(d: &Declaration) -> Result<Option<Warp>> {
    let Some(r) = &d.resampled else { return Ok(None) };
    let (from, to) = (Crs::parse(&r.crs)?, Crs::parse(&d.crs)?);
    let transform = Transform::new(&from, &to, &DatumChoice::parse(&r.datum)?)?;
    let degrees = [from.unit == AxisUnit::Degree, to.unit == AxisUnit::Degree];
    Ok(Some(Warp::new(r.lattice, d.lattice, LatticeUnit::for_crs(&to), transform, r.turn, degrees)?))
}

/// What resampling did to the samples: absolute differences between the survey's surface and the delivered samples, at
/// those. It says nothing about accuracy, and is in no stated error.
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Resampling {
    /// Delivered posts that lie within the resampled ones.
    pub posts: u64,
    pub mean_m: f64,
    /// 99 % of the differences are no larger (to within 1 %).
    pub p99_m: f64,
    pub max_m: f64,
}

/// Differences, gathered: counted by the upper 16 bits of a `f32`, so each count holds values within 1 %.
struct Counts {
    bins: Vec<u64>,
    posts: u64,
    sum: f64,
    max: f64,
}

impl Counts {
    fn new() -> Counts {
        Counts { bins: vec![0; 1 << 16], posts: 0, sum: 0.0, max: 0.0 }
    }

    fn add(&mut self, differences: &[f64]) {
        for d in differences {
            self.bins[((*d as f32).to_bits() >> 16) as usize] += 1;
            self.posts += 1;
            self.sum += d;
            self.max = self.max.max(*d);
        }
    }

    fn finish(&self) -> Resampling {
        let rank = (self.posts as f64 * 0.99).ceil() as u64;
        let mut seen = 0;
        let bin = self.bins.iter().position(|n| {
            seen += n;
            seen >= rank
        });
        // The upper end of the bin.
        let p99 = f64::from(f32::from_bits(((bin.unwrap_or(0) as u32) << 16) | 0xffff));
        Resampling {
            posts: self.posts,
            mean_m: if self.posts == 0 { 0.0 } else { self.sum / self.posts as f64 },
            p99_m: p99.min(self.max),
            max_m: self.max,
        }
    }
}

impl Builder<'_> {
    /// Resamples the blocks of posts that dirty samples can change.
    pub(super) fn resample(
        &mut self,
        warp: &Warp,
        base: &Files,
        out: &mut SegmentWriter,
        progress: &Progress,
    ) -> Result<()> {
        let blocks = blocks_of(&self.dirty);
        let extent = self.delivered_posts();
        for bj in blocks.j0..blocks.j1 {
            progress.step("resampling", (bj - blocks.j0) as f64 / blocks.height() as f64)?;
            let row: Vec<Option<Vec<u8>>> = self.with_reader(base, out, |reader| {
                (blocks.i0..blocks.i1)
                    .into_par_iter()
                    .map(|bi| {
                        let posts = |r: &CellRect| reader.delivered_posts(r);
                        let none = |r: &CellRect| reader.delivered_is_void(r);
                        Ok(warp.block(bi, bj, &extent, &posts, &none)?.map(|b| encode(&b)))
                    })
                    .collect()
            })?;
            for (k, bytes) in row.into_iter().enumerate() {
                let bi = blocks.i0 + k as i64;
                let at = bytes.map(|b| out.append(&b)).transpose()?;
                self.set_block(0, bi, bj, at);
                let address = PageAddress::of_block(0, bi, bj);
                if at.is_some() || self.knows(address)? {
                    self.edit(address)?.blocks[block_slot(bi, bj)] = at;
                }
            }
        }
        Ok(())
    }

    /// Compares the posts with the delivered samples among those that changed.
    pub(super) fn compare(
        &self,
        warp: &Warp,
        delivered: &[CellRect],
        base: &Files,
        out: &SegmentWriter,
        progress: &Progress,
    ) -> Result<Resampling> {
        let blocks: BTreeSet<(i64, i64)> = delivered
            .iter()
            .map(blocks_of)
            .flat_map(|b| (b.j0..b.j1).flat_map(move |bj| (b.i0..b.i1).map(move |bi| (bj, bi))))
            .collect();
        let blocks: Vec<(i64, i64)> = blocks.into_iter().collect();
        let mut counts = Counts::new();
        self.with_reader(base, out, |reader| {
            for (n, some) in blocks.chunks(64).enumerate() {
                progress.step("comparing", n as f64 * 64.0 / blocks.len() as f64)?;
                let found: Vec<Vec<f64>> = some
                    .into_par_iter()
                    .map(|(bj, bi)| {
                        let mut found = Vec::new();
                        let (source, target) =
                            (|r: &CellRect| reader.delivered_posts(r), |r: &CellRect| reader.posts(r));
                        warp.differences(*bi, *bj, &source, &target, |d| found.push(d))?;
                        Ok(found)
                    })
                    .collect::<Result<_>>()?;
                found.iter().for_each(|d| counts.add(d));
            }
            Ok(())
        })?;
        Ok(counts.finish())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn counts_know_mean_percentile_and_maximum() {
        let mut c = Counts::new();
        c.add(&(1..=1000).map(f64::from).collect::<Vec<f64>>());
        let r = c.finish();
        assert_eq!((r.posts, r.mean_m, r.max_m), (1000, 500.5, 1000.0));
        assert!((990.0..=1000.0).contains(&r.p99_m), "{}", r.p99_m);
        assert_eq!(Counts::new().finish(), Resampling::default());
    }
}
