//! Acceptance G-e: any prefix is a surface, as good as its bound says.

use crate::support::grids::{self, Grid};
use crate::support::random::Random;
use crate::support::streams::{DENSE, coded, every, read, whole, wrong};
use terraquilt_codecs::Error;
use terraquilt_codecs::gtb::{Decoded, Encoded, Heights, Stop, surface};

/// Every byte: an error until the corners are there, then surfaces within their bounds, which only get better.
fn every_byte(name: &str, heights: &Heights, encoded: &Encoded) {
    let mut bound = u32::MAX;
    for cut in 0..=encoded.bytes.len() {
        match read(&encoded.bytes[..cut], Stop::End) {
            Ok(d) => {
                let (most, _) = wrong(heights, &d);
                assert!(most <= f64::from(d.bound), "{name}, {cut} bytes: {most}, {} was promised", d.bound);
                assert!(cut == encoded.bytes.len() || !d.complete, "{name}: {cut} bytes are whole");
                assert!(d.bytes_used as usize <= cut);
                bound = d.bound;
            }
            Err(Error::Short { .. }) => {
                assert_eq!(bound, u32::MAX, "{name}: {cut} bytes are too few, fewer were not")
            }
            Err(e) => panic!("{name}, {cut} bytes: {e}"),
        }
    }
    assert!(bound < u32::MAX);
}

#[test]
fn every_byte_of_small_tiles() {
    let crater = grids::bundled("crater_2005-06-15_10m");
    let ragged = grids::bundled("survey_2004-10-04_native");
    for profile in DENSE {
        for layers in [&[0][..], &[5], &[13, 4, 1]] {
            for (name, heights) in [
                ("a square that fits", crater.cut(120, 200, 33, 33)),
                ("a rectangle", crater.cut(90, 190, 29, 18)),
                ("voids", ragged.cut(20, 20, 40, 30)),
                ("one row", crater.cut(30, 30, 60, 1)),
                ("one post", crater.cut(3, 3, 1, 1)),
            ] {
                every_byte(name, &heights, &coded(&heights, profile, layers));
            }
        }
    }
}

/// Passes of few posts, 17 x 17 in all: after one of them a surface that was right by chance may be a little worse.
const FEW: usize = 8;

/// The root mean square after the corners and after each pass of a stream of one layer.
fn whole_passes(heights: &Heights, d: &Decoded) -> Vec<f64> {
    let (lattice, side) = (d.header.lattice, d.header.lattice.side());
    let after = |passes: u32| {
        let mut surface: Vec<f64> = d.z.iter().map(|z| f64::from(*z)).collect();
        let known =
            |at: usize| lattice.pass_of([at / side, at % side]).is_none_or(|p| lattice.number(p) < passes);
        surface::fill(lattice, &mut surface, known);
        let data = (0..heights.z.len()).filter(|k| !heights.is_void(*k));
        let away =
            data.map(|k| surface[k / heights.cols * side + k % heights.cols] - f64::from(heights.z[k]));
        let (sum, count) = away.fold((0.0, 0.0), |(s, n), a| (s + a * a, n + 1.0));
        (sum / f64::max(count, 1.0)).sqrt()
    };
    (0..=2 * lattice.n()).map(after).collect()
}

/// Random cuts: within their bounds; the root mean square does not rise from one end of a pass to the next, and by at most 2 % within
/// a pass.
fn random_cuts(grid: &Grid, layers: &[u32], cuts: usize) {
    let mut r = Random::new(11);
    for profile in DENSE {
        let encoded = coded(&grid.heights, profile, layers);
        let n = encoded.passes.len() / layers.len();
        let mut rms: Vec<f64> =
            whole_passes(&grid.heights, &whole(&coded(&grid.heights, profile, &layers[..1]).bytes));
        // The last bytes of a layer may hold the first posts of the next.
        let at_end = |bytes: u64| wrong(&grid.heights, &read(&encoded.bytes, Stop::Bytes(bytes)).unwrap()).1;
        rms.extend(encoded.passes[n..].iter().map(|p| at_end(p.bytes)));
        for (k, two) in rms.windows(2).enumerate() {
            let (before, after, may) = (two[0], two[1], if k < FEW { 1.2 } else { 1.0 });
            assert!(after <= before * may + 1e-9, "{}: {before}, {after} after pass {k}", grid.name);
        }
        for _ in 0..cuts / every(profile) {
            // As many cuts in coarse passes as in fine ones.
            let most = (encoded.bytes.len() as f64).ln();
            let bytes = (most * (0.4 + 0.6 * r.unit())).exp() as u64;
            let Ok(d) = read(&encoded.bytes, Stop::Bytes(bytes)) else { continue };
            let (most, now) = wrong(&grid.heights, &d);
            assert!(
                most <= f64::from(d.bound),
                "{}, {bytes} bytes: {most}, {} was promised",
                grid.name,
                d.bound
            );
            let start = rms[(d.reached.layer * n + d.reached.passes as usize).min(rms.len() - 1)];
            assert!(
                now <= start * 1.02 + 1e-9,
                "{}, {bytes} bytes: {now} from {start}, {:?}",
                grid.name,
                d.reached
            );
        }
    }
}

#[test]
fn a_thousand_cuts_of_a_big_one() {
    random_cuts(&grids::bundled("crater_2005-06-15_10m"), &[13, 4, 1, 0], 1000);
}

#[test]
fn cuts_of_real_grids() {
    for grid in grids::all() {
        random_cuts(&grid, &[4, 0], 40);
    }
}
