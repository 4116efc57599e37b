//! How fast the parts are: each prints one JSON object, for `tools/compare_speed.py`, which sets them beside other programs.
//! `cargo run --release --example speed -- PART ...`

mod arrival;
mod camera;
mod decode;
mod mesh;
mod pyramid;

use terraquilt::base::Result;

const USAGE: &str = "usage: speed PART ...
  arrival DB FILE [ROUNDS]   a survey comes and goes ROUNDS times (5): milliseconds from the call to a durable commit that a query sees
  camera DB [TIMES]          a camera asks TIMES times (1000) from the same place
  decode DB                  every sample block of the first survey is decoded, from the mapped files, on one thread
  mesh DB ERROR [ROUNDS]     a mesh of everything within ERROR metres, from the selection to triangles in memory (ROUNDS: 3)
  pyramid DB                 errors of all levels over posts of the first survey, on one thread";

fn main() -> Result<()> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let args: Vec<&str> = args.iter().map(String::as_str).collect();
    let found = match args[..] {
        ["arrival", db, file] => arrival::run(db, file, 5),
        ["arrival", db, file, rounds] => arrival::run(db, file, rounds.parse().expect(USAGE)),
        ["camera", db] => camera::run(db, 1000),
        ["camera", db, times] => camera::run(db, times.parse().expect(USAGE)),
        ["decode", db] => decode::run(db),
        ["mesh", db, error] => mesh::run(db, error.parse().expect(USAGE), 3),
        ["mesh", db, error, rounds] => {
            mesh::run(db, error.parse().expect(USAGE), rounds.parse().expect(USAGE))
        }
        ["pyramid", db] => pyramid::run(db),
        _ => {
            eprintln!("{USAGE}");
            std::process::exit(2);
        }
    }?;
    println!("{found}");
    Ok(())
}

/// The middle one, and the least.
pub fn summary(mut all: Vec<f64>) -> serde_json::Value {
    all.sort_by(f64::total_cmp);
    serde_json::json!({ "median": all[all.len() / 2], "least": all[0], "most": all[all.len() - 1], "count": all.len() })
}
