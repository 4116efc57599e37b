//! A mesh made fit to be asked what is inside.

use super::holes;
use super::mesh::Mesh;
use super::report::Report;
use super::turning::{sides, turn};
use super::vector::Vector;
use crate::{Error, Result};

/// The mesh mended, in this order: equal positions become one, positions that no triangle uses are left out, and triangles with two corners at one
/// place; of triangles that lie on each other those that face opposite ways cancel, and one of the rest stays; triangles are turned to face
/// as their neighbours do; holes are closed; the whole is turned if it encloses a negative volume; triangles on a line are left out. Costs a few
/// sorts.
///
/// # Errors
/// As [`Mesh::check`]; [`Error::Invalid`] also if no triangle is left.
pub fn mended(mesh: &Mesh) -> Result<(Mesh, Report)> {
    mesh.check()?;
    let mut report = Report::default();
    let mut out = welded(mesh);
    let given = out.triangles.len();
    out.triangles.retain(|[a, b, c]| a != b && b != c && c != a);
    let whole = out.triangles.len();
    cancel(&mut out);
    report.doubled = whole - out.triangles.len();
    let all = sides(&out);
    let groups = || all.chunk_by(|a, b| a.ends == b.ends);
    report.open_edges = groups().filter(|g| g.len() == 1).count();
    report.crowded_edges = groups().filter(|g| g.len() > 2).count();
    turn(&mut out, &all, &mut report);
    report.triangles = out.triangles.len();
    report.positions = out.positions.len();
    report.holes = holes::close(&mut out);
    if out.volume() < 0.0 {
        report.inside_out = true;
        out.triangles.iter_mut().for_each(|t| t.swap(1, 2));
    }
    // Those on one line hold edges together, so they go last.
    let flat = out.face_normals().into_iter().map(|n| n == [0.0; 3]).collect::<Vec<_>>();
    let on_lines = flat[..report.triangles].iter().filter(|f| **f).count();
    report.degenerate = given - whole + on_lines;
    report.triangles -= on_lines;
    let mut flat = flat.into_iter();
    out.triangles.retain(|_| !flat.next().unwrap_or(true));
    if report.triangles == 0 {
        let reason = format!(
            "of its {given} triangles {} have no area and {} lie back to back; give a mesh that encloses something",
            report.degenerate, report.doubled
        );
        return Err(Error::invalid("mesh", reason));
    }
    Ok((out, report))
}

/// The mesh with each place once, in the order in which triangles meet them.
fn welded(mesh: &Mesh) -> Mesh {
    // A negative zero is a zero.
    let key = |p: Vector| p.map(|v| (v + 0.0).to_bits());
    let mut used: Vec<u32> = mesh.triangles.iter().flatten().copied().collect();
    used.sort_unstable();
    used.dedup();
    used.sort_by_key(|v| key(mesh.positions[*v as usize]));
    const NONE: u32 = u32::MAX;
    // The first of those at one place stands for all.
    let mut same = vec![NONE; mesh.positions.len()];
    for group in used.chunk_by(|a, b| key(mesh.positions[*a as usize]) == key(mesh.positions[*b as usize])) {
        group.iter().for_each(|v| same[*v as usize] = group[0]);
    }
    let mut new = vec![NONE; mesh.positions.len()];
    let mut positions = Vec::new();
    let triangles = mesh.triangles.iter().map(|t| {
        t.map(|v| {
            let v = same[v as usize] as usize;
            if new[v] == NONE {
                new[v] = positions.len() as u32;
                positions.push(mesh.positions[v].map(|x| x + 0.0));
            }
            new[v]
        })
    });
    let triangles = triangles.collect();
    Mesh { positions, triangles }
}

/// Of the triangles on the same three corners leaves one, facing as the most of them do; none if as many face either way.
fn cancel(mesh: &mut Mesh) {
    let mut order: Vec<([u32; 3], bool, u32)> = Vec::with_capacity(mesh.triangles.len());
    for (k, t) in mesh.triangles.iter().enumerate() {
        let mut corners = *t;
        corners.sort_unstable();
        // Whether it turns as its corners sorted do.
        let first = (0..3).find(|n| t[*n] == corners[0]).unwrap_or(0);
        order.push((corners, t[(first + 1) % 3] == corners[1], k as u32));
    }
    order.sort_unstable();
    let mut stays = vec![false; mesh.triangles.len()];
    for group in order.chunk_by(|a, b| a.0 == b.0) {
        let along = group.iter().filter(|t| t.1).count();
        let against = group.len() - along;
        if along != against
            && let Some(one) = group.iter().find(|t| t.1 == (along > against))
        {
            stays[one.2 as usize] = true;
        }
    }
    let mut stays = stays.into_iter();
    mesh.triangles.retain(|_| stays.next().unwrap_or(false));
}
