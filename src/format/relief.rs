//! Shaded relief as PNG.
//!
//! Light comes from the north-west at 45 degrees, with weaker lights beside it and from above, so that no
//! slope is black (after R. Mark: Multidirectional, oblique-weighted, shaded-relief image, USGS OFR 92-422,
//! 1992; with fixed weights). Colours are tints of height, or a class for each pixel: the size of the patch
//! that it was made of, from blue (large) over yellow to red (small), as in figure 5 of Rocca, Panozzo and
//! Puppo, Patchwork Terrains. Flat land is exaggerated until its slopes can be seen.

use std::io::Write;

use rayon::prelude::*;

use crate::base::{Error, Result, limits};

/// A picture to be drawn; pixels row by row, the first row is the northernmost.
#[derive(Debug, Clone)]
pub struct Relief<'a> {
    pub cols: usize,
    pub rows: usize,
    /// Height of each pixel, metres; NaN: none (transparent).
    pub z: &'a [f32],
    /// Width and height of a pixel, metres.
    pub cell_m: [f64; 2],
    /// log2 of the side (metres) of the patch at each pixel; NaN: none (grey).
    pub class: Option<&'a [f32]>,
    /// The classes that are drawn red (smallest) and blue (largest); `None`: those that all but
    /// one in a hundred pixels lie between. Give it where pictures shall be compared.
    pub class_range: Option<[f32; 2]>,
}

/// Lights: from where (east, north, up; unit vectors), how strong.
const LIGHTS: [([f32; 3], f32); 4] = [
    ([-0.5, 0.5, 0.707_106_77], 0.62), // north-west, 45 degrees high
    ([-0.866_025_4, 0.0, 0.5], 0.13),  // west, 30 degrees
    ([0.0, 0.866_025_4, 0.5], 0.13),   // north, 30 degrees
    ([0.353_553_4, -0.353_553_4, 0.866_025_4], 0.12), // a breath from the south-east
];

/// Red (small) to blue (large): lightness rises to the middle and the hue never turns back.
const CLASS_COLORS: [[f32; 3]; 7] = [
    [0.830, 0.290, 0.210],
    [0.935, 0.490, 0.250],
    [0.985, 0.715, 0.370],
    [0.970, 0.915, 0.640],
    [0.630, 0.850, 0.770],
    [0.360, 0.690, 0.830],
    [0.260, 0.450, 0.720],
];

/// Lowland to summit, muted: the shading carries the shape.
const HEIGHT_COLORS: [[f32; 3]; 6] = [
    [0.590, 0.690, 0.560],
    [0.760, 0.790, 0.630],
    [0.890, 0.840, 0.690],
    [0.830, 0.730, 0.590],
    [0.780, 0.700, 0.630],
    [0.965, 0.960, 0.955],
];

const NO_CLASS: [f32; 3] = [0.78, 0.78, 0.78];

/// One slope in ten is at least this steep after exaggeration, if the exaggeration stays below its limit.
const STEEP_SLOPE: f64 = 0.45;
const EXAGGERATION_MAX: f64 = 20.0;
/// Heights and slopes are judged by about so many pixels.
const SAMPLE_PIXELS: usize = 200_000;
/// Rows drawn (in parallel) between two writes.
const BLOCK_ROWS: usize = 128;

/// Draws a shaded relief: 8 bits RGBA, transparent where there is no height. Takes about 50 ns a pixel and
/// core, and holds 128 rows. The same input gives the same bytes.
///
/// # Errors
/// [`Error::Invalid`] if an array does not have `cols` times `rows` values or the size is zero,
/// [`Error::Limit`] above [`limits::RASTER_POSTS_MAX`], [`Error::Io`] from `out`.
pub fn write_relief(out: &mut dyn Write, relief: &Relief) -> Result<()> {
    write_painted_relief(out, relief, None, None)
}

/// As [`write_relief`], with a colour of its own (sRGB) for each pixel that has one, and what the file says of itself.
///
/// # Errors
/// As [`write_relief`]; [`Error::Invalid`] if there is not one entry a pixel.
pub fn write_painted_relief(
    out: &mut dyn Write,
    relief: &Relief,
    paint: Option<&[Option<[u8; 3]>]>,
    comment: Option<&str>,
) -> Result<()> {
    let Relief { cols, rows, .. } = *relief;
    let count = cols as u64 * rows as u64;
    if count > limits::RASTER_POSTS_MAX {
        return Err(Error::limit("pixels of a picture", limits::RASTER_POSTS_MAX, count));
    }
    let lengths = [Some(relief.z.len()), relief.class.map(<[f32]>::len), paint.map(<[_]>::len)];
    if count == 0 || lengths.into_iter().flatten().any(|n| n as u64 != count) {
        return Err(Error::invalid(
            "relief",
            format!("{cols} x {rows} pixels do not match the values given"),
        ));
    }
    if !relief.cell_m.iter().all(|&m| m.is_finite() && m > 0.0) {
        return Err(Error::invalid("relief", format!("a pixel of {:?} m", relief.cell_m)));
    }
    let ink = Ink::new(relief);
    let mut encoder = png::Encoder::new(out, cols as u32, rows as u32);
    encoder.set_color(png::ColorType::Rgba);
    encoder.set_depth(png::BitDepth::Eight);
    encoder.set_source_srgb(png::SrgbRenderingIntent::Perceptual);
    if let Some(text) = comment {
        encoder.add_text_chunk("Comment".into(), text.into()).map_err(png_error)?;
    }
    let mut writer = encoder.write_header().map_err(png_error)?;
    let mut stream = writer.stream_writer().map_err(png_error)?;
    for first in (0..rows).step_by(BLOCK_ROWS) {
        let height = BLOCK_ROWS.min(rows - first);
        let mut block = vec![0u8; height * cols * 4];
        block
            .par_chunks_mut(cols * 4)
            .enumerate()
            .for_each(|(r, line)| draw_row(relief, paint, &ink, first + r, line));
        stream.write_all(&block).map_err(|e| Error::io("PNG", e))?;
    }
    stream.finish().map_err(png_error)?;
    writer.finish().map_err(png_error)
}

fn png_error(error: png::EncodingError) -> Error {
    match error {
        png::EncodingError::IoError(e) => Error::io("PNG", e),
        other => Error::invalid("PNG", other),
    }
}

/// What was decided from the whole picture.
struct Ink {
    /// Per metre of height difference between the columns (rows) beside a pixel: slope, exaggerated.
    slope: [f32; 2],
    /// Lowest and highest height of the tints.
    heights: [f32; 2],
    classes: [f32; 2],
}

impl Ink {
    fn new(relief: &Relief) -> Ink {
        let stride = (relief.z.len() / SAMPLE_PIXELS).max(1) | 1;
        let mut heights = Vec::new();
        let mut slopes = Vec::new();
        for i in (0..relief.z.len()).step_by(stride).filter(|&i| relief.z[i].is_finite()) {
            heights.push(relief.z[i]);
            let [x, y] = rises(relief, i % relief.cols, i / relief.cols);
            slopes.push((f64::from(x) / relief.cell_m[0]).hypot(f64::from(y) / relief.cell_m[1]) as f32);
        }
        heights.sort_by(f32::total_cmp);
        slopes.sort_by(f32::total_cmp);
        let quantile = |sorted: &[f32], part: f64| match sorted.len() {
            0 => 0.0,
            n => sorted[((n - 1) as f64 * part).round() as usize],
        };
        let steep = f64::from(quantile(&slopes, 0.9)).max(1e-9);
        let exaggeration = (STEEP_SLOPE / steep).clamp(1.0, EXAGGERATION_MAX);
        let sampled = relief.class.into_iter().flat_map(|c| c.iter().step_by(stride));
        let mut classes: Vec<f32> = sampled.copied().filter(|c| c.is_finite()).collect();
        classes.sort_by(f32::total_cmp);
        let common = [quantile(&classes, 0.01), quantile(&classes, 0.99)];
        Ink {
            slope: relief.cell_m.map(|m| (exaggeration / m) as f32),
            heights: [quantile(&heights, 0.002), quantile(&heights, 0.998)],
            classes: relief.class_range.unwrap_or(common),
        }
    }
}

/// Rise of the surface per pixel towards east and north (Horn's weights); missing neighbours are level.
fn rises(relief: &Relief, col: usize, row: usize) -> [f32; 2] {
    let centre = relief.z[row * relief.cols + col];
    let at = |dc: isize, dr: isize| {
        let c = col.saturating_add_signed(dc).min(relief.cols - 1);
        let r = row.saturating_add_signed(dr).min(relief.rows - 1);
        let z = relief.z[r * relief.cols + c];
        if z.is_finite() { z } else { centre }
    };
    let (nw, n, ne) = (at(-1, -1), at(0, -1), at(1, -1));
    let (w, e) = (at(-1, 0), at(1, 0));
    let (sw, s, se) = (at(-1, 1), at(0, 1), at(1, 1));
    [((ne - nw) + 2.0 * (e - w) + (se - sw)) / 8.0, ((nw - sw) + 2.0 * (n - s) + (ne - se)) / 8.0]
}

fn draw_row(relief: &Relief, paint: Option<&[Option<[u8; 3]>]>, ink: &Ink, row: usize, line: &mut [u8]) {
    for (col, pixel) in line.chunks_exact_mut(4).enumerate() {
        let i = row * relief.cols + col;
        let z = relief.z[i];
        if !z.is_finite() {
            continue;
        }
        let [east, north] = rises(relief, col, row);
        let light = shade(east * ink.slope[0], north * ink.slope[1]);
        let painted = paint.and_then(|p| p[i]).map(|rgb| rgb.map(|v| f32::from(v) / 255.0));
        let tint = match relief.class {
            _ if painted.is_some() => painted.unwrap_or(NO_CLASS),
            None => ramp(&HEIGHT_COLORS, z, ink.heights),
            Some(class) if class[i].is_finite() => ramp(&CLASS_COLORS, class[i], ink.classes),
            Some(_) => NO_CLASS,
        };
        for (byte, v) in pixel.iter_mut().zip(lit(tint, light)) {
            *byte = (v * 255.0 + 0.5).clamp(0.0, 255.0) as u8;
        }
        pixel[3] = 255;
    }
}

/// How bright a slope is: 1 on level ground, below in the shade, above towards the light.
fn shade(east: f32, north: f32) -> f32 {
    let length = (east * east + north * north + 1.0).sqrt();
    let sum = |n: [f32; 3]| -> f32 {
        LIGHTS.iter().map(|(l, weight)| weight * (n[0] * l[0] + n[1] * l[1] + n[2] * l[2]).max(0.0)).sum()
    };
    sum([-east / length, -north / length, 1.0 / length]) / sum([0.0, 0.0, 1.0])
}

/// A tint in some light: shade turns bluish and never black, light turns towards warm white.
fn lit(tint: [f32; 3], light: f32) -> [f32; 3] {
    const SHADE: [f32; 3] = [0.16, 0.17, 0.27];
    const GLOW: [f32; 3] = [1.0, 0.985, 0.94];
    if light < 1.0 {
        let dark = (1.0 - light).powf(0.95) * 0.95;
        std::array::from_fn(|k| tint[k] * (1.0 - dark) + tint[k].mul_add(0.35, SHADE[k] * 0.65) * dark * 0.75)
    } else {
        let bright = ((light - 1.0) * 1.5).min(0.75);
        std::array::from_fn(|k| tint[k] + (GLOW[k] - tint[k]) * bright)
    }
}

/// The colour of `value` on a ramp that spans `range`; the middle one if the range is empty.
fn ramp(colors: &[[f32; 3]], value: f32, [low, high]: [f32; 2]) -> [f32; 3] {
    let part = if high > low { ((value - low) / (high - low)).clamp(0.0, 1.0) } else { 0.5 };
    let place = part * (colors.len() - 1) as f32;
    let i = (place as usize).min(colors.len() - 2);
    let t = place - i as f32;
    std::array::from_fn(|k| colors[i][k] + (colors[i + 1][k] - colors[i][k]) * t)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn drawn(relief: &Relief) -> Vec<u8> {
        let mut bytes = Vec::new();
        write_relief(&mut bytes, relief).expect("a picture");
        let mut reader = png::Decoder::new(std::io::Cursor::new(bytes)).read_info().expect("a PNG");
        let mut pixels = vec![0; reader.output_buffer_size().expect("a size")];
        reader.next_frame(&mut pixels).expect("pixels");
        pixels
    }

    fn brightness(pixel: &[u8]) -> u32 {
        pixel[..3].iter().map(|&v| u32::from(v)).sum()
    }

    #[test]
    fn pixels_without_height_are_transparent() {
        let z = [1.0, f32::NAN, 2.0, 3.0, 4.0, f32::INFINITY];
        let pixels =
            drawn(&Relief { cols: 3, rows: 2, z: &z, cell_m: [1.0, 1.0], class: None, class_range: None });
        let opaque: Vec<bool> = pixels.chunks(4).map(|p| p[3] == 255).collect();
        assert_eq!(opaque, [true, false, true, true, true, false]);
        let nothing = [f32::NAN; 4];
        let pixels = drawn(&Relief {
            cols: 2,
            rows: 2,
            z: &nothing,
            cell_m: [1.0, 1.0],
            class: Some(&nothing),
            class_range: None,
        });
        assert!(pixels.iter().all(|&v| v == 0));
    }

    #[test]
    fn slopes_to_the_north_west_are_lit_and_no_slope_is_black() {
        let side = 9;
        let plane = |east: f32, north: f32| -> u32 {
            let z: Vec<f32> =
                (0..side * side).map(|i| east * (i % side) as f32 - north * (i / side) as f32).collect();
            let flat = vec![0.0f32; z.len()];
            let relief = Relief {
                cols: side,
                rows: side,
                z: &z,
                cell_m: [1.0, 1.0],
                class: Some(&flat),
                class_range: Some([-1.0, 1.0]),
            };
            brightness(&drawn(&relief)[4 * (side * 4 + 4)..])
        };
        let (level, lit, dark) = (plane(0.0, 0.0), plane(0.5, -0.5), plane(-0.5, 0.5));
        assert!(lit > level && level > dark, "{lit} {level} {dark}");
        for (east, north) in [(-9.0, 9.0), (9.0, 9.0), (-9.0, -9.0), (0.0, 9.0), (-9.0, 0.0)] {
            assert!(plane(east, north) > 120);
        }
    }

    #[test]
    fn small_patches_are_red_and_large_ones_blue() {
        let class = [2.0, 9.0];
        let pixels = drawn(&Relief {
            cols: 2,
            rows: 1,
            z: &[5.0, 5.0],
            cell_m: [1.0, 1.0],
            class: Some(&class),
            class_range: None,
        });
        assert!(pixels[0] > pixels[2] && pixels[4] < pixels[6], "{pixels:?}");
    }

    #[test]
    fn sizes_that_do_not_match_are_refused() {
        let mut out = Vec::new();
        let good =
            Relief { cols: 2, rows: 1, z: &[0.0, 0.0], cell_m: [1.0, 1.0], class: None, class_range: None };
        assert!(write_relief(&mut out, &Relief { rows: 2, ..good.clone() }).is_err());
        assert!(write_relief(&mut out, &Relief { class: Some(&[0.0]), ..good.clone() }).is_err());
        assert!(write_relief(&mut out, &Relief { cols: 0, z: &[], ..good.clone() }).is_err());
        assert!(write_relief(&mut out, &Relief { cell_m: [0.0, 1.0], ..good.clone() }).is_err());
        assert!(out.is_empty());
    }
}
