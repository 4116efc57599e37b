//! Every file of the difficult data, and some more: read as GDAL reads it, or refused in one line.

use super::{Random, check_windows, fnv, read_all, shared};
use terraquilt::base::Error;
use terraquilt::format::open;

/// Well-formed files: name, type, columns, rows, FNV-1a of samples and validity bytes, valid posts; as GDAL 3.10.3
/// reads them (rasterio 1.4.4: `read(1)`, then `read_masks(1)` and finite). Two differ: GDAL holds ASCII grids as
/// float32, here they are what the text says; and it does not see the voids of `ehdr.flt`, whose header rounds them.
#[rustfmt::skip]
pub const GOOD: &[(&str, &str, u64, u64, u64, usize)] = &[
    ("center_crlf_upper.asc", "int32", 50, 40, 0x95932fc19dd3d470, 1943),
    ("cog_overviews.tif", "int16", 181, 157, 0x821b91acef6a69da, 28095),
    ("crs_feet_state_plane.tif", "int16", 181, 157, 0x02be3d1b4c0a4a73, 28095),
    ("decimal_comma.asc", "int32", 50, 40, 0x95932fc19dd3d470, 1943),
    ("dx_dy.asc", "int32", 50, 40, 0x95932fc19dd3d470, 1943),
    ("ehdr.flt", "float32", 181, 157, 0xd85b2c232327be12, 28095),
    ("envi.bil", "int16", 181, 157, 0x821b91acef6a69da, 28095),
    ("everest.dt0", "int16", 121, 121, 0x0136a76a818845bc, 13308),
    ("everest.dt1.zip", "int16", 1201, 1201, 0x5df79c0ad91f3d8b, 1311448),
    ("everest_usgs.dem", "int16", 121, 121, 0x0136a76a818845bc, 13308),
    ("float16.tif", "float32", 181, 157, 0x5a3348734a944f46, 28095),
    ("float32_bigendian_lzw_p3.tif", "float32", 181, 157, 0xa4812908b41c08a6, 28095),
    ("float32_deflate_p3_tiled.tif", "float32", 181, 157, 0xa4812908b41c08a6, 28095),
    ("float32_inf_and_nan_no_tag.tif", "float32", 181, 157, 0xb2ee09bf5d988d70, 28094),
    ("float32_lerc_0p01.tif", "float32", 181, 157, 0x1a6659df0cfbec18, 28095),
    ("float32_lerc_zstd_lossless.tif", "float32", 181, 157, 0xa4812908b41c08a6, 28095),
    ("float32_nodata_minfloat.tif", "float32", 181, 157, 0xd85b2c232327be12, 28095),
    ("float32_predictor2.tif", "float32", 181, 157, 0xa4812908b41c08a6, 28095),
    ("float64_nodata_nan.tif", "float64", 181, 157, 0x5aeb3856a25fb806, 28095),
    ("float64_zstd_p3.tif", "float64", 181, 157, 0x505546f8ab97197a, 28095),
    ("grid.asc", "int32", 181, 157, 0x68d69ec00d287fe6, 28095),
    ("height_16bit.png", "uint16", 181, 157, 0xe8ebe640aaa3bd53, 28417),
    ("int16_bigendian_stripped_lzw_p2.tif", "int16", 181, 157, 0x821b91acef6a69da, 28095),
    ("int16_bigtiff_bigendian.tif", "int16", 181, 157, 0x821b91acef6a69da, 28095),
    ("int16_bigtiff_tiled_deflate_p2.tif", "int16", 181, 157, 0x821b91acef6a69da, 28095),
    ("int16_lzma.tif", "int16", 181, 157, 0x821b91acef6a69da, 28095),
    ("int16_one_row_strips.tif", "int16", 181, 157, 0x821b91acef6a69da, 28095),
    ("int16_packbits.tif", "int16", 181, 157, 0x821b91acef6a69da, 28095),
    ("int16_scale_quarter_metre.tif", "int16", 181, 157, 0x6b29350b9c37d0c6, 28095),
    ("int16_zstd_p2_tiled.tif", "int16", 181, 157, 0x821b91acef6a69da, 28095),
    ("int32_deflate_p2.tif", "int32", 181, 157, 0x68d69ec00d287fe6, 28095),
    ("internal_mask.tif", "int16", 181, 157, 0xd7e677830d39741b, 25310),
    ("no_georeference.tif", "int16", 181, 157, 0x821b91acef6a69da, 28095),
    ("no_nodata_tabs.asc", "int32", 50, 40, 0xc65148b5bc94e921, 2000),
    ("pixel_is_point.tif", "int16", 181, 157, 0x821b91acef6a69da, 28095),
    ("real_4x3_no_nodata.asc", "int32", 3, 4, 0x12bf2d485642d081, 12),
    ("real_BigTIFF.tif", "uint8", 64, 64, 0xc21d92d357e7a981, 4096),
    ("real_BigTIFFMotorola.tif", "uint8", 64, 64, 0xc21d92d357e7a981, 4096),
    ("real_N10W110_ocean.hgt.zip", "int16", 1201, 1201, 0x327f07cdb595254a, 1442401),
    ("real_bessel_towgs84.tif", "uint8", 101, 101, 0x2da68d02d74fd601, 10201),
    ("real_esri_wkt.tif", "uint16", 2, 2, 0x67c58163b4db6e15, 4),
    ("real_geomatrix_rotated.tif", "uint8", 20, 20, 0x277fa709130d8775, 400),
    ("real_gray_12bit.tif", "uint16", 64, 64, 0x2e9ba4759fdf9d60, 4096),
    ("real_int16_zstd.tif", "int16", 64, 64, 0x2395135cc409fbc6, 4096),
    ("real_issue_69_lzw.tif", "uint16", 45, 45, 0x710df438c5c41cd3, 2025),
    ("real_laea_float_nodata.tif", "float32", 13, 12, 0xc0ac36ed54ddb4db, 98),
    ("real_pre_runout_dem.asc", "float64", 80, 122, 0x58c6f05cf17ecad7, 9638),
    ("real_predictor3_gray_f32.tif", "float32", 200, 200, 0x40c8e0591decad31, 40000),
    ("real_rotated_nocrs.tif", "uint8", 10, 15, 0x3e02be37f7f525a0, 150),
    ("real_runout_dem_of_difference.asc", "float64", 80, 122, 0x1cbffde3772829a5, 224),
    ("real_slovenia_dtm1m_nan_nodata.tif", "float32", 1000, 1000, 0x7f995c188216325d, 999500),
    ("real_srtmgl3_niwot.asc", "int32", 240, 144, 0xf353e9063581fa3c, 34560),
    ("real_utm_nonsquare.tif", "uint8", 100, 100, 0x0b341b6ba3b6af2d, 10000),
    ("real_west_bijou_gully.asc", "float64", 43, 89, 0xba5ace75d41e85be, 1088),
    ("real_white_fp16.tif", "float32", 256, 256, 0xd0cf6465f87f2325, 65536),
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
    ("wrapped_sci.asc", "int32", 50, 40, 0x6aa3c4e4937c2e85, 1943),
];

/// Files outside that folder, in the same way; of the quadrangle GDAL shows a void row more on either side.
#[rustfmt::skip]
const OTHERS: &[(&str, &str, u64, u64, u64, usize)] = &[
    ("overlap/gabon/N00E010.hgt.zip", "int16", 1201, 1201, 0x777f8966427ac1e0, 1442401),
    ("overlap/gabon/N00E011.hgt.zip", "int16", 1201, 1201, 0x9ab4c3b2580d2a51, 1442401),
    ("dem/N48W125.hgt.zip", "int16", 3601, 3601, 0x882b20204d92da30, 6483325),
    ("overlap/st_helens/usgs_quad_30m_nad27.dem", "int16", 327, 466, 0x51cb8c1b6de9e6c6, 148885),
];

/// Files that are refused, and how.
pub const REFUSED: &[(&str, Refusal)] = &[
    ("bad_token.asc", Refusal::Corrupt),
    ("corrupt_zstd_block.tif", Refusal::Corrupt),
    ("ehdr.prj", Refusal::Unsupported),
    ("empty.tif", Refusal::Corrupt),
    ("huge_dimensions.tif", Refusal::Limit),
    ("ifd_loop.tif", Refusal::Corrupt),
    ("real_corrupt_jpeg.tif", Refusal::Unsupported),
    ("real_fuzz_graydepth.tif", Refusal::Corrupt),
    ("strip_offset_past_end.tif", Refusal::Corrupt),
    ("truncated.asc", Refusal::Corrupt),
    ("truncated_half.tif", Refusal::Corrupt),
    ("truncated_header.tif", Refusal::Corrupt),
];

/// Headers, which are understood in place of the grids beside them.
const HEADERS: &[(&str, &str)] = &[("ehdr.hdr", "ehdr.flt"), ("envi.hdr", "envi.bil")];

#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Refusal {
    Corrupt,
    Unsupported,
    Limit,
}

/// Opens and reads a file and holds it against its line.
fn check(path: &std::path::Path, line: &(&str, &str, u64, u64, u64, usize), random: &mut Random) {
    let (name, sample_type, cols, rows, hash, valid) = line;
    let mut source = open(path).unwrap_or_else(|e| panic!("{e}"));
    let info = source.info();
    assert_eq!((info.sample_type.name(), info.cols, info.rows), (*sample_type, *cols, *rows), "{name}");
    let all = read_all(source.as_mut()).unwrap_or_else(|e| panic!("{e}"));
    assert_eq!(all.valid.iter().filter(|v| **v == 1).count(), *valid, "{name}");
    assert_eq!(fnv([&all.data, &all.valid]), *hash, "{name}");
    check_windows(source.as_mut(), &all, random);
}

#[test]
fn well_formed_files_read_as_gdal_reads_them() {
    let mut random = Random(7);
    for line in GOOD {
        let Some(path) = shared(&format!("difficult/{}", line.0)) else { return };
        check(&path, line, &mut random);
    }
    for (header, grid) in HEADERS {
        let Some(path) = shared(&format!("difficult/{header}")) else { return };
        check(&path, GOOD.iter().find(|g| g.0 == *grid).unwrap(), &mut random);
    }
}

#[test]
fn zipped_tiles_and_a_quadrangle_read_as_gdal_reads_them() {
    let mut random = Random(8);
    for line in OTHERS {
        let Some(path) = shared(line.0) else { return };
        check(&path, line, &mut random);
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
fn every_difficult_file_has_an_expectation() {
    let Some(folder) = shared("difficult") else { return };
    let mut names: Vec<&str> = GOOD.iter().map(|g| g.0).collect();
    names.extend(REFUSED.iter().map(|r| r.0));
    names.extend(HEADERS.iter().map(|h| h.0));
    names.sort_unstable();
    let entries = std::fs::read_dir(folder).unwrap();
    let mut found: Vec<String> = entries.map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
    found.sort_unstable();
    assert_eq!(found, names);
}
