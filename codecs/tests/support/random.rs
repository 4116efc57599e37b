//! Numbers from a seed, and selections made of them.

use terraquilt_codecs::lattice::Lattice;

/// A small generator (xorshift64*).
pub struct Random(u64);

impl Random {
    pub fn new(seed: u64) -> Random {
        Random(seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1)
    }
    pub fn next(&mut self) -> u64 {
        self.0 ^= self.0 >> 12;
        self.0 ^= self.0 << 25;
        self.0 ^= self.0 >> 27;
        self.0.wrapping_mul(0x2545_f491_4f6c_dd1d)
    }
    /// Uniform in [0, n).
    pub fn below(&mut self, n: u64) -> u64 {
        self.next() % n
    }
    /// Uniform in [0, 1).
    pub fn unit(&mut self) -> f64 {
        (self.next() >> 11) as f64 / (1u64 << 53) as f64
    }
    /// Marks of posts, by one of several densities.
    pub fn selection(&mut self, lattice: Lattice) -> Vec<bool> {
        let posts = lattice.side() * lattice.side();
        let density = [0.0, 3.0 / posts as f64, 0.01, 0.1, 0.5, 1.0][self.below(6) as usize];
        (0..posts).map(|_| self.unit() < density).collect()
    }
    /// Ground, `side * side`: midpoints and a displacement of about `rough` units a post of the step.
    pub fn ground(&mut self, lattice: Lattice, rough: f64) -> Vec<i32> {
        let side = lattice.side();
        let mut z = vec![0; side * side];
        lattice.corners().into_iter().for_each(|[y, x]| z[y * side + x] = self.below(200) as i32);
        for pass in lattice.passes() {
            for post in pass.posts(lattice) {
                let ([a, b], _) = pass.parents(lattice, post);
                let away = (self.unit() + self.unit() + self.unit() - 1.5) * rough * pass.step as f64;
                z[post[0] * side + post[1]] =
                    (z[a[0] * side + a[1]] + z[b[0] * side + b[1]]) / 2 + away.round() as i32;
            }
        }
        z
    }
}
