//! Coordinates: against values of PROJ, and what is refused; heights over geoids.

use crate::support::{printed, shared};
use std::sync::Arc;
use terraquilt::base::Result;
use terraquilt::format;
use terraquilt::height::crs::vertical::{US_FOOT_M, VerticalDatum};
use terraquilt::height::crs::{Crs, DatumChoice, Helmert, Transform, lonlat_bounds};
use terraquilt::height::lifted::{Lift, Lifted};
use terraquilt::height::source::{Affine, HeightSource, SampleType, Samples, SourceInfo, Window};

/// Longitude and latitude on a system's own datum, and its coordinates: computed by PROJ 9.5.1 (EPSG v11.022).
#[rustfmt::skip]
const PROJ: [(&str, [f64; 2], [f64; 2]); 74] = [
    ("EPSG:32611", [-118.2, 50.4], [414716.31840, 5583794.25424]),
    ("EPSG:32611", [-115.5, 16.8], [659848.54928, 1858035.12706]),
    ("EPSG:32733", [13.8, -32.0], [386649.92523, 6458935.23634]),
    ("EPSG:32733", [16.5, -64.0], [573363.09537, 2902122.63857]),
    ("EPSG:3857", [-72.0, 17.012], [-8015003.33712, 1922221.95560]),
    ("EPSG:3857", [90.0, -51.036], [10018754.17139, -6627664.17811]),
    ("EPSG:2154", [-3.788, 47.396], [188615.36467, 6721511.54923]),
    ("EPSG:2154", [5.32, 43.232], [888559.06762, 6239747.96669]),
    ("EPSG:2229", [-119.23, 34.59], [6191488.66425, 2039359.91636]),
    ("EPSG:2229", [-115.945, 33.37], [7189183.63626, 1599517.80444]),
    ("EPSG:2263", [-73.522, 40.968], [1116256.76616, 292307.91066]),
    ("EPSG:2263", [-72.415, 40.636], [1424138.01029, 174968.14140]),
    ("EPSG:26910", [-124.197, 61.296], [435865.07128, 6796345.54507]),
    ("EPSG:26910", [-121.492, 40.792], [627225.14810, 4516761.45891]),
    ("EPSG:3035", [-11.457, 60.678], [3165896.14113, 4352431.15023]),
    ("EPSG:3035", [24.727, 36.626], [5640720.16329, 1633465.72575]),
    ("EPSG:5070", [-107.426, 39.392], [-972742.35372, 1877392.41673]),
    ("EPSG:5070", [-81.38, 29.404], [1413692.18091, 812237.62335]),
    ("EPSG:3031", [-72.0, -72.0], [-1874855.29237, 609177.41208]),
    ("EPSG:3031", [90.0, -84.0], [652486.97201, 0.00000]),
    ("EPSG:3413", [-72.0, 78.0], [-592234.44254, -1162325.53864]),
    ("EPSG:3413", [90.0, 66.0], [1864649.65859, 1864649.65859]),
    ("EPSG:27700", [-5.704, 56.506], [172101.13887, 741016.26845]),
    ("EPSG:27700", [-0.745, 52.002], [486142.65477, 234519.66287]),
    ("EPSG:2056", [7.319, 47.014], [2590832.42119, 1206853.77059]),
    ("EPSG:2056", [9.357, 46.218], [2747924.28347, 1120177.32604]),
    ("EPSG:28992", [4.406, 52.52], [88381.97797, 503929.32622]),
    ("EPSG:28992", [6.215, 51.34], [212643.04463, 372535.95733]),
    ("EPSG:2193", [170.048, -39.392], [1345775.49173, 5635563.05203]),
    ("EPSG:2193", [175.565, -44.684], [1803270.20306, 5048951.61678]),
    ("EPSG:31467", [8.403, 51.962], [3458969.71069, 5758691.37294]),
    ("EPSG:31467", [9.758, 48.834], [3555641.32014, 5410891.34924]),
    ("EPSG:3395", [-72.0, 18.4], [-8015003.33712, 2070940.92712]),
    ("EPSG:3395", [90.0, -47.2], [10018754.17139, -5943414.20708]),
    ("EPSG:3006", [14.272, 63.426], [463663.89758, 7033260.78456]),
    ("EPSG:3006", [20.635, 57.782], [834868.69235, 6418389.18674]),
    ("EPSG:25832", [7.803, 65.018], [443594.10187, 7210994.75342]),
    ("EPSG:25832", [10.508, 46.026], [616712.76184, 5098041.73144]),
    ("EPSG:3338", [-170.303, 63.36], [-805889.32314, 1587413.81108]),
    ("EPSG:3338", [-144.388, 55.32], [607827.04557, 633809.48124]),
    ("EPSG:3005", [-131.552, 55.306], [648703.27424, 1159169.43354]),
    ("EPSG:3005", [-120.32, 50.602], [1401426.20005, 636882.99959]),
    ("EPSG:6931", [-72.0, 54.0], [-3757061.32856, -1220743.22560]),
    ("EPSG:6931", [90.0, 18.0], [7496339.97276, -0.00000]),
    ("EPSG:6933", [-72.0, 17.2], [-6947012.17806, 2162295.63483]),
    ("EPSG:6933", [90.0, -51.6], [8683765.22258, -5744097.38469]),
    ("EPSG:3112", [125.102, -23.396], [-899537.17306, -2698001.51624]),
    ("EPSG:3112", [143.48, -36.932], [846136.43602, -4185922.07078]),
    ("EPSG:5880", [-59.391, -10.06], [4409069.54730, 8882652.40054]),
    ("EPSG:5880", [-37.463, -27.16], [6634310.98190, 6886824.13959]),
    ("EPSG:32661", [-72.0, 78.0], [728456.07180, 1586850.33310]),
    ("EPSG:32661", [90.0, 66.0], [4702653.63058, 2000000.00000]),
    ("EPSG:2039", [34.626, 31.748], [164713.92917, 628561.72566]),
    ("EPSG:2039", [35.31, 30.216], [229685.20939, 458568.08047]),
    ("EPSG:3375", [100.36, 5.138], [263529.91425, 568943.01830]),
    ("EPSG:3375", [103.87, 2.466], [652679.95617, 272673.24537]),
    ("EPSG:5514", [15.231, 49.728], [-690480.54220, -1090332.18704]),
    ("EPSG:5514", [19.942, 48.396], [-361890.33155, -1270268.74144]),
    ("EPSG:3978", [-110.926, 67.16], [-662949.79524, 2062013.18796]),
    ("EPSG:3978", [-65.8, 47.86], [2118654.24206, 367982.46177]),
    ("EPSG:8857", [-72.0, 18.0], [-6737077.62602, 2293588.06327]),
    ("EPSG:8857", [90.0, -54.0], [6881348.59246, -6378608.79200]),
    ("EPSG:26986", [-72.408, 42.318], [125151.13292, 896788.76871]),
    ("EPSG:26986", [-70.77, 41.746], [260719.98554, 833117.64882]),
    ("ESRI:102003", [-107.426, 39.392], [-972742.35372, 270606.15615]),
    ("ESRI:102003", [-81.38, 29.404], [1413692.18091, -794548.63723]),
    ("ESRI:102001", [-110.926, 67.16], [-635467.42877, 3099345.66187]),
    ("ESRI:102001", [-65.8, 47.86], [2196161.51590, 1360676.91226]),
    ("ESRI:102008", [-135.1, 61.4], [-2058330.62606, 2915655.77808]),
    ("ESRI:102008", [-78.94, 36.34], [1440966.89258, -300646.11277]),
    ("ESRI:54009", [-72.0, 18.0], [-6995786.44796, 2211539.48454]),
    ("ESRI:54009", [90.0, -54.0], [6469255.98331, -6285697.27270]),
    ("ESRI:54008", [-72.0, 18.0], [-7625158.75731, 1990981.93488]),
    ("ESRI:54008", [90.0, -54.0], [5901819.63787, -5985916.02840]),
];

/// German Gauss-Krueger on Bessel with +towgs84, and UTM 32 on WGS 84: PROJ 9.5.1.
const SHIFTED: [([f64; 2], [f64; 2]); 2] = [
    ([3458969.71069, 5758691.37294], [458913.51702, 5756827.86733]),
    ([3555641.32014, 5410891.34924], [555543.40296, 5409166.44487]),
];

/// Post (0, 0) of the Albers grid of the Sierra on NAD83: PROJ 9.5.1.
const SIERRA: [f64; 2] = [-119.47464717470172, 37.55186556309467];

fn way(from: &str, to: &str) -> Transform {
    Transform::new(&Crs::parse(from).unwrap(), &Crs::parse(to).unwrap(), &DatumChoice::None).unwrap()
}

#[test]
fn projections_are_those_of_proj() {
    let geographic = Crs::from_epsg(4326).unwrap();
    for (code, lonlat, expected) in PROJ {
        // Ballpark: the table has each system's own longitudes, old datums too.
        let crs = Crs::parse(code).unwrap();
        let t = Transform::new(&geographic, &crs, &DatumChoice::Ballpark).unwrap();
        let p = t.forward(lonlat).unwrap();
        let error = (p[0] - expected[0]).hypot(p[1] - expected[1]);
        assert!(error < 1e-3, "{code} {lonlat:?}: {p:?}, PROJ {expected:?}");
        let back = t.inverse(p).unwrap();
        // 2e-8 degrees are 2 mm: the inverse of the equal-area azimuthal projection is no better.
        assert!((0..2).all(|k| (back[k] - lonlat[k]).abs() < 2e-8), "{code} {lonlat:?}: {back:?}");
    }
}

#[test]
fn stated_shifts_are_those_of_proj() {
    let potsdam = "+proj=tmerc +lon_0=9 +x_0=3500000 +ellps=bessel \
                   +towgs84=598.1,73.7,418.2,0.202,0.045,-2.455,6.7";
    let stated = way(potsdam, "EPSG:32632");
    assert!(stated.description().contains("stated by the system"), "{}", stated.description());
    let (gk, utm) = (Crs::from_epsg(31467).unwrap(), Crs::from_epsg(32632).unwrap());
    let choice = DatumChoice::parse("598.1,73.7,418.2,0.202,0.045,-2.455,6.7").unwrap();
    let chosen = Transform::new(&gk, &utm, &choice).unwrap();
    assert!(chosen.description().contains("chosen by the user"), "{}", chosen.description());
    for (p, q) in SHIFTED {
        for t in [&stated, &chosen] {
            let found = t.forward(p).unwrap();
            assert!((found[0] - q[0]).hypot(found[1] - q[1]) < 1e-3, "{found:?}, PROJ {q:?}");
            let back = t.inverse(found).unwrap();
            assert!((back[0] - p[0]).hypot(back[1] - p[1]) < 1e-5, "{back:?}");
        }
    }
}

#[test]
fn old_datums_want_a_choice() {
    let (nad27, utm) = (Crs::from_epsg(26710).unwrap(), Crs::from_epsg(32610).unwrap());
    let refused = Transform::new(&nad27, &utm, &DatumChoice::None).err().unwrap().to_string();
    assert!(refused.contains("NAD27") && refused.contains("--datum-shift"), "{refused}");
    let ballpark = Transform::new(&nad27, &utm, &DatumChoice::Ballpark).unwrap();
    assert!(ballpark.description().contains("ballpark") && ballpark.notes().len() == 1);
    let choice = DatumChoice::ToWgs84(Helmert::parse("-8,160,176").unwrap());
    assert_eq!(choice, DatumChoice::parse(&choice.to_string()).unwrap());
    let shifted = Transform::new(&nad27, &utm, &choice).unwrap();
    assert!(shifted.description().contains("towgs84=-8,160,176"), "{}", shifted.description());
    let p = [560000.0, 5115000.0];
    let (a, b) = (ballpark.forward(p).unwrap(), shifted.forward(p).unwrap());
    let apart = (a[0] - b[0]).hypot(a[1] - b[1]);
    assert!((50.0..150.0).contains(&apart), "{apart} m");
    // PROJ 9.5.1, +towgs84=-8,160,176 on clrk66.
    assert!((b[0] - 559906.34685).hypot(b[1] - 5115195.89177) < 1e-3, "{b:?}");
    let back = shifted.inverse(b).unwrap();
    assert!((back[0] - p[0]).hypot(back[1] - p[1]) < 1e-6);
    // On one datum nothing is shifted, whatever it is.
    let same = Transform::new(&nad27, &Crs::from_epsg(4267).unwrap(), &DatumChoice::None).unwrap();
    assert!(same.notes().is_empty());
    assert!(same.forward([f64::NAN, 0.0]).is_none());
    for wrong in ["", "1,2", "1,2,x", "1,2,3,4,5,6,inf", "perhaps"] {
        assert!(DatumChoice::parse(wrong).is_err(), "{wrong}");
    }
}

/// Transverse Mercator on Bessel's ellipsoid, on a datum that the text names.
fn named_datum(name: &str, lon0: f64) -> String {
    format!(
        r#"PROJCS["x",GEOGCS["{name}",DATUM["{name}",SPHEROID["Bessel 1841",6377397.155,299.1528128]],
        PRIMEM["Greenwich",0],UNIT["degree",0.0174532925199433]],PROJECTION["Transverse_Mercator"],
        PARAMETER["latitude_of_origin",0],PARAMETER["central_meridian",{lon0}],PARAMETER["scale_factor",1],
        PARAMETER["false_easting",3500000],PARAMETER["false_northing",0],UNIT["metre",1]]"#
    )
}

#[test]
fn two_old_datums_on_one_ellipsoid_are_two() {
    let (tokyo, dhdn) = (named_datum("Tokyo", 9.0), named_datum("Deutsches_Hauptdreiecksnetz", 9.0));
    let [tokyo, dhdn] = [tokyo, dhdn].map(|text| Crs::parse(&text).unwrap());
    let unnamed = "+proj=tmerc +lon_0=9 +x_0=3500000 +ellps=bessel";
    let [unnamed, moved] = [unnamed, &unnamed.replace("=9", "=10")].map(|text| Crs::parse(text).unwrap());
    for (a, b) in [(&tokyo, &dhdn), (&dhdn, &unnamed), (&unnamed, &moved)] {
        assert!(!a.same_as(b), "{} {}", a.code, b.code);
        let refused = Transform::new(a, b, &DatumChoice::None).err().unwrap().to_string();
        assert!(refused.contains("--datum-shift"), "{refused}");
        let shift = DatumChoice::parse("598.1,73.7,418.2").unwrap();
        assert!(Transform::new(a, b, &shift).err().unwrap().to_string().contains("'ballpark'"));
        assert!(Transform::new(a, b, &DatumChoice::Ballpark).unwrap().notes()[0].contains("hundred"));
    }
    // What the texts name is kept: the same system as the code's, whatever text it is read from.
    let code = Crs::from_epsg(31467).unwrap();
    assert!(dhdn.same_as(&code) && !tokyo.same_as(&code) && !unnamed.same_as(&code));
    for crs in [&tokyo, &dhdn, &unnamed, &moved] {
        assert_eq!(&Crs::parse(&crs.code).unwrap(), crs);
        assert!(crs.same_as(crs));
        assert!(Transform::new(crs, crs, &DatumChoice::None).unwrap().notes().is_empty());
    }
    let turned = Crs::parse(&named_datum("Deutsches_Hauptdreiecksnetz", 10.0)).unwrap();
    assert!(Transform::new(&turned, &code, &DatumChoice::None).unwrap().description().contains("one datum"));
    for wrong in
        ["+ellps=intl +datum_epsg=6314", "+ellps=WGS84 +datum_epsg=6326", "+datum=NAD27 +datum_epsg=6314"]
    {
        assert!(Crs::parse(&format!("+proj=longlat {wrong}")).is_err(), "{wrong}");
    }
    for wrong in ["0", "x", "-1", "99999999999", "6314 +towgs84=1,2,3"] {
        assert!(Crs::parse(&format!("+proj=longlat +ellps=bessel +datum_epsg={wrong}")).is_err(), "{wrong}");
    }
}

#[test]
fn systems_that_proj_computes_otherwise_are_refused() {
    let geographic = Crs::from_epsg(4326).unwrap();
    for (code, word) in [("EPSG:4087", "equidistant"), ("EPSG:27572", "meridian"), ("EPSG:4803", "meridian")]
    {
        let crs = Crs::parse(code).unwrap();
        let text = Transform::new(&crs, &geographic, &DatumChoice::Ballpark).err().unwrap().to_string();
        assert!(text.contains(code) && text.contains(word), "{text}");
    }
    let unreadable =
        ["EPSG:4326+", "ESRI:1", "+proj=robin", "+proj=laea +lat_0=x", "PROJCS[", "utm", "", "+", "GEOGCS[]"];
    for text in unreadable {
        assert!(Crs::parse(text).is_err(), "{text}");
    }
    let deep = "A[".repeat(1000);
    assert!(
        Crs::parse(&deep).is_err() && Crs::parse(&format!("+proj=utm +zone={}", "1".repeat(9000))).is_err()
    );
}

#[test]
fn modern_datums_are_one_and_it_is_said() {
    let t = way("EPSG:26911", "EPSG:32611");
    let p = t.forward([400000.0, 4100000.0]).unwrap();
    assert!((p[0] - 400000.0).hypot(p[1] - 4100000.0) < 1e-3);
    assert!(t.notes()[0].contains("NAD83") && t.notes()[0].contains("4 m"), "{:?}", t.notes());
    assert!(way("EPSG:32611", "EPSG:4326").notes().is_empty());
}

const ESRI_ALBERS: &str = r#"PROJCS["USA_Contiguous_Albers_Equal_Area_Conic",GEOGCS["GCS_North_American_1983",
    DATUM["D_North_American_1983",SPHEROID["GRS_1980",6378137.0,298.257222101]],PRIMEM["Greenwich",0.0],
    UNIT["Degree",0.0174532925199433]],PROJECTION["Albers"],PARAMETER["False_Easting",0.0],
    PARAMETER["False_Northing",0.0],PARAMETER["Central_Meridian",-96.0],PARAMETER["Standard_Parallel_1",29.5],
    PARAMETER["Standard_Parallel_2",45.5],PARAMETER["Latitude_Of_Origin",37.5],UNIT["Meter",1.0]]"#;

const ESRI_SOUTH: &str = r#"PROJCS["Antarctic",GEOGCS["GCS_WGS_1984",DATUM["D_WGS_1984",
    SPHEROID["WGS_1984",6378137.0,298.257223563]],PRIMEM["Greenwich",0.0],UNIT["Degree",0.0174532925199433]],
    PROJECTION["Stereographic_South_Pole"],PARAMETER["False_Easting",0.0],PARAMETER["False_Northing",0.0],
    PARAMETER["Central_Meridian",0.0],PARAMETER["Standard_Parallel_1",-71.0],UNIT["Meter",1.0]]"#;

const WKT2_UTM: &str = r#"PROJCRS["mine",BASEGEOGCRS["WGS 84",DATUM["World Geodetic System 1984",
    ELLIPSOID["WGS 84",6378137,298.257223563,LENGTHUNIT["metre",1]]],PRIMEM["Greenwich",0,
    ANGLEUNIT["degree",0.0174532925199433]]],CONVERSION["x",METHOD["Transverse Mercator"],
    PARAMETER["Latitude of natural origin",0,ANGLEUNIT["degree",0.0174532925199433]],
    PARAMETER["Longitude of natural origin",-117,ANGLEUNIT["degree",0.0174532925199433]],
    PARAMETER["Scale factor at natural origin",0.9996,SCALEUNIT["unity",1]],
    PARAMETER["False easting",500000,LENGTHUNIT["metre",1]],PARAMETER["False northing",0,LENGTHUNIT["metre",1]]],
    CS[Cartesian,2],AXIS["easting",east,ORDER[1]],AXIS["northing",north,ORDER[2]],LENGTHUNIT["metre",1]]"#;

#[test]
fn wkt_of_three_kinds() {
    let code = |text: &str| Crs::parse(text).unwrap().code;
    assert_eq!(code(ESRI_ALBERS), "ESRI:102003");
    assert_eq!(code(ESRI_SOUTH), "EPSG:3031");
    assert_eq!(code(WKT2_UTM), "EPSG:32611");
    // A code of its own counts more than what it spells out.
    let coded = format!("{},ID[\"EPSG\",32612]]", &WKT2_UTM[..WKT2_UTM.len() - 1]);
    assert_eq!(code(&coded), "EPSG:32612");
    let general = ESRI_SOUTH.replace("Stereographic_South_Pole", "Stereographic");
    assert!(Crs::parse(&general).err().unwrap().to_string().contains("stereographic"));
}

#[test]
fn damaged_texts_are_errors_or_systems_that_are_read_again() {
    let proj = "+proj=omerc +lat_0=4 +lonc=115 +alpha=53.3 +gamma=53.1 +k=0.99984 +x_0=1 +ellps=krass +towgs84=1,2,3";
    let mut read = 0;
    for text in [proj, "+proj=cea +lat_ts=30 +datum=WGS84 +units=us-ft", ESRI_ALBERS, ESRI_SOUTH, WKT2_UTM] {
        for at in (0..text.len()).filter(|at| text.is_char_boundary(*at)) {
            for put in ["", "9", "-", "e", "]", "[", "\"", ","] {
                let damaged = format!("{}{put}{}", &text[..at], &text[at + 1..]);
                if let Ok(crs) = Crs::parse(&damaged) {
                    assert_eq!(Crs::parse(&crs.code).unwrap(), crs, "{damaged}");
                    read += 1;
                }
            }
        }
    }
    assert!(read > 1000, "{read}");
}

#[test]
fn files_that_spell_their_system_out() {
    let laea = "+proj=laea +lat_0=52 +lon_0=10 +x_0=4321000 +y_0=3210000 +ellps=GRS80 +units=m +no_defs";
    let expected = [
        ("difficult/real_esri_wkt.tif", "EPSG:5070"),
        ("difficult/crs_feet_state_plane.tif", "EPSG:2229"),
        ("dem/vestfold_32m_polar.tif", "EPSG:3031"),
        ("kit/k10_albers_30m_real.tif", "ESRI:102003"),
        ("overlap/sierra/sierra_30m_albers.tif", "ESRI:102003"),
        ("difficult/real_laea_float_nodata.tif", laea),
    ];
    for (name, code) in expected {
        let Some(path) = shared(name) else { return };
        let source = format::open(&path).unwrap();
        let info = source.info();
        assert_eq!(info.crs.as_ref().map(|c| c.code.as_str()), Some(code), "{name}: {:?}", info.notes);
    }
    let esri = format::open(&shared("difficult/real_esri_wkt.tif").unwrap()).unwrap();
    assert_eq!(esri.info().vertical_datum.as_deref(), Some("EPSG:5703"));
    assert_eq!(esri.info().vertical_unit_m, Some(0.01));
    // The Albers grid lies where PROJ says, and its rectangle reaches further than its corners.
    let albers = format::open(&shared("overlap/sierra/sierra_30m_albers.tif").unwrap()).unwrap();
    let crs = albers.info().crs.clone().unwrap();
    let [x, y] = albers.info().affine.unwrap().origin;
    let p = way(&crs.code, "EPSG:4269").forward([x, y]).unwrap();
    assert!((p[0] - SIERRA[0]).abs() < 1e-9 && (p[1] - SIERRA[1]).abs() < 1e-9, "{p:?}");
    let found = lonlat_bounds(&crs, [x, y - 1099.0 * 30.0, x + 1099.0 * 30.0, y]).unwrap();
    let proj = [-119.47464717470172, 37.26656094456902, -119.01851877509603, 37.623247893190864];
    assert!((0..4).all(|k| (found[k] - proj[k]).abs() < 1e-6), "{found:?}");
}

/// The bytes of a GTX file: 12 x 10 values c * c / 4 - 1.5 r from 5 E, 45 N in steps of half a degree.
fn gtx() -> Vec<u8> {
    let mut bytes = Vec::new();
    for v in [45.0f64, 5.0, 0.5, 0.5] {
        bytes.extend(v.to_be_bytes());
    }
    bytes.extend(10i32.to_be_bytes());
    bytes.extend(12i32.to_be_bytes());
    for r in 0..10 {
        for c in 0..12 {
            bytes.extend(((c * c) as f32 * 0.25 - r as f32 * 1.5).to_be_bytes());
        }
    }
    bytes
}

#[test]
fn gtx_grids_are_read_as_proj_reads_them() {
    let geoid = format::geoid::open_bytes("a.gtx", gtx()).unwrap();
    // +proj=vgridshift of PROJ 9.5.1 on the same bytes.
    let expected =
        [([5.0, 45.0], 0.0), ([7.123, 46.777], -0.7775), ([10.49, 49.49], 16.675), ([366.3, 47.3], -5.15)];
    for ([lon, lat], n) in expected {
        let found = geoid.undulation(lon, lat).unwrap();
        assert!((found - n).abs() < 1e-9, "{lon} {lat}: {found}, PROJ {n}");
    }
    assert!(geoid.undulation(4.9, 46.0).is_none() && geoid.undulation(7.0, 49.6).is_none());
    let bytes = gtx();
    for cut in [0, 39, 40, bytes.len() - 1] {
        assert!(format::geoid::open_bytes("a.gtx", bytes[..cut].to_vec()).is_err(), "{cut}");
    }
    let mut large = bytes.clone();
    large[32..40].copy_from_slice(&[0x7f; 8]);
    assert!(format::geoid::open_bytes("a.gtx", large).err().unwrap().to_string().contains("at most"));
    let mut negative = bytes;
    negative[32] = 0xff;
    assert!(format::geoid::open_bytes("a.gtx", negative).is_err());
}

#[test]
fn the_same_grid_as_geotiff() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("grid.tif");
    let spec = format::geotiff::GeoTiffSpec {
        cols: 12,
        rows: 10,
        sample_type: SampleType::F32,
        affine: Some(Affine { origin: [5.0, 49.5], col_step: [0.5, 0.0], row_step: [0.0, -0.5] }),
        crs: Some(Crs::from_epsg(4326).unwrap()),
        nodata: None,
        scale: 1.0,
        offset: 0.0,
        vertical_datum: None,
    };
    let rows: Vec<u8> = (0..10)
        .rev()
        .flat_map(|r| (0..12).flat_map(move |c| ((c * c) as f32 * 0.25 - r as f32 * 1.5).to_le_bytes()))
        .collect();
    let mut writer = format::geotiff::GeoTiffWriter::create(&path, spec).unwrap();
    writer.write_rows(0, &rows).unwrap();
    writer.finish().unwrap();
    let tiff = format::geoid::open(&path).unwrap();
    let by_hand = format::geoid::open_bytes("a.gtx", gtx()).unwrap();
    assert_eq!(tiff.digest(), by_hand.digest());
    assert_eq!(tiff.bounds(), [5.0, 45.0, 10.5, 49.5]);
}

/// A slope of 16-bit samples on UTM 32, in half feet.
struct Slope {
    info: SourceInfo,
}

impl Slope {
    fn at(origin: [f64; 2]) -> Box<Slope> {
        let info = SourceInfo {
            file: "slope".to_string(),
            format: "memory",
            cols: 60,
            rows: 50,
            sample_type: SampleType::I16,
            affine: Some(Affine { origin, col_step: [900.0, 0.0], row_step: [0.0, -900.0] }),
            crs: Some(Crs::from_epsg(32632).unwrap()),
            nodata: Some(0.0),
            scale: 0.5,
            offset: 10.0,
            vertical_datum: Some("EPSG:5773".to_string()),
            vertical_unit_m: Some(US_FOOT_M),
            accuracy_m: None,
            product: None,
            notes: Vec::new(),
        };
        Box::new(Slope { info })
    }
}

impl HeightSource for Slope {
    fn info(&self) -> &SourceInfo {
        &self.info
    }
    fn set_nodata(&mut self, _: f64) {}
    fn read(&mut self, w: Window) -> Result<Samples> {
        let posts: Vec<i16> = (w.row..w.row + w.rows as u64)
            .flat_map(|r| (w.col..w.col + w.cols as u64).map(move |c| (c * 100 + r) as i16))
            .collect();
        let data = posts.iter().flat_map(|z| z.to_le_bytes()).collect();
        let valid = posts.iter().map(|z| u8::from(*z != 0)).collect();
        Ok(Samples { cols: w.cols, rows: w.rows, data, valid })
    }
}

#[test]
fn heights_are_lifted_post_by_post() {
    let utm = Crs::from_epsg(32632).unwrap();
    let geoid = Arc::new(format::geoid::open_bytes("a.gtx", gtx()).unwrap());
    let origin = [400000.0, 5300000.0];
    let mut lifted =
        Lifted::new(Slope::at(origin), &utm, US_FOOT_M, geoid.clone(), &Lift::ToEllipsoid).unwrap();
    assert_eq!(lifted.info().vertical_datum.as_deref(), Some("ellipsoid"));
    assert_eq!((lifted.info().sample_type, lifted.info().scale), (SampleType::F32, 1.0));
    assert!(lifted.info().notes.last().unwrap().contains(geoid.digest()));
    let whole = lifted.read(Window { col: 0, row: 0, cols: 60, rows: 50 }).unwrap();
    assert!(whole.valid[0] == 0 && SampleType::F32.value(&whole.data).is_nan());
    let exact = way("EPSG:32632", "EPSG:4326");
    for (i, b) in whole.data.chunks_exact(4).enumerate().skip(1) {
        let (c, r) = ((i % 60) as f64, (i / 60) as f64);
        let [lon, lat] = exact.forward([origin[0] + 900.0 * c, origin[1] - 900.0 * r]).unwrap();
        let height = ((c * 100.0 + r) * 0.5 + 10.0) * US_FOOT_M;
        let expected = height + geoid.undulation(lon, lat).unwrap();
        let found = SampleType::F32.value(b);
        // This grid climbs by up to 5.5 m in half a degree: 6 m on the ground are 1 mm.
        assert!((found - expected).abs() < 1e-3, "{i}: {found} {expected}");
    }
    // A window by itself has the same bits.
    let part = lifted.read(Window { col: 13, row: 17, cols: 20, rows: 3 }).unwrap();
    for r in 0..3 {
        let from = 4 * ((17 + r) * 60 + 13);
        assert_eq!(part.data[r * 80..(r + 1) * 80], whole.data[from..from + 80]);
    }
    // Up and down again.
    let egm = VerticalDatum::parse("egm96").unwrap();
    let mut back = Lifted::new(Box::new(lifted), &utm, 1.0, geoid.clone(), &Lift::ToGeoid(egm)).unwrap();
    assert_eq!(back.info().vertical_datum.as_deref(), Some("EPSG:5773"));
    let again = back.read(Window { col: 1, row: 0, cols: 1, rows: 1 }).unwrap();
    assert!((SampleType::F32.value(&again.data) - 60.0 * US_FOOT_M).abs() < 1e-5);
    // Heights that begin elsewhere than the way are not moved.
    let from = |datum: Option<&str>, lift: &Lift| {
        let mut slope = Slope::at(origin);
        slope.info.vertical_datum = datum.map(str::to_string);
        Lifted::new(slope, &utm, 1.0, geoid.clone(), lift)
    };
    let onto = Lift::ToGeoid(VerticalDatum::parse("egm96").unwrap());
    for (datum, lift) in [("ellipsoid", &Lift::ToEllipsoid), ("EPSG:5773", &onto), ("City zero", &onto)] {
        let text = from(Some(datum), lift).err().unwrap().to_string();
        assert!(text.contains(datum) && text.contains("--geoid"), "{text}");
    }
    for (lift, word) in [(&Lift::ToEllipsoid, "over a geoid"), (&onto, "over the ellipsoid")] {
        let unsaid = from(None, lift).unwrap();
        assert!(unsaid.info().notes.iter().any(|n| n.contains(word)), "{:?}", unsaid.info().notes);
    }
    // Beyond the grid: both rectangles are named.
    let beyond = Lifted::new(Slope::at([700000.0, 5300000.0]), &utm, 1.0, geoid, &Lift::ToEllipsoid);
    let text = beyond.err().unwrap().to_string();
    assert!(text.contains("5.0000 to 10.5000") && text.contains("covers the file"), "{text}");
}

#[test]
fn what_heights_count_from_goes_out_with_them() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_string();
    let file = path("h.tif");
    for (i, datum) in ["EPSG:5703", "ellipsoid", "Zürich, old gauge"].into_iter().enumerate() {
        let (first, second) = (path(&format!("a{i}")), path(&format!("b{i}")));
        let spec = format::geotiff::GeoTiffSpec {
            cols: 20,
            rows: 20,
            sample_type: SampleType::I16,
            affine: Some(Affine { origin: [500000.0, 4e6], col_step: [30.0, 0.0], row_step: [0.0, -30.0] }),
            crs: Some(Crs::from_epsg(32610).unwrap()),
            nodata: None,
            scale: 0.3048,
            offset: 0.0,
            vertical_datum: None,
        };
        let data: Vec<u8> = (0..400i16).flat_map(|v| (v % 23).to_le_bytes()).collect();
        let mut writer = format::geotiff::GeoTiffWriter::create(std::path::Path::new(&file), spec).unwrap();
        writer.write_rows(0, &data).unwrap();
        writer.finish().unwrap();
        for (db, said) in [(&first, &["--vertical-datum", datum][..]), (&second, &[])] {
            printed(&["init", db, "--crs", "EPSG:32610"]);
            printed(&[&["ingest", db.as_str(), &file, "--name", "s", "--accuracy", "1"], said].concat());
            printed(&["export", &first, &file, "--survey", "s"]);
        }
        assert_eq!(printed(&["fingerprint", &first]), printed(&["fingerprint", &second]), "{datum}");
        // So do those of the surface.
        printed(&["export", &first, &file, "--error", "0"]);
        let source = format::open(std::path::Path::new(&file)).unwrap();
        assert_eq!(source.info().vertical_datum.as_deref(), Some(datum));
        assert_eq!(source.info().vertical_unit_m, Some(1.0));
        assert_eq!(source.info().crs.as_ref().map(|c| c.code.as_str()), Some("EPSG:32610"));
    }
}
