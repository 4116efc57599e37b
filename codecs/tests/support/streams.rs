//! Streams of heights alone, and how wrong they are.

use terraquilt_codecs::Result;
use terraquilt_codecs::gtb::companion::Alone;
use terraquilt_codecs::gtb::{Decoded, Encoded, Given, Heights, Options, Profile, Stop, decode, encode};

/// The profiles that code every post.
pub const DENSE: [Profile; 2] = [Profile::Cubic, Profile::Adaptive];

/// How many cases of a long row are left out for the slower profile: every one is tried of `cubic`, every fourth of `adaptive`.
pub fn every(profile: Profile) -> usize {
    if profile == Profile::Adaptive { 4 } else { 1 }
}

pub fn coded(heights: &Heights, profile: Profile, layers: &[u32]) -> Encoded {
    refining(heights, profile, layers, None)
}

/// A stream for a receiver that has some heights.
pub fn refining(heights: &Heights, profile: Profile, layers: &[u32], given: Option<&Given>) -> Encoded {
    let options = Options { layers: layers.to_vec(), given, ..Options::new(profile, 0) };
    encode(heights, &options, &mut Alone, &mut |_| true).expect("heights that can be coded")
}

pub fn read(bytes: &[u8], stop: Stop) -> Result<Decoded> {
    read_with(bytes, stop, None)
}

pub fn read_with(bytes: &[u8], stop: Stop, given: Option<&Given>) -> Result<Decoded> {
    decode(bytes, &mut Vec::new(), stop, given, &mut Alone, &mut |_| true)
}

/// The whole of a stream, which must be whole.
pub fn whole(bytes: &[u8]) -> Decoded {
    let d = read(bytes, Stop::End).expect("a whole stream");
    assert!(d.complete && d.damaged.is_none());
    d
}

/// How wrong a surface is at posts with data: the greatest error and the root of the mean square.
pub fn wrong(heights: &Heights, d: &Decoded) -> (f64, f64) {
    let side = d.header.lattice.side();
    let surface = d.surface();
    let (mut most, mut sum, mut count) = (0.0_f64, 0.0, 0.0);
    for (k, z) in heights.z.iter().enumerate().filter(|(k, _)| !heights.is_void(*k)) {
        let away = (surface[k / heights.cols * side + k % heights.cols] - f64::from(*z)).abs();
        most = most.max(away);
        sum += away * away;
        count += 1.0;
    }
    (most, (sum / f64::max(count, 1.0)).sqrt())
}
