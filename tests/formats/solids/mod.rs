//! Triangle meshes: PLY, GLB and glTF in, GLB out.

mod glb;
mod ply;

use terraquilt::format::solid::parse_solid;
use terraquilt_codecs::solid::Mesh;

/// A tetrahedron, outward-facing.
fn tetrahedron() -> Mesh {
    Mesh {
        positions: vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 2.0, 0.0], [0.0, 0.0, 4.0]],
        triangles: vec![[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]],
    }
}

fn refusal(bytes: &[u8]) -> String {
    match parse_solid("a.mesh", bytes) {
        Err(e) => e.to_string(),
        Ok(mesh) => panic!("not refused: {mesh:?}"),
    }
}

/// Numbers from a seed.
struct Random(u64);

impl Random {
    fn below(&mut self, n: usize) -> usize {
        self.0 ^= self.0 >> 12;
        self.0 ^= self.0 << 25;
        self.0 ^= self.0 >> 27;
        (self.0.wrapping_mul(0x2545_f491_4f6c_dd1d) >> 20) as usize % n
    }
}

/// Reads a file cut at every byte, and with bytes changed: a mesh whose triangles have their positions, or an error.
fn hostile(bytes: &[u8], seed: u64) {
    let sound = |bytes: &[u8]| {
        if let Ok(mesh) = parse_solid("a.mesh", bytes) {
            assert!(mesh.triangles.iter().flatten().all(|v| (*v as usize) < mesh.positions.len()));
        }
    };
    (0..bytes.len()).for_each(|n| sound(&bytes[..n]));
    let mut random = Random(seed | 1);
    for _ in 0..4000 {
        let mut bytes = bytes.to_vec();
        for _ in 0..=random.below(4) {
            let (at, by) = (random.below(bytes.len()), random.below(256) as u8);
            match random.below(5) {
                0 => bytes[at] = by,
                1 => bytes[at] ^= 1 << (by & 7),
                2 => bytes[at] = b"0123456789-eE.\n "[usize::from(by & 15)],
                3 => drop(bytes.remove(at)),
                _ => bytes.insert(at, by),
            }
        }
        sound(&bytes);
    }
}
