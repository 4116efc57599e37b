//! What can go wrong between a tile and its values on a GPU.

/// The result of everything in this crate that can fail.
pub type Result<T> = std::result::Result<T, Error>;

/// What went wrong.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// No driver, or none that can do it.
    #[error(
        "no GPU can be used: {reason}; install a Vulkan driver (Debian: apt install mesa-vulkan-drivers, which needs no GPU), \
         or decode on the CPU"
    )]
    Absent {
        /// What was looked for.
        reason: String,
    },
    /// The driver gave up: memory, a lost device, or a call that it does not accept.
    #[error("{adapter}: {reason}; try a smaller window, or decode on the CPU")]
    Failed {
        /// The GPU's name.
        adapter: String,
        /// In the driver's words.
        reason: String,
    },
    /// The tile or the window is not what it should be, or too large.
    #[error(transparent)]
    Tile(#[from] terraquilt_codecs::Error),
}
