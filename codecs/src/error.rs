//! One error type: what is wrong, where, both values, what to do.

/// The result of everything in this crate that can fail.
pub type Result<T> = std::result::Result<T, Error>;

/// What went wrong.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum Error {
    /// The bytes end before anything can be shown.
    #[error("{what}: {has} bytes are there, {needs} are needed; ask for a longer prefix")]
    Short {
        /// The part that is cut.
        what: &'static str,
        /// Bytes that it takes.
        needs: u64,
        /// Bytes that are there.
        has: u64,
    },
    /// The bytes are not what they claim to be.
    #[error("damaged {place}: {reason}")]
    Damaged {
        /// Where.
        place: String,
        /// Both values, and what to do.
        reason: String,
    },
    /// A size beyond what is allowed.
    #[error("{what}: {wanted} wanted, at most {limit} allowed")]
    Limit {
        /// What is bounded.
        what: &'static str,
        /// The bound.
        limit: u64,
        /// What was asked for.
        wanted: u64,
    },
    /// The caller asked for something that cannot be.
    #[error("{what}: {reason}")]
    Invalid {
        /// The argument.
        what: &'static str,
        /// Why not, and what to do.
        reason: String,
    },
    /// The caller stopped the work.
    #[error("stopped")]
    Stopped,
}

impl Error {
    /// [`Error::Damaged`].
    pub fn damaged(place: impl ToString, reason: impl ToString) -> Error {
        Error::Damaged { place: place.to_string(), reason: reason.to_string() }
    }

    /// [`Error::Invalid`].
    pub fn invalid(what: &'static str, reason: impl ToString) -> Error {
        Error::Invalid { what, reason: reason.to_string() }
    }
}
