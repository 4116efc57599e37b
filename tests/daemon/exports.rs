//! Files from a server are those of the command line, byte for byte.

use super::by_hand;
use super::hills::{DOME, file as delivered, hills};
use super::support::{connect, serve};
use std::path::Path;
use std::time::Duration;
use terraquilt::client::{Connection, export};
use terraquilt::wire::v1;
use terraquilt::wire::v1::file_request::Format;

fn region(b: [f64; 4]) -> Option<v1::Region> {
    let b = v1::Box { xmin: b[0], ymin: b[1], xmax: b[2], ymax: b[3] };
    Some(v1::Region { kind: Some(v1::region::Kind::Box(b)) })
}

fn request(format: Format, error_m: f64) -> v1::FileRequest {
    let kind = Some(v1::tolerance::Kind::ErrorM(error_m));
    let tolerance = Some(v1::Tolerance { kind });
    v1::FileRequest { format: format as i32, tolerance, region: region(DOME), ..Default::default() }
}

/// What the command line writes, and prints, of the database.
fn written(folder: &Path, ending: &str, args: &[&str]) -> (Vec<u8>, serde_json::Value) {
    let db = folder.join("db");
    let (bytes, mut json, _) = by_hand::export(folder, ending, &[db.to_str().unwrap()], args);
    json.as_object_mut().unwrap().remove("seconds");
    (bytes, json)
}

async fn asked(c: &Connection, r: v1::FileRequest) -> (Vec<u8>, serde_json::Value, v1::FileChunk) {
    let mut bytes = Vec::new();
    let end = export::file(c, r, &mut bytes).await.unwrap();
    let mut json: serde_json::Value = serde_json::from_str(&end.json).unwrap();
    json.as_object_mut().unwrap().remove("seconds");
    assert_eq!(end.bytes, bytes.len() as u64);
    (bytes, json, end)
}

async fn refused(c: &Connection, r: v1::FileRequest) -> String {
    export::file(c, r, &mut Vec::new()).await.unwrap_err().to_string()
}

#[tokio::test(flavor = "multi_thread")]
async fn files_are_those_of_the_command_line() {
    let folder = tempfile::tempdir().unwrap();
    let server = serve(&hills(folder.path())).await;
    let c = connect(&server).await;
    let dome = DOME.map(|v| v.to_string()).join(",");
    let degrees = "-122.195,46.195,-122.185,46.205";
    let in_degrees = |r: v1::FileRequest| v1::FileRequest {
        coords: "EPSG:4326".into(),
        region: region([-122.195, 46.195, -122.185, 46.205]),
        ..r
    };
    let glb = v1::FileRequest {
        region: region([562_400.0, 5_115_700.0, 562_800.0, 5_116_100.0]),
        ..request(Format::Glb, 8.0)
    };
    let small = "562400,5115700,562800,5116100";
    let tif = request(Format::Geotiff, 0.0);
    let png = request(Format::Png, 2.0);
    let survey =
        v1::FileRequest { format: Format::Geotiff as i32, survey: "2004-10-04".into(), ..Default::default() };
    let cases: Vec<(&str, Vec<&str>, v1::FileRequest)> = vec![
        ("glb", vec!["--error", "8", "--bbox", small], glb.clone()),
        (
            "glb",
            vec!["--error", "8", "--bbox", small, "--quantize", "--seams", "off"],
            v1::FileRequest { quantize: true, seams: v1::Seams::Off as i32, ..glb },
        ),
        ("tif", vec!["--error", "0", "--bbox", &dome, "--at", "1"], v1::FileRequest { at: 1, ..tif.clone() }),
        (
            "tif",
            vec!["--error", "0", "--bbox", &dome, "--step", "7,9"],
            v1::FileRequest { step_x: 7.0, step_y: 9.0, ..tif.clone() },
        ),
        ("tif", vec!["--error", "0", "--bbox", degrees, "--coords", "EPSG:4326"], in_degrees(tif)),
        (
            "png",
            vec!["--error", "2", "--bbox", &dome, "--step", "10"],
            v1::FileRequest { step_x: 10.0, ..png },
        ),
        ("tif", vec!["--survey", "2004-10-04"], survey.clone()),
    ];
    for (ending, args, r) in cases {
        let at = r.at;
        let (bytes, json, end) = asked(&c, r).await;
        let (by_hand, said) = written(folder.path(), ending, &args);
        assert_eq!(end.version, if at == 0 { 3 } else { at });
        assert_eq!(json, said, "{args:?}");
        assert!(bytes == by_hand, "{args:?}: {} and {} bytes differ", bytes.len(), by_hand.len());
    }
    // Bit for bit as they were delivered.
    let (bytes, _, _) = asked(&c, survey).await;
    let copy = folder.path().join("copy.tif");
    std::fs::write(&copy, bytes).unwrap();
    let samples = |path: &Path| {
        let mut source = terraquilt::format::open(path).unwrap();
        let info = source.info().clone();
        let (cols, rows) = (info.cols as usize, info.rows as usize);
        let window = terraquilt::height::source::Window { col: 0, row: 0, cols, rows };
        (info.affine, source.read(window).unwrap().data)
    };
    assert!(samples(&copy) == samples(&delivered("survey_2004-10-04_native.tif")));
    server.stop().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn bad_requests_are_refused_with_a_sentence() {
    let folder = tempfile::tempdir().unwrap();
    let server = serve(&hills(folder.path())).await;
    let c = connect(&server).await;
    let tif = request(Format::Geotiff, 1.0);
    let png = request(Format::Png, 1.0);
    let survey = v1::FileRequest { survey: "2005".into(), ..tif.clone() };
    for (r, sentence) in [
        (v1::FileRequest { format: 9, ..tif.clone() }, "format: 9 is none"),
        (v1::FileRequest { format: 0, ..tif.clone() }, "format: is missing"),
        (v1::FileRequest { tolerance: None, ..tif.clone() }, "tolerance: is missing"),
        (v1::FileRequest { quantize: true, ..tif.clone() }, "--quantize: is for .glb"),
        (v1::FileRequest { step_x: -1.0, ..tif.clone() }, "must be positive"),
        (v1::FileRequest { step_x: 1e-6, ..tif.clone() }, "pixels"),
        (v1::FileRequest { step_x: 0.1, ..png.clone() }, "at most 64000000 allowed"),
        (v1::FileRequest { region: region([0.0, 0.0, 9.0, 9.0]), ..png.clone() }, "the surveys lie in"),
        (v1::FileRequest { coords: "EPSG:1".into(), ..png }, "EPSG:1"),
        (v1::FileRequest { at: 9, ..tif.clone() }, "9"),
        (v1::FileRequest { tile: "a.tif".into(), ..tif }, "name it in `survey`"),
        (v1::FileRequest { format: Format::Png as i32, ..survey.clone() }, "written as GeoTIFF"),
        (v1::FileRequest { tile: "nothing.tif".into(), ..survey.clone() }, "tile 'nothing.tif'"),
        (v1::FileRequest { survey: "1999".into(), ..survey }, "1999"),
    ] {
        let said = refused(&c, r).await;
        assert!(said.contains(sentence), "{said}");
    }
    if !cfg!(feature = "meshopt") {
        let said = refused(&c, v1::FileRequest { meshopt: true, ..request(Format::Glb, 8.0) }).await;
        assert!(said.contains("meshopt"), "{said}");
    }
    server.stop().await.unwrap();
}

/// Clients that go or do not read leave no file, and give their place to others.
#[tokio::test(flavor = "multi_thread")]
async fn who_goes_is_forgotten() {
    let folder = tempfile::tempdir().unwrap();
    let server = serve(&hills(folder.path())).await;
    let c = connect(&server).await;
    let small = v1::FileRequest { step_x: 20.0, ..request(Format::Geotiff, 2.0) };
    let wide = v1::FileRequest { region: None, step_x: 0.5, ..request(Format::Geotiff, 0.0) };
    // Sixteen may be made, wait or be read at once; who does not read keeps a place.
    let mut held = Vec::new();
    for _ in 0..16 {
        held.push(connect(&server).await.export().file(wide.clone()).await.unwrap().into_inner());
    }
    let said = refused(&c, small.clone()).await;
    assert!(said.contains("16 files are being made"), "{said}");
    drop(held);
    // The work of sixteen stops soon: a small file is made long before their hundreds of millions of posts could be.
    let done = async {
        loop {
            let mut bytes = Vec::new();
            match export::file(&c, small.clone(), &mut bytes).await {
                Ok(end) => break end.bytes,
                Err(e) => assert!(e.to_string().contains("16 files"), "{e}"),
            }
            tokio::time::sleep(Duration::from_millis(50)).await;
        }
    };
    assert!(tokio::time::timeout(Duration::from_secs(60), done).await.unwrap() > 1000);
    // Other tests of this process have files of their own for a while.
    let closed = async {
        while open_nameless() > 0 {
            tokio::time::sleep(Duration::from_millis(50)).await;
        }
    };
    tokio::time::timeout(Duration::from_secs(60), closed).await.expect("no file stays open");
    server.stop().await.unwrap();
}

/// Files without a name that this process holds open.
fn open_nameless() -> usize {
    let Ok(open) = std::fs::read_dir("/proc/self/fd") else { return 0 };
    let scratch = std::env::temp_dir();
    open.flatten()
        .filter_map(|e| std::fs::read_link(e.path()).ok())
        .filter(|p| p.starts_with(&scratch) && p.to_string_lossy().ends_with("(deleted)"))
        .filter(|p| p.parent() == Some(&scratch))
        .count()
}

#[tokio::test(flavor = "multi_thread")]
async fn several_at_once_and_a_slow_reader() {
    let folder = tempfile::tempdir().unwrap();
    let server = serve(&hills(folder.path())).await;
    let c = connect(&server).await;
    let r = v1::FileRequest { step_x: 5.0, ..request(Format::Geotiff, 1.0) };
    let (alone, _, _) = asked(&c, r.clone()).await;
    let slow = connect(&server).await;
    let large = v1::FileRequest { step_x: 1.5, ..r.clone() };
    let mut stream = slow.export().file(large).await.unwrap().into_inner();
    let first = stream.message().await.unwrap().unwrap();
    assert_eq!(first.data.len(), 256 << 10);
    let callers: Vec<_> = (0..8)
        .map(|_| {
            let (c, r) = (c.clone(), r.clone());
            tokio::spawn(async move { asked(&c, r).await.0 })
        })
        .collect();
    for caller in callers {
        assert!(caller.await.unwrap() == alone);
    }
    let mut came = first.data.len() as u64;
    while let Some(chunk) = stream.message().await.unwrap() {
        came += chunk.data.len() as u64;
        if !chunk.json.is_empty() {
            assert_eq!(chunk.bytes, came);
        }
    }
    server.stop().await.unwrap();
}
