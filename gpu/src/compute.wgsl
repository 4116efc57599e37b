// One value per invocation, of a block of a window. Follows walk.wgsl.

struct Block {
    cols: u32,
    rows: u32,
    depth: u32,
}

@group(1) @binding(0) var<uniform> block: Block;
@group(1) @binding(1) var<storage, read> columns: array<vec2<u32>>;
@group(1) @binding(2) var<storage, read> rows: array<vec2<u32>>;
@group(1) @binding(3) var<storage, read_write> values: array<f32>;

@compute @workgroup_size(8, 8)
fn decode(@builtin(global_invocation_id) id: vec3<u32>) {
    if id.x < block.cols && id.y < block.rows {
        values[id.y * block.cols + id.x] = walk(columns[id.x], rows[id.y], block.depth);
    }
}
