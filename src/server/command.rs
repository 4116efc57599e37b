//! `terraquilt serve`.

use super::{Settings, configuration, log, start};
use crate::base::{Error, Result};
use clap::{Arg, ArgAction, ArgMatches, Command};
use std::io::Write;
use std::path::PathBuf;
use std::time::Duration;
use tokio::signal::unix::{Signal, SignalKind, signal};

/// How long the process waits for what no call waits for any more.
const LAST_TASKS: Duration = Duration::from_secs(1);

const EXAMPLES: &str = "Examples:
  terraquilt serve hills                                   # on this machine only: needs no token
  terraquilt token add hills --right admin --name me       # from then on every caller needs one
  terraquilt serve hills --listen 0.0.0.0:50051 --tls-cert server.pem --tls-key server.key
  terraquilt serve hills --config serve.toml --print-config

Every setting is also a variable (TERRAQUILT_LISTEN) and a key of the file (listen = \"...\"). A flag wins over a variable, a
variable over the file. Ctrl-C or SIGTERM: stops gracefully; a second one: at once.";

/// The command `serve`.
pub fn serve() -> Command {
    Command::new("serve")
        .about("Serve a database over gRPC, gRPC-web and HTTP on one port")
        .after_help(EXAMPLES)
        .arg(
            Arg::new("db")
                .value_name("DB")
                .required(true)
                .value_parser(clap::value_parser!(PathBuf))
                .help("Directory of the database"),
        )
        .arg(
            Arg::new("config")
                .long("config")
                .value_name("FILE.toml")
                .env("TERRAQUILT_CONFIG")
                .value_parser(clap::value_parser!(PathBuf))
                .help("Settings from this file"),
        )
        .arg(
            Arg::new("print-config")
                .long("print-config")
                .action(ArgAction::SetTrue)
                .help("Print the settings that hold, as such a file, and stop"),
        )
        .args(configuration::arguments())
}

/// Serves until the process is told to stop (Ctrl-C, SIGTERM).
pub fn run_serve(matches: &ArgMatches) -> Result<bool> {
    let path = |name: &str| matches.get_one::<PathBuf>(name);
    let db = path("db").ok_or_else(|| Error::invalid("serve", "names no database"))?;
    let variable = |name: &str| std::env::var(name).ok();
    let settings = configuration::settings(db, path("config").map(PathBuf::as_path), variable, matches)?;
    if matches.get_flag("print-config") {
        let text = configuration::printed(&settings);
        std::io::stdout().write_all(text.as_bytes()).map_err(|e| Error::io("standard output", e))?;
        return Ok(true);
    }
    log::start(&settings)?;
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .enable_all()
        .build()
        .map_err(|e| Error::invalid("threads", e))?;
    let done = runtime.block_on(run(settings));
    // A commit that still computes is cut off: it is not there until it is durable.
    runtime.shutdown_timeout(LAST_TASKS);
    done.map(|()| true)
}

async fn run(settings: Settings) -> Result<()> {
    let listens = |kind| signal(kind).map_err(|e| Error::invalid("signals", e));
    let (mut interrupt, mut terminate) =
        (listens(SignalKind::interrupt())?, listens(SignalKind::terminate())?);
    let scheme = if settings.tls.is_some() { "https" } else { "http" };
    let running = start(settings).await?;
    // Nobody may be reading.
    let _ = writeln!(std::io::stderr(), "terraquilt listens on {scheme}://{}", running.address);
    either(&mut interrupt, &mut terminate).await;
    tracing::info!("stopping: no new calls; a second signal stops at once");
    tokio::select! {
        done = running.stop() => done,
        () = either(&mut interrupt, &mut terminate) => Ok(()),
    }
}

async fn either(a: &mut Signal, b: &mut Signal) {
    tokio::select! {
        _ = a.recv() => {}
        _ = b.recv() => {}
    }
}
