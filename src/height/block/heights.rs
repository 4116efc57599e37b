//! What a block is for those who evaluate it: heights in metres.

use super::{N, RawBlock};

/// Heights of a whole block, metres: what is evaluated.
#[derive(Clone, Debug)]
pub struct Heights {
    /// 112 x 112, row-major; voids hold their fill, or 0.
    pub z: Vec<f64>,
    /// 112 x 112; `None` = all valid.
    pub valid: Option<Vec<u8>>,
}

impl Heights {
    /// A block with nothing in it.
    pub fn void() -> Heights {
        Heights { z: vec![0.0; N * N], valid: Some(vec![0; N * N]) }
    }

    /// Lays the block's samples over what is here: valid ones win.
    pub fn lay(&mut self, b: &RawBlock, scale: f64, offset: f64) {
        let w = b.sample_type.bytes();
        let plain = scale == 1.0 && offset == 0.0;
        let whole = b.cols == N && b.rows == N;
        let mut fill = b.fills.iter();
        let mut row = [0.0; N];
        let row = &mut row[..b.cols];
        for r in 0..b.rows {
            let (at, from) = ((b.row + r) * N + b.col, r * b.cols);
            b.sample_type.values(&b.samples[from * w..(from + b.cols) * w], row);
            if !plain {
                row.iter_mut().for_each(|h| *h = *h * scale + offset);
            }
            let z = &mut self.z[at..at + b.cols];
            let valid = b.valid.as_ref().map(|v| &v[from..from + b.cols]);
            let Some(valid) = valid.filter(|v| v.contains(&0)) else {
                z.copy_from_slice(row);
                if let Some(mask) = &mut self.valid {
                    mask[at..at + b.cols].fill(1);
                }
                continue;
            };
            let mask = self.valid.get_or_insert_with(|| vec![1; N * N]);
            for (((z, m), h), v) in z.iter_mut().zip(&mut mask[at..]).zip(row.iter()).zip(valid) {
                if *v != 0 {
                    (*z, *m) = (*h, 1);
                } else if let Some(f) = fill.next()
                    && *m == 0
                {
                    *z = f64::from(*f);
                }
            }
        }
        if whole && b.valid.as_ref().is_none_or(|v| !v.contains(&0)) {
            self.valid = None;
        }
    }

    #[inline]
    pub fn is_valid(&self, a: usize, b: usize) -> bool {
        self.valid.as_ref().is_none_or(|v| v[b * N + a] != 0)
    }

    /// Bytes in memory.
    pub fn weight(&self) -> u64 {
        (self.z.len() * 8 + self.valid.as_ref().map_or(0, Vec::len)) as u64
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::sample;
    use super::*;
    use crate::height::source::SampleType;

    /// Sample by sample, as the heights of a block are defined.
    fn plainly(h: &mut Heights, b: &RawBlock, scale: f64, offset: f64) {
        let w = b.sample_type.bytes();
        let mut fill = b.fills.iter();
        let mask = h.valid.get_or_insert_with(|| vec![1; N * N]);
        for k in 0..b.cols * b.rows {
            let at = (b.row + k / b.cols) * N + b.col + k % b.cols;
            if b.valid.as_ref().is_none_or(|v| v[k] != 0) {
                let raw = b.sample_type.value(&b.samples[k * w..]);
                h.z[at] = if scale == 1.0 && offset == 0.0 { raw } else { raw * scale + offset };
                mask[at] = 1;
            } else if let Some(f) = fill.next()
                && mask[at] == 0
            {
                h.z[at] = f64::from(*f);
            }
        }
    }

    #[test]
    fn blocks_lie_over_one_another_as_sample_by_sample() {
        let corner = |b: RawBlock| RawBlock { col: N - b.cols, row: N - b.rows, ..b };
        for (k, t) in SampleType::ALL.into_iter().enumerate() {
            let (scale, offset) = if k % 2 == 0 { (1.0, 0.0) } else { (0.1, -3.0) };
            for whole in [false, true] {
                let (mut fast, mut plain) = (Heights::void(), Heights::void());
                for b in [
                    sample(t, 60, 70, true),
                    RawBlock { fills: Vec::new(), ..sample(t, 80, 33, true) },
                    sample(t, 20, 10, false),
                    corner(sample(t, if whole { N } else { 90 }, N, k % 3 == 0)),
                    sample(t, 50, 50, true),
                ] {
                    fast.lay(&b, scale, offset);
                    plainly(&mut plain, &b, scale, offset);
                    let bits = |h: &Heights| h.z.iter().map(|z| z.to_bits()).collect::<Vec<u64>>();
                    assert_eq!(bits(&fast), bits(&plain), "{t:?}");
                    assert!((0..N * N).all(|p| fast.is_valid(p % N, p / N) == plain.is_valid(p % N, p / N)));
                }
            }
        }
    }
}
