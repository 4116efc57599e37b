//! The decoder of GTB for browsers: a page writes the bytes that it has into the module's memory, and reads a surface from there.
//!
//! Plain numbers in, plain numbers out; no glue code, no imports. The calls, in order:
//!
//! 1. `gtb_room(len)`: address of `len` bytes of memory. Write the file, or its first bytes, there.
//! 2. `gtb_decode(len, seed)`: decodes the first `len` bytes of the room; a room may be decoded many times, with more bytes each
//!    time. 0: there is a surface; 1: there is a sentence that says why not. The seed is of what a texture makes up; the same seed
//!    paints the same bytes everywhere.
//! 3. `gtb_answer()`, `gtb_answer_len()`: address and bytes of the answer: `side * side` little-endian f64 heights in units above
//!    the base, row by row from the north-west; or the sentence in UTF-8. `gtb_picture()`: the texture, three bytes (red, green,
//!    blue) a cell, row by row. Addresses hold until the next call of `gtb_room` or `gtb_decode`, which may move the memory.
//! 4. `gtb_number(k)`: 0 columns, 1 rows, 2 side of the lattice, 3 bytes of the file that were used, 4 whether nothing is missing
//!    (0 or 1), 5 bound of the codec's error in units, 6 metres of one unit, 7 height of the base, 8 cells along a side of the
//!    texture over the lattice's square (0: none travels along). NaN without a surface.
//!
//! The module is used by one thread, as WebAssembly modules are; natively each thread has a room of its own.
#![warn(missing_docs)]

use std::cell::RefCell;
use terraquilt_codecs::gtb::companion::Alone;
use terraquilt_codecs::gtb::texture::{Cells, Reader};
use terraquilt_codecs::gtb::{Decoded, Header, Stop, decode};

#[derive(Default)]
struct State {
    room: Vec<u8>,
    answer: Vec<u8>,
    picture: Vec<u8>,
    numbers: Vec<f64>,
}

thread_local! {
    static STATE: RefCell<State> = RefCell::default();
}

/// Address of a room of `len` bytes; what was written to an earlier room is kept as far as it fits.
#[unsafe(no_mangle)]
pub extern "C" fn gtb_room(len: usize) -> *mut u8 {
    STATE.with_borrow_mut(|s| {
        s.room.resize(len, 0);
        s.room.as_mut_ptr()
    })
}

/// Decodes the first `len` bytes of the room. 0: a surface; 1: a sentence.
#[unsafe(no_mangle)]
pub extern "C" fn gtb_decode(len: usize, seed: u32) -> u32 {
    STATE.with_borrow_mut(|s| match surface(&s.room[..len.min(s.room.len())], seed) {
        Ok(surface) => {
            let h = &surface.decoded.header;
            s.numbers = vec![
                h.cols as f64,
                h.rows as f64,
                h.lattice.side() as f64,
                surface.decoded.bytes_used as f64,
                f64::from(u8::from(surface.decoded.complete)),
                f64::from(surface.decoded.bound),
                h.place.unit,
                h.place.base,
                surface.picture.as_ref().map_or(0.0, |p| f64::from(1_u32 << p.n)),
            ];
            s.answer = surface.z.iter().flat_map(|v| v.to_le_bytes()).collect();
            s.picture = surface.picture.map_or(Vec::new(), |p| p.rgb.concat());
            0
        }
        Err(sentence) => {
            s.answer = sentence.into_bytes();
            s.picture.clear();
            s.numbers.clear();
            1
        }
    })
}

/// Address of the answer.
#[unsafe(no_mangle)]
pub extern "C" fn gtb_answer() -> *const u8 {
    STATE.with_borrow(|s| s.answer.as_ptr())
}

/// Bytes of the answer.
#[unsafe(no_mangle)]
pub extern "C" fn gtb_answer_len() -> usize {
    STATE.with_borrow(|s| s.answer.len())
}

/// Address of the texture's bytes.
#[unsafe(no_mangle)]
pub extern "C" fn gtb_picture() -> *const u8 {
    STATE.with_borrow(|s| s.picture.as_ptr())
}

/// A number about the surface; see the list at the top.
#[unsafe(no_mangle)]
pub extern "C" fn gtb_number(k: usize) -> f64 {
    STATE.with_borrow(|s| s.numbers.get(k).copied().unwrap_or(f64::NAN))
}

/// What a prefix gives.
pub struct Surface {
    /// The stream, as far as it was read.
    pub decoded: Decoded,
    /// `side * side` heights in units above the base.
    pub z: Vec<f64>,
    /// The texture, if one travels along.
    pub picture: Option<Cells>,
}

/// Decodes a file or its first bytes; a sentence where they give no surface.
pub fn surface(bytes: &[u8], seed: u32) -> Result<Surface, String> {
    let told = |e: terraquilt_codecs::Error| e.to_string();
    let (header, _) = Header::read(bytes).map_err(told)?;
    let (mut body, going) = (Vec::new(), &mut |_: f64| true);
    let (decoded, picture) = match header.texture {
        None => (decode(bytes, &mut body, Stop::End, None, &mut Alone, going).map_err(told)?, None),
        Some(n) => {
            let mut reader = Reader::new(n);
            let decoded = decode(bytes, &mut body, Stop::End, None, &mut reader, going).map_err(told)?;
            (decoded, Some(reader.picture(u64::from(seed))))
        }
    };
    Ok(Surface { z: decoded.surface(), decoded, picture })
}
