//! Rounding errors upwards: a stored bound is never below what it bounds.

/// The smallest `f32` that is not below `x`. Infinite if `x` exceeds every finite `f32`.
pub fn up_f32(x: f64) -> f32 {
    let y = x as f32;
    if f64::from(y) < x { y.next_up() } else { y }
}

/// `a + b` rounded towards +infinity in `f64` (exact error term by Knuth's TwoSum).
pub fn add_up(a: f64, b: f64) -> f64 {
    let s = a + b;
    if !s.is_finite() {
        return s;
    }
    let bb = s - a;
    let err = (a - (s - bb)) + (b - bb);
    if err > 0.0 { s.next_up() } else { s }
}

/// The `f64` next to an integer: what `x as f64` is, without the call that this is on most machines.
#[inline]
pub fn nearest(x: i128) -> f64 {
    const LOW: u32 = 52;
    let high = (x >> LOW) as i64;
    if i128::from(high) != x >> LOW || high.unsigned_abs() > 1 << 53 {
        return x as f64;
    }
    // Both parts are exact, so their sum is rounded once.
    let low = x as i64 & ((1 << LOW) - 1);
    high as f64 * (1u64 << LOW) as f64 + low as f64
}

/// `x` rounded to `digits` significant decimal digits; how steps of a lattice are named.
pub fn significant(x: f64, digits: usize) -> f64 {
    if x == 0.0 || !x.is_finite() {
        return x;
    }
    format!("{:.*e}", digits - 1, x).parse().expect("a number printed by Rust is read back")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rounding_up_never_goes_below() {
        assert_eq!(up_f32(0.1), 0.1f32.next_up().min(up_f32(0.1)));
        assert!(f64::from(up_f32(0.1)) >= 0.1);
        assert_eq!(up_f32(0.5), 0.5);
        assert!(add_up(1.0, 1e-30) > 1.0);
        assert_eq!(add_up(1.0, 2.0), 3.0);
        assert_eq!(up_f32(0.0), 0.0);
    }

    #[test]
    fn nearest_is_the_conversion_of_the_language() {
        let mut x = 0x9e37_79b9_7f4a_7c15_f39c_c060_5ced_c834u128;
        for k in 0..400_000u32 {
            x = x.wrapping_mul(0xda94_2042_e4dd_58b5).wrapping_add(0x1234_5678_9abc_def1) ^ x >> 77;
            // All magnitudes; and values around halves between two floats, where rounding is decided.
            let v = (x as i128) >> (k % 127);
            let bits = 128 - v.unsigned_abs().leading_zeros();
            let half = if bits > 54 { v >> (bits - 54) << (bits - 54) } else { v };
            for v in [v, half, half + 1, half - 1, half ^ 1 << bits.saturating_sub(54).min(126)] {
                assert_eq!(nearest(v).to_bits(), (v as f64).to_bits(), "{v}");
            }
        }
        for v in [0, 1, -1, i128::MAX, i128::MIN, (1 << 105) - 1, 1 << 105, -(1 << 105), -(1 << 105) - 1] {
            assert_eq!(nearest(v).to_bits(), (v as f64).to_bits(), "{v}");
        }
    }

    #[test]
    fn significant_digits_are_decimal() {
        assert_eq!(significant(69.99999999999989, 12), 70.0);
        assert_eq!(significant(0.00083333333333333, 12), 8.33333333333e-4);
        assert_eq!(significant(-10.0, 12), -10.0);
    }
}
