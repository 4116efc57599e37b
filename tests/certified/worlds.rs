//! Worlds to ask: random ones, the survey kit, Mount St. Helens; and the tolerances they are asked with.

use super::reference::World;
use crate::support::{Grid, Random, Scratch, change, random_grid, shared};
use terraquilt::base::date::Date;
use terraquilt::db::query::{Query, Tolerance};
use terraquilt::db::{Change, Db, Ingest, Options, Policy};
use terraquilt::format;
use terraquilt::height::crs::Crs;
use terraquilt::height::lod::cut::Camera;
use terraquilt::height::patch::Kind;
use terraquilt::height::source::Window;
use terraquilt::height::surface::Blend;

/// A tolerance, and its value by the formula of section 5.3.
#[derive(Clone, Debug)]
pub enum Ask {
    Metres(f64),
    Eye { eye: [f64; 3], look: [f64; 3], fov: f64, viewport: [u32; 2], pixels: f64 },
}

impl Ask {
    pub fn tolerance(&self) -> Tolerance {
        match *self {
            Ask::Metres(c) => Tolerance::Constant(c),
            Ask::Eye { eye, look, fov, viewport, pixels } => {
                Tolerance::Camera(Camera::new(eye, look, fov, viewport, pixels, None).unwrap())
            }
        }
    }

    pub fn query(&self, region: Option<[f64; 4]>) -> Query {
        Query { area: region.into(), tolerance: self.tolerance(), how: Blend::Exact.into() }
    }

    /// Allowed error at a point over terrain between two heights.
    pub fn at(&self, p: [f64; 2], z: [f64; 2]) -> f64 {
        match *self {
            Ask::Metres(c) => c,
            Ask::Eye { eye, look, fov, viewport, pixels } => {
                let d = [0, 1, 2].map(|k| look[k] - eye[k]);
                let flat = (d[0] * d[0] + d[1] * d[1]).sqrt();
                let alpha = (-d[2]).atan2(flat);
                let q = [p[0] - eye[0], p[1] - eye[1]];
                let x = (q[0] * d[0] + q[1] * d[1]) / flat;
                let y = (q[0] * d[1] - q[1] * d[0]) / flat;
                let s = alpha.sin().abs();
                let h = eye[2] - if d[2] < 0.0 { z[1] } else { z[0] };
                // The near plane of a camera that sees 100 km is at 1 m.
                let w = (x * alpha.cos() + h * alpha.sin()).max(1.0);
                let focal = f64::from(viewport[1]) / 2.0 / (fov / 2.0).to_radians().tan();
                let rho = (x * x + y * y * s * s).sqrt();
                let delta = pixels * w * w / (focal * rho + pixels * s * w);
                if delta.is_nan() { f64::INFINITY } else { delta }
            }
        }
    }
}

/// Five errors, a level camera and one pitched down, over the bounds of a world.
pub fn asks(world: &World) -> Vec<Ask> {
    let b = world.snapshot.bounds().unwrap();
    let (w, h) = (b[2] - b[0], b[3] - b[1]);
    let at = |s: f64, t: f64, z: f64| [b[0] + s * w, b[1] + t * h, z];
    let top = world.z[1];
    let eye = |eye: [f64; 3], look: [f64; 3], pixels: f64| {
        let viewport = [1280, 720];
        Ask::Eye { eye, look, fov: 50.0, viewport, pixels }
    };
    let mut all: Vec<Ask> = [0.0, 1.0, 5.0, 20.0, 100.0].map(Ask::Metres).into();
    // Tolerances from centimetres to tens of metres over any of the worlds.
    let pixels = (20_000.0 / w.max(h)).max(1.0);
    all.push(eye(at(-0.02, -0.02, top), at(0.9, 0.7, top), 0.3 * pixels));
    all.push(eye(at(0.3, 0.2, top + 0.2 * w), at(0.5, 0.6, world.z[0]), 1.2 * pixels));
    all
}

/// A random world of `count` surveys, some of them replaced by others.
pub fn random(r: &mut Random, count: usize, posts_max: usize, kind: Kind) -> World {
    let s = Scratch::of(Policy::Accuracy, kind);
    let grids: Vec<Grid> = (0..count).map(|k| random_grid(r, &format!("s{k}"), posts_max)).collect();
    grids.iter().for_each(|g| {
        s.ingest(g);
    });
    of(&s, &grids).at_home(s.folder)
}

/// The world of a database and the grids that are in it.
pub fn of(s: &Scratch, grids: &[Grid]) -> World {
    World::new(s.db.snapshot(None).unwrap(), grids, true)
}

/// A file with its name, accuracy and date.
type File = (&'static str, &'static str, f64, &'static str);

/// Grids in UTM from the kit, as `kit.json` states them.
const KIT: [File; 3] = [
    ("k05", "kit/k05_rot17_utm11.tif", 5.0, "2008-08-01"),
    ("k06", "kit/k06_utm11_holes.tif", 5.0, "2010-09-01"),
    ("k09", "kit/k09_flight_strip.tif", 2.0, "2016-06-15"),
];

/// The crater and its growing dome; the accuracies are ours.
const HELENS: [File; 6] = [
    ("2000-09-25", "overlap/st_helens/survey_2000-09-25_native.tif", 2.0, "2000-09-25"),
    ("2004-10-04", "overlap/st_helens/survey_2004-10-04_native.tif", 0.5, "2004-10-04"),
    ("2004-10-11", "overlap/st_helens/survey_2004-10-11_native.tif", 0.5, "2004-10-11"),
    ("2004-10-13", "overlap/st_helens/survey_2004-10-13_native.tif", 0.5, "2004-10-13"),
    ("2004-11-04", "overlap/st_helens/crater_2004-11-04_10m.tif", 2.0, "2004-11-04"),
    ("2005-06-15", "overlap/st_helens/crater_2005-06-15_10m.tif", 2.0, "2005-06-15"),
];

pub fn kit(policy: Policy) -> Option<World> {
    kit_of(policy, Kind::Bilinear)
}

pub fn kit_of(policy: Policy, kind: Kind) -> Option<World> {
    real(&KIT, 32611, policy, kind)
}

/// `leave_out`: the last files, whole craters, hide the domes.
pub fn helens(policy: Policy, leave_out: usize) -> Option<World> {
    real(&HELENS[..HELENS.len() - leave_out], 26910, policy, Kind::Bilinear)
}

/// One survey of the kit alone.
pub fn holes_alone() -> Option<World> {
    real(&KIT[1..2], 32611, Policy::Accuracy, Kind::Bilinear)
}

fn real(files: &[File], epsg: u32, policy: Policy, patch: Kind) -> Option<World> {
    let folder = tempfile::tempdir().unwrap();
    let db =
        Db::create(&folder.path().join("db"), &Options { crs: Crs::from_epsg(epsg).unwrap(), policy, patch })
            .unwrap();
    let mut grids = Vec::new();
    for (name, file, accuracy, date) in files {
        let path = shared(file)?;
        let mut source = format::open(&path).unwrap();
        let (cols, rows) = (source.info().cols as usize, source.info().rows as usize);
        let samples = source.read(Window { col: 0, row: 0, cols, rows }).unwrap();
        let kind = source.info().sample_type;
        let each = samples.data.chunks_exact(kind.bytes()).zip(&samples.valid);
        let z = each.map(|(b, ok)| if *ok == 1 { kind.value(b) as f32 } else { f32::NAN }).collect();
        let affine = source.info().affine.unwrap();
        let date = Some(Date::parse(date).unwrap());
        let g = Grid {
            name: name.to_string(),
            cols,
            rows,
            z,
            affine,
            accuracy: *accuracy,
            precedence: None,
            date,
        };
        let ingest = Ingest { name: Some(g.name.clone()), ..g.tiles_of(vec![source]) };
        change(&db, Change::Ingest(ingest)).unwrap();
        grids.push(g);
    }
    Some(World::new(db.snapshot(None).unwrap(), &grids, false).at_home(folder))
}
