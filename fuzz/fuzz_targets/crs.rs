//! Any text as a coordinate system (EPSG, ESRI, PROJ string, WKT): an error, or a system whose text is read again
//! as itself.
#![no_main]

use libfuzzer_sys::fuzz_target;
use terraquilt::height::crs::Crs;
use terraquilt::height::crs::vertical::Vertical;

fuzz_target!(|data: &[u8]| {
    let Ok(text) = std::str::from_utf8(data) else { return };
    let _ = Vertical::of_text(text);
    let Ok(crs) = Crs::parse(text) else { return };
    let again = Crs::parse(&crs.code).expect("a stored text is read");
    assert_eq!(again.code, crs.code);
});
