//! The tokens as a running server knows them.

use super::file::{Token, TokenFile, hash_of, now_s};
use super::rights::Needs;
use crate::base::Result;
use std::collections::HashMap;
use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, SystemTime};
use tokio::sync::watch;
use tonic::Status;

/// How often the file is looked at.
const LOOK_EVERY: Duration = Duration::from_millis(500);

/// Tokens by hash; `None`: none was ever made, and everyone may do everything.
type Known = Option<Arc<HashMap<String, Token>>>;

/// The tokens as a running server knows them.
pub struct Tokens {
    file: TokenFile,
    known: watch::Sender<Known>,
}

/// Who asks.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Caller {
    /// Nobody needs a token here.
    Anyone,
    /// Gave no token, and needed none for this.
    Unnamed,
    Holder(Token),
}

impl Caller {
    /// As the log names the caller.
    pub fn name(&self) -> &str {
        match self {
            Caller::Anyone | Caller::Unnamed => "-",
            Caller::Holder(t) => &t.name,
        }
    }
}

impl Tokens {
    pub fn open(path: &Path) -> Result<Tokens> {
        let file = TokenFile::at(path);
        let known = by_hash(file.read()?);
        Ok(Tokens { file, known: watch::Sender::new(known) })
    }

    /// Whether callers need a token.
    pub fn guarded(&self) -> bool {
        self.known.borrow().is_some()
    }

    /// Tokens that are good now.
    pub fn good(&self) -> usize {
        let now = now_s();
        self.known.borrow().as_ref().map_or(0, |k| k.values().filter(|t| !t.expired(now)).count())
    }

    /// Whether whoever gave this token may ask for what needs that right.
    ///
    /// # Errors
    /// `UNAUTHENTICATED` without a good token, `PERMISSION_DENIED` with one that does not allow it.
    #[allow(clippy::result_large_err)]
    pub fn admit(
        &self,
        given: Option<&str>,
        needs: Needs,
        what: &str,
    ) -> std::result::Result<Caller, Status> {
        let known = self.known.borrow().clone();
        let Some(known) = known else { return Ok(Caller::Anyone) };
        let Needs::Right(needed) = needs else { return Ok(Caller::Unnamed) };
        let Some(given) = given else {
            return Err(Status::unauthenticated(format!(
                "{what} needs a token with the right {needed}, and none was given; send `authorization: Bearer tq_...` (the \
                 command line: --token-file or TERRAQUILT_TOKEN; the operator makes one by `terraquilt token add`)"
            )));
        };
        let token = known.get(&hash_of(given)).ok_or_else(|| {
            Status::unauthenticated(
                "the token that was given is not known here: mistyped, revoked, or another server's; ask the operator for a \
                 new one",
            )
        })?;
        if token.expired(now_s()) {
            return Err(Status::unauthenticated(format!(
                "token '{}' has expired; ask the operator for a new one",
                token.name
            )));
        }
        if token.right < needed {
            return Err(Status::permission_denied(format!(
                "{what} needs the right {needed}, token '{}' has the right {}; ask the operator for another token",
                token.name, token.right
            )));
        }
        Ok(Caller::Holder(token.clone()))
    }

    /// Ends when the caller's token is no longer good, with the reason.
    pub async fn withdrawn(&self, caller: &Caller) -> Status {
        let Caller::Holder(token) = caller else { return std::future::pending().await };
        let mut changes = self.known.subscribe();
        let gone = async {
            let there = |k: &Known| k.as_ref().is_some_and(|k| k.contains_key(&token.hash));
            // An error says that the server is no more: then nothing is withdrawn either.
            if changes.wait_for(|k| !there(k)).await.is_err() {
                std::future::pending::<()>().await;
            }
        };
        let expired = async {
            match token.expires_at_s {
                None => std::future::pending().await,
                Some(t) => tokio::time::sleep(Duration::from_secs(t.saturating_sub(now_s()))).await,
            }
        };
        tokio::select! {
            () = gone => Status::unauthenticated(format!("token '{}' was revoked", token.name)),
            () = expired => Status::unauthenticated(format!("token '{}' has expired", token.name)),
        }
    }

    /// Follows the file until told to stop. A file that cannot be read, or is gone, leaves what was known: it never opens a
    /// server that was guarded.
    pub fn follow(self: &Arc<Self>, mut stopped: watch::Receiver<bool>) {
        let tokens = self.clone();
        tokio::spawn(async move {
            let mut seen = stamp(tokens.file.path()).await;
            while !*stopped.borrow() {
                tokio::select! {
                    () = tokio::time::sleep(LOOK_EVERY) => {}
                    _ = stopped.changed() => break,
                }
                let now = stamp(tokens.file.path()).await;
                if now != seen {
                    seen = now;
                    tokens.read_again().await;
                }
            }
        });
    }

    async fn read_again(&self) {
        let file = self.file.clone();
        match tokio::task::spawn_blocking(move || file.read()).await {
            Ok(Ok(Some(tokens))) => {
                tracing::info!("tokens were read again: {} are known", tokens.len());
                self.known.send_replace(by_hash(Some(tokens)));
            }
            Ok(Ok(None)) if self.guarded() => {
                tracing::warn!(
                    "the file of tokens is gone; those that were known stay good until the server is started again"
                );
            }
            Ok(Ok(None)) | Err(_) => {}
            Ok(Err(e)) => tracing::error!("tokens stay as they were: {e}"),
        }
    }
}

/// What changes when the file does. A rename gives another inode, whatever the clock says.
async fn stamp(path: &Path) -> Option<(u64, u64, Option<SystemTime>)> {
    use std::os::unix::fs::MetadataExt;
    let m = tokio::fs::metadata(path).await.ok()?;
    Some((m.ino(), m.len(), m.modified().ok()))
}

fn by_hash(tokens: Option<Vec<Token>>) -> Known {
    tokens.map(|all| Arc::new(all.into_iter().map(|t| (t.hash.clone(), t)).collect()))
}

#[cfg(test)]
mod tests {
    use super::super::Right;
    use super::*;

    #[tokio::test]
    async fn a_guarded_server_never_opens() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("tokens.json");
        let file = TokenFile::at(&path);
        let (_, secret) = file.add(Right::Read, Some("a"), None).unwrap();
        let tokens = Tokens::open(&path).unwrap();
        assert!(tokens.admit(Some(&secret), Needs::Right(Right::Read), "x").is_ok());
        std::fs::remove_file(&path).unwrap();
        tokens.read_again().await;
        assert!(tokens.guarded() && tokens.admit(None, Needs::Right(Right::Read), "x").is_err());
        std::fs::write(&path, "{").unwrap();
        tokens.read_again().await;
        assert!(tokens.guarded() && tokens.admit(None, Needs::Right(Right::Read), "x").is_err());
        std::fs::write(&path, r#"{"tokens":[]}"#).unwrap();
        tokens.read_again().await;
        assert!(tokens.guarded() && tokens.admit(Some(&secret), Needs::Right(Right::Read), "x").is_err());
    }
}
