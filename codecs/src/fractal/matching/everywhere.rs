//! Each range meets all domains, or all of its classes.
//!
//! Ranges and domains are taken by their lengths: a strip whose domains are all too short or too long for a range, even were they like it, is
//! passed over, and those that fit best come first.

use super::frame::Frame;
use super::screen::Answer;
use super::sought::{Range, Sought};
use super::strip::{LANES, Strip, centred, firsts};
use super::{BATCH, collect, plain};
use crate::Result;
use crate::work::{self, Workers};

/// Numbers of domains that are laid out at once: 16 MiB. In tests small grids shall fall into parts as well.
const NUMBERS: usize = if cfg!(test) { 5000 } else { 4 << 20 };

/// Numbers of the domains of a strip, what the nearest memory holds; and the most domains.
const STRIP: (usize, usize) = (4096, 256);

/// Numbers of the ranges of one part of the work, in one pose; the fewest and the most ranges.
const PART: (usize, usize, usize) = (16_384, 8, 64);

/// Domains of one part of the work.
const DOMAINS: usize = 1024;

/// Fills in the best matches among all domains.
pub fn search<const D: usize>(
    frame: &Frame<D>,
    sought: &mut Vec<Sought<D>>,
    workers: &dyn Workers,
) -> Result<()> {
    let rows = frame.poses.rows;
    let domains = frame.level.domains.len();
    // Besides its samples a domain takes the room of some 16.
    let chunk = (NUMBERS / (rows + 16)).max(LANES);
    let part = (PART.0 / rows).clamp(PART.1, PART.2);
    sought.sort_by(|a, b| f64::total_cmp(&a.squares, &b.squares));
    for begin in (0..domains).step_by(chunk) {
        let end = domains.min(begin + chunk);
        let share = |ranges: usize, of: usize| {
            (begin as f64 + (end - begin) as f64 * ranges as f64 / of as f64) / domains as f64
        };
        work::check(workers, share(0, 1))?;
        let strips = strips(frame, begin, end, workers);
        let lanes: usize = strips.iter().map(|(_, s)| s.stride).sum();
        let each = (lanes * rows).saturating_mul(frame.poses.poses.len() * part);
        let batch = part * (BATCH / each.max(1)).max(16);
        let mut out = Vec::with_capacity(sought.len());
        for (k, ranges) in sought.chunks(batch).enumerate() {
            work::check(workers, share(k * batch, sought.len()))?;
            let parts: Vec<&[Sought<D>]> = ranges.chunks(part).collect();
            out.extend(collect(workers, parts.len(), &|k| meet(frame, parts[k], &strips)).flatten());
        }
        *sought = out;
    }
    Ok(())
}

/// Some ranges meet the domains of some strips.
fn meet<const D: usize>(frame: &Frame<D>, sought: &[Sought<D>], strips: &[(usize, Strip)]) -> Vec<Sought<D>> {
    let mut sought = sought.to_vec();
    let ranges: Vec<Option<Range>> = sought.iter().map(|s| s.screened.then(|| frame.range(s))).collect();
    let all: Vec<usize> = (0..frame.poses.poses.len()).collect();
    let mut answer = Answer::default();
    let middle = ranges.get(ranges.len() / 2).and_then(|r| Some(r.as_ref()?.length)).unwrap_or(1.0);
    // The shortest that are as long as the range have the finest steps of s.
    let mut order: Vec<(f32, &(usize, Strip))> = strips
        .iter()
        .map(|s| {
            let length = s.1.longest();
            (if length < middle { 8.0 * middle / length } else { length / middle }, s)
        })
        .collect();
    order.sort_by(|a, b| f32::total_cmp(&a.0, &b.0));
    for (_, (class, strip)) in order {
        for (sought, range) in sought.iter_mut().zip(&ranges) {
            let Some(range) = range else { continue };
            let chosen = frame.classes.as_ref().map_or(&*all, |c| c.met(range.class, *class));
            if !chosen.is_empty() && sought.may_gain(frame, range, strip) {
                sought.meet(frame, range, chosen, strip, 0..strip.domains.len(), &mut answer);
            }
        }
    }
    sought
}

/// Domains laid side by side, with their class; flat ones are left out, and of those that are the same all but the first.
fn strips<const D: usize>(
    frame: &Frame<D>,
    begin: usize,
    end: usize,
    workers: &dyn Workers,
) -> Vec<(usize, Strip)> {
    let parts = (end - begin).div_ceil(DOMAINS);
    let part = |k: usize| digests(frame, begin + k * DOMAINS, end.min(begin + (k + 1) * DOMAINS));
    let mut digests: Vec<Digest> = collect(workers, parts, &part).flatten().collect();
    digests.sort_unstable();
    let mut kept = Vec::with_capacity(digests.len());
    for same in digests.chunk_by(|a, b| (a.class, a.hash) == (b.class, b.hash)) {
        let first = block(frame, same[0].domain);
        kept.push(same[0]);
        for other in &same[1..] {
            if block(frame, other.domain) != first {
                kept.push(*other);
            }
        }
    }
    kept.sort_unstable_by_key(|d| (d.class, d.squares, d.domain));
    let long = (STRIP.0 / frame.poses.rows).clamp(LANES, STRIP.1).next_multiple_of(LANES);
    let of_class = kept.chunk_by(|a, b| a.class == b.class);
    let parts: Vec<&[Digest]> = of_class.flat_map(|c| c.chunks(long)).collect();
    let lay =
        |k: usize| (parts[k][0].class, Strip::new(frame, parts[k].iter().map(|d| d.domain).collect(), 0));
    collect(workers, parts.len(), &lay).collect()
}

/// A domain, and what tells it from others: in the order of classes, then of hashes, then of numbers.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
struct Digest {
    class: usize,
    hash: u64,
    domain: usize,
    /// The bits of the sum of its squares, which are in the order of the sums.
    squares: u64,
}

/// Those of the domains from `begin` to `end` that are not flat.
fn digests<const D: usize>(frame: &Frame<D>, begin: usize, end: usize) -> Vec<Digest> {
    let mut out = Vec::with_capacity(end - begin);
    let mut blocks = vec![[0.0; LANES]; frame.samples];
    let domains: Vec<usize> = (begin..end).collect();
    for domains in domains.chunks(LANES) {
        let firsts = firsts(frame, domains);
        let (_, squares) = centred(&frame.level.half.values, &firsts, &frame.offsets, &mut blocks);
        let mut hashes = [0; LANES];
        for row in &blocks {
            for (hash, v) in hashes.iter_mut().zip(row) {
                // Multiplied by an odd number near 2^64 over the golden ratio, which spreads the bits.
                *hash = (u64::rotate_left(*hash, 23) ^ v.to_bits()).wrapping_mul(0x9e37_79b9_7f4a_7c15);
            }
        }
        for ((domain, squares), hash) in domains.iter().zip(squares).zip(hashes) {
            if frame.length(squares).is_some() {
                let class = frame.classes.as_ref().map_or(0, |c| c.of(&frame.raw(*domain)));
                out.push(Digest { class, hash, domain: *domain, squares: squares.to_bits() });
            }
        }
    }
    out
}

/// The samples of a domain without their mean.
fn block<const D: usize>(frame: &Frame<D>, domain: usize) -> Vec<f64> {
    let mut out = frame.raw(domain);
    plain::centre(&mut out);
    out
}
