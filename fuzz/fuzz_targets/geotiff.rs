//! Any bytes behind a TIFF magic: an error or samples, never a panic, a hang or a huge allocation.
#![no_main]

use libfuzzer_sys::fuzz_target;
use terraquilt::height::source::Window;

fuzz_target!(|data: &[u8]| {
    let Ok(mut source) = terraquilt::format::open_bytes("fuzz.tif", data.to_vec()) else { return };
    let (cols, rows) = (source.info().cols.min(2048) as usize, source.info().rows.min(512) as usize);
    let (last_col, last_row) = (source.info().cols - cols as u64, source.info().rows - rows as u64);
    for (col, row) in [(0, 0), (last_col, last_row)] {
        if let Ok(samples) = source.read(Window { col, row, cols, rows }) {
            assert_eq!(samples.valid.len(), cols * rows);
            assert_eq!(samples.data.len(), cols * rows * source.info().sample_type.bytes());
        }
    }
});
