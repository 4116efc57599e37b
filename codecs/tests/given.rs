//! Streams for a receiver that has some heights already.

use crate::support::grids;
use crate::support::random::Random;
use crate::support::streams::{DENSE, coded, every, read, read_with, refining, whole, wrong};
use terraquilt_codecs::gtb::{Given, Heights, Profile, Stop};

/// Every `step`-th post, and a rectangle of all of them, as decoded from a stream of bound `e`.
fn held(heights: &Heights, e: u32, step: usize) -> Given {
    let d = whole(&coded(heights, DENSE[0], &[e]).bytes);
    let side = d.header.lattice.side();
    let known = |at: usize| {
        let (y, x) = (at / side, at % side);
        !d.is_free(at) && (y % step == 0 && x % step == 0 || y > side / 2 && x < side / 3)
    };
    let known: Vec<bool> = (0..side * side).map(known).collect();
    let z = d.z.iter().zip(&known).map(|(z, k)| if *k { *z } else { 0 }).collect();
    Given { z, known }
}

/// A stream over known heights is smaller, gives the same surface, and every prefix of it keeps its bound.
#[test]
fn what_is_given_does_not_travel() {
    let crater = grids::bundled("crater_2005-06-15_10m");
    let ragged = grids::bundled("survey_2004-10-04_native");
    for heights in [crater.cut(100, 160, 65, 65), crater.cut(60, 100, 70, 40), ragged.cut(100, 80, 60, 50)] {
        for profile in DENSE {
            for (e, layers) in [(0, &[0][..]), (2, &[2]), (0, &[4, 1, 0]), (10, &[1])] {
                let given = held(&heights, e, 4);
                let alone = coded(&heights, profile, layers).bytes;
                let encoded = refining(&heights, profile, layers, Some(&given));
                // Heights that are worse than the stream's own make bad neighbours.
                if e <= layers[0] {
                    assert!(encoded.bytes.len() < alone.len(), "{layers:?} over {e}");
                }
                let d = read_with(&encoded.bytes, Stop::End, Some(&given)).unwrap();
                assert!(d.complete && d.z == encoded.z);
                assert_eq!(wrong(&heights, &d).0, f64::from(d.bound));
                assert!(d.bound <= e.max(layers[layers.len() - 1]));
                for (k, _) in given.known.iter().enumerate().filter(|(_, k)| **k) {
                    assert_eq!(d.z[k], given.z[k], "post {k} was given");
                }
                for cut in (0..encoded.bytes.len()).step_by(every(profile)) {
                    let Ok(d) = read_with(&encoded.bytes[..cut], Stop::End, Some(&given)) else { continue };
                    let (most, _) = wrong(&heights, &d);
                    assert!(
                        most <= f64::from(d.bound),
                        "{layers:?}, {cut} bytes: {most}, {} promised",
                        d.bound
                    );
                }
            }
        }
    }
}

/// Another state, or none, is refused with both names.
#[test]
fn another_state_is_refused() {
    let mut r = Random::new(1);
    let heights = Heights::new(20, 20, (0..400).map(|_| r.below(100) as i32).collect());
    let given = held(&heights, 0, 2);
    let bytes = refining(&heights, DENSE[0], &[0], Some(&given)).bytes;
    let mut other = given.clone();
    let at = other.known.iter().position(|k| *k).unwrap();
    other.z[at] += 1;
    let named = format!("{:016x}", given.state());
    for wrong in [Some(&other), Some(&Given::default()), None] {
        let e = read_with(&bytes, Stop::End, wrong).err().unwrap().to_string();
        assert!(e.contains(&named) && e.contains("give the heights that it was asked for with"), "{e}");
    }
    // A stream that refines nothing takes no notice.
    assert_eq!(whole(&coded(&heights, DENSE[0], &[0]).bytes).bound, 0);
    assert!(read(&bytes, Stop::End).is_err());
}

/// A given height that is wrong, within ground that the first prefixes show too high: the bound of these prefixes counts it.
#[test]
fn a_wrong_given_height_counts_in_every_bound() {
    let mut heights = Heights::new(17, 17, vec![-100; 289]);
    [0, 16, 272, 288].into_iter().for_each(|corner| heights.z[corner] = 0);
    heights.z[12 * 17 + 4] = -450;
    let mut given = Given { z: vec![0; 289], known: vec![false; 289] };
    (given.z[6 * 17 + 10], given.known[6 * 17 + 10]) = (-600, true);
    let bytes = refining(&heights, Profile::Cubic, &[0], Some(&given)).bytes;
    let mut shown = 0;
    for cut in 0..=bytes.len() {
        let Ok(d) = read_with(&bytes[..cut], Stop::End, Some(&given)) else { continue };
        let (most, _) = wrong(&heights, &d);
        assert!(most >= 500.0 && most <= f64::from(d.bound), "{cut} bytes: {most} and not {}", d.bound);
        shown += 1;
    }
    assert!(shown > 10);
}
