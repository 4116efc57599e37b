//! Fractal tiles of the surface from a server: the bytes of the command line, as exact as they say; who goes is forgotten.

use super::by_hand;
use super::hills::{DOME, hills};
use super::support::{connect, serve};
use std::time::{Duration, Instant};
use terraquilt::client::{Connection, export, heights};
use terraquilt::wire::v1;
use terraquilt::wire::v1::file_request::{Format, Search};
use terraquilt_codecs::fractal::Tile;

fn region(b: [f64; 4]) -> Option<v1::Region> {
    let b = v1::Box { xmin: b[0], ymin: b[1], xmax: b[2], ymax: b[3] };
    Some(v1::Region { kind: Some(v1::region::Kind::Box(b)) })
}

fn tolerance(error_m: f64) -> Option<v1::Tolerance> {
    Some(v1::Tolerance { kind: Some(v1::tolerance::Kind::ErrorM(error_m)) })
}

fn request(error_m: f64, step_x: f64) -> v1::FileRequest {
    let format = Format::Ifs as i32;
    v1::FileRequest {
        format,
        tolerance: tolerance(error_m),
        region: region(DOME),
        step_x,
        ..Default::default()
    }
}

async fn asked(c: &Connection, r: v1::FileRequest) -> (Vec<u8>, serde_json::Value, v1::FileChunk) {
    let mut bytes = Vec::new();
    let end = export::file(c, r, &mut bytes).await.unwrap();
    assert_eq!(end.bytes, bytes.len() as u64);
    (bytes, serde_json::from_str(&end.json).unwrap(), end)
}

async fn refused(c: &Connection, r: v1::FileRequest) -> String {
    export::file(c, r, &mut Vec::new()).await.unwrap_err().to_string()
}

#[tokio::test(flavor = "multi_thread")]
async fn tiles_are_those_of_the_command_line() {
    let folder = tempfile::tempdir().unwrap();
    let server = serve(&hills(folder.path())).await;
    let c = connect(&server).await;
    let (db, address) = (folder.path().join("db"), server.address.to_string());
    let dome = DOME.map(|v| v.to_string()).join(",");
    let r = request(4.0, 10.0);
    let cases = [
        ("--error 4 --step 10", r.clone()),
        ("--error 4 --step 10 --at 1", v1::FileRequest { at: 1, ..r.clone() }),
        (
            "--error 6 --step 7,9 --bound 1 --unit 0.05",
            v1::FileRequest { step_y: 9.0, bound_m: Some(1.0), unit_m: 0.05, ..request(6.0, 7.0) },
        ),
        (
            "--error 4 --step 10 --maps 700 --search exact",
            v1::FileRequest { maps: Some(700), search: Search::Exact as i32, ..r.clone() },
        ),
        (
            "--error 0 --step 20 --search classes --seams all",
            v1::FileRequest {
                search: Search::Classes as i32,
                seams: v1::Seams::All as i32,
                ..request(0.0, 20.0)
            },
        ),
    ];
    for (args, r) in cases {
        let args: Vec<&str> = args.split(' ').chain(["--bbox", &dome]).collect();
        let (version, maps) = (if r.at == 0 { 3 } else { r.at }, r.maps);
        let (bytes, json, end) = asked(&c, r).await;
        let (here, said, notes) = by_hand::export(folder.path(), "ifs", &[db.to_str().unwrap()], &args);
        let (there, also, there_notes) =
            by_hand::export(folder.path(), "ifs", &["--server", &address], &args);
        assert!(bytes == here && bytes == there, "{args:?}: {} and {} bytes", bytes.len(), here.len());
        assert_eq!((&json, &json), (&said, &also), "{args:?}");
        assert_eq!((end.version, notes), (version, there_notes));
        assert!(end.notes.iter().any(|n| n.contains("as measured")) == maps.is_some(), "{:?}", end.notes);
        let tile = Tile::read(&bytes).unwrap();
        assert!(tile.complete && maps.is_none_or(|n| tile.maps() as u64 <= n));
        assert_eq!(tile.header.place.source, format!("terraquilt, version {version}"));
    }
    server.stop().await.unwrap();
}

/// Against what the server answers at the posts of the tile at error 0, of a version with one survey.
#[tokio::test(flavor = "multi_thread")]
async fn no_post_is_farther_from_the_heights_than_stated() {
    let folder = tempfile::tempdir().unwrap();
    let server = serve(&hills(folder.path())).await;
    let c = connect(&server).await;
    for r in [
        request(3.0, 10.0),
        v1::FileRequest { bound_m: Some(0.5), ..request(3.0, 12.0) },
        v1::FileRequest { maps: Some(500), ..request(3.0, 10.0) },
    ] {
        let (bytes, json, _) = asked(&c, v1::FileRequest { at: 1, ..r.clone() }).await;
        let tile = Tile::read(&bytes).unwrap();
        let (place, [cols, rows, _]) = (&tile.header.place, tile.header.size);
        let t = place.transform;
        let at = |c: usize, r: usize| [t[0] + c as f64 * t[1], t[3] + r as f64 * t[5]];
        let posts: Vec<[f64; 2]> =
            (0..rows).flat_map(|r| (0..cols).map(move |c| (c, r))).map(|(c, r)| at(c, r)).collect();
        let header = v1::HeightsHeader { tolerance: tolerance(0.0), at: 1, ..Default::default() };
        let (_, truth) = heights::points(&c, header, &posts).await.unwrap();
        let units: Vec<f64> = match r.maps {
            None => tile.heights().unwrap().z.iter().map(|z| f64::from(*z)).collect(),
            Some(_) => tile.plane(0).unwrap().values,
        };
        let (mut worst, mut seen) = (0.0_f64, 0);
        for (z, truth) in units.iter().zip(&truth) {
            if let Some(truth) = truth {
                worst = worst.max((place.base + place.unit * z - truth.z).abs());
                seen += 1;
            }
        }
        let stated = json["error_m"].as_f64().unwrap();
        println!("{worst:.3} m at {seen} posts, {stated:.3} m stated");
        assert!(seen > 5000 && worst <= stated, "{worst} m, {json}");
        assert!(r.maps.is_some() || stated <= 3.0, "{json}");
    }
    server.stop().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn bad_requests_are_refused_with_a_sentence() {
    let folder = tempfile::tempdir().unwrap();
    let server = serve(&hills(folder.path())).await;
    let c = connect(&server).await;
    let r = request(4.0, 10.0);
    let tif = v1::FileRequest { format: Format::Geotiff as i32, ..r.clone() };
    for (r, sentence) in [
        (v1::FileRequest { tolerance: None, ..r.clone() }, "tolerance: is missing"),
        (v1::FileRequest { search: 9, ..r.clone() }, "search: 9 is none"),
        (v1::FileRequest { maps: Some(900), bound_m: Some(1.0), ..r.clone() }, "leave the other out"),
        (v1::FileRequest { maps: Some(0), ..r.clone() }, "ask for at least so many"),
        (v1::FileRequest { maps: Some(900), unit_m: 9.0, ..r.clone() }, "9 m round by 4.5 m"),
        (v1::FileRequest { bound_m: Some(f64::NAN), ..r.clone() }, "NaN is no bound"),
        (v1::FileRequest { bound_m: Some(4.0), ..r.clone() }, "leave nothing of 4 m"),
        (v1::FileRequest { unit_m: -1.0, ..r.clone() }, "unit: -1 m"),
        (v1::FileRequest { unit_m: 1e-6, ..request(0.0, 10.0) }, "take a larger unit"),
        (v1::FileRequest { step_x: 0.5, ..r.clone() }, "at most 4198401 allowed"),
        (v1::FileRequest { step_x: 1e-300, ..r.clone() }, "a larger step"),
        (
            v1::FileRequest { step_x: 2.0, search: Search::Exact as i32, ..r.clone() },
            "at most 263169 allowed",
        ),
        (v1::FileRequest { quantize: true, ..r.clone() }, "--quantize: is for .glb"),
        (v1::FileRequest { region: region([0.0, 0.0, 9.0, 9.0]), ..r.clone() }, "the surveys lie in"),
        (v1::FileRequest { survey: "2004-10-04".into(), ..r.clone() }, "written as GeoTIFF"),
        (v1::FileRequest { bound_m: Some(1.0), ..tif.clone() }, "bound: is for fractal tiles"),
        (v1::FileRequest { maps: Some(9), ..tif.clone() }, "maps: is for fractal tiles"),
        (v1::FileRequest { unit_m: 1.0, ..tif.clone() }, "unit: is for fractal tiles"),
        (v1::FileRequest { search: Search::Near as i32, ..tif }, "search: is for fractal tiles"),
    ] {
        let said = refused(&c, r).await;
        assert!(said.contains(sentence), "{sentence}: {said}");
    }
    server.stop().await.unwrap();
}

/// The work of a client that goes stops soon, so that others have their turn.
#[tokio::test(flavor = "multi_thread")]
async fn who_goes_is_forgotten() {
    let folder = tempfile::tempdir().unwrap();
    let server = serve(&hills(folder.path())).await;
    let c = connect(&server).await;
    // Nearly as many posts as may be searched exactly, 16 times: minutes of work.
    let long = v1::FileRequest { search: Search::Exact as i32, ..request(0.0, 2.6) };
    let mut held = Vec::new();
    for _ in 0..16 {
        held.push(connect(&server).await.export().file(long.clone()).await.unwrap().into_inner());
    }
    tokio::time::sleep(Duration::from_secs(2)).await;
    let begun = Instant::now();
    drop(held);
    let done = async {
        loop {
            let mut bytes = Vec::new();
            match export::file(&c, request(4.0, 40.0), &mut bytes).await {
                Ok(end) => break end.bytes,
                Err(e) => assert!(e.to_string().contains("16 files"), "{e}"),
            }
            tokio::time::sleep(Duration::from_millis(50)).await;
        }
    };
    assert!(tokio::time::timeout(Duration::from_secs(60), done).await.unwrap() > 300);
    println!("a small tile {:.1} s after sixteen went", begun.elapsed().as_secs_f64());
    server.stop().await.unwrap();
}
