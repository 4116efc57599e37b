//! The `terraquilt` program.

use std::process::ExitCode;

fn main() -> ExitCode {
    terraquilt::cli::run(std::env::args_os())
}
