//! Tiles: parts of a mesh whose corners fit 16 bits from a corner of their own.
//!
//! The corner is a point of the lattice, so a vertex on the side of two tiles decodes to the same three numbers in
//! both: corner + offset is the same whole number, and whole numbers of this size times a power of two are exact in
//! 32-bit floats.

/// The triangles of a part, and its vertices in the order of their first use.
pub(super) struct Tile {
    /// The point of the lattice that its 16-bit positions count from; `None`: triangles too wide for 16 bits, written
    /// as 32-bit floats.
    pub corner: Option<[i32; 3]>,
    /// Indices into the mesh's positions.
    pub vertices: Vec<u32>,
    /// Indices into `vertices`.
    pub triangles: Vec<[u32; 3]>,
}

/// Extent of a tile, quanta, and vertices in it: 16-bit positions, and 16-bit indices, of which the largest means
/// "restart" and is not used.
const WIDEST: i64 = u16::MAX as i64;
const VERTICES_MAX: usize = u16::MAX as usize;

/// Triangles hang over the cuts: room for this part of a tile's width.
const OVERHANG: i64 = 32;

/// A tile of fewer triangles costs more in the JSON than 16 bits save.
const FEWEST: usize = 256;

/// Splits a mesh, cutting along the longer side until each part fits. Parts of few triangles that still do not fit
/// are joined to one of 32-bit floats, the last. Triangles keep their order within a tile.
pub(super) fn split(points: &[[i32; 3]], triangles: &[[u32; 3]]) -> Vec<Tile> {
    let mut tiles = Vec::new();
    let mut wide: Vec<u32> = Vec::new();
    let mut used = Used { by: vec![0; points.len()], part: 0 };
    let mut parts = vec![(0..triangles.len() as u32).collect::<Vec<u32>>()];
    while let Some(mut part) = parts.pop() {
        if part.is_empty() {
            continue;
        }
        let [lo, hi] = bounds(points, triangles, &part);
        let fits = (0..3).all(|k| i64::from(hi[k]) - i64::from(lo[k]) <= WIDEST);
        if fits && used.count(triangles, &part) <= VERTICES_MAX {
            tiles.push(tile(triangles, &mut part, Some(lo)));
        } else if part.len() < FEWEST {
            wide.append(&mut part);
        } else {
            let axis = if hi[0].abs_diff(lo[0]) >= hi[2].abs_diff(lo[2]) { 0 } else { 2 };
            let right = cut(points, triangles, &mut part, axis, [lo[axis], hi[axis]]);
            parts.push(right);
            parts.push(part);
        }
    }
    if !wide.is_empty() {
        tiles.push(tile(triangles, &mut wide, None));
    }
    tiles
}

/// Takes the far part out of `part`: cuts that leave as many tiles as the extent needs, or half of the triangles.
fn cut(
    points: &[[i32; 3]],
    triangles: &[[u32; 3]],
    part: &mut Vec<u32>,
    axis: usize,
    [lo, hi]: [i32; 2],
) -> Vec<u32> {
    // Thrice the middle of a triangle.
    let middle =
        |t: u32| -> i64 { triangles[t as usize].iter().map(|&v| i64::from(points[v as usize][axis])).sum() };
    let extent = i64::from(hi) - i64::from(lo);
    let tiles = extent / (WIDEST - WIDEST / OVERHANG) + 1;
    let at: i64 = 3 * (i64::from(lo) + extent * (tiles / 2) / tiles);
    let (near, far): (Vec<u32>, Vec<u32>) = part.iter().partition(|&&t| middle(t) < at);
    if tiles > 1 && !near.is_empty() && !far.is_empty() {
        *part = near;
        return far;
    }
    let half = part.len() / 2;
    part.select_nth_unstable_by_key(half, |&t| (middle(t), t));
    part.split_off(half)
}

/// Smallest and largest coordinates of the corners.
fn bounds(points: &[[i32; 3]], triangles: &[[u32; 3]], part: &[u32]) -> [[i32; 3]; 2] {
    let (mut lo, mut hi) = ([i32::MAX; 3], [i32::MIN; 3]);
    for v in part.iter().flat_map(|&t| triangles[t as usize]) {
        for k in 0..3 {
            lo[k] = lo[k].min(points[v as usize][k]);
            hi[k] = hi[k].max(points[v as usize][k]);
        }
    }
    [lo, hi]
}

/// Which part used a vertex last.
struct Used {
    by: Vec<u32>,
    part: u32,
}

impl Used {
    /// Vertices of a part.
    fn count(&mut self, triangles: &[[u32; 3]], part: &[u32]) -> usize {
        self.part += 1;
        let mut count = 0;
        for v in part.iter().flat_map(|&t| triangles[t as usize]) {
            let by = &mut self.by[v as usize];
            count += usize::from(*by != self.part);
            *by = self.part;
        }
        count
    }
}

fn tile(triangles: &[[u32; 3]], part: &mut [u32], corner: Option<[i32; 3]>) -> Tile {
    part.sort_unstable();
    let mut local = std::collections::HashMap::with_capacity(part.len());
    let mut vertices = Vec::new();
    let triangles = part
        .iter()
        .map(|&t| {
            triangles[t as usize].map(|v| {
                *local.entry(v).or_insert_with(|| {
                    vertices.push(v);
                    vertices.len() as u32 - 1
                })
            })
        })
        .collect();
    Tile { corner, vertices, triangles }
}
