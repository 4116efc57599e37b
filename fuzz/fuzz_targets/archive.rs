//! Any bytes as a zip. First byte even: as they are; odd: packed as an ASCII grid and read as if never packed.
#![no_main]

use libfuzzer_sys::fuzz_target;
use std::io::{Cursor, Write};
use terraquilt::format::open_bytes;
use terraquilt::height::source::{HeightSource, Window};
use zip::{ZipWriter, write::SimpleFileOptions};

fuzz_target!(|data: &[u8]| {
    let Some((kind, rest)) = data.split_first() else { return };
    if kind % 2 == 0 {
        let bytes = [b"PK\x03\x04", rest].concat();
        if let Ok(mut source) = open_bytes("a.zip", bytes) {
            endure(source.as_mut());
        }
        return;
    }
    if rest.starts_with(b"PK") {
        // An archive in an archive is refused.
        return;
    }
    let mut zip = ZipWriter::new(Cursor::new(Vec::new()));
    zip.start_file("a.asc", SimpleFileOptions::default()).expect("a name");
    zip.write_all(rest).expect("memory");
    let packed = zip.finish().expect("memory").into_inner();
    let (plain, packed) = (open_bytes("a.asc", rest.to_vec()), open_bytes("a.zip", packed));
    assert_eq!(plain.is_ok(), packed.is_ok());
    if let (Ok(mut plain), Ok(mut packed)) = (plain, packed) {
        let cols = plain.info().cols.min(2048) as usize;
        let window = Window { col: 0, row: 0, cols, rows: 1 };
        assert_eq!(plain.read(window).ok(), packed.read(window).ok());
        endure(packed.as_mut());
    }
});

/// Start and end of a grid: an error or samples of the right number.
fn endure(source: &mut dyn HeightSource) -> bool {
    let info = source.info().clone();
    let (cols, rows) = (info.cols.min(2048) as usize, info.rows.min(512) as usize);
    [(0, 0), (info.cols - cols as u64, info.rows - rows as u64)].into_iter().all(|(col, row)| {
        let Ok(samples) = source.read(Window { col, row, cols, rows }) else { return false };
        assert_eq!(samples.valid.len(), cols * rows);
        assert_eq!(samples.data.len(), cols * rows * info.sample_type.bytes());
        true
    })
}
