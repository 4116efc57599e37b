//! Least squares that follow the ground.

use multiversion::multiversion;

/// Inputs and, last, the target.
pub(super) const WIDE: usize = 24;
/// Inputs.
pub(super) const INPUTS: usize = WIDE - 1;
/// A post's inputs and target, or weights.
pub(super) type Row = [f32; WIDE];
/// Sums of products: the upper triangle.
pub(super) type Sums = [Row; WIDE];

const NONE: Sums = [[0.0; WIDE]; WIDE];

/// `sums[i][j] += weight v[i] v[j]`.
#[inline(always)]
pub(super) fn add(sums: &mut Sums, v: &Row, weight: f32) {
    for i in 0..WIDE {
        let f = weight * v[i];
        for j in i / 8 * 8..WIDE {
            sums[i][j] += f * v[j];
        }
    }
}

/// `to = to * keep + from`.
#[multiversion(targets("x86_64+avx512f+avx512dq+avx512vl+avx512bw", "x86_64+avx2"))]
fn blend(to: &mut Sums, keep: f32, from: &Sums, part: f32) {
    for i in 0..WIDE {
        for j in i / 8 * 8..WIDE {
            to[i][j] = to[i][j] * keep + from[i][j] * part;
        }
    }
}

/// `a * part + b + c`.
#[multiversion(targets("x86_64+avx512f+avx512dq+avx512vl+avx512bw", "x86_64+avx2"))]
fn gathered(a: &Sums, part: f32, b: &Sums, c: &Sums) -> Sums {
    let mut out = NONE;
    for i in 0..WIDE {
        for j in i / 8 * 8..WIDE {
            out[i][j] = a[i][j] * part + (b[i][j] + c[i][j]);
        }
    }
    out
}

/// `from -= part * row`, from place `FROM` on.
#[inline(always)]
fn less<const FROM: usize>(from: &mut Row, part: f32, row: &Row) {
    for j in FROM..WIDE {
        from[j] -= part * row[j];
    }
}

/// The weights of least squares, drawn towards `prior` by `ridge` of the mean diagonal.
#[multiversion(targets("x86_64+avx512f+avx512dq+avx512vl+avx512bw", "x86_64+avx2"))]
fn solve(sums: &Sums, prior: &Row, ridge: f32) -> Row {
    let mut a = *sums;
    let mut trace = 0.0;
    for k in 0..INPUTS {
        trace += a[k][k];
    }
    let r = trace * (ridge / INPUTS as f32) + 1e-6;
    for k in 0..INPUTS {
        a[k][k] += r;
        a[k][INPUTS] += r * prior[k];
    }
    // Elimination; `parts` are its factors, by row.
    let mut parts = NONE;
    let mut w = [0.0; WIDE];
    for k in 0..INPUTS {
        let (known, rest) = a.split_at_mut(k + 1);
        let row = &known[k];
        let inverse = 1.0 / row[k].max(1e-9);
        w[k] = row[INPUTS] * inverse;
        for i in k + 1..INPUTS {
            let f = row[i] * inverse;
            parts[i][k] = f;
            let to = &mut rest[i - k - 1];
            for part in i / 8..WIDE / 8 {
                let (to, from) = (&mut to[8 * part..8 * part + 8], &row[8 * part..8 * part + 8]);
                for l in 0..8 {
                    to[l] -= f * from[l];
                }
            }
        }
    }
    for k in (1..INPUTS).rev() {
        let f = w[k];
        for l in 0..WIDE {
            w[l] -= f * parts[k][l];
        }
    }
    let sane = w.iter().all(|v| v.abs() < 64.0);
    if sane { w } else { *prior }
}

/// `w . v` in eight lanes.
#[inline(always)]
pub(super) fn dot(w: &Row, v: &Row) -> f32 {
    let mut s = [0.0f32; 8];
    for k in 0..WIDE / 8 {
        for l in 0..8 {
            s[l] += w[8 * k + l] * v[8 * k + l];
        }
    }
    ((s[0] + s[4]) + (s[1] + s[5])) + ((s[2] + s[6]) + (s[3] + s[7]))
}

/// Sums around a block of posts: what was north, and west in this row.
struct Window {
    down: f32,
    along: f32,
    prior: f32,
    /// Per block: sums of the rows above, and those with what lies east of them.
    columns: Vec<Sums>,
    east: Vec<Sums>,
    west: Sums,
    weights: Row,
}

/// The least squares of one pass.
pub(super) struct Squares {
    windows: Vec<Window>,
    /// Of the coarser pass of the same kind, a post's worth.
    inherited: Sums,
    /// Of all posts of the pass so far.
    all: Sums,
    count: f32,
    broad: Row,
    prior: Row,
    worth: Sums,
    now: Sums,
    now_count: f32,
}

/// Windows.
pub(super) const WINDOWS: usize = 2;

impl Squares {
    pub fn new(blocks: usize, inherited: Option<&Squares>, prior: Row) -> Squares {
        let window = |down, along, weight| Window {
            down,
            along,
            prior: weight,
            columns: vec![NONE; blocks],
            east: vec![NONE; blocks + 1],
            west: NONE,
            weights: prior,
        };
        let mut s = Squares {
            windows: vec![
                window(p(0, 0.6), p(1, 0.6), p(2, 30.0)),
                window(p(3, 0.9), p(4, 0.9), p(5, 30.0)),
            ],
            inherited: NONE,
            all: NONE,
            count: 0.0,
            broad: prior,
            prior,
            worth: NONE,
            now: NONE,
            now_count: 0.0,
        };
        if let Some(from) = inherited {
            s.inherited = from.worth();
            s.broad = from.broad;
        }
        s
    }

    /// Sums of all posts, a post's worth.
    fn worth(&self) -> Sums {
        let mut out = self.inherited;
        let k = p(6, 30.0);
        let part = 1.0 / (self.count + k);
        blend(&mut out, k * part, &self.all, part);
        out
    }

    /// A row begins.
    pub fn row(&mut self) {
        for w in &mut self.windows {
            w.west = NONE;
        }
        self.worth = self.worth();
        self.broad = solve(&self.worth, &self.prior, p(7, 1e-5));
    }

    /// Weights for block `k`.
    pub fn weights(&mut self, k: usize) -> [Row; WINDOWS + 1] {
        let mut out = [self.broad; WINDOWS + 1];
        for (n, w) in self.windows.iter_mut().enumerate() {
            let a = gathered(&self.worth, w.prior, &w.east[k], &w.west);
            w.weights = solve(&a, &self.prior, p(8, 1e-5));
            out[n] = w.weights;
        }
        out
    }

    /// A post is known.
    #[inline(always)]
    pub fn learn(&mut self, v: &Row, weight: f32) {
        add(&mut self.now, v, weight);
        self.now_count += 1.0;
    }

    /// Block `k` ends.
    pub fn block(&mut self, k: usize) {
        for w in &mut self.windows {
            blend(&mut w.columns[k], w.down, &self.now, 1.0);
            // The row's west: sums of the rows above lie in `east` already.
            blend(&mut w.west, w.along, &self.now, w.along);
        }
        blend(&mut self.all, 1.0, &self.now, 1.0);
        self.count += self.now_count;
        self.now = NONE;
        self.now_count = 0.0;
    }

    /// A row ends: what the next one finds above, to both sides.
    pub fn row_end(&mut self) {
        for w in &mut self.windows {
            let n = w.columns.len();
            let mut run = NONE;
            for k in (0..n).rev() {
                blend(&mut run, w.along, &w.columns[k], w.down);
                w.east[k] = run;
            }
            let mut run = NONE;
            for k in 0..n {
                blend(&mut w.east[k], 1.0, &run, 1.0);
                blend(&mut run, w.along, &w.columns[k], w.down * w.along);
            }
        }
    }
}

/// A knob.
pub(super) fn p(k: usize, v: f32) -> f32 {
    static S: std::sync::OnceLock<Vec<Option<f32>>> = std::sync::OnceLock::new();
    S.get_or_init(|| {
        let t = std::env::var("KNOBS").unwrap_or_default();
        let mut o = vec![None; 100];
        for kv in t.split(',').filter(|s| !s.is_empty()) {
            let (a, b) = kv.split_once('=').unwrap();
            o[a.parse::<usize>().unwrap()] = Some(b.parse().unwrap());
        }
        o
    })[k]
        .unwrap_or(v)
}
