//! The overlay of all lattices, face by face, and core' (section 12) from it.
//!
//! - A face is a nonempty intersection of the interiors of one cell of every lattice.
//! - Only faces inside some core are listed, each once: by the finest survey with the face in its core.
//! - A lattice that has no core cell near a cell of another is not drawn there.

use super::OracleSurvey;
use super::exact::{Cut, Line, Polygon};
use super::survey::{Cells, core};

/// No core cell of that survey.
const NONE: u32 = u32::MAX;

/// The faces inside the union of the cores.
pub struct Faces {
    surveys: usize,
    /// For each face, the number of its cell in every survey.
    cells: Vec<u32>,
}

impl Faces {
    pub fn count(&self) -> usize {
        self.cells.len() / self.surveys.max(1)
    }

    /// For each face, the (survey, cell number) pairs of the core cells it lies in.
    pub fn iter(&self) -> impl Iterator<Item = impl Iterator<Item = (usize, usize)> + Clone + '_> + '_ {
        self.cells.chunks(self.surveys.max(1)).map(|face| {
            let cells = face.iter().copied().enumerate();
            cells.filter(|&(_, cell)| cell != NONE).map(|(survey, cell)| (survey, cell as usize))
        })
    }
}

/// The lattice of a survey, in wide integers.
struct Lattice {
    anchor: [i128; 2],
    u: [i128; 2],
    v: [i128; 2],
    /// Twice the signed area of half a cell: positive where u, v turn counter-clockwise.
    cell: i128,
}

impl Lattice {
    fn new(survey: &OracleSurvey) -> Lattice {
        let [anchor, u, v] = [survey.anchor, survey.u, survey.v].map(|p| p.map(i128::from));
        let cell = u[0] * v[1] - u[1] * v[0];
        assert!(cell != 0, "survey {}: the steps are parallel", survey.id);
        Lattice { anchor, u, v, cell }
    }

    fn post(&self, [i, j]: [i64; 2]) -> [i128; 2] {
        [0, 1].map(|axis| self.anchor[axis] + i128::from(i) * self.u[axis] + i128::from(j) * self.v[axis])
    }

    /// The lines i = k and the lines j = k, seen from `origin`.
    fn families(&self, origin: [i128; 2]) -> [Family; 2] {
        let a = [self.anchor[0] - origin[0], self.anchor[1] - origin[1]];
        let ([ux, uy], [vx, vy], s) = (self.u, self.v, self.cell.signum());
        let step = self.cell.abs();
        [
            Family { a: s * vy, b: -s * vx, c: s * (a[1] * vx - a[0] * vy), step },
            Family { a: -s * uy, b: s * ux, c: s * (a[0] * uy - a[1] * ux), step },
        ]
    }
}

/// Equidistant lines a x + b y + c = k step; the left-hand side grows with the index.
struct Family {
    a: i128,
    b: i128,
    c: i128,
    step: i128,
}

impl Family {
    fn index(&self, p: [i128; 2]) -> i64 {
        (self.a * p[0] + self.b * p[1] + self.c).div_euclid(self.step) as i64
    }

    fn line(&self, k: i64) -> Line {
        Line::new(self.a, self.b, self.c - i128::from(k) * self.step)
    }

    /// Cuts a polygon into the strips between consecutive lines; each strip with the index below it.
    fn slice(
        &self,
        polygon: Polygon,
        lines: &mut Vec<Line>,
        mut strip: impl FnMut(i64, Polygon, &mut Vec<Line>),
    ) {
        let step = self.step as f64;
        let start = polygon.least([self.a as f64 / step, self.b as f64 / step, self.c as f64 / step]);
        let mut k = start.floor() as i64;
        let mut rest = polygon;
        let cut = |polygon: Polygon, k: i64, lines: &mut Vec<Line>| {
            lines.push(self.line(k));
            let l = lines.len() as u32 - 1;
            polygon.cut(lines, l)
        };
        // The rounded start may be too high, never decide by it.
        loop {
            match cut(rest.clone(), k, lines) {
                Cut::Above(_) => break,
                Cut::Below(_) | Cut::Both(..) => k -= 1,
            }
        }
        loop {
            match cut(rest, k + 1, lines) {
                Cut::Below(last) => return strip(k, last, lines),
                Cut::Above(all) => rest = all,
                Cut::Both(below, above) => {
                    strip(k, below, lines);
                    rest = above;
                }
            }
            k += 1;
        }
    }
}

/// How many cells of a set lie in a rectangle, at once.
struct Sums {
    table: Vec<u32>,
}

impl Sums {
    fn new(cells: &Cells) -> Sums {
        let width = cells.cols + 1;
        let mut table = vec![0; width * (cells.rows + 1)];
        for n in 0..cells.inside.len() {
            let (x, y) = (n % cells.cols, n / cells.cols);
            let above = table[y * width + x + 1] - table[y * width + x];
            table[(y + 1) * width + x + 1] = table[(y + 1) * width + x] + above + u32::from(cells.inside[n]);
        }
        Sums { table }
    }

    /// Cells of the set with `low <= index <= high`.
    fn count(&self, cells: &Cells, low: [i64; 2], high: [i64; 2]) -> u64 {
        let clip = |k: i64, axis: usize| {
            (k - cells.first[axis]).clamp(0, [cells.cols, cells.rows][axis] as i64) as usize
        };
        let (x0, y0, x1, y1) = (clip(low[0], 0), clip(low[1], 1), clip(high[0] + 1, 0), clip(high[1] + 1, 1));
        let at = |x: usize, y: usize| i64::from(self.table[y * (cells.cols + 1) + x]);
        (at(x1, y1) - at(x0, y1) - at(x1, y0) + at(x0, y0)) as u64
    }
}

/// The faces of a world, given the core of every survey.
///
/// Time and space grow with the number of faces: about 20 a cell for four surveys of like steps.
/// Checks itself: the areas of the faces of every core cell must add up to the cell.
pub fn faces(surveys: &[OracleSurvey], cores: &[Cells]) -> Faces {
    let lattices: Vec<Lattice> = surveys.iter().map(Lattice::new).collect();
    let sums: Vec<Sums> = cores.iter().map(Sums::new).collect();
    let mut order: Vec<usize> = (0..surveys.len()).collect();
    order.sort_by_key(|&s| lattices[s].cell.abs());
    let mut found = Faces { surveys: surveys.len(), cells: Vec::new() };
    let mut areas: Vec<Vec<f64>> = cores.iter().map(|c| vec![0.0; c.inside.len()]).collect();
    let mut lines = Vec::new();
    for (place, &s) in order.iter().enumerate() {
        let lattice = &lattices[s];
        'cells: for at in cores[s].iter() {
            let origin = lattice.post(at);
            let (u, v) = (lattice.u, lattice.v);
            let mut corners = [[0, 0], u, [u[0] + v[0], u[1] + v[1]], v];
            if lattice.cell < 0 {
                corners.reverse();
            }
            // Finer surveys first: what lies in their cores has been listed.
            let mut others = Vec::new();
            for (rank, &t) in order.iter().enumerate().filter(|&(_, &t)| t != s) {
                let families = lattices[t].families(origin);
                let low =
                    [0, 1].map(|f| corners.map(|p| families[f].index(p)).into_iter().min().unwrap_or(0));
                let high =
                    [0, 1].map(|f| corners.map(|p| families[f].index(p)).into_iter().max().unwrap_or(0));
                let near = sums[t].count(&cores[t], low, high);
                if rank < place && near == (high[0] - low[0] + 1) as u64 * (high[1] - low[1] + 1) as u64 {
                    continue 'cells;
                }
                if near > 0 {
                    others.push((t, rank < place, families));
                }
            }
            lines.clear();
            let mut tuple = vec![NONE; surveys.len()];
            tuple[s] = cores[s].number(at).expect("a cell of the core") as u32;
            let mut pieces = vec![(Polygon::new(&corners, &mut lines), tuple)];
            for (t, listed, [columns, rows]) in &others {
                let mut next = Vec::with_capacity(2 * pieces.len());
                for (polygon, tuple) in pieces {
                    columns.slice(polygon, &mut lines, |i, column, lines| {
                        rows.slice(column, lines, |j, piece, _| {
                            let cell = cores[*t].number([i, j]).filter(|&n| cores[*t].inside[n]);
                            if cell.is_none() || !listed {
                                let mut tuple = tuple.clone();
                                tuple[*t] = cell.map_or(NONE, |n| n as u32);
                                next.push((piece, tuple));
                            }
                        });
                    });
                }
                pieces = next;
            }
            for (polygon, tuple) in pieces {
                let area = polygon.area();
                for (t, &n) in tuple.iter().enumerate().filter(|&(_, &n)| n != NONE) {
                    areas[t][n as usize] += area;
                }
                found.cells.extend_from_slice(&tuple);
            }
        }
    }
    for ((core, lattice), areas) in cores.iter().zip(&lattices).zip(&areas) {
        let cell = lattice.cell.abs() as f64;
        for (n, &area) in areas.iter().enumerate().filter(|&(n, _)| core.inside[n]) {
            let off = (area / cell - 1.0).abs();
            assert!(off < 1e-6, "the oracle is wrong: faces miss {off} of cell {:?}", core.index(n));
        }
    }
    found
}

/// What precedence leaves of every core: the cells not wholly inside the union of the cores above.
pub fn core_prime(surveys: &[OracleSurvey], cores: &[Cells], faces: &Faces) -> Vec<Cells> {
    let mut left: Vec<Cells> = cores.to_vec();
    left.iter_mut().for_each(|cells| cells.inside.fill(false));
    for face in faces.iter() {
        let highest = face.clone().map(|(s, _)| surveys[s].precedence).max();
        for (s, n) in face.filter(|&(s, _)| Some(surveys[s].precedence) == highest) {
            left[s].inside[n] = true;
        }
    }
    left
}

/// The cores of all surveys.
pub fn cores(surveys: &[OracleSurvey]) -> Vec<Cells> {
    surveys.iter().map(core).collect()
}
