//! The messages of `proto/terraquilt/v1`, as both sides of the wire see them. Generated; the manual is in the `.proto` files.

/// Messages, servers and clients.
#[allow(clippy::all, missing_docs)]
pub mod v1 {
    tonic::include_proto!("terraquilt.v1");
}

/// The files of `proto/` as a compiled `FileDescriptorSet`, for reflection.
pub const DESCRIPTORS: &[u8] = include_bytes!(concat!(env!("OUT_DIR"), "/descriptors.bin"));

/// Bytes of samples, patches or rows that go into one message. Common clients refuse messages above 4 MiB.
pub const MESSAGE_BYTES: usize = 1 << 20;
/// The largest message that is taken, whoever sends it.
pub const MESSAGE_BYTES_MAX: usize = 4 << 20;
