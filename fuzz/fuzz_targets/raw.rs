//! Any bytes as what lies beside a grid: `.hdr`, `.prj`, world file, `.aux.xml`; parted by zeros.
#![no_main]

use libfuzzer_sys::fuzz_target;
use terraquilt::height::source::{HeightSource, Window};

fuzz_target!(|data: &[u8]| {
    let Some((kind, rest)) = data.split_first() else { return };
    let mut parts = rest.split(|b| *b == 0).map(<[u8]>::to_vec);
    let names = ["a.hdr", "a.prj", "a.wld", "a.aux.xml"];
    let beside: Vec<(String, Vec<u8>)> =
        names.into_iter().map_while(|n| Some((n.to_string(), parts.next()?))).collect();
    let name = ["a.flt", "a.bil", "a.dem", "a"][usize::from(kind % 4)];
    let bytes: Vec<u8> = parts.flatten().chain([1; 600]).collect();
    let Ok(mut source) = terraquilt::format::open_bytes_beside(name, bytes, beside) else { return };
    let read = endure(source.as_mut());
    let raw = ["Esri raw grid", "ENVI"].contains(&source.info().format);
    assert!(read || !raw, "a layout that was held against the file is read");
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
