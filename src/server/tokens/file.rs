//! The file of tokens.

use crate::base::{Error, Result};
use serde::{Deserialize, Serialize};
use std::fmt;
use std::fs::{self, File, OpenOptions};
use std::io::Write;
use std::os::unix::fs::OpenOptionsExt;
use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime, UNIX_EPOCH};

/// Bytes that a file of tokens may have: some 20 000 tokens.
const FILE_BYTES_MAX: u64 = 4 << 20;

/// What a token allows. Each allows what the one before allows.
#[derive(
    Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, clap::ValueEnum,
)]
#[serde(rename_all = "lowercase")]
pub enum Right {
    /// Ask.
    Read,
    /// Ask, and change what is in the database.
    Write,
    /// All that, and forget versions and check everything.
    Admin,
}

impl fmt::Display for Right {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Right::Read => "read",
            Right::Write => "write",
            Right::Admin => "admin",
        })
    }
}

/// A token that was made, without its secret.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Token {
    /// The first eight hexadecimal digits of the hash.
    pub id: String,
    pub name: String,
    pub right: Right,
    /// Seconds since 1970-01-01 UTC.
    pub made_at_s: u64,
    /// From then on it is refused.
    pub expires_at_s: Option<u64>,
    /// BLAKE3 of the token, hexadecimal.
    pub hash: String,
}

impl Token {
    pub fn expired(&self, now_s: u64) -> bool {
        self.expires_at_s.is_some_and(|t| t <= now_s)
    }
}

/// The hash under which a token is kept.
pub fn hash_of(token: &str) -> String {
    blake3::hash(token.as_bytes()).to_hex().to_string()
}

/// Seconds since 1970-01-01 UTC.
pub fn now_s() -> u64 {
    SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or(Duration::ZERO).as_secs()
}

#[derive(Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Contents {
    tokens: Vec<Token>,
}

/// The file of tokens.
#[derive(Clone, Debug)]
pub struct TokenFile {
    path: PathBuf,
}

impl TokenFile {
    pub fn at(path: impl Into<PathBuf>) -> TokenFile {
        TokenFile { path: path.into() }
    }

    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The tokens; `None` where there is no file.
    pub fn read(&self) -> Result<Option<Vec<Token>>> {
        let length = match fs::metadata(&self.path) {
            Ok(m) => m.len(),
            Err(e) if e.kind() == std::io::ErrorKind::NotFound => return Ok(None),
            Err(e) => return Err(Error::io(&self.path, e)),
        };
        if length > FILE_BYTES_MAX {
            return Err(Error::limit(
                format!("bytes of the token file {}", self.path.display()),
                FILE_BYTES_MAX,
                length,
            ));
        }
        let text = fs::read_to_string(&self.path).map_err(|e| Error::io(&self.path, e))?;
        let contents: Contents = serde_json::from_str(&text).map_err(|e| {
            Error::corrupt(
                self.path.display(),
                "list of tokens",
                format!("{e}; restore it, or remove it and make new tokens"),
            )
        })?;
        Ok(Some(contents.tokens))
    }

    /// Makes a token and returns its secret, which is written nowhere.
    ///
    /// # Errors
    /// If the name is taken or is none (1 to 64 letters, digits, `.`, `_`, `-`).
    pub fn add(&self, right: Right, name: Option<&str>, lasts: Option<Duration>) -> Result<(Token, String)> {
        let mut random = [0u8; 32];
        getrandom::fill(&mut random).map_err(|e| Error::invalid("random numbers", e))?;
        let secret = format!("tq_{}", random.iter().map(|b| format!("{b:02x}")).collect::<String>());
        let hash = hash_of(&secret);
        let id = hash[..8].to_string();
        let name = name.unwrap_or(&id).to_string();
        let fits = |c: char| c.is_ascii_alphanumeric() || "._-".contains(c);
        if name.is_empty() || name.len() > 64 || !name.chars().all(fits) {
            let what =
                format!("'{name}' is no name; take 1 to 64 letters, digits, dots, dashes, underscores");
            return Err(Error::invalid("--name", what));
        }
        let made_at_s = now_s();
        let expires_at_s = lasts.map(|d| made_at_s.saturating_add(d.as_secs()));
        let token = Token { id, name, right, made_at_s, expires_at_s, hash };
        self.change(|tokens| {
            if let Some(t) = tokens.iter().find(|t| t.name == token.name || t.id == token.name) {
                return Err(Error::invalid(
                    "--name",
                    format!(
                        "'{}' is token {} already; take another name or revoke it first",
                        token.name, t.id
                    ),
                ));
            }
            tokens.push(token.clone());
            Ok(())
        })?;
        Ok((token, secret))
    }

    /// Takes a token away, by name or id.
    pub fn revoke(&self, which: &str) -> Result<Token> {
        self.change(|tokens| {
            let k = tokens.iter().position(|t| t.name == which || t.id == which).ok_or_else(|| {
                Error::missing(
                    format!("token '{which}' in {}", self.path.display()),
                    "`terraquilt token list` names all",
                )
            })?;
            Ok(tokens.remove(k))
        })
    }

    /// Reads, changes and writes the file, alone: under a lock, under a temporary name that is then renamed, for the owner's
    /// eyes only.
    fn change<T>(&self, with: impl FnOnce(&mut Vec<Token>) -> Result<T>) -> Result<T> {
        let io = |e| Error::io(&self.path, e);
        let folder = match self.path.parent() {
            Some(p) if !p.as_os_str().is_empty() => p.to_path_buf(),
            _ => PathBuf::from("."),
        };
        let held = File::open(&folder).map_err(|e| Error::io(&folder, e))?;
        held.lock().map_err(|e| Error::io(&folder, e))?;
        let mut tokens = self.read()?.unwrap_or_default();
        let made = with(&mut tokens)?;
        let text = serde_json::to_string_pretty(&Contents { tokens })
            .map_err(|e| Error::invalid(self.path.display(), e))?;
        let mut temporary = self.path.clone().into_os_string();
        temporary.push(".new");
        let temporary = PathBuf::from(temporary);
        match fs::remove_file(&temporary) {
            Err(e) if e.kind() != std::io::ErrorKind::NotFound => return Err(Error::io(&temporary, e)),
            _ => {}
        }
        let mut file = OpenOptions::new()
            .write(true)
            .create_new(true)
            .mode(0o600)
            .open(&temporary)
            .map_err(|e| Error::io(&temporary, e))?;
        file.write_all(text.as_bytes())
            .and_then(|()| file.sync_all())
            .map_err(|e| Error::io(&temporary, e))?;
        fs::rename(&temporary, &self.path).map_err(io)?;
        held.sync_all().map_err(|e| Error::io(&folder, e))?;
        Ok(made)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::os::unix::fs::PermissionsExt;

    #[test]
    fn only_hashes_are_kept_and_only_the_owner_reads_them() {
        let folder = tempfile::tempdir().unwrap();
        let file = TokenFile::at(folder.path().join("tokens.json"));
        assert_eq!(file.read().unwrap(), None);
        let (token, secret) = file.add(Right::Write, Some("crew"), Some(Duration::from_secs(5))).unwrap();
        let text = fs::read_to_string(file.path()).unwrap();
        assert!(!text.contains(&secret) && !text.contains(&secret[3..]), "{text}");
        assert_eq!(fs::metadata(file.path()).unwrap().permissions().mode() & 0o777, 0o600);
        assert_eq!(file.read().unwrap(), Some(vec![token.clone()]));
        assert_eq!(token.hash, hash_of(&secret));
        assert_eq!(secret.len(), 3 + 64);
        assert!(!token.expired(token.made_at_s + 4) && token.expired(token.made_at_s + 5));
        let again = file.add(Right::Read, Some("crew"), None).unwrap_err().to_string();
        assert!(again.contains("'crew' is token"), "{again}");
        assert!(file.add(Right::Read, Some("two words"), None).is_err());
        assert_eq!(file.revoke("crew").unwrap(), token);
        assert_eq!(file.read().unwrap(), Some(vec![]));
        assert!(file.revoke("crew").is_err());
    }

    #[test]
    fn tokens_made_at_once_are_all_kept() {
        let folder = tempfile::tempdir().unwrap();
        let file = TokenFile::at(folder.path().join("tokens.json"));
        std::thread::scope(|s| {
            for _ in 0..4 {
                s.spawn(|| (0..5).for_each(|_| drop(file.add(Right::Read, None, None).unwrap())));
            }
        });
        assert_eq!(file.read().unwrap().unwrap().len(), 20);
    }
}
