use std::io::Write;
use std::sync::OnceLock;
use terraquilt_codecs::fractal::{Ifs, Leaf, Shape, Walk};
use terraquilt_gpu::Gpu;

/// The GPU, or `None` (with a message that is always seen) where there is none.
pub fn gpu() -> Option<&'static Gpu> {
    static GPU: OnceLock<Option<Gpu>> = OnceLock::new();
    GPU.get_or_init(open).as_ref()
}

/// One for a test that breaks it.
pub fn open() -> Option<Gpu> {
    match Gpu::open() {
        Ok(gpu) => Some(gpu),
        Err(e) => {
            assert!(std::env::var_os("TERRAQUILT_REQUIRE_GPU").is_none(), "{e}");
            // The test runner keeps what `eprintln!` prints.
            let _ = writeln!(std::io::stderr(), "skipped: {e}");
            None
        }
    }
}

/// A small generator (xorshift64*).
pub struct Random(u64);

impl Random {
    pub fn new(seed: u64) -> Random {
        Random(seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1)
    }
    pub fn below(&mut self, n: usize) -> usize {
        self.0 ^= self.0 >> 12;
        self.0 ^= self.0 << 25;
        self.0 ^= self.0 >> 27;
        (self.0.wrapping_mul(0x2545_f491_4f6c_dd1d) >> 33) as usize % n
    }
}

/// A tile with ranges of all sides, all isometries and all scales, samples round 4000 units.
pub fn tile(seed: u64, size: [usize; 2], range_min_log: u32) -> Walk<2> {
    tile_above(4000.0, seed, size, range_min_log)
}

/// As [`tile`], at another height.
pub fn tile_above(origin: f64, seed: u64, size: [usize; 2], range_min_log: u32) -> Walk<2> {
    let shape = shape(origin, size, range_min_log);
    shape.check().unwrap();
    tile_of(shape, seed)
}

/// A shape that may be beyond what files hold.
pub fn shape(origin: f64, size: [usize; 2], range_min_log: u32) -> Shape<2> {
    Shape {
        size,
        range_max_log: 5,
        range_min_log,
        jump: 4,
        isometries: 8,
        near: 0,
        scale_bits: 5,
        step: 0.25,
        origin,
    }
}

/// As [`tile`], of any shape.
pub fn tile_of(shape: Shape<2>, seed: u64) -> Walk<2> {
    let mut r = Random::new(seed);
    let mut ifs = Ifs { shape, leaves: vec![], units: vec![], unit_means: vec![], complete: true };
    let [across, down] = ifs.shape.cells(0);
    for k in 0..across * down {
        ranges(&mut ifs, &mut r, 0, [(k % across) as u16, (k / across) as u16]);
    }
    Walk::new(&ifs).unwrap()
}

/// A range of a level, or the four that it is split into.
fn ranges(ifs: &mut Ifs<2>, r: &mut Random, level: usize, cell: [u16; 2]) {
    let side = ifs.shape.side(level);
    if level + 1 < ifs.shape.levels() && r.below(3) > 0 {
        if side == 2 {
            ifs.units.push(cell);
            ifs.unit_means.extend((0..4).map(|_| r.below(1000) as i32));
            return;
        }
        return (0..4)
            .for_each(|k| ranges(ifs, r, level + 1, [2 * cell[0] + (k & 1), 2 * cell[1] + (k >> 1)]));
    }
    let domains = ifs.shape.domains(level);
    ifs.leaves.push(Leaf {
        mean: r.below(1000) as i32,
        cell,
        domain: domains.count.map(|n| r.below(n.max(1)) as u16),
        level: level as u8,
        isometry: r.below(8) as u8,
        // A tile may be too small to have domains of this side.
        scale: if domains.is_empty() { 0 } else { r.below(31) as i8 - 15 },
    });
}

/// How far the samples at zoom 1 lie apart.
pub fn range(walk: &Walk<2>) -> f64 {
    let values = &walk.grid().values;
    values.iter().copied().fold(f64::MIN, f64::max) - values.iter().copied().fold(f64::MAX, f64::min)
}
