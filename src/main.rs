//! The `terraquilt` program: `serve` and `token` go to the server, `demo` to the demo, every other word to the command line.

use std::process::ExitCode;
use terraquilt::cli::{self, Door};
use terraquilt::{demo, server};

fn main() -> ExitCode {
    let doors = vec![
        Door { command: demo::command(), run: demo::run },
        Door { command: server::command::serve(), run: server::command::run_serve },
        Door { command: server::tokens::command::token(), run: server::tokens::command::run_token },
    ];
    cli::run(std::env::args_os(), doors)
}
