//! Any bytes as a GTX geoid grid: an error, or a grid that answers everywhere.
#![no_main]

use libfuzzer_sys::fuzz_target;

fuzz_target!(|data: &[u8]| {
    let Ok(geoid) = terraquilt::format::geoid::open_bytes("grid.gtx", data.to_vec()) else { return };
    let [west, south, east, north] = geoid.bounds();
    for (x, y) in [(0.0, 0.0), (0.5, 0.5), (1.0, 1.0), (1.5, 0.3)] {
        let _ = geoid.undulation(west + x * (east - west), south + y * (north - south));
    }
});
