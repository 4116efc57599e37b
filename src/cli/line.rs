//! The line to a server: where it is, who asks, and waiting for answers.

use super::output::{Meter, stop_flag};
use crate::base::{Error, Result};
use crate::client::{Address, Connection, catalog};
use clap::Args;
use std::ffi::OsString;
use std::future::Future;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;
use std::sync::atomic::Ordering;
use std::time::Duration;
use tokio::runtime::{Builder, Runtime};

/// How often it is asked how far a commit is, and whether to stop.
const ASK_EVERY: Duration = Duration::from_millis(500);
const STOP_WITHIN: Duration = Duration::from_millis(50);

// Which server, and who asks. (A doc comment here would become the help of every command.)
#[derive(Args, Clone, Debug, Default)]
#[command(next_help_heading = "Server")]
pub struct Login {
    /// Ask this server (`terraquilt serve`) in place of DB: host:port, or https://host:port where it speaks TLS
    #[arg(long, value_name = "ADDR")]
    server: Option<String>,
    /// File that holds the caller's token [default: the environment variable TERRAQUILT_TOKEN]
    #[arg(long, value_name = "FILE")]
    token_file: Option<PathBuf>,
    /// Certificates that may sign the server's, instead of those that the system trusts
    #[arg(long, value_name = "FILE.pem")]
    ca: Option<PathBuf>,
    /// Certificate of the caller, for servers that ask for one
    #[arg(long, value_name = "FILE.pem", requires = "tls_key")]
    tls_cert: Option<PathBuf>,
    /// Key of that certificate
    #[arg(long, value_name = "FILE.pem", requires = "tls_cert")]
    tls_key: Option<PathBuf>,
}

/// Said once, by the one command of the process.
static LOGIN: OnceLock<Login> = OnceLock::new();

/// How a server stands in the place of a directory.
const SERVER: &str = "server://";

impl Login {
    /// For all lines of this process.
    pub fn keep(self) {
        let _ = LOGIN.set(self);
    }

    fn address(&self, server: &str) -> Result<Address> {
        let read = |p: &Option<PathBuf>| match p {
            None => Ok(None),
            Some(p) => std::fs::read(p).map(Some).map_err(|e| Error::io(p, e)),
        };
        let token = match &self.token_file {
            Some(p) => Some(std::fs::read_to_string(p).map_err(|e| Error::io(p, e))?.trim().to_string()),
            None => std::env::var("TERRAQUILT_TOKEN").ok().filter(|t| !t.trim().is_empty()),
        };
        let identity = read(&self.tls_cert)?.zip(read(&self.tls_key)?);
        Ok(Address { server: server.to_string(), token, ca: read(&self.ca)?, identity })
    }
}

/// The server that stands in the place of a directory, if one does.
pub fn server(db: &Path) -> Option<&str> {
    let text = db.to_str()?;
    let web = text.starts_with("http://") || text.starts_with("https://");
    text.strip_prefix(SERVER).or(web.then_some(text))
}

/// Puts `--server ADDR` in the place of DB: behind the word of the command. Says which command has none to ask.
pub fn in_place(args: Vec<OsString>, disk_only: &[&str]) -> std::result::Result<Vec<OsString>, String> {
    let end = args.iter().position(|a| a == "--").unwrap_or(args.len());
    let named = |a: &OsString| a.to_str().and_then(|t| t.strip_prefix("--server=")).map(str::to_string);
    let Some(k) = (1..end).find(|k| args[*k] == "--server" || named(&args[*k]).is_some()) else {
        return Ok(args);
    };
    let (address, taken) = match named(&args[k]) {
        Some(a) => (a, 1),
        None => match args.get(k + 1).and_then(|a| a.to_str()) {
            Some(a) if k + 1 < end && !a.starts_with('-') => (a.to_string(), 2),
            // The parser says what is missing.
            _ => return Ok(args),
        },
    };
    let mut rest = args;
    rest.drain(k..k + taken);
    if let Some(other) = rest[..end - taken].iter().find(|a| *a == "--server" || named(a).is_some()) {
        let other = other.to_string_lossy();
        return Err(format!(
            "error: --server is given twice ({address}, and {other} behind it); a command asks one server"
        ));
    }
    let word = rest.iter().enumerate().skip(1).find(|(_, a)| !a.to_string_lossy().starts_with('-'));
    let Some((at, word)) = word.map(|(at, w)| (at, w.to_string_lossy().into_owned())) else {
        return Ok(rest);
    };
    if disk_only.contains(&word.as_str()) {
        return Err(format!(
            "error: `terraquilt {word}` works on the files of a database; run it where they are, without --server"
        ));
    }
    rest.insert(at + 1, OsString::from(format!("{SERVER}{address}")));
    Ok(rest)
}

/// A connection, and the thread that drives it.
pub struct Line {
    runtime: Runtime,
    pub connection: Connection,
}

impl Line {
    /// # Errors
    /// If nobody listens there, a file of the login cannot be read, or a certificate is not trusted.
    pub fn open(server: &str) -> Result<Line> {
        let address = LOGIN.get().cloned().unwrap_or_default().address(server)?;
        // One thread of its own: it answers the server's pings while a command computes.
        let runtime = Builder::new_multi_thread().worker_threads(1).enable_all().build();
        let runtime = runtime.map_err(|e| Error::invalid("threads", e))?;
        let connection = wait(&runtime, Connection::open(&address))?;
        Ok(Line { runtime, connection })
    }

    /// Waits for an answer, or for Ctrl-C.
    pub fn wait<T>(&self, work: impl Future<Output = Result<T>>) -> Result<T> {
        wait(&self.runtime, work)
    }

    /// Waits for a commit, with a bar that says how far the server is.
    pub fn commit<T>(&self, operation: &str, work: impl Future<Output = Result<T>>) -> Result<T> {
        let meter = Meter::new();
        let watched = async {
            tokio::pin!(work);
            let mut ticks = tokio::time::interval(ASK_EVERY);
            loop {
                tokio::select! {
                    done = &mut work => return done,
                    _ = ticks.tick(), if meter.is_shown() => {
                        if let Ok(s) = catalog::operation(&self.connection, operation).await
                            && !s.stage.is_empty()
                        {
                            meter.report(&s.stage, s.share);
                        }
                    }
                }
            }
        };
        let done = self.wait(watched);
        meter.clear();
        match done {
            Err(Error::Stopped) => Err(Error::Remote {
                server: self.connection.server.clone(),
                message: format!(
                    "stopped waiting; it may still carry the change out: the same command with --operation {operation} \
                     says what became of it"
                ),
            }),
            done => done,
        }
    }

    /// An answer that the server gave as JSON.
    pub fn read<T: serde::de::DeserializeOwned>(&self, json: &[u8]) -> Result<T> {
        serde_json::from_slice(json).map_err(|e| Error::Remote {
            server: self.connection.server.clone(),
            message: format!(
                "sent JSON that this program does not know ({e}); use the same version on both sides"
            ),
        })
    }
}

fn wait<T>(runtime: &Runtime, work: impl Future<Output = Result<T>>) -> Result<T> {
    let stop = stop_flag();
    runtime.block_on(async {
        let stopped = async {
            while !stop.load(Ordering::Relaxed) {
                tokio::time::sleep(STOP_WITHIN).await;
            }
        };
        tokio::select! {
            done = work => done,
            () = stopped => Err(Error::Stopped),
        }
    })
}

/// An id for a change whose caller gave none: random.
pub fn operation(given: Option<&str>, what: &str) -> Result<String> {
    if let Some(id) = given {
        return Ok(id.to_string());
    }
    let mut random = [0u8; 12];
    getrandom::fill(&mut random).map_err(|e| Error::invalid("random numbers", e))?;
    Ok(format!("{what}-{}", random.iter().map(|b| format!("{b:02x}")).collect::<String>()))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn placed(line: &str) -> std::result::Result<String, String> {
        let args = line.split(' ').map(OsString::from).collect();
        let out = in_place(args, &["init", "backup"])?;
        Ok(out.iter().map(|a| a.to_string_lossy().into_owned()).collect::<Vec<_>>().join(" "))
    }

    #[test]
    fn a_server_stands_in_the_place_of_the_database() {
        for (given, wanted) in [
            ("t surveys db", "t surveys db"),
            ("t surveys --server a:1", "t surveys server://a:1"),
            ("t --server a:1 surveys --json", "t surveys server://a:1 --json"),
            ("t export out.glb --server=a:1 --error 2", "t export server://a:1 out.glb --error 2"),
            ("t surveys --server", "t surveys --server"),
            ("t surveys --server --json", "t surveys --server --json"),
            ("t heights --error 0 -- --server a", "t heights --error 0 -- --server a"),
        ] {
            assert_eq!(placed(given).unwrap(), wanted);
        }
        assert!(placed("t init --server a:1").unwrap_err().contains("init"));
        for twice in ["t surveys --server a:1 --server b:2", "t --server=a:1 surveys --server=b:2"] {
            assert!(placed(twice).unwrap_err().contains("twice"), "{twice}");
        }
        assert_eq!(server(Path::new("server://a:1")), Some("a:1"));
        assert_eq!(server(Path::new("https://a:1")), Some("https://a:1"));
        assert_eq!(server(Path::new("hills")), None);
    }
}
