//! What is in the database, asked over the wire.

use super::survey::offline;
use crate::support::{connect, empty, serve};
use std::time::Duration;
use terraquilt::client::{Connection, catalog};
use terraquilt::db::{self, Db};
use terraquilt::server::Running;
use terraquilt::wire::v1;
use tonic::Code;

struct Here {
    _folder: tempfile::TempDir,
    db: Db,
    server: Running,
    c: Connection,
}

async fn here(surveys: &[usize]) -> Here {
    let folder = tempfile::tempdir().unwrap();
    let db = empty(folder.path());
    surveys.iter().for_each(|k| offline(&db, *k));
    let server = serve(&db).await;
    let c = connect(&server).await;
    Here { _folder: folder, db, server, c }
}

#[tokio::test(flavor = "multi_thread")]
async fn lists_come_in_pages_of_one_version() {
    let h = here(&[1, 2, 3]).await;
    let s = h.db.snapshot(None).unwrap();
    let all = db::surveys(&s).unwrap();
    let (mut names, mut token, mut pages) = (Vec::new(), String::new(), 0);
    loop {
        let request = v1::ListSurveysRequest { page_size: 1, page_token: token, ..Default::default() };
        let page = h.c.catalog().list_surveys(request).await.unwrap().into_inner();
        assert_eq!((page.version, page.surveys.len(), page.frames.len()), (3, 1, 1));
        let row = &all[pages];
        let listed = &page.surveys[0];
        assert_eq!(listed.json, serde_json::to_string(row).unwrap());
        assert_eq!((listed.live, listed.dormant, listed.cols), (row.live, row.dormant, row.cols as u64));
        let entry = s.survey(&row.name).unwrap();
        let f = &page.frames[0];
        assert_eq!((f.survey, f.level_max), (entry.number.0, u32::from(entry.geometry.level_max)));
        assert_eq!([f.anchor_x, f.anchor_y, f.u_x, f.v_y], {
            let g = &entry.geometry.frame;
            [g.anchor.x, g.anchor.y, g.u.x, g.v.y]
        });
        names.push(listed.name.clone());
        pages += 1;
        token = page.next_page_token;
        if pages == 1 {
            // A commit between two pages changes nothing in them.
            let request = v1::RemoveRequest { surveys: vec![all[1].name.clone()], ..Default::default() };
            let done = catalog::remove(&h.c, request).await.unwrap();
            assert_eq!((done.version, done.changed), (4, true));
        }
        if token.is_empty() {
            break;
        }
    }
    assert_eq!(names, all.iter().map(|r| r.name.clone()).collect::<Vec<_>>());
    let newest = catalog::surveys(&h.c, 0, true).await.unwrap();
    assert_eq!((newest.version, newest.frames.len(), newest.surveys.len()), (4, 2, 0));
    // Only those in a region.
    let kind = v1::region::Kind::Box(v1::Box { xmin: 0.0, ymin: 0.0, xmax: 1.0, ymax: 1.0 });
    let region = Some(v1::Region { kind: Some(kind) });
    let request = v1::ListSurveysRequest { region, ..Default::default() };
    assert!(h.c.catalog().list_surveys(request).await.unwrap().into_inner().surveys.is_empty());
    for (at, token) in [(0, "x"), (0, "3"), (2, "3.1"), (0, "99.1"), (0, "3.-1")] {
        let request = v1::ListSurveysRequest { at, page_token: token.into(), ..Default::default() };
        let refused = h.c.catalog().list_surveys(request).await.unwrap_err();
        let code = if token == "99.1" { Code::NotFound } else { Code::InvalidArgument };
        assert_eq!(refused.code(), code, "{refused}");
    }
    let tiles = catalog::tiles(&h.c, 3, &all[0].name).await.unwrap();
    let rows = db::tiles(&s, &all[0].name).unwrap();
    assert_eq!(tiles.tiles.len(), rows.len());
    assert_eq!(tiles.tiles[0].json, serde_json::to_string(&rows[0]).unwrap());
    let versions = catalog::versions(&h.c).await.unwrap();
    assert_eq!(versions.versions.iter().map(|v| v.number).collect::<Vec<_>>(), [1, 2, 3, 4]);
    h.server.stop().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn operations_are_known_while_they_run_and_ever_after() {
    let h = here(&[1, 3]).await;
    let remove = v1::RemoveRequest {
        surveys: vec!["dome-2004-10-04".into()],
        operation: "gone".into(),
        ..Default::default()
    };
    let unknown = h.c.catalog().get_operation(v1::GetOperationRequest { operation: "gone".into() }).await;
    assert_eq!(unknown.unwrap_err().code(), Code::NotFound);
    // Five calls at once are one commit.
    let calls = (0..5).map(|_| {
        let (c, remove) = (h.c.clone(), remove.clone());
        tokio::spawn(async move { catalog::remove(&c, remove).await.unwrap() })
    });
    let calls: Vec<_> = calls.collect();
    let mut changed = 0;
    for call in calls {
        let done = call.await.unwrap();
        assert_eq!((done.version, done.operation.as_str()), (3, "gone"));
        changed += u32::from(done.changed);
    }
    assert_eq!(changed, 1);
    let done = v1::operation_status::State::Done as i32;
    let standing = catalog::operation(&h.c, "gone").await.unwrap();
    assert_eq!((standing.state, standing.version), (done, 3));
    let failed = v1::RemoveRequest { surveys: vec!["none".into()], operation: "f".into(), ..remove.clone() };
    let refused = h.c.catalog().remove(failed).await.unwrap_err();
    assert_eq!(refused.code(), Code::NotFound);
    let standing = catalog::operation(&h.c, "f").await.unwrap();
    assert_eq!(standing.state, v1::operation_status::State::Failed as i32);
    assert!(standing.error.contains("survey 'none' not found"), "{}", standing.error);
    for (request, says) in [
        (v1::RemoveRequest::default(), "none is named"),
        (v1::RemoveRequest { operation: "commit-7".into(), ..remove.clone() }, "commit-"),
    ] {
        let refused = h.c.catalog().remove(request).await.unwrap_err();
        assert_eq!(refused.code(), Code::InvalidArgument);
        assert!(refused.message().contains(says), "{refused}");
    }
    h.server.stop().await.unwrap();
    // Another server of the same database knows what was committed.
    let server = serve(&h.db).await;
    let c = connect(&server).await;
    let standing = catalog::operation(&c, "gone").await.unwrap();
    assert_eq!((standing.state, standing.version), (done, 3));
    server.stop().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn prune_leaves_what_is_read() {
    let h = here(&[1, 3]).await;
    let set =
        |n| v1::SetRequest { survey: "dome-2004-10-04".into(), precedence: Some(n), ..Default::default() };
    for n in 1..=2 {
        assert!(catalog::set(&h.c, set(n)).await.unwrap().changed);
    }
    // Version 2 is held by a reader, version 3 was only looked at.
    let held = h.server.state().live.snapshot(2).unwrap();
    let before = db::fingerprint(&held).unwrap();
    assert_eq!(catalog::info(&h.c, 3, false).await.unwrap().ground.unwrap().version, 3);
    let keep = v1::prune_request::What::Keep;
    let done = catalog::prune(&h.c, keep(1)).await.unwrap();
    assert_eq!((done.version, &done.forgotten[..], &done.kept_for_readers[..]), (4, &[1, 3][..], &[2][..]));
    assert_eq!(db::fingerprint(&held).unwrap(), before);
    assert_eq!(catalog::fingerprint(&h.c, 2).await.unwrap().fingerprint, before);
    let gone = h.c.catalog().info(v1::InfoRequest { at: 3, sizes: false }).await.unwrap_err();
    assert_eq!(gone.code(), Code::NotFound);
    assert!(gone.message().contains("version 3 not found"), "{gone}");
    drop(held);
    let done = catalog::prune(&h.c, v1::prune_request::What::Before(4)).await.unwrap();
    assert_eq!((&done.forgotten[..], &done.kept_for_readers[..]), (&[2][..], &[][..]));
    let refused = h.c.catalog().prune(v1::PruneRequest { what: Some(keep(0)) }).await.unwrap_err();
    assert_eq!(refused.code(), Code::InvalidArgument);
    h.server.stop().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn reports_come_line_by_line_and_nobody_need_read_them() {
    let h = here(&[0, 1]).await;
    let s = h.db.snapshot(None).unwrap();
    let kind = |k: v1::report_request::Kind| v1::ReportRequest { kind: k as i32, ..Default::default() };
    let mut nodes: Vec<serde_json::Value> = Vec::new();
    let version = catalog::report(&h.c, kind(v1::report_request::Kind::Tree), |line| {
        nodes.push(serde_json::from_slice(line).unwrap());
        Ok(())
    });
    assert_eq!(version.await.unwrap(), 2);
    // The same tree as the database's own, node by node.
    fn walk(n: &db::TreeNode, path: String, out: &mut Vec<(String, Vec<String>)>) {
        out.push((path.clone(), n.ids.clone()));
        for (k, c) in n.children.iter().enumerate() {
            if let Some(c) = c {
                walk(c, format!("{path}{k}"), out);
            }
        }
    }
    let mut own = Vec::new();
    walk(&db::tree(&s).unwrap().unwrap(), String::new(), &mut own);
    let sent: Vec<(String, Vec<String>)> = nodes
        .iter()
        .map(|n| {
            let ids = n["ids"].as_array().unwrap().iter().map(|i| i.as_str().unwrap().to_string());
            (n["path"].as_str().unwrap().to_string(), ids.collect())
        })
        .collect();
    assert_eq!(sent, own);
    // Streams that nobody reads hold no thread: more of them than there are, and the server still answers.
    let mut unread = Vec::new();
    for _ in 0..16 {
        // A connection of its own each time: unread bytes fill the window of a connection.
        let c = connect(&h.server).await;
        unread.push(c.catalog().boxes(v1::BoxesRequest { at: 0 }).await.unwrap());
        unread.push(c.catalog().report(kind(v1::report_request::Kind::Tree)).await.unwrap());
    }
    let answer = tokio::time::timeout(Duration::from_secs(60), catalog::fingerprint(&h.c, 0));
    let found = answer.await.expect("the pool is free").unwrap();
    assert_eq!(found.fingerprint, db::fingerprint(&s).unwrap());
    for (request, code) in [
        (v1::ReportRequest::default(), Code::InvalidArgument),
        (v1::ReportRequest { kind: 99, ..Default::default() }, Code::InvalidArgument),
        (kind(v1::report_request::Kind::Provenance), Code::InvalidArgument),
        (
            v1::ReportRequest { surveys: vec!["a".into()], ..kind(v1::report_request::Kind::Contradictions) },
            Code::InvalidArgument,
        ),
        (v1::ReportRequest { at: 77, ..kind(v1::report_request::Kind::Redundant) }, Code::NotFound),
    ] {
        let refused = h.c.catalog().report(request.clone()).await.unwrap_err();
        assert_eq!(refused.code(), code, "{request:?}: {refused}");
    }
    drop(unread);
    // A check that is left is left off.
    let left = h.c.catalog().verify(v1::VerifyRequest { at: 0 }).await.unwrap();
    drop(left);
    let checked = catalog::verify(&h.c, 0, |_, share| assert!((0.0..=1.0).contains(&share))).await.unwrap();
    assert!(checked.ok && checked.done && checked.json.contains("\"ok\":true"));
    h.server.stop().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn ids_names_and_tokens_from_outside_are_bounded() {
    let h = here(&[1]).await;
    let mut catalog = h.c.catalog();
    for (id, told) in
        [("x".repeat(201), "201 bytes"), ("a\nb".into(), "control"), ("commit-7".into(), "commit-")]
    {
        let request =
            v1::RemoveRequest { surveys: vec!["s".into()], operation: id.clone(), ..Default::default() };
        let e = catalog.remove(request).await.unwrap_err();
        assert!(e.code() == Code::InvalidArgument && e.message().contains(told), "{e}");
        let request =
            v1::SetRequest { survey: "s".into(), precedence: Some(1), operation: id, ..Default::default() };
        let e = catalog.set(request).await.unwrap_err();
        assert!(e.code() == Code::InvalidArgument && e.message().contains(told), "{e}");
    }
    // What says that there is none fits into a header, however long the name.
    let request = v1::GetSurveyRequest { survey: "\u{e9}".repeat(1 << 20), ..Default::default() };
    let e = catalog.get_survey(request).await.unwrap_err();
    assert!(e.code() == Code::NotFound && e.message().ends_with("what is in the database"), "{e}");
    let survey = db::surveys(&h.db.snapshot(None).unwrap()).unwrap()[0].name.clone();
    let page_token = format!("1.{}", u64::MAX);
    let request = v1::ListTilesRequest { survey, page_token, ..Default::default() };
    assert!(catalog.list_tiles(request).await.unwrap().into_inner().tiles.is_empty());
    h.server.stop().await.unwrap();
}
