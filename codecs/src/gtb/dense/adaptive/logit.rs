//! Logarithms and powers of two by polynomials: the same bits on every machine.

/// log2 of a positive, normal number; within 4e-6.
#[inline(always)]
pub(super) fn log2(x: f32) -> f32 {
    let bits = x.to_bits();
    let exponent = (bits >> 23) as i32 - 127;
    let f = f32::from_bits(bits & 0x007f_ffff | 0x3f80_0000) - 1.0;
    let f2 = f * f;
    let low = (1.442_501_7 - 0.717_668_1 * f) + f2 * (0.455_742_98 - 0.274_832_43 * f);
    let p = low + (f2 * f2) * (0.119_381_52 - 0.025_125_61 * f);
    exponent as f32 + p * f
}

/// 2 to the power of a number from -120 to 120; within 1e-5 of itself.
#[inline(always)]
pub(super) fn exp2(x: f32) -> f32 {
    let whole = (x + 128.0) as i32 - 128;
    let f = x - whole as f32;
    let f2 = f * f;
    let p = (1.0 + 0.692_995_65 * f) + f2 * ((0.241_565_61 + 0.051_752_27 * f) + 0.013_686_47 * f2);
    f32::from_bits(((whole + 127) as u32) << 23) * p
}

/// The probability whose odds are 2^x.
#[inline(always)]
pub(super) fn squash(x: f32) -> f32 {
    1.0 / (1.0 + exp2(-x))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn close_to_the_true_values() {
        for k in 1..200_000 {
            let x = k as f32 * 0.013;
            assert!((f64::from(log2(x)) - f64::from(x).log2()).abs() < 1e-5, "log2 {x}");
            let x = (k - 100_000) as f32 * 0.0011;
            assert!((f64::from(exp2(x)) / f64::from(x).exp2() - 1.0).abs() < 2e-5, "exp2 {x}");
        }
        assert_eq!(squash(0.0), 0.5);
    }
}
