//! Settings from flags, variables and a file.
//!
//! One table names every setting: `--calls-max`, `TERRAQUILT_CALLS_MAX`, `calls-max` in the file. A flag wins over a variable, a
//! variable over the file, the file over the default. Whatever its source, a value is read by the same function, and a mistake
//! names the source.

use super::settings::{LogForm, Settings, TlsFiles};
use crate::base::{Error, Result};
use clap::{Arg, ArgMatches};
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Bytes that a configuration file may have.
const FILE_BYTES_MAX: u64 = 1 << 20;
/// No time is longer.
const LONGEST: Duration = Duration::from_secs(10 * 365 * 86_400);

/// How a value is written.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Kind {
    Text,
    Number,
    Switch,
    List,
}

/// A setting: its name, what it is, and how it is read and shown.
struct Key {
    name: &'static str,
    value: &'static str,
    help: &'static str,
    kind: Kind,
    set: fn(&mut Settings, &str) -> Parsed<()>,
    /// `None`: not set.
    get: fn(&Settings) -> Option<String>,
}

type Parsed<T> = std::result::Result<T, String>;

macro_rules! time {
    ($name:literal, $field:ident, $help:literal) => {
        Key {
            name: $name,
            value: "TIME",
            help: $help,
            kind: Kind::Text,
            set: |s, t| time(t).map(|v| s.$field = v),
            get: |s| Some(shown(s.$field)),
        }
    };
}

macro_rules! number {
    ($name:literal, $field:ident, $max:literal, $help:literal) => {
        Key {
            name: $name,
            value: "N",
            help: $help,
            kind: Kind::Number,
            set: |s, t| {
                number(t, $max)
                    .and_then(|v| v.try_into().map(|v| s.$field = v).map_err(|_| "is too large".into()))
            },
            get: |s| Some(s.$field.to_string()),
        }
    };
}

macro_rules! path {
    ($name:literal, $value:literal, $help:literal, $set:expr, $get:expr) => {
        Key { name: $name, value: $value, help: $help, kind: Kind::Text, set: $set, get: $get }
    };
}

fn tls(s: &mut Settings) -> &mut TlsFiles {
    s.tls.get_or_insert_default()
}

fn path(p: Option<&PathBuf>) -> Option<String> {
    p.filter(|p| !p.as_os_str().is_empty()).map(|p| p.display().to_string())
}

const KEYS: &[Key] = &[
    Key {
        name: "listen",
        value: "ADDR",
        help: "Address and port to listen on; port 0: any free one",
        kind: Kind::Text,
        set: |s, t| {
            t.parse()
                .map(|v| s.listen = v)
                .map_err(|_| "is no address; give one such as 127.0.0.1:50051 or [::1]:50051".into())
        },
        get: |s| Some(s.listen.to_string()),
    },
    path!(
        "tls-cert",
        "FILE",
        "Certificates (PEM) of the server, its own first: it then speaks TLS only",
        |s, t| set_path(t).map(|p| tls(s).certificates = p),
        |s| path(s.tls.as_ref().map(|t| &t.certificates))
    ),
    path!(
        "tls-key",
        "FILE",
        "Private key (PEM) of the certificate",
        |s, t| set_path(t).map(|p| tls(s).key = p),
        |s| path(s.tls.as_ref().map(|t| &t.key))
    ),
    path!(
        "tls-client-ca",
        "FILE",
        "Certificates (PEM) that sign those of clients: who shows none is refused (mutual TLS)",
        |s, t| set_path(t).map(|p| tls(s).client_ca = Some(p)),
        |s| path(s.tls.as_ref().and_then(|t| t.client_ca.as_ref()))
    ),
    path!(
        "tokens",
        "FILE",
        "File of the tokens (`terraquilt token`); without it, tokens.json in the database",
        |s, t| set_path(t).map(|p| s.tokens = Some(p)),
        |s| path(s.tokens.as_ref())
    ),
    Key {
        name: "insecure-open",
        value: "BOOL",
        help: "Listen beyond loopback though no token was made: whoever reaches the port may do everything",
        kind: Kind::Switch,
        set: |s, t| t.parse().map(|v| s.insecure_open = v).map_err(|_| "is neither true nor false".into()),
        get: |s| Some(s.insecure_open.to_string()),
    },
    Key {
        name: "allow-origin",
        value: "ORIGIN,...",
        help: "Origins whose pages may ask by gRPC-web, such as https://maps.example.org; *: any",
        kind: Kind::List,
        set: |s, t| {
            s.allow_origin =
                t.split(',').map(str::trim).filter(|o| !o.is_empty()).map(String::from).collect();
            match s.allow_origin.iter().find(|o| *o != "*" && !o.contains("://")) {
                Some(o) => Err(format!("names '{o}', which is no origin; give scheme://host:port, or *")),
                None => Ok(()),
            }
        },
        get: |s| Some(s.allow_origin.join(",")),
    },
    number!(
        "connections-max",
        connections_max,
        1_000_000,
        "Connections that may be open; further ones are closed as they come"
    ),
    number!(
        "connection-calls-max",
        connection_calls_max,
        100_000,
        "Calls that one HTTP/2 connection may have under way"
    ),
    number!(
        "calls-max",
        calls_max,
        100_000,
        "Calls under way at once that end by themselves; further ones get RESOURCE_EXHAUSTED"
    ),
    number!(
        "streams-max",
        streams_max,
        100_000,
        "Views, watches and uploads under way at once; further ones get RESOURCE_EXHAUSTED"
    ),
    time!(
        "deadline",
        deadline,
        "How long a call of one message each way may take where the caller gives no time"
    ),
    time!(
        "greet-within",
        greet_within,
        "Within this time come TLS handshake, first bytes, and the head of a request"
    ),
    time!("idle", idle, "A connection without a call on which nothing moved for this long is closed"),
    time!("stall", stall, "A connection whose client takes nothing of an answer for this long is closed"),
    time!("keepalive", keepalive, "How often a quiet HTTP/2 connection is asked whether it is alive"),
    time!("grace", grace, "How long calls may go on once the server was told to stop"),
    path!(
        "ingest-from",
        "DIR",
        "Files below this directory may be ingested by name; without it, none may",
        |s, t| set_path(t).map(|p| s.ingest_from = Some(p)),
        |s| path(s.ingest_from.as_ref())
    ),
    time!(
        "uploads-kept",
        uploads_kept,
        "How long what arrived of an upload is kept after its connection broke"
    ),
    time!("upload-idle", upload_idle, "How long an upload may send nothing before its stream is ended"),
    number!(
        "uploads-max",
        uploads_max,
        1_000_000,
        "Uploads that may be in progress, or kept to be resumed, at once"
    ),
    number!(
        "uploads-bytes-max",
        uploads_bytes_max,
        1_000_000_000_000_000,
        "Bytes that the samples of uploads may take on the disk"
    ),
    time!("sessions-kept", sessions_kept, "How long the session of a view is kept after its stream ended"),
    number!("sessions-max", sessions_max, 1_000_000, "Sessions of views that may be held at once"),
    number!("patches-max", patches_max, 1_000_000_000, "Patches that one answer may have"),
    number!("points-max", points_max, 1_000_000_000_000, "Points of one call for heights"),
    number!(
        "gtb-side-max",
        gtb_side_max,
        8193,
        "Posts along a side of a stream of the surface; memory goes by its square, some 50 bytes a post"
    ),
    number!(
        "gtb-cache-bytes",
        gtb_cache_bytes,
        1_000_000_000_000,
        "Bytes of streams of the surface that are kept for those who go on with them"
    ),
    Key {
        name: "log",
        value: "FORM",
        help: "How the log is written to standard error: text, or json (one object a line)",
        kind: Kind::Text,
        set: |s, t| {
            s.log = match t {
                "text" => LogForm::Text,
                "json" => LogForm::Json,
                _ => return Err("is neither text nor json".into()),
            };
            Ok(())
        },
        get: |s| Some(if s.log == LogForm::Text { "text" } else { "json" }.into()),
    },
    Key {
        name: "log-level",
        value: "LEVEL",
        help: "What is logged: error, warn, info (a line for each call), debug, trace; or filters such as info,h2=debug",
        kind: Kind::Text,
        set: |s, t| {
            s.log_level = t.into();
            Ok(())
        },
        get: |s| Some(s.log_level.clone()),
    },
];

/// The flags.
pub fn arguments() -> impl Iterator<Item = Arg> {
    let defaults = Settings::new("");
    KEYS.iter().map(move |k| {
        let help = match (k.get)(&defaults) {
            Some(d) if !d.is_empty() => format!("{} [default: {d}]", k.help),
            _ => k.help.to_string(),
        };
        let arg = Arg::new(k.name).long(k.name).value_name(k.value).help(help);
        match k.kind {
            Kind::Switch => arg.num_args(0..=1).require_equals(true).default_missing_value("true"),
            _ => arg,
        }
    })
}

/// The settings for a database: defaults, then what the file says, then the variables, then the flags.
///
/// # Errors
/// If a value cannot be read, or the file names what is no setting.
pub fn settings(
    db: &Path,
    file: Option<&Path>,
    variable: impl Fn(&str) -> Option<String>,
    flags: &ArgMatches,
) -> Result<Settings> {
    let mut settings = Settings::new(db);
    let mut set = |k: &Key, source: String, text: &str| {
        (k.set)(&mut settings, text)
            .map_err(|e| Error::invalid(source, format!("'{}' {e}", text.escape_default())))
    };
    if let Some(path) = file {
        for (k, text) in of_file(path)? {
            set(k, format!("{}: {}", path.display(), k.name), &text)?;
        }
    }
    for k in KEYS {
        let name = variable_of(k.name);
        if let Some(text) = variable(&name) {
            set(k, name, &text)?;
        }
    }
    for k in KEYS {
        if let Some(text) = flags.get_one::<String>(k.name) {
            set(k, format!("--{}", k.name), text)?;
        }
    }
    if let Some(tls) = &settings.tls
        && (tls.certificates.as_os_str().is_empty() || tls.key.as_os_str().is_empty())
    {
        return Err(Error::invalid(
            "TLS",
            "needs both tls-cert and tls-key; give them, or no TLS file at all",
        ));
    }
    Ok(settings)
}

/// The variable of a setting.
fn variable_of(name: &str) -> String {
    format!("TERRAQUILT_{}", name.to_ascii_uppercase().replace('-', "_"))
}

fn of_file(path: &Path) -> Result<Vec<(&'static Key, String)>> {
    let length = std::fs::metadata(path).map_err(|e| Error::io(path, e))?.len();
    if length > FILE_BYTES_MAX {
        return Err(Error::limit(format!("bytes of {}", path.display()), FILE_BYTES_MAX, length));
    }
    let text = std::fs::read_to_string(path).map_err(|e| Error::io(path, e))?;
    let table: toml::Table = text.parse().map_err(|e: toml::de::Error| {
        let before = e.span().and_then(|s| text.get(..s.start)).unwrap_or("");
        let line = before.matches('\n').count() + 1;
        Error::invalid(format!("{}: line {line}", path.display()), e.message().replace('\n', "; "))
    })?;
    table
        .into_iter()
        .map(|(name, value)| {
            let key = KEYS.iter().find(|k| k.name == name).ok_or_else(|| {
                let far = |k: &&Key| strsim::damerau_levenshtein(k.name, &name);
                let nearest = KEYS.iter().min_by_key(far).map_or("listen", |k| k.name);
                Error::invalid(path.display(), format!("'{name}' is no setting; the nearest is '{nearest}'"))
            })?;
            let text = as_text(&value).ok_or_else(|| {
                let what = format!("'{name}' is {}; give {}", value.type_str(), key.value);
                Error::invalid(path.display(), what)
            })?;
            Ok((key, text))
        })
        .collect()
}

fn as_text(value: &toml::Value) -> Option<String> {
    match value {
        toml::Value::String(s) => Some(s.clone()),
        toml::Value::Integer(n) => Some(n.to_string()),
        toml::Value::Boolean(b) => Some(b.to_string()),
        toml::Value::Array(all) => {
            all.iter().map(|v| v.as_str()).collect::<Option<Vec<_>>>().map(|v| v.join(","))
        }
        _ => None,
    }
}

/// The settings as a file that gives them again. No secret is in it: keys and tokens are files of their own.
pub fn printed(settings: &Settings) -> String {
    let mut out = format!(
        "# Settings of `terraquilt serve`: the file of --config. Flags (--listen) and variables (TERRAQUILT_LISTEN) win over it.\n\
         # Database: {}\n",
        settings.db.display().to_string().escape_debug()
    );
    for k in KEYS {
        let text = |t: String| toml::Value::String(t).to_string();
        let line = match ((k.get)(settings), k.kind) {
            (None, _) => format!("# {} = \"\"", k.name),
            (Some(v), Kind::Number | Kind::Switch) => format!("{} = {v}", k.name),
            (Some(v), Kind::Text) => format!("{} = {}", k.name, text(v)),
            (Some(v), Kind::List) => {
                let all =
                    v.split(',').filter(|o| !o.is_empty()).map(|o| toml::Value::String(o.into())).collect();
                format!("{} = {}", k.name, toml::Value::Array(all))
            }
        };
        out += &format!("\n# {} ({}).\n{line}\n", k.help, k.value);
    }
    out
}

fn set_path(text: &str) -> Parsed<PathBuf> {
    if text.is_empty() { Err("is no path".into()) } else { Ok(text.into()) }
}

fn number(text: &str, max: u64) -> Parsed<u64> {
    let n: u64 = text.replace('_', "").parse().map_err(|_| "is no whole number".to_string())?;
    if (1..=max).contains(&n) { Ok(n) } else { Err(format!("is not between 1 and {max}")) }
}

const UNITS: [(&str, u64); 5] = [("d", 86_400_000), ("h", 3_600_000), ("m", 60_000), ("s", 1000), ("ms", 1)];

/// A time as people write it: `300ms`, `20s`, `5m`, `24h`, `7d`; a number alone is seconds.
fn time(text: &str) -> Parsed<Duration> {
    let wrong = || "is no time; give a number and ms, s, m, h or d, such as 20s".to_string();
    let digits = text.find(|c: char| !c.is_ascii_digit()).unwrap_or(text.len());
    let n: u64 = text[..digits].parse().map_err(|_| wrong())?;
    let unit = match &text[digits..] {
        "" => 1000,
        u => UNITS.iter().find(|(name, _)| *name == u.trim()).ok_or_else(wrong)?.1,
    };
    let t = n.checked_mul(unit).map(Duration::from_millis).filter(|t| *t <= LONGEST);
    match t {
        Some(t) if !t.is_zero() => Ok(t),
        _ => Err("is not between 1 ms and 3650 days".into()),
    }
}

fn shown(t: Duration) -> String {
    let ms = t.as_millis() as u64;
    let (name, unit) = UNITS.iter().find(|(_, unit)| ms.is_multiple_of(*unit)).unwrap_or(&("ms", 1));
    format!("{}{name}", ms / unit)
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Command;

    fn read(file: &str, variables: &[(&str, &str)], flags: &[&str]) -> Result<Settings> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("serve.toml");
        std::fs::write(&path, file).unwrap();
        let command = Command::new("serve").args(arguments()).no_binary_name(true);
        let matches = command.try_get_matches_from(flags).unwrap();
        let variable = |n: &str| variables.iter().find(|(k, _)| *k == n).map(|(_, v)| v.to_string());
        settings(Path::new("db"), Some(&path), variable, &matches)
    }

    #[test]
    fn a_flag_wins_over_a_variable_and_a_variable_over_the_file() {
        let file = "calls-max = 10\nstreams-max = 20\ndeadline = \"1m\"\nallow-origin = [\"http://a\", \"http://b\"]\n";
        let variables = [("TERRAQUILT_CALLS_MAX", "11"), ("TERRAQUILT_STREAMS_MAX", "21")];
        let s = read(file, &variables, &["--calls-max", "12", "--insecure-open"]).unwrap();
        assert_eq!((s.calls_max, s.streams_max, s.deadline), (12, 21, Duration::from_secs(60)));
        assert_eq!(s.allow_origin, ["http://a", "http://b"]);
        assert!(s.insecure_open);
        let s = read(file, &[], &[]).unwrap();
        assert_eq!((s.calls_max, s.streams_max, s.insecure_open), (10, 20, false));
    }

    #[test]
    fn mistakes_name_their_source_and_what_to_do() {
        let wrong = |file: &str, variables: &[(&str, &str)], flags: &[&str]| {
            read(file, variables, flags).unwrap_err().to_string()
        };
        let e = wrong("conections-max = 5", &[], &[]);
        assert!(e.contains("'conections-max' is no setting; the nearest is 'connections-max'"), "{e}");
        let e = wrong("", &[("TERRAQUILT_IDLE", "soon")], &[]);
        assert!(e.starts_with("TERRAQUILT_IDLE: 'soon' is no time"), "{e}");
        let e = wrong("", &[], &["--calls-max", "0"]);
        assert!(e.starts_with("--calls-max: '0' is not between 1"), "{e}");
        let e = wrong("listen = 5", &[], &[]);
        assert!(e.contains("serve.toml: listen: '5' is no address"), "{e}");
        let e = wrong("listen = 5.5", &[], &[]);
        assert!(e.contains("'listen' is float; give ADDR"), "{e}");
        assert!(wrong("listen = ", &[], &[]).contains("serve.toml"));
        assert!(wrong("tls-key = 'k.pem'", &[], &[]).contains("needs both tls-cert and tls-key"));
    }

    #[test]
    fn printed_settings_give_the_same_settings_again() {
        let flags = [
            "--listen",
            "[::1]:7",
            "--tls-cert",
            "a \"b\".pem",
            "--tls-key",
            "k",
            "--allow-origin",
            "http://a,http://b",
        ];
        let s = read("", &[], &flags).unwrap();
        let text = printed(&s);
        let again = read(&text, &[], &[]).unwrap();
        assert_eq!(printed(&again), text);
        assert_eq!(format!("{again:?}"), format!("{s:?}"));
        assert!(text.contains("listen = \"[::1]:7\"") && text.contains("# ingest-from = \"\""), "{text}");
        for k in KEYS {
            assert!(text.contains(&format!("# {} ({}).\n", k.help, k.value)), "{}", k.name);
        }
    }
}
