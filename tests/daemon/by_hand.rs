//! The program as a person runs it, beside what a server answers.

use std::path::Path;
use std::process::{Command, Output};

pub fn program(args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_terraquilt")).args(args).env_remove("TERRAQUILT_TOKEN").output().unwrap()
}

/// What `export` writes and prints, of a directory or a server, and its notes. `ending`: that of the file.
pub fn export(
    folder: &Path,
    ending: &str,
    of: &[&str],
    args: &[&str],
) -> (Vec<u8>, serde_json::Value, String) {
    let out = folder.join("by-hand").with_extension(ending);
    let run = program(&[&["export"], of, &[out.to_str().unwrap(), "--json"], args].concat());
    let said = String::from_utf8_lossy(&run.stderr).into_owned();
    assert!(run.status.success(), "{said}");
    let mut json: serde_json::Value = serde_json::from_slice(&run.stdout).unwrap();
    assert!(json.as_object_mut().unwrap().remove("out").is_some());
    (std::fs::read(&out).unwrap(), json, said)
}
