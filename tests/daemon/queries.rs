//! Query: answers are those of the offline database, within budgets, and differences lead from one to the other.

use super::support::{connect, serve};
use prost::Message;
use std::collections::BTreeSet;
use std::path::Path;
use std::sync::OnceLock;
use std::sync::atomic::AtomicBool;
use terraquilt::base::date::Date;
use terraquilt::client::{Connection, query::Patches};
use terraquilt::db::query::{Query, Tolerance};
use terraquilt::db::{Change, Db, Ingest, Options, Policy, Progress};
use terraquilt::height::crs::Crs;
use terraquilt::height::patch::Kind;
use terraquilt::height::surface::Blend;
use terraquilt::server::Running;
use terraquilt::wire::v1;
use tonic::Code;

fn survey(date: &str, accuracy_m: f64) -> Change {
    let data = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/st_helens");
    let source = terraquilt::format::open(&data.join(format!("survey_{date}_native.tif"))).unwrap();
    Change::Ingest(Ingest {
        name: Some(date.into()),
        accuracy_m: Some(accuracy_m),
        date: Some(Date::parse(date).unwrap()),
        ..Ingest::new(vec![source])
    })
}

/// A database in a folder, a version for each change.
fn made(folder: &Path, changes: impl IntoIterator<Item = Change>) -> Db {
    let crs = Crs::from_epsg(26910).unwrap();
    let options = Options { crs, policy: Policy::Newest, patch: Kind::Bilinear };
    let db = Db::create(&folder.join("db"), &options).unwrap();
    let (stop, quiet) = (AtomicBool::new(false), |_: &str, _: f64| ());
    let progress = Progress { report: &quiet, stop: &stop };
    for change in changes {
        db.change(change, None, false, &progress, &mut || ()).unwrap();
    }
    db
}

/// Two surveys of St. Helens in two versions, made once.
pub fn helens() -> Db {
    static FOLDER: OnceLock<tempfile::TempDir> = OnceLock::new();
    let folder = FOLDER.get_or_init(|| {
        let folder = tempfile::tempdir().unwrap();
        made(folder.path(), [survey("2000-09-25", 2.0), survey("2004-10-04", 0.5)]);
        folder
    });
    Db::open(&folder.path().join("db")).unwrap()
}

pub async fn served() -> (Running, Connection) {
    let server = serve(&helens()).await;
    let client = connect(&server).await;
    (server, client)
}

pub fn error_m(e: f64) -> Option<v1::Tolerance> {
    Some(v1::Tolerance { kind: Some(v1::tolerance::Kind::ErrorM(e)) })
}

fn asked(e: f64) -> v1::PatchesRequest {
    v1::PatchesRequest { tolerance: error_m(e), ..Default::default() }
}

fn ids(patches: &[v1::Patch]) -> BTreeSet<Vec<u8>> {
    patches.iter().map(|p| p.id.to_vec()).collect()
}

#[tokio::test]
async fn answers_are_those_of_the_offline_database() {
    let (server, client) = served().await;
    let db = helens();
    for at in [1, 2] {
        let now = db.snapshot(Some(at)).unwrap();
        for e in [0.0, 2.0, 15.0, f64::INFINITY] {
            let found = client.patches(v1::PatchesRequest { at, explain: true, ..asked(e) }).await.unwrap();
            let how = Blend::Exact.into();
            let offline =
                now.select(&Query { area: None.into(), tolerance: Tolerance::Constant(e), how }).unwrap();
            let known: BTreeSet<Vec<u8>> = offline.records.iter().map(|r| r.id.0.to_vec()).collect();
            assert_eq!(ids(&found.patches), known, "version {at}, {e} m");
            assert_eq!(found.end.hash[..], terraquilt::db::query::set_hash(offline.records.iter()));
            for p in &found.patches {
                let r = offline.records.iter().find(|r| r.id.0[..] == p.id[..]).unwrap();
                assert_eq!((p.level, p.i, p.j), (r.place.level.into(), r.place.i, r.place.j));
                assert_eq!((p.bot_m, p.top_m, p.floor), (r.bot, r.top, r.floor));
                assert_eq!(p.payload, now.payload(r).unwrap());
            }
            let header = &found.header;
            assert_eq!((header.factor, header.ground.as_ref().unwrap().version), (1.0, at));
            assert_eq!(header.surveys.len() as u64, at);
            let step = |p: &v1::Patch| {
                let f = header.surveys.iter().find(|f| f.survey == p.survey).unwrap();
                f.step_x * f64::from(1 << p.level)
            };
            assert!(found.patches.is_sorted_by(|a, b| step(a) >= step(b)), "coarse first");
            let x = found.end.explanation.unwrap();
            assert_eq!(x.found, known.len() as u64);
            assert_eq!(x.levels.iter().map(|l| l.patches).sum::<u64>(), x.found);
            assert_eq!(x.payload_bytes, found.patches.iter().map(|p| p.payload.len() as u64).sum::<u64>());
            let bare = v1::PatchesRequest { at, descriptors_only: true, ..asked(e) };
            let bare = client.patches(bare).await.unwrap();
            assert_eq!(ids(&bare.patches), known);
            assert!(bare.masks.is_empty() && bare.patches.iter().all(|p| p.payload.is_empty()));
        }
    }
    server.stop().await.unwrap();
}

/// Bytes of the messages of an answer, at least.
fn bytes(p: &Patches) -> u64 {
    let part = v1::PatchesPart { patches: p.patches.clone(), masks: p.masks.clone(), ..Default::default() };
    (p.header.encoded_len() + part.encoded_len() + p.end.encoded_len()) as u64
}

#[tokio::test]
async fn budgets_are_kept_and_used() {
    let (server, client) = served().await;
    let whole = client.patches(asked(0.0)).await.unwrap();
    let next = (1.0f64 / 16.0).exp2();
    for share in [2, 5, 20] {
        let most = whole.patches.len() as u64 / share;
        let found =
            client.patches(v1::PatchesRequest { max_patches: Some(most), ..asked(1.0) }).await.unwrap();
        assert!(found.patches.len() as u64 <= most);
        let f = found.header.factor;
        let Some(v1::tolerance::Kind::ErrorM(e)) = found.header.tolerance.unwrap().kind else { panic!() };
        assert_eq!(e, f);
        let tighter = client.patches(asked(f / next)).await.unwrap();
        assert!(f == 1.0 || tighter.patches.len() as u64 > most, "{most}: {} fit", tighter.patches.len());
        let most = bytes(&whole) / share;
        let found = client.patches(v1::PatchesRequest { max_bytes: Some(most), ..asked(0.0) }).await.unwrap();
        let used = bytes(&found);
        assert!(used <= most && found.header.factor > 1.0, "{used} of {most} bytes");
        assert!(used > most / 3, "{used} of {most} bytes");
    }
    let same = client.patches(v1::PatchesRequest { max_patches: Some(1 << 40), ..asked(0.0) }).await.unwrap();
    assert_eq!((same.header.factor, same.end.hash), (1.0, whole.end.hash));
    let one = v1::PatchesRequest { max_patches: Some(1), ..asked(1.0) };
    let refused = client.query().patches(one).await.unwrap_err();
    assert_eq!(refused.code(), Code::ResourceExhausted);
    assert!(refused.message().contains("coarsest"), "{refused}");
    server.stop().await.unwrap();
}

/// Checks that a difference leads from one version's answer to the other's. Returns it.
async fn leads(client: &Connection, e: f64, from: u64, to: u64) -> Patches {
    let request = v1::DifferenceRequest { tolerance: error_m(e), from, to, ..Default::default() };
    let d = client.difference(request).await.unwrap();
    let mut held = match from {
        0 => Patches::default(),
        at => client.patches(v1::PatchesRequest { at, ..asked(e) }).await.unwrap(),
    };
    let after = client.patches(v1::PatchesRequest { at: to, ..asked(e) }).await.unwrap();
    let gone: BTreeSet<Vec<u8>> = d.removed.chunks(16).map(<[u8]>::to_vec).collect();
    assert!(gone.is_subset(&ids(&held.patches)) && gone.is_disjoint(&ids(&d.patches)));
    held.patches.retain(|p| !gone.contains(&p.id[..]));
    for c in &d.changed {
        let p = held.patches.iter_mut().find(|p| p.id == c.id).unwrap();
        let was = (p.top_m, p.floor, p.survey);
        (p.top_m, p.floor, p.survey) = (c.top_m, c.floor, c.survey);
        assert_ne!((p.top_m, p.floor, p.survey), was);
    }
    held.patches.extend(d.patches.clone());
    let key = |m: &v1::MaskBlock| (m.survey, m.level, m.i, m.j);
    let drop: BTreeSet<_> = d.masks_removed.iter().chain(&d.masks).map(key).collect();
    held.masks.retain(|m| !drop.contains(&key(m)));
    held.masks.extend(d.masks.clone());
    held.masks.sort_by_key(key);
    held.patches.sort_by(|a, b| a.id.cmp(&b.id));
    let mut known = after.clone();
    known.patches.sort_by(|a, b| a.id.cmp(&b.id));
    assert_eq!(held.patches, known.patches, "{e} m, {from} to {to}");
    assert_eq!(held.masks, known.masks);
    assert_eq!((&d.end.hash, d.header.from), (&after.end.hash, from));
    assert!(from != to || (gone.is_empty() && drop.is_empty()));
    d
}

#[tokio::test]
async fn differences_lead_from_one_version_to_the_other() {
    let (server, client) = served().await;
    for e in [0.0, 5.0, 40.0] {
        for (from, to) in [(0, 1), (1, 2), (0, 2), (2, 1), (2, 2)] {
            leads(&client, e, from, to).await;
        }
    }
    server.stop().await.unwrap();
}

#[tokio::test]
async fn patches_of_a_survey_that_came_again_are_changed() {
    let folder = tempfile::tempdir().unwrap();
    let gone = Change::Remove { surveys: vec!["2004-10-04".into()], tile: None };
    let db = made(folder.path(), [survey("2004-10-04", 0.5), gone, survey("2004-10-04", 0.5)]);
    let server = serve(&db).await;
    let client = connect(&server).await;
    let d = leads(&client, 5.0, 1, 3).await;
    assert!(d.removed.is_empty() && d.patches.is_empty() && !d.changed.is_empty());
    assert_ne!(d.changed[0].survey, 1);
    server.stop().await.unwrap();
}

#[tokio::test]
async fn questions_that_are_none_are_refused_and_empty_ones_answered() {
    let (server, client) = served().await;
    let region = |xmin: f64, xmax: f64| {
        let kind = v1::region::Kind::Box(v1::Box { xmin, ymin: 0.0, xmax, ymax: 10.0 });
        Some(v1::Region { kind: Some(kind) })
    };
    let far = client.patches(v1::PatchesRequest { region: region(0.0, 9.0), ..asked(1.0) }).await.unwrap();
    assert!(far.patches.is_empty() && far.masks.is_empty() && far.end.patches == 0);
    let camera = |fov_deg| {
        let c = v1::Camera { look_at_x: 1.0, fov_deg, pixels: 1.0, ..Default::default() };
        Some(v1::Tolerance { kind: Some(v1::tolerance::Kind::Camera(c)) })
    };
    let bad = [
        v1::PatchesRequest { tolerance: None, ..asked(1.0) },
        asked(-1.0),
        asked(f64::NAN),
        v1::PatchesRequest { region: region(9.0, 0.0), ..asked(1.0) },
        v1::PatchesRequest { region: region(f64::NAN, 1.0), ..asked(1.0) },
        v1::PatchesRequest { blend: 77, ..asked(1.0) },
        v1::PatchesRequest { seams: -1, ..asked(1.0) },
        v1::PatchesRequest { max_bytes: Some(0), ..asked(1.0) },
        v1::PatchesRequest { tolerance: camera(f64::NAN), ..asked(1.0) },
        v1::PatchesRequest { tolerance: camera(45.0), ..asked(1.0) },
    ];
    for request in bad {
        let s = client.query().patches(request.clone()).await.unwrap_err();
        assert_eq!(s.code(), Code::InvalidArgument, "{request:?}: {s}");
        assert!(s.message().len() > 20, "{s}");
    }
    let gone = client.query().patches(v1::PatchesRequest { at: 99, ..asked(1.0) }).await.unwrap_err();
    assert_eq!(gone.code(), Code::NotFound, "{gone}");
    server.stop().await.unwrap();
}
