//! Views: what clients hold is what the database would answer, whatever moves, arrives, leaves or breaks.

/// Corrections of seams in views.
mod bent;
/// The laws of differences over random steps, arrivals and removals, without a network.
mod laws;
/// Broken connections: coming back, taking over, sessions that are gone.
mod sessions;
/// Streams: steering, commits, slow clients, bad questions.
mod streams;

use crate::worlds::{Grid, Random, Scratch, change, ground};
use std::collections::BTreeMap;
use std::time::Duration;
use terraquilt::client::view::{Opening, Set, View};
use terraquilt::client::{Address, Connection};
use terraquilt::db::query::Query;
use terraquilt::db::{Change, Policy, Snapshot};
use terraquilt::height::source::Affine;
use terraquilt::server::{Running, Settings, start};
use terraquilt::wire::v1;

/// Where the worlds of these tests lie.
const MIDDLE: [f64; 2] = [500_000.0, 4_000_000.0];

/// What is known of a patch by its id: survey, top, floor.
type Known = BTreeMap<[u8; 16], (u32, u32, bool)>;

/// What the database answers.
fn answered(s: &Snapshot, q: &Query) -> Known {
    let records = s.select(q).unwrap().records;
    records.iter().map(|r| (r.id.0, (r.survey.0, r.top.to_bits(), r.floor))).collect()
}

/// What a client holds.
fn held(set: &Set) -> Known {
    let one =
        |p: &v1::Patch| (p.id.as_ref().try_into().expect("16 bytes"), (p.survey, p.top_m.to_bits(), p.floor));
    set.patches.values().map(one).collect()
}

fn boxed(b: [f64; 4]) -> v1::Region {
    let b = v1::Box { xmin: b[0], ymin: b[1], xmax: b[2], ymax: b[3] };
    v1::Region { kind: Some(v1::region::Kind::Box(b)) }
}

fn constant(error_m: f64) -> v1::Tolerance {
    v1::Tolerance { kind: Some(v1::tolerance::Kind::ErrorM(error_m)) }
}

/// A camera that looks from a point `h` metres high towards an angle.
fn camera(eye: [f64; 2], h: f64, angle: f64) -> v1::Camera {
    v1::Camera {
        eye_x: eye[0],
        eye_y: eye[1],
        eye_z: 600.0 + h,
        look_at_x: eye[0] + angle.cos() * 100.0,
        look_at_y: eye[1] + angle.sin() * 100.0,
        look_at_z: 560.0 + h,
        fov_deg: 50.0,
        viewport_width: 800,
        viewport_height: 600,
        pixels: 2.0,
        far_m: 0.0,
    }
}

fn through(c: v1::Camera) -> v1::Tolerance {
    v1::Tolerance { kind: Some(v1::tolerance::Kind::Camera(c)) }
}

/// A survey of hills: `posts` x `posts`, its north-west corner `at` from the middle.
fn hills(name: &str, at: [f64; 2], posts: usize, step: f64, precedence: i64) -> Grid {
    let affine = Affine {
        origin: [MIDDLE[0] + at[0], MIDDLE[1] + at[1]],
        col_step: [step, 0.0],
        row_step: [0.0, -step],
    };
    let height = |k: usize| {
        let (i, j) = ((k % posts) as f64, (k / posts) as f64);
        ground(at[0] + i * step, at[1] - j * step).round() as f32
    };
    Grid {
        name: name.into(),
        cols: posts,
        rows: posts,
        z: (0..posts * posts).map(height).collect(),
        affine,
        accuracy: 0.5,
        precedence: Some(precedence),
        date: None,
    }
}

/// A server over a scratch database.
struct World {
    scratch: Scratch,
    server: Running,
}

impl World {
    async fn of(grids: &[Grid], with: impl FnOnce(&mut Settings)) -> World {
        let scratch = Scratch::new(Policy::Accuracy);
        grids.iter().for_each(|g| {
            scratch.ingest(g);
        });
        let mut settings = Settings { listen: ([127, 0, 0, 1], 0).into(), ..Settings::new(scratch.path()) };
        with(&mut settings);
        let server = start(settings).await.expect("a free port");
        World { scratch, server }
    }

    async fn connect(&self) -> Connection {
        let address = Address { server: self.server.address.to_string(), ..Address::default() };
        Connection::open(&address).await.expect("the server listens")
    }

    /// Commits, and lets the server know at once.
    fn commit(&self, c: Change) {
        change(&self.scratch.db, c).unwrap();
        self.server.state().live.look().unwrap();
    }

    fn ingest(&self, g: &Grid) {
        self.commit(Change::Ingest(g.ingest()));
    }

    fn remove(&self, name: &str) {
        self.commit(Change::Remove { surveys: vec![name.into()], tile: None });
    }

    /// What the newest version answers to the region and tolerance of a box question.
    fn answers(&self, b: [f64; 4], error_m: f64) -> Known {
        let query = Query {
            area: terraquilt::db::query::Area::Box(b),
            tolerance: terraquilt::db::query::Tolerance::Constant(error_m),
            how: terraquilt::height::surface::Blend::Exact.into(),
        };
        answered(&self.server.state().live.newest(), &query)
    }
}

/// The window that the tests look through, and its tolerance.
const WINDOW: [f64; 4] = [MIDDLE[0] + 20.0, MIDDLE[1] - 160.0, MIDDLE[0] + 160.0, MIDDLE[1] - 20.0];

/// A window that moves and stays over the hills.
fn moved(r: &mut Random) -> [f64; 4] {
    let (x, y) = (r.unit() * 200.0, r.unit() * 200.0);
    [MIDDLE[0] + x, MIDDLE[1] - y - 120.0, MIDDLE[0] + x + 120.0, MIDDLE[1] - y]
}

fn through_window() -> Opening {
    Opening { region: Some(boxed(WINDOW)), tolerance: Some(constant(1.0)), ..Opening::default() }
}

/// Fails if nothing comes soon.
async fn next(view: &mut View) -> terraquilt::base::Result<terraquilt::client::view::Applied> {
    tokio::time::timeout(Duration::from_secs(60), view.next()).await.expect("the server answers in time")
}
