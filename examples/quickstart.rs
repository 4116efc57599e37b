//! A database from two real surveys, and what can be asked of it. `cargo run --example quickstart`

use std::path::Path;
use std::sync::atomic::AtomicBool;
use terraquilt::base::date::Date;
use terraquilt::db::query::{Query, Tolerance};
use terraquilt::db::{Change, Db, Ingest, Options, Policy, Progress};
use terraquilt::height::{crs::Crs, patch::Kind, surface::Blend};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let folder = std::env::temp_dir().join(format!("terraquilt-quickstart-{}", std::process::id()));
    let db = Db::create(
        &folder,
        &Options { crs: Crs::parse("EPSG:26910")?, policy: Policy::Newest, patch: Kind::Bilinear },
    )?;
    let data = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/st_helens");
    let (stop, quiet) = (AtomicBool::new(false), |_: &str, _: f64| ());
    for (date, accuracy_m) in [("2000-09-25", 2.0), ("2004-10-13", 0.5)] {
        let ingest = Ingest {
            name: Some(format!("helens {date}")),
            accuracy_m: Some(accuracy_m),
            date: Some(Date::parse(date)?),
            ..Ingest::new(vec![terraquilt::format::open(&data.join(format!("survey_{date}_native.tif")))?])
        };
        let progress = Progress { report: &quiet, stop: &stop };
        let done = db.change(Change::Ingest(ingest), None, false, &progress, &mut || ())?;
        println!(
            "version {}: '{}', {} posts, {} patches",
            done.version, done.survey, done.posts, done.patches
        );
    }
    let now = db.snapshot(None)?;
    let points = [[562_660.0, 5_116_000.0], [562_000.0, 5_118_000.0]];
    for error_m in [0.0, 10.0] {
        for (p, e) in points.iter().zip(now.heights(&points, &Tolerance::Constant(error_m), Blend::Exact)?) {
            let Some(e) = e else { continue };
            println!("within {error_m} m: {p:?} is {:.2} m high, error at most {} m", e.z, e.error_m);
        }
    }
    let region = Some([562_400.0, 5_115_700.0, 562_900.0, 5_116_200.0]);
    let answer = now.select(&Query {
        area: region.into(),
        tolerance: Tolerance::Constant(10.0),
        how: Blend::Exact.into(),
    })?;
    println!(
        "{} patches make the dome within 10 m; the first is {}",
        answer.records.len(),
        answer.records[0].id
    );
    drop(now);
    Ok(std::fs::remove_dir_all(&folder)?)
}
