//! Must show 1: surveys arrive while views move and clients ask. Every answer is written down with the version that it names, and
//! afterwards compared, bit for bit, with the same request to a database that was made without a server.

use super::support::{connect, serve};
use super::survey::{HELENS, Survey, grid_of, helens};
use prost::Message;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;
use terraquilt::base::date::Date;
use terraquilt::client::ingest::{Sending, upload};
use terraquilt::client::view::{Opening, View};
use terraquilt::client::{Connection, heights};
use terraquilt::db::query::{Area, Query, Tolerance};
use terraquilt::db::{Change, Db, Ingest, Options, Policy, Progress, Snapshot, fingerprint};
use terraquilt::format;
use terraquilt::height::crs::Crs;
use terraquilt::height::lod::cut::Camera;
use terraquilt::height::patch::Kind;
use terraquilt::height::surface::{Blend, Evaluation};
use terraquilt::wire::v1;

/// A survey as a file and what is said of it.
struct Said {
    file: PathBuf,
    name: String,
    accuracy_m: f64,
    date: String,
}

impl Said {
    fn upload(&self) -> Survey {
        let mut source = format::open(&self.file).unwrap();
        let (grid, rows) = grid_of(&mut *source);
        let header = v1::UploadHeader {
            operation: format!("upload of {}", self.name),
            name: self.name.clone(),
            accuracy_m: Some(self.accuracy_m),
            date: self.date.clone(),
            crs: source.info().crs.as_ref().unwrap().code.clone(),
            grids: vec![grid],
            ..Default::default()
        };
        Survey { header, grids: vec![rows] }
    }

    fn offline(&self, db: &Db) {
        let ingest = Ingest {
            name: Some(self.name.clone()),
            accuracy_m: Some(self.accuracy_m),
            date: Some(Date::parse(&self.date).unwrap()),
            ..Ingest::new(vec![format::open(&self.file).unwrap()])
        };
        let stop = AtomicBool::new(false);
        let progress = Progress { report: &|_, _| (), stop: &stop };
        db.change(Change::Ingest(ingest), None, false, &progress, &mut || {}).unwrap();
    }
}

/// A small generator (xorshift64*).
struct Random(u64);

impl Random {
    fn unit(&mut self) -> f64 {
        self.0 ^= self.0 >> 12;
        self.0 ^= self.0 << 25;
        self.0 ^= self.0 >> 27;
        (self.0.wrapping_mul(0x2545_f491_4f6c_dd1d) >> 11) as f64 / (1u64 << 53) as f64
    }

    fn between(&mut self, a: f64, b: f64) -> f64 {
        a + (b - a) * self.unit()
    }
}

/// A request, in words of both sides.
#[derive(Clone, Debug)]
enum Asked {
    Camera { eye: [f64; 3], look_at: [f64; 3], pixels: f64 },
    Box { sides: [f64; 4], error_m: f64 },
    Heights { points: Vec<[f64; 2]>, error_m: f64 },
}

fn wire_box([xmin, ymin, xmax, ymax]: [f64; 4]) -> v1::Region {
    v1::Region { kind: Some(v1::region::Kind::Box(v1::Box { xmin, ymin, xmax, ymax })) }
}

fn error(m: f64) -> v1::Tolerance {
    v1::Tolerance { kind: Some(v1::tolerance::Kind::ErrorM(m)) }
}

const FOV: f64 = 50.0;
const VIEWPORT: [u32; 2] = [800, 600];

impl Asked {
    /// A camera or a box somewhere.
    fn patches(r: &mut Random, world: &World) -> Asked {
        let [x0, y0, x1, y1] = world.bounds;
        let p = [r.between(x0, x1), r.between(y0, y1)];
        let q = [r.between(x0, x1), r.between(y0, y1)];
        if r.unit() < 0.6 {
            let z = world.z[1] + r.between(0.05, 1.0) * (x1 - x0) * 0.2;
            Asked::Camera {
                eye: [p[0], p[1], z],
                look_at: [q[0], q[1], world.z[0]],
                pixels: r.between(1.0, 8.0),
            }
        } else {
            let side = (x1 - x0) * r.between(0.05, 0.4);
            let sides = [p[0], p[1], p[0] + side, p[1] + side];
            Asked::Box { sides, error_m: world.coarse * r.between(0.1, 1.0) }
        }
    }

    fn heights(r: &mut Random, world: &World) -> Asked {
        let [x0, y0, x1, y1] = world.bounds;
        let points = (0..95).map(|_| [r.between(x0, x1), r.between(y0, y1)]).collect();
        let error_m = if r.unit() < 0.5 { 0.0 } else { world.coarse * r.unit() };
        Asked::Heights { points, error_m }
    }

    fn region(&self) -> Option<v1::Region> {
        match self {
            Asked::Box { sides, .. } => Some(wire_box(*sides)),
            _ => None,
        }
    }

    fn tolerance(&self) -> v1::Tolerance {
        match self {
            Asked::Camera { eye, look_at, pixels } => v1::Tolerance {
                kind: Some(v1::tolerance::Kind::Camera(v1::Camera {
                    eye_x: eye[0],
                    eye_y: eye[1],
                    eye_z: eye[2],
                    look_at_x: look_at[0],
                    look_at_y: look_at[1],
                    look_at_z: look_at[2],
                    fov_deg: FOV,
                    viewport_width: VIEWPORT[0],
                    viewport_height: VIEWPORT[1],
                    pixels: *pixels,
                    far_m: 0.0,
                })),
            },
            Asked::Box { error_m, .. } | Asked::Heights { error_m, .. } => error(*error_m),
        }
    }

    /// The answer of a version that no server has touched.
    fn offline(&self, s: &Snapshot) -> Digest {
        let (area, tolerance) = match self {
            Asked::Heights { points, error_m } => {
                let found = s.heights(points, &Tolerance::Constant(*error_m), Blend::Exact).unwrap();
                return of_heights(&found);
            }
            Asked::Camera { eye, look_at, pixels } => {
                let camera = Camera::new(*eye, *look_at, FOV, VIEWPORT, *pixels, None).unwrap();
                (Area::Everything, Tolerance::Camera(camera))
            }
            Asked::Box { sides, error_m } => (Area::Box(*sides), Tolerance::Constant(*error_m)),
        };
        let found = s.select(&Query { area, tolerance, how: Blend::Exact.into() }).unwrap();
        let patches = found.records.iter().map(|r| v1::Patch {
            handle: 0,
            id: r.id.0.to_vec().into(),
            survey: r.survey.0,
            level: u32::from(r.place.level),
            i: r.place.i,
            j: r.place.j,
            bot_m: r.bot,
            top_m: r.top,
            floor: r.floor,
            payload: s.payload(r).unwrap(),
        });
        let masks = s.masks(&found.region).unwrap();
        let masks = masks.into_iter().map(|m| v1::MaskBlock {
            survey: m.survey.0,
            level: u32::from(m.level),
            i: m.i,
            j: m.j,
            cells: m.cells,
        });
        of_patches(patches.collect(), masks.collect())
    }
}

/// A hash of an answer: all its numbers.
type Digest = [u8; 32];

fn of_patches(mut patches: Vec<v1::Patch>, mut masks: Vec<v1::MaskBlock>) -> Digest {
    patches.sort_by(|a, b| a.id.cmp(&b.id));
    masks.sort_by_key(|m| (m.survey, m.level, m.i, m.j));
    let mut h = blake3::Hasher::new();
    for p in &mut patches {
        p.handle = 0;
        h.update(&p.encode_to_vec());
    }
    for m in &masks {
        h.update(&m.encode_to_vec());
    }
    *h.finalize().as_bytes()
}

fn of_heights(found: &[Option<Evaluation>]) -> Digest {
    let mut h = blake3::Hasher::new();
    for e in found {
        let numbers = e.as_ref().map_or([f64::NAN; 4], |e| [e.z, e.error_m, e.accuracy_m, e.correction_m]);
        numbers.iter().for_each(|v| {
            h.update(&v.to_bits().to_le_bytes());
        });
        h.update(&e.as_ref().map_or([2, 2], |e| [u8::from(e.certified), u8::from(e.contradiction)]));
    }
    *h.finalize().as_bytes()
}

/// An answer that a client was given.
struct Answered {
    asked: Asked,
    version: u64,
    digest: Digest,
}

/// Where the surveys of a test lie.
struct World {
    bounds: [f64; 4],
    z: [f64; 2],
    /// A tolerance that leaves some patches, metres.
    coarse: f64,
}

/// Between two questions of a client that has `answered` so many: without optimisation arrivals and the check afterwards are
/// slow, and there must not be the more answers for it.
fn pause(answered: usize) -> Duration {
    if cfg!(debug_assertions) {
        Duration::from_millis(200) * (1 + answered as u32 / 10)
    } else {
        Duration::from_millis(10)
    }
}

/// A view that moves until told to stop.
async fn look(c: Connection, world: Arc<World>, seed: u64, stop: Arc<AtomicBool>) -> Vec<Answered> {
    let mut r = Random(seed);
    let mut next = Asked::patches(&mut r, &world);
    let opening = Opening { region: next.region(), tolerance: Some(next.tolerance()), ..Opening::default() };
    let mut view = View::open(&c, opening).await.unwrap();
    let (mut out, mut version, mut due): (Vec<Answered>, u64, u64) = (Vec::new(), 0, view.asked());
    let mut asked = next.clone();
    loop {
        let applied = view.next().await.unwrap();
        assert!(applied.version >= version, "a view went back from version {version} to {}", applied.version);
        version = applied.version;
        // Without a question it is the last one, answered in a newer version.
        assert!(applied.answers == 0 || applied.answers == due, "{applied:?}");
        if applied.answers == due {
            asked = next.clone();
        }
        let masks = view.set.masks.iter().map(|((survey, level, i, j), cells)| v1::MaskBlock {
            survey: *survey,
            level: *level,
            i: *i,
            j: *j,
            cells: cells.clone(),
        });
        let digest = of_patches(view.set.patches.values().cloned().collect(), masks.collect());
        out.push(Answered { asked: asked.clone(), version, digest });
        if applied.answers == due {
            if stop.load(Ordering::Relaxed) {
                return out;
            }
            tokio::time::sleep(pause(out.len())).await;
            next = Asked::patches(&mut r, &world);
            due = view.steer(next.region(), next.tolerance()).await.unwrap();
        }
    }
}

/// A client that asks, patches and heights in turn, until told to stop.
async fn ask(c: Connection, world: Arc<World>, seed: u64, stop: Arc<AtomicBool>) -> Vec<Answered> {
    let mut r = Random(seed);
    let (mut out, mut last) = (Vec::new(), 0);
    for k in 0.. {
        let (asked, version, digest) = if k % 2 == 0 {
            let asked = Asked::patches(&mut r, &world);
            let (version, digest) = patches(&c, &asked).await;
            (asked, version, digest)
        } else {
            let asked = Asked::heights(&mut r, &world);
            let Asked::Heights { points, .. } = &asked else { unreachable!("heights were asked") };
            let header =
                v1::HeightsHeader { tolerance: Some(asked.tolerance()), ..v1::HeightsHeader::default() };
            let (version, found) = heights::points(&c, header, points).await.unwrap();
            (asked, version, of_heights(&found))
        };
        assert!(version >= last, "an answer went back from version {last} to {version}");
        last = version;
        out.push(Answered { asked, version, digest });
        if stop.load(Ordering::Relaxed) {
            break;
        }
        tokio::time::sleep(pause(out.len())).await;
    }
    out
}

async fn patches(c: &Connection, asked: &Asked) -> (u64, Digest) {
    use v1::patches_reply::Kind;
    let request = v1::PatchesRequest {
        region: asked.region(),
        tolerance: Some(asked.tolerance()),
        ..v1::PatchesRequest::default()
    };
    let mut stream = c.query().patches(request).await.unwrap().into_inner();
    let (mut version, mut patches, mut masks, mut ended) = (0, Vec::new(), Vec::new(), false);
    while let Some(m) = stream.message().await.unwrap() {
        match m.kind.unwrap() {
            Kind::Header(h) => version = h.ground.unwrap().version,
            Kind::Part(p) => {
                patches.extend(p.patches);
                masks.extend(p.masks);
            }
            Kind::End(e) => {
                assert_eq!(e.patches, patches.len() as u64);
                ended = true;
            }
        }
    }
    assert!(ended, "the stream ended early");
    (version, of_patches(patches, masks))
}

/// Surveys arrive at a server while `views` views move and `clients` clients ask; all answers are compared with those of a
/// database to which the same surveys came without a server.
async fn linearisable(crs: &str, said: Vec<Said>, coarse: f64, [views, clients]: [u64; 2]) {
    let folder = tempfile::tempdir().unwrap();
    let options = || Options { crs: Crs::parse(crs).unwrap(), policy: Policy::Newest, patch: Kind::Bilinear };
    let db = Db::create(&folder.path().join("served"), &options()).unwrap();
    let alone = Db::create(&folder.path().join("alone"), &options()).unwrap();
    let (said, alone) = tokio::task::spawn_blocking(move || {
        said.iter().for_each(|s| s.offline(&alone));
        (said, alone)
    })
    .await
    .unwrap();
    let last = alone.snapshot(None).unwrap();
    let world = Arc::new(World { bounds: last.bounds().unwrap(), z: last.z_range().unwrap(), coarse });

    let server = serve(&db).await;
    let stop = Arc::new(AtomicBool::new(false));
    let mut tasks = Vec::new();
    for k in 0..views {
        let c = connect(&server).await;
        tasks.push(tokio::spawn(look(c, world.clone(), 1000 + k, stop.clone())));
    }
    for k in 0..clients {
        let c = connect(&server).await;
        tasks.push(tokio::spawn(ask(c, world.clone(), 2000 + k, stop.clone())));
    }
    let c = connect(&server).await;
    for (k, s) in said.iter().enumerate() {
        tokio::time::sleep(Duration::from_millis(100)).await;
        let s = s.upload();
        let done = upload(&c, s.header.clone(), s.rows(), &Sending::default(), &mut |_| {}).await.unwrap();
        assert_eq!(done.version, k as u64 + 1);
    }
    tokio::time::sleep(Duration::from_millis(300)).await;
    stop.store(true, Ordering::Relaxed);
    let mut answers = Vec::new();
    for t in tasks {
        answers.extend(t.await.unwrap());
    }
    server.stop().await.unwrap();

    let (counts, answers) = tokio::task::spawn_blocking(move || {
        assert_eq!(fingerprint(&db.snapshot(None).unwrap()).unwrap(), fingerprint(&last).unwrap());
        let versions: Vec<Snapshot> =
            (0..=said.len() as u64).map(|v| alone.snapshot(Some(v)).unwrap()).collect();
        let mut counts = vec![0u64; versions.len()];
        for a in &answers {
            let s = &versions[a.version as usize];
            assert_eq!(a.digest, a.asked.offline(s), "version {}: {:?}", a.version, a.asked);
            counts[a.version as usize] += 1;
        }
        (counts, answers.len())
    })
    .await
    .unwrap();
    println!("{crs}: {answers} answers, all as without a server; by version {counts:?}");
    assert!(counts.iter().filter(|n| **n > 0).count() > 2, "few versions were seen: {counts:?}");
}

fn st_helens() -> Vec<Said> {
    let said = |(file, name, date, accuracy_m): &(&str, &str, &str, f64)| Said {
        file: helens(file),
        name: name.to_string(),
        accuracy_m: *accuracy_m,
        date: date.to_string(),
    };
    HELENS.iter().map(said).collect()
}

/// The grids of the kit, in four systems, as its manifest describes them.
fn kit() -> Option<Vec<Said>> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data/kit");
    let Ok(manifest) = std::fs::read_to_string(folder.join("kit.json")) else {
        assert!(std::env::var_os("TERRAQUILT_REQUIRE_SHARED").is_none(), "{} is absent", folder.display());
        println!("shared data absent: skipped (kit)");
        return None;
    };
    let manifest: serde_json::Value = serde_json::from_str(&manifest).unwrap();
    let said = |s: &serde_json::Value| {
        let file = s["file"].as_str().unwrap();
        Said {
            file: folder.join(file),
            name: file.trim_end_matches(".tif").to_string(),
            accuracy_m: s["vertical_accuracy_m"].as_f64().unwrap(),
            date: s["date"].as_str().unwrap().to_string(),
        }
    };
    Some(manifest["surveys"].as_array().unwrap().iter().map(said).collect())
}

#[tokio::test(flavor = "multi_thread")]
async fn st_helens_arrives_while_views_move_and_clients_ask() {
    linearisable("EPSG:26910", st_helens(), 20.0, [8, 4]).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn three_grids_of_the_kit_arrive_while_views_move_and_clients_ask() {
    let Some(mut said) = kit() else { return };
    said.retain(|s| ["k05", "k09", "k10"].iter().any(|k| s.name.starts_with(k)));
    assert_eq!(said.len(), 3);
    linearisable("EPSG:32611", said, 60.0, [8, 4]).await;
}

/// `cargo test --release --test daemon the_kit_and_st_helens -- --ignored --nocapture`
#[tokio::test(flavor = "multi_thread")]
#[ignore = "minutes without optimisation; the command is in its comment"]
async fn the_kit_and_st_helens_arrive_at_two_servers_while_views_move_and_clients_ask() {
    let Some(said) = kit() else { return };
    assert_eq!(said.len(), 11);
    tokio::join!(
        linearisable("EPSG:32611", said, 60.0, [4, 2]),
        linearisable("EPSG:26910", st_helens(), 20.0, [4, 2]),
    );
}
