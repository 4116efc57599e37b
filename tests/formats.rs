//! Reading other people's files and writing GeoTIFF: every difficult file, damage of all kinds, round trips.

use std::path::{Path, PathBuf};
use terraquilt::base::Error;
use terraquilt::format::geotiff::{GeoTiffSpec, GeoTiffWriter};
use terraquilt::format::{open, open_bytes};
use terraquilt::height::crs::{AxisUnit, Crs};
use terraquilt::height::source::{Affine, HeightSource, SampleType, Samples, Window};

/// Well-formed files: name, type, columns, rows, FNV-1a of samples and validity bytes, valid posts; as GDAL 3.10.3
/// reads them (rasterio 1.4.4: `read(1)`, then `read_masks(1)` and finite).
#[rustfmt::skip]
const GOOD: &[(&str, &str, u64, u64, u64, usize)] = &[
    ("cog_overviews.tif", "int16", 181, 157, 0x821b91acef6a69da, 28095),
    ("crs_feet_state_plane.tif", "int16", 181, 157, 0x02be3d1b4c0a4a73, 28095),
    ("float32_bigendian_lzw_p3.tif", "float32", 181, 157, 0xa4812908b41c08a6, 28095),
    ("float32_deflate_p3_tiled.tif", "float32", 181, 157, 0xa4812908b41c08a6, 28095),
    ("float32_inf_and_nan_no_tag.tif", "float32", 181, 157, 0xb2ee09bf5d988d70, 28094),
    ("float32_lerc_0p01.tif", "float32", 181, 157, 0x1a6659df0cfbec18, 28095),
    ("float32_lerc_zstd_lossless.tif", "float32", 181, 157, 0xa4812908b41c08a6, 28095),
    ("float32_nodata_minfloat.tif", "float32", 181, 157, 0xd85b2c232327be12, 28095),
    ("float32_predictor2.tif", "float32", 181, 157, 0xa4812908b41c08a6, 28095),
    ("float64_nodata_nan.tif", "float64", 181, 157, 0x5aeb3856a25fb806, 28095),
    ("float64_zstd_p3.tif", "float64", 181, 157, 0x505546f8ab97197a, 28095),
    ("int16_bigendian_stripped_lzw_p2.tif", "int16", 181, 157, 0x821b91acef6a69da, 28095),
    ("int16_bigtiff_bigendian.tif", "int16", 181, 157, 0x821b91acef6a69da, 28095),
    ("int16_bigtiff_tiled_deflate_p2.tif", "int16", 181, 157, 0x821b91acef6a69da, 28095),
    ("int16_one_row_strips.tif", "int16", 181, 157, 0x821b91acef6a69da, 28095),
    ("int16_packbits.tif", "int16", 181, 157, 0x821b91acef6a69da, 28095),
    ("int16_scale_quarter_metre.tif", "int16", 181, 157, 0x6b29350b9c37d0c6, 28095),
    ("int16_zstd_p2_tiled.tif", "int16", 181, 157, 0x821b91acef6a69da, 28095),
    ("int32_deflate_p2.tif", "int32", 181, 157, 0x68d69ec00d287fe6, 28095),
    ("internal_mask.tif", "int16", 181, 157, 0xd7e677830d39741b, 25310),
    ("no_georeference.tif", "int16", 181, 157, 0x821b91acef6a69da, 28095),
    ("pixel_is_point.tif", "int16", 181, 157, 0x821b91acef6a69da, 28095),
    ("real_BigTIFF.tif", "uint8", 64, 64, 0xc21d92d357e7a981, 4096),
    ("real_BigTIFFMotorola.tif", "uint8", 64, 64, 0xc21d92d357e7a981, 4096),
    ("real_esri_wkt.tif", "uint16", 2, 2, 0x67c58163b4db6e15, 4),
    ("real_geomatrix_rotated.tif", "uint8", 20, 20, 0x277fa709130d8775, 400),
    ("real_int16_zstd.tif", "int16", 64, 64, 0x2395135cc409fbc6, 4096),
    ("real_issue_69_lzw.tif", "uint16", 45, 45, 0x710df438c5c41cd3, 2025),
    ("real_laea_float_nodata.tif", "float32", 13, 12, 0xc0ac36ed54ddb4db, 98),
    ("real_predictor3_gray_f32.tif", "float32", 200, 200, 0x40c8e0591decad31, 40000),
    ("real_rotated_nocrs.tif", "uint8", 10, 15, 0x3e02be37f7f525a0, 150),
    ("real_slovenia_dtm1m_nan_nodata.tif", "float32", 1000, 1000, 0x7f995c188216325d, 999500),
    ("reference_int16.tif", "int16", 181, 157, 0x821b91acef6a69da, 28095),
    ("rotated_30deg.tif", "int16", 181, 157, 0x821b91acef6a69da, 28095),
    ("sheared.tif", "int16", 181, 157, 0x821b91acef6a69da, 28095),
    ("south_up.tif", "int16", 181, 157, 0x954d0df39b5af40e, 28095),
    ("sparse_tiles.tif", "int16", 600, 600, 0xa8aa2fe5ef5744ef, 6876),
    ("two_bands_pixel_interleaved.tif", "int16", 181, 157, 0x821b91acef6a69da, 28095),
    ("two_bands_planar.tif", "int16", 181, 157, 0x821b91acef6a69da, 28095),
    ("uint16_offset.tif", "uint16", 181, 157, 0xd5c38c2a309f04bf, 28095),
    ("uint32.tif", "uint32", 181, 157, 0x96ee48b39ed4db9f, 28095),
    ("uint8_scaled.tif", "uint8", 181, 157, 0x65030f577bb78ca9, 28417),
];

/// Files that are refused, and how.
const REFUSED: &[(&str, Refusal)] = &[
    ("corrupt_zstd_block.tif", Refusal::Corrupt),
    ("empty.tif", Refusal::Corrupt),
    ("float16.tif", Refusal::Unsupported),
    ("huge_dimensions.tif", Refusal::Limit),
    ("ifd_loop.tif", Refusal::Corrupt),
    ("int16_lzma.tif", Refusal::Unsupported),
    ("real_bessel_towgs84.tif", Refusal::Unsupported),
    ("real_corrupt_jpeg.tif", Refusal::Unsupported),
    ("real_fuzz_graydepth.tif", Refusal::Corrupt),
    ("real_gray_12bit.tif", Refusal::Unsupported),
    ("real_utm_nonsquare.tif", Refusal::Unsupported),
    ("real_white_fp16.tif", Refusal::Unsupported),
    ("strip_offset_past_end.tif", Refusal::Corrupt),
    ("truncated_half.tif", Refusal::Corrupt),
    ("truncated_header.tif", Refusal::Corrupt),
    ("grid.asc", Refusal::Unsupported),
    ("height_16bit.png", Refusal::Unsupported),
    ("everest.dt0", Refusal::Unsupported),
    ("everest_usgs.dem", Refusal::Unsupported),
    ("ehdr.flt", Refusal::Unsupported),
    ("real_N10W110_ocean.hgt.zip", Refusal::Unsupported),
];

#[derive(Clone, Copy, Debug, PartialEq)]
enum Refusal {
    Corrupt,
    Unsupported,
    Limit,
}

/// The shared data's folder; None, said aloud, where it is absent.
fn shared(path: &str) -> Option<PathBuf> {
    let full = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data").join(path);
    if full.exists() {
        return Some(full);
    }
    let required = std::env::var_os("TERRAQUILT_REQUIRE_SHARED").is_some();
    assert!(!required, "{} is wanted (TERRAQUILT_REQUIRE_SHARED is set)", full.display());
    println!("shared data absent: skipped");
    None
}

fn fnv(parts: [&[u8]; 2]) -> u64 {
    let bytes = parts.into_iter().flatten();
    bytes.fold(0xcbf2_9ce4_8422_2325, |h, b| (h ^ u64::from(*b)).wrapping_mul(0x100_0000_01b3))
}

/// Everything, in the source's own batches of rows.
fn read_all(source: &mut dyn HeightSource) -> Result<Samples, Error> {
    let (cols, rows) = (source.info().cols as usize, source.info().rows);
    let mut all = Samples { cols, rows: rows as usize, ..Samples::default() };
    let mut row = 0;
    while row < rows {
        let batch = (rows - row).min(source.row_batch() as u64) as usize;
        let part = source.read(Window { col: 0, row, cols, rows: batch })?;
        assert_eq!(part.data.len(), cols * batch * source.info().sample_type.bytes());
        assert_eq!(part.valid.len(), cols * batch);
        all.data.extend(part.data);
        all.valid.extend(part.valid);
        row += batch as u64;
    }
    Ok(all)
}

/// Windows of all sizes hold what the whole holds.
fn check_windows(source: &mut dyn HeightSource, all: &Samples, random: &mut Random) {
    let width = source.info().sample_type.bytes();
    for _ in 0..20 {
        let (col, row) = (random.below(all.cols), random.below(all.rows));
        let (cols, rows) = (1 + random.below(all.cols - col), 1 + random.below(all.rows - row));
        let part = source.read(Window { col: col as u64, row: row as u64, cols, rows }).unwrap();
        for r in 0..rows {
            let at = (row + r) * all.cols + col;
            assert_eq!(part.valid[r * cols..][..cols], all.valid[at..][..cols]);
            assert_eq!(part.data[r * cols * width..][..cols * width], all.data[at * width..][..cols * width]);
        }
    }
    let (cols, rows) = (all.cols as u64, all.rows as u64);
    for (col, row) in [(cols, 0), (0, rows), (u64::MAX, 0), (0, u64::MAX)] {
        assert!(source.read(Window { col, row, cols: 1, rows: 1 }).is_err());
    }
    assert!(source.read(Window { col: 0, row: 0, cols: usize::MAX, rows: 1 }).is_err());
    assert!(source.read(Window { col: cols, row: 0, cols: 0, rows: 1 }).unwrap().data.is_empty());
}

/// xorshift64*; the seed is printed by the test that fails.
struct Random(u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 ^= self.0 >> 12;
        self.0 ^= self.0 << 25;
        self.0 ^= self.0 >> 27;
        self.0.wrapping_mul(0x2545_f491_4f6c_dd1d)
    }
    fn below(&mut self, n: usize) -> usize {
        (self.next() >> 16) as usize % n
    }
}

#[test]
fn well_formed_files_read_as_gdal_reads_them() {
    let mut random = Random(7);
    for (name, sample_type, cols, rows, hash, valid) in GOOD {
        let Some(path) = shared(&format!("difficult/{name}")) else { return };
        let mut source = open(&path).unwrap_or_else(|e| panic!("{e}"));
        let info = source.info();
        assert_eq!((info.sample_type.name(), info.cols, info.rows), (*sample_type, *cols, *rows), "{name}");
        let all = read_all(source.as_mut()).unwrap_or_else(|e| panic!("{e}"));
        assert_eq!(all.valid.iter().filter(|v| **v == 1).count(), *valid, "{name}");
        assert_eq!(fnv([&all.data, &all.valid]), *hash, "{name}");
        check_windows(source.as_mut(), &all, &mut random);
    }
}

#[test]
fn malformed_and_foreign_files_are_refused_in_one_line() {
    for (name, how) in REFUSED {
        let Some(path) = shared(&format!("difficult/{name}")) else { return };
        let result = open(&path).and_then(|mut source| read_all(source.as_mut()));
        let Err(error) = result else { panic!("{name} was read") };
        let found = match &error {
            Error::Corrupt { .. } => Refusal::Corrupt,
            Error::Unsupported { .. } => Refusal::Unsupported,
            Error::Limit { .. } => Refusal::Limit,
            other => panic!("{name}: {other}"),
        };
        assert_eq!(found, *how, "{error}");
        let line = error.to_string();
        assert!(line.contains(name) && !line.contains('\n'), "{line}");
    }
}

#[test]
fn every_difficult_tif_has_an_expectation() {
    let Some(folder) = shared("difficult") else { return };
    for entry in std::fs::read_dir(folder).unwrap() {
        let name = entry.unwrap().file_name().into_string().unwrap();
        let known = GOOD.iter().any(|g| g.0 == name) || REFUSED.iter().any(|r| r.0 == name);
        assert!(known || !name.ends_with(".tif"), "{name} is in neither list");
    }
}

#[test]
fn encodings_of_one_crop_agree_on_heights_and_place() {
    let Some(path) = shared("difficult/reference_int16.tif") else { return };
    let mut reference = open(&path).unwrap();
    let all = read_all(reference.as_mut()).unwrap();
    let step = 1.0 / 1200.0;
    for name in ["int16_scale_quarter_metre", "uint16_offset", "float32_lerc_0p01", "float64_zstd_p3"] {
        let mut source = open(&shared(&format!("difficult/{name}.tif")).unwrap()).unwrap();
        let found = read_all(source.as_mut()).unwrap();
        let info = source.info().clone();
        assert_eq!(found.valid, all.valid, "{name}");
        assert_eq!(info.affine, reference.info().affine, "{name}");
        let slack = if name.contains("0p01") { 0.0101 } else { 1e-3 };
        for i in (0..all.valid.len()).filter(|i| all.valid[*i] == 1) {
            let column = (i % all.cols) as f64;
            let wave = if info.sample_type.is_float() { 0.25 * column.sin() } else { 0.0 };
            let expected = SampleType::I16.value(&all.data[i * 2..]) + wave;
            let sample = info.sample_type.value(&found.data[i * info.sample_type.bytes()..]);
            let height = sample * info.scale + info.offset;
            assert!((height - expected).abs() <= slack, "{name} post {i}: {height}, expected {expected}");
        }
    }
    // Corner 86.61625, 27.367083..; a post is the centre of its pixel, also where the file says PixelIsPoint.
    for name in ["reference_int16", "pixel_is_point", "cog_overviews", "int16_bigtiff_bigendian"] {
        let source = open(&shared(&format!("difficult/{name}.tif")).unwrap()).unwrap();
        let a = source.info().affine.unwrap();
        let expected = [86.61625 + step / 2.0, 27.367083333333333 - step / 2.0];
        let close = a.origin.iter().zip(expected).all(|(found, expected)| (found - expected).abs() < 1e-12);
        assert!(close, "{name}: {:?}", a.origin);
        assert_eq!((a.col_step[1], a.row_step[0]), (0.0, 0.0));
        assert!((a.col_step[0] - step).abs() < 1e-15 && (a.row_step[1] + step).abs() < 1e-15, "{name}");
        assert_eq!(
            source.info().crs,
            Some(Crs { code: "EPSG:4326".into(), unit: AxisUnit::Degree }),
            "{name}"
        );
    }
}

#[test]
fn rotated_sheared_and_south_up_grids_keep_their_place() {
    // Name, corner of the first pixel, step of a column, step of a row.
    let cases = [
        ("rotated_30deg", [480000.0, 3090000.0], [77.94228634059948, 45.0], [45.0, -77.94228634059948]),
        ("sheared", [480000.0, 3090000.0], [90.0, 0.0], [15.0, -90.0]),
        ("south_up", [86.61625, 27.236250000000002], [1.0 / 1200.0, 0.0], [0.0, 1.0 / 1200.0]),
        ("real_geomatrix_rotated", [1841001.75, 1144003.25], [1.5, -5.0], [-5.0, -1.5]),
    ];
    for (name, corner, col_step, row_step) in cases {
        let Some(path) = shared(&format!("difficult/{name}.tif")) else { return };
        let a = open(&path).unwrap().info().affine.unwrap();
        for k in 0..2 {
            let origin = corner[k] + 0.5 * (col_step[k] + row_step[k]);
            assert!((a.origin[k] - origin).abs() < 1e-9, "{name}: {a:?}");
            assert!((a.col_step[k] - col_step[k]).abs() < 1e-12, "{name}: {a:?}");
            assert!((a.row_step[k] - row_step[k]).abs() < 1e-12, "{name}: {a:?}");
        }
    }
}

#[test]
fn what_a_user_should_know_is_noted() {
    let Some(_) = shared("difficult") else { return };
    let notes = |name: &str| {
        let source = open(&shared(&format!("difficult/{name}.tif")).unwrap()).unwrap();
        let crs = source.info().crs.as_ref().map(|c| c.code.clone()).unwrap_or_default();
        (crs, source.info().notes.join("; "))
    };
    assert!(notes("two_bands_planar").1.contains("2 bands"));
    assert!(notes("real_BigTIFF").1.contains("RGB"));
    let (crs, text) = notes("real_esri_wkt");
    assert!(crs == "EPSG:5070" && text.contains("'cm'") == text.contains("heights in"), "{crs}: {text}");
    assert!(open(&shared("difficult/no_georeference.tif").unwrap()).unwrap().info().affine.is_none());
    let feet = open(&shared("difficult/crs_feet_state_plane.tif").unwrap()).unwrap();
    let crs = feet.info().crs.clone().unwrap();
    assert_eq!(crs.code, "EPSG:2229");
    assert!(matches!(crs.unit, AxisUnit::Metre(m) if (m - 1200.0 / 3937.0).abs() < 1e-12), "{crs:?}");
}

#[test]
fn an_srtm_tile_lies_on_its_degree_lines() {
    let Some(path) = shared("codec/N44W072.hgt") else { return };
    let mut source = open(&path).unwrap();
    let info = source.info().clone();
    assert_eq!((info.format, info.cols, info.rows, info.accuracy_m), ("HGT", 1201, 1201, Some(16.0)));
    assert_eq!(info.affine.unwrap().origin, [-72.0, 45.0]);
    let all = read_all(source.as_mut()).unwrap();
    check_windows(source.as_mut(), &all, &mut Random(3));
    let bytes = std::fs::read(&path).unwrap();
    let first = i16::from_be_bytes([bytes[0], bytes[1]]);
    assert_eq!(SampleType::I16.value(&all.data), f64::from(first));
    let cut = open_bytes("N44W072.hgt", bytes[..bytes.len() - 1].to_vec()).err().unwrap();
    assert!(matches!(cut, Error::Corrupt { .. }), "{cut}");
}

/// Opens and reads what may be anything; only a panic, a hang or a huge allocation is wrong.
fn endure(name: &str, bytes: Vec<u8>) -> bool {
    let Ok(mut source) = open_bytes(name, bytes) else { return false };
    // A header may honestly claim a large sparse grid: look at its start and its end only.
    let info = source.info().clone();
    let cols = info.cols.min(2048) as usize;
    let rows = info.rows.min(512) as usize;
    let start = source.read(Window { col: 0, row: 0, cols, rows });
    let (col, row) = (info.cols - cols as u64, info.rows - rows as u64);
    let end = source.read(Window { col, row, cols, rows });
    start.is_ok() && end.is_ok()
}

#[test]
fn cut_and_flipped_files_never_panic() {
    let seed = 20260101;
    println!("seed {seed}");
    let mut random = Random(seed);
    let (mut read, mut refused) = (0, 0);
    let names = GOOD.iter().map(|g| g.0).chain(REFUSED.iter().map(|r| r.0));
    for name in names.filter(|n| n.ends_with(".tif") && *n != "real_slovenia_dtm1m_nan_nodata.tif") {
        let Some(path) = shared(&format!("difficult/{name}")) else { return };
        let good = std::fs::read(path).unwrap();
        if good.is_empty() {
            continue;
        }
        for round in 0..100 {
            let bytes = if round % 2 == 0 {
                good[..random.below(good.len())].to_vec()
            } else {
                damaged(&good, &mut random)
            };
            if endure(name, bytes) { read += 1 } else { refused += 1 }
        }
    }
    println!("{read} read, {refused} refused");
}

/// A few bytes changed, most of them where headers and directories lie.
fn damaged(good: &[u8], random: &mut Random) -> Vec<u8> {
    let mut bytes = good.to_vec();
    for _ in 0..1 + random.below(4) {
        let n = bytes.len();
        let at = match random.below(3) {
            0 => random.below(n),
            1 => random.below(n.min(400)),
            _ => n - 1 - random.below(n.min(600)),
        };
        bytes[at] = match random.below(3) {
            0 => bytes[at] ^ (1 << random.below(8)),
            1 => [0, 1, 0x7f, 0xff][random.below(4)],
            _ => random.next() as u8,
        };
    }
    bytes
}

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
    for crs in ["ESRI:102003", "EPSG:0", "EPSG:70000"] {
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
    let lies: [(u16, u32, &str); 12] = [
        (256, 4_000_000_000, "columns"),
        (257, 0, "image size"),
        (257, 1_999_999, "tiles"),
        (258, 12, "12 bits"),
        (259, 7, "JPEG"),
        (262, 3, "palette"),
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
