//! The GPU: found, opened, and held to account. The only place that asks whether a call went wrong.

use crate::{Error, Result};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::{Arc, Mutex, PoisonError, mpsc};
use wgpu::{BufferUsages, MapMode};

/// A GPU (or a driver that computes on the processor), opened.
pub struct Gpu {
    device: wgpu::Device,
    queue: wgpu::Queue,
    name: String,
    faults: Arc<Faults>,
    tiles: wgpu::BindGroupLayout,
    pub(crate) blocks: wgpu::BindGroupLayout,
    pub(crate) decode: wgpu::ComputePipeline,
}

/// The first complaint since it was last asked.
#[derive(Default)]
struct Faults(Mutex<Option<String>>);

impl Faults {
    fn note(&self, what: String) {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert(what);
    }

    fn take(&self) -> Option<String> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).take()
    }
}

impl Gpu {
    /// Opens the fastest Vulkan adapter. Takes some tenths of a second; keep it.
    ///
    /// # Errors
    /// [`Error::Absent`] where there is none, or it lacks what every WebGPU adapter has.
    pub fn open() -> Result<Gpu> {
        let instance = wgpu::Instance::new(&wgpu::InstanceDescriptor {
            backends: wgpu::Backends::VULKAN,
            flags: wgpu::InstanceFlags::empty(),
            ..Default::default()
        });
        let options = wgpu::RequestAdapterOptions {
            power_preference: wgpu::PowerPreference::HighPerformance,
            ..Default::default()
        };
        let absent = |reason: String| Error::Absent { reason };
        let adapter = pollster::block_on(instance.request_adapter(&options));
        let adapter = adapter.ok_or_else(|| absent("Vulkan finds no adapter".into()))?;
        let (info, has) = (adapter.get_info(), adapter.limits());
        let name = format!("{} ({})", info.name, info.driver_info);
        // What every adapter has; but as large buffers as this one offers.
        let required_limits = wgpu::Limits {
            max_buffer_size: has.max_buffer_size,
            max_storage_buffer_binding_size: has.max_storage_buffer_binding_size,
            ..Default::default()
        };
        let wanted =
            wgpu::DeviceDescriptor { label: Some("terraquilt"), required_limits, ..Default::default() };
        let opened = pollster::block_on(adapter.request_device(&wanted, None));
        let (device, queue) = opened.map_err(|e| absent(format!("{name}: {e}")))?;

        let faults = Arc::new(Faults::default());
        let (errors, losses) = (faults.clone(), faults.clone());
        device.on_uncaptured_error(Box::new(move |e| errors.note(e.to_string())));
        device.set_device_lost_callback(move |reason, text| {
            losses.note(format!("the device is lost ({reason:?}) {text}"));
        });
        let (tiles, blocks) = (tile_layout(&device), block_layout(&device));
        let decode = compute_pipeline(&device, &[&tiles, &blocks]);
        let gpu = Gpu { device, queue, name, faults, tiles, blocks, decode };
        gpu.check()?;
        Ok(gpu)
    }

    /// The adapter's name and its driver's.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// For programs that draw. An error that wgpu reports about it comes back from the next call of this crate.
    pub fn device(&self) -> &wgpu::Device {
        &self.device
    }

    /// As [`device`](Gpu::device).
    pub fn queue(&self) -> &wgpu::Queue {
        &self.queue
    }

    /// Group 0 of both shaders: what [`Uploaded::tile`](crate::Uploaded::tile) is bound to.
    pub fn tile_layout(&self) -> &wgpu::BindGroupLayout {
        &self.tiles
    }

    /// What went wrong since the last time this was asked.
    ///
    /// # Errors
    /// [`Error::Failed`], in the driver's words.
    pub fn check(&self) -> Result<()> {
        match self.faults.take() {
            Some(reason) => Err(self.failed(reason)),
            None => Ok(()),
        }
    }

    fn failed(&self, reason: impl ToString) -> Error {
        Error::Failed { adapter: self.name.clone(), reason: reason.to_string() }
    }

    /// A buffer with these bytes.
    ///
    /// # Errors
    /// Limit if the adapter takes no buffer of that size.
    pub(crate) fn buffer(
        &self,
        what: &'static str,
        bytes: &[u8],
        usage: BufferUsages,
    ) -> Result<wgpu::Buffer> {
        let out = self.room(what, bytes.len() as u64, usage | BufferUsages::COPY_DST)?;
        self.queue.write_buffer(&out, 0, bytes);
        Ok(out)
    }

    /// A buffer of so many bytes, all 0.
    ///
    /// # Errors
    /// As [`buffer`](Gpu::buffer).
    pub(crate) fn room(&self, what: &'static str, bytes: u64, usage: BufferUsages) -> Result<wgpu::Buffer> {
        let limits = self.device.limits();
        let bound = u64::from(limits.max_storage_buffer_binding_size);
        let limit =
            if usage.contains(BufferUsages::STORAGE) { bound } else { u64::MAX }.min(limits.max_buffer_size);
        if bytes > limit {
            return Err(terraquilt_codecs::Error::Limit { what, limit, wanted: bytes }.into());
        }
        let descriptor =
            wgpu::BufferDescriptor { label: Some(what), size: bytes, usage, mapped_at_creation: false };
        Ok(self.device.create_buffer(&descriptor))
    }

    /// Waits for what was submitted and reads the first bytes of a buffer that can be mapped.
    ///
    /// # Errors
    /// [`Error::Failed`] for any complaint since the last check, and if the GPU takes longer than a minute.
    pub fn read(&self, buffer: &wgpu::Buffer, bytes: u64) -> Result<Vec<u8>> {
        self.check()?;
        let (send, mapped) = mpsc::channel();
        buffer.slice(..bytes).map_async(MapMode::Read, move |r| {
            let _ = send.send(r);
        });
        // A device lost while it is waited for makes wgpu panic.
        let waited = catch_unwind(AssertUnwindSafe(|| self.device.poll(wgpu::Maintain::Wait)));
        self.check()?;
        waited.map_err(|_| self.failed("the device was lost"))?;
        match mapped.try_recv() {
            Ok(Ok(())) => {
                let out = buffer.slice(..bytes).get_mapped_range().to_vec();
                buffer.unmap();
                Ok(out)
            }
            Ok(Err(e)) => Err(self.failed(e)),
            Err(_) => Err(self.failed("no answer within a minute")),
        }
    }
}

fn tile_layout(device: &wgpu::Device) -> wgpu::BindGroupLayout {
    let seen = wgpu::ShaderStages::COMPUTE | wgpu::ShaderStages::FRAGMENT;
    let entries = [uniform(0, seen), storage(1, seen, true), storage(2, seen, true), storage(3, seen, true)];
    device
        .create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor { label: Some("tile"), entries: &entries })
}

fn block_layout(device: &wgpu::Device) -> wgpu::BindGroupLayout {
    let seen = wgpu::ShaderStages::COMPUTE;
    let entries = [uniform(0, seen), storage(1, seen, true), storage(2, seen, true), storage(3, seen, false)];
    device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
        label: Some("block"),
        entries: &entries,
    })
}

fn uniform(binding: u32, visibility: wgpu::ShaderStages) -> wgpu::BindGroupLayoutEntry {
    entry(binding, visibility, wgpu::BufferBindingType::Uniform)
}

fn storage(binding: u32, visibility: wgpu::ShaderStages, read_only: bool) -> wgpu::BindGroupLayoutEntry {
    entry(binding, visibility, wgpu::BufferBindingType::Storage { read_only })
}

fn entry(
    binding: u32,
    visibility: wgpu::ShaderStages,
    kind: wgpu::BufferBindingType,
) -> wgpu::BindGroupLayoutEntry {
    let ty = wgpu::BindingType::Buffer { ty: kind, has_dynamic_offset: false, min_binding_size: None };
    wgpu::BindGroupLayoutEntry { binding, visibility, ty, count: None }
}

fn compute_pipeline(device: &wgpu::Device, groups: &[&wgpu::BindGroupLayout]) -> wgpu::ComputePipeline {
    let module = device.create_shader_module(wgpu::ShaderModuleDescriptor {
        label: Some("decode"),
        source: wgpu::ShaderSource::Wgsl(crate::shader::compute().into()),
    });
    let layout = device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
        label: Some("decode"),
        bind_group_layouts: groups,
        push_constant_ranges: &[],
    });
    device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
        label: Some("decode"),
        layout: Some(&layout),
        module: &module,
        entry_point: Some("decode"),
        compilation_options: Default::default(),
        cache: None,
    })
}
