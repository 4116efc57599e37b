//! Points, lines and rasters from a server are those of the database, bit for bit.

use super::hills::{DOME, hills};
use super::support::{connect, serve};
use std::time::Duration;
use terraquilt::analysis::{Terrain, profile};
use terraquilt::client::{Connection, heights};
use terraquilt::db::query::{Area, Query, Tolerance};
use terraquilt::db::{Db, Snapshot};
use terraquilt::height::surface::{Blend, Evaluation, How, Seams};
use terraquilt::server::{Settings, start};
use terraquilt::wire::v1;
use tokio_stream::StreamExt;

fn header(error_m: f64) -> v1::HeightsHeader {
    let kind = Some(v1::tolerance::Kind::ErrorM(error_m));
    v1::HeightsHeader { tolerance: Some(v1::Tolerance { kind }), ..Default::default() }
}

const BENT: How = How { blend: Blend::Exact, seams: Seams::All };

/// Points on and beside the crater, in no order that helps.
fn scattered(n: u64, seed: u64) -> Vec<[f64; 2]> {
    let mut r = seed | 1;
    let mut unit = || {
        r ^= r << 13;
        r ^= r >> 7;
        r ^= r << 17;
        (r >> 11) as f64 / (1u64 << 53) as f64
    };
    (0..n).map(|_| [559_000.0 + unit() * 7_000.0, 5_113_000.0 + unit() * 6_000.0]).collect()
}

/// Equal in every bit.
fn same(a: &[Option<Evaluation>], b: &[Option<Evaluation>]) {
    assert_eq!(a.len(), b.len());
    let bits = |e: &Evaluation| {
        let numbers =
            [e.z, e.gradient[0], e.gradient[1], e.error_m, e.accuracy_m, e.correction_m].map(f64::to_bits);
        (numbers, e.certified, e.contradiction)
    };
    for (k, (a, b)) in a.iter().zip(b).enumerate() {
        assert_eq!(a.as_ref().map(bits), b.as_ref().map(bits), "point {k}: {a:?} and {b:?}");
    }
}

fn offline(s: &Snapshot, points: &[[f64; 2]], error: f64, how: How) -> Vec<Option<Evaluation>> {
    s.heights(points, &Tolerance::Constant(error), how).unwrap()
}

async fn refused(connection: &Connection, header: v1::HeightsHeader, points: &[[f64; 2]]) -> String {
    heights::points(connection, header, points).await.unwrap_err().to_string()
}

#[tokio::test(flavor = "multi_thread")]
async fn heights_are_those_of_the_version_they_name() {
    let folder = tempfile::tempdir().unwrap();
    let db = hills(folder.path());
    let server = serve(&db).await;
    let connection = connect(&server).await;
    let points = scattered(6000, 1);
    for (at, version) in [(0, 3), (1, 1), (2, 2)] {
        let s = db.snapshot(Some(version)).unwrap();
        let asked = v1::HeightsHeader { at, ..header(0.5) };
        let (named, found) = heights::points(&connection, asked.clone(), &points).await.unwrap();
        assert_eq!(named, version);
        same(&found, &offline(&s, &points, 0.5, Blend::Exact.into()));
        assert!(found.iter().any(Option::is_none) && found.iter().any(Option::is_some));

        let bent = v1::HeightsHeader { seams: v1::Seams::All as i32, gradients: true, ..asked };
        let found = heights::asked(&connection, bent, &points[..2000]).await.unwrap();
        same(&found.heights, &s.slopes(&points[..2000], &Tolerance::Constant(0.5), BENT).unwrap());
    }
    // One message in one answer, float32.
    let request = v1::PointsRequest {
        header: Some(v1::HeightsHeader { single: true, ..header(2.0) }),
        points: heights::packed(&points[..95]).into(),
    };
    let mut stream = connection.heights().ask(request).await.unwrap().into_inner();
    let reply = stream.next().await.unwrap().unwrap();
    assert_eq!((reply.count, reply.z.len()), (95, 95 * 4));
    let exact = offline(&db.snapshot(None).unwrap(), &points[..95], 2.0, Blend::Exact.into());
    for (a, b) in heights::unpacked(&connection, &reply).unwrap().iter().zip(&exact) {
        assert_eq!(a.as_ref().map(|e| e.z), b.as_ref().map(|e| f64::from(e.z as f32)));
    }
    assert!(stream.next().await.is_none());
    server.stop().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn many_callers_at_once_get_what_one_gets() {
    let folder = tempfile::tempdir().unwrap();
    let db = hills(folder.path());
    let server = serve(&db).await;
    let s = db.snapshot(None).unwrap();
    let callers = (0..8).map(|k| {
        let (server, points) = (server.address.to_string(), scattered(5000 + k, k + 7));
        let exact = offline(&s, &points, k as f64 / 2.0, BENT);
        tokio::spawn(async move {
            let address = terraquilt::client::Address { server, ..Default::default() };
            let connection = Connection::open(&address).await.unwrap();
            let asked = v1::HeightsHeader { seams: v1::Seams::All as i32, ..header(k as f64 / 2.0) };
            let (version, found) = heights::points(&connection, asked, &points).await.unwrap();
            assert_eq!(version, 3);
            same(&found, &exact);
        })
    });
    for caller in callers.collect::<Vec<_>>() {
        caller.await.unwrap();
    }
    server.stop().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn who_made_a_height() {
    let folder = tempfile::tempdir().unwrap();
    let db = hills(folder.path());
    let server = serve(&db).await;
    let connection = connect(&server).await;
    let s = db.snapshot(None).unwrap();
    let points = scattered(600, 3);
    let asked = v1::HeightsHeader { explain: true, ..header(1.0) };
    let found = heights::asked(&connection, asked, &points).await.unwrap();
    assert_eq!((found.makers.len(), found.heights.len()), (600, 600));
    let mut shares = 0;
    for (k, p) in points.iter().enumerate() {
        let exact = s.explain(*p, &Tolerance::Constant(1.0), Blend::Exact).unwrap();
        assert_eq!(found.heights[k].is_some(), !exact.is_empty());
        assert_eq!(found.makers[k].len(), exact.len());
        for (c, (r, w)) in found.makers[k].iter().zip(&exact) {
            assert_eq!(
                (c.survey, c.weight.to_bits(), c.level),
                (r.survey.0, w.to_bits(), r.place.level.into())
            );
            assert_eq!((&c.patch[..], c.error_m, c.floor), (&r.id.0[..], r.bot, r.floor));
            let name = &s.survey_by_number(r.survey).unwrap().name;
            assert!(found.surveys.iter().any(|n| n.survey == c.survey && n.name == *name));
            shares += 1;
        }
    }
    assert!(shares > 100, "{shares}");
    server.stop().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn lines_are_those_of_the_command_line() {
    let folder = tempfile::tempdir().unwrap();
    let db = hills(folder.path());
    let server = serve(&db).await;
    let connection = connect(&server).await;
    let s = db.snapshot(None).unwrap();
    let line = [
        [560_000.0, 5_114_000.0],
        [562_700.0, 5_116_000.0],
        [562_700.0, 5_116_000.0],
        [563_000.0, 5_117_000.0],
    ];
    let query =
        Query { area: Area::Everything, tolerance: Tolerance::Constant(0.5), how: Blend::Exact.into() };
    let terrain = Terrain::new(&s, &query).unwrap();
    for step in [0.0, 7.5] {
        let found = heights::profile(&connection, header(0.5), &line, step).await.unwrap();
        let exact = profile(&terrain, &line, (step > 0.0).then_some(step)).unwrap();
        assert_eq!(found.line.len(), exact.len());
        for ((p, e), x) in found.line.iter().zip(&found.heights).zip(&exact) {
            assert_eq!((p.at, p.distance_m, p.vertex), ([x.x, x.y], x.distance_m, x.vertex));
            assert_eq!(e.as_ref().map(|e| e.z.to_bits()), x.z.map(f64::to_bits));
            assert_eq!(e.as_ref().filter(|e| e.certified).map(|e| e.error_m), x.error_m);
        }
    }
    let refused = heights::profile(&connection, header(0.5), &line[..1], 0.0).await.unwrap_err().to_string();
    assert!(refused.contains("two at least"), "{refused}");
    let refused = heights::profile(&connection, header(0.5), &line, -1.0).await.unwrap_err().to_string();
    assert!(refused.contains("-1 m"), "{refused}");
    let refused = heights::profile(&connection, header(0.5), &line, 1e-9).await.unwrap_err().to_string();
    assert!(refused.contains("points of a line"), "{refused}");
    let odd = [[0.0, 0.0], [f64::INFINITY, 0.0]];
    let refused = heights::profile(&connection, header(0.5), &odd, 0.0).await.unwrap_err().to_string();
    assert!(refused.contains("vertex 1 of the line"), "{refused}");
    server.stop().await.unwrap();
}

fn raster(cols: u32, rows: u32) -> v1::RasterRequest {
    v1::RasterRequest { header: Some(header(1.0)), x: DOME[0], y: DOME[3], dx: 5.0, dy: -5.0, cols, rows }
}

#[tokio::test(flavor = "multi_thread")]
async fn rasters_come_row_by_row() {
    let folder = tempfile::tempdir().unwrap();
    let db = hills(folder.path());
    let server = serve(&db).await;
    let connection = connect(&server).await;
    let mut found = Vec::new();
    let version = heights::raster(&connection, raster(261, 270), |first, some| {
        assert_eq!(first, found.len() as u64);
        found.extend(some);
        Ok(())
    });
    assert_eq!(version.await.unwrap(), 3);
    let posts: Vec<[f64; 2]> = (0..270)
        .flat_map(|r| (0..261).map(move |c| [DOME[0] + f64::from(c) * 5.0, DOME[3] + f64::from(r) * -5.0]))
        .collect();
    same(&found, &offline(&db.snapshot(None).unwrap(), &posts, 1.0, Blend::Exact.into()));
    server.stop().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn bad_questions_are_refused_with_a_sentence() {
    let folder = tempfile::tempdir().unwrap();
    let db = hills(folder.path());
    let server = start(Settings {
        listen: ([127, 0, 0, 1], 0).into(),
        points_max: 200_000,
        ..Settings::new(db.path())
    })
    .await
    .unwrap();
    let connection = connect(&server).await;
    let mut points = scattered(70_000, 5);
    points[65_600][1] = f64::NAN;
    let said = refused(&connection, header(1.0), &points).await;
    assert!(said.contains("point 65600 of the call") && said.contains("NaN"), "{said}");
    let said = refused(&connection, v1::HeightsHeader::default(), &points[..5]).await;
    assert!(said.contains("tolerance: is missing"), "{said}");
    let said = refused(&connection, header(-1.0), &points[..5]).await;
    assert!(said.contains("-1"), "{said}");
    let said = refused(&connection, v1::HeightsHeader { blend: 7, ..header(1.0) }, &points[..5]).await;
    assert!(said.contains("blend: 7"), "{said}");
    let said = refused(&connection, v1::HeightsHeader { at: 99, ..header(1.0) }, &points[..5]).await;
    assert!(said.contains("99"), "{said}");
    let said = refused(&connection, header(1.0), &vec![[0.0; 2]; 200_001]).await;
    assert!(said.contains("points of the call: 200001 wanted, at most 200000"), "{said}");

    let none = |_: u64, _: Vec<Option<Evaluation>>| Ok(());
    for (odd, sentence) in [
        (raster(u32::MAX, u32::MAX), "18446744065119617025 wanted, at most 200000 allowed"),
        (raster(0, 5), "0 x 5 posts"),
        (v1::RasterRequest { dx: f64::NAN, ..raster(5, 5) }, "dx NaN"),
        (v1::RasterRequest { dy: 0.0, ..raster(5, 5) }, "on top of each other"),
        (v1::RasterRequest { dx: 1e308, ..raster(5, 5) }, "finite"),
        (v1::RasterRequest { header: None, ..raster(5, 5) }, "header: is missing"),
    ] {
        let said = heights::raster(&connection, odd, none).await.unwrap_err().to_string();
        assert!(said.contains(sentence), "{said}");
    }

    let ask = |header: Option<v1::HeightsHeader>, points: Vec<u8>| {
        let mut client = connection.heights();
        async move { client.ask(v1::PointsRequest { header, points: points.into() }).await }
    };
    let first = |r: Result<tonic::Response<tonic::Streaming<v1::HeightsReply>>, tonic::Status>| async {
        match r {
            Err(s) => s,
            Ok(mut r) => r.get_mut().message().await.unwrap_err(),
        }
    };
    let said = first(ask(Some(header(1.0)), vec![0; 17]).await).await;
    assert!(said.message().contains("17 bytes are no pairs"), "{said}");
    let said = first(ask(Some(header(1.0)), vec![0; 65_537 * 16]).await).await;
    assert_eq!(said.code(), tonic::Code::ResourceExhausted);
    assert!(said.message().contains("65537 wanted, at most 65536"), "{said}");
    // A region without data, and none at all: no error.
    let found = heights::points(&connection, header(1.0), &[[0.0, 0.0], [1e300, -1e300]]).await.unwrap();
    assert_eq!(found.1, [None, None]);
    assert_eq!(heights::points(&connection, header(1.0), &[]).await.unwrap().1, []);
    server.stop().await.unwrap();
}

/// A client that does not read holds nobody up, and what it asked is not computed ahead.
#[tokio::test(flavor = "multi_thread")]
async fn a_client_that_does_not_read_waits_alone() {
    let folder = tempfile::tempdir().unwrap();
    let db: Db = hills(folder.path());
    let server = serve(&db).await;
    let connection = connect(&server).await;
    let lazy = connect(&server).await;
    let mut held = lazy.heights().raster(raster(20_000, 20_000)).await.unwrap().into_inner();
    assert!(held.message().await.unwrap().is_some());
    let points = scattered(95, 9);
    for _ in 0..20 {
        let found =
            tokio::time::timeout(Duration::from_secs(20), heights::points(&connection, header(0.0), &points));
        assert_eq!(found.await.unwrap().unwrap().1.len(), 95);
    }
    drop(held);
    server.stop().await.unwrap();
}
