//! The surface of a prefix as triangles, with its picture.

use super::prefix::Prefix;
use crate::base::Result;
use crate::export::Going;
use crate::export::grid::{self, Coat, MeshRequest, MeshTold, Said, Surface};
use serde_json::{Map, Value, json};
use std::io::Write;
use terraquilt_codecs::gtb::Profile;

/// Colour of cells without a picture, sRGB: dry grass and rock.
const BARE: [u8; 3] = [182, 175, 158];

/// Writes the surface of a prefix as GLB: textured if it has a picture, its vertices posts of the lattice.
///
/// # Errors
/// [`Error::Limit`](crate::base::Error::Limit) beyond the vertices of a mesh; what writing meets.
pub fn write_mesh(out: &mut dyn Write, p: &Prefix, request: MeshRequest, going: Going) -> Result<MeshTold> {
    let lattice = p.header.lattice;
    let surface = Surface { lattice, z: &p.surface, free: &p.free, grid: &p.grid, base: p.header.place.base };
    let said = Said { crs: &p.header.place.crs, error: Some(p.reached.error_bound), extras: extras(p) };
    let painted = p.picture.as_ref().map(|cells| Painted::new(p, cells));
    let uv = |at: usize| painted.as_ref().map_or([0.0; 2], |x| x.uv(at, lattice.side()));
    let coat = painted.as_ref().map(|x| Coat { cols: x.cols, rgb: &x.rgb, uv: &uv });
    grid::write_mesh(out, &surface, request, said, coat, going)
}

fn extras(p: &Prefix) -> Map<String, Value> {
    let mut extras = Map::new();
    extras.insert("source".into(), json!(p.header.place.source));
    extras.insert("complete".into(), json!(p.reached.complete));
    extras.insert("spacing_posts".into(), json!(p.reached.spacing));
    let profile = match p.header.profile {
        Profile::Sparse => "sparse",
        Profile::Cubic => "cubic",
        Profile::Adaptive => "adaptive",
    };
    extras.insert("profile".into(), json!(profile));
    if p.picture.is_some() {
        // What was measured and what was made up cannot be told apart in it.
        extras.insert("texture".into(), json!("synthetic"));
    }
    extras
}

/// The part of a picture that lies over the grid.
struct Painted {
    cols: usize,
    rows: usize,
    rgb: Vec<[u8; 3]>,
    cells_a_post: f64,
}

impl Painted {
    fn new(p: &Prefix, cells: &terraquilt_codecs::gtb::texture::Cells) -> Painted {
        let side = 1usize << cells.n;
        let cells_a_post = side as f64 / p.header.lattice.last() as f64;
        let over = |posts: usize| (((posts - 1) as f64 * cells_a_post).ceil() as usize).clamp(1, side);
        let (cols, rows) = (over(p.grid.cols), over(p.grid.rows));
        let is_void = |at: usize| cells.void.get(at).copied().unwrap_or(false);
        let rgb = (0..rows)
            .flat_map(|i| (0..cols).map(move |j| i * side + j))
            .map(|at| if is_void(at) { BARE } else { cells.rgb[at] })
            .collect();
        Painted { cols, rows, rgb, cells_a_post }
    }

    fn uv(&self, at: usize, side: usize) -> [f32; 2] {
        let place = |post: usize, cells: usize| (post as f64 * self.cells_a_post / cells as f64) as f32;
        [place(at % side, self.cols), place(at / side, self.rows)]
    }
}
