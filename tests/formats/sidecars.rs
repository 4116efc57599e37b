//! What lies beside a grid: headers of raw grids, world files, GDAL's notes.

use super::{Random, check_windows, read_all};
use terraquilt::base::Error;
use terraquilt::format::{open, open_bytes_beside};
use terraquilt::height::source::{HeightSource, SampleType};

fn raw(name: &str, bytes: &[u8], header: &str) -> Result<Box<dyn HeightSource>, Error> {
    open_bytes_beside(name, bytes.to_vec(), vec![("a.hdr".to_string(), header.as_bytes().to_vec())])
}

fn values(source: &mut dyn HeightSource) -> Vec<f64> {
    let all = read_all(source).unwrap();
    check_windows(source, &all, &mut Random(4));
    let t = source.info().sample_type;
    all.data.chunks_exact(t.bytes()).map(|b| t.value(b)).collect()
}

/// Two bands of 3 x 2 samples: 1 to 6, and 101 to 106.
fn bands(order: &str, big_endian: bool) -> Vec<u8> {
    let at = |band: u16, row: u16, col: u16| 100 * band + row * 3 + col + 1;
    let mut all = Vec::new();
    let mut put = |v: u16| all.extend(if big_endian { v.to_be_bytes() } else { v.to_le_bytes() });
    for outer in 0..2 {
        for inner in 0..2 {
            for col in 0..3 {
                match order {
                    "bsq" => put(at(outer, inner, col)),
                    "bil" => put(at(inner, outer, col)),
                    _ => {}
                }
            }
        }
    }
    if order == "bip" {
        (0..6).for_each(|k| (0..2).for_each(|band| put(at(band, k / 3, k % 3))));
    }
    all
}

#[test]
fn bands_in_every_order_give_the_first() {
    let expected: Vec<f64> = (1..=6).map(f64::from).collect();
    for order in ["bsq", "bil", "bip"] {
        for big in [false, true] {
            let esri = format!(
                "NROWS 2\nNCOLS 3\nNBANDS 2\nNBITS 16\nPIXELTYPE UNSIGNEDINT\nLAYOUT {}\nBYTEORDER {}\nULXMAP 5\nULYMAP 9\nXDIM 2\nYDIM 2\n",
                order.to_uppercase(),
                if big { "M" } else { "I" }
            );
            let envi = format!(
                "ENVI\ndescription = {{\n  two = bands}}\nsamples = 3\nlines = 2\nbands = 2\ndata type = 12\ninterleave = {order}\nbyte order = {}\nheader offset = 4\n",
                u8::from(big)
            );
            let bytes = bands(order, big);
            let mut source = raw(&format!("a.{order}"), &bytes, &esri).unwrap();
            assert_eq!(values(source.as_mut()), expected, "{esri}");
            assert_eq!(source.info().affine.unwrap().origin, [5.0, 9.0]);
            assert!(source.info().notes.iter().any(|n| n.contains("2 bands")));
            let mut source = raw("a.img", &[b"skip".to_vec(), bytes].concat(), &envi).unwrap();
            assert_eq!(values(source.as_mut()), expected, "{envi}");
        }
    }
}

#[test]
fn a_float_grid_has_the_words_of_an_ascii_grid() {
    let head = "ncols 2\r\nnrows 2\r\nxllcorner 100\r\nyllcorner 200\r\ncellsize 10\r\nNODATA_value -9999\r\nbyteorder MSBFIRST\r\n";
    let bytes: Vec<u8> = [1.5f32, -9999.0, 3.0, f32::NAN].iter().flat_map(|v| v.to_be_bytes()).collect();
    let mut source = raw("a.flt", &bytes, head).unwrap();
    let all = read_all(source.as_mut()).unwrap();
    assert_eq!((source.info().sample_type, &all.valid[..]), (SampleType::F32, &[1, 0, 1, 0][..]));
    assert_eq!(source.info().affine.unwrap().origin, [105.0, 215.0]);
    assert_eq!(SampleType::F32.value(&all.data), 1.5);
}

#[test]
fn headers_that_lie_are_refused_with_what_they_say() {
    let good = "ENVI\nsamples = 3\nlines = 2\nbands = 1\ndata type = 2\ninterleave = bsq\n";
    let esri = "NROWS 2\nNCOLS 3\nNBITS 16\nLAYOUT BIL\nPIXELTYPE SIGNEDINT\n";
    let cases = [
        (good.replace("samples = 3", "samples = 300"), "1200"),
        (good.replace("samples = 3", "samples = 4000000000"), "columns"),
        (good.replace("lines = 2", "lines = x"), "'x'"),
        (good.replace("lines = 2\n", ""), "'lines'"),
        (good.replace("type = 2", "type = 6"), "complex"),
        (good.replace("bsq", "zip"), "'zip'"),
        (good.replace("bands = 1", "bands = 18446744073709551615\nfile compression = 1"), "compressed"),
        (good.to_string() + "header offset = 18446744073709551615\n", "need"),
        (good.to_string() + "byte order = 7\n", "byte order"),
        (esri.replace("NCOLS 3", "NCOLS 0"), "0 x 2"),
        (esri.replace("NBITS 16", "NBITS 12"), "12 bits"),
        (esri.replace("LAYOUT BIL", "LAYOUT BIZ"), "BIZ"),
        (esri.to_string() + "NBANDS 18446744073709551615\n", "need"),
        (esri.to_string() + "TOTALROWBYTES 1\n", "TOTALROWBYTES"),
        (esri.to_string() + "SKIPBYTES 18446744073709551615\n", "need"),
    ];
    for (header, word) in cases {
        let line =
            raw("a.bil", &[0; 12], &header).err().unwrap_or_else(|| panic!("read: {header}")).to_string();
        assert!(line.contains(word) && !line.contains('\n'), "no '{word}' in: {line}");
    }
    assert!(raw("a.bil", &[0; 12], good).is_ok() && raw("a.bil", &[0; 12], esri).is_ok());
}

#[test]
fn an_envi_grid_turned_and_placed_as_gdal_does() {
    // As GDAL 3.10.3 writes a grid of 30 m turned by 20 degrees.
    let head = |info: &str| {
        format!("ENVI\nsamples = 1\nlines = 1\nbands = 1\ndata type = 1\nmap info = {{{info}}}\n")
    };
    let place = |info: &str| raw("a.dat", &[7], &head(info)).unwrap().info().clone();
    let turned = place("UTM, 1, 1, 500000, 4000000, 30, 30, 45, North,WGS-84, rotation=20");
    let (sin, cos) = 20f64.to_radians().sin_cos();
    let a = turned.affine.unwrap();
    assert_eq!((a.col_step, a.row_step), ([30.0 * cos, 30.0 * sin], [30.0 * sin, -30.0 * cos]));
    assert_eq!(a.origin, [500019.22569146164, 3999991.034912838]);
    assert_eq!(turned.crs.unwrap().code, "EPSG:32645");
    let inner = place("Geographic Lat/Lon, 1.5, 2.5, 8, 50, 0.5, 0.25, WGS-84, units=Degrees");
    assert_eq!(inner.affine.unwrap().origin, [8.0, 50.25]);
    assert_eq!(inner.crs.unwrap().code, "EPSG:4326");
    let lost = place("Arbitrary, 1, 1, 0, 0, 1, 1");
    assert!(lost.affine.is_none() && lost.crs.is_none());
}

#[test]
fn files_on_disk_find_what_lies_beside_them() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let put = |name: &str, bytes: &[u8]| std::fs::write(at(name), bytes).unwrap();
    let complaint =
        |name: &str| open(&at(name)).err().unwrap_or_else(|| panic!("{name} was opened")).to_string();
    put("Grid.flt", &1.0f32.to_le_bytes());
    let missing = complaint("Grid.flt");
    assert!(missing.contains("Grid.hdr") && missing.contains("not found"), "{missing}");
    put("GRID.HDR", b"NCOLS 1\nNROWS 1\nXLLCORNER 0\nYLLCORNER 0\nCELLSIZE 1\nBYTEORDER LSBFIRST\n");
    assert_eq!(values(open(&at("Grid.flt")).unwrap().as_mut()), [1.0]);
    // The header, named in place of the grid: understood while that is clear.
    let source = open(&at("GRID.HDR")).unwrap();
    assert!(source.info().file.ends_with("Grid.flt"), "{}", source.info().file);
    put("grid.bil", &[1]);
    let two = complaint("GRID.HDR");
    assert!(two.contains("Grid.flt") && two.contains("grid.bil"), "{two}");
    put("lonely.hdr", b"ENVI\nsamples = 1\n");
    assert!(complaint("lonely.hdr").contains("lonely.flt"));
    put("grid.prj", b"PROJCS[]");
    assert!(complaint("grid.prj").contains("name the grid"));
}

/// A greyscale PNG of 16 bits.
fn png(cols: u32, rows: u32, grey: impl Fn(u32) -> u16) -> Vec<u8> {
    let mut out = Vec::new();
    let mut encoder = png::Encoder::new(&mut out, cols, rows);
    encoder.set_color(png::ColorType::Grayscale);
    encoder.set_depth(png::BitDepth::Sixteen);
    let data: Vec<u8> = (0..cols * rows).flat_map(|k| grey(k).to_be_bytes()).collect();
    encoder.write_header().unwrap().write_image_data(&data).unwrap();
    out
}

#[test]
fn a_world_file_places_a_picture() {
    let bytes = png(20, 30, |k| (k * 97) as u16);
    let world = |text: &str| vec![("a.pgw".to_string(), text.as_bytes().to_vec())];
    let mut source = open_bytes_beside("a.png", bytes.clone(), world("2\n0\n0\n-2\n101\n199\n")).unwrap();
    let a = source.info().affine.unwrap();
    assert_eq!((a.origin, a.row_step), ([101.0, 199.0], [0.0, -2.0]));
    assert_eq!(values(source.as_mut())[599], f64::from(599 * 97));
    let error = open_bytes_beside("a.png", bytes.clone(), world("2\n0\n0\n")).err().unwrap().to_string();
    assert!(error.contains("a.pgw") && error.contains("3 found"), "{error}");
    let aux =
        "<PAMDataset><SRS>EPSG:32610</SRS><GeoTransform>100, 2, 0, 200, 0, -2</GeoTransform></PAMDataset>";
    let aux = vec![("a.png.aux.xml".to_string(), aux.as_bytes().to_vec())];
    let source = open_bytes_beside("a.png", bytes.clone(), aux).unwrap();
    assert_eq!(source.info().affine.unwrap().origin, [101.0, 199.0]);
    assert_eq!(source.info().crs.as_ref().unwrap().code, "EPSG:32610");
    let mut cut = open_bytes_beside("a.png", bytes[..bytes.len() / 2].to_vec(), Vec::new()).unwrap();
    assert!(matches!(read_all(cut.as_mut()), Err(Error::Corrupt { .. })));
}
