//! Errors within the bound, sizes that do not fit, stops, limits, what the head says.

use crate::support::grids;
use crate::support::random::Random;
use crate::support::streams::{DENSE, coded, every, read, whole, wrong};
use terraquilt_codecs::Error;
use terraquilt_codecs::gtb::companion::Alone;
use terraquilt_codecs::gtb::heights::HEIGHT_MAX;
use terraquilt_codecs::gtb::{Header, Heights, Options, Place, Profile, Stop, decode_within, encode};

/// Acceptance G-d: no post with data is wrong by more than E; exact at 0. The head's bound is the true one.
#[test]
fn errors_stay_within_the_bound_on_real_grids() {
    for grid in grids::all() {
        for profile in DENSE {
            for e in [0, 1, 2, 5, 10, 20, 60].into_iter().step_by(every(profile)) {
                let encoded = coded(&grid.heights, profile, &[e]);
                let d = whole(&encoded.bytes);
                let (most, _) = wrong(&grid.heights, &d);
                assert!(most <= f64::from(e), "{} at {e}: {most}", grid.name);
                assert_eq!(most, f64::from(d.bound), "{} at {e}", grid.name);
                assert_eq!((encoded.error_max, &encoded.z), (d.bound, &d.z), "{} at {e}", grid.name);
            }
        }
    }
}

/// Every size up to 40 x 40 or so, on the lattice that holds it; one post, one row, one column.
#[test]
fn grids_that_do_not_fit_the_lattice() {
    let mut r = Random::new(5);
    let sizes = (1..=40).flat_map(|cols| (1..=40).map(move |rows| [cols, rows]));
    for [cols, rows] in sizes.filter(|[a, b]| a * b < 60 || (a * 7 + b * 3) % 5 == 0) {
        let slope = r.below(40) as i32 - 20;
        let z = (0..cols * rows).map(|k| (k % cols) as i32 * slope + r.below(9) as i32 - 300);
        let heights = Heights::new(cols, rows, z.collect());
        for profile in DENSE {
            for layers in [&[0][..], &[3], &[4, 1, 0]] {
                let encoded = coded(&heights, profile, layers);
                let d = whole(&encoded.bytes);
                let (most, _) = wrong(&heights, &d);
                assert!(most <= f64::from(layers[layers.len() - 1]), "{cols} x {rows}, {layers:?}: {most}");
                assert!(most <= f64::from(d.bound));
                assert_eq!(d.bytes_used, encoded.bytes.len() as u64);
            }
        }
    }
}

/// The greatest heights and steps there are.
#[test]
fn extreme_heights() {
    for profile in DENSE {
        for (bound, seed) in [(0, 1), (1, 2), (1 << 20, 3)] {
            let mut r = Random::new(seed);
            let z = (0..33 * 20).map(|_| if r.below(2) == 0 { HEIGHT_MAX } else { -HEIGHT_MAX });
            let heights = Heights::new(33, 20, z.collect());
            let (most, _) = wrong(&heights, &whole(&coded(&heights, profile, &[bound]).bytes));
            assert!(most <= f64::from(bound), "{most} at {bound}");
        }
        let heights = Heights::new(2, 1, vec![0, HEIGHT_MAX + 1]);
        let refused = encode(&heights, &Options::new(profile, 0), &mut Alone, &mut |_| true).err();
        assert!(refused.is_some_and(|e| e.to_string().contains("larger unit")));
    }
}

/// What the head carries comes back, bit by bit.
#[test]
fn a_head_comes_back() {
    let place = Place {
        unit: 0.1,
        base: -12.5,
        given_error: 0.25,
        transform: [500_000.0, 10.0, 0.5, 4e6, -0.5, -10.0],
        crs: "EPSG:26910".into(),
        vertical: "m NAVD88 height".into(),
        source: "ground".into(),
    };
    let heights = Heights::new(5, 4, (0..20).collect());
    let options = Options { layers: vec![4, 1], place: place.clone(), ..Options::new(Profile::Cubic, 0) };
    let bytes = encode(&heights, &options, &mut Alone, &mut |_| true).unwrap().bytes;
    let (header, length) = Header::read(&bytes).unwrap();
    assert_eq!((header.cols, header.rows, header.lattice.n()), (5, 4, 2));
    assert_eq!((&header.layers, &header.place), (&vec![4, 1], &place));
    assert_eq!(header.bytes(), bytes[..length]);
    for cut in 0..length {
        assert!(matches!(Header::read(&bytes[..cut]), Err(Error::Short { .. })), "{cut} bytes");
    }
}

/// A stop by error takes no more than it needs, and what it gives is that good.
#[test]
fn a_stop_by_error_is_kept() {
    let grid = grids::bundled("crater_2005-06-15_10m");
    let encoded = coded(&grid.heights, Profile::Cubic, &[13, 4, 1, 0]);
    let mut last = 0;
    for wanted in [10_000.0, 1000.0, 300.0, 100.0, 30.0, 13.0, 12.0, 4.0, 1.0, 0.5, 0.0] {
        let d = read(&encoded.bytes, Stop::Error(wanted)).unwrap();
        let (most, _) = wrong(&grid.heights, &d);
        assert!(
            most <= f64::from(d.bound) && f64::from(d.bound) <= wanted,
            "{most}, {} for {wanted}",
            d.bound
        );
        assert!(d.bytes_used >= last && d.bytes_used <= encoded.bytes.len() as u64);
        // The same bytes alone give the same surface.
        let again = read(&encoded.bytes, Stop::Bytes(d.bytes_used)).unwrap();
        assert!(again.bound <= d.bound, "{} and {} for {wanted}", again.bound, d.bound);
        last = d.bytes_used;
    }
    assert_eq!(last, encoded.bytes.len() as u64);
}

/// Ends of passes as the encoder names them are ends for a decoder, and no byte too late by more than the coder's eight.
#[test]
fn ends_of_passes_are_where_they_are_said_to_be() {
    let grid = grids::bundled("survey_2000-09-25_native");
    let encoded = coded(&grid.heights, Profile::Cubic, &[4, 1]);
    let n = 2 * whole(&encoded.bytes).header.lattice.n();
    for (k, end) in encoded.passes.iter().enumerate() {
        let d = read(&encoded.bytes, Stop::Bytes(end.bytes)).unwrap();
        let passes = d.reached.layer as u32 * n + d.reached.passes;
        assert!(passes > k as u32, "pass {k}: {:?} of {} bytes", d.reached, end.bytes);
        assert!(d.bound <= end.bound);
        let d = read(&encoded.bytes, Stop::Bytes(end.bytes.saturating_sub(24)));
        let passes = d.map_or(0, |d| d.reached.layer as u32 * n + d.reached.passes);
        assert!(
            passes <= k as u32 || end.bytes == encoded.bytes.len() as u64,
            "pass {k} was whole long before"
        );
    }
}

/// Callers stop the work, and refuse sizes, before anything is allocated.
#[test]
fn callers_refuse() {
    let heights = Heights::new(40, 40, vec![7; 1600]);
    let options = Options::new(Profile::Cubic, 0);
    let stopped = encode(&heights, &options, &mut Alone, &mut |done| done < 0.1).err();
    assert_eq!(stopped, Some(Error::Stopped));
    let bytes = coded(&heights, Profile::Cubic, &[0]).bytes;
    let mut body = Vec::new();
    let d = decode_within(65 * 65 - 1, &bytes, &mut body, Stop::End, None, &mut Alone, &mut |_| true);
    assert!(matches!(d.err(), Some(Error::Limit { limit: 4224, wanted: 4225, .. })));
    assert!(body.is_empty());
    let d = decode_within(65 * 65, &bytes, &mut body, Stop::End, None, &mut Alone, &mut |_| false);
    assert_eq!(d.err(), Some(Error::Stopped));
    let too_long = Heights::new(8194, 1, vec![0; 8194]);
    let refused = encode(&too_long, &options, &mut Alone, &mut |_| true).err();
    assert!(matches!(refused, Some(Error::Limit { wanted: 8194, .. })));
}
