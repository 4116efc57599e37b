//! `export` of .glb: its options, and what is said of a mesh.

use super::output::count;
use crate::export::MeshFound;
use clap::Args;

/// How a .glb is written.
#[derive(Args, Clone, Copy, Default)]
pub struct Packing {
    /// .glb: 16-bit positions, 8-bit normals (KHR_mesh_quantization); goes with --error
    #[arg(long)]
    pub quantize: bool,
    /// .glb: --quantize and compressed (EXT_meshopt_compression; needs a build with meshopt)
    #[arg(long)]
    pub meshopt: bool,
}

/// One line for people.
pub fn text(m: &MeshFound) -> String {
    let lattice = m.compacted.map_or(String::new(), |c| {
        format!(", lattice of {} m {:.3} in {} tiles", c.quantum_m, c.quantization_error_m, count(c.tiles))
    });
    let bent = match m.correction_m {
        0.0 => String::new(),
        c => format!(", of which {c:.3} by bending at seams"),
    };
    format!(
        "{} triangles; error {:.3} m (surface {:.3}{bent}, mesh {:.3} measured at {} points{lattice})",
        count(m.triangles),
        m.error_m,
        m.surface_error_m,
        m.mesh_error_m,
        count(m.measured_points)
    )
}
