//! Where posts lie, that all encodings of one crop have its heights, and what a user is told.

use super::{Random, check_windows, read_all, shared};
use terraquilt::base::Error;
use terraquilt::format::{open, open_bytes};
use terraquilt::height::crs::AxisUnit;
use terraquilt::height::source::SampleType;

/// How a file writes the crop of `reference_int16.tif`.
struct Written {
    /// Files, without the extension where it is `.tif`.
    names: &'static [&'static str],
    /// Heights carry 0.25 sin(column).
    wave: bool,
    /// What the file does not say: its zero, in steps of its samples.
    shift: f64,
    nodata: Option<f64>,
    slack: f64,
}

const PLAIN: Written = Written { names: &[], wave: false, shift: 0.0, nodata: None, slack: 0.0 };

/// Every file that is this crop, or its first 50 columns and 40 rows.
const CROPS: &[Written] = &[
    Written {
        names: &[
            "cog_overviews",
            "int16_bigendian_stripped_lzw_p2",
            "int16_bigtiff_bigendian",
            "int16_bigtiff_tiled_deflate_p2",
            "int16_lzma",
            "int16_one_row_strips",
            "int16_packbits",
            "int16_scale_quarter_metre",
            "int16_zstd_p2_tiled",
            "int32_deflate_p2",
            "no_georeference",
            "pixel_is_point",
            "rotated_30deg",
            "sheared",
            "two_bands_pixel_interleaved",
            "two_bands_planar",
            "uint16_offset",
            "grid.asc",
            "center_crlf_upper.asc",
            "dx_dy.asc",
            "decimal_comma.asc",
            "wrapped_sci.asc",
            "envi.bil",
        ],
        ..PLAIN
    },
    Written { names: &["uint32"], shift: -500.0, ..PLAIN },
    Written { names: &["no_nodata_tabs.asc"], nodata: Some(-32768.0), ..PLAIN },
    Written { names: &["height_16bit.png"], shift: -1000.0, nodata: Some(0.0), ..PLAIN },
    // Its samples are half floats: steps of 1 to 2 m above 1024 m, cut off by who wrote them.
    Written { names: &["float16"], wave: true, slack: 2.0, ..PLAIN },
    Written { names: &["float32_lerc_0p01"], wave: true, slack: 0.0101, ..PLAIN },
    Written {
        names: &[
            "float32_bigendian_lzw_p3",
            "float32_deflate_p3_tiled",
            "float32_lerc_zstd_lossless",
            "float32_nodata_minfloat",
            "float32_predictor2",
            "float64_nodata_nan",
            "float64_zstd_p3",
            "ehdr.flt",
        ],
        wave: true,
        slack: 1e-3,
        ..PLAIN
    },
];

#[test]
fn encodings_of_one_crop_agree_on_heights_and_place() {
    let Some(path) = shared("difficult/reference_int16.tif") else { return };
    let mut reference = open(&path).unwrap();
    let all = read_all(reference.as_mut()).unwrap();
    for w in CROPS {
        for name in w.names {
            let file = if name.contains('.') { name.to_string() } else { format!("{name}.tif") };
            let mut source = open(&shared(&format!("difficult/{file}")).unwrap()).unwrap();
            w.nodata.into_iter().for_each(|v| source.set_nodata(v));
            let found = read_all(source.as_mut()).unwrap();
            let info = source.info().clone();
            let cols = found.cols;
            for (k, sample) in found.data.chunks_exact(info.sample_type.bytes()).enumerate() {
                let (col, row) = (k % cols, k / cols);
                let at = row * all.cols + col;
                assert_eq!(found.valid[k], all.valid[at], "{name}: column {col}, row {row}");
                if found.valid[k] == 0 {
                    continue;
                }
                let wave = if w.wave { 0.25 * (col as f64).sin() } else { 0.0 };
                let expected = SampleType::I16.value(&all.data[at * 2..]) + wave;
                let height = info.sample_type.value(sample) * info.scale + info.offset + w.shift;
                assert!(
                    (height - expected).abs() <= w.slack,
                    "{name} ({col}, {row}): {height}, expected {expected}"
                );
            }
            // Ten digits of a cell's size in the texts are 1e-10 of a degree after 181 cells.
            let elsewhere = ["no_georeference", "rotated_30deg", "sheared", "height_16bit.png", "dx_dy.asc"];
            if elsewhere.contains(name) {
                continue;
            }
            let (a, b) = (info.affine.unwrap(), reference.info().affine.unwrap());
            for k in 0..2 {
                assert!((a.origin[k] - b.origin[k]).abs() < 1e-9, "{name}: {a:?}, expected {b:?}");
                assert!((a.col_step[k] - b.col_step[k]).abs() < 1e-12, "{name}: {a:?}, expected {b:?}");
                assert!((a.row_step[k] - b.row_step[k]).abs() < 1e-12, "{name}: {a:?}, expected {b:?}");
            }
        }
    }
}

#[test]
fn dted_and_usgs_dem_are_the_tile_they_were_made_of() {
    let Some(path) = shared("dem/everest_srtm3.tif") else { return };
    let mut tile = open(&path).unwrap();
    let all = read_all(tile.as_mut()).unwrap();
    let place = tile.info().affine.unwrap();
    for (name, each) in [("everest.dt0", 10), ("everest.dt1.zip", 1), ("everest_usgs.dem", 10)] {
        let mut source = open(&shared(&format!("difficult/{name}")).unwrap()).unwrap();
        let found = read_all(source.as_mut()).unwrap();
        for k in 0..found.valid.len() {
            let at = k / found.cols * each * all.cols + k % found.cols * each;
            assert_eq!(found.valid[k], all.valid[at], "{name} post {k}");
            if found.valid[k] == 1 {
                assert_eq!(found.data[k * 2..k * 2 + 2], all.data[at * 2..at * 2 + 2], "{name} post {k}");
            }
        }
        let a = source.info().affine.unwrap();
        for k in 0..2 {
            assert!((a.origin[k] - place.origin[k]).abs() < 1e-9, "{name}: {a:?}, expected {place:?}");
            let steps = (
                a.col_step[k] - place.col_step[k] * each as f64,
                a.row_step[k] - place.row_step[k] * each as f64,
            );
            assert!(steps.0.abs() < 1e-12 && steps.1.abs() < 1e-12, "{name}: {a:?}, expected {place:?}");
        }
        assert_eq!(source.info().crs.as_ref().unwrap().code, "EPSG:4326", "{name}");
    }
}

#[test]
fn stated_accuracies_are_handed_on_and_others_are_not_made_up() {
    // Record C: 3 m of the datum, 3 m of the heights on it, root mean squares.
    let Some(path) = shared("overlap/st_helens/usgs_quad_30m_nad27.dem") else { return };
    let source = open(&path).unwrap();
    let expected = 1.6449 * 18f64.sqrt();
    assert!((source.info().accuracy_m.unwrap() - expected).abs() < 1e-12, "{:?}", source.info().accuracy_m);
    assert_eq!(source.info().crs.as_ref().unwrap().code, "EPSG:26710");
    assert!(source.info().notes.iter().any(|n| n.contains("NAD27")), "{:?}", source.info().notes);
    for name in ["everest.dt0", "everest_usgs.dem", "grid.asc", "ehdr.flt", "reference_int16.tif"] {
        let source = open(&shared(&format!("difficult/{name}")).unwrap()).unwrap();
        assert_eq!(source.info().accuracy_m, None, "{name}");
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
        let name = if name.contains('.') { name.to_string() } else { format!("{name}.tif") };
        let source = open(&shared(&format!("difficult/{name}")).unwrap()).unwrap();
        let crs = source.info().crs.as_ref().map(|c| c.code.clone()).unwrap_or_default();
        (crs, source.info().notes.join("; "))
    };
    assert!(notes("two_bands_planar").1.contains("2 bands"));
    assert!(notes("real_BigTIFF").1.contains("RGB"));
    assert!(notes("real_utm_nonsquare").1.contains("palette"));
    assert!(notes("decimal_comma.asc").1.contains("commas"));
    assert!(notes("height_16bit.png").1.contains("grey"));
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
