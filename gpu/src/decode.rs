//! A tile in the GPU's memory, and its windows block by block.

use crate::words::Words;
use crate::{Gpu, Result, Window};
use bytemuck::{bytes_of, cast_slice};
use terraquilt_codecs::fractal::Walk;
use wgpu::BufferUsages;

/// Side of a block, in samples. Its 16 MiB are within what every adapter offers, as are its 256 x 256 workgroups.
const BLOCK: u32 = 2048;
/// Side of a workgroup, as in compute.wgsl.
const GROUP: u32 = 8;

/// A tile in the GPU's memory.
pub struct Uploaded<'a> {
    gpu: &'a Gpu,
    tile: wgpu::BindGroup,
    size: [usize; 2],
    low: f64,
    span: f64,
}

/// The buffers that every block of a window goes through.
struct Room {
    columns: wgpu::Buffer,
    rows: wgpu::Buffer,
    block: wgpu::Buffer,
    values: wgpu::Buffer,
    back: wgpu::Buffer,
    group: wgpu::BindGroup,
}

impl Gpu {
    /// Copies a tile to the GPU: 32 bytes per leaf, 4 per square of the index and per sample.
    ///
    /// # Errors
    /// Limit for a tile larger than a buffer of this adapter; [`Error::Failed`](crate::Error::Failed) if
    /// memory is short.
    pub fn upload(&self, tile: &Walk<2>) -> Result<Uploaded<'_>> {
        let Words { shape, leaves, seed, low, span } = Words::of(tile)?;
        let buffers = [
            self.buffer("shape", bytes_of(&shape), BufferUsages::UNIFORM)?,
            self.buffer("leaves", cast_slice(&leaves), BufferUsages::STORAGE)?,
            self.buffer("index", cast_slice(tile.index()), BufferUsages::STORAGE)?,
            self.buffer("samples", cast_slice(&seed), BufferUsages::STORAGE)?,
        ];
        let group = bound(self, "tile", self.tile_layout(), &buffers.each_ref());
        self.check()?;
        Ok(Uploaded { gpu: self, tile: group, size: tile.size(), low, span })
    }

    /// The values of a window, row by row: within 1e-4 of the tile's height range of those on the CPU.
    ///
    /// One tile, one window; for several windows [`upload`](Gpu::upload) once.
    ///
    /// # Errors
    /// As [`upload`](Gpu::upload) and [`Uploaded::decode`].
    pub fn decode(&self, tile: &Walk<2>, window: &Window) -> Result<Vec<f64>> {
        self.upload(tile)?.decode(window)
    }
}

impl Uploaded<'_> {
    /// The values of a window, row by row.
    ///
    /// # Errors
    /// Invalid for a window that reaches out of the tile, Limit for one that is too large, [`Error::Failed`](crate::Error::Failed)
    /// where the driver gives up.
    pub fn decode(&self, window: &Window) -> Result<Vec<f64>> {
        window.check(self.size)?;
        let mut out = vec![0.0; window.len()];
        if out.is_empty() {
            return Ok(out);
        }
        let room = self.room(window)?;
        for row in (0..window.rows).step_by(BLOCK as usize) {
            for col in (0..window.cols).step_by(BLOCK as usize) {
                let (cols, rows) = (BLOCK.min(window.cols - col), BLOCK.min(window.rows - row));
                let bytes = self.block(&room, window, [col, row], [cols, rows])?;
                let lines = bytes.chunks_exact(4 * cols as usize);
                for (line, row) in lines.zip(row as usize..) {
                    let at = row * window.cols as usize + col as usize;
                    let values = line.chunks_exact(4).map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]]));
                    for (out, v) in out[at..].iter_mut().zip(values) {
                        *out = self.height(v);
                    }
                }
            }
        }
        Ok(out)
    }

    /// The height that a share of the range stands for, as the shaders give it: 0 is the lowest sample at zoom 1, 1 the highest.
    pub fn height(&self, share: f32) -> f64 {
        self.low + self.span * f64::from(share)
    }

    /// Group 0 of the shaders.
    pub fn tile(&self) -> &wgpu::BindGroup {
        &self.tile
    }

    fn room(&self, window: &Window) -> Result<Room> {
        let gpu = self.gpu;
        let (cols, rows) = (u64::from(BLOCK.min(window.cols)), u64::from(BLOCK.min(window.rows)));
        let read = BufferUsages::STORAGE | BufferUsages::COPY_DST;
        let columns = gpu.room("columns", 8 * cols, read)?;
        let lines = gpu.room("rows", 8 * rows, read)?;
        let block = gpu.room("block", 16, BufferUsages::UNIFORM | BufferUsages::COPY_DST)?;
        let values = gpu.room("values", 4 * cols * rows, BufferUsages::STORAGE | BufferUsages::COPY_SRC)?;
        let back =
            gpu.room("values to read", 4 * cols * rows, BufferUsages::MAP_READ | BufferUsages::COPY_DST)?;
        let group = bound(gpu, "block", &gpu.blocks, &[&block, &columns, &lines, &values]);
        Ok(Room { columns, rows: lines, block, values, back, group })
    }

    /// The bytes of a block of `size` samples at `from`.
    fn block(&self, room: &Room, window: &Window, from: [u32; 2], size: [u32; 2]) -> Result<Vec<u8>> {
        let gpu = self.gpu;
        let [cols, rows] = size;
        gpu.queue().write_buffer(&room.columns, 0, cast_slice(&window.columns(from[0], cols)));
        gpu.queue().write_buffer(&room.rows, 0, cast_slice(&window.lines(from[1], rows)));
        gpu.queue().write_buffer(&room.block, 0, bytes_of(&[cols, rows, window.depth, 0]));
        let mut encoder = gpu.device().create_command_encoder(&Default::default());
        {
            let mut pass = encoder.begin_compute_pass(&Default::default());
            pass.set_pipeline(&gpu.decode);
            pass.set_bind_group(0, &self.tile, &[]);
            pass.set_bind_group(1, &room.group, &[]);
            pass.dispatch_workgroups(cols.div_ceil(GROUP), rows.div_ceil(GROUP), 1);
        }
        let bytes = 4 * u64::from(cols) * u64::from(rows);
        encoder.copy_buffer_to_buffer(&room.values, 0, &room.back, 0, bytes);
        gpu.queue().submit([encoder.finish()]);
        gpu.read(&room.back, bytes)
    }
}

/// Buffers at bindings 0, 1, 2 and so on.
fn bound(
    gpu: &Gpu,
    label: &str,
    layout: &wgpu::BindGroupLayout,
    buffers: &[&wgpu::Buffer],
) -> wgpu::BindGroup {
    let entries: Vec<_> = buffers
        .iter()
        .zip(0..)
        .map(|(b, binding)| wgpu::BindGroupEntry { binding, resource: b.as_entire_binding() })
        .collect();
    let descriptor = wgpu::BindGroupDescriptor { label: Some(label), layout, entries: &entries };
    gpu.device().create_bind_group(&descriptor)
}
