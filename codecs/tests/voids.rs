//! Voids: no height is coded for them, and none is missed beside them.

use crate::support::grids;
use crate::support::random::Random;
use crate::support::streams::{DENSE, coded, read, whole, wrong};
use terraquilt_codecs::gtb::{Heights, Profile, Stop};

fn same_voids(heights: &Heights, bytes: &[u8]) {
    let d = whole(bytes);
    let side = d.header.lattice.side();
    for at in 0..side * side {
        let (y, x) = (at / side, at % side);
        let outside = y >= heights.rows || x >= heights.cols;
        assert_eq!(d.is_free(at), outside || heights.is_void(y * heights.cols + x), "row {y}, column {x}");
    }
    assert!(wrong(heights, &d).0 <= f64::from(d.bound));
}

#[test]
fn voids_of_all_kinds() {
    let mut r = Random::new(6);
    for (cols, rows) in [(33, 33), (50, 20), (7, 40), (1, 9), (9, 1), (1, 1), (2, 2)] {
        let z: Vec<i32> =
            (0..cols * rows).map(|k| (k % cols) as i32 * 5 + r.below(20) as i32 + 100).collect();
        let marks: [(&str, Vec<bool>); 5] = [
            ("a rectangle", (0..z.len()).map(|k| k % cols < cols / 2 && k / cols > rows / 3).collect()),
            ("scattered", (0..z.len()).map(|_| r.below(4) == 0).collect()),
            ("all but one", (0..z.len()).map(|k| k != z.len() / 2).collect()),
            ("all", vec![true; z.len()]),
            ("the border", (0..z.len()).map(|k| k % cols == 0 || k / cols + 1 == rows).collect()),
        ];
        for (name, void) in marks {
            for profile in DENSE {
                for layers in [&[0][..], &[4, 1]] {
                    println!("{cols} x {rows}, {name}, {layers:?}");
                    let heights = Heights { cols, rows, z: z.clone(), void: void.clone() };
                    same_voids(&heights, &coded(&heights, profile, layers).bytes);
                }
            }
        }
    }
}

/// What lies in voids is no matter: the bytes are the same.
#[test]
fn voids_carry_nothing() {
    let grid = grids::bundled("survey_2004-10-11_native");
    let mut other = grid.heights.clone();
    assert!(other.void.contains(&true));
    let mut r = Random::new(9);
    for (z, _) in other.z.iter_mut().zip(&other.void).filter(|(_, v)| **v) {
        *z = r.next() as i32;
    }
    for profile in DENSE {
        assert!(coded(&grid.heights, profile, &[3]).bytes == coded(&other, profile, &[3]).bytes);
    }
}

/// A mask that is cut is no mask: nothing is shown before it is whole.
#[test]
fn no_surface_before_the_mask() {
    let grid = grids::bundled("survey_2004-10-04_native");
    let bytes = coded(&grid.heights, Profile::Cubic, &[2]).bytes;
    let first = (0..bytes.len()).find(|cut| read(&bytes[..*cut], Stop::End).is_ok()).unwrap();
    let d = read(&bytes[..first], Stop::End).unwrap();
    let side = d.header.lattice.side();
    for (k, void) in grid.heights.void.iter().enumerate() {
        assert_eq!(d.is_free(k / grid.heights.cols * side + k % grid.heights.cols), *void);
    }
}

/// The mask of a mountain with 15.8 % voids takes less than a tenth of a bit a post; all of it less than the best fill
/// does as a lossless JPEG XL (5.33; specification, section 5).
#[test]
fn everest() {
    let Some(grid) = grids::of_shared("everest_srtm3") else { return };
    let h = &grid.heights;
    let voids = h.void.iter().filter(|v| **v).count() as f64 / h.void.len() as f64;
    assert!((voids - 0.158).abs() < 0.001, "{voids}");
    let bits = |bytes: &[u8]| bytes.len() as f64 * 8.0 / h.z.len() as f64;
    let flat = Heights { z: vec![0; h.z.len()], ..h.clone() };
    for profile in DENSE {
        let (all, mask) = (bits(&coded(h, profile, &[0]).bytes), bits(&coded(&flat, profile, &[0]).bytes));
        println!(
            "everest, {:.1} % voids, {profile:?}: {all:.3} bits a post, of which the mask {mask:.3}",
            voids * 100.0
        );
        assert!(all <= 4.85 && mask < 0.1, "{all}, {mask}");
    }
}
