//! The mesh of a region as GLB, plain or compact.

use super::Going;
use crate::base::round::add_up;
use crate::base::{Error, Result};
use crate::db::query::{Query, Tolerance};
use crate::db::{self, Snapshot};
use crate::format::gltf::{Compact, Compacted, GlbMesh, meshopt_built, write_compact_glb, write_glb};
use crate::height::crs::AxisUnit;
use serde_json::{Map, json};
use std::io::Write;

/// How a .glb is written.
#[derive(Clone, Copy, Debug, Default)]
pub struct Packing {
    /// 16-bit positions, 8-bit normals (KHR_mesh_quantization).
    pub quantize: bool,
    /// The same, compressed (EXT_meshopt_compression).
    pub meshopt: bool,
}

impl Packing {
    fn compact(self) -> bool {
        self.quantize || self.meshopt
    }

    fn option(self) -> &'static str {
        if self.meshopt { "--meshopt" } else { "--quantize" }
    }

    /// Refuses the options for files of another ending.
    pub fn only_for_glb(self, ending: &str) -> Result<()> {
        if self.compact() && ending != "glb" {
            return Err(Error::invalid(
                self.option(),
                format!("is for .glb, the file to write ends in '.{ending}'"),
            ));
        }
        if self.meshopt { meshopt_built() } else { Ok(()) }
    }
}

/// Share of the error asked that the lattice of a compact mesh may take.
const LATTICE_SHARE: f64 = 1.0 / 32.0;

/// What a mesh export found.
#[derive(Debug, serde::Serialize, serde::Deserialize)]
pub struct MeshFound {
    pub vertices: u64,
    pub triangles: u64,
    pub error_m: f64,
    pub surface_error_m: f64,
    pub mesh_error_m: f64,
    /// Largest part of the tolerance that was needed, where it is not the same everywhere.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub tolerance_used: Option<f64>,
    /// Largest correction of seams, part of the surface's error.
    pub correction_m: f64,
    pub seams: String,
    /// Of compact meshes.
    #[serde(flatten)]
    pub compacted: Option<Compacted>,
    pub measured_points: u64,
    pub seconds: f64,
}

/// Writes a region as GLB. A compact mesh is made for a little less than the error asked; the lattice may have the rest.
pub fn write_mesh(
    out: &mut dyn Write,
    s: &Snapshot,
    query: &Query,
    packing: Packing,
    going: Going,
) -> Result<MeshFound> {
    let started = std::time::Instant::now();
    let mut query = query.clone();
    let mut lattice_m = 0.0;
    if packing.compact() {
        let Tolerance::Constant(asked) = &mut query.tolerance else {
            return Err(Error::invalid(
                packing.option(),
                "gives every vertex the same lattice, so it goes with --error only; write a plain .glb for a tolerance that \
                 varies, or give --error its least value",
            ));
        };
        lattice_m = *asked * LATTICE_SHARE;
        *asked -= lattice_m;
    }
    let r = db::triangulate_region(s, &query, &|share| going("mesh", share))?;
    let mut extras = Map::new();
    extras.insert("surface_error_m".into(), json!(r.surface_error_m));
    extras.insert("mesh_error_m".into(), json!(r.mesh.error_m));
    extras.insert("seams".into(), json!(query.how.seams.name()));
    extras.insert("correction_m".into(), json!(r.correction_m));
    if let Some(used) = r.tolerance_used {
        extras.insert("tolerance_used".into(), json!(used));
    }
    if s.crs().unit == AxisUnit::Degree {
        extras.insert(
            "projection".into(),
            json!("local: metres east and north of the origin, which is in degrees"),
        );
    }
    let mesh = GlbMesh {
        positions: &r.mesh.positions,
        normals: &r.mesh.normals,
        triangles: &r.mesh.triangles,
        colors: None,
        origin: r.origin,
        crs: &s.crs().code,
        error_m: r.error_m,
        version: s.number(),
        extras,
    };
    let mut compacted = None;
    if packing.compact() {
        let shift_m = db::WALL_STEPS * finest_step(s, r.origin);
        let compact = Compact { error_m: lattice_m, shift_m, meshopt: packing.meshopt };
        compacted = Some(write_compact_glb(out, &mesh, &compact)?);
    } else {
        write_glb(out, &mesh)?;
    }
    Ok(MeshFound {
        vertices: r.mesh.positions.len() as u64,
        triangles: r.mesh.triangles.len() as u64,
        error_m: compacted.map_or(r.error_m, |c| add_up(r.error_m, c.quantization_error_m)),
        surface_error_m: r.surface_error_m,
        mesh_error_m: r.mesh.error_m,
        tolerance_used: r.tolerance_used,
        correction_m: r.correction_m,
        seams: query.how.seams.name().into(),
        compacted,
        measured_points: r.mesh.measured_points,
        seconds: started.elapsed().as_secs_f64(),
    })
}

/// The finest step of the database's posts in metres, as it is at a place.
fn finest_step(s: &Snapshot, at: [f64; 3]) -> f64 {
    let scale = db::metres_per_unit(s.crs().unit, [at[0], at[1]]);
    let steps = s.entries().flat_map(|e| e.geometry.steps);
    steps.fold(f64::INFINITY, f64::min) * scale[0].min(scale[1])
}
