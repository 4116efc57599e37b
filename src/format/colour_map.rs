//! Values as a coloured picture with a legend, as PNG.

use crate::base::{Error, Result, limits};
use std::io::Write;

/// Colours for values, from the low end of the range to the high one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ramp {
    /// Black to white.
    Grey,
    /// Pale to dark red: quantities that begin at 0.
    Heat,
    /// Comes back to where it began: directions.
    Circle,
    /// Blue below the middle, red above, pale in the middle.
    Diverging,
}

impl Ramp {
    fn colors(self) -> &'static [[f32; 3]] {
        match self {
            Ramp::Grey => &[[0.0; 3], [1.0; 3]],
            Ramp::Heat => &[
                [1.0, 0.98, 0.90],
                [0.99, 0.85, 0.55],
                [0.96, 0.60, 0.26],
                [0.82, 0.30, 0.17],
                [0.50, 0.07, 0.15],
                [0.22, 0.02, 0.12],
            ],
            // North grey-blue, east yellow, south red, west violet: neighbours differ, opposites differ most.
            Ramp::Circle => &[
                [0.35, 0.55, 0.85],
                [0.40, 0.78, 0.60],
                [0.95, 0.87, 0.35],
                [0.95, 0.60, 0.30],
                [0.85, 0.32, 0.30],
                [0.72, 0.32, 0.55],
                [0.55, 0.38, 0.75],
                [0.42, 0.46, 0.85],
                [0.35, 0.55, 0.85],
            ],
            Ramp::Diverging => &[
                [0.08, 0.22, 0.50],
                [0.17, 0.45, 0.73],
                [0.52, 0.74, 0.87],
                [0.96, 0.96, 0.94],
                [0.95, 0.66, 0.52],
                [0.80, 0.28, 0.23],
                [0.45, 0.05, 0.13],
            ],
        }
    }

    fn at(self, value: f32, [low, high]: [f32; 2]) -> [u8; 3] {
        let colors = self.colors();
        let part = if high > low { ((value - low) / (high - low)).clamp(0.0, 1.0) } else { 0.5 };
        let place = part * (colors.len() - 1) as f32;
        let k = (place as usize).min(colors.len() - 2);
        let t = place - k as f32;
        std::array::from_fn(|c| {
            let v = colors[k][c] + (colors[k + 1][c] - colors[k][c]) * t;
            (v * 255.0 + 0.5) as u8
        })
    }
}

/// A picture of values; pixels row by row, the first row is the northernmost.
#[derive(Clone, Debug)]
pub struct ColourMap<'a> {
    pub cols: usize,
    pub rows: usize,
    /// NaN: transparent.
    pub values: &'a [f32],
    pub ramp: Ramp,
    /// Values of the ends of the ramp; those beyond are drawn like the ends.
    pub range: [f32; 2],
    /// What stands behind the numbers of the legend: digits, `m`, `%`, `deg`, spaces.
    pub unit: &'a str,
    pub legend: bool,
}

/// Pixels around the legend, height of its bar, side of a dot of its letters.
const GAP: usize = 12;
const BAR: usize = 14;
const DOT: usize = 2;
/// Letters: 5 dots wide, 7 high, one between them.
const LETTER: [usize; 2] = [5, 7];
/// A narrower picture gets a transparent margin, so that the legend has room.
const WIDTH_MIN: usize = 360;
/// Labels under the bar.
const LABELS: usize = 5;

/// Draws the values, and with a legend below them a bar of the colours with the values they stand for: 8 bits RGBA.
///
/// # Errors
/// [`Error::Invalid`] if the sizes do not match or the range is not one, [`Error::Limit`] above
/// [`limits::RASTER_POSTS_MAX`], [`Error::Io`] from `out`.
pub fn write_colour_map(out: &mut dyn Write, map: &ColourMap) -> Result<()> {
    let ColourMap { cols, rows, .. } = *map;
    let count = cols as u64 * rows as u64;
    if count > limits::RASTER_POSTS_MAX {
        return Err(Error::limit("pixels of a picture", limits::RASTER_POSTS_MAX, count));
    }
    if count == 0 || map.values.len() as u64 != count {
        return Err(Error::invalid(
            "picture",
            format!("{cols} x {rows} pixels do not match the values given"),
        ));
    }
    if !(map.range.iter().all(|v| v.is_finite()) && map.range[0] < map.range[1]) {
        return Err(Error::invalid("picture", format!("range of colours {:?} is empty", map.range)));
    }
    let width = if map.legend { cols.max(WIDTH_MIN) } else { cols };
    let left = (width - cols) / 2;
    let legend = if map.legend { legend(map, width) } else { Vec::new() };
    let height = rows + legend.len() / (4 * width);
    let mut encoder = png::Encoder::new(out, width as u32, height as u32);
    encoder.set_color(png::ColorType::Rgba);
    encoder.set_depth(png::BitDepth::Eight);
    encoder.set_source_srgb(png::SrgbRenderingIntent::Perceptual);
    let mut writer = encoder.write_header().map_err(png_error)?;
    let mut stream = writer.stream_writer().map_err(png_error)?;
    for row in map.values.chunks(cols) {
        let mut line = vec![0u8; 4 * width];
        for (pixel, v) in line[4 * left..].chunks_exact_mut(4).zip(row) {
            if !v.is_nan() {
                pixel[..3].copy_from_slice(&map.ramp.at(*v, map.range));
                pixel[3] = 255;
            }
        }
        stream.write_all(&line).map_err(|e| Error::io("PNG", e))?;
    }
    stream.write_all(&legend).map_err(|e| Error::io("PNG", e))?;
    stream.finish().map_err(png_error)?;
    writer.finish().map_err(png_error)
}

fn png_error(error: png::EncodingError) -> Error {
    match error {
        png::EncodingError::IoError(e) => Error::io("PNG", e),
        other => Error::invalid("PNG", other),
    }
}

/// The rows of the legend: a bar, ticks, labels, on white.
fn legend(map: &ColourMap, width: usize) -> Vec<u8> {
    let height = GAP + BAR + 4 + LETTER[1] * DOT + GAP;
    let mut rows = vec![255u8; 4 * width * height];
    let mut dot = |x: usize, y: usize, c: [u8; 3]| {
        if x < width && y < height {
            rows[4 * (y * width + x)..][..3].copy_from_slice(&c);
        }
    };
    // Half a label of room at both ends.
    let labels: Vec<String> = (0..LABELS).map(|k| label(map, k)).collect();
    let advance = (LETTER[0] + 1) * DOT;
    let margin = GAP + labels.iter().map(|l| l.len() * advance / 2).max().unwrap_or(0);
    let bar = width - 2 * margin;
    for x in 0..bar {
        let part = x as f32 / (bar - 1) as f32;
        let color = map.ramp.at(map.range[0] + (map.range[1] - map.range[0]) * part, map.range);
        for y in 0..BAR {
            dot(margin + x, GAP + y, color);
        }
    }
    const INK: [u8; 3] = [40; 3];
    for (k, text) in labels.iter().enumerate() {
        let x = margin + k * (bar - 1) / (LABELS - 1);
        (BAR..BAR + 3).for_each(|y| dot(x, GAP + y, INK));
        let from = (x + DOT / 2).saturating_sub(text.len() * advance / 2);
        for (n, letter) in text.bytes().enumerate() {
            for (row, bits) in glyph(letter).into_iter().enumerate() {
                for col in (0..LETTER[0]).filter(|c| bits >> (LETTER[0] - 1 - c) & 1 == 1) {
                    for k in 0..DOT * DOT {
                        let at =
                            [from + n * advance + col * DOT + k % DOT, GAP + BAR + 4 + row * DOT + k / DOT];
                        dot(at[0], at[1], INK);
                    }
                }
            }
        }
    }
    rows
}

/// The value at one of the labels, with as many digits as tell it from the next.
fn label(map: &ColourMap, k: usize) -> String {
    let step = (map.range[1] - map.range[0]) / (LABELS - 1) as f32;
    let v = map.range[0] + step * k as f32;
    let digits = (1.0 - step.log10()).floor().clamp(0.0, 4.0) as usize;
    let text = format!("{v:.digits$}");
    let text = if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.') } else { &text };
    let text = if text == "-0" { "0" } else { text };
    let unit = if map.unit.is_empty() { String::new() } else { format!(" {}", map.unit) };
    // The unit stands once, behind the last number.
    format!("{text}{}", if k == LABELS - 1 { &unit } else { "" })
}

/// Seven rows of five dots, the most significant bit left.
fn glyph(letter: u8) -> [u8; 7] {
    match letter {
        b'0' => [0b01110, 0b10001, 0b10011, 0b10101, 0b11001, 0b10001, 0b01110],
        b'1' => [0b00100, 0b01100, 0b00100, 0b00100, 0b00100, 0b00100, 0b01110],
        b'2' => [0b01110, 0b10001, 0b00001, 0b00110, 0b01000, 0b10000, 0b11111],
        b'3' => [0b01110, 0b10001, 0b00001, 0b00110, 0b00001, 0b10001, 0b01110],
        b'4' => [0b00010, 0b00110, 0b01010, 0b10010, 0b11111, 0b00010, 0b00010],
        b'5' => [0b11111, 0b10000, 0b11110, 0b00001, 0b00001, 0b10001, 0b01110],
        b'6' => [0b00110, 0b01000, 0b10000, 0b11110, 0b10001, 0b10001, 0b01110],
        b'7' => [0b11111, 0b00001, 0b00010, 0b00100, 0b01000, 0b01000, 0b01000],
        b'8' => [0b01110, 0b10001, 0b10001, 0b01110, 0b10001, 0b10001, 0b01110],
        b'9' => [0b01110, 0b10001, 0b10001, 0b01111, 0b00001, 0b00010, 0b01100],
        b'.' => [0, 0, 0, 0, 0, 0b01100, 0b01100],
        b'-' => [0, 0, 0, 0b01110, 0, 0, 0],
        b'%' => [0b11001, 0b11010, 0b00010, 0b00100, 0b01000, 0b01011, 0b10011],
        b'm' => [0, 0, 0b11010, 0b10101, 0b10101, 0b10101, 0b10101],
        b'd' => [0b00001, 0b00001, 0b01101, 0b10011, 0b10001, 0b10011, 0b01101],
        b'e' => [0, 0, 0b01110, 0b10001, 0b11111, 0b10000, 0b01110],
        b'g' => [0, 0b01111, 0b10001, 0b10001, 0b01111, 0b00001, 0b01110],
        _ => [0; 7],
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn drawn(map: &ColourMap) -> (usize, Vec<u8>) {
        let mut bytes = Vec::new();
        write_colour_map(&mut bytes, map).expect("a picture");
        let mut reader = png::Decoder::new(std::io::Cursor::new(bytes)).read_info().expect("a PNG");
        let mut pixels = vec![0; reader.output_buffer_size().expect("a size")];
        let width = reader.info().width as usize;
        reader.next_frame(&mut pixels).expect("pixels");
        (width, pixels)
    }

    #[test]
    fn below_is_blue_above_is_red_and_nothing_is_transparent() {
        let values = [-5.0, 0.0, 5.0, f32::NAN];
        let map = ColourMap {
            cols: 4,
            rows: 1,
            values: &values,
            ramp: Ramp::Diverging,
            range: [-5.0, 5.0],
            unit: "m",
            legend: true,
        };
        let (width, pixels) = drawn(&map);
        let first = 4 * ((width - 4) / 2);
        let p: Vec<&[u8]> = pixels[first..first + 16].chunks(4).collect();
        assert!(p[0][2] > 2 * p[0][0] && p[2][0] > 2 * p[2][2], "{p:?}");
        assert!(p[1][..3].iter().all(|v| *v > 220) && p[3][3] == 0, "{p:?}");
        // The legend repeats both ends of the ramp, and has ink for its numbers.
        let below = &pixels[4 * width..];
        assert!(below.chunks(4).any(|q| q == p[0]) && below.chunks(4).any(|q| q == p[2]));
        assert!(below.chunks(4).filter(|q| q[..3] == [40; 3]).count() > 100);
    }

    #[test]
    fn labels_tell_their_values_apart() {
        for (range, found) in [
            ([-20.0f32, 20.0], ["-20", "-10", "0", "10", "20 m"]),
            ([0.0, 0.2], ["0", "0.05", "0.1", "0.15", "0.2 m"]),
        ] {
            let map = ColourMap {
                cols: 1,
                rows: 1,
                values: &[0.0],
                ramp: Ramp::Heat,
                range,
                unit: "m",
                legend: true,
            };
            let labels: Vec<String> = (0..LABELS).map(|k| label(&map, k)).collect();
            assert_eq!(labels, found);
            // Each letter is one that can be drawn.
            for b in labels.concat().bytes().filter(|b| *b != b' ') {
                assert_ne!(glyph(b), [0; 7], "{}", b as char);
            }
        }
    }

    #[test]
    fn sizes_that_do_not_match_are_refused() {
        let good = ColourMap {
            cols: 1,
            rows: 1,
            values: &[0.0],
            ramp: Ramp::Grey,
            range: [0.0, 1.0],
            unit: "",
            legend: false,
        };
        let mut out = Vec::new();
        assert!(write_colour_map(&mut out, &ColourMap { rows: 2, ..good.clone() }).is_err());
        assert!(write_colour_map(&mut out, &ColourMap { range: [1.0, 1.0], ..good.clone() }).is_err());
        assert!(write_colour_map(&mut out, &ColourMap { range: [f32::NAN, 1.0], ..good }).is_err());
        assert!(out.is_empty());
    }
}
