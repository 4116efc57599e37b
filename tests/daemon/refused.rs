//! What of an upload is refused: damaged blocks, headers that make no sense, streams without an end. The server is unharmed.

use super::calls::{Call, folders, listed, send, serve_with};
use super::support::{connect, empty};
use super::survey::hills;
use std::time::Duration;
use terraquilt::server::Settings;
use terraquilt::wire::v1;
use terraquilt::wire::v1::upload_request::Kind;
use tonic::Code;

#[tokio::test(flavor = "multi_thread")]
async fn bad_blocks_are_refused_and_the_rest_is_kept() {
    let folder = tempfile::tempdir().unwrap();
    let db = empty(folder.path());
    let server = serve_with(&db, |_| {}).await;
    let c = connect(&server).await;
    let survey = hills("hills", 600, 0.0, 1);
    let good = || survey.block(0, 0, 10);
    let sealed = |mut b: v1::SampleBlock| {
        b.crc32 = terraquilt::wire::crc32(&b.samples);
        b
    };
    let zlib = |bytes: usize| {
        use std::io::Write;
        let mut z = flate2::write::ZlibEncoder::new(Vec::new(), flate2::Compression::best());
        z.write_all(&vec![0; bytes]).unwrap();
        z.finish().unwrap()
    };
    let cases: Vec<(v1::SampleBlock, &str)> = vec![
        (v1::SampleBlock { crc32: 5, ..good() }, "checksum"),
        (v1::SampleBlock { grid: 1, ..good() }, "header describes 1"),
        (v1::SampleBlock { row: 595, ..good() }, "rows 0 to 599"),
        (v1::SampleBlock { row: u64::MAX, ..good() }, "rows 0 to 599"),
        (v1::SampleBlock { rows: 0, ..good() }, "one row at least"),
        (v1::SampleBlock { rows: u32::MAX, ..good() }, "rows 0 to 599"),
        (v1::SampleBlock { rows: 9, ..good() }, "21600 are needed"),
        (v1::SampleBlock { packing: 7, ..good() }, "packing 7"),
        (v1::SampleBlock { packing: 1, ..good() }, "zlib"),
        (survey.block(0, 0, 500), "1048576 allowed"),
        // A bomb: 1000 times what the rows have.
        (sealed(v1::SampleBlock { packing: 1, samples: zlib(24_000_000).into(), ..good() }), "or more bytes"),
        (sealed(v1::SampleBlock { packing: 1, samples: zlib(23_999).into(), ..good() }), "23999 bytes"),
    ];
    for (received, (block, told)) in (0..).zip(cases) {
        let (mut call, first) = Call::begin(&c, &survey.header).await.unwrap();
        assert_eq!(first.received.iter().map(|s| s.rows).sum::<u64>(), received);
        call.block(survey.block(0, 20 + received, 1)).await;
        call.block(block).await;
        let e = call.refused().await;
        assert!(e.message().contains(told), "{told}: {e}");
        assert!(matches!(e.code(), Code::InvalidArgument | Code::ResourceExhausted), "{told}: {e}");
        // The stream has ended: the upload is free again at once.
    }
    // Not all rows: says which.
    let (mut call, _) = Call::begin(&c, &survey.header).await.unwrap();
    call.finish().await;
    let e = call.refused().await;
    assert_eq!(e.code(), Code::FailedPrecondition);
    assert!(e.message().contains("12 of 600") && e.message().contains("'hills.grid' rows 0 to 19"), "{e}");
    // A stream that ends without finish, one with a second header, one with an empty message.
    let (mut call, _) = Call::begin(&c, &survey.header).await.unwrap();
    call.header(&survey.header).await;
    assert!(call.refused().await.message().contains("one header"));
    let (call, _) = Call::begin(&c, &survey.header).await.unwrap();
    let Call { send: sender, mut replies } = call;
    drop(sender);
    let e = replies.message().await.unwrap_err();
    assert!(e.code() == Code::FailedPrecondition && e.message().contains("finish"), "{e}");
    let (call, _) = Call::begin(&c, &survey.header).await.unwrap();
    call.send.send(v1::UploadRequest { kind: None }).await.unwrap();
    let Call { mut replies, .. } = call;
    assert_eq!(replies.message().await.unwrap_err().code(), Code::InvalidArgument);
    // No header first.
    let mut call = Call::open(&c).await;
    call.block(good()).await;
    assert!(call.refused().await.message().contains("first message"));
    // It still becomes what it should be.
    assert_eq!(send(&c, &survey).await.unwrap().posts, 360_000);
}

#[tokio::test(flavor = "multi_thread")]
async fn samples_with_another_hash_are_forgotten_and_sent_again() {
    let folder = tempfile::tempdir().unwrap();
    let db = empty(folder.path());
    let server = serve_with(&db, |_| {}).await;
    let c = connect(&server).await;
    let mut survey = hills("hills", 100, 0.0, 1);
    survey.header.grids[0].hash = blake3::hash(&survey.grids[0]).as_bytes().to_vec().into();
    let mut damaged = survey.clone();
    damaged.grids[0][4000] ^= 1;
    let e = send(&c, &damaged).await.unwrap_err().to_string();
    assert!(e.contains("hash of grid 'hills.grid'") && e.contains("send them anew"), "{e}");
    assert_eq!(db.newest().unwrap(), 0);
    let (mut call, first) = Call::begin(&c, &survey.header).await.unwrap();
    assert_eq!(first.received, []);
    call.block(survey.block(0, 0, 100)).await;
    // The hash at the end must be right, too.
    let finish = |hashes: Vec<Vec<u8>>| {
        Kind::Finish(v1::UploadFinish { hashes: hashes.into_iter().map(Into::into).collect() })
    };
    call.kind(finish(vec![vec![7; 32]])).await;
    assert!(call.refused().await.message().contains("hash of grid"));
    let (mut call, _) = Call::begin(&c, &survey.header).await.unwrap();
    call.kind(finish(vec![vec![7; 31]])).await;
    assert!(call.refused().await.message().contains("31 bytes"));
    assert_eq!(send(&c, &survey).await.unwrap().version, 1);
}

#[tokio::test(flavor = "multi_thread")]
async fn bad_headers_are_refused_before_anything_is_kept() {
    let folder = tempfile::tempdir().unwrap();
    let db = empty(folder.path());
    let server = serve_with(&db, |s| s.uploads_bytes_max = 1 << 30).await;
    let c = connect(&server).await;
    let good = hills("hills", 100, 0.0, 1).header;
    type Spoil = fn(&mut v1::UploadHeader);
    let cases: Vec<(Spoil, Code, &str)> = vec![
        (|h| h.operation.clear(), Code::InvalidArgument, "operation"),
        (|h| h.operation = "commit-7".into(), Code::InvalidArgument, "commit-"),
        (|h| h.operation = "x".repeat(201), Code::InvalidArgument, "201 bytes"),
        (|h| h.operation = "a\nb".into(), Code::InvalidArgument, "control"),
        (|h| h.grids.clear(), Code::InvalidArgument, "grids"),
        (|h| h.grids[0].sample_type = 0, Code::InvalidArgument, "sample_type"),
        (|h| h.grids[0].sample_type = 99, Code::InvalidArgument, "99 is none"),
        (|h| h.grids[0].cols = 0, Code::InvalidArgument, "grids[0].cols"),
        (|h| h.grids[0].rows = 3, Code::InvalidArgument, "4 x 4"),
        (|h| h.grids[0].rows = u64::MAX, Code::ResourceExhausted, "18446744073709551615"),
        (|h| h.grids[0].cols = 600_000, Code::ResourceExhausted, "several grids"),
        (|h| h.grids[0].x = f64::NAN, Code::InvalidArgument, "grids[0].x"),
        (|h| h.grids[0].scale = f64::INFINITY, Code::InvalidArgument, "grids[0].scale"),
        (|h| h.grids[0].row_dy = 0.0, Code::InvalidArgument, "span no area"),
        (|h| h.grids[0].name.clear(), Code::InvalidArgument, "name the tile"),
        (|h| h.grids.push(h.grids[0].clone()), Code::InvalidArgument, "hills.grid"),
        (|h| h.grids[0].hash = vec![1; 20].into(), Code::InvalidArgument, "20 bytes"),
        (|h| h.accuracy_m = Some(f64::NAN), Code::InvalidArgument, "accuracy"),
        (|h| h.accuracy_m = Some(-1.0), Code::InvalidArgument, "-1"),
        (|h| h.accuracy_m = None, Code::InvalidArgument, "accurate"),
        (|h| h.date = "tomorrow".into(), Code::InvalidArgument, "tomorrow"),
        (|h| h.date.clear(), Code::InvalidArgument, "policy 'newest'"),
        (|h| h.crs = "EPSG:1".into(), Code::FailedPrecondition, "EPSG:1"),
        (|h| h.crs = "x".repeat(5000), Code::ResourceExhausted, "crs"),
        (|h| h.lattice = vec![1.0; 3], Code::InvalidArgument, "3 numbers"),
        (|h| h.step = vec![f64::NAN; 2], Code::InvalidArgument, "step"),
        (|h| h.datum_shift = "sideways".into(), Code::InvalidArgument, "sideways"),
        (|h| h.name = "n".repeat(2000), Code::InvalidArgument, "name"),
        (|h| h.name = "\u{1b}[2Jhills".into(), Code::InvalidArgument, "control"),
        (
            |h| {
                h.target = Some(v1::upload_header::Target::Into("nobody".into()));
                h.name.clear();
            },
            Code::NotFound,
            "nobody",
        ),
        // A terabyte is refused by the room that uploads may take, 40 GB on one side by rows.
        (|h| (h.grids[0].cols, h.grids[0].rows) = (100_000, 2_000_000), Code::ResourceExhausted, "posts"),
        (|h| (h.grids[0].cols, h.grids[0].rows) = (100_000, 10_000), Code::ResourceExhausted, "1073741824"),
    ];
    for (spoil, code, told) in cases {
        let mut header = good.clone();
        spoil(&mut header);
        let e = match Call::begin(&c, &header).await {
            Err(e) => e,
            Ok(_) => panic!("{told}: was accepted"),
        };
        assert!(e.message().contains(told), "{told}: {e:?}");
        assert_eq!(e.code(), code, "{told}: {e}");
    }
    let mut many = good.clone();
    many.grids = vec![v1::Grid::default(); 10_001];
    let e = Call::begin(&c, &many).await.err().unwrap();
    assert!(e.message().contains("10001"), "{e}");
    assert_eq!((listed(&c).await.len(), folders(&db)), (0, 0));
    // The server is unharmed.
    assert!(send(&c, &hills("hills", 100, 0.0, 1)).await.unwrap().changed);
}

#[tokio::test(flavor = "multi_thread")]
async fn silent_streams_end_and_uploads_are_limited_and_expire() {
    let folder = tempfile::tempdir().unwrap();
    let db = empty(folder.path());
    let set = |s: &mut Settings| {
        s.upload_idle = Duration::from_millis(400);
        s.uploads_max = 2;
        s.uploads_kept = Duration::from_secs(2);
    };
    let server = serve_with(&db, set).await;
    let c = connect(&server).await;
    let survey = |k: u64| hills(&format!("hills-{k}"), 50, 0.0, k);
    let (mut call, _) = Call::begin(&c, &survey(1).header).await.unwrap();
    call.block(survey(1).block(0, 0, 10)).await;
    let e = call.refused().await;
    assert!(e.code() == Code::DeadlineExceeded && e.message().contains("what arrived is kept"), "{e}");
    assert_eq!(listed(&c).await[0].rows_received, 10);
    // One that sends the same again and again, and never anything new.
    let (mut call, _) = Call::begin(&c, &survey(1).header).await.unwrap();
    let (sender, block) = (call.send.clone(), survey(1).block(0, 0, 10));
    let again = tokio::spawn(async move {
        let kind = Some(Kind::Block(block));
        while sender.send(v1::UploadRequest { kind: kind.clone() }).await.is_ok() {}
    });
    let e = call.refused().await;
    assert!(e.code() == Code::DeadlineExceeded && e.message().contains("nothing new"), "{e}");
    again.await.unwrap();
    // A stream that says nothing at all.
    let mut call = Call::open(&c).await;
    assert_eq!(call.refused().await.code(), Code::DeadlineExceeded);
    let (_second, _) = Call::begin(&c, &survey(2).header).await.unwrap();
    let e = Call::begin(&c, &survey(3).header).await.err().unwrap();
    assert!(e.code() == Code::ResourceExhausted && e.message().contains("at most 2"), "{e}");
    // Nobody touches them: they go.
    let waiting = std::time::Instant::now();
    while !(listed(&c).await.is_empty() && folders(&db) == 0) {
        assert!(waiting.elapsed() < Duration::from_secs(15), "{:?}", listed(&c).await);
        tokio::time::sleep(Duration::from_millis(50)).await;
    }
    // Rows without a folder and folders without a row go, too.
    let (call, _) = Call::begin(&c, &survey(4).header).await.unwrap();
    drop(call);
    let uploads = db.path().join("uploads");
    std::fs::create_dir(uploads.join("0123456789abcdef0123456789abcdef")).unwrap();
    let waiting = std::time::Instant::now();
    while !(listed(&c).await.is_empty() && folders(&db) == 0) {
        assert!(waiting.elapsed() < Duration::from_secs(15), "{:?}", listed(&c).await);
        tokio::time::sleep(Duration::from_millis(50)).await;
    }
}
