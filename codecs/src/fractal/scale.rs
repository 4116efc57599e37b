//! The steps in which contrast and mean are stored.

/// Levels of s on each side of zero: 5 bits with zero make 15.
pub const SCALE_MAX: i8 = 15;

/// s of a level.
#[inline(always)]
pub fn scale(level: i8) -> f64 {
    f64::from(level) / f64::from(SCALE_MAX)
}

/// The level whose s leaves the least error: the nearest to `<R, D> / <D, D>`; 0 where the domain is flat.
#[inline(always)]
pub fn nearest(product: f64, domain: f64) -> i8 {
    if domain <= 0.0 {
        return 0;
    }
    let max = f64::from(SCALE_MAX);
    // Halves go away from zero, as `round` does it.
    (product / domain * max).clamp(-max, max).round() as i8
}

/// The squared error of a range without its mean: `<R, R> - 2 s <R, D> + s^2 <D, D>`, at least 0.
#[inline(always)]
pub fn error(level: i8, range: f64, product: f64, domain: f64) -> f64 {
    let s = scale(level);
    (range - 2.0 * s * product + s * s * domain).max(0.0)
}
