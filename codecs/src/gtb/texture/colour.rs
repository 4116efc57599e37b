//! Red, green and blue as one lightness and two differences, reversibly (YCoCg-R).

/// Lightness 0 to 255 and two differences, -255 to 255.
pub fn apart([r, g, b]: [u8; 3]) -> [i32; 3] {
    let [r, g, b] = [r, g, b].map(i32::from);
    let co = r - b;
    let t = b + (co >> 1);
    let cg = g - t;
    [t + (cg >> 1), co, cg]
}

/// The inverse of [`apart`], held to 0 to 255.
pub fn together([y, co, cg]: [i32; 3]) -> [u8; 3] {
    let t = y.wrapping_sub(cg >> 1);
    let g = cg.wrapping_add(t);
    let b = t.wrapping_sub(co >> 1);
    let r = b.wrapping_add(co);
    [r, g, b].map(|v| v.clamp(0, 255) as u8)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_colour_comes_back() {
        for k in 0..1u32 << 24 {
            let rgb = [k as u8, (k >> 8) as u8, (k >> 16) as u8];
            assert_eq!(together(apart(rgb)), rgb);
        }
    }
}
