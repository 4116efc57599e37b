//! What is wrong with a mesh.

use std::fmt;

/// What was found in a mesh on the way to its field.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Report {
    /// Triangles that are used.
    pub triangles: usize,
    /// Positions that they use, equal ones counted once.
    pub positions: usize,
    /// Parts that no edge connects.
    pub components: usize,
    /// Triangles left out: two corners at one place, or all on one line.
    pub degenerate: usize,
    /// Triangles left out because others lie on them: one of two that face the same way, both of two back to back.
    pub doubled: usize,
    /// Edges of one triangle: the mesh is open there.
    pub open_edges: usize,
    /// Holes that such edges bound; each was closed by a fan of triangles round its middle.
    pub holes: usize,
    /// Edges of more than two triangles.
    pub crowded_edges: usize,
    /// Triangles that were turned over to face as their neighbours do.
    pub turned: usize,
    /// Edges whose two triangles face different ways, and cannot be made to agree: the mesh has one side only.
    pub one_sided_edges: usize,
    /// Whether the mesh was inside out, and turned as a whole.
    pub inside_out: bool,
    /// Voxels that are inside or outside by how often the triangles go round them, and not as their nearest triangle says.
    pub resigned: usize,
    /// Pairs of neighbouring voxels whose distances differ by more than their own: the sign changes there without a surface.
    pub torn: usize,
}

impl Report {
    /// Whether every edge has two triangles that face the same way: the mesh bounds a solid, and the field's signs are certain where it does not
    /// cross itself.
    pub fn is_closed(&self) -> bool {
        self.open_edges == 0 && self.crowded_edges == 0 && self.one_sided_edges == 0
    }

    /// What a user should know, as one sentence; nothing if the mesh is as it should be.
    pub fn warning(&self) -> Option<String> {
        let mut parts = Vec::new();
        let mut note = |count: usize, one: &str, many: &str| {
            if count > 0 {
                parts.push(format!("{count} {}", if count == 1 { one } else { many }));
            }
        };
        note(self.open_edges, "open edge", "open edges");
        note(self.holes, "hole closed", "holes closed");
        note(self.crowded_edges, "edge of more than two triangles", "edges of more than two triangles");
        note(
            self.one_sided_edges,
            "edge between two sides of one face",
            "edges between two sides of one face",
        );
        note(self.turned, "triangle turned over", "triangles turned over");
        note(self.doubled, "triangle left out that lies on another", "triangles left out that lie on others");
        note(self.degenerate, "triangle without area left out", "triangles without area left out");
        note(self.torn, "tear in the field", "tears in the field");
        if self.inside_out {
            parts.push("it was inside out".to_string());
        }
        (!parts.is_empty()).then(|| {
            let end = if self.is_closed() && self.torn == 0 {
                ""
            } else {
                "; what is inside is a best guess there: mend the mesh if it matters"
            };
            format!("the mesh is not as it should be: {}{end}", parts.join(", "))
        })
    }
}

impl fmt::Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "{} triangles, {} positions, {} components",
            self.triangles, self.positions, self.components
        )?;
        match self.warning() {
            Some(w) => write!(f, "; {w}"),
            None => write!(f, "; closed"),
        }
    }
}
