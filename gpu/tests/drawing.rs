use crate::support::{gpu, range, tile};
use terraquilt_codecs::fractal::Walk;
use terraquilt_gpu::wgpu::util::{BufferInitDescriptor, DeviceExt};
use terraquilt_gpu::{Gpu, Result, Uploaded, shader, wgpu};

/// Pixels along each side of the picture.
const SIDE: u32 = 128;
const FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::Rgba32Float;

/// What the fragment shader draws of the square of `extent` cells at `corner`: for each pixel the share of the height range.
fn drawn(gpu: &Gpu, tile: &Uploaded, walk: &Walk<2>, corner: [f32; 2], extent: f32) -> Result<Vec<f32>> {
    let device = gpu.device();
    let [cols, rows] = walk.size().map(|n| n as f32);
    let mut view: Vec<u8> = [corner[0], corner[1], extent, extent, cols, rows].map(f32::to_le_bytes).concat();
    view.extend([24_u32, 0].map(u32::to_le_bytes).concat());
    let usage = wgpu::BufferUsages::UNIFORM;
    let view = device.create_buffer_init(&BufferInitDescriptor { label: None, contents: &view, usage });
    let text = wgpu::ShaderSource::Wgsl(shader::fragment().into());
    let module = &device.create_shader_module(wgpu::ShaderModuleDescriptor { label: None, source: text });
    let view_layout = device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
        label: None,
        entries: &[wgpu::BindGroupLayoutEntry {
            binding: 0,
            visibility: wgpu::ShaderStages::VERTEX_FRAGMENT,
            ty: wgpu::BindingType::Buffer {
                ty: wgpu::BufferBindingType::Uniform,
                has_dynamic_offset: false,
                min_binding_size: None,
            },
            count: None,
        }],
    });
    let layout = device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
        label: None,
        bind_group_layouts: &[gpu.tile_layout(), &view_layout],
        push_constant_ranges: &[],
    });
    let pipeline = device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
        label: None,
        layout: Some(&layout),
        vertex: wgpu::VertexState {
            module,
            entry_point: Some("cover"),
            compilation_options: Default::default(),
            buffers: &[],
        },
        fragment: Some(wgpu::FragmentState {
            module,
            entry_point: Some("shade"),
            compilation_options: Default::default(),
            targets: &[Some(FORMAT.into())],
        }),
        primitive: Default::default(),
        depth_stencil: None,
        multisample: Default::default(),
        multiview: None,
        cache: None,
    });
    let group = device.create_bind_group(&wgpu::BindGroupDescriptor {
        label: None,
        layout: &view_layout,
        entries: &[wgpu::BindGroupEntry { binding: 0, resource: view.as_entire_binding() }],
    });
    let size = wgpu::Extent3d { width: SIDE, height: SIDE, depth_or_array_layers: 1 };
    let target = device.create_texture(&wgpu::TextureDescriptor {
        label: None,
        size,
        mip_level_count: 1,
        sample_count: 1,
        dimension: wgpu::TextureDimension::D2,
        format: FORMAT,
        usage: wgpu::TextureUsages::RENDER_ATTACHMENT | wgpu::TextureUsages::COPY_SRC,
        view_formats: &[],
    });
    let bytes = 16 * u64::from(SIDE) * u64::from(SIDE);
    let back = device.create_buffer(&wgpu::BufferDescriptor {
        label: None,
        size: bytes,
        usage: wgpu::BufferUsages::MAP_READ | wgpu::BufferUsages::COPY_DST,
        mapped_at_creation: false,
    });
    let mut encoder = device.create_command_encoder(&Default::default());
    {
        let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            color_attachments: &[Some(wgpu::RenderPassColorAttachment {
                view: &target.create_view(&Default::default()),
                resolve_target: None,
                ops: Default::default(),
            })],
            ..Default::default()
        });
        pass.set_pipeline(&pipeline);
        pass.set_bind_group(0, tile.tile(), &[]);
        pass.set_bind_group(1, &group, &[]);
        pass.draw(0..3, 0..1);
    }
    let rows =
        wgpu::TexelCopyBufferLayout { offset: 0, bytes_per_row: Some(16 * SIDE), rows_per_image: None };
    encoder.copy_texture_to_buffer(
        target.as_image_copy(),
        wgpu::TexelCopyBufferInfo { buffer: &back, layout: rows },
        size,
    );
    gpu.queue().submit([encoder.finish()]);
    let pixels = gpu.read(&back, bytes)?;
    Ok(pixels.chunks_exact(16).map(|p| f32::from_le_bytes([p[0], p[1], p[2], p[3]])).collect())
}

/// The shader finds the depth by itself, from the distance of the fragments: that of the zoom.
#[test]
fn what_is_drawn_is_what_the_cpu_walks() {
    let Some(gpu) = gpu() else { return };
    let walk = tile(1, [256, 128], 0);
    let tile = gpu.upload(&walk).unwrap();
    for (zoom, depth) in [(1_u16, 0), (2, 1), (8, 3), (64, 6), (256, 8)] {
        let extent = SIDE as f32 / f32::from(zoom);
        for corner in [[0.0, 0.0], [128.0 - extent, 128.0 - extent], [32.0 + extent.min(8.0), 0.0]] {
            let picture = drawn(gpu, &tile, &walk, corner, extent).unwrap();
            assert_eq!(picture.len(), (SIDE * SIDE) as usize);
            let mut furthest: f64 = 0.0;
            for (k, share) in picture.iter().enumerate() {
                let pixel = [k as u32 % SIDE, k as u32 / SIDE];
                let at = [0, 1].map(|a| f64::from(corner[a]) + (f64::from(pixel[a]) + 0.5) / f64::from(zoom));
                furthest = furthest.max((tile.height(*share) - walk.value(at, depth)).abs());
            }
            let share = furthest / range(&walk);
            println!("zoom {zoom} at {corner:?}: {share:e} of the range");
            assert!(share <= 1e-4, "zoom {zoom} at {corner:?}: {share} of the range apart");
        }
    }
}
