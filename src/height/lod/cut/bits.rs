//! Truths as bits.

/// Bit k is the k-th truth (0 or 1). Comparisons write bytes, which compilers do many at a time; eight of them become bits by one
/// product: byte i is moved to bit 56 + i, and no two meet.
#[inline]
pub fn pack(truths: &[u8; 64]) -> u64 {
    let (eights, _) = truths.as_chunks::<8>();
    eights.iter().enumerate().fold(0, |mask, (k, eight)| {
        let bits = u64::from_le_bytes(*eight).wrapping_mul(0x0102_0408_1020_4080) >> 56;
        mask | bits << (8 * k)
    })
}

#[cfg(test)]
mod tests {
    #[test]
    fn every_bit_comes_from_its_byte() {
        let mut s = 1u64;
        for _ in 0..10_000 {
            s = s.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            let mask = s ^ s >> 33;
            assert_eq!(super::pack(&std::array::from_fn(|k| (mask >> k & 1) as u8)), mask);
        }
    }
}
