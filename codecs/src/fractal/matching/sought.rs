//! A range and its best match so far.

use super::Match;
use super::frame::Frame;
use super::screen::{Answer, Measure, Question, ROOM};
use super::strip::{LANES, Strip};

/// The best match so far.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Best {
    /// As in [`Match`].
    pub error: f64,
    /// Number of the domain.
    pub domain: usize,
    /// As in [`Match`].
    pub isometry: usize,
    /// As in [`Match`].
    pub scale: i8,
}

/// A range that is not flat.
#[derive(Clone)]
pub struct Sought<const D: usize> {
    /// Its place among those that were asked for.
    pub index: usize,
    /// Its corner.
    pub range: [usize; D],
    /// Sum of the squares of its samples without their mean.
    pub squares: f64,
    /// Whether it is within reach of f32; it is settled already if not.
    pub screened: bool,
    /// Its best match so far.
    pub best: Option<Best>,
}

/// A range as it is screened.
pub struct Range {
    /// Its samples without their mean.
    pub block: Vec<f64>,
    /// Its class, where classes decide.
    pub class: usize,
    /// Its poses, one after the other.
    pub poses: Vec<f32>,
    /// Its length in the unit of the frame.
    pub length: f32,
}

impl<const D: usize> Sought<D> {
    /// The match that was found.
    pub fn found(&self, frame: &Frame<D>) -> Option<Match<D>> {
        self.best.map(|b| Match {
            domain: frame.place(b.domain),
            isometry: b.isometry,
            scale: b.scale,
            error: b.error,
        })
    }

    /// Meets the domains of some lanes of a strip in some poses. `answer` is room to work in.
    pub fn meet(
        &mut self,
        frame: &Frame<D>,
        range: &Range,
        chosen: &[usize],
        strip: &Strip,
        lanes: std::ops::Range<usize>,
        answer: &mut Answer,
    ) {
        let measure = Measure::new(&frame.poses, range.length, frame.level.scales);
        let (at, needed) = (lanes.start, self.needed());
        let question = Question { poses: &range.poses, chosen, measure, strip, at, needed };
        question.answer(&frame.poses, lanes.len(), answer);
        for first in &answer.enough {
            for (k, gain) in answer.gains[*first..][..LANES].iter().enumerate() {
                if *gain > self.needed() && lanes.contains(&(at + first + k)) {
                    self.try_lane(frame, range, chosen, strip, at + first + k, measure);
                }
            }
        }
    }

    /// Whether domains of a strip, in the order of their lengths, may beat the best.
    #[inline]
    pub fn may_gain(&self, frame: &Frame<D>, range: &Range, strip: &Strip) -> bool {
        Measure::new(&frame.poses, range.length, frame.level.scales).most(strip.lengths[0], strip.longest())
            > self.needed()
    }

    /// What a pair must gain, as it is screened, to be tried.
    #[inline]
    fn needed(&self) -> f32 {
        self.best.map_or(0.0, |b| (1.0 - b.error / self.squares - ROOM).max(0.0) as f32)
    }

    /// The isometries by which one domain may beat the best.
    fn try_lane(
        &mut self,
        frame: &Frame<D>,
        range: &Range,
        chosen: &[usize],
        strip: &Strip,
        lane: usize,
        measure: Measure,
    ) {
        let poses = &frame.poses;
        let (length, inverse) = (strip.lengths[lane], strip.inverses[lane]);
        for p in chosen {
            let mut parts = [0.0_f32; 8];
            let mut at = lane;
            for some in range.poses[p * poses.rows..][..poses.rows].chunks_exact(poses.parts) {
                for (sum, r) in parts.iter_mut().zip(some) {
                    *sum += r * strip.samples[at];
                    at += strip.stride;
                }
            }
            if poses.mirrors {
                for axis in (0..D).map(|a| 1 << a) {
                    for k in (0..1 << D).filter(|k| k & axis == 0) {
                        (parts[k], parts[k | axis]) =
                            (parts[k] + parts[k | axis], parts[k] - parts[k | axis]);
                    }
                }
            } else {
                parts[0] = parts.iter().sum();
            }
            for (isometry, correlation) in poses.poses[*p].isometries.iter().zip(parts) {
                let Some(isometry) = *isometry else { continue };
                if measure.gain(correlation.abs(), length, inverse) > self.needed() {
                    self.try_pair(frame, range, strip, lane, isometry);
                }
            }
        }
    }

    /// A pair, as in the plain form.
    fn try_pair(&mut self, frame: &Frame<D>, range: &Range, strip: &Strip, lane: usize, isometry: usize) {
        let (domain, mean, squares) = (strip.domains[lane], strip.means[lane], strip.squares[lane]);
        let values = &frame.level.half.values[frame.first(domain)..];
        let pairs = frame.places[isometry].iter().zip(&frame.offsets);
        let product = pairs.map(|(p, o)| range.block[*p as usize] * (values[*o] - mean)).sum::<f64>();
        let scale = frame.level.scales.nearest(product, squares);
        let error = frame.level.scales.error(scale, self.squares, product, squares);
        let better = match self.best {
            None => error < self.squares,
            Some(b) => error < b.error || error == b.error && (domain, isometry) < (b.domain, b.isometry),
        };
        if scale != 0 && better {
            self.best = Some(Best { error, domain, isometry, scale });
        }
    }
}
