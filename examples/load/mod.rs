//! A server in a process of its own, and ground for it: what `latency` and `soak` share.

use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use terraquilt::base::{Error, Result};
use terraquilt::client::ingest::{InMemory, Sending, grid_of, upload};
use terraquilt::client::{Address, Connection};
use terraquilt::db::{Db, Options, Policy};
use terraquilt::format;
use terraquilt::height::crs::Crs;
use terraquilt::height::patch::Kind;
use terraquilt::height::source::Window;
use terraquilt::server::{Settings, start};
use terraquilt::wire::v1;

/// The word by which a program of these starts itself as a server.
pub const SERVE: &str = "serve-here";

/// Serves until the process is killed. Says on standard output where.
pub fn serve(db: &str) -> Result<()> {
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .enable_all()
        .build()
        .map_err(|e| Error::invalid("threads", e))?;
    runtime.block_on(async {
        let settings = Settings { listen: ([127, 0, 0, 1], 0).into(), ..Settings::new(db) };
        let running = start(settings).await?;
        println!("{}", running.address);
        std::future::pending().await
    })
}

/// A server in a process of its own; killed when dropped.
pub struct Server {
    child: Child,
    pub address: String,
}

impl Server {
    pub fn start(db: &Path) -> Result<Server> {
        let io = |e| Error::invalid("the server's process", e);
        let program = std::env::current_exe().map_err(io)?;
        let mut child =
            Command::new(program).arg(SERVE).arg(db).stdout(Stdio::piped()).spawn().map_err(io)?;
        let mut address = String::new();
        if let Some(out) = child.stdout.take() {
            BufReader::new(out).read_line(&mut address).map_err(io)?;
        }
        Ok(Server { child, address: address.trim().to_string() })
    }

    pub fn id(&self) -> u32 {
        self.child.id()
    }

    pub async fn connect(&self) -> Result<Connection> {
        Connection::open(&Address { server: self.address.clone(), ..Address::default() }).await
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// An empty database in UTM 11, policy newest.
pub fn create(folder: &Path) -> Result<Db> {
    let options = Options { crs: Crs::from_epsg(32611)?, policy: Policy::Newest, patch: Kind::Bilinear };
    Db::create(folder, &options)
}

/// A survey as it is sent.
#[derive(Clone)]
pub struct Survey {
    pub header: v1::UploadHeader,
    rows: Vec<u8>,
}

/// Dates of the ground that is there first and of what arrives later.
const OLD: &str = "2020-01-01";
const NEW: &str = "2024-01-01";

/// West and north border of the made-up ground.
pub const CORNER: [f64; 2] = [300_000.0, 4_200_000.0];

impl Survey {
    /// `side` x `side` posts of made-up mountains, `step` m apart; the first lies at `offset` m to the east and south of
    /// [`CORNER`]. Surveys of other `seed` differ by some decimetres.
    pub fn mountains(name: &str, side: u64, step: f64, offset: [f64; 2], seed: u64) -> Survey {
        let mut rows = Vec::with_capacity((side * side * 4) as usize);
        for j in 0..side {
            for i in 0..side {
                let (x, y) = (offset[0] + i as f64 * step, offset[1] + j as f64 * step);
                let z = mountain(x, y) + 0.3 * noise(i as f64 + 0.5, j as f64 + 0.5, seed + 100);
                rows.extend_from_slice(&((z * 100.0).round() as f32 / 100.0).to_le_bytes());
            }
        }
        let grid = v1::Grid {
            name: format!("{name}.grid"),
            cols: side,
            rows: side,
            sample_type: v1::SampleType::Float32 as i32,
            x: CORNER[0] + offset[0],
            y: CORNER[1] - offset[1],
            col_dx: step,
            row_dy: -step,
            ..v1::Grid::default()
        };
        Survey { header: header(name, if seed == 0 { OLD } else { NEW }, grid), rows }
    }

    /// A file, whole.
    pub fn of_file(path: &Path) -> Result<Survey> {
        let mut source = format::open(path)?;
        let info = source.info().clone();
        let all = Window { col: 0, row: 0, cols: info.cols as usize, rows: info.rows as usize };
        let rows = source.read(all)?.data;
        let grid = grid_of(&info)?;
        Ok(Survey { header: header("file", OLD, grid), rows })
    }

    /// The same samples as a survey of another name.
    pub fn named(&self, name: &str) -> Survey {
        let header = header(name, &self.header.date, self.header.grids[0].clone());
        Survey { header, rows: self.rows.clone() }
    }

    pub async fn send(&self, c: &Connection) -> Result<v1::CommitReply> {
        let row_bytes = self.header.grids.iter().map(|g| g.row_bytes().unwrap_or(0) as usize).collect();
        let rows = InMemory { grids: vec![self.rows.clone()], row_bytes };
        upload(c, self.header.clone(), rows, &Sending::default(), &mut |_| {}).await
    }
}

fn header(name: &str, date: &str, grid: v1::Grid) -> v1::UploadHeader {
    v1::UploadHeader {
        operation: format!("{name} of {:?}", std::time::SystemTime::now()),
        name: name.into(),
        accuracy_m: Some(0.5),
        date: date.into(),
        grids: vec![grid],
        ..v1::UploadHeader::default()
    }
}

/// Value noise in [-1, 1] over unit cells.
fn noise(x: f64, y: f64, seed: u64) -> f64 {
    let (i, j) = (x.floor(), y.floor());
    let at = |a: f64, b: f64| {
        let mut h =
            (a as i64 as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15) ^ (b as i64 as u64).rotate_left(32) ^ seed;
        h = (h ^ (h >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        h = (h ^ (h >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((h ^ (h >> 31)) >> 11) as f64 / (1u64 << 52) as f64 - 1.0
    };
    let ease = |t: f64| t * t * (3.0 - 2.0 * t);
    let (u, v) = (ease(x - i), ease(y - j));
    let row = |b: f64| at(i, b) * (1.0 - u) + at(i + 1.0, b) * u;
    row(j) * (1.0 - v) + row(j + 1.0) * v
}

/// Mountains some two kilometres high: ten octaves, the finest 12 m long.
fn mountain(x: f64, y: f64) -> f64 {
    let (mut z, mut length, mut height) = (2000.0, 6400.0, 700.0);
    for octave in 0..10 {
        z += height * noise(x / length, y / length, octave);
        (length, height) = (length / 2.0, height * 0.46);
    }
    z
}

/// A camera that flies over a square of ground: from above one place, looking ahead, `far` m far, 1 px.
pub fn camera(at: [f64; 2], ahead: [f64; 2], z: f64, far: f64) -> v1::Tolerance {
    let camera = v1::Camera {
        eye_x: at[0],
        eye_y: at[1],
        eye_z: z,
        look_at_x: at[0] + 1000.0 * ahead[0],
        look_at_y: at[1] + 1000.0 * ahead[1],
        look_at_z: z - 20.0,
        fov_deg: 45.0,
        viewport_width: 1280,
        viewport_height: 720,
        pixels: 1.0,
        far_m: far,
    };
    v1::Tolerance { kind: Some(v1::tolerance::Kind::Camera(camera)) }
}

/// The same tolerance everywhere.
pub fn constant(error_m: f64) -> v1::Tolerance {
    v1::Tolerance { kind: Some(v1::tolerance::Kind::ErrorM(error_m)) }
}

/// A flight in a circle around the middle of a box `[xmin, ymin, xmax, ymax]`.
#[derive(Clone, Copy)]
pub struct Flight {
    middle: [f64; 2],
    radius: f64,
    z: f64,
    /// Angle at the start, and of a frame; radians.
    start: f64,
    turn: f64,
}

impl Flight {
    /// The `k`-th of several, `step` m a frame.
    pub fn new(ground: &v1::Ground, k: usize, step: f64) -> Flight {
        let b = ground.bounds.unwrap_or_default();
        let side = (b.xmax - b.xmin).min(b.ymax - b.ymin);
        let radius = side * (0.2 + 0.05 * (k % 5) as f64);
        Flight {
            middle: [(b.xmin + b.xmax) / 2.0, (b.ymin + b.ymax) / 2.0],
            radius,
            z: ground.z_max() + 300.0,
            start: k as f64 * 2.399,
            turn: step / radius * if k.is_multiple_of(2) { 1.0 } else { -1.0 },
        }
    }

    pub fn at(&self, frame: u64) -> v1::Tolerance {
        let a = self.start + self.turn * frame as f64;
        let ahead = [-a.sin() * self.turn.signum(), a.cos() * self.turn.signum()];
        let at = [self.middle[0] + self.radius * a.cos(), self.middle[1] + self.radius * a.sin()];
        camera(at, ahead, self.z, 15_000.0)
    }
}

/// What is fixed of the database, as it is now.
pub async fn ground(c: &Connection) -> Result<v1::Ground> {
    let ask = v1::PatchesRequest {
        tolerance: Some(constant(1e9)),
        descriptors_only: true,
        ..v1::PatchesRequest::default()
    };
    let mut stream = c.query().patches(ask).await.map_err(|s| c.failed(s))?.into_inner();
    let mut found = None;
    while let Some(m) = stream.message().await.map_err(|s| c.failed(s))? {
        if let Some(v1::patches_reply::Kind::Header(h)) = m.kind {
            found = h.ground;
        }
    }
    found.ok_or_else(|| Error::invalid("server", "sent no header"))
}
