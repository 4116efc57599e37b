//! Sets that are joined two by two: each thing has a parent of its set, the first one is its own.

/// The one that stands for all that were joined with `t`: the least.
pub fn root(parents: &mut [u32], mut t: u32) -> u32 {
    while parents[t as usize] != t {
        parents[t as usize] = parents[parents[t as usize] as usize];
        t = parents[t as usize];
    }
    t
}

/// Makes two one.
pub fn join(parents: &mut [u32], a: u32, b: u32) {
    let (a, b) = (root(parents, a), root(parents, b));
    let (least, other) = (a.min(b), a.max(b));
    parents[other as usize] = least;
}
