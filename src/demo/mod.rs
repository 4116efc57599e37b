//! `terraquilt demo`: the whole story on real surveys of Mount St. Helens that are part of the program, over gRPC: a server in
//! this process on a free port of loopback, surveys streamed in, a view kept open that is told of each, questions, a mesh.
//!
//! After the databases are made, everything goes through [`client`](crate::client): what the demo does, any program can do.

mod bundled;
mod story;

use crate::base::{Error, Result};
use clap::{ArgMatches, Args, Command, FromArgMatches};
use std::path::{Path, PathBuf};

/// The whole story on bundled real surveys, over gRPC: arrive, replace, view, ask, draw, remove
#[derive(Args)]
#[command(after_help = "Example:\n  terraquilt demo /tmp/helens")]
struct Demo {
    /// Folder for the databases, the pictures and the mesh
    #[arg(default_value = "terraquilt-demo")]
    dir: PathBuf,
}

/// The command `demo`.
pub fn command() -> Command {
    Demo::augment_args(Command::new("demo"))
}

/// Tells the story.
pub fn run(matches: &ArgMatches) -> Result<bool> {
    let demo = Demo::from_arg_matches(matches).map_err(|e| Error::invalid("demo", e))?;
    prepare(&demo.dir)?;
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .enable_all()
        .build()
        .map_err(|e| Error::invalid("threads", e))?;
    runtime.block_on(story::tell(&demo.dir))
}

/// A file that marks a folder as made by the demo, so that it may be made again.
const MARK: &str = "made-by-terraquilt-demo";

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
