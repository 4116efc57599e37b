//! Any name and any bytes as an SRTM tile. The first byte of the input is the length of the name; what
//! follows is repeated to the size of a tile, as the fuzzer does not find 2884802 bytes by itself.
#![no_main]

use libfuzzer_sys::fuzz_target;
use terraquilt::height::source::Window;

const TILE_BYTES: usize = 1201 * 1201 * 2;

fuzz_target!(|data: &[u8]| {
    let Some((length, rest)) = data.split_first() else { return };
    let (name, body) = rest.split_at(usize::from(*length).min(rest.len()));
    let name = format!("{}.hgt", String::from_utf8_lossy(name));
    let _ = terraquilt::format::open_bytes(&name, body.to_vec());
    if body.is_empty() {
        return;
    }
    let tile: Vec<u8> = body.iter().copied().cycle().take(TILE_BYTES).collect();
    let Ok(mut source) = terraquilt::format::open_bytes(&name, tile) else { return };
    let window = Window { col: 1100, row: 1150, cols: 101, rows: 51 };
    source.read(window).expect("a window inside a tile in memory is read");
});
