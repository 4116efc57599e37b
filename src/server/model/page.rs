//! Pages of long lists.

use crate::base::{Error, Result};
use crate::wire::MESSAGE_BYTES;

/// Which page of a list is asked for. A token names the version and the last entry before the page: `12.345`.
pub struct Page {
    /// Entries up to this one have been sent; `None`: it is the first page.
    pub after: Option<u64>,
    entries_max: usize,
    entries: usize,
    bytes: usize,
}

impl Page {
    /// The page, and the version that it is of: that of the token, else `at`.
    ///
    /// # Errors
    /// If the token is none of this server's, or of another version than `at`.
    pub fn of(size: u32, token: &str, at: u64) -> Result<(Page, u64)> {
        let entries_max = if size == 0 { usize::MAX } else { size as usize };
        let page = |after| Page { after, entries_max, entries: 0, bytes: 0 };
        if token.is_empty() {
            return Ok((page(None), at));
        }
        let parts = token.split_once('.').and_then(|(v, k)| Some((v.parse().ok()?, k.parse().ok()?)));
        let Some((version, after)) = parts else {
            let reason = "is none that this server gave; leave it empty for the first page";
            return Err(Error::invalid("page_token", reason));
        };
        if at != 0 && at != version {
            let reason = format!("is of version {version}, but `at` is {at}; ask for both alike");
            return Err(Error::invalid("page_token", reason));
        }
        Ok((page(Some(after)), version))
    }

    /// Whether an entry of so many bytes still fits. The first one always does.
    pub fn takes(&mut self, bytes: usize) -> bool {
        let fits = self.entries < self.entries_max && self.bytes + bytes <= MESSAGE_BYTES;
        if !fits && self.entries > 0 {
            return false;
        }
        self.entries += 1;
        // Each entry has a key and a length before it.
        self.bytes += bytes + 6;
        true
    }

    /// The token of the page after the entry `last`.
    pub fn next(version: u64, last: u64) -> String {
        format!("{version}.{last}")
    }
}
