//! Meshes made in code, and their exact distances.

use terraquilt_codecs::solid::Mesh;

/// A box from `min` to `max`, outward-facing.
pub fn cuboid(min: [f64; 3], max: [f64; 3]) -> Mesh {
    let corner = |c: usize| [0, 1, 2].map(|k| if c >> k & 1 == 1 { max[k] } else { min[k] });
    let quads = [[0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]];
    let triangles = quads.iter().flat_map(|[a, b, c, d]: &[u32; 4]| [[*a, *b, *c], [*a, *c, *d]]).collect();
    Mesh { positions: (0..8).map(corner).collect(), triangles }
}

/// A grid of `n` by `m` that closes on itself both ways, without the poles that `at` maps to one point.
fn closed(n: u32, m: u32, at: impl Fn(f64, f64) -> [f64; 3]) -> Mesh {
    let mut mesh = Mesh::default();
    for j in 0..m {
        for i in 0..n {
            mesh.positions.push(at(f64::from(i) / f64::from(n), f64::from(j) / f64::from(m)));
            let v = |i: u32, j: u32| (j % m) * n + i % n;
            let (a, b, c, d) = (v(i, j), v(i + 1, j), v(i + 1, j + 1), v(i, j + 1));
            mesh.triangles.extend([[a, b, c], [a, c, d]]);
        }
    }
    mesh
}

/// A torus round the z axis: `r` from the axis to the middle of the tube, `t` the tube's own radius.
pub fn torus(r: f64, t: f64, n: u32) -> Mesh {
    use std::f64::consts::TAU;
    closed(n, n / 2, |u, v| {
        let (su, cu) = (u * TAU).sin_cos();
        let (sv, cv) = (v * TAU).sin_cos();
        [(r + t * cv) * cu, (r + t * cv) * su, t * sv]
    })
}

/// A sphere: the octahedron, each triangle divided `depth` times, its corners brought to the radius.
pub fn sphere(middle: [f64; 3], radius: f64, depth: u32) -> Mesh {
    let mut triangles: Vec<[[f64; 3]; 3]> = Vec::new();
    for octant in 0..8 {
        let sign = |k: usize| if octant >> k & 1 == 1 { -1.0 } else { 1.0 };
        let (x, y, z) = ([sign(0), 0.0, 0.0], [0.0, sign(1), 0.0], [0.0, 0.0, sign(2)]);
        let even = (octant as u32).count_ones().is_multiple_of(2);
        triangles.push(if even { [x, y, z] } else { [y, x, z] });
    }
    for _ in 0..depth {
        let between = |a: [f64; 3], b: [f64; 3]| {
            let m = [0, 1, 2].map(|k| a[k] + b[k]);
            let length = m.iter().map(|v| v * v).sum::<f64>().sqrt();
            m.map(|v| v / length)
        };
        triangles = triangles
            .into_iter()
            .flat_map(|[a, b, c]| {
                let (ab, bc, ca) = (between(a, b), between(b, c), between(c, a));
                [[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]
            })
            .collect();
    }
    // Corners apart: reading a mesh has to join them.
    let positions =
        triangles.iter().flatten().map(|p| [0, 1, 2].map(|k| middle[k] + radius * p[k])).collect();
    Mesh {
        positions,
        triangles: (0..triangles.len() as u32).map(|k| [3 * k, 3 * k + 1, 3 * k + 2]).collect(),
    }
}

/// Two meshes in one.
pub fn both(a: &Mesh, b: &Mesh) -> Mesh {
    let mut out = a.clone();
    let shift = out.positions.len() as u32;
    out.positions.extend(&b.positions);
    out.triangles.extend(b.triangles.iter().map(|t| t.map(|v| v + shift)));
    out
}

/// The signed distance of a point to a box, positive inside.
pub fn to_cuboid(p: [f64; 3], min: [f64; 3], max: [f64; 3]) -> f64 {
    let d = [0, 1, 2].map(|k| (min[k] - p[k]).max(p[k] - max[k]));
    let outside = d.iter().map(|v| v.max(0.0) * v.max(0.0)).sum::<f64>().sqrt();
    if outside > 0.0 { -outside } else { -d[0].max(d[1]).max(d[2]) }
}

/// The signed distance of a point to a torus as [`torus`]'s, smooth.
pub fn to_torus(p: [f64; 3], r: f64, t: f64) -> f64 {
    let ring = p[0].hypot(p[1]) - r;
    t - ring.hypot(p[2])
}

/// Number of edges that have not exactly two triangles that face the same way.
pub fn bad_edges(mesh: &Mesh) -> usize {
    let mut sides: Vec<([u32; 2], bool)> = Vec::new();
    for t in &mesh.triangles {
        for k in 0..3 {
            let (a, b) = (t[k], t[(k + 1) % 3]);
            sides.push(([a.min(b), a.max(b)], a < b));
        }
    }
    sides.sort();
    sides.chunk_by(|a, b| a.0 == b.0).filter(|g| g.len() != 2 || g[0].1 == g[1].1).count()
}

/// The least area of a triangle.
pub fn least_area(mesh: &Mesh) -> f64 {
    let area = |t: usize| {
        let [a, b, c] = mesh.corners(t);
        let (u, v) = ([0, 1, 2].map(|k| b[k] - a[k]), [0, 1, 2].map(|k| c[k] - a[k]));
        let n = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]];
        n.iter().map(|x| x * x).sum::<f64>().sqrt() / 2.0
    };
    (0..mesh.triangles.len()).map(area).fold(f64::INFINITY, f64::min)
}
