//! GeoTIFF as it is written here: round trips, damage, and headers that lie.

use super::{Random, check_windows, damaged, endure, read_all};
use terraquilt::base::Error;
use terraquilt::format::geotiff::{GeoTiffSpec, GeoTiffWriter};
use terraquilt::format::open_bytes;
use terraquilt::height::crs::{AxisUnit, Crs};
use terraquilt::height::source::{Affine, SampleType, Window};

/// Any bits for integers; for floats now and then NaN and infinity, else heights.
fn samples(t: SampleType, count: usize, random: &mut Random) -> Vec<u8> {
    let mut data = Vec::new();
    for i in 0..count {
        let height = 1000.0 + 300.0 * (i as f64 / 37.0).sin() + random.below(100) as f64 / 64.0;
        let bits = random.next().to_le_bytes();
        match t {
            SampleType::F32 if i % 97 == 0 => data.extend(f32::NAN.to_le_bytes()),
            SampleType::F32 => data.extend((height as f32).to_le_bytes()),
            SampleType::F64 if i % 89 == 0 => data.extend(f64::INFINITY.to_le_bytes()),
            SampleType::F64 => data.extend(height.to_le_bytes()),
            _ if i % 5 == 0 => data.extend(&bits[..t.bytes()]),
            _ => data.extend(&(height as i64).to_le_bytes()[..t.bytes()]),
        }
    }
    data
}

fn spec(cols: u64, rows: u64, sample_type: SampleType) -> GeoTiffSpec {
    GeoTiffSpec {
        cols,
        rows,
        sample_type,
        affine: Some(Affine { origin: [500015.0, 4100005.0], col_step: [30.0, 0.0], row_step: [0.0, -10.0] }),
        crs: Some(Crs { code: "EPSG:32611".into(), unit: AxisUnit::Metre(1.0) }),
        nodata: None,
        scale: 1.0,
        offset: 0.0,
        vertical_datum: None,
    }
}

/// Writes in batches of `batch` rows and gives the file's bytes.
fn write(spec: &GeoTiffSpec, data: &[u8], batch: usize) -> Vec<u8> {
    let out = std::io::Cursor::new(Vec::new());
    let mut writer = GeoTiffWriter::new(out, "written".into(), spec.clone()).unwrap();
    let row_bytes = spec.cols as usize * spec.sample_type.bytes();
    for (i, rows) in data.chunks(row_bytes * batch).enumerate() {
        writer.write_rows((i * batch) as u64, rows).unwrap();
    }
    writer.finish().unwrap().into_inner()
}

#[test]
fn every_type_and_size_is_read_back_bit_for_bit() {
    let mut random = Random(11);
    for t in SampleType::ALL {
        for (cols, rows) in [(1, 1), (17, 3), (256, 256), (300, 517), (1000, 5), (3, 700)] {
            let data = samples(t, cols * rows, &mut random);
            let spec = spec(cols as u64, rows as u64, t);
            let bytes = write(&spec, &data, 64);
            assert_eq!(bytes, write(&spec, &data, 7), "the same samples give the same bytes");
            let mut source = open_bytes("written.tif", bytes).unwrap();
            assert_eq!(source.info().affine, spec.affine);
            assert_eq!(source.info().crs, spec.crs);
            assert_eq!((source.info().sample_type, source.info().nodata), (t, None));
            let all = read_all(source.as_mut()).unwrap();
            assert_eq!(all.data, data, "{} {cols} x {rows}", t.name());
            let finite = |s: &[u8]| u8::from(t.value(s).is_finite());
            assert_eq!(all.valid, data.chunks(t.bytes()).map(finite).collect::<Vec<u8>>());
            check_windows(source.as_mut(), &all, &mut random);
        }
    }
}

#[test]
fn nodata_scale_place_and_crs_are_read_back() {
    let mut spec = spec(4, 2, SampleType::I16);
    let turned = Affine { origin: [7.5, 47.25], col_step: [0.5, 0.25], row_step: [0.125, -0.5] };
    spec.affine = Some(turned);
    spec.crs = Some(Crs { code: "EPSG:4326".into(), unit: AxisUnit::Degree });
    spec.nodata = Some("-32768".into());
    (spec.scale, spec.offset) = (0.25, -100.0);
    let data: Vec<u8> = [5i16, -32768, 0, 1, 2, 3, -32768, 4].iter().flat_map(|v| v.to_le_bytes()).collect();
    let mut source = open_bytes("written.tif", write(&spec, &data, 1)).unwrap();
    let info = source.info().clone();
    assert_eq!((info.affine, info.crs, info.nodata), (spec.affine, spec.crs, Some(-32768.0)));
    assert_eq!((info.scale, info.offset), (0.25, -100.0));
    assert_eq!(read_all(source.as_mut()).unwrap().valid, [1, 0, 1, 1, 1, 1, 0, 1]);
    source.set_nodata(0.0);
    assert_eq!(read_all(source.as_mut()).unwrap().valid, [1, 1, 0, 1, 1, 1, 1, 1]);
    source.set_nodata(0.5);
    assert!(source.info().notes.iter().any(|n| n.contains("0.5")), "{:?}", source.info().notes);
}

#[test]
fn the_writer_refuses_rows_out_of_order_and_unfinished_files() {
    let spec = spec(4, 3, SampleType::U8);
    let out = || std::io::Cursor::new(Vec::new());
    let mut writer = GeoTiffWriter::new(out(), "written".into(), spec.clone()).unwrap();
    assert!(writer.write_rows(1, &[0; 4]).is_err());
    assert!(writer.write_rows(0, &[0; 5]).is_err());
    writer.write_rows(0, &[0; 8]).unwrap();
    assert!(writer.write_rows(0, &[0; 4]).is_err());
    assert!(writer.write_rows(2, &[0; 8]).is_err());
    assert!(writer.finish().is_err());
    for crs in ["EPSG:0", "EPSG:70000", "+proj=\u{e9}"] {
        let crs = Some(Crs { code: crs.into(), unit: AxisUnit::Degree });
        assert!(GeoTiffWriter::new(out(), "written".into(), GeoTiffSpec { crs, ..spec.clone() }).is_err());
    }
    assert!(GeoTiffWriter::new(out(), "written".into(), GeoTiffSpec { cols: 0, ..spec }).is_err());
}

#[test]
fn a_written_file_cut_or_flipped_never_panics() {
    let mut random = Random(5);
    for t in SampleType::ALL {
        let data = samples(t, 40 * 30, &mut random);
        let good = write(&spec(40, 30, t), &data, 30);
        for cut in 0..good.len().min(200) {
            assert!(!endure("cut.tif", good[..cut].to_vec()), "{cut} bytes were read");
        }
        assert!(!endure("cut.tif", good[..good.len() - 1].to_vec()), "the directory ends the file");
        for _ in 0..300 {
            endure("damaged.tif", damaged(&good, &mut random));
        }
        let junk = [good.clone(), b"trailing junk".to_vec()].concat();
        assert!(endure("junk.tif", junk), "what follows the file does not matter");
    }
}

#[test]
fn a_synthetic_srtm_tile_reads_by_windows() {
    let side = 1201usize;
    let height = |i: usize| if i.is_multiple_of(101) { -32768 } else { (i % 9000) as i16 };
    let bytes: Vec<u8> = (0..side * side).flat_map(|i| height(i).to_be_bytes()).collect();
    let mut source = open_bytes("S09W001.hgt", bytes).unwrap();
    assert_eq!(source.info().affine.unwrap().origin, [-1.0, -8.0]);
    let all = read_all(source.as_mut()).unwrap();
    for i in 0..side * side {
        assert_eq!(SampleType::I16.value(&all.data[i * 2..]), f64::from(height(i)));
        assert_eq!(all.valid[i] == 1, height(i) != -32768);
    }
    check_windows(source.as_mut(), &all, &mut Random(9));
}

/// Where a written (classic, little-endian) file keeps the value of a tag, and how many bytes it has there.
fn value_of(bytes: &[u8], tag: u16) -> usize {
    let u16_at = |at: usize| u16::from_le_bytes([bytes[at], bytes[at + 1]]);
    let u32_at = |at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap());
    let directory = u32_at(4) as usize;
    let entries = (0..usize::from(u16_at(directory))).map(|i| directory + 2 + 12 * i);
    let entry = entries.into_iter().find(|at| u16_at(*at) == tag).unwrap();
    let width = if u16_at(entry + 2) == 3 { 2 } else { 4 };
    let inline = u32_at(entry + 4) * width <= 4;
    if inline { entry + 8 } else { u32_at(entry + 8) as usize }
}

#[test]
fn headers_that_lie_are_refused_before_anything_is_allocated() {
    let good = write(&spec(300, 40, SampleType::I16), &vec![1; 300 * 40 * 2], 40);
    // Tag, value, word of the error.
    let lies: [(u16, u32, &str); 11] = [
        (256, 4_000_000_000, "columns"),
        (257, 0, "grid size"),
        (257, 1_999_999, "tiles"),
        (258, 24, "24 bits"),
        (259, 7, "JPEG"),
        (317, 3, "predictor"),
        (322, 0, "tile size"),
        (322, 2_000_000_000, "bytes of one tile"),
        (323, 200_000, "tile size"),
        (324, 4_000_000_000, "tile 0"),
        (325, 4_000_000_000, "tile 0"),
    ];
    for (tag, value, word) in lies {
        let mut bytes = good.clone();
        let at = value_of(&bytes, tag);
        bytes[at..at + 4].copy_from_slice(&value.to_le_bytes());
        let error =
            open_bytes("lie.tif", bytes).err().unwrap_or_else(|| panic!("tag {tag} = {value} was believed"));
        assert!(error.to_string().contains(word), "tag {tag} = {value}: {error}");
    }
}

#[test]
fn tiles_that_are_not_stored_are_nodata_or_else_zero() {
    for nodata in [Some("-5"), None, Some("0.5")] {
        let nodata = nodata.map(String::from);
        let spec = GeoTiffSpec { nodata: nodata.clone(), ..spec(300, 40, SampleType::I16) };
        let data: Vec<u8> = (0..300 * 40).flat_map(|_| 77i16.to_le_bytes()).collect();
        let mut bytes = write(&spec, &data, 40);
        let second = value_of(&bytes, 324) + 4;
        bytes[second..second + 4].fill(0);
        let mut source = open_bytes("sparse.tif", bytes).unwrap();
        let all = read_all(source.as_mut()).unwrap();
        let fill = if nodata.as_deref() == Some("-5") { (-5.0, 0) } else { (0.0, 1) };
        for i in 0..300 * 40 {
            let found = (SampleType::I16.value(&all.data[i * 2..]), all.valid[i]);
            assert_eq!(found, if i % 300 < 256 { (77.0, 1) } else { fill }, "post {i}, nodata {nodata:?}");
        }
        check_windows(source.as_mut(), &all, &mut Random(1));
    }
}

#[test]
fn a_block_that_does_not_decode_is_named() {
    let data = samples(SampleType::I16, 300 * 300, &mut Random(2));
    let mut bytes = write(&spec(300, 300, SampleType::I16), &data, 300);
    let table = value_of(&bytes, 324) + 3 * 4;
    let at = u32::from_le_bytes(bytes[table..table + 4].try_into().unwrap()) as usize;
    bytes[at + 20..at + 40].fill(0xff);
    let mut source = open_bytes("damaged.tif", bytes).unwrap();
    assert!(source.read(Window { col: 0, row: 0, cols: 300, rows: 256 }).is_ok(), "the others are sound");
    let error = source.read(Window { col: 0, row: 0, cols: 300, rows: 300 }).unwrap_err();
    let text = error.to_string();
    assert!(matches!(error, Error::Corrupt { .. }) && text.contains("damaged.tif"), "{text}");
    assert!(text.contains("tile 3 (columns 256 to 299, rows 256 to 299)"), "{text}");
}
