//! Surveys arrive: uploads whole and in pieces, out of order, twice, damaged, cut off and resumed; files beside the server.

use super::support::{connect, empty};
use super::survey::{HELENS, Survey, bundled, grid_of, helens, hills, offline, print};
use std::path::Path;
use std::time::Duration;
use terraquilt::client::Connection;
use terraquilt::client::ingest::{Sending, upload};
use terraquilt::db::Db;
use terraquilt::server::{Running, Settings, start};
use terraquilt::wire::v1::upload_request::Kind;
use terraquilt::wire::v1::{self, operation_status::State};
use tokio::sync::mpsc;
use tokio_stream::wrappers::ReceiverStream;
use tonic::{Code, Status, Streaming};

/// A server with other settings than the defaults.
async fn serve_with(db: &Db, set: impl FnOnce(&mut Settings)) -> Running {
    let mut settings = Settings { listen: ([127, 0, 0, 1], 0).into(), ..Settings::new(db.path()) };
    set(&mut settings);
    start(settings).await.expect("a free port")
}

/// A stream of an upload, message by message.
struct Call {
    send: mpsc::Sender<v1::UploadRequest>,
    replies: Streaming<v1::UploadReply>,
}

impl Call {
    async fn open(c: &Connection) -> Call {
        let (send, requests) = mpsc::channel(64);
        let replies = c.ingest().upload(ReceiverStream::new(requests)).await.unwrap().into_inner();
        Call { send, replies }
    }

    /// Sends a header and returns what is there.
    async fn begin(c: &Connection, header: &v1::UploadHeader) -> Result<(Call, v1::UploadReply), Status> {
        let mut call = Call::open(c).await;
        call.header(header).await;
        let first = call.replies.message().await?.expect("a reply");
        Ok((call, first))
    }

    async fn kind(&self, kind: Kind) {
        // A server that refused takes nothing more.
        let _ = self.send.send(v1::UploadRequest { kind: Some(kind) }).await;
    }
    async fn header(&self, h: &v1::UploadHeader) {
        self.kind(Kind::Header(h.clone())).await;
    }
    async fn block(&self, b: v1::SampleBlock) {
        self.kind(Kind::Block(b)).await;
    }
    async fn finish(&self) {
        self.kind(Kind::Finish(v1::UploadFinish::default())).await;
    }

    /// Reads replies until so many rows were said to be durable.
    async fn durable(&mut self, rows: u64) {
        let mut seen = 0;
        while seen < rows {
            let reply = self.replies.message().await.unwrap().expect("a reply");
            seen += reply.received.iter().map(|s| s.rows).sum::<u64>();
        }
    }

    /// Reads replies until the commit.
    async fn commit(&mut self) -> Result<v1::CommitReply, Status> {
        loop {
            let reply = self.replies.message().await?.expect("a reply");
            if let Some(commit) = reply.commit {
                assert_eq!(reply.state, State::Done as i32);
                return Ok(commit);
            }
        }
    }

    /// What the server refuses.
    async fn refused(&mut self) -> Status {
        self.commit().await.expect_err("a refusal")
    }
}

async fn send(c: &Connection, s: &Survey) -> terraquilt::base::Result<v1::CommitReply> {
    upload(c, s.header.clone(), s.rows(), &Sending::default(), &mut |_| {}).await
}

/// Folders of uploads that are left.
fn folders(db: &Db) -> usize {
    let Ok(entries) = std::fs::read_dir(db.path().join("uploads")) else { return 0 };
    entries.filter(|e| e.as_ref().unwrap().path().is_dir()).count()
}

async fn listed(c: &Connection) -> Vec<v1::UploadInfo> {
    c.ingest().list_uploads(v1::ListUploadsRequest {}).await.unwrap().into_inner().uploads
}

fn spans(reply: &v1::UploadReply) -> Vec<[u64; 3]> {
    reply.received.iter().map(|s| [u64::from(s.grid), s.row, s.rows]).collect()
}

#[tokio::test(flavor = "multi_thread")]
async fn surveys_uploaded_are_the_surveys_ingested() {
    let folder = tempfile::tempdir().unwrap();
    let db = empty(folder.path());
    let server = serve_with(&db, |_| {}).await;
    let c = connect(&server).await;
    let alone = empty(&folder.path().join("alone"));
    for k in 0..HELENS.len() {
        let (survey, mut stages) = (bundled(k), Vec::new());
        let sending = Sending { packed: k % 2 == 0, ..Sending::default() };
        let told = &mut |r: &v1::UploadReply| stages.push(r.state());
        let commit = upload(&c, survey.header.clone(), survey.rows(), &sending, told).await.unwrap();
        assert!(commit.changed, "{commit:?}");
        assert_eq!((commit.version, commit.survey.as_str()), (k as u64 + 1, HELENS[k].1));
        assert_eq!(stages.first(), Some(&State::Uploading));
        assert_eq!(stages.last(), Some(&State::Done));
        // The newest version is there for whoever asks next.
        assert_eq!(server.state().live.newest().number(), k as u64 + 1);
        tokio::task::block_in_place(|| offline(&alone, k));
    }
    assert_eq!(print(&db), print(&alone));
    assert_eq!((listed(&c).await, folders(&db)), (vec![], 0));

    // The same call again: answered with its commit, nothing is sent.
    let (_, again) = Call::begin(&c, &bundled(1).header).await.unwrap();
    assert_eq!((again.state(), again.commit.unwrap().version), (State::Done, 2));
    // The same samples under another operation: no version. With their hash nothing is sent either.
    let (_, again) = Call::begin(&c, &bundled(1).called("another").header).await.unwrap();
    let by_hash = again.commit.unwrap();
    let mut unhashed = bundled(1).called("a third");
    unhashed.header.grids[0].hash = Default::default();
    let commit = send(&c, &unhashed).await.unwrap();
    assert!(!commit.changed && commit.version == 5, "{commit:?}");
    assert!(commit.warnings.iter().any(|w| w.contains("holds these samples already")), "{commit:?}");
    assert_eq!((by_hash.changed, by_hash.version), (false, 5));
    assert_eq!((by_hash.posts, by_hash.voids, by_hash.live), (commit.posts, commit.voids, commit.live));
    assert!(by_hash.warnings.iter().all(|w| commit.warnings.contains(w)), "{by_hash:?}");
    let (_, again) = Call::begin(&c, &unhashed.header).await.unwrap();
    assert_eq!(again.commit.unwrap().version, 5);
    // One sample or one field further it is another delivery.
    let mut other = bundled(1).called("other");
    other.grids[0][2000] ^= 1;
    let mut rows = other.rows();
    terraquilt::client::ingest::hash(&mut other.header, &mut rows).unwrap();
    let (_, first) = Call::begin(&c, &other.header).await.unwrap();
    assert_eq!(first.state(), State::Uploading);
    for spoil in [|g: &mut v1::Grid| g.nodata = None, |g: &mut v1::Grid| g.x += g.col_dx] {
        let mut header = bundled(1).called("moved").header;
        spoil(&mut header.grids[0]);
        let (_, first) = Call::begin(&c, &header).await.unwrap();
        assert_eq!(first.state(), State::Uploading);
        let abandon = v1::AbandonRequest { operation: header.operation };
        while c.ingest().abandon(abandon.clone()).await.is_err() {
            tokio::time::sleep(Duration::from_millis(10)).await;
        }
    }
    assert_eq!(db.versions().unwrap().len(), 5);
    server.stop().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn blocks_come_in_any_order_and_twice() {
    let folder = tempfile::tempdir().unwrap();
    let db = empty(folder.path());
    let server = serve_with(&db, |_| {}).await;
    let c = connect(&server).await;
    let mut survey = hills("hills", 100, 0.0, 1);
    // Two grids: the second is the first one's eastern neighbour, and hides half of its posts by a mask.
    let east = hills("east", 100, 1000.0, 2);
    let (mut grid, mut rows) = (east.header.grids[0].clone(), Vec::new());
    grid.masked = true;
    for row in east.grids[0].chunks_exact(400) {
        rows.extend_from_slice(row);
        rows.extend((0..13).map(|k| if k < 6 { 0xff } else { 0 }));
    }
    survey.header.grids.push(grid);
    survey.grids.push(rows);
    let (mut call, first) = Call::begin(&c, &survey.header).await.unwrap();
    assert_eq!((first.state(), first.received.len(), first.kept_s), (State::Uploading, 0, 24 * 3600));
    for k in (0..10).rev() {
        for grid in [1, 0] {
            call.block(survey.block(grid, k * 10, 10)).await;
        }
    }
    // Again, with other bytes: rows that are there stay as they are.
    let mut other = survey.block(0, 20, 10);
    other.samples = vec![0; 4000].into();
    other.crc32c = crc32c::crc32c(&other.samples);
    call.block(other).await;
    call.block(survey.block(1, 5, 50)).await;
    call.finish().await;
    let commit = call.commit().await.unwrap();
    assert_eq!((commit.posts, commit.voids), (20_000, 52 * 100));
    // As in one piece.
    let other = empty(&folder.path().join("other"));
    let second = serve_with(&other, |_| {}).await;
    send(&connect(&second).await, &survey).await.unwrap();
    assert_eq!(print(&db), print(&other));
}

#[tokio::test(flavor = "multi_thread")]
async fn an_upload_that_stopped_goes_on_where_it_was() {
    let folder = tempfile::tempdir().unwrap();
    let db = empty(folder.path());
    let server = serve_with(&db, |_| {}).await;
    let c = connect(&server).await;
    let survey = hills("hills", 300, 0.0, 1);
    let (mut call, _) = Call::begin(&c, &survey.header).await.unwrap();
    for k in [0, 1, 4] {
        call.block(survey.block(0, k * 50, 50)).await;
    }
    call.durable(150).await;
    let info = &listed(&c).await[0];
    assert_eq!((info.operation.as_str(), info.name.as_str()), ("upload of hills", "hills"));
    assert_eq!((info.grids, info.rows_received, info.rows, info.active), (1, 150, 300, true));
    // One stream at a time, and nobody abandons it meanwhile.
    let busy = Call::begin(&c, &survey.header).await.err().unwrap();
    assert_eq!(busy.code(), Code::Unavailable, "{busy}");
    let abandon = v1::AbandonRequest { operation: survey.header.operation.clone() };
    let e = c.ingest().abandon(abandon.clone()).await.unwrap_err();
    assert_eq!(e.code(), Code::FailedPrecondition, "{e}");
    // What was written and not yet said to be durable is kept, too, when a stream breaks.
    call.block(survey.block(0, 100, 7)).await;
    tokio::time::sleep(Duration::from_millis(300)).await;
    drop(call);
    while listed(&c).await[0].active {
        tokio::time::sleep(Duration::from_millis(10)).await;
    }

    // Another header under the same operation says what differs.
    let mut other = survey.header.clone();
    other.accuracy_m = Some(2.0);
    let e = Call::begin(&c, &other).await.err().unwrap();
    assert_eq!(e.code(), Code::InvalidArgument);
    assert!(e.message().contains("accuracy_m was Some(1.0), is Some(2.0)"), "{e}");
    let mut other = survey.header.clone();
    other.grids[0].x += 1.0;
    let e = Call::begin(&c, &other).await.err().unwrap();
    assert!(e.message().contains("560001") && e.message().contains("grids[0]"), "{e}");

    // The server goes and comes; the client sends what is missing and no more.
    server.stop().await.unwrap();
    let server = serve_with(&db, |_| {}).await;
    let c = connect(&server).await;
    let (call, first) = Call::begin(&c, &survey.header).await.unwrap();
    assert_eq!(spans(&first), [[0, 0, 107], [0, 200, 50]]);
    drop(call);
    while listed(&c).await[0].active {
        tokio::time::sleep(Duration::from_millis(10)).await;
    }
    let counted = Counted { rows: survey.rows(), read: Default::default() };
    let read = counted.read.clone();
    let commit = upload(&c, survey.header.clone(), counted, &Sending::default(), &mut |_| {}).await.unwrap();
    assert!(commit.changed);
    assert_eq!(read.load(std::sync::atomic::Ordering::Relaxed), 300 - 157, "rows that were sent");
    assert_eq!((listed(&c).await.len(), folders(&db)), (0, 0));

    // Abandoned: nothing is left of it.
    let second = hills("second", 100, 0.0, 2);
    let (mut call, _) = Call::begin(&c, &second.header).await.unwrap();
    call.block(second.block(0, 0, 50)).await;
    call.durable(50).await;
    drop(call);
    while listed(&c).await[0].active {
        tokio::time::sleep(Duration::from_millis(10)).await;
    }
    assert_eq!(folders(&db), 1);
    let abandon = v1::AbandonRequest { operation: second.header.operation.clone() };
    assert!(c.ingest().abandon(abandon.clone()).await.unwrap().into_inner().abandoned);
    assert!(!c.ingest().abandon(abandon).await.unwrap().into_inner().abandoned);
    assert_eq!((listed(&c).await.len(), folders(&db)), (0, 0));
}

/// Counts the rows that are asked for.
struct Counted {
    rows: terraquilt::client::ingest::InMemory,
    read: std::sync::Arc<std::sync::atomic::AtomicU64>,
}

impl terraquilt::client::ingest::Rows for Counted {
    fn read(&mut self, grid: usize, row: u64, rows: u64, out: &mut Vec<u8>) -> terraquilt::base::Result<()> {
        self.read.fetch_add(rows, std::sync::atomic::Ordering::Relaxed);
        self.rows.read(grid, row, rows, out)
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_dry_run_keeps_the_samples_and_makes_no_version() {
    let folder = tempfile::tempdir().unwrap();
    let db = empty(folder.path());
    let server = serve_with(&db, |_| {}).await;
    let c = connect(&server).await;
    let mut survey = hills("hills", 100, 0.0, 1);
    survey.header.dry_run = true;
    let commit = send(&c, &survey).await.unwrap();
    assert_eq!((commit.posts, db.newest().unwrap()), (10_000, 0));
    survey.header.dry_run = false;
    let (mut call, first) = Call::begin(&c, &survey.header).await.unwrap();
    assert_eq!(spans(&first), [[0, 0, 100]]);
    call.finish().await;
    assert_eq!(call.commit().await.unwrap().version, 1);
}

#[tokio::test(flavor = "multi_thread")]
async fn bad_blocks_are_refused_and_the_rest_is_kept() {
    let folder = tempfile::tempdir().unwrap();
    let db = empty(folder.path());
    let server = serve_with(&db, |_| {}).await;
    let c = connect(&server).await;
    let survey = hills("hills", 600, 0.0, 1);
    let good = || survey.block(0, 0, 10);
    let sealed = |mut b: v1::SampleBlock| {
        b.crc32c = crc32c::crc32c(&b.samples);
        b
    };
    let zlib = |bytes: usize| {
        use std::io::Write;
        let mut z = flate2::write::ZlibEncoder::new(Vec::new(), flate2::Compression::best());
        z.write_all(&vec![0; bytes]).unwrap();
        z.finish().unwrap()
    };
    let cases: Vec<(v1::SampleBlock, &str)> = vec![
        (v1::SampleBlock { crc32c: 5, ..good() }, "checksum"),
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
    let mut received = 0;
    for (block, told) in cases {
        let (mut call, first) = Call::begin(&c, &survey.header).await.unwrap();
        assert_eq!(first.received.iter().map(|s| s.rows).sum::<u64>(), received);
        call.block(survey.block(0, 20 + received, 1)).await;
        received += 1;
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

#[tokio::test(flavor = "multi_thread")]
async fn others_leave_uploads_alone() {
    let folder = tempfile::tempdir().unwrap();
    let db = empty(folder.path());
    let server = serve_with(&db, |_| {}).await;
    let c = connect(&server).await;
    let survey = hills("hills", 100, 0.0, 1);
    let (mut call, _) = Call::begin(&c, &survey.header).await.unwrap();
    call.block(survey.block(0, 0, 60)).await;
    call.durable(60).await;
    // Commits, prune, compaction, verify, backup and copy of another process, while the stream is open.
    let other = Db::open(db.path()).unwrap();
    tokio::task::block_in_place(|| {
        use std::sync::atomic::AtomicBool;
        use terraquilt::db::{Progress, verify};
        let stop = AtomicBool::new(false);
        let progress = Progress { report: &|_, _| (), stop: &stop };
        offline(&other, 1);
        offline(&other, 2);
        other.prune(|all| all.to_vec(), &mut || {}).unwrap();
        other.compact(0.0, &progress, &mut || {}).unwrap();
        assert!(verify(&other, &other.snapshot(None).unwrap(), &progress).unwrap().ok);
        for to in ["backup", "copy"].map(|n| folder.path().join(n)) {
            match to.ends_with("backup") {
                true => other.backup(&to, None, &progress).map(|_| ()).unwrap(),
                false => other.copy(&to, None, &progress).map(|_| ()).unwrap(),
            }
            assert!(!to.join("uploads").exists());
        }
    });
    let before = db.newest().unwrap();
    call.block(survey.block(0, 60, 40)).await;
    call.finish().await;
    let commit = call.commit().await.unwrap();
    assert_eq!(commit.version, before + 1);
}

#[tokio::test(flavor = "multi_thread")]
async fn tiles_join_a_survey_and_replace_its_tiles() {
    use v1::upload_header::Target;
    let folder = tempfile::tempdir().unwrap();
    let db = empty(folder.path());
    let server = serve_with(&db, |_| {}).await;
    let c = connect(&server).await;
    send(&c, &hills("hills", 100, 0.0, 1)).await.unwrap();
    let mut east = hills("east", 100, 1000.0, 2).called("east");
    (east.header.target, east.header.name) = (Some(Target::Into("hills".into())), String::new());
    east.header.date.clear();
    let commit = send(&c, &east).await.unwrap();
    assert_eq!((commit.version, commit.survey.as_str()), (2, "hills"));
    let mut better = hills("better", 100, 1000.0, 3).called("better");
    (better.header.target, better.header.name) = (Some(Target::Replace("hills".into())), String::new());
    better.header.date.clear();
    assert_eq!(send(&c, &better).await.unwrap().version, 3);
    let s = db.snapshot(None).unwrap();
    let number = s.survey("hills").unwrap().number;
    let tiles: Vec<String> = s.head(number).unwrap().tiles.iter().map(|t| t.file.clone()).collect();
    assert_eq!(tiles.len(), 2);
    assert!(tiles.contains(&"hills.grid".to_string()) && tiles.contains(&"better.grid".to_string()));
    // Another accuracy than the survey's is refused before a sample is sent.
    east.header.accuracy_m = Some(3.0);
    let e = Call::begin(&c, &east.called("again").header).await.err().unwrap();
    assert!(e.message().contains("a declaration never changes"), "{e}");
}

/// Asks for files and waits for the commit.
async fn files(c: &Connection, operation: &str, paths: &[&str]) -> Result<v1::CommitReply, Status> {
    let header = v1::UploadHeader {
        operation: operation.into(),
        name: "crater-2000".into(),
        accuracy_m: Some(2.0),
        date: "2000-09-25".into(),
        ..Default::default()
    };
    let paths = paths.iter().map(|p| p.to_string()).collect();
    let request = v1::FilesRequest { header: Some(header), paths, nodata: None };
    let mut replies = c.ingest().files(request).await?.into_inner();
    loop {
        if let Some(commit) = replies.message().await?.expect("a reply").commit {
            return Ok(commit);
        }
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn files_beside_the_server_are_ingested_where_that_is_allowed() {
    let folder = tempfile::tempdir().unwrap();
    let db = empty(folder.path());
    let closed = serve_with(&db, |_| {}).await;
    let e = files(&connect(&closed).await, "f", &["a.tif"]).await.unwrap_err();
    assert!(e.code() == Code::FailedPrecondition && e.message().contains("--ingest-from"), "{e}");
    closed.stop().await.unwrap();

    let inbox = folder.path().join("inbox");
    std::fs::create_dir_all(inbox.join("sub")).unwrap();
    let (file, ..) = HELENS[0];
    std::fs::copy(helens(file), inbox.join("sub/crater.tif")).unwrap();
    let outside = folder.path().join("outside.tif");
    std::fs::copy(helens(file), &outside).unwrap();
    std::os::unix::fs::symlink(&outside, inbox.join("link.tif")).unwrap();
    std::os::unix::fs::symlink(folder.path(), inbox.join("up")).unwrap();
    std::os::unix::fs::symlink(inbox.join("sub/crater.tif"), inbox.join("inner.tif")).unwrap();
    let server = serve_with(&db, |s| s.ingest_from = Some(inbox.clone())).await;
    let c = connect(&server).await;
    let absolute = outside.to_str().unwrap();
    for path in
        [absolute, "../outside.tif", "sub/../../outside.tif", "link.tif", "up/outside.tif", "", "a\0b"]
    {
        let e = files(&c, "f", &[path]).await.unwrap_err();
        assert_eq!(e.code(), Code::PermissionDenied, "{path}: {e}");
    }
    assert_eq!(files(&c, "f", &["none.tif"]).await.unwrap_err().code(), Code::NotFound);
    assert_eq!(files(&c, "f", &["sub"]).await.unwrap_err().code(), Code::FailedPrecondition);
    assert_eq!(files(&c, "f", &[]).await.unwrap_err().code(), Code::InvalidArgument);
    assert_eq!(files(&c, "", &["sub/crater.tif"]).await.unwrap_err().code(), Code::InvalidArgument);
    let commit = files(&c, "f", &["sub/crater.tif"]).await.unwrap();
    assert!(commit.changed && commit.version == 1, "{commit:?}");
    assert_eq!(files(&c, "f", &["sub/crater.tif"]).await.unwrap().version, 1);
    assert!(!files(&c, "g", &["./inner.tif"]).await.unwrap().changed);
    let alone = empty(&folder.path().join("alone"));
    offline(&alone, 0);
    assert_eq!(print(&db), print(&alone));
}

#[test]
fn a_file_becomes_the_grid_that_it_is() {
    let mut source = terraquilt::format::open(&helens(HELENS[1].0)).unwrap();
    let (grid, rows) = grid_of(&mut *source);
    assert_eq!(grid.rows * grid.row_bytes().unwrap(), rows.len() as u64);
    assert!(Path::new(&source.info().file).ends_with(&grid.name));
}
