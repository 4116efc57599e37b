//! Greedy insertion into a constrained Delaunay triangulation.
//!
//! M. Garland, P. S. Heckbert: Fast Polygonal Approximation of Terrains and Height Fields, CMU-CS-95-181,
//! 1995, section 4 (algorithm III: greedy insertion, a heap of candidates, only changed triangles looked
//! at again). The steps:
//!
//! 1. The border is split until the field along it is within the bound, and triangulated.
//! 2. Every post waits in the triangle that it lies in. The one with the largest error of all becomes a
//!    vertex, and the posts of the triangles that changed are shared among the new ones; until none is
//!    above the bound.
//! 3. The triangles are measured between the posts as well (see `measure`); points above the bound become
//!    posts, and step 2 goes on. Only triangles that changed are measured again. It ends when nothing
//!    above the bound is found.
//!
//! 4. Vertices that are no longer needed are taken out (see `thin`), and step 3 goes on, a few times.
//!
//! We depart from the paper in steps 3 and 4, in the constraints, and in that posts may lie anywhere, on
//! several rotated grids. Step 4 saves about one triangle in six, which is more than step 3 costs unless the
//! bound is below the bend of the field within one cell of its posts.

use super::border::{border, sample_surely};
use super::extract::{Extract, extract};
use super::flat::{Flat, Vertex};
use super::grow::Ground;
use super::lattice::Lattice;
use super::measure::{measure, snap_heights};
use super::plain::lay;
use super::posts::PostGrid;
use super::thin::thin;
use super::tin::{BorderSplit, Site, Tin};
use super::{Field, Mesh, MeshOptions, Polygon, grid_unit};
use crate::base::{Error, Result};

/// Insertions between two looks at the caller's wish to stop.
const INSERTIONS_PER_LOOK: u32 = 2048;
/// Posts asked of the field at a time.
const SAMPLE_POINTS: usize = 1 << 18;
/// A field that jumps keeps asking for vertices; this many rounds of measuring are enough for any other.
const ROUNDS_MAX: u32 = 64;
/// Rounds of taking vertices out, unless one takes less than this part (one in so many) of them.
const THINNINGS_MAX: i32 = 4;
const THINNING_SHARE: usize = 200;

/// Lays triangles over `region` that are nowhere farther from `field` than `options.error_m`.
///
/// The border is followed exactly (to [`grid_unit`]), its edges shared by all; holes stay open. Errors are
/// measured at every post, on a lattice 4 times finer than `options.step_m`, along all edges and at all
/// centroids; [`Mesh::error_m`] is the largest one found. The same input gives the same mesh, whatever the
/// number of threads. An empty region gives an empty mesh.
///
/// `progress` gets a fraction from 0 to 1 from time to time, in the calling thread; when it returns false
/// the work stops.
///
/// Takes one evaluation of the field a post, 16 a step squared and about 50 a triangle (in parallel), and
/// about 20 microseconds a vertex on one thread; a million posts and 70,000 vertices took 4.5 s on two cores.
/// Holds about 60 bytes a post and 500 a vertex.
///
/// # Errors
/// [`Error::Invalid`] if an option is out of range, the outline crosses itself or the field has no height
/// on the border; [`Error::Limit`] if more than `options.vertices_max` vertices are needed;
/// [`Error::Stopped`] if `progress` said so.
pub fn triangulate(
    field: &dyn Field,
    region: &[Polygon],
    options: &MeshOptions,
    progress: &dyn Fn(f64) -> bool,
) -> Result<Mesh> {
    let (bound, step) = (options.error_m, options.step_m);
    if !(bound > 0.0 && bound.is_finite()) {
        return Err(Error::invalid("error bound", format!("{bound} m is not above zero")));
    }
    if !(step > 0.0 && step.is_finite()) {
        return Err(Error::invalid("post step", format!("{step} m is not above zero")));
    }
    let coordinates = || region.iter().flat_map(Polygon::rings).flatten().flatten();
    if coordinates().any(|v| !v.is_finite()) {
        return Err(Error::invalid("outline", "a coordinate is not a number"));
    }
    if coordinates().next().is_none() {
        return Ok(Mesh::default());
    }
    let unit = grid_unit(coordinates().fold(0.0f64, |m, v| m.max(v.abs())));
    let within_limit = |count: usize| match count <= options.vertices_max {
        true => Ok(()),
        false => Err(Error::limit("vertices of the mesh", options.vertices_max as u64, count as u64)),
    };

    let rim = border(field, region, (unit, step, bound))?;
    within_limit(rim.knots.len())?;
    let mut tin = Tin::new(rim.knots, &rim.edges, (unit, step, bound))?;
    let look = |fraction: f64| if progress(fraction) { Ok(()) } else { Err(Error::Stopped) };
    look(0.0)?;
    if let Some(grid) = &options.grid
        && let Some(mesh) = plain_mesh(&tin, grid, (unit, bound), &|share, vertices| {
            within_limit(vertices)?;
            look(share)
        })?
    {
        whole(region, &mesh.positions, &mesh.triangles)?;
        return Ok(mesh);
    }
    for posts in options.posts.chunks(SAMPLE_POINTS) {
        let mut sites = sites(field, posts);
        snap_heights(&tin, field, sites.iter_mut().collect());
        tin.scatter(&sites);
        look(0.05)?;
    }

    let origin = options.posts.first().copied().unwrap_or([0.0; 2]);
    let lattice = Lattice { origin, step, unit, bound, wall: options.wall_m };
    let start = tin.worst_error().unwrap_or(bound).max(bound * 1.001);
    let grown = |tin: &Tin| {
        within_limit(tin.vertex_count())?;
        let worst = tin.worst_error().unwrap_or(bound).clamp(bound, start);
        look(0.1 + 0.4 * (start / worst).ln() / (start / bound).ln())
    };
    insert_all(&mut tin, field, (unit, step), &grown)?;
    let settled = |tin: &Tin| within_limit(tin.vertex_count());
    for pass in 0..=THINNINGS_MAX {
        // The first pass takes the time from 5 to 7 tenths, the others half of what is left.
        let share = |k: i32| 1.0 - 0.3 * 0.5f64.powi(k);
        let (from, to) = if pass == 0 { (0.5, 0.7) } else { (share(pass - 1), share(pass)) };
        let part = |p: f64| progress(from + (to - from) * p);
        let before = tin.vertex_count();
        if pass > 0 {
            thin(&mut tin, field, &lattice, &|p| part(p / 2.0))?;
        }
        for round in 0..ROUNDS_MAX {
            let vertices = tin.vertex_count();
            insert_all(&mut tin, field, (unit, step), &settled)?;
            if round > 0 && tin.vertex_count() == vertices {
                break;
            }
            let done = 1.0 - 0.5f64.powi(round as i32 + 1);
            let found = measure(&mut tin, field, &lattice, &|p| part(done + (1.0 - done) / 2.0 * p))?;
            if found == 0 {
                break;
            }
        }
        if pass > 0 && before.saturating_sub(tin.vertex_count()) * THINNING_SHARE < before {
            break;
        }
    }

    let Extract { positions, triangles } = extract(&tin);
    within_limit(positions.len())?;
    whole(region, &positions, &triangles)?;
    let (error_m, measured_points) = tin.error();
    drop(tin);
    let mut normals = Vec::with_capacity(positions.len());
    for chunk in positions.chunks(SAMPLE_POINTS) {
        let points: Vec<[f64; 2]> = chunk.iter().map(|p| [p[0], p[1]]).collect();
        normals.extend(sample_surely(field, &points, unit, step)?.iter().map(|s| normal(s.dzdx, s.dzdy)));
        look(0.99)?;
    }
    Ok(Mesh { positions, normals, triangles, error_m, measured_points })
}

/// The mesh of a field that is bilinear on a lattice. `None` where that finds no way to stay within the bound.
fn plain_mesh(
    tin: &Tin,
    grid: &PostGrid,
    (unit, bound): (f64, f64),
    look: &dyn Fn(f64, usize) -> Result<()>,
) -> Result<Option<Mesh>> {
    let first = extract(tin);
    let vertex = |p: &[f64; 3]| {
        let [x, y] = [p[0], p[1]].map(|v| (v / unit).round() as i32);
        Vertex { z: p[2], ..Ground { grid, unit, bound }.vertex_at(x, y) }
    };
    let flat = Flat::new(first.positions.iter().map(vertex).collect(), &first.triangles);
    if flat.vertices.iter().any(|v| !v.field.is_finite()) {
        return Ok(None);
    }
    let laid = lay(flat, grid, (unit, bound), look)?;
    if laid.error_m.is_nan() || laid.error_m > bound {
        return Ok(None);
    }
    let flat = laid.flat;
    let place = |v: &Vertex| [f64::from(v.x) * unit, f64::from(v.y) * unit, v.z];
    let normals = flat.vertices.iter().map(|v| grid.slopes(v.i, v.j)).map(|[x, y]| normal(x, y)).collect();
    Ok(Some(Mesh {
        positions: flat.vertices.iter().map(place).collect(),
        normals,
        triangles: (0..flat.triangle_count() as u32).map(|t| flat.triangle(t)).collect(),
        error_m: laid.error_m,
        measured_points: laid.points,
    }))
}

/// A mesh covers its region: a guard against faults of ours, since an error is measured only where triangles are.
fn whole(region: &[Polygon], positions: &[[f64; 3]], triangles: &[[u32; 3]]) -> Result<()> {
    let wanted: f64 = region.iter().map(Polygon::area).sum();
    let doubled = |t: &[u32; 3]| {
        let [a, b, c] = t.map(|k| positions[k as usize]);
        (b[0] - a[0]) * (c[1] - a[1]) - (c[0] - a[0]) * (b[1] - a[1])
    };
    let found: f64 = triangles.iter().map(doubled).sum::<f64>() / 2.0;
    if (found - wanted).abs() > 1e-3 * wanted {
        return Err(Error::corrupt(
            "mesh",
            "triangulation",
            format!(
                "covers {found:.1} of {wanted:.1} square metres; nothing was written, please report this"
            ),
        ));
    }
    Ok(())
}

/// Inserts sites, worst first, and splits the border edges that stand in the way, until no site is above
/// the bound or none can be inserted.
fn insert_all(
    tin: &mut Tin,
    field: &dyn Field,
    (unit, step): (f64, f64),
    look: &dyn Fn(&Tin) -> Result<()>,
) -> Result<()> {
    loop {
        let mut count = 0;
        while tin.insert_worst() {
            count += 1;
            if count % INSERTIONS_PER_LOOK == 0 {
                look(tin)?;
            }
        }
        look(tin)?;
        let mut splits: Vec<BorderSplit> = std::mem::take(&mut tin.splits);
        splits.sort_by_key(|s| s.edge);
        splits.dedup_by_key(|s| s.edge);
        let points: Vec<[f64; 2]> = splits.iter().map(|s| s.at).collect();
        let heights = sample_surely(field, &points, unit, step)?;
        let splits: Vec<(BorderSplit, f64)> = splits.into_iter().zip(heights.iter().map(|h| h.z)).collect();
        if splits.is_empty() || tin.split_borders(&splits) == 0 {
            return Ok(());
        }
    }
}

fn sites(field: &dyn Field, posts: &[[f64; 2]]) -> Vec<Site> {
    let mut heights = Vec::with_capacity(posts.len());
    field.heights(posts, &mut heights);
    let known = posts.iter().zip(heights);
    known
        .filter_map(|(p, s)| {
            s.map(|s| Site { x: p[0], y: p[1], z: s.z, z_snapped: s.z, weight: 1.0 / field.share(*p) })
        })
        .collect()
}

fn normal(dzdx: f64, dzdy: f64) -> [f32; 3] {
    let length = (dzdx * dzdx + dzdy * dzdy + 1.0).sqrt();
    [(-dzdx / length) as f32, (-dzdy / length) as f32, (1.0 / length) as f32]
}
