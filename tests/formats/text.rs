//! Text formats: what Esri ASCII grids and USGS DEMs may look like, and what is wrong with them.

use super::{Random, check_windows, read_all, shared};
use terraquilt::base::Error;
use terraquilt::format::{open_bytes, open_bytes_beside};
use terraquilt::height::source::{SampleType, Samples, SourceInfo};

const HEAD: &str = "ncols 3\nnrows 2\nxllcorner 10\nyllcorner 20\ncellsize 2\n";

fn grid(text: &str) -> Result<(SourceInfo, Samples), Error> {
    let mut source = open_bytes("a.asc", text.as_bytes().to_vec())?;
    let all = read_all(source.as_mut())?;
    check_windows(source.as_mut(), &all, &mut Random(1));
    Ok((source.info().clone(), all))
}

fn heights(text: &str) -> Vec<Option<f64>> {
    let (info, all) = grid(text).unwrap_or_else(|e| panic!("{e}"));
    let values = all.data.chunks_exact(info.sample_type.bytes()).map(|b| info.sample_type.value(b));
    values.zip(&all.valid).map(|(v, valid)| (*valid == 1).then_some(v)).collect()
}

fn complaint(text: &str) -> String {
    match grid(text) {
        Ok(_) => panic!("read: {text}"),
        Err(e) => e.to_string(),
    }
}

#[test]
fn ascii_grids_of_all_writings_say_the_same() {
    let expected: Vec<Option<f64>> = [1.0, 2.0, -3.0, 4.0, 5.0].into_iter().map(Some).chain([None]).collect();
    let bodies = [
        "1 2 -3\n4 5 -9\n",
        "1\t2\t-3\r\n4\t5\t-9",
        "  1 2\n -3 4 5\n\n -9 \x1a",
        "1\n2\n-3\n4\n5\n-9\n",
        "1.0 2.000 -3. 4e0 +5 -9.0",
    ];
    for body in bodies {
        for nodata in ["NODATA_value -9\n", "NODATA -9\r\n", "nodata_VALUE -9.0\n"] {
            assert_eq!(heights(&format!("{HEAD}{nodata}{body}")), expected, "{nodata}{body}");
        }
    }
    let upper = HEAD.to_uppercase().replace('\n', "\r\n");
    assert_eq!(heights(&format!("\u{feff}{upper}NODATA_VALUE -9\r\n1 2 -3 4 5 -9")), expected);
    let commas = "1,0 2,0 -3,0\n4 5 -9\n";
    assert_eq!(heights(&format!("{HEAD}NODATA_value -9\n{commas}")), expected);
}

#[test]
fn posts_are_the_centres_of_cells_and_the_first_row_the_northernmost() {
    let origin = |head: &str| grid(&format!("{head}1 2 3 4 5 6")).unwrap().0.affine.unwrap().origin;
    assert_eq!(origin(HEAD), [11.0, 23.0]);
    let centre = HEAD.replace("corner", "center");
    assert_eq!(origin(&centre), [10.0, 22.0]);
    let flat = HEAD.replace("cellsize 2", "dx 2\ndy 0.5");
    assert_eq!(origin(&flat), [11.0, 20.75]);
    let a = grid(&format!("{flat}1 2 3 4 5 6")).unwrap().0.affine.unwrap();
    assert_eq!((a.col_step, a.row_step), ([2.0, 0.0], [0.0, -0.5]));
}

#[test]
fn samples_take_the_narrowest_type_that_holds_what_is_written() {
    let kind = |body: &str| grid(&format!("{HEAD}{body}")).unwrap().0.sample_type;
    assert_eq!(kind("1 2 3 4 5 -2147483648"), SampleType::I32);
    assert_eq!(kind("1 2 3 4 5 2147483648"), SampleType::F32);
    assert_eq!(kind("1 2 3 4 5.5 nan"), SampleType::F32);
    assert_eq!(kind("1 2 3 4 5 16777217.5"), SampleType::F64);
    assert_eq!(kind("1 2 3 4 5 0.1"), SampleType::F64);
    assert_eq!(
        heights(&format!("{HEAD}0.1 nan 1.#QNAN 4 inf 6"))[..5],
        [Some(0.1), None, None, Some(4.0), None]
    );
}

#[test]
fn without_a_nodata_line_esris_default_is_void_and_said() {
    let (info, all) = grid(&format!("{HEAD}1 2 -9999 4 5 -32768")).unwrap();
    assert_eq!(all.valid, [1, 1, 0, 1, 1, 1]);
    assert!(info.notes.iter().any(|n| n.contains("-9999")), "{:?}", info.notes);
    let (info, _) = grid(&format!("{HEAD}1 2 3 4 5 6")).unwrap();
    assert_eq!((info.nodata, info.notes.len()), (None, 0));
}

#[test]
fn bad_ascii_grids_are_refused_with_line_and_values() {
    let body = "1 2 3\n4 5 6\n";
    let cases = [
        // Text, words of the error.
        (format!("{HEAD}1 2 3\n4 x5 6\n"), vec!["line 7", "'x5'"]),
        (format!("{HEAD}1 2 3\n4 5\n"), vec!["line 7", "5 of 3 x 2", "(2)"]),
        (format!("{HEAD}1 2 3\n4 5 6 7\n"), vec!["line 7", "more than 3 x 2"]),
        (format!("{HEAD}1 2\n3 4 5 6\n"), vec!["line 6", "2 values", "a row has 3"]),
        (format!("{HEAD}1,119,000 2 3 4 5 6"), vec!["'1,119,000'"]),
        (format!("{HEAD}1,5 2.5 3 4 5 6"), vec!["'2.5'", "commas"]),
        (format!("{HEAD}1.5 2,5 3 4 5 6"), vec!["'2,5'", "decimal points"]),
        (format!("{HEAD}1 2 3 4 5 1e999"), vec!["'1e999'"]),
        (format!("{HEAD}1 2 3 4 5 {}", "9".repeat(5000)), vec!["is not a number"]),
        (HEAD.to_string(), vec!["no heights"]),
        (HEAD.replace("cellsize 2", "") + body, vec!["CELLSIZE or DX"]),
        (HEAD.replace("cellsize 2", "cellsize 0") + body, vec!["0 x 0"]),
        (HEAD.replace("cellsize 2", "cellsize 2\ndx 2") + body, vec!["both"]),
        (HEAD.replace("xllcorner 10\n", "") + body, vec!["XLLCORNER or XLLCENTER"]),
        (HEAD.replace("ncols 3", "ncols") + body, vec!["NCOLS", "'nrows'"]),
        (HEAD.replace("ncols 3", "ncols 3\nNCOLS 3") + body, vec!["second time"]),
        (HEAD.replace("ncols 3", "ncols -3") + body, vec!["NCOLS is -3"]),
        (HEAD.replace("ncols 3", "ncols 2.5") + body, vec!["NCOLS is 2.5"]),
        (HEAD.replace("ncols 3", "ncols 0") + body, vec!["0 x 2"]),
        (HEAD.replace("ncols 3", "ncols 4000000000") + body, vec!["columns", "4000000000"]),
        (
            HEAD.replace("ncols 3", "ncols 1900000").replace("nrows 2", "nrows 1900000") + body,
            vec!["posts", "allowed"],
        ),
        (HEAD.replace("ncols 3", "ncols 100000") + body, vec!["100000 x 2 posts in a file of"]),
        (HEAD.replace("cellsize 2", "cellsize 2\nunits metres") + body, vec!["line 6", "'units'"]),
    ];
    for (text, words) in cases {
        let line = complaint(&text);
        assert!(line.contains("a.asc") && !line.contains('\n') && line.len() < 400, "{line}");
        for w in words {
            assert!(line.contains(w), "no '{w}' in: {line}");
        }
    }
}

/// A USGS DEM of 30 m in UTM 10: profiles as (first northing, heights).
fn dem(step: f64, unit: u8, profiles: &[(f64, &[i32])]) -> String {
    let mut text = format!("{:<144}{:>6}{:>6}{:>6}{:>6}", "A QUADRANGLE", 1, 1, 1, 10);
    text += &" ".repeat(360);
    text += &format!("{:>6}{:>6}{:>6}", 2, unit, 4);
    text += &" ".repeat(8 * 24 + 2 * 24 + 24);
    text += &format!(
        "{:>6}{:>12}{:>12}{:>12}{:>6}{:>6}",
        0,
        "0.300000E+02",
        "0.300000E+02",
        format!("{step:E}"),
        1,
        profiles.len()
    );
    text += &format!("{:<26}{:>2}{:<132}", "", 4, "");
    assert_eq!(text.len(), 1024);
    for (k, (north, heights)) in profiles.iter().enumerate() {
        text += &format!("{:>6}{:>6}{:>6}{:>6}", 1, k + 1, heights.len(), 1);
        let place = [500000.0 + 30.0 * k as f64, *north, 0.0];
        place.iter().for_each(|v| text += &format!("{:>24}", format!("{v:.15E}").replace('E', "D")));
        text += &" ".repeat(48);
        heights.iter().for_each(|h| text += &format!("{h:>6}"));
        text += &" ".repeat(1020 - (144 + 6 * heights.len()));
        text += "\r\n  ";
    }
    text
}

#[test]
fn profiles_of_a_slanted_quadrangle_fill_their_place() {
    let text = dem(0.5, 1, &[(4000030.0, &[10, -32767, 12]), (4000000.0, &[20, 21]), (4000060.0, &[31])]);
    let mut source = open_bytes("quad.dem", text.into_bytes()).unwrap();
    let info = source.info().clone();
    assert_eq!((info.cols, info.rows, info.sample_type), (3, 4, SampleType::I16));
    assert_eq!((info.scale, info.crs.unwrap().code.as_str()), (0.5 * 0.3048, "EPSG:26910"));
    let a = info.affine.unwrap();
    assert_eq!((a.origin, a.col_step, a.row_step), ([500000.0, 4000090.0], [30.0, 0.0], [0.0, -30.0]));
    let all = read_all(source.as_mut()).unwrap();
    let h: Vec<i64> = all.data.chunks(2).map(|b| SampleType::I16.value(b) as i64).collect();
    let v = -32767;
    assert_eq!(h, [12, v, v, v, v, 31, 10, 21, v, v, 20, v]);
    assert!(h.iter().zip(&all.valid).all(|(h, valid)| (*h != v) == (*valid == 1)));
    check_windows(source.as_mut(), &all, &mut Random(2));
}

#[test]
fn bad_usgs_dems_are_refused_by_profile() {
    let good = dem(1.0, 2, &[(0.0, &[1, 2]), (0.0, &[3, 4])]);
    let complaint = |text: String| match open_bytes("quad.dem", text.into_bytes()) {
        Ok(_) => panic!("read"),
        Err(e) => e.to_string(),
    };
    let cut = complaint(good[..good.len() - 900].to_string());
    assert!(cut.contains("profile 2 of 2"), "{cut}");
    let off = complaint(dem(1.0, 2, &[(0.0, &[1, 2]), (10.0, &[3, 4])]));
    assert!(off.contains("profile 2") && off.contains("0.333"), "{off}");
    let far = complaint(dem(1.0, 2, &[(0.0, &[1, 2]), (3e7, &[3, 4])]));
    assert!(far.contains("span"), "{far}");
    let letters = complaint(good.replace("     3     4", "     3     x"));
    assert!(letters.contains("1 of 2 heights"), "{letters}");
}

#[test]
fn the_crs_of_a_text_is_beside_it() {
    let text = format!("{HEAD}1 2 3 4 5 6").into_bytes();
    let with = |prj: &str| {
        let beside = vec![("A.PRJ".to_string(), prj.as_bytes().to_vec())];
        open_bytes_beside("dir/a.asc", text.clone(), beside).unwrap().info().clone()
    };
    assert_eq!(with("EPSG:25832\n").crs.unwrap().code, "EPSG:25832");
    let info = with("NOTHING[\"known\"]");
    assert!(
        info.crs.is_none() && info.notes[0].contains("A.PRJ") && info.notes[0].contains("NOTHING"),
        "{info:?}"
    );
    let Some(path) = shared("difficult/grid.asc") else { return };
    assert!(terraquilt::format::open(&path).unwrap().info().crs.is_none());
}
