//! Any bytes as an Esri ASCII grid, a USGS DEM or DTED. The first byte chooses; a header that is right stands before
//! the rest every second time, so that the fuzzer need not find one. What the text formats open, they read.
#![no_main]

use libfuzzer_sys::fuzz_target;
use terraquilt::height::source::{HeightSource, Window};

fuzz_target!(|data: &[u8]| {
    let Some((kind, rest)) = data.split_first() else { return };
    let (name, head) = match kind % 6 {
        0 => ("a.asc", String::new()),
        1 => ("a.asc", "ncols 3\nnrows 2\nxllcorner 0\nyllcorner 0\ncellsize 1\n".to_string()),
        2 => ("a.dem", String::new()),
        3 => ("a.dem", record_a()),
        4 => ("a.dt0", String::new()),
        _ => ("a.dt0", format!("{:<80}", "UHL10710000W0010000S03000300NA  U              000300040")),
    };
    let bytes = [head.as_bytes(), rest].concat();
    let Ok(mut source) = terraquilt::format::open_bytes(name, bytes) else { return };
    let read = endure(source.as_mut());
    let looked_through = ["Esri ASCII grid", "USGS DEM"].contains(&source.info().format);
    assert!(read || !looked_through, "what was looked through at opening is read");
});

/// The header of a USGS DEM: UTM, metres, steps of 30 m, two profiles.
fn record_a() -> String {
    let mut text = format!("{:<144}{:>6}{:>6}{:>6}{:>6}{:<360}", "QUAD", 1, 1, 1, 10, "");
    text += &format!("{:>6}{:>6}{:>6}{:<264}{:>6}", 2, 2, 4, "", 0);
    text += &format!("{:>12}{:>12}{:>12}{:>6}{:>6}{:<160}", "0.3E+02", "0.3E+02", "0.1E+01", 1, 2, "");
    text
}

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
