//! `terraquilt token add|list|revoke`.

use super::file::{Right, Token, TokenFile, now_s};
use crate::base::{Error, Result};
use crate::server::Settings;
use clap::{ArgMatches, Args, Command, FromArgMatches, Subcommand};
use std::io::Write;
use std::path::PathBuf;
use std::time::Duration;

/// Make, list and revoke the tokens that callers of a server show
#[derive(Args)]
#[command(
    after_help = "Examples:\n  terraquilt token add hills --right write --name flight-crew --expires 30\n  terraquilt token list hills\n  terraquilt token revoke hills flight-crew\n\nThe token is printed once and kept only as a hash, in tokens.json of the database. A running server takes up a change within\na second. As soon as that file is there, every caller needs a token."
)]
struct TokenCommand {
    #[command(subcommand)]
    what: What,
}

#[derive(Subcommand)]
enum What {
    /// Make a token and print it, once
    Add(Add),
    /// The tokens there are, without their secrets
    List(List),
    /// Take a token away: it is refused from then on
    Revoke(Revoke),
}

/// Where the tokens are.
#[derive(Args)]
struct Place {
    /// Directory of the database
    db: PathBuf,
    /// File of the tokens instead of tokens.json in the database
    #[arg(long, value_name = "FILE", env = "TERRAQUILT_TOKENS")]
    tokens: Option<PathBuf>,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

#[derive(Args)]
#[command(after_help = "Example:\n  terraquilt token add hills --right read --name map-service")]
struct Add {
    #[command(flatten)]
    place: Place,
    /// What it allows: each right allows what those before it allow
    #[arg(long, value_enum)]
    right: Right,
    /// Name by which logs and lists know it
    #[arg(long)]
    name: Option<String>,
    /// Days until it is refused; without it, it stays good
    #[arg(long, value_name = "DAYS", value_parser = clap::value_parser!(u64).range(1..=36_500))]
    expires: Option<u64>,
}

#[derive(Args)]
#[command(after_help = "Example:\n  terraquilt token list hills --json")]
struct List {
    #[command(flatten)]
    place: Place,
}

#[derive(Args)]
#[command(after_help = "Example:\n  terraquilt token revoke hills map-service")]
struct Revoke {
    #[command(flatten)]
    place: Place,
    /// Name or id of the token
    token: String,
}

impl Place {
    fn file(&self) -> Result<TokenFile> {
        if !self.db.is_dir() {
            return Err(Error::missing(format!("database {}", self.db.display()), "check the name"));
        }
        let settings = Settings { tokens: self.tokens.clone(), ..Settings::new(&self.db) };
        Ok(TokenFile::at(settings.tokens_file()))
    }
}

/// The command `token`.
pub fn token() -> Command {
    TokenCommand::augment_args(Command::new("token"))
}

/// Carries it out.
pub fn run_token(matches: &ArgMatches) -> Result<bool> {
    let command = TokenCommand::from_arg_matches(matches).map_err(|e| Error::invalid("token", e))?;
    match command.what {
        What::Add(a) => {
            let file = a.place.file()?;
            let lasts = a.expires.map(|days| Duration::from_secs(days * 86_400));
            let (token, secret) = file.add(a.right, a.name.as_deref(), lasts)?;
            if a.place.json {
                let mut shown = shown(&token);
                shown["token"] = secret.into();
                return line(&shown.to_string());
            }
            line(&secret)?;
            eprintln!(
                "token '{}' ({}, right {}): this is the only time that it is shown",
                token.name, token.id, token.right
            );
            Ok(true)
        }
        What::List(l) => {
            let file = l.place.file()?;
            let found = file.read()?;
            if found.is_none() {
                eprintln!(
                    "no token was ever made ({} is not there): whoever reaches a server of this database may do everything",
                    file.path().display()
                );
            }
            let tokens = found.unwrap_or_default();
            if l.place.json {
                return line(&serde_json::Value::Array(tokens.iter().map(shown).collect()).to_string());
            }
            line(&format!("{:8}  {:5}  {:24}  {:9}  expires in", "id", "right", "name", "age"))?;
            for t in &tokens {
                let age = days(now_s().saturating_sub(t.made_at_s));
                let left = match t.expires_at_s {
                    None => "never".into(),
                    Some(_) if t.expired(now_s()) => "(expired)".into(),
                    Some(at) => days(at.saturating_sub(now_s())),
                };
                line(&format!("{:8}  {:5}  {:24}  {age:9}  {left}", t.id, t.right.to_string(), t.name))?;
            }
            Ok(true)
        }
        What::Revoke(r) => {
            let token = r.place.file()?.revoke(&r.token)?;
            if r.place.json {
                return line(&shown(&token).to_string());
            }
            eprintln!("token '{}' ({}, right {}) is revoked", token.name, token.id, token.right);
            Ok(true)
        }
    }
}

/// A token as JSON, without its hash.
fn shown(t: &Token) -> serde_json::Value {
    serde_json::json!({
        "id": t.id, "name": t.name, "right": t.right, "made_at_s": t.made_at_s, "expires_at_s": t.expires_at_s,
        "expired": t.expired(now_s()),
    })
}

fn days(seconds: u64) -> String {
    match seconds {
        0..=7199 => format!("{} min", seconds / 60),
        7200..=172_799 => format!("{} h", seconds / 3600),
        _ => format!("{} days", seconds / 86_400),
    }
}

fn line(text: &str) -> Result<bool> {
    writeln!(std::io::stdout(), "{text}").map_err(|e| Error::io("standard output", e))?;
    Ok(true)
}
