//! The acts of the demo.

use super::bundled::{Bundled, SURVEYS};
use crate::base::{Error, Result};
use crate::cli::output::{Output, bytes, count};
use crate::client::ingest::{Sending, upload};
use crate::client::view::{Opening, View};
use crate::client::{Address, Connection};
use crate::db::{Db, Options, Policy};
use crate::height::crs::Crs;
use crate::height::patch::Kind;
use crate::server::{Running, Settings, start};
use crate::wire::v1;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// A point on the growing dome, EPSG:26910.
const DOME: [f64; 2] = [562_660.0, 5_116_000.0];
/// The box that the mesh shows: xmin, ymin, xmax, ymax.
const DOME_BOX: [f64; 4] = [562_000.0, 5_115_300.0, 563_300.0, 5_116_600.0];
/// Tolerance of the open view, metres.
const VIEW_M: f64 = 5.0;
/// How long the open view may take to be told of a commit.
const TOLD_WITHIN: Duration = Duration::from_secs(60);

/// A server in this process, and a client of it.
struct Daemon {
    server: Running,
    client: Connection,
}

impl Daemon {
    /// Serves a new database.
    async fn new(path: &Path) -> Result<Daemon> {
        let options = Options { crs: Crs::from_epsg(26910)?, policy: Policy::Newest, patch: Kind::Bilinear };
        Db::create(path, &options)?;
        let server = start(Settings { listen: ([127, 0, 0, 1], 0).into(), ..Settings::new(path) }).await?;
        let address = Address { server: server.address.to_string(), ..Address::default() };
        Ok(Daemon { client: Connection::open(&address).await?, server })
    }

    async fn send(&self, survey: &Bundled) -> Result<v1::CommitReply> {
        let (header, rows) = survey.upload()?;
        upload(&self.client, header, rows, &Sending::default(), &mut |_| {}).await
    }

    async fn fingerprint(&self, at: u64) -> Result<String> {
        let found = self.client.catalog().fingerprint(v1::FingerprintRequest { at }).await;
        Ok(found.map_err(|s| self.client.failed(s))?.into_inner().fingerprint)
    }

    /// How many patches a question needs, and how many nodes of the tree were read for them.
    async fn patches(&self, tolerance: v1::Tolerance, at: u64) -> Result<(u64, u64)> {
        let asked = v1::PatchesRequest {
            tolerance: Some(tolerance),
            at,
            descriptors_only: true,
            explain: true,
            ..Default::default()
        };
        let failed = |s| self.client.failed(s);
        let mut replies = self.client.query().patches(asked).await.map_err(failed)?.into_inner();
        let mut found = (0, 0);
        while let Some(reply) = replies.message().await.map_err(failed)? {
            if let Some(v1::patches_reply::Kind::End(end)) = reply.kind {
                found = (end.patches, end.explanation.map_or(0, |e| e.nodes));
            }
        }
        Ok(found)
    }

    /// The height at a point, and its error.
    async fn height(&self, p: [f64; 2], at: u64) -> Result<Option<[f64; 2]>> {
        let header = v1::HeightsHeader { tolerance: Some(within(0.0)), at, ..Default::default() };
        let points: Vec<u8> = p.iter().flat_map(|v| v.to_le_bytes()).collect();
        let asked = v1::PointsRequest { header: Some(header), points: points.into() };
        let failed = |s| self.client.failed(s);
        let mut replies = self.client.heights().ask(asked).await.map_err(failed)?.into_inner();
        let reply = replies.message().await.map_err(failed)?.unwrap_or_default();
        let number =
            |b: &[u8]| b.get(..8).map(|b| f64::from_le_bytes(b.try_into().expect("8 bytes were cut")));
        let found = number(&reply.z).zip(number(&reply.error_m));
        Ok(found.filter(|(z, _)| !z.is_nan()).map(|(z, e)| [z, e]))
    }

    /// Fetches a file; returns what the server tells of it.
    async fn file(&self, asked: v1::FileRequest, path: &Path) -> Result<serde_json::Value> {
        let failed = |s| self.client.failed(s);
        let io = |e| Error::io(path, e);
        let mut chunks = self.client.export().file(asked).await.map_err(failed)?.into_inner();
        let mut file = std::fs::File::create(path).map_err(io)?;
        let mut told = String::new();
        while let Some(chunk) = chunks.message().await.map_err(failed)? {
            file.write_all(&chunk.data).map_err(io)?;
            told.push_str(&chunk.json);
        }
        Ok(serde_json::from_str(&told).unwrap_or_default())
    }
}

/// A constant tolerance.
fn within(error_m: f64) -> v1::Tolerance {
    v1::Tolerance { kind: Some(v1::tolerance::Kind::ErrorM(error_m)) }
}

/// Tells the story.
pub async fn tell(dir: &Path) -> Result<bool> {
    let mut out = Output::new();
    let surveys = dir.join("surveys");
    SURVEYS.iter().try_for_each(|b| b.unpack(&surveys))?;
    out.line("Mount St. Helens, Washington: the crater of 2000 at 10 m, three surveys of the growing dome in October 2004")?;
    out.line(
        "at 2 m on ragged footprints, and the whole crater again in June 2005 at 10 m (USGS, public domain).",
    )?;
    out.line("Policy 'newest': where surveys overlap, the later one is the ground.\n")?;

    let path = dir.join("helens");
    let daemon = Daemon::new(&path).await?;
    out.line(format!(
        "A server in this process listens on {}. A view is open at {VIEW_M} m error.",
        daemon.server.address
    ))?;
    let mut view =
        View::open(&daemon.client, Opening { tolerance: Some(within(VIEW_M)), ..Opening::default() }).await?;
    for b in &SURVEYS {
        arrive(&daemon, &mut view, b, &mut out).await?;
        out.show()?;
    }

    ask(&daemon, &mut view, &mut out).await?;
    out.show()?;
    same_in_any_order(&daemon, dir, &mut out).await?;
    out.show()?;
    draw(&daemon, dir, &mut out).await?;
    drop(view);
    daemon.server.stop().await?;

    let p = path.display();
    out.line("\nTry next:")?;
    out.line(format!("  terraquilt surveys {p}"))?;
    out.line(format!("  terraquilt heights {p} --error 0 562660,5116000 --explain"))?;
    out.line(format!(
        "  terraquilt serve {p}      # and in another terminal: terraquilt surveys --server 127.0.0.1:50051"
    ))?;
    out.line(format!("  terraquilt verify {p}"))?;
    out.line("  and on your own grids:")?;
    out.line("  terraquilt init mine --crs EPSG:32633 && terraquilt ingest mine FILE.tif --accuracy 0.5")?;
    out.end()
}

/// One survey is streamed in, and the open view is told of it.
async fn arrive(daemon: &Daemon, view: &mut View, survey: &Bundled, out: &mut Output) -> Result<()> {
    let began = Instant::now();
    let o = daemon.send(survey).await?;
    let sent = began.elapsed();
    out.line(format!(
        "{}  {:16} {:>7} posts, {:>6} void   {:>3} patches live, {:>3} dormant   {:.0} ms",
        survey.date,
        o.survey,
        count(o.posts),
        count(o.voids),
        o.live,
        o.dormant,
        sent.as_secs_f64() * 1e3
    ))?;
    for w in &o.warnings {
        out.line(format!("            note: {w}"))?;
    }
    let (mut come, mut gone, mut size) = (0, 0, 0);
    while view.set.version < o.version {
        let told = tokio::time::timeout(TOLD_WITHIN, view.next()).await;
        let told = told.map_err(|_| Error::invalid("demo", "the open view was not told of the commit"))??;
        (come, gone, size) = (come + told.added.len(), gone + told.removed.len(), size + told.bytes);
    }
    out.line(format!(
        "            the view is told: {come} patches come, {gone} go, {}; it holds {}",
        bytes(size as u64),
        view.set.patches.len()
    ))
}

/// Questions of an older version, and of every version.
async fn ask(daemon: &Daemon, view: &mut View, out: &mut Output) -> Result<()> {
    out.line("\nQuestions, asked of version 4, before the survey of 2005:")?;
    let (found, nodes) = daemon.patches(within(5.0), 4).await?;
    out.line(format!("  everything within 5 m: {found} patches, {nodes} tree nodes read"))?;
    let camera = v1::Camera {
        eye_x: 562_900.0,
        eye_y: 5_118_500.0,
        eye_z: 2600.0,
        look_at_x: 562_650.0,
        look_at_y: 5_115_900.0,
        look_at_z: 2050.0,
        fov_deg: 45.0,
        viewport_width: 1920,
        viewport_height: 1080,
        pixels: 1.0,
        far_m: 15_000.0,
    };
    let seen = v1::Tolerance { kind: Some(v1::tolerance::Kind::Camera(camera)) };
    let (found, nodes) = daemon.patches(seen, 4).await?;
    out.line(format!("  a camera north of the crater, 1 pixel: {found} patches, {nodes} tree nodes read"))?;

    let steps: u32 = 60;
    let (mut size, mut come) = (0, 0);
    for k in 0..=steps {
        let t = f64::from(k) / f64::from(steps);
        let moved = v1::Camera { eye_y: camera.eye_y - 600.0 * t, eye_z: camera.eye_z - 200.0 * t, ..camera };
        let seen = v1::Tolerance { kind: Some(v1::tolerance::Kind::Camera(moved)) };
        let number = view.steer(None, seen).await?;
        let told = loop {
            let told = view.next().await?;
            if told.answers >= number {
                break told;
            }
        };
        if k > 0 {
            (size, come) = (size + told.bytes, come + told.added.len());
        }
    }
    out.line(format!(
        "  the open view flies on with it, {steps} frames of 10 m: {:.1} patches and {} a frame",
        come as f64 / f64::from(steps),
        bytes(size as u64 / u64::from(steps))
    ))?;

    out.line(format!("  the height at {}, {} over time:", DOME[0], DOME[1]))?;
    let versions = daemon.client.catalog().list_versions(v1::ListVersionsRequest::default()).await;
    for v in versions.map_err(|s| daemon.client.failed(s))?.into_inner().versions {
        if let Some([z, error]) = daemon.height(DOME, v.number).await? {
            out.line(format!("    version {}: {z:8.2} m, error {error} m   ({})", v.number, v.action))?;
        }
    }
    Ok(())
}

/// The same surveys in reverse order, and one that leaves again.
async fn same_in_any_order(daemon: &Daemon, dir: &Path, out: &mut Output) -> Result<()> {
    out.line("\nThe state is a function of the set of surveys:")?;
    let forward = daemon.fingerprint(0).await?;
    let other = Daemon::new(&dir.join("helens-reversed")).await?;
    for b in SURVEYS.iter().rev() {
        other.send(b).await?;
    }
    let backward = other.fingerprint(0).await?;
    other.server.stop().await?;
    out.line(format!("  in order of time  {}", short(&forward)))?;
    out.line(format!("  in reverse order  {}", short(&backward)))?;
    same(&forward, &backward, "the reverse order gives another fingerprint")?;
    let four = daemon.fingerprint(4).await?;
    let asked = v1::RemoveRequest { surveys: vec!["crater-2005".into()], ..Default::default() };
    daemon.client.catalog().remove(asked).await.map_err(|s| daemon.client.failed(s))?;
    let removed = daemon.fingerprint(0).await?;
    out.line(format!("  before 2005 came  {}", short(&four)))?;
    out.line(format!("  after it left     {}", short(&removed)))?;
    same(&four, &removed, "removal left something behind")
}

fn short(fingerprint: &str) -> &str {
    fingerprint.get(..32).unwrap_or(fingerprint)
}

fn same(a: &str, b: &str, otherwise: &str) -> Result<()> {
    if a == b { Ok(()) } else { Err(Error::corrupt("demo", "fingerprint", otherwise)) }
}

/// A picture and a mesh.
async fn draw(daemon: &Daemon, dir: &Path, out: &mut Output) -> Result<()> {
    out.line("\nDrawn:")?;
    let picture = dir.join("helens-2004.png");
    let asked = v1::FileRequest {
        format: v1::file_request::Format::Png as i32,
        tolerance: Some(within(2.0)),
        ..Default::default()
    };
    daemon.file(asked, &picture).await?;
    out.line(format!(
        "  {}   shaded relief at 2 m error; red: small patches, blue: large ones",
        picture.display()
    ))?;
    let mesh = dir.join("dome-2004.glb");
    let [xmin, ymin, xmax, ymax] = DOME_BOX;
    let region = v1::region::Kind::Box(v1::Box { xmin, ymin, xmax, ymax });
    let asked = v1::FileRequest {
        format: v1::file_request::Format::Glb as i32,
        region: Some(v1::Region { kind: Some(region) }),
        tolerance: Some(within(4.0)),
        seams: v1::Seams::Off as i32,
        ..Default::default()
    };
    let told = daemon.file(asked, &mesh).await?;
    let number = |name: &str| told[name].as_f64().unwrap_or(f64::NAN);
    out.line(format!(
        "  {}   {} triangles, error {:.2} m (surface {:.2} certified + mesh {:.2} measured)",
        mesh.display(),
        count(told["triangles"].as_u64().unwrap_or(0)),
        number("error_m"),
        number("surface_error_m"),
        number("mesh_error_m")
    ))?;
    let info = daemon.client.catalog().info(v1::InfoRequest { sizes: true, ..Default::default() }).await;
    let info = info.map_err(|s| daemon.client.failed(s))?.into_inner();
    let info: serde_json::Value = serde_json::from_str(&info.json).unwrap_or_default();
    let path: PathBuf = dir.join("helens");
    out.line(format!(
        "  {}   the database: {}, version {}",
        path.display(),
        bytes(info["bytes"].as_u64().unwrap_or(0)),
        info["version"]
    ))
}
