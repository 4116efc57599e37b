//! What travels between servers and clients, packed: vertices of patches, cells of masks, nodes of corrections; heights of a
//! stream that a receiver has already.
//!
//! The bytes are drawn in `docs/payload.md`. Pure functions of their arguments: same numbers, same bytes, on every machine.
//! What is unpacked comes from outside: it is checked, never trusted, and never allocates more than one patch or block holds.

mod bits;
pub mod cells;
pub mod corrections;
pub mod held;
pub mod vertices;
