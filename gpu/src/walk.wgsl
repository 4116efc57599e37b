// The inverse walk through a fractal tile, for compute and fragment shaders alike.
//
// A place along an axis is two words: whole cells of the zoom-1 grid, and 2^-32 parts of a cell. Doubling and mirroring
// are then exact: no zoom is too deep for the steps to find the leaves that exact arithmetic finds.

struct Shape {
    // Columns and rows of the zoom-1 grid, in whole ranges of the largest side.
    size: vec2<u32>,
    // Entries in a row of the index.
    across: u32,
    // The side of an index entry is 2^shift cells.
    shift: u32,
}

struct Leaf {
    range: vec2<u32>,
    domain: vec2<u32>,
    side: u32,
    // 1: the axes change places; 2: columns backwards; 4: rows backwards.
    turn: u32,
    scale: f32,
    offset: f32,
}

@group(0) @binding(0) var<uniform> shape: Shape;
@group(0) @binding(1) var<storage, read> leaves: array<Leaf>;
@group(0) @binding(2) var<storage, read> index: array<u32>;
@group(0) @binding(3) var<storage, read> seed: array<f32>;

// side - p
fn mirrored(p: vec2<u32>, side: u32) -> vec2<u32> {
    return vec2<u32>(side - p.x - select(0u, 1u, p.y != 0u), 0u - p.y);
}

// corner + 2 p
fn doubled(p: vec2<u32>, corner: u32) -> vec2<u32> {
    return vec2<u32>(corner + ((p.x << 1u) | (p.y >> 31u)), p.y << 1u);
}

// The centre of the part of side 2^-depth that holds a place: mirrors keep it off the edges of ranges.
fn centred(p: vec2<u32>, depth: u32) -> vec2<u32> {
    let half = 0x80000000u >> min(depth, 31u);
    return vec2<u32>(p.x, (p.y & ~((half << 1u) - 1u)) | half);
}

// The value at a place in the tile after `depth` steps, in shares of the height range.
fn walk(x_start: vec2<u32>, y_start: vec2<u32>, depth: u32) -> f32 {
    var x = centred(x_start, depth);
    var y = centred(y_start, depth);
    var sum = 0.0;
    var factor = 1.0;
    for (var step = 0u; step < depth; step++) {
        let cell = vec2<u32>(x.x, y.x) >> vec2<u32>(shape.shift);
        let number = index[cell.y * shape.across + cell.x];
        // Flat ground: the sample at zoom 1 is its height.
        if number == 0xffffffffu {
            break;
        }
        let leaf = leaves[number];
        sum += factor * leaf.offset;
        factor *= leaf.scale;
        var u = vec2<u32>(x.x - leaf.range.x, x.y);
        var v = vec2<u32>(y.x - leaf.range.y, y.y);
        if (leaf.turn & 1u) != 0u {
            let t = u;
            u = v;
            v = t;
        }
        if (leaf.turn & 2u) != 0u {
            u = mirrored(u, leaf.side);
        }
        if (leaf.turn & 4u) != 0u {
            v = mirrored(v, leaf.side);
        }
        x = doubled(u, leaf.domain.x);
        y = doubled(v, leaf.domain.y);
    }
    return sum + factor * seed[y.x * shape.size.x + x.x];
}
