//! A region of the surface as triangles: the one surface function, its outline and its posts handed to `mesh/`.

use super::Snapshot;
use super::query::{Area, Ground, Query, Tolerance};
use super::view::{Rules, Tables};
use super::walls::{Ring, place_in_cell, rings, steep};
use crate::base::lattice::Point;
use crate::base::{Error, Result};
use crate::height::crs::AxisUnit;
use crate::height::frame::{CellRect, Frame};
use crate::height::lod::cover::rects;
use crate::height::lod::cut::Region;
use crate::height::lod::{Cells, KERNEL, World};
use crate::height::patch::Kind;
use crate::height::surface::{Blend, Seams};
use crate::mesh::{
    Field, FieldSample, Mesh, MeshOptions, Polygon, PostGrid, outline, outline_within, triangulate,
};
use std::sync::Mutex;

/// Posts that one mesh is measured at, at most.
pub const MESH_POSTS_MAX: u64 = 40_000_000;

/// A mesh of a region and what is known of its error.
pub struct RegionMesh {
    pub mesh: Mesh,
    /// East, north, up of the mesh's zero, CRS units and metres.
    pub origin: [f64; 3],
    /// Certified error of the surface: the largest over posts and vertices, and with corrected seams over points half a step
    /// from posts, metres.
    pub surface_error_m: f64,
    /// Largest correction of seams over the same points, the nodes of corrections among them, metres; part of surface_error_m.
    pub correction_m: f64,
    /// surface_error_m + mesh.error_m.
    pub error_m: f64,
    /// The largest part of the tolerance that surface and mesh use together at any post or vertex; above 1 where the
    /// surveys are less accurate than was asked. `None` if the tolerance is the same everywhere.
    pub tolerance_used: Option<f64>,
}

/// Where surveys meet, the surface changes over within a cell, most of it within a hundredth of one: in such cells and as
/// far beside them the mesh is measured to within this many steps sideways. Everywhere else it is measured vertically.
pub const WALL_STEPS: f64 = 0.02;

/// A cell without a height that is further than this share of the mesh's error from a plane over its corners has no wall.
const WALL_SHARE: f64 = 0.125;

/// Metres east and north of one CRS unit, at a place.
pub fn metres_per_unit(unit: AxisUnit, at: [f64; 2]) -> [f64; 2] {
    match unit {
        AxisUnit::Metre(k) => [k, k],
        // Lengths of a degree on the GRS 80 / WGS 84 ellipsoid (series to 1 cm).
        AxisUnit::Degree => {
            let f = at[1].to_radians();
            let east = 111_412.84 * f.cos() - 93.5 * (3.0 * f).cos() + 0.118 * (5.0 * f).cos();
            let north = 111_132.92 - 559.82 * (2.0 * f).cos() + 1.175 * (4.0 * f).cos();
            [east, north]
        }
    }
}

/// Metres that a mesh may err at a place.
type Allowed<'a> = &'a (dyn Fn([f64; 2]) -> f64 + Sync);

struct GroundField<'a> {
    ground: &'a Ground<'a>,
    origin: [f64; 2],
    scale: [f64; 2],
    failed: Mutex<Option<Error>>,
    /// Cells in which surveys give way to each other, and how far beside them the mesh may look for a wall, metres.
    rings: &'a [Ring],
    wall_m: f64,
    /// Where the tolerance is not the same everywhere: what the mesh may err at a place, and the most it may anywhere.
    allowed: Option<(Allowed<'a>, f64)>,
}

impl GroundField<'_> {
    fn place(&self, p: [f64; 2]) -> [f64; 2] {
        [0, 1].map(|k| self.origin[k] + p[k] / self.scale[k])
    }

    fn ask(&self, points: &[[f64; 2]], out: &mut Vec<Option<FieldSample>>, slopes: bool) {
        out.clear();
        let at: Vec<[f64; 2]> = points.iter().map(|p| self.place(*p)).collect();
        match if slopes { self.ground.slopes(&at) } else { self.ground.heights(&at) } {
            Ok(found) => out.extend(found.into_iter().map(|e| {
                e.map(|e| FieldSample {
                    z: e.z,
                    dzdx: e.gradient[0] / self.scale[0],
                    dzdy: e.gradient[1] / self.scale[1],
                })
            })),
            Err(e) => {
                out.extend(points.iter().map(|_| None));
                self.failed.lock().expect("no thread panicked while holding the error").get_or_insert(e);
            }
        }
    }
}

impl Field for GroundField<'_> {
    fn sample(&self, points: &[[f64; 2]], out: &mut Vec<Option<FieldSample>>) {
        self.ask(points, out, true);
    }
    fn heights(&self, points: &[[f64; 2]], out: &mut Vec<Option<FieldSample>>) {
        self.ask(points, out, false);
    }
    fn share(&self, p: [f64; 2]) -> f64 {
        self.allowed.map_or(1.0, |(allowed, most)| (allowed(self.place(p)) / most).min(1.0))
    }
    fn at_wall(&self, p: [f64; 2]) -> bool {
        let near = [0.0, -self.wall_m, self.wall_m];
        near.iter().any(|x| {
            near.iter().any(|y| {
                let q = self.place([p[0] + x, p[1] + y]);
                self.rings.iter().any(|r| r.holds(q))
            })
        })
    }
}

/// Triangulates a region within a total error. The surface is taken at the accuracy of the least accurate survey there,
/// which costs nothing: its certified error cannot be smaller everywhere. The mesh gets the rest. Where that leaves less than
/// a tenth, the mesh gets half of what was asked, and the result says what the sum is.
///
/// A tolerance that varies is shared out in the same way at every point.
pub fn triangulate_region(s: &Snapshot, query: &Query, progress: &dyn Fn(f64) -> bool) -> Result<RegionMesh> {
    let (area, cut) = match &query.tolerance {
        Tolerance::Constant(_) => (query.area.clone(), None),
        t @ Tolerance::Camera(_) => (s.in_view(query)?, Some(s.cut(t))),
        t => (query.area.clone(), Some(s.cut(t))),
    };
    let accuracy = least_accurate(s, area.bounds());
    // What is left for the mesh.
    let rest = |total: f64| if accuracy <= total * 0.9 { total - accuracy } else { total / 2.0 };
    let tolerance = |p: [f64; 2]| cut.as_ref().map_or(f64::NAN, |c| c.at(p).min(TOLERANCE_M_MAX));
    let least = match (&query.tolerance, &cut) {
        (Tolerance::Constant(total), _) => *total,
        (_, Some(cut)) => {
            let region = area.convex().or_else(|| s.bounds().map(Region::from_box));
            region.map_or(0.0, |r| cut.bounds(&r.polygon).0)
        }
        _ => 0.0,
    };
    if cut.is_none() && !(least > 0.0 && least.is_finite()) {
        return Err(Error::invalid("--error", format!("{least} m; a mesh needs a positive error")));
    }
    let query = Query { area, tolerance: Tolerance::Constant(accuracy.min(least)), how: query.how };
    let ground = s.surface(&query)?;
    let b = ground.selection.region.bounds();
    if !b[0].is_finite() || ground.selection.records.is_empty() {
        return Err(Error::invalid(
            "region",
            "holds no data; `terraquilt surveys` shows where the surveys are",
        ));
    }
    let origin = [(b[0] + b[2]) / 2.0, (b[1] + b[3]) / 2.0];
    let scale = metres_per_unit(s.crs().unit, origin);
    let local = |p: [f64; 2]| [0, 1].map(|k| (p[k] - origin[k]) * scale[k]);
    let place = |p: &[f64; 2]| [0, 1].map(|k| origin[k] + p[k] / scale[k]);
    let (quads, pieces, mut posts, step) = outline_and_posts(s, b, &local, scale)?;
    if let Area::Polygon(p) = &query.area {
        posts.retain(|q| p.contains(place(q)));
    }
    let polygons = match &query.area {
        Area::Everything => outline(&quads, None)?,
        Area::Box(_) => {
            let (lo, hi) = (local([b[0], b[1]]), local([b[2], b[3]]));
            outline(&quads, Some([lo[0], lo[1], hi[0], hi[1]]))?
        }
        Area::Polygon(p) => {
            let ring = |r: &Vec<[f64; 2]>| r.iter().map(|q| local(*q)).collect::<Vec<_>>();
            let parts: Vec<Vec<Vec<[f64; 2]>>> =
                p.parts().iter().map(|part| part.iter().map(ring).collect()).collect();
            outline_within(&quads, &parts)?
        }
    };
    let allowed = |p: [f64; 2]| rest(tolerance(p));
    let mesh_error_m = match &cut {
        None => rest(least),
        Some(_) => most_allowed(
            &allowed,
            posts.iter().chain(polygons.iter().flat_map(Polygon::rings).flatten()).map(place),
        )?,
    };
    // Cells are flat or not by the error that is allowed at them.
    let flat_m =
        |p: [f64; 2]| WALL_SHARE * if cut.is_some() { allowed(p).min(mesh_error_m) } else { mesh_error_m };
    let around = rings(s, b)?;
    let (steep, candidates) = steep(&around, &ground, b, &flat_m)?;
    let mut options = MeshOptions::new(mesh_error_m, step, posts.clone());
    if cut.is_none() {
        options.grid = lattice(s, &query, (b, &pieces, posts.len()), (origin, scale))?;
    }
    options.wall_m = if steep.is_empty() { 0.0 } else { step * WALL_STEPS };
    options.posts.extend(candidates.into_iter().map(local));
    let field = GroundField {
        ground: &ground,
        origin,
        scale,
        failed: Mutex::new(None),
        rings: &steep,
        wall_m: options.wall_m,
        allowed: cut.as_ref().map(|_| (&allowed as Allowed, mesh_error_m)),
    };
    let mesh = triangulate(&field, &polygons, &options, progress);
    if let Some(e) = field.failed.into_inner().unwrap_or(None) {
        return Err(e);
    }
    let mut mesh = mesh?;
    if mesh.triangles.is_empty() {
        return Err(Error::invalid(
            "region",
            "no cell with data lies in it; `terraquilt surveys` shows where the surveys are",
        ));
    }
    // What the surface promises at its posts and at the vertices; where it is bent, at the nodes of corrections too, as
    // they peak there. Nodes beside a box count at its side, where the correction bends as well.
    let vertices = mesh.positions.iter().map(|p| place(&[p[0], p[1]]));
    let bent = query.how.seams != Seams::Off;
    let whole = pieces.iter().filter(|_| bent).flat_map(|p| p.halves());
    let nodes =
        whole.chain(around.iter().filter(|_| bent).flat_map(Ring::nodes)).filter_map(|p| match &query.area {
            Area::Polygon(area) => area.contains(p).then_some(p),
            _ => Some([p[0].clamp(b[0], b[2]), p[1].clamp(b[1], b[3])]),
        });
    let mut places = posts.iter().map(place).chain(vertices).chain(nodes);
    let (mut surface_error_m, mut correction_m, mut used) = (0.0f64, 0.0f64, 0.0f64);
    loop {
        let chunk: Vec<[f64; 2]> = places.by_ref().take(1 << 20).collect();
        if chunk.is_empty() {
            break;
        }
        for (p, e) in chunk.iter().zip(ground.heights(&chunk)?) {
            let Some(e) = e.filter(|e| e.certified) else { continue };
            surface_error_m = surface_error_m.max(e.error_m);
            correction_m = correction_m.max(e.correction_m.abs());
            if cut.is_some() {
                let ours = mesh.error_m / mesh_error_m * allowed(*p);
                used = used.max((e.error_m + ours) / tolerance(*p));
            }
        }
    }
    // Heights near zero keep their digits as 32-bit floats.
    let (lo, hi) = mesh
        .positions
        .iter()
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), p| (a.min(p[2]), b.max(p[2])));
    let up = ((lo + hi) / 2.0).round();
    for p in &mut mesh.positions {
        p[2] -= up;
    }
    let error_m = surface_error_m + mesh.error_m;
    let tolerance_used = cut.is_some().then_some(used);
    Ok(RegionMesh {
        mesh,
        origin: [origin[0], origin[1], up],
        surface_error_m,
        correction_m,
        error_m,
        tolerance_used,
    })
}

/// A lattice has at most so many times the posts of the cells in it, for the surface to be made of it.
const LATTICE_POSTS: usize = 4;

/// Posts of a lattice that are asked for together.
const LATTICE_AT_ONCE: usize = 1 << 18;

/// The surface as the posts of one lattice, where it is bilinear in each of its cells: in a bilinear database, where one survey
/// alone reaches the region, and no patch that is selected is off its posts. At the tolerance of a mesh that holds: it is at
/// most the survey's accuracy, so every contributor's error is the accuracy itself (theorem T7), rounded upwards.
fn lattice(
    s: &Snapshot,
    query: &Query,
    (b, pieces, posts): ([f64; 4], &[Piece], usize),
    (origin, scale): ([f64; 2], [f64; 2]),
) -> Result<Option<PostGrid>> {
    let alone = Rules(&s.view).meeting(&region_bounds(b, s.unit().size())).len() == 1;
    let Some(first) = pieces.first() else { return Ok(None) };
    if !alone || s.kind() != Kind::Bilinear || query.how.blend != Blend::Exact {
        return Ok(None);
    }
    let whole = pieces.iter().map(|p| p.cells).reduce(|r, c| CellRect {
        i0: r.i0.min(c.i0),
        j0: r.j0.min(c.j0),
        i1: r.i1.max(c.i1),
        j1: r.j1.max(c.j1),
    });
    let Some(r) = whole else { return Ok(None) };
    let (cols, rows) = (r.width() as usize + 1, r.height() as usize + 1);
    let cells: usize = pieces.iter().map(|p| ((p.cells.width() + 1) * (p.cells.height() + 1)) as usize).sum();
    if cols.saturating_mul(rows) > LATTICE_POSTS * cells.max(posts) {
        return Ok(None);
    }
    // Cells at the side of the region have posts outside of it.
    let place = |i: i64, j: i64| place_in_cell(&first.frame, first.size, (i, j), [0.0, 0.0]);
    let corners = [(r.i0, r.j0), (r.i1, r.j0), (r.i0, r.j1), (r.i1, r.j1)].map(|(i, j)| place(i, j));
    let wide = crate::height::lod::cut::bounds(&corners);
    if s.near(wide).len() != 1 {
        return Ok(None);
    }
    // Corrections are bilinear in half cells. One place around has its own, which looks for better surveys one place further.
    if query.how.seams != Seams::Off {
        let w = r.grow(2 * KERNEL);
        let far = [(w.i0, w.j0), (w.i1, w.j0), (w.i0, w.j1), (w.i1, w.j1)].map(|(i, j)| place(i, j));
        if s.near(crate::height::lod::cut::bounds(&far)).len() != 1 {
            return Ok(None);
        }
    }
    let ground = s.surface(&Query { area: Area::Box(wide), ..query.clone() })?;
    let mut heights = vec![f64::NAN; cols * rows];
    for piece in pieces {
        let c = piece.cells;
        let (width, mut j) = ((c.i1 - c.i0 + 1) as usize, c.j0);
        while j <= c.j1 {
            let end = (j + (LATTICE_AT_ONCE / width).max(1) as i64).min(c.j1 + 1);
            let at: Vec<[f64; 2]> =
                (j..end).flat_map(|j| (c.i0..=c.i1).map(move |i| (i, j))).map(|(i, j)| place(i, j)).collect();
            let found = ground.planes(&at)?;
            for (row, z) in (j..end).zip(found.z.chunks_exact(width)) {
                let from = (row - r.j0) as usize * cols + (c.i0 - r.i0) as usize;
                heights[from..from + width].copy_from_slice(z);
            }
            j = end;
        }
    }
    let local = |p: [f64; 2]| [0, 1].map(|k| (p[k] - origin[k]) * scale[k]);
    let way = |p: Point| [p.x as f64 * first.size * scale[0], p.y as f64 * first.size * scale[1]];
    let (u, v) = (way(first.frame.u), way(first.frame.v));
    Ok(Some(PostGrid { origin: local(place(r.i0, r.j0)), u, v, cols, rows, heights }))
}

/// Tolerances above are as good as this one, metres.
const TOLERANCE_M_MAX: f64 = 1e6;

/// The most that a mesh may err at any of some places.
fn most_allowed(
    allowed: &dyn Fn([f64; 2]) -> f64,
    mut places: impl Iterator<Item = [f64; 2]>,
) -> Result<f64> {
    places.try_fold(0.0f64, |most, p| {
        let here = allowed(p);
        if here > 0.0 {
            return Ok(most.max(here));
        }
        Err(Error::invalid(
            "tolerance",
            format!("0 m at {}, {}; a mesh needs a positive error everywhere", p[0], p[1]),
        ))
    })
}

/// The largest accuracy number of the surveys that meet a region, metres.
fn least_accurate(s: &Snapshot, region: Option<[f64; 4]>) -> f64 {
    let Some(b) = region.or_else(|| s.bounds()) else { return 0.0 };
    let rules = Rules(&s.view);
    let met = rules.meeting(&region_bounds(b, s.unit().size()));
    met.into_iter().map(|n| f64::from(rules.geometry(n).accuracy)).fold(0.0, f64::max)
}

/// Cells of one survey.
struct Piece {
    frame: Frame,
    /// CRS units of one lattice unit.
    size: f64,
    cells: CellRect,
}

impl Piece {
    /// Points half a step from posts, in CRS units: with the posts, the nodes of corrections (section 15).
    fn halves(&self) -> impl Iterator<Item = [f64; 2]> + '_ {
        let r = self.cells;
        let nodes = (2 * r.j0..=2 * r.j1).flat_map(move |b| (2 * r.i0..=2 * r.i1).map(move |a| (a, b)));
        nodes.filter(|(a, b)| (a | b) & 1 == 1).map(|(a, b)| {
            let part = [a & 1, b & 1].map(|k| k as f64 / 2.0);
            place_in_cell(&self.frame, self.size, (a >> 1, b >> 1), part)
        })
    }
}

type QuadsPiecesPostsStep = (Vec<[[f64; 2]; 4]>, Vec<Piece>, Vec<[f64; 2]>, f64);

/// The cells of the region as quads and as pieces of surveys, their posts, and the finest step in metres.
fn outline_and_posts(
    s: &Snapshot,
    b: [f64; 4],
    local: &dyn Fn([f64; 2]) -> [f64; 2],
    scale: [f64; 2],
) -> Result<QuadsPiecesPostsStep> {
    let rules = Rules(&s.view);
    let size = s.unit().size();
    let (mut quads, mut pieces, mut posts, mut step) = (Vec::new(), Vec::new(), Vec::new(), f64::INFINITY);
    let bounds = region_bounds(b, size);
    let mut count = 0u64;
    for n in rules.meeting(&bounds) {
        let g = s.view.geometry_of(n);
        let window = g.frame.cells_meeting(&bounds.quad());
        let found = rects(&rules, n, Cells::CorePrime, &window)?;
        count += found.iter().map(|r| ((r.width() + 1) * (r.height() + 1)) as u64).sum::<u64>();
        if count > MESH_POSTS_MAX {
            return Err(Error::limit(
                "posts in the region of one mesh (give a smaller --bbox)",
                MESH_POSTS_MAX,
                count,
            ));
        }
        let at = |i: i64, j: i64| {
            let p = g.frame.post(i, j);
            local([p.x as f64 * size, p.y as f64 * size])
        };
        if !found.is_empty() {
            step = step.min(g.steps[0] * scale[0].min(scale[1])).min(g.steps[1] * scale[0].min(scale[1]));
        }
        let mut seen = std::collections::BTreeSet::new();
        for r in &found {
            let q = g.frame.quad(r).0.map(|p| local([p.x as f64 * size, p.y as f64 * size]));
            quads.push(q);
            pieces.push(Piece { frame: g.frame, size, cells: *r });
            for j in r.j0..=r.j1 {
                for i in r.i0..=r.i1 {
                    // Posts on the sides of a rectangle may belong to its neighbour too.
                    let side = i == r.i0 || i == r.i1 || j == r.j0 || j == r.j1;
                    if side && !seen.insert((i, j)) {
                        continue;
                    }
                    posts.push(at(i, j));
                }
            }
        }
    }
    let (lo, hi) = (local([b[0], b[1]]), local([b[2], b[3]]));
    posts.retain(|p| p[0] >= lo[0] && p[0] <= hi[0] && p[1] >= lo[1] && p[1] <= hi[1]);
    Ok((quads, pieces, posts, if step.is_finite() { step } else { 1.0 }))
}

pub(super) fn region_bounds(b: [f64; 4], size: f64) -> crate::base::lattice::Bounds {
    let lattice = |v: f64| (v / size).round().clamp(-(2f64.powi(60)), 2f64.powi(60)) as i64;
    crate::base::lattice::Bounds {
        min: crate::base::lattice::Point::new(lattice(b[0]), lattice(b[1])),
        max: crate::base::lattice::Point::new(lattice(b[2]), lattice(b[3])),
    }
}
