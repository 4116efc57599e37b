//! Tops, states and floors from the definitions, and the comparison with what was printed.

use super::overlay::{Faces, core_prime, cores, faces};
use super::spline;
use super::survey::{Cells, area, delta, error_up, patches};
use super::{KERNEL, MARGIN, OracleSurvey, PatchBox};
use std::collections::{BTreeMap, BTreeSet, HashMap};

/// Disagreements kept in words; the rest are only counted.
const KEPT: usize = 50;

/// What the definitions say about one patch.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Truth {
    pub top: f32,
    pub live: bool,
    pub floor: bool,
}

/// What was compared.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Counts {
    pub surveys: usize,
    pub posts: usize,
    pub core_cells: usize,
    /// Core cells that precedence took away.
    pub replaced_cells: usize,
    pub faces: usize,
    pub patches: usize,
    pub live: usize,
    pub dormant: usize,
    /// Patches whose kernel precedence emptied.
    pub empty: usize,
    pub floors: usize,
    pub finite_tops: usize,
    pub kernel_pieces: usize,
    /// Errors that differ by one step of `f32`, allowed where heights are not whole numbers.
    pub errors_one_step_off: usize,
    /// All disagreements, also those not put in words.
    pub problems: usize,
}

/// The outcome of [`check`].
#[derive(Clone, Debug, Default)]
pub struct Report {
    /// At most 50.
    pub problems: Vec<String>,
    pub counts: Counts,
}

impl Report {
    fn say(&mut self, problem: impl FnOnce() -> String) {
        self.counts.problems += 1;
        if self.problems.len() < KEPT {
            self.problems.push(problem());
        }
    }
}

/// Compares every printed patch with the definitions.
///
/// Existence, kernel, domain, nominal area, error, top, state and floor. Tops and floors are judged with the
/// printed errors (which are compared on their own), so that one wrong error is one disagreement.
pub fn check(surveys: &[OracleSurvey], boxes: &[PatchBox]) -> Report {
    compare(surveys, boxes, &delta, true)
}

/// The same for a database of bicubic patches. Their errors are sums of many products, so one step of `f32` is allowed
/// whatever the heights: the oracle adds in another order.
pub fn check_splines(surveys: &[OracleSurvey], boxes: &[PatchBox]) -> Report {
    compare(surveys, boxes, &spline::delta, false)
}

/// Error of a patch by its level and index.
type Delta<'a> = &'a dyn Fn(&OracleSurvey, u32, [i64; 2]) -> f64;

/// `exact`: errors of whole heights must be equal.
fn compare(surveys: &[OracleSurvey], boxes: &[PatchBox], delta: Delta, exact: bool) -> Report {
    let mut report = Report::default();
    let cores = cores(surveys);
    let faces = faces(surveys, &cores);
    let kept = core_prime(surveys, &cores, &faces);
    let numbers: HashMap<&str, usize> = surveys.iter().enumerate().map(|(n, s)| (s.id.as_str(), n)).collect();
    if numbers.len() < surveys.len() {
        report.say(|| "two surveys have the same id".into());
    }

    let (mut ids, mut keys) = (BTreeSet::new(), BTreeSet::new());
    let mut printed = BTreeMap::new();
    let mut known = Vec::new();
    for b in boxes {
        let Some(&s) = numbers.get(b.survey.as_str()) else {
            report.say(|| format!("patch {}: there is no survey {}", b.id, b.survey));
            continue;
        };
        if !ids.insert(&b.id) || !keys.insert(&b.key) {
            report.say(|| format!("{}: its id {} or key {} is printed twice", name(b), b.id, b.key));
        }
        if let Some(other) = printed.insert((s, b.level, b.index), b) {
            report.say(|| format!("{}: printed twice, as {} and {}", name(b), other.id, b.id));
            continue;
        }
        known.push((s, b));
    }
    for (s, survey) in surveys.iter().enumerate() {
        for (level, index) in patches(&cores[s]) {
            if printed.remove(&(s, level, index)).is_none() {
                report.say(|| format!("survey {}: no patch of level {level} at {index:?}", survey.id));
            }
        }
    }
    for b in printed.values() {
        report.say(|| format!("{}: should not exist, by the core and the highest level", name(b)));
    }

    let whole: Vec<bool> =
        surveys.iter().map(|s| exact && s.heights.iter().flatten().all(|h| h.fract() == 0.0)).collect();
    for &(s, b) in &known {
        let survey = &surveys[s];
        check_error(survey, delta, whole[s], b, &mut report);
        if b.area != area(survey, b.level) {
            report.say(|| format!("{}: area {}, expected {}", name(b), b.area, area(survey, b.level)));
        }
        check_domain(survey, b, &mut report);
        check_kernel(survey, &kept[s], b, &mut report);
    }
    for ((_, b), truth) in known.iter().zip(truths(surveys, &kept, &faces, &known)) {
        if b.top != truth.top {
            report.say(|| format!("{}: top {}, expected {}, error {}", name(b), b.top, truth.top, b.err));
        }
        if b.live != truth.live {
            let state = |live: bool| if live { "live" } else { "dormant" };
            report.say(|| format!("{}: {}, expected {}", name(b), state(b.live), state(truth.live)));
        }
        if b.floor != truth.floor {
            report.say(|| format!("{}: floor {}, expected {}", name(b), b.floor, truth.floor));
        }
        report.counts.live += usize::from(truth.live);
        report.counts.dormant += usize::from(!truth.live);
        report.counts.floors += usize::from(truth.floor);
        report.counts.finite_tops += usize::from(truth.top.is_finite());
    }
    let counts = &mut report.counts;
    counts.surveys = surveys.len();
    counts.posts = surveys.iter().map(|s| s.heights.len()).sum();
    counts.core_cells = cores.iter().map(Cells::count).sum();
    counts.replaced_cells = counts.core_cells - kept.iter().map(Cells::count).sum::<usize>();
    counts.faces = faces.count();
    counts.patches = known.len();
    report
}

fn name(b: &PatchBox) -> String {
    format!(
        "patch {} (survey {}, level {}, {:?})",
        b.id.get(..12).unwrap_or(&b.id),
        b.survey,
        b.level,
        b.index
    )
}

/// Top, state and floor of each patch, in the order given; `kept` is core' of every survey.
pub fn truths(
    surveys: &[OracleSurvey],
    kept: &[Cells],
    faces: &Faces,
    patches: &[(usize, &PatchBox)],
) -> Vec<Truth> {
    // Greatest first: larger area, then smaller error, then smaller key.
    let mut order: Vec<usize> = (0..patches.len()).collect();
    order.sort_by(|&p, &q| {
        let (p, q) = (patches[p].1, patches[q].1);
        let by_area = q.area.total_cmp(&p.area);
        by_area.then_with(|| p.err.total_cmp(&q.err)).then_with(|| p.key.cmp(&q.key))
    });
    let mut rank = vec![0; patches.len()];
    order.iter().enumerate().for_each(|(place, &p)| rank[p] = place);

    // The patches over each level-0 kernel rectangle of each survey.
    let mut over: Vec<HashMap<[i64; 2], Vec<usize>>> = vec![HashMap::new(); surveys.len()];
    for (s, cells) in kept.iter().enumerate() {
        let here: Vec<usize> = (0..patches.len()).filter(|&p| patches[p].0 == s).collect();
        for block in cells.iter().map(|at| at.map(|k| k.div_euclid(KERNEL))).collect::<BTreeSet<_>>() {
            let over_block = here.iter().copied().filter(|&p| {
                let b = patches[p].1;
                block.map(|k| k.div_euclid(b.stride())) == b.index
            });
            over[s].insert(block, over_block.map(|p| rank[p]).collect());
        }
    }

    let exact: Vec<f32> = surveys.iter().map(|s| error_up(s.accuracy, 0.0)).collect();
    let by_rank = |place: usize| patches[order[place]];
    let mut tops = vec![0f32; patches.len()];
    let mut floors = vec![false; patches.len()];
    let (mut here, mut before) = (Vec::new(), (Vec::new(), f32::NAN));
    for face in faces.iter() {
        here.clear();
        let mut best = f32::INFINITY;
        for (s, n) in face.filter(|&(s, n)| kept[s].inside[n]) {
            here.extend_from_slice(&over[s][&kept[s].index(n).map(|k| k.div_euclid(KERNEL))]);
            best = best.min(exact[s]);
        }
        here.sort_unstable();
        if before.0 == here && before.1 == best {
            continue; // as in the face next to it
        }
        let mut least = f32::INFINITY;
        for &place in &here {
            let (s, b) = by_rank(place);
            tops[place] = tops[place].max(least);
            floors[place] |= b.err <= exact[s] && best >= b.err;
            least = least.min(b.err);
        }
        std::mem::swap(&mut here, &mut before.0);
        before.1 = best;
    }
    let truth = |p: usize| {
        let (top, live) = (tops[rank[p]], tops[rank[p]] > patches[p].1.err);
        Truth { top, live, floor: live && floors[rank[p]] }
    };
    (0..patches.len()).map(truth).collect()
}

fn check_error(survey: &OracleSurvey, delta: Delta, whole: bool, b: &PatchBox, report: &mut Report) {
    let expected = error_up(survey.accuracy, delta(survey, b.level, b.index));
    if b.err == expected {
        return;
    }
    if !whole && (b.err == expected.next_up() || b.err == expected.next_down()) {
        report.counts.errors_one_step_off += 1;
    } else {
        report.say(|| format!("{}: error {}, expected {expected}", name(b), b.err));
    }
}

fn check_domain(survey: &OracleSurvey, b: &PatchBox, report: &mut Report) {
    let r = b.stride();
    let low = b.index.map(|k| (KERNEL * k - MARGIN) * r);
    let high = b.index.map(|k| (KERNEL * (k + 1) + MARGIN) * r);
    let expected = rectangle(survey, low, high);
    let printed: Option<Vec<[i64; 2]>> = b.domain.iter().map(|&p| post_at(survey, p)).collect();
    if !printed.is_some_and(|printed| same_cycle(&printed, &expected)) {
        report.say(|| format!("{}: its domain is not the posts {expected:?}", name(b)));
    }
}

/// Kernel pieces must be rectangles of whole cells of the survey that tile rectangle ∩ core'.
fn check_kernel(survey: &OracleSurvey, kept: &Cells, b: &PatchBox, report: &mut Report) {
    let side = KERNEL * b.stride();
    let low = [0, 1].map(|axis| (b.index[axis] * side).max(kept.first[axis]));
    let cells = [kept.cols, kept.rows];
    let high = [0, 1].map(|axis| ((b.index[axis] + 1) * side).min(kept.first[axis] + cells[axis] as i64));
    let size = [0, 1].map(|axis| (high[axis] - low[axis]).max(0) as usize);
    let mut times = vec![0u32; size[0] * size[1]];
    let mut outside = false;
    for piece in &b.kernel {
        let posts: Option<Vec<[i64; 2]>> = piece.iter().map(|&p| post_at(survey, p)).collect();
        let posts = without_straight(&posts.unwrap_or_default());
        let bound = |axis: usize| {
            let values = posts.iter().map(|p| p[axis]);
            (values.clone().min().unwrap_or(0), values.max().unwrap_or(0))
        };
        let ((i0, i1), (j0, j1)) = (bound(0), bound(1));
        if i0 == i1 || j0 == j1 || !same_cycle(&posts, &rectangle(survey, [i0, j0], [i1, j1])) {
            report.say(|| format!("{}: kernel piece {piece:?} is no ccw rectangle of whole cells", name(b)));
            return;
        }
        outside |= i0 < low[0] || j0 < low[1] || i1 > high[0] || j1 > high[1];
        for j in j0.max(low[1])..j1.min(high[1]) {
            for i in i0.max(low[0])..i1.min(high[0]) {
                times[(j - low[1]) as usize * size[0] + (i - low[0]) as usize] += 1;
            }
        }
        report.counts.kernel_pieces += 1;
    }
    if outside {
        report.say(|| format!("{}: a kernel piece leaves the rectangle or the survey", name(b)));
    }
    let cell = |n: usize| [low[0] + (n % size[0]) as i64, low[1] + (n / size[0]) as i64];
    let wrong: Vec<usize> =
        (0..times.len()).filter(|&n| times[n] != u32::from(kept.contains(cell(n)))).collect();
    if let Some(&n) = wrong.first() {
        let expected = u32::from(kept.contains(cell(n)));
        report.say(|| {
            let (count, at, times) = (wrong.len(), cell(n), times[n]);
            format!(
                "{}: {count} cells of its kernel differ, first {at:?}: {times} times, expected {expected}",
                name(b)
            )
        });
    }
    if (0..times.len()).all(|n| !kept.contains(cell(n))) {
        report.counts.empty += 1;
    }
}

/// The corners of an index rectangle, counter-clockwise in the plane.
fn rectangle(survey: &OracleSurvey, low: [i64; 2], high: [i64; 2]) -> [[i64; 2]; 4] {
    let [[ux, uy], [vx, vy]] = [survey.u, survey.v].map(|p| p.map(i128::from));
    let mut corners = [low, [high[0], low[1]], high, [low[0], high[1]]];
    if ux * vy - uy * vx < 0 {
        corners.reverse();
    }
    corners
}

/// The index of the post at a place, if there is one.
fn post_at(survey: &OracleSurvey, place: [i64; 2]) -> Option<[i64; 2]> {
    let [[ux, uy], [vx, vy]] = [survey.u, survey.v].map(|p| p.map(i128::from));
    let [x, y] = [0, 1].map(|axis| i128::from(place[axis]) - i128::from(survey.anchor[axis]));
    let cell = ux * vy - uy * vx;
    let (i, j) = (x * vy - y * vx, ux * y - uy * x);
    (i % cell == 0 && j % cell == 0).then(|| [(i / cell) as i64, (j / cell) as i64])
}

fn same_cycle(a: &[[i64; 2]], b: &[[i64; 2]]) -> bool {
    a.len() == b.len() && (0..a.len()).any(|shift| (0..a.len()).all(|k| a[(k + shift) % a.len()] == b[k]))
}

/// The polygon without corners on a straight line between their neighbours.
fn without_straight(posts: &[[i64; 2]]) -> Vec<[i64; 2]> {
    let count = posts.len();
    let turns = |k: usize| {
        let [p, q, r] = [(k + count - 1) % count, k, (k + 1) % count].map(|n| posts[n].map(i128::from));
        (q[0] - p[0]) * (r[1] - q[1]) != (q[1] - p[1]) * (r[0] - q[0])
    };
    (0..count).filter(|&k| turns(k)).map(|k| posts[k]).collect()
}
