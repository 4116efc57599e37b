//! Must show 6.
