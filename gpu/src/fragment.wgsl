// The tile as a texture without texels: each fragment walks as far as its distance to the next asks for. Follows walk.wgsl.

struct View {
    // The part of the tile that `cover` draws, in cells: its corner, its extent.
    corner: vec2<f32>,
    extent: vec2<f32>,
    // Columns and rows of the tile; what lies beyond them is drawn as the border.
    size: vec2<f32>,
    // No fragment takes more steps.
    depth_max: u32,
}

@group(1) @binding(0) var<uniform> view: View;

struct Place {
    @builtin(position) position: vec4<f32>,
    // Cells of the zoom-1 grid.
    @location(0) cells: vec2<f32>,
}

// One triangle over the whole target, row 0 of the tile at the top.
@vertex
fn cover(@builtin(vertex_index) corner: u32) -> Place {
    let at = vec2<f32>(f32((corner << 1u) & 2u), f32(corner & 2u));
    var out: Place;
    out.position = vec4<f32>(2.0 * at.x - 1.0, 1.0 - 2.0 * at.y, 0.0, 1.0);
    out.cells = view.corner + at * view.extent;
    return out;
}

fn fixed(cells: f32, size: f32) -> vec2<u32> {
    // The greatest number below `size`, up to 16384 cells.
    let p = clamp(cells, 0.0, size - 0.001);
    return vec2<u32>(u32(p), u32(fract(p) * 4294967296.0));
}

// The number of doublings from one cell to the distance of neighbouring fragments. A hundredth of an octave is rounding.
fn depth_wanted(cells: vec2<f32>) -> u32 {
    let across = dpdx(cells);
    let down = dpdy(cells);
    let step = sqrt(max(dot(across, across), dot(down, down)));
    let octaves = ceil(-log2(max(step, 1e-9)) - 0.01);
    return u32(clamp(octaves, 0.0, f32(view.depth_max)));
}

@fragment
fn shade(in: Place) -> @location(0) vec4<f32> {
    let depth = depth_wanted(in.cells);
    let grey = walk(fixed(in.cells.x, view.size.x), fixed(in.cells.y, view.size.y), depth);
    return vec4<f32>(grey, grey, grey, 1.0);
}
