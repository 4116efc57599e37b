//! Heights at the posts of a lattice as triangles of the tree: only those that they need, none where there is no data.

use super::Grid;
use crate::base::{Error, Result, limits};
use crate::db::metres_per_unit;
use crate::export::{Going, go_on};
use crate::format::gltf::{Drape, DrapePicture, GlbMesh, write_draped_glb};
use crate::height::crs::AxisUnit;
use serde::Serialize;
use serde_json::{Map, Value, json};
use std::io::Write;
use terraquilt_codecs::gtb::bitree;
use terraquilt_codecs::lattice::Lattice;

/// Heights at every post of a square lattice, of which a grid is the corner.
pub struct Surface<'a> {
    /// The lattice.
    pub lattice: Lattice,
    /// Heights, row by row; all are numbers.
    pub z: &'a [f64],
    /// Posts without data, and those beyond the grid.
    pub free: &'a [bool],
    /// Where it lies.
    pub grid: &'a Grid,
    /// What heights count from: the larger, the more digits rounding takes.
    pub base: f64,
}

/// What a file says of a mesh.
#[derive(Default)]
pub struct Said<'a> {
    /// Coordinate system.
    pub crs: &'a str,
    /// How wrong the surface is, in the unit of heights; `None`: nobody knows.
    pub error: Option<f64>,
    /// Further entries.
    pub extras: Map<String, Value>,
}

/// A picture over a mesh.
pub struct Coat<'a> {
    /// Pixels in a row.
    pub cols: usize,
    /// Pixels.
    pub rgb: &'a [[u8; 3]],
    /// The place of a post on it: 0, 0 the upper left corner, 1, 1 the lower right one.
    pub uv: &'a dyn Fn(usize) -> [f32; 2],
}

/// How a mesh is written.
#[derive(Clone, Copy, Debug, Default)]
pub struct MeshRequest {
    /// One strip instead of triangles.
    pub strips: bool,
    /// The mesh may be this far from the surface, in the unit of heights.
    pub error: f64,
}

/// What there is to say of a mesh.
#[derive(Clone, Debug, Default, Serialize)]
pub struct MeshTold {
    /// Posts that are vertices.
    pub vertices: u64,
    /// Triangles that are drawn.
    pub triangles: u64,
    /// Indices of the strip.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub strip_length: Option<u64>,
    /// Farthest the mesh is from the surface at a post, in the unit of heights.
    pub mesh_error: f64,
}

/// The surface with fewer posts: which are selected, and the heights that result.
struct Thinned {
    selected: Vec<bool>,
    z: Vec<f64>,
    error: f64,
}

/// Selects from coarse to fine each post that the surface of those before it misses by more than `most`; with 0 the rest is
/// exactly the surface. Posts without data are selected only where triangles must end: around them every post is needed.
fn thin(p: &Surface, most: f64) -> Thinned {
    let (lattice, side) = (p.lattice, p.lattice.side());
    let mut selected = edges(lattice, p.free);
    let mut z = p.z.to_vec();
    let mut error = 0.0f64;
    for pass in lattice.passes() {
        for post in pass.posts(lattice) {
            let at = post[0] * side + post[1];
            let ([a, b], _) = pass.parents(lattice, post);
            let middle = (z[a[0] * side + a[1]] + z[b[0] * side + b[1]]) / 2.0;
            let off = (p.z[at] - middle).abs();
            // The surface was scaled after it was filled: its midpoints differ by rounding.
            let rounding = 4.0 * f64::EPSILON * (middle.abs() + p.base.abs());
            selected[at] |= off > most.max(rounding) && !p.free[at];
            if !selected[at] {
                z[at] = middle;
                if !p.free[at] && off > rounding {
                    error = error.max(off);
                }
            }
        }
    }
    Thinned { selected, z, error }
}

/// Posts whose triangles hold posts with data and posts without: split, down to the cells.
fn edges(lattice: Lattice, free: &[bool]) -> Vec<bool> {
    let side = lattice.side();
    if !free.contains(&true) {
        return vec![false; side * side];
    }
    const FREE: u8 = 1;
    const DATA: u8 = 2;
    let of = |at: usize| if free[at] { FREE } else { DATA };
    // What the finer posts hand on to their apexes.
    let mut below = vec![0u8; side * side];
    let mut out = vec![false; side * side];
    for pass in lattice.passes().rev() {
        for post in pass.posts(lattice) {
            let at = post[0] * side + post[1];
            let (ends, apexes) = pass.parents(lattice, post);
            let apexes = apexes.into_iter().flatten();
            let around = ends.into_iter().chain(apexes.clone()).map(|[y, x]| of(y * side + x));
            let seen = around.fold(below[at] | of(at), |a, b| a | b);
            out[at] = seen == FREE | DATA;
            for [y, x] in apexes {
                below[y * side + x] |= seen;
            }
        }
    }
    out
}

/// Writes a surface as GLB, its vertices posts of the lattice; textured if it has a coat.
///
/// # Errors
/// [`Error::Limit`] beyond the vertices of a mesh; what writing meets.
pub fn write_mesh(
    out: &mut dyn Write,
    p: &Surface,
    request: MeshRequest,
    said: Said,
    coat: Option<Coat>,
    going: Going,
) -> Result<MeshTold> {
    let (lattice, side) = (p.lattice, p.lattice.side());
    go_on(going, "mesh", 0.0)?;
    let thinned = thin(p, request.error);
    let needed = bitree::needed(lattice, &thinned.selected);
    go_on(going, "mesh", 0.3)?;
    let drawn = |t: &[u32; 3]| t.iter().all(|at| !p.free[*at as usize]);
    let mut triangles = bitree::triangles(lattice, &needed);
    triangles.retain(drawn);
    let mut number = vec![u32::MAX; side * side];
    triangles.iter().flatten().for_each(|at| number[*at as usize] = 0);
    let posts: Vec<usize> = (0..number.len()).filter(|at| number[*at] == 0).collect();
    if posts.len() > limits::MESH_VERTICES_MAX {
        return Err(Error::limit(
            "vertices of the mesh (give --mesh-error)",
            limits::MESH_VERTICES_MAX as u64,
            posts.len() as u64,
        ));
    }
    posts.iter().zip(0..).for_each(|(at, k)| number[*at] = k);
    go_on(going, "mesh", 0.6)?;
    let ground = Ground::new(p);
    let mut strip = request.strips.then(|| bitree::strip(lattice, &triangles));
    if ground.mirrored {
        triangles.iter_mut().for_each(|t| t.swap(1, 2));
        if let Some(strip) = strip.as_mut().filter(|s| !s.is_empty()) {
            strip.insert(0, strip[0]);
        }
    }
    let renumber = |at: &mut u32| *at = number[*at as usize];
    triangles.iter_mut().flatten().for_each(renumber);
    strip.iter_mut().flatten().for_each(renumber);
    let positions: Vec<[f64; 3]> = posts.iter().map(|at| ground.position(*at, thinned.z[*at])).collect();
    let normals: Vec<[f32; 3]> = posts.iter().map(|at| ground.normal(*at)).collect();
    go_on(going, "mesh", 0.8)?;
    let uv: Vec<[f32; 2]> = coat.iter().flat_map(|c| posts.iter().map(|at| (c.uv)(*at))).collect();
    let picture = coat.as_ref().map(|c| DrapePicture { cols: c.cols, rgb: c.rgb, uv: &uv });
    let mut extras = said.extras;
    extras.insert("mesh_error_m".into(), json!(thinned.error * ground.unit_m));
    if request.strips {
        extras.insert("strips".into(), json!("one, its parts joined by degenerate triangles"));
    }
    if p.grid.affine.is_none() {
        extras.insert("place".into(), json!("unknown: a metre is a post"));
    } else if p.grid.crs.as_ref().is_some_and(|c| c.unit == AxisUnit::Degree) {
        extras.insert(
            "projection".into(),
            json!("local: metres east and north of the origin, which is in degrees"),
        );
    }
    let mesh = GlbMesh {
        positions: &positions,
        normals: &normals,
        triangles: &triangles,
        colors: None,
        origin: ground.origin,
        crs: said.crs,
        error_m: said.error.map_or(f64::NAN, |e| (e + thinned.error) * ground.unit_m),
        version: 0,
        extras,
    };
    write_draped_glb(out, &mesh, &Drape { picture, strip: strip.as_deref() })?;
    Ok(MeshTold {
        vertices: posts.len() as u64,
        triangles: triangles.len() as u64,
        strip_length: strip.map(|s| s.len() as u64),
        mesh_error: thinned.error,
    })
}

/// Posts in metres around an origin.
struct Ground<'a> {
    p: &'a Surface<'a>,
    /// Metres of a step of columns and of rows, east and north.
    steps: [[f64; 2]; 2],
    /// Of the first post.
    first: [f64; 2],
    origin: [f64; 3],
    /// Metres of a unit of height.
    unit_m: f64,
    /// Rows run north where columns run east: triangles turn.
    mirrored: bool,
}

impl<'a> Ground<'a> {
    fn new(p: &'a Surface<'a>) -> Ground<'a> {
        let unit_m = p.grid.vertical_unit_m.unwrap_or(1.0);
        let heights = p.grid.z.iter().filter(|z| !z.is_nan());
        let (low, high) =
            heights.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), z| (l.min(*z), h.max(*z)));
        let up = if low <= high { (low + high) / 2.0 * unit_m } else { 0.0 };
        let (origin, col, row, scale) = match p.grid.affine {
            None => ([0.0; 2], [1.0, 0.0], [0.0, -1.0], [1.0; 2]),
            Some(a) => {
                let [c, r] = [(p.grid.cols - 1) as f64 / 2.0, (p.grid.rows - 1) as f64 / 2.0];
                let middle = [0, 1].map(|k| a.origin[k] + c * a.col_step[k] + r * a.row_step[k]);
                let unit = p.grid.crs.as_ref().map_or(AxisUnit::Metre(1.0), |c| c.unit);
                (middle, a.col_step, a.row_step, metres_per_unit(unit, middle))
            }
        };
        let steps = [col, row].map(|s| [s[0] * scale[0], s[1] * scale[1]]);
        let from = p.grid.affine.map_or([0.0; 2], |a| a.origin);
        let first = [0, 1].map(|k| (from[k] - origin[k]) * scale[k]);
        let mirrored = steps[0][0] * steps[1][1] - steps[0][1] * steps[1][0] > 0.0;
        Ground { p, steps, first, origin: [origin[0], origin[1], up], unit_m, mirrored }
    }

    fn position(&self, at: usize, z: f64) -> [f64; 3] {
        let side = self.p.lattice.side();
        let (col, row) = ((at % side) as f64, (at / side) as f64);
        let [x, y] = [0, 1].map(|k| self.first[k] + col * self.steps[0][k] + row * self.steps[1][k]);
        [x, y, z * self.unit_m - self.origin[2]]
    }

    /// Of the surface, by the posts beside one that have data.
    fn normal(&self, at: usize) -> [f32; 3] {
        let side = self.p.lattice.side();
        let rise = |before: Option<usize>, after: Option<usize>| {
            let there = |q: Option<usize>| q.filter(|q| !self.p.free[*q]);
            let (a, b) = (there(before).unwrap_or(at), there(after).unwrap_or(at));
            let posts = usize::from(a != at) + usize::from(b != at);
            (self.p.z[b] - self.p.z[a]) * self.unit_m / posts.max(1) as f64
        };
        let (col, row) = (at % side, at / side);
        let c = rise((col > 0).then(|| at - 1), (col + 1 < side).then_some(at + 1));
        let r = rise((row > 0).then(|| at - side), (row + 1 < side).then_some(at + side));
        let [a, b] = self.steps;
        let n = [a[1] * r - c * b[1], c * b[0] - a[0] * r, a[0] * b[1] - a[1] * b[0]];
        let n = if n[2] < 0.0 { n.map(|v| -v) } else { n };
        let length = (n[0] * n[0] + n[1] * n[1] + n[2] * n[2]).sqrt();
        n.map(|v| (v / length) as f32)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The triangles that a strip makes, as sorted rotations.
    fn made(strip: &[u32]) -> Vec<[u32; 3]> {
        let mut out = Vec::new();
        for (k, t) in strip.windows(3).enumerate() {
            let t = if k % 2 == 0 { [t[0], t[1], t[2]] } else { [t[1], t[0], t[2]] };
            if t[0] != t[1] && t[1] != t[2] && t[0] != t[2] {
                out.push(turned(t));
            }
        }
        out.sort_unstable();
        out
    }

    fn turned(t: [u32; 3]) -> [u32; 3] {
        let least = (0..3).min_by_key(|k| t[*k]).unwrap_or(0);
        [0, 1, 2].map(|k| t[(k + least) % 3])
    }

    #[test]
    fn a_strip_makes_the_triangles_that_are_drawn_and_no_other() {
        let mut state = 9u64;
        let mut random = || {
            state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
            (state >> 33) as u32
        };
        for n in 0..=4 {
            let lattice = Lattice::new(n).unwrap();
            for round in 0..20 {
                let posts = lattice.side() * lattice.side();
                let selected: Vec<bool> = (0..posts).map(|_| random() % 3 == 0).collect();
                let free: Vec<bool> = (0..posts).map(|_| round > 4 && random() % 5 == 0).collect();
                let needed = bitree::needed(lattice, &selected);
                let drawn = |t: &[u32; 3]| t.iter().all(|at| !free[*at as usize]);
                let kept: Vec<[u32; 3]> =
                    bitree::triangles(lattice, &needed).into_iter().filter(drawn).collect();
                let mut triangles: Vec<[u32; 3]> = kept.iter().copied().map(turned).collect();
                triangles.sort_unstable();
                assert_eq!(made(&bitree::strip(lattice, &kept)), triangles, "n {n}");
            }
        }
    }

    #[test]
    fn around_posts_without_data_every_cell_is_split_and_elsewhere_none() {
        let lattice = Lattice::new(4).unwrap();
        let mut free = vec![false; 17 * 17];
        assert!(!edges(lattice, &free).contains(&true));
        free[5 * 17 + 6] = true;
        let needed = bitree::needed(lattice, &edges(lattice, &free));
        let triangles = bitree::triangles(lattice, &needed);
        // All but the triangles of the cells around it are drawn, and those have the size of half a cell.
        let area = |t: &[u32; 3]| {
            let [a, b, c] = t.map(|at| [i64::from(at) % 17, i64::from(at) / 17]);
            ((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])).abs()
        };
        let (gone, kept): (Vec<_>, Vec<_>) = triangles.iter().partition(|t| t.contains(&(5 * 17 + 6)));
        assert!(gone.iter().all(|t| area(t) == 1) && !gone.is_empty());
        let left: i64 = kept.iter().map(area).sum();
        assert_eq!(left + gone.len() as i64, 2 * 16 * 16);
        assert!(edges(lattice, &vec![true; 17 * 17]).iter().all(|e| !e));
    }
}
