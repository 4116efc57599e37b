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
    fn significant_digits_are_decimal() {
        assert_eq!(significant(69.99999999999989, 12), 70.0);
        assert_eq!(significant(0.00083333333333333, 12), 8.33333333333e-4);
        assert_eq!(significant(-10.0, 12), -10.0);
    }
}
