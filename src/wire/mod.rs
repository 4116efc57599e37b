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

/// The checksum of a block of samples: CRC-32 as zlib has it.
pub fn crc32(bytes: &[u8]) -> u32 {
    let mut crc = flate2::Crc::new();
    crc.update(bytes);
    crc.sum()
}

impl v1::Grid {
    /// Bytes of one row as it is sent: samples, and the mask behind them. `None`: the type is unknown, or there is no such row.
    pub fn row_bytes(&self) -> Option<u64> {
        use v1::SampleType as T;
        let width = match T::try_from(self.sample_type).ok()? {
            T::Unspecified => return None,
            T::Uint8 | T::Int8 => 1,
            T::Uint16 | T::Int16 => 2,
            T::Uint32 | T::Int32 | T::Float32 => 4,
            T::Float64 => 8,
        };
        let mask = if self.masked { self.cols.div_ceil(8) } else { 0 };
        self.cols.checked_mul(width)?.checked_add(mask)
    }
}
