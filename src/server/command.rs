//! `terraquilt serve`.

use super::{Settings, start};
use crate::base::{Error, Result};
use clap::{ArgMatches, Args, Command, FromArgMatches};
use std::net::SocketAddr;
use std::path::PathBuf;

/// Serve a database over gRPC, gRPC-web and HTTP on one port
#[derive(Args)]
#[command(after_help = "Example:\n  terraquilt serve hills --listen 127.0.0.1:50051")]
struct Serve {
    /// Directory of the database
    db: PathBuf,
    /// Address and port to listen on
    #[arg(long, value_name = "ADDR", default_value = "127.0.0.1:50051")]
    listen: SocketAddr,
}

/// The command `serve`.
pub fn serve() -> Command {
    Serve::augment_args(Command::new("serve"))
}

/// Serves until the process is told to stop (Ctrl-C, SIGTERM).
pub fn run_serve(matches: &ArgMatches) -> Result<bool> {
    let args = Serve::from_arg_matches(matches).map_err(|e| Error::invalid("serve", e))?;
    let settings = Settings { listen: args.listen, ..Settings::new(args.db) };
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .enable_all()
        .build()
        .map_err(|e| Error::invalid("threads", e))?;
    runtime.block_on(async {
        let running = start(settings).await?;
        eprintln!("terraquilt listens on http://{}", running.address);
        let _ = tokio::signal::ctrl_c().await;
        running.stop().await
    })?;
    Ok(true)
}
