//! Where a node puts its mesh.

use super::document::Node;

/// Columns: where the axes go, and the origin.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Affine(pub [[f64; 3]; 4]);

impl Affine {
    pub const NONE: Affine = Affine([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0; 3]]);

    /// That of a node in its parent: its matrix, or scale, then rotation, then translation.
    pub fn of(node: &Node) -> Affine {
        if let Some(m) = node.matrix {
            return Affine([0, 4, 8, 12].map(|k| [m[k], m[k + 1], m[k + 2]]));
        }
        let [x, y, z, w] = node.rotation.unwrap_or([0.0, 0.0, 0.0, 1.0]);
        let scale = node.scale.unwrap_or([1.0; 3]);
        let axes = [
            [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + z * w), 2.0 * (x * z - y * w)],
            [2.0 * (x * y - z * w), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + x * w)],
            [2.0 * (x * z + y * w), 2.0 * (y * z - x * w), 1.0 - 2.0 * (x * x + y * y)],
        ];
        let [a, b, c] = [0, 1, 2].map(|k| axes[k].map(|v| v * scale[k]));
        Affine([a, b, c, node.translation.unwrap_or_default()])
    }

    /// First `inner`, then this.
    pub fn after(&self, inner: &Affine) -> Affine {
        let [a, b, c, origin] = inner.0;
        Affine([self.turn(a), self.turn(b), self.turn(c), self.apply(origin)])
    }

    /// Where a point goes.
    pub fn apply(&self, p: [f64; 3]) -> [f64; 3] {
        let q = self.turn(p);
        [0, 1, 2].map(|k| q[k] + self.0[3][k])
    }

    /// Where a direction goes.
    fn turn(&self, p: [f64; 3]) -> [f64; 3] {
        let [a, b, c, _] = self.0;
        [0, 1, 2].map(|k| a[k] * p[0] + b[k] * p[1] + c[k] * p[2])
    }

    /// Whether it is a mirror: triangles turn over.
    pub fn mirrors(&self) -> bool {
        let [a, b, c, _] = self.0;
        let across = [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
        across[0] * c[0] + across[1] * c[1] + across[2] * c[2] < 0.0
    }
}
