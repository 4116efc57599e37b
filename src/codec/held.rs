//! Heights that a receiver has from an earlier stream, at the posts of a new one.
//!
//! Both sides find them by the same steps. The sender then drops those that are no longer good enough and says which: by runs.

use crate::base::{Error, Result};
use terraquilt_codecs::gtb::{Decoded, Given, Place};
use terraquilt_codecs::lattice::Lattice;

/// Parts of a step by which posts of two streams may miss each other and still be the same.
const MISS: f64 = 1e-6;

/// The posts of a stream that is about to be made, or is being read.
pub struct Posts<'a> {
    pub cols: usize,
    pub rows: usize,
    pub lattice: Lattice,
    pub place: &'a Place,
}

/// The heights of an earlier stream at the posts that both have, in units of the new one. `None` if they share no post, lie in
/// different systems, or are turned.
///
/// Heights are converted by additions, products and roundings of doubles in one order: the same on every machine.
pub fn shared(earlier: &Decoded, posts: &Posts) -> Option<Given> {
    let (old, new) = (&earlier.header.place, posts.place);
    let turned = [old, new].iter().any(|p| p.transform[2] != 0.0 || p.transform[4] != 0.0);
    if turned || old.crs != new.crs || old.vertical != new.vertical {
        return None;
    }
    let cols = meeting(axis(old, 0), earlier.header.cols, axis(new, 0), posts.cols);
    let rows = meeting(axis(old, 1), earlier.header.rows, axis(new, 1), posts.rows);
    if cols.is_empty() || rows.is_empty() {
        return None;
    }
    let (side, side_old) = (posts.lattice.side(), earlier.header.lattice.side());
    let known = earlier.known();
    let mut given = Given { z: vec![0; side * side], known: vec![false; side * side] };
    let mut any = false;
    for (row_old, row) in &rows {
        for (col_old, col) in &cols {
            let (from, to) = (row_old * side_old + col_old, row * side + col);
            if known[from] && !earlier.is_free(from) {
                let metres = old.base - new.base + old.unit * f64::from(earlier.z[from]);
                let z = (metres / new.unit + 0.5).floor();
                // A height beyond all heights of a stream is none of its.
                if z.abs() <= f64::from(1 << 25) {
                    (given.z[to], given.known[to], any) = (z as i32, true, true);
                }
            }
        }
    }
    any.then_some(given)
}

/// By how many posts a stream must begin farther west and farther north so that coarser posts of an earlier one are among its
/// coarser posts: less than a spacing of the earlier one. Posts that lie between the others of a pass help to predict nothing.
pub fn beginning(earlier: &Place, new: &Place) -> [usize; 2] {
    let along = |k: usize| {
        let (old, new) = (axis(earlier, k), axis(new, k));
        let times = (old[1] / new[1]).round();
        let away = (new[0] - old[0]) / new[1];
        let fits = (old[1] / new[1] - times).abs() <= MISS && (away - away.round()).abs() <= MISS;
        (fits && (1.0..=4096.0).contains(&times)).then(|| away.round().rem_euclid(times) as usize)
    };
    match (along(0), along(1)) {
        (Some(west), Some(north)) => [west, north],
        _ => [0; 2],
    }
}

/// First post and step along an axis.
fn axis(p: &Place, k: usize) -> [f64; 2] {
    let t = &p.transform;
    if k == 0 { [t[0], t[1]] } else { [t[3], t[5]] }
}

/// Which posts of the old axis are posts of the new one: pairs of both numbers.
fn meeting(old: [f64; 2], count_old: usize, new: [f64; 2], count: usize) -> Vec<(usize, usize)> {
    let number = |k: usize| {
        let at = (old[0] + k as f64 * old[1] - new[0]) / new[1];
        let near = at.round();
        ((at - near).abs() <= MISS && near >= 0.0 && near < count as f64).then_some((k, near as usize))
    };
    (0..count_old).filter_map(number).collect()
}

/// Drops the heights that are not `good`. Returns how many in raster order stay and fall, by turns, beginning with those that
/// stay.
pub fn sift(given: &mut Given, good: impl Fn(usize, i32) -> bool) -> Vec<u64> {
    let (mut runs, mut stays) = (vec![0u64], true);
    for at in 0..given.known.len() {
        if !given.known[at] {
            continue;
        }
        if good(at, given.z[at]) != stays {
            stays = !stays;
            runs.push(0);
        }
        if let Some(run) = runs.last_mut() {
            *run += 1;
        }
        if !stays {
            (given.known[at], given.z[at]) = (false, 0);
        }
    }
    runs
}

/// Drops what the sender dropped.
///
/// # Errors
/// If the runs count other heights than there are.
pub fn follow(given: &mut Given, runs: &[u64]) -> Result<()> {
    let count = given.known.iter().filter(|k| **k).count() as u64;
    let sum = runs.iter().fold(0u64, |a, b| a.saturating_add(*b));
    if sum != count {
        return Err(Error::invalid(
            "heights that are here already",
            format!("the sender counts {sum} at posts of the new stream, {count} are here; ask without them"),
        ));
    }
    let mut turns = runs.iter().enumerate().flat_map(|(k, n)| (0..*n).map(move |_| k % 2 == 0));
    for at in 0..given.known.len() {
        if given.known[at] && turns.next() == Some(false) {
            (given.known[at], given.z[at]) = (false, 0);
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use terraquilt_codecs::gtb::companion::Alone;
    use terraquilt_codecs::gtb::{Heights, Options, Profile, Stop, decode, encode};

    fn place(x0: f64, y0: f64, step: f64, unit: f64) -> Place {
        Place { transform: [x0, step, 0.0, y0, 0.0, -step], unit, ..Place::default() }
    }

    fn stream(cols: usize, rows: usize, place: Place, z: impl Fn(usize) -> i32) -> Decoded {
        let heights = Heights::new(cols, rows, (0..cols * rows).map(z).collect());
        let options = Options { place, ..Options::new(Profile::Cubic, 0) };
        let bytes = encode(&heights, &options, &mut Alone, &mut |_| true).unwrap().bytes;
        decode(&bytes, &mut Vec::new(), Stop::End, None, &mut Alone, &mut |_| true).unwrap()
    }

    #[test]
    fn posts_of_a_coarser_stream_are_found_in_a_finer_one() {
        let coarse = stream(4, 3, place(100.0, 80.0, 20.0, 0.1), |k| 10 * k as i32);
        let fine = place(110.0, 80.0, 10.0, 0.01);
        let lattice = Lattice::around(5, 4).unwrap();
        let posts = Posts { cols: 5, rows: 4, lattice, place: &fine };
        let mut given = shared(&coarse, &posts).unwrap();
        let side = lattice.side();
        let found: Vec<_> = (0..side * side).filter(|at| given.known[*at]).collect();
        // 120 and 140 of 100, 120, 140, 160; rows 80 and 60 of 80, 60, 40.
        assert_eq!(found, [1, 3, 2 * side + 1, 2 * side + 3]);
        assert_eq!(found.iter().map(|at| given.z[*at]).collect::<Vec<_>>(), [100, 200, 500, 600]);
        let mut again = given.clone();
        let runs = sift(&mut given, |_, z| z != 200);
        assert_eq!(runs, [1, 1, 2]);
        follow(&mut again, &runs).unwrap();
        assert_eq!(given, again);
        assert_eq!(given.known.iter().filter(|k| **k).count(), 3);
        assert!(follow(&mut again, &runs).is_err());
    }

    #[test]
    fn a_finer_stream_begins_on_a_coarser_post() {
        let old = place(96.0, 96.0, 16.0, 1.0);
        assert_eq!(beginning(&old, &place(104.0, 100.0, 4.0, 1.0)), [2, 3]);
        assert_eq!(beginning(&old, &place(80.0, 128.0, 8.0, 1.0)), [0, 0]);
        for other in
            [place(104.0, 88.0, 16.0, 1.0), place(105.0, 88.0, 4.0, 1.0), place(104.0, 88.0, 32.0, 1.0)]
        {
            assert_eq!(beginning(&old, &other), [0, 0]);
        }
    }

    #[test]
    fn streams_that_share_nothing_give_nothing() {
        let coarse = stream(4, 3, place(100.0, 80.0, 20.0, 0.1), |k| k as i32);
        let lattice = Lattice::around(5, 4).unwrap();
        let crs = Place { crs: "EPSG:4326".into(), ..place(110.0, 80.0, 10.0, 0.1) };
        for other in [place(115.0, 80.0, 10.0, 0.1), place(900.0, 80.0, 10.0, 0.1), crs] {
            assert!(shared(&coarse, &Posts { cols: 5, rows: 4, lattice, place: &other }).is_none());
        }
    }
}
