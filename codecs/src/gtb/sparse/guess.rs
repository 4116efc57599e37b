//! The surplus that a post will have, by least squares over the selected posts so far.

use super::around::FEATURES;
use crate::lattice::Kind;

/// What a sum keeps of itself from one post to the next.
const KEPT: f64 = 0.9995;
/// Weights are solved for after so many posts.
const OFTEN: u32 = 16;
/// What the first weights are believed, as a sum of squares of features over squares of scales.
const TRUST: f64 = 48.0;

/// Sums of products, forgotten slowly, and the weights that solve them.
pub(super) struct Guess {
    /// Upper triangle of features by features, and features by surplus.
    sums: [[f64; FEATURES + 1]; FEATURES],
    weights: [f64; FEATURES],
    seen: u32,
}

impl Guess {
    /// Begins with weights that suit most ground.
    pub fn new(kind: Kind) -> Guess {
        let weights = match kind {
            Kind::Centres => [0.8, -0.35, 0.12, 0.0, 0.0, -0.15],
            Kind::Edges => [1.0, -0.4, 0.08, 0.0, -0.12, 0.12],
        };
        let mut sums = [[0.0; FEATURES + 1]; FEATURES];
        for k in 0..FEATURES {
            sums[k][k] = TRUST;
            sums[k][FEATURES] = TRUST * weights[k];
        }
        Guess { sums, weights, seen: 0 }
    }

    /// The surplus to expect.
    pub fn of(&self, features: &[f64; FEATURES]) -> f64 {
        let mut sum = 0.0;
        for (w, f) in self.weights.iter().zip(features) {
            sum += w * f;
        }
        sum
    }

    /// Learns a surplus; `scale`: how large surpluses are around it, at least a part of a unit.
    pub fn learn(&mut self, features: &[f64; FEATURES], surplus: f64, scale: f64) {
        let w = 1.0 / (scale * scale);
        for (i, sums) in self.sums.iter_mut().enumerate() {
            for j in i..FEATURES {
                sums[j] = sums[j] * KEPT + w * features[i] * features[j];
            }
            sums[FEATURES] = sums[FEATURES] * KEPT + w * features[i] * surplus;
        }
        self.seen = self.seen.wrapping_add(1);
        if self.seen.is_multiple_of(OFTEN)
            && let Some(weights) = solve(&self.sums)
        {
            self.weights = weights;
        }
    }
}

/// Cholesky's way; `None` where the sums say too little or nonsense.
fn solve(sums: &[[f64; FEATURES + 1]; FEATURES]) -> Option<[f64; FEATURES]> {
    let mut lower = [[0.0; FEATURES]; FEATURES];
    let mut y = [0.0; FEATURES];
    for i in 0..FEATURES {
        for j in 0..=i {
            let mut sum = sums[j][i];
            for (a, b) in lower[i][..j].iter().zip(&lower[j]) {
                sum -= a * b;
            }
            lower[i][j] = if i == j { (sum + sums[i][i] * 1e-6).max(1e-9).sqrt() } else { sum / lower[j][j] };
        }
        let mut sum = sums[i][FEATURES];
        for k in 0..i {
            sum -= lower[i][k] * y[k];
        }
        y[i] = sum / lower[i][i];
    }
    let mut weights = [0.0; FEATURES];
    for i in (0..FEATURES).rev() {
        let mut sum = y[i];
        for k in i + 1..FEATURES {
            sum -= lower[k][i] * weights[k];
        }
        weights[i] = sum / lower[i][i];
    }
    weights.iter().all(|w| w.abs() < 1e3).then_some(weights)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Surpluses that are a sum of features are guessed soon.
    #[test]
    fn finds_the_weights() {
        let wanted = [0.5, -0.25, 1.5, 0.0, -1.0, 0.125];
        let mut guess = Guess::new(Kind::Edges);
        let mut random = 1u32;
        let mut draw = || {
            random = random.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            f64::from(random >> 16) / 1024.0 - 32.0
        };
        for _ in 0..3000 {
            let features = [(); FEATURES].map(|()| draw());
            let surplus: f64 = features.iter().zip(wanted).map(|(f, w)| f * w).sum();
            guess.learn(&features, surplus, 1.0);
        }
        for (found, wanted) in guess.weights.iter().zip(wanted) {
            assert!((found - wanted).abs() < 0.01, "{found} for {wanted}");
        }
    }

    /// What a hostile stream can make of heights never makes a guess that is no number.
    #[test]
    fn stays_finite() {
        let mut guess = Guess::new(Kind::Centres);
        for k in 0..5000 {
            let v = if k % 3 == 0 { 4.3e9 } else { -4.3e9 * f64::from(k % 7) };
            guess.learn(&[v, -v, v, 0.0, v, v], -v * 1e6, 0.3);
            assert!(guess.of(&[v; FEATURES]).is_finite());
        }
    }
}
