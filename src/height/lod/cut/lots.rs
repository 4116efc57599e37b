//! Columns in lots of a fixed length.
//!
//! Compilers make one vector operation of a loop over a lot. Over columns of any length they first ask whether any two overlap,
//! and do short ones one by one.

/// Doubles in the widest vectors there are.
pub const LOT: usize = 8;

/// The lot of a column that begins at `from`; zeros after its end.
#[inline(always)]
pub fn lot<T: Copy + Default>(column: &[T], from: usize) -> [T; LOT] {
    let rest = &column[from..];
    rest.first_chunk().copied().unwrap_or_else(|| {
        let mut short = [T::default(); LOT];
        short[..rest.len()].copy_from_slice(rest);
        short
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lots_end_in_zeros() {
        let column: [f64; 11] = std::array::from_fn(|k| k as f64 + 1.0);
        assert_eq!(lot(&column, 0), [1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0]);
        assert_eq!(lot(&column, 8), [9.0, 10.0, 11.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
    }
}
