//! Commits are told as they happen, with what they did and where.

use super::hills::{DOME, arrival, commit, hills};
use super::support::{connect, serve};
use std::collections::BTreeMap;
use std::time::Duration;
use terraquilt::base::date::Date;
use terraquilt::client::watch::Commits;
use terraquilt::db::{Change, Db, Footprint, Snapshot, boxes};
use terraquilt::wire::v1;

/// A live patch of a listing: its survey, top and floor; its domain's box in CRS units.
type Live = ((u32, Option<u32>, bool), [f64; 4]);

/// Every live patch by key, from the tables: without the tree.
fn live(s: &Snapshot) -> BTreeMap<String, Live> {
    let mut out = BTreeMap::new();
    let size = s.unit().size();
    // A survey that left and came again has another number, and the same id.
    let hex = |id: &[u8]| id.iter().map(|b| format!("{b:02x}")).collect::<String>();
    let numbers: BTreeMap<String, u32> = s.entries().map(|e| (hex(&e.id), e.number.0)).collect();
    boxes(s, |b| {
        if b.state == "live" {
            let side = |k: usize, high: bool| {
                let values = b.domain.iter().map(|p| p[k]);
                (if high { values.max() } else { values.min() }).unwrap() as f64 * size
            };
            let place = [side(0, false), side(1, false), side(0, true), side(1, true)];
            out.insert(b.key, ((numbers[&b.survey], b.top.map(f32::to_bits), b.floor), place));
        }
        Ok(())
    })
    .unwrap();
    out
}

/// The same by comparing every patch: counts, and the boxes of the patches that differ.
fn by_force(before: Option<&Snapshot>, now: &Snapshot) -> ([u64; 3], Vec<[f64; 4]>) {
    let (old, new) = (before.map(live).unwrap_or_default(), live(now));
    let (mut counts, mut places) = ([0; 3], Vec::new());
    for (key, (is, place)) in &new {
        match old.get(key) {
            None => counts[0] += 1,
            Some((was, _)) if was != is => counts[2] += 1,
            Some(_) => continue,
        }
        places.push(*place);
    }
    for (_, place) in old.iter().filter(|(key, _)| !new.contains_key(*key)).map(|(_, v)| v) {
        counts[1] += 1;
        places.push(*place);
    }
    (counts, places)
}

fn checked(f: &Footprint, (counts, places): ([u64; 3], Vec<[f64; 4]>)) {
    assert_eq!([f.added, f.removed, f.changed], counts);
    assert!(f.boxes.len() <= 64);
    let within = |b: &[f64; 4], p: &[f64; 4]| b[0] <= p[0] && b[1] <= p[1] && p[2] <= b[2] && p[3] <= b[3];
    assert!(places.iter().all(|p| f.boxes.iter().any(|b| within(b, p))));
    // No larger than what it covers.
    let around = |all: &[[f64; 4]]| {
        all.iter().fold([f64::INFINITY, f64::INFINITY, f64::NEG_INFINITY, f64::NEG_INFINITY], |a, b| {
            [a[0].min(b[0]), a[1].min(b[1]), a[2].max(b[2]), a[3].max(b[3])]
        })
    };
    let (found, wanted) = (around(&f.boxes), around(&places));
    assert!(found.iter().zip(&wanted).all(|(a, b)| a == b || (a - b).abs() < 1e-6), "{found:?} {wanted:?}");
}

fn redated(db: &Db, survey: &str, date: &str) -> u64 {
    let date = Some(Date::parse(date).unwrap());
    commit(db, Change::Set { survey: survey.into(), date, precedence: None })
}

fn removed(db: &Db, survey: &str) -> u64 {
    commit(db, Change::Remove { surveys: vec![survey.into()], tile: None })
}

#[test]
fn footprints_are_those_of_comparing_every_patch() {
    let folder = tempfile::tempdir().unwrap();
    let db = hills(folder.path());
    removed(&db, "2004-10-04");
    commit(&db, arrival(1));
    redated(&db, "2000", "2006-01-01");
    removed(&db, "2005");
    // What the crater covered of the dome's coarse patches is covered no more.
    let n = removed(&db, "2000");
    let versions: Vec<Snapshot> = (1..=n).map(|v| db.snapshot(Some(v)).unwrap()).collect();
    checked(&versions[0].footprint(None).unwrap(), by_force(None, &versions[0]));
    let mut met = [0; 3];
    for (k, now) in versions.iter().enumerate() {
        for before in &versions[..k] {
            let f = now.footprint(Some(before)).unwrap();
            checked(&f, by_force(Some(before), now));
            [f.added, f.removed, f.changed].iter().zip(&mut met).for_each(|(n, m)| *m += n);
        }
        assert_eq!(now.footprint(Some(now)).unwrap(), Footprint::default());
    }
    assert!(met.iter().all(|m| *m > 0), "{met:?}");
    // Version 4 is version 1 and the survey of 2005; 5 is 3 again, though every page was written anew.
    let again = versions[4].footprint(Some(&versions[2])).unwrap();
    assert_eq!((again.added, again.removed), (0, 0));
}

async fn soon(watch: &mut Commits<'_>) -> v1::Commit {
    let next = tokio::time::timeout(Duration::from_secs(20), watch.next());
    next.await.expect("a commit within 20 s").unwrap().expect("the stream goes on")
}

fn region(b: [f64; 4]) -> Option<v1::Region> {
    let b = v1::Box { xmin: b[0], ymin: b[1], xmax: b[2], ymax: b[3] };
    Some(v1::Region { kind: Some(v1::region::Kind::Box(b)) })
}

#[tokio::test(flavor = "multi_thread")]
async fn commits_are_told_in_order_and_none_is_left_out() {
    let folder = tempfile::tempdir().unwrap();
    let db = hills(folder.path());
    let server = serve(&db).await;
    let connection = connect(&server).await;
    let mut all = Commits::watch(&connection, None, Some(0)).await.unwrap();
    let mut later = Commits::watch(&connection, None, Some(2)).await.unwrap();
    let mut new = Commits::watch(&connection, None, None).await.unwrap();
    let mut dome = Commits::watch(&connection, region(DOME), None).await.unwrap();
    let far = region([0.0, 0.0, 1.0, 1.0]);
    let mut nowhere = Commits::watch(&connection, far, Some(0)).await.unwrap();
    for k in 1..=3 {
        let c = soon(&mut all).await;
        assert_eq!((c.version, c.since), (k, k - 1));
        let f = db.snapshot(Some(k)).unwrap();
        let before = (k > 1).then(|| db.snapshot(Some(k - 1)).unwrap());
        let f = f.footprint(before.as_ref()).unwrap();
        assert_eq!([c.added, c.removed, c.changed], [f.added, f.removed, f.changed]);
        let told: Vec<[f64; 4]> = c.footprint.iter().map(|b| [b.xmin, b.ymin, b.xmax, b.ymax]).collect();
        assert_eq!(told, f.boxes);
    }
    assert_eq!(soon(&mut later).await.version, 3);
    // Another process commits twice in a row: both are told.
    assert_eq!((removed(&db, "2005"), redated(&db, "2000", "1999-01-01")), (4, 5));
    for watch in [&mut all, &mut later, &mut new] {
        let (a, b) = (soon(watch).await, soon(watch).await);
        assert_eq!([(a.version, a.since), (b.version, b.since)], [(4, 3), (5, 4)]);
        let v = &db.versions().unwrap()[3];
        assert_eq!((&a.operation, a.made_at_s, &a.action), (&v.operation, v.made_at, &v.action));
    }
    assert_eq!(soon(&mut dome).await.version, 4);
    drop(all);
    // Streams that go on for ever end with the server, not before.
    let waits = tokio::time::timeout(Duration::from_millis(300), nowhere.next()).await;
    assert!(waits.is_err(), "{waits:?}");
    tokio::time::timeout(Duration::from_secs(10), server.stop()).await.unwrap().unwrap();
    let end = nowhere.next().await.unwrap_err().to_string();
    assert!(end.contains("stopping") || end.contains("transport") || end.contains("connection"), "{end}");
}

#[tokio::test(flavor = "multi_thread")]
async fn versions_that_are_gone_are_said_to_be() {
    let folder = tempfile::tempdir().unwrap();
    let db = hills(folder.path());
    db.prune(|_| vec![1, 2], &mut || {}).unwrap();
    let server = serve(&db).await;
    let connection = connect(&server).await;
    let refused = |after: u64| {
        let connection = &connection;
        async move { Commits::watch(connection, None, Some(after)).await.err().unwrap().to_string() }
    };
    let said = refused(2).await;
    assert!(
        said.contains("version 2") && said.contains("not kept") && said.contains("newest is 3"),
        "{said}"
    );
    let said = refused(7).await;
    assert!(said.contains("version 7") && said.contains("newest is 3"), "{said}");
    // From nothing, the oldest that is left is the first.
    let mut all = Commits::watch(&connection, None, Some(0)).await.unwrap();
    let c = soon(&mut all).await;
    assert_eq!((c.version, c.since, c.removed), (3, 0, 0));
    assert!(c.added > 100);
    let inverted = Commits::watch(&connection, region([1.0, 0.0, 0.0, 1.0]), None).await;
    assert!(inverted.err().unwrap().to_string().contains("empty"));
    drop(all);
    server.stop().await.unwrap();
}
