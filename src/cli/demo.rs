//! `demo`: the whole story on real surveys of Mount St. Helens that are part of the program.

use super::export::write_file;
use super::ingest::carry_out;
use super::output::{Output, bytes, count};
use crate::base::date::Date;
use crate::base::{Error, Result, limits};
use crate::db::query::{Area, Query, Tolerance, difference};
use crate::db::{self, Change, Db, Ingest, Options, Policy, Snapshot};
use crate::export::{FileRequest, Form, Packing, Place, Written, write_surface};
use crate::format;
use crate::height::crs::Crs;
use crate::height::lod::cut::Camera;
use crate::height::patch::Kind;
use crate::height::surface::{Blend, How, Seams};
use clap::Args;
use std::path::{Path, PathBuf};

/// The whole story on bundled real surveys: ingest, replace, ask, draw, remove
#[derive(Args)]
#[command(after_help = "Example:\n  terraquilt demo /tmp/helens")]
pub struct Demo {
    /// Folder for the database, the pictures and the mesh
    #[arg(default_value = "terraquilt-demo")]
    dir: PathBuf,
}

/// A survey that comes with the program (USGS Open-File Report 2008-1169, public domain).
struct Bundled {
    file: &'static str,
    name: &'static str,
    date: &'static str,
    accuracy_m: f64,
    bytes: &'static [u8],
}

macro_rules! bundled {
    ($file:literal, $name:literal, $date:literal, $accuracy:literal) => {
        Bundled {
            file: $file,
            name: $name,
            date: $date,
            accuracy_m: $accuracy,
            bytes: include_bytes!(concat!("../../tests/data/st_helens/", $file)),
        }
    };
}

const SURVEYS: [Bundled; 5] = [
    bundled!("survey_2000-09-25_native.tif", "crater-2000", "2000-09-25", 2.0),
    bundled!("survey_2004-10-04_native.tif", "dome-2004-10-04", "2004-10-04", 0.5),
    bundled!("survey_2004-10-11_native.tif", "dome-2004-10-11", "2004-10-11", 0.5),
    bundled!("survey_2004-10-13_native.tif", "dome-2004-10-13", "2004-10-13", 0.5),
    bundled!("crater_2005-06-15_10m.tif", "crater-2005", "2005-06-15", 2.0),
];

/// A point on the growing dome, EPSG:26910.
const DOME: [f64; 2] = [562_660.0, 5_116_000.0];
/// The box that the mesh shows.
const DOME_BOX: [f64; 4] = [562_000.0, 5_115_300.0, 563_300.0, 5_116_600.0];
/// A file that marks a folder as made by the demo, so that it may be made again.
const MARK: &str = "made-by-terraquilt-demo";

fn uniform(error_m: f64) -> Query {
    Query { area: Area::Everything, tolerance: Tolerance::Constant(error_m), how: Blend::Exact.into() }
}

fn ingest(db: &Db, folder: &Path, b: &Bundled) -> Result<db::Outcome> {
    let request = Ingest {
        sources: vec![format::open(&folder.join(b.file))?],
        name: Some(b.name.into()),
        into: None,
        accuracy_m: Some(b.accuracy_m),
        date: Some(Date::parse(b.date)?),
        precedence: None,
        vertical_unit_m: None,
        vertical_datum: None,
        crs: None,
        datum: Default::default(),
        step: None,
        lattice: None,
    };
    carry_out(db, Change::Ingest(request), None, false)
}

/// Draws a region into a file.
fn draw(s: &Snapshot, form: Form, query: Query, path: &Path) -> Result<Written> {
    let place = Place { area: query.area.clone(), bounds: query.area.bounds(), ..Place::default() };
    let (step, packing) = (None, Packing::default());
    let request = FileRequest { form, place, query, step, packing, pixels_max: limits::RASTER_POSTS_MAX };
    write_file(path, |out, going| write_surface(out, s, &request, going))
}

impl Demo {
    pub fn run(self) -> Result<bool> {
        let dir = &self.dir;
        prepare(dir)?;
        let mut out = Output::new();
        let surveys = dir.join("surveys");
        for b in &SURVEYS {
            let path = surveys.join(b.file);
            std::fs::write(&path, b.bytes).map_err(|e| Error::io(&path, e))?;
        }
        out.line("Mount St. Helens, Washington: the crater of 2000 at 10 m, three surveys of the growing dome in October 2004")?;
        out.line("at 2 m on ragged footprints, and the whole crater again in June 2005 at 10 m (USGS, public domain).")?;
        out.line("Policy 'newest': where surveys overlap, the later one is the ground.\n")?;

        let options = Options { crs: Crs::from_epsg(26910)?, policy: Policy::Newest, patch: Kind::Bilinear };
        let path = dir.join("helens");
        let db = Db::create(&path, &options)?;
        for b in &SURVEYS {
            self.arrive(&db, &surveys, b, &mut out)?;
        }

        out.line("\nQuestions, asked of version 4, before the survey of 2005:")?;
        let before = db.snapshot(Some(4))?;
        let q = uniform(5.0);
        let found = before.select(&q)?;
        out.line(format!(
            "  everything within 5 m: {} patches, {} tree nodes read",
            found.records.len(),
            found.nodes
        ))?;
        let camera = Camera::new(
            [562_900.0, 5_118_500.0, 2600.0],
            [562_650.0, 5_115_900.0, 2050.0],
            45.0,
            [1920, 1080],
            1.0,
            Some(15_000.0),
        )?;
        let view = before.select(&Query { tolerance: Tolerance::Camera(camera), ..q.clone() })?;
        out.line(format!(
            "  a camera north of the crater, 1 pixel: {} patches, {} tree nodes read",
            view.records.len(),
            view.nodes
        ))?;
        out.line(format!("  the height at {}, {} over time:", DOME[0], DOME[1]))?;
        for v in db.versions()? {
            let s = db.snapshot(Some(v.number))?;
            if let Some(e) = &s.heights(&[DOME], &Tolerance::Constant(0.0), Blend::Exact)?[0] {
                out.line(format!(
                    "    version {}: {:8.2} m, error {} m   ({})",
                    v.number, e.z, e.error_m, v.action
                ))?;
            }
        }

        out.line("\nThe state is a function of the set of surveys:")?;
        let forward = db::fingerprint(&db.snapshot(None)?)?;
        let reversed = Db::create(&dir.join("helens-reversed"), &options)?;
        for b in SURVEYS.iter().rev() {
            ingest(&reversed, &surveys, b)?;
        }
        let backward = db::fingerprint(&reversed.snapshot(None)?)?;
        out.line(format!("  in order of time  {}", &forward[..32]))?;
        out.line(format!("  in reverse order  {}", &backward[..32]))?;
        same(&forward, &backward, "the reverse order gives another fingerprint")?;
        let four = db::fingerprint(&before)?;
        carry_out(&db, Change::Remove { surveys: vec!["crater-2005".into()], tile: None }, None, false)?;
        let removed = db::fingerprint(&db.snapshot(None)?)?;
        out.line(format!("  before 2005 came  {}", &four[..32]))?;
        out.line(format!("  after it left     {}", &removed[..32]))?;
        same(&four, &removed, "removal left something behind")?;

        out.line("\nDrawn:")?;
        let now = db.snapshot(None)?;
        let picture = dir.join("helens-2004.png");
        let bent = How { blend: Blend::Exact, seams: Seams::All };
        draw(&now, Form::Png, Query { how: bent, ..uniform(2.0) }, &picture)?;
        out.line(format!(
            "  {}   shaded relief at 2 m error; red: small patches, blue: large ones",
            picture.display()
        ))?;
        let mesh = dir.join("dome-2004.glb");
        let query = Query { area: Area::Box(DOME_BOX), ..uniform(4.0) };
        if let Written::Mesh(m) = draw(&now, Form::Glb, query, &mesh)? {
            out.line(format!(
                "  {}   {} triangles, error {:.2} m (surface {:.2} certified + mesh {:.2} measured)",
                mesh.display(),
                count(m.triangles),
                m.error_m,
                m.surface_error_m,
                m.mesh_error_m
            ))?;
        }
        let info = db::info(&db, &now)?;
        out.line(format!(
            "  {}   the database: {}, {} versions",
            path.display(),
            bytes(info.bytes),
            db.versions()?.len()
        ))?;

        let p = path.display();
        out.line("\nTry next:")?;
        out.line(format!("  terraquilt surveys {p}"))?;
        out.line(format!("  terraquilt heights {p} --error 0 562660,5116000 --explain"))?;
        out.line(format!("  terraquilt export {p} crater.tif --error 1 --step 5"))?;
        out.line(format!("  terraquilt verify {p}"))?;
        out.line("  and on your own grids:")?;
        out.line(
            "  terraquilt init mine --crs EPSG:32633 && terraquilt ingest mine FILE.tif --accuracy 0.5",
        )?;
        out.end()
    }

    /// One survey comes; tells what changed.
    fn arrive(&self, db: &Db, surveys: &Path, b: &Bundled, out: &mut Output) -> Result<()> {
        let old = db.snapshot(None)?;
        let o = ingest(db, surveys, b)?;
        let new = db.snapshot(None)?;
        out.line(format!(
            "{}  {:16} {:>7} posts, {:>6} void   {:>3} patches live, {:>3} dormant   {:.0} ms",
            b.date,
            o.survey,
            count(o.posts),
            count(o.voids),
            o.live,
            o.dormant,
            o.seconds * 1e3
        ))?;
        for (name, cells) in &o.flipped_cells {
            out.line(format!("            hides {} cells of '{name}'", count(*cells)))?;
        }
        for w in &o.warnings {
            out.line(format!("            note: {w}"))?;
        }
        let q = uniform(5.0);
        let d = difference(&old.select(&q)?.records, &new.select(&q)?.records);
        out.line(format!(
            "            a viewer at 5 m error is sent {} patches and drops {}",
            d.added.len(),
            d.removed.len()
        ))
    }
}

fn same(a: &str, b: &str, otherwise: &str) -> Result<()> {
    if a == b { Ok(()) } else { Err(Error::corrupt("demo", "fingerprint", otherwise)) }
}

/// Makes the folder, or clears one that an earlier demo made.
fn prepare(dir: &Path) -> Result<()> {
    let io = |e| Error::io(dir, e);
    if dir.exists() {
        let marked = dir.join(MARK).exists();
        let empty = std::fs::read_dir(dir).map_err(io)?.next().is_none();
        if !marked && !empty {
            return Err(Error::invalid(
                dir.display(),
                "is not empty and was not made by the demo; name another folder",
            ));
        }
        for sub in ["helens", "helens-reversed", "surveys"] {
            if dir.join(sub).exists() {
                std::fs::remove_dir_all(dir.join(sub)).map_err(io)?;
            }
        }
    }
    std::fs::create_dir_all(dir.join("surveys")).map_err(io)?;
    std::fs::write(dir.join(MARK), "This folder may be deleted; `terraquilt demo` makes it again.\n")
        .map_err(io)
}
