//! The `terraquilt` program: `serve` goes to the server, every other word to the command line.

use std::process::ExitCode;
use terraquilt::cli::{self, Door};
use terraquilt::server;

fn main() -> ExitCode {
    let doors = vec![Door { command: server::command::serve(), run: server::command::run_serve }];
    cli::run(std::env::args_os(), doors)
}
