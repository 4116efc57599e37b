//! The smallest grids: one post, two posts a side (no pass at all), three.

use terraquilt_codecs::gtb::companion::Alone;
use terraquilt_codecs::gtb::{Heights, Options, Profile, Stop, decode, encode};

#[test]
fn grids_of_a_few_posts_come_back() {
    let layers: [&[u32]; 3] = [&[0], &[2], &[4, 1, 0]];
    for (cols, rows) in (1..=3).flat_map(|c| (1..=3).map(move |r| (c, r))) {
        for (profile, layers) in
            [Profile::Cubic, Profile::Adaptive].iter().flat_map(|p| layers.iter().map(move |l| (*p, *l)))
        {
            let z: Vec<i32> = (0..cols * rows).map(|k| 20_000 + 37 * k as i32).collect();
            let heights = Heights::new(cols, rows, z.clone());
            let options = Options { layers: layers.to_vec(), ..Options::new(profile, 0) };
            let found = encode(&heights, &options, &mut Alone, &mut |_| true).unwrap();
            let mut body = Vec::new();
            let d = decode(&found.bytes, &mut body, Stop::End, None, &mut Alone, &mut |_| true).unwrap();
            let side = d.header.lattice.side();
            let e = layers[layers.len() - 1];
            assert!(d.complete && d.bound <= e, "{cols} x {rows} {profile:?} {layers:?}: {}", d.bound);
            for (k, z) in z.iter().enumerate() {
                let back = d.z[k / cols * side + k % cols];
                assert!(back.abs_diff(*z) <= e, "{cols} x {rows} {profile:?} {layers:?}: {back} for {z}");
            }
        }
    }
}
