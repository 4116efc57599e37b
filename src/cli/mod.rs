//! The command line: one file per group of subcommands, one contract for people and scripts.
//!
//! Results go to stdout (one JSON document, or one object a line, with `--json`); messages and progress to stderr.
//! Exit 0: done; 1: could not be done, one line says why; 2: wrong usage.

mod args;
mod ask;
mod care;
mod coded;
mod export;
mod fractal;
mod gtb;
mod ingest;
mod line;
mod measure;
mod mesh;
mod origin;
pub mod output;
mod place;
mod points;
mod question;
mod reader;
mod remote;
mod send;
mod stream;
mod tile;
mod tolerance;
mod upkeep;

use crate::base::{Error, Result};
use clap::{ArgMatches, Args, CommandFactory, FromArgMatches, Parser, Subcommand};
use std::ffi::OsString;
use std::process::ExitCode;

/// A living terrain database: overlapping elevation surveys in, one seamless surface with a certified error out.
#[derive(Parser)]
#[command(name = "terraquilt", version, max_term_width = 100)]
#[command(
    after_help = "Example:\n  terraquilt init hills --crs EPSG:32610\n  terraquilt ingest hills lidar.tif --accuracy 0.3\n  terraquilt export hills hills.png --error 2\n  terraquilt serve hills                              # then, in another terminal:\n  terraquilt surveys --server 127.0.0.1:50051\n  terraquilt demo        # the whole story on real surveys"
)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    Init(ingest::Init),
    Ingest(ingest::IngestFiles),
    Replace(ingest::Replace),
    Set(ingest::Set),
    Remove(ingest::Remove),
    Surveys(ask::Surveys),
    Tiles(ask::Tiles),
    Versions(ask::Versions),
    Patches(ask::Patches),
    Heights(ask::Heights),
    Boxes(ask::Boxes),
    Export(export::Export),
    Profile(measure::Profile),
    Sight(measure::SightCommand),
    Statistics(measure::StatisticsCommand),
    Contours(measure::ContoursCommand),
    Slope(measure::Slope),
    Aspect(measure::Aspect),
    Hillshade(measure::Hillshade),
    Volume(measure::Volume),
    Difference(measure::Difference),
    Contradictions(measure::Contradictions),
    Info(care::InfoCommand),
    Fingerprint(care::Fingerprint),
    Verify(care::Verify),
    Redundant(origin::Redundant),
    Provenance(origin::ProvenanceCommand),
    Prune(upkeep::Prune),
    Compact(upkeep::Compact),
    Backup(upkeep::Backup),
    Copy(upkeep::Copy),
    Rebuild(upkeep::Rebuild),
    Gtb(gtb::Gtb),
    Fractal(fractal::Fractal),
}

/// A word of the command line that another room carries out.
pub struct Door {
    pub command: clap::Command,
    pub run: fn(&ArgMatches) -> Result<bool>,
}

/// Words that work on files: of a database, or others.
const DISK_ONLY: [&str; 10] =
    ["backup", "compact", "copy", "demo", "fractal", "gtb", "init", "rebuild", "serve", "token"];

/// Runs the program. Never panics on input; a closed pipe is no crash.
pub fn run(args: impl IntoIterator<Item = OsString>, doors: Vec<Door>) -> ExitCode {
    // A point such as -119.5,37.6 is a value, not an option: a leading space says so, and is trimmed later.
    let args = args.into_iter().map(|a| match a.to_str() {
        Some(t) if is_negative_point(t) => OsString::from(format!(" {t}")),
        _ => a,
    });
    let args = match line::in_place(args.collect(), &DISK_ONLY) {
        Ok(args) => args,
        Err(text) => {
            output::message(&text);
            return ExitCode::from(2);
        }
    };
    let mut whole = Cli::command();
    for name in Cli::command().get_subcommands().map(clap::Command::get_name) {
        if !DISK_ONLY.contains(&name) {
            whole = whole.mut_subcommand(name, line::Login::augment_args);
        }
    }
    let whole = doors.iter().fold(whole, |c, d| c.subcommand(d.command.clone()));
    let matches = match whole.try_get_matches_from(args) {
        Ok(m) => m,
        Err(e) => {
            let _ = e.print();
            return ExitCode::from(if e.use_stderr() { 2 } else { 0 });
        }
    };
    if let Some((word, inner)) = matches.subcommand()
        && let Some(door) = doors.iter().find(|d| d.command.get_name() == word)
    {
        return finish((door.run)(inner));
    }
    if let Some((word, inner)) = matches.subcommand()
        && !DISK_ONLY.contains(&word)
        && let Ok(login) = line::Login::from_arg_matches(inner)
    {
        login.keep();
    }
    let cli = match Cli::from_arg_matches(&matches) {
        Ok(c) => c,
        Err(e) => {
            let _ = e.print();
            return ExitCode::from(2);
        }
    };
    let done = match cli.command {
        Command::Init(c) => c.run(),
        Command::Ingest(c) => c.run(),
        Command::Replace(c) => c.run(),
        Command::Set(c) => c.run(),
        Command::Remove(c) => c.run(),
        Command::Surveys(c) => c.run(),
        Command::Tiles(c) => c.run(),
        Command::Versions(c) => c.run(),
        Command::Patches(c) => c.run(),
        Command::Heights(c) => c.run(),
        Command::Boxes(c) => c.run(),
        Command::Export(c) => c.run(),
        Command::Profile(c) => c.run(),
        Command::Sight(c) => c.run(),
        Command::Statistics(c) => c.run(),
        Command::Contours(c) => c.run(),
        Command::Slope(c) => c.run(),
        Command::Aspect(c) => c.run(),
        Command::Hillshade(c) => c.run(),
        Command::Volume(c) => c.run(),
        Command::Difference(c) => c.run(),
        Command::Contradictions(c) => c.run(),
        Command::Info(c) => c.run(),
        Command::Fingerprint(c) => c.run(),
        Command::Verify(c) => c.run(),
        Command::Redundant(c) => c.run(),
        Command::Provenance(c) => c.run(),
        Command::Prune(c) => c.run(),
        Command::Compact(c) => c.run(),
        Command::Backup(c) => c.run(),
        Command::Copy(c) => c.run(),
        Command::Rebuild(c) => c.run(),
        Command::Gtb(c) => c.run(),
        Command::Fractal(c) => c.run(),
    };
    finish(done)
}

fn is_negative_point(text: &str) -> bool {
    text.starts_with('-') && text.contains(',') && text.split(',').all(|n| n.trim().parse::<f64>().is_ok())
}

fn finish(done: Result<bool>) -> ExitCode {
    match done {
        Ok(true) => ExitCode::SUCCESS,
        Ok(false) => ExitCode::from(1),
        Err(Error::Io { source, .. }) if source.kind() == std::io::ErrorKind::BrokenPipe => ExitCode::SUCCESS,
        Err(e) => {
            output::message(&format!("error: {e}"));
            ExitCode::from(1)
        }
    }
}
