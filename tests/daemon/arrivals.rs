//! Surveys arrive: uploads whole and in pieces, out of order, twice, cut off and resumed; files beside the server.

use super::calls::{Call, folders, listed, send, serve_with, spans};
use super::support::{connect, empty};
use super::survey::{HELENS, bundled, grid_of, helens, hills, offline, print};
use std::path::Path;
use std::time::Duration;
use terraquilt::client::Connection;
use terraquilt::client::ingest::{Sending, upload};
use terraquilt::db::Db;
use terraquilt::wire::v1::{self, operation_status::State};
use tonic::{Code, Status};

#[tokio::test(flavor = "multi_thread")]
async fn surveys_uploaded_are_the_surveys_ingested() {
    let folder = tempfile::tempdir().unwrap();
    let db = empty(folder.path());
    let server = serve_with(&db, |_| {}).await;
    let c = connect(&server).await;
    let alone = empty(&folder.path().join("alone"));
    for (k, (_, name, ..)) in HELENS.iter().enumerate() {
        let (survey, mut stages) = (bundled(k), Vec::new());
        let sending = Sending { packed: k % 2 == 0, ..Sending::default() };
        let told = &mut |r: &v1::UploadReply| stages.push(r.state());
        let commit = upload(&c, survey.header.clone(), survey.rows(), &sending, told).await.unwrap();
        assert!(commit.changed, "{commit:?}");
        assert_eq!((commit.version, commit.survey.as_str()), (k as u64 + 1, *name));
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
    other.crc32 = terraquilt::wire::crc32(&other.samples);
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
    let (mut open, _) = Call::begin(&c, &survey.header).await.unwrap();
    let stopping = std::time::Instant::now();
    let (stopped, told) = tokio::join!(server.stop(), open.refused());
    stopped.unwrap();
    assert!(told.code() == Code::Unavailable && told.message().contains("stopping"), "{told}");
    assert!(stopping.elapsed() < Duration::from_secs(20), "an open stream holds the server");
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
