//! The oracle on trial: worlds with known answers, and slower second methods on random ones.

use super::check::truths;
use super::overlay::{core_prime, cores, faces};
use super::survey::{Cells, area, delta, error_up, patches};
use super::*;
use num_bigint::BigInt;
use num_rational::Ratio;
use std::collections::HashSet;

/// SplitMix64.
struct Random(u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let z = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// Uniform in `low..=high`.
    fn within(&mut self, low: i64, high: i64) -> i64 {
        low + (self.next() % (high - low + 1) as u64) as i64
    }
}

/// A flat survey of `cols` x `rows` posts.
fn flat(
    id: &str,
    anchor: [i64; 2],
    u: [i64; 2],
    v: [i64; 2],
    first: [i64; 2],
    size: [usize; 2],
) -> OracleSurvey {
    let step = |p: [i64; 2]| (p[0] as f64).hypot(p[1] as f64);
    OracleSurvey {
        id: id.into(),
        anchor,
        u,
        v,
        first,
        cols: size[0],
        rows: size[1],
        heights: vec![Some(0.0); size[0] * size[1]],
        nominal_step: [step(u), step(v)],
        accuracy: 0.0,
        precedence: 0,
    }
}

/// A survey whose core is exactly one level-0 kernel rectangle, from `anchor` on.
fn single(id: &str, anchor: [i64; 2], u: [i64; 2], v: [i64; 2], accuracy: f64) -> OracleSurvey {
    OracleSurvey { accuracy, ..flat(id, anchor, u, v, [-1, -1], [31, 31]) }
}

/// What a faultless product would print.
fn print(surveys: &[OracleSurvey]) -> Vec<PatchBox> {
    let cores = cores(surveys);
    let faces = faces(surveys, &cores);
    let kept = core_prime(surveys, &cores, &faces);
    let mut boxes = Vec::new();
    for (s, survey) in surveys.iter().enumerate() {
        for (level, index) in patches(&cores[s]) {
            let r = 1i64 << level;
            let low = index.map(|k| KERNEL * k * r);
            let high = low.map(|k| k + KERNEL * r);
            let key = Random(boxes.len() as u64 * 7 + 1).next();
            boxes.push(PatchBox {
                id: format!("{key:016x}"),
                key: format!("{key:016x}"),
                survey: survey.id.clone(),
                level,
                index,
                kernel: runs(&kept[s], low, high).iter().map(|run| quad(survey, run).to_vec()).collect(),
                domain: quad(survey, &(low.map(|k| k - MARGIN * r), high.map(|k| k + MARGIN * r))),
                area: area(survey, level),
                err: error_up(survey.accuracy, delta(survey, level, index)),
                top: 0.0,
                live: false,
                floor: false,
            });
        }
    }
    let number = |b: &PatchBox| surveys.iter().position(|s| s.id == b.survey).unwrap();
    let known: Vec<(usize, &PatchBox)> = boxes.iter().map(|b| (number(b), b)).collect();
    let truths = truths(surveys, &kept, &faces, &known);
    for (b, truth) in boxes.iter_mut().zip(truths) {
        (b.top, b.live, b.floor) = (truth.top, truth.live, truth.floor);
    }
    boxes
}

/// A rectangle of posts, counter-clockwise in the plane.
fn quad(survey: &OracleSurvey, &(low, high): &([i64; 2], [i64; 2])) -> [[i64; 2]; 4] {
    let ([ux, uy], [vx, vy]) = (survey.u.map(i128::from), survey.v.map(i128::from));
    let mut corners = [low, [high[0], low[1]], high, [low[0], high[1]]];
    if ux * vy < uy * vx {
        corners.reverse();
    }
    corners.map(|[i, j]| [0, 1].map(|a| survey.anchor[a] + i * survey.u[a] + j * survey.v[a]))
}

/// Row runs of the cells in `[low, high)`, equal consecutive runs merged.
fn runs(cells: &Cells, low: [i64; 2], high: [i64; 2]) -> Vec<([i64; 2], [i64; 2])> {
    let mut found: Vec<([i64; 2], [i64; 2])> = Vec::new();
    for j in low[1].max(cells.first[1])..high[1].min(cells.first[1] + cells.rows as i64) {
        let mut i = low[0];
        while i < high[0] {
            let start = i;
            while i < high[0] && cells.contains([i, j]) {
                i += 1;
            }
            if i > start {
                match found.iter_mut().find(|(a, b)| a[0] == start && b[0] == i && b[1] == j) {
                    Some((_, b)) => b[1] = j + 1,
                    None => found.push(([start, j], [i, j + 1])),
                }
            }
            i = i.max(start) + 1;
        }
    }
    found
}

fn find<'a>(boxes: &'a [PatchBox], survey: &str) -> &'a PatchBox {
    boxes.iter().find(|b| b.survey == survey && b.level == 0).unwrap()
}

/// A few surveys of whole-number heights, most of them turned, some shifted copies, with voids and ranks.
fn random_world(seed: u64, size: i64, unit: i64) -> Vec<OracleSurvey> {
    let mut random = Random(seed);
    let turns = [[1, 0], [4, 3], [12, 5], [15, -8], [0, 1], [7, 24], [3, -4]];
    let mut world: Vec<OracleSurvey> = Vec::new();
    for n in 0..random.within(2, 4) {
        let (cols, rows) = (random.within(size / 2, size), random.within(size / 2, size));
        let mut s = if n > 0 && random.within(0, 3) == 0 {
            let mut copy = world[0].clone();
            let [i, j] = [random.within(-20, 20), random.within(-20, 20)];
            copy.anchor = [0, 1].map(|axis| copy.anchor[axis] + i * copy.u[axis] + j * copy.v[axis]);
            copy
        } else {
            let [x, y] = turns[random.within(0, 6) as usize];
            let step = unit * random.within(1, 3);
            let (u, v) = ([x * step, y * step], [-y * step, x * step]);
            let v = if random.within(0, 1) == 0 { v } else { v.map(|k| -k) };
            // A rounding of the frame that makes it not quite square.
            let u = if unit > 100 { [u[0] + random.within(-1, 1), u[1] + random.within(-1, 1)] } else { u };
            // The norm of the turn is 1, 5, 13, 17 or 25: bring all steps to 25 at most.
            let longest = 30 * unit;
            let anchor = [
                random.within(-longest * size, longest * size),
                random.within(-longest * size, longest * size),
            ];
            let mut s = flat("", anchor.map(|k| k / 16), u, v, [0, 0], [cols as usize, rows as usize]);
            s.first = [random.within(-size, 0), random.within(-size, 0)];
            let centre =
                [0, 1].map(|axis| s.u[axis] * (s.first[0] + cols / 2) + s.v[axis] * (s.first[1] + rows / 2));
            s.anchor = [0, 1].map(|axis| s.anchor[axis] - centre[axis]);
            s
        };
        s.id = format!("s{n}");
        let rough = random.within(0, 40);
        for (k, height) in s.heights.iter_mut().enumerate() {
            let slope = (k % s.cols) as i64 * 3 + (k / s.cols) as i64;
            *height = Some((slope + random.within(0, rough)) as f64);
        }
        for _ in 0..random.within(0, 4) {
            let at = [random.within(0, s.cols as i64 - 1), random.within(0, s.rows as i64 - 1)];
            let radius = random.within(0, size / 10);
            for (k, height) in s.heights.iter_mut().enumerate() {
                let d = [(k % s.cols) as i64 - at[0], (k / s.cols) as i64 - at[1]];
                if d[0] * d[0] + d[1] * d[1] <= radius * radius {
                    *height = None;
                }
            }
        }
        s.accuracy = random.within(0, 20) as f64 / 8.0;
        s.precedence = random.within(0, 2);
        world.push(s);
    }
    world
}

#[test]
fn a_faultless_print_is_accepted() {
    for seed in 0..12 {
        let world = random_world(seed, 110, 1 << 30);
        let boxes = print(&world);
        let report = check(&world, &boxes);
        println!("seed {seed}: {:?}", report.counts);
        assert_eq!(report.problems, Vec::<String>::new(), "seed {seed}");
    }
}

/// The shapes of three surveys of the kit, as large as they are. Says how long the parts take.
#[test]
#[ignore = "large, some seconds: cargo test --release --test main large_grids -- --ignored"]
fn large_grids_take_seconds() {
    let turned = |metres: f64, degrees: f64| {
        let at = |a: f64| (metres * 2f64.powi(35) * a) as i64;
        let (s, c) = degrees.to_radians().sin_cos();
        ([at(c), at(s)], [at(s), at(-c)])
    };
    let mut random = Random(11);
    let mut world = Vec::new();
    for (id, [cols, rows], metres, degrees, precedence) in [
        ("k05", [600, 500], 70.0, 17.0, 0),
        ("k06", [700, 700], 60.0, 0.0, 1),
        ("k09", [1500, 40], 70.0, -31.0, 2),
    ] {
        let (u, v) = turned(metres, degrees);
        let first = [70000 - cols as i64 / 2, -70000 - rows as i64 / 2];
        let mut s = flat(id, [0, 0], u, v, first, [cols, rows]);
        s.anchor = [0, 1].map(|a| -(u[a] * 70000 - v[a] * 70000) + (4_000_000 << 35));
        for (k, height) in s.heights.iter_mut().enumerate() {
            let hole = id == "k06" && (random.within(0, 2000) == 0 || (k / 20) % 35 + (k / 7000) % 10 == 20);
            *height = (!hole).then(|| (k % cols) as f64 + random.within(0, 30) as f64);
        }
        s.accuracy = metres / 20.0;
        s.precedence = precedence;
        world.push(s);
    }
    let start = std::time::Instant::now();
    let boxes = print(&world);
    println!("printed in {:.1?}", start.elapsed());
    let report = check(&world, &boxes);
    println!("checked by {:.1?}: {:?}", start.elapsed(), report.counts);
    assert!(report.problems.is_empty());
    let far = 1i64 << 60;
    expected_tree(&boxes, ([-far, -far], [far, far]), 64, 40);
    println!("tree by {:.1?}", start.elapsed());
}

#[test]
fn every_single_fault_is_reported() {
    let world = random_world(5, 80, 1 << 20);
    let boxes = print(&world);
    assert!(check(&world, &boxes).problems.is_empty());
    let expect = |word: &str, fault: &dyn Fn(&mut Vec<PatchBox>)| {
        let mut boxes = boxes.clone();
        fault(&mut boxes);
        let problems = check(&world, &boxes).problems;
        assert!(problems.iter().any(|p| p.contains(word)), "{word}: {problems:?}");
    };
    let full = boxes.iter().position(|b| !b.kernel.is_empty() && b.top.is_finite()).unwrap();
    expect("no patch of level", &|b| drop(b.remove(0)));
    expect("printed twice", &|b| b.push(b[0].clone()));
    expect("should not exist", &|b| b[0].index[0] += 1000);
    expect("there is no survey", &|b| b[0].survey = "nobody".into());
    expect("error", &|b| b[full].err = b[full].err.next_up());
    expect("area", &|b| b[full].area = b[full].area.next_up());
    expect("top", &|b| b[full].top = b[full].top.next_up());
    expect("expected", &|b| b[full].live = !b[full].live);
    expect("floor", &|b| b[full].floor = !b[full].floor);
    expect("domain", &|b| b[full].domain[1][0] += 1);
    expect("domain", &|b| b[full].domain.reverse());
    expect("whole cells", &|b| b[full].kernel[0].reverse());
    expect("whole cells", &|b| b[full].kernel[0][0][0] += 1);
    expect("cells of its kernel differ", &|b| drop(b[full].kernel.pop()));
    expect("cells of its kernel differ", &|b| {
        let again = b[full].kernel[0].clone();
        b[full].kernel.push(again);
    });
    expect("leaves the rectangle", &|b| {
        let by = [0, 1].map(|axis| world[0].u[axis] * 1000);
        let n = b.iter().position(|b| b.survey == "s0" && !b.kernel.is_empty()).unwrap();
        let far = b[n].kernel[0].iter().map(|p| [p[0] + by[0], p[1] + by[1]]).collect();
        b[n].kernel.push(far);
    });
}

#[test]
fn one_flat_survey_is_all_in_its_coarsest_patches() {
    let mut survey = flat("a", [5, 7], [10, 0], [0, -10], [-1, -1], [115, 59]);
    survey.accuracy = 0.1;
    let boxes = print(&[survey.clone()]);
    // Core cells 0..112 x 0..56: 4 x 2, then 2 x 1 patches.
    assert_eq!(boxes.iter().filter(|b| b.level == 0).count(), 8);
    assert_eq!(boxes.len(), 10);
    for b in &boxes {
        assert_eq!(
            (b.err, b.live, b.floor),
            (0.1f32.next_up().min(error_up(0.1, 0.0)), b.level == 1, b.level == 1)
        );
        assert_eq!(b.top, if b.level == 1 { f32::INFINITY } else { b.err });
    }
    // A spike above a post that level 1 skips: its patch stands off by the height of the spike.
    survey.heights[survey.cols * 12 + 12] = Some(8.0);
    let boxes = print(&[survey.clone()]);
    let coarse = boxes.iter().find(|b| b.level == 1 && b.index == [0, 0]).unwrap();
    assert_eq!((coarse.err, coarse.top), (error_up(0.1, 8.0), f32::INFINITY));
    let under = |b: &&PatchBox| b.level == 0 && b.index[0] < 2;
    assert!(boxes.iter().filter(under).all(|b| b.live && b.top == coarse.err && b.floor));
    // A void raises its fill to the mean of the posts around it: of 8 neighbours one is the spike.
    survey.heights[survey.cols * 13 + 13] = None;
    assert_eq!(delta(&survey, 1, [0, 0]), 8.0 - 8.0 / 8.0 / 4.0);
}

#[test]
fn two_turned_kernels_that_touch_cover_and_with_a_gap_do_not() {
    let s = 1i64 << 33;
    let (u, v) = ([4 * s, 3 * s], [-3 * s, 4 * s]);
    let at = |i: i64, j: i64| [0, 1].map(|axis| 11 + i * u[axis] + j * v[axis]);
    let double = |p: [i64; 2], sign: i64| p.map(|k| 2 * sign * k);
    let small = single("small", at(0, 0), u, v, 0.5);
    let left = single("left", at(-42, -14), double(u, 1), double(v, 1), 1.0);
    // The right one counts from its far corner, so that nothing but the edge is shared.
    let right = single("right", at(70, 42), double(u, -1), double(v, -1), 2.0);
    let boxes = print(&[small.clone(), left.clone(), right.clone()]);
    assert_eq!(find(&boxes, "small").top, 2.0);
    assert!(find(&boxes, "small").live && find(&boxes, "small").floor);
    assert_eq!(find(&boxes, "left").top, f32::INFINITY);
    // By one unit the touch becomes a gap, or the other way an overlap.
    for (moved, top) in [([1, 0], f32::INFINITY), ([0, 1], f32::INFINITY), ([0, -1], 2.0), ([-1, 1], 2.0)] {
        let mut right = right.clone();
        right.anchor = [right.anchor[0] + moved[0], right.anchor[1] + moved[1]];
        let boxes = print(&[small.clone(), left.clone(), right.clone()]);
        assert_eq!(find(&boxes, "small").top, top, "moved by {moved:?}");
    }
    let mut torn = left.clone();
    torn.heights[31 * 20 + 24] = None;
    assert_eq!(find(&print(&[small.clone(), torn, right.clone()]), "small").top, f32::INFINITY);
    // Where greater patches are at least as good, the small one sleeps.
    let boxes = print(&[OracleSurvey { accuracy: 2.0, ..small }, left, right]);
    let small = find(&boxes, "small");
    assert!((small.top, small.live, small.floor) == (2.0, false, false));
}

#[test]
fn order_minimality_is_all_there_is() {
    let (u, v) = (|k: i64| [k, 0], |k: i64| [0, k]);
    let mut world = vec![single("A", [-140, -140], u(10), v(10), 0.0)];
    for (n, corner) in [[-168, -168], [-56, -168], [-168, -56], [-56, -56]].into_iter().enumerate() {
        world.push(single(&format!("q{n}"), corner, u(8), v(8), 0.0));
    }
    assert!(print(&world).iter().all(|b| b.live && b.floor && b.top == f32::INFINITY));
    // Nowhere the best data, the greatest is live but no floor.
    world[0].accuracy = 1.0;
    assert!(print(&world).iter().all(|b| b.live && b.floor == (b.survey != "A")));
    world[1].heights[31 * 15 + 15] = None;
    assert!(find(&print(&world), "A").floor, "the best data have a hole here");
}

#[test]
fn of_twins_the_smaller_key_is_awake() {
    let one = single("one", [0, 0], [4, 0], [0, 4], 0.5);
    let boxes = print(&[one.clone(), OracleSurvey { id: "two".into(), ..one }]);
    let [a, b] = [0, 1].map(|n| &boxes[n]);
    let (small, large) = if a.key < b.key { (a, b) } else { (b, a) };
    assert_eq!((small.top, small.live, small.floor), (f32::INFINITY, true, true));
    assert_eq!((large.top, large.live, large.floor), (0.5, false, false));
}

#[test]
fn precedence_takes_cells_inside_the_union_and_ties_take_none() {
    let (u, v) = ([4, 0], [0, 4]);
    let base = flat("base", [0, 0], u, v, [-1, -1], [31, 31]);
    let above = |id: &str, anchor: [i64; 2], precedence: i64| OracleSurvey {
        precedence,
        ..single(id, anchor, [1, 0], [0, 1], 1.0)
    };
    let kept = |world: &[OracleSurvey]| {
        let cores = cores(world);
        core_prime(world, &cores, &faces(world, &cores))
    };
    // Two cores side by side, x from 2 to 30 and 30 to 58: the joint at 30 is inside cell 7.
    let pair = [above("h", [2, 2], 1), above("i", [30, 2], 2)];
    let world = [base.clone(), pair[0].clone(), pair[1].clone()];
    let left = kept(&world);
    for [i, j] in [[1, 1], [7, 1], [13, 6]] {
        assert!(!left[0].contains([i, j]), "{i} {j}");
    }
    for [i, j] in [[0, 1], [14, 1], [7, 0], [7, 7]] {
        assert!(left[0].contains([i, j]), "{i} {j}");
    }
    assert_eq!(left[0].count(), 28 * 28 - 13 * 6);
    assert_eq!(left[1].count() + left[2].count(), 2 * 28 * 28);
    let apart = [base.clone(), pair[0].clone(), above("i", [31, 2], 2)];
    assert!(kept(&apart)[0].contains([7, 1]));
    let tied = [base.clone(), above("h", [2, 2], 0), above("i", [30, 2], 0)];
    assert_eq!(kept(&tied)[0].count(), 28 * 28);
    // A chain: h above base, i above both; where i is void h shows, where both are, base.
    let mut i = OracleSurvey { precedence: 2, ..flat("i", [0, 0], u, v, [-1, -1], [31, 31]) };
    i.heights[31 * 10 + 10] = None;
    let chain = [base.clone(), OracleSurvey { id: "h".into(), precedence: 1, ..base.clone() }, i.clone()];
    let left = kept(&chain);
    assert_eq!((left[0].count(), left[1].count(), left[2].count()), (0, 16, 28 * 28 - 16));
    let mut h = chain[1].clone();
    h.heights[31 * 10 + 11] = None;
    let left = kept(&[base, h, i]);
    assert_eq!((left[0].count(), left[1].count()), (12, 4));
}

#[test]
fn an_emptied_patch_sleeps_with_top_zero() {
    let low = single("low", [0, 0], [4, 0], [0, 4], 0.0);
    let high = OracleSurvey { precedence: 1, ..single("high", [-10, -10], [5, 0], [0, 5], 3.0) };
    let world = [low, high];
    let boxes = print(&world);
    let low = find(&boxes, "low");
    assert_eq!((low.top, low.live, low.floor, low.kernel.len()), (0.0, false, false, 0));
    assert!(find(&boxes, "high").floor);
    assert_eq!(check(&world, &boxes).counts.empty, 1);
}

#[test]
fn sums_are_rounded_up_exactly() {
    assert_eq!(error_up(0.0, 0.0), 0.0);
    assert_eq!(error_up(0.5, 0.25), 0.75);
    for (a, b) in [(0.1, 0.0), (0.3, 0.7), (1.0, 1e-30), (1e8, 0.1), (16777217.0, 0.0), (1.0, 2f64.powi(-60))]
    {
        let exact =
            |x: f64| Ratio::<BigInt>::new((x * 2f64.powi(200)).to_string().parse().unwrap(), 1.into());
        let (sum, up) = (exact(a) + exact(b), error_up(a, b));
        assert!(exact(f64::from(up)) >= sum && exact(f64::from(up.next_down())) < sum, "{a} + {b}: {up}");
    }
}

#[test]
fn lines_of_boxes_are_read_to_the_last_bit() {
    let line = r#"{"id":"0a","key":"0b","survey":"s \"1\"","level":1,"index":[-3,9007199254740993],
        "kernel":[[[1,2],[3,4],[-5,6]],[]],"domain":[[1,2],[3,4],[5,6],[9223372036854775807,8]],
        "area":0.1,"err":0.30000001192092896,"top":null,"state":"live","floor":true,"more":{"a":[1,{}]}}"#;
    let b = &parse_boxes(&line.replace('\n', " ")).unwrap()[0];
    assert_eq!((b.index, b.domain[3][0]), ([-3, 9007199254740993], i64::MAX));
    assert_eq!((b.err, b.top, b.live, b.floor), (0.3f32, f32::INFINITY, true, true));
    assert_eq!((b.survey.as_str(), b.kernel.len(), b.kernel[0][2]), ("s \"1\"", 2, [-5, 6]));
    for (from, to) in [("\"live\"", "\"alive\""), ("-3", "-3.5"), ("null", "nan"), ("}}", "}"), ("true", "1")]
    {
        assert!(parse_boxes(&line.replace('\n', " ").replace(from, to)).is_err(), "{to}");
    }
}

// A second method for core' and tops: definition 2.1 by subtraction of polygons with rational corners.

type Number = Ratio<BigInt>;
type Region = Vec<[Number; 2]>;

fn side(p: &[i64; 2], q: &[i64; 2], x: &[Number; 2]) -> Number {
    let whole = |k: i64| Number::from(BigInt::from(k));
    let d = [whole(q[0] - p[0]), whole(q[1] - p[1])];
    d[0].clone() * (x[1].clone() - whole(p[1])) - d[1].clone() * (x[0].clone() - whole(p[0]))
}

/// The part of a convex region on one side of the line from `p` to `q`; none without interior.
fn half(region: &Region, p: &[i64; 2], q: &[i64; 2], left: bool) -> Option<Region> {
    let zero = Number::from(BigInt::from(0));
    let sides: Vec<Number> =
        region.iter().map(|x| if left { side(p, q, x) } else { -side(p, q, x) }).collect();
    if sides.iter().all(|s| *s <= zero) {
        return None;
    }
    let mut out = Region::new();
    for k in 0..region.len() {
        let n = (k + 1) % region.len();
        if sides[k] >= zero {
            out.push(region[k].clone());
        }
        if (sides[k] > zero && sides[n] < zero) || (sides[k] < zero && sides[n] > zero) {
            let t = sides[k].clone() / (sides[k].clone() - sides[n].clone());
            out.push(
                [0, 1].map(|a| {
                    region[k][a].clone() + t.clone() * (region[n][a].clone() - region[k][a].clone())
                }),
            );
        }
    }
    Some(out)
}

fn subtract(regions: Vec<Region>, hole: &[[i64; 2]; 4]) -> Vec<Region> {
    let mut out = Vec::new();
    for region in regions {
        let mut inside = Some(region.clone());
        let mut around = Vec::new();
        for k in 0..4 {
            let (p, q) = (&hole[k], &hole[(k + 1) % 4]);
            let Some(rest) = inside else { break };
            around.extend(half(&rest, p, q, false));
            inside = half(&rest, p, q, true);
        }
        if inside.is_some() {
            out.extend(around);
        } else {
            out.push(region);
        }
    }
    out
}

fn region(quad: &[[i64; 2]; 4]) -> Region {
    quad.map(|p| p.map(|k| Number::from(BigInt::from(k)))).to_vec()
}

#[test]
fn subtracting_polygons_gives_the_same_cores_and_tops() {
    let (mut replaced, mut finite) = (0, 0);
    for seed in 100..108 {
        let world = random_world(seed, 48, if seed % 2 == 0 { 8 } else { 1 << 20 });
        let cores = cores(&world);
        let kept = core_prime(&world, &cores, &faces(&world, &cores));
        for (s, survey) in world.iter().enumerate() {
            let above: Vec<_> = (0..world.len())
                .filter(|&t| world[t].precedence > survey.precedence)
                .flat_map(|t| {
                    let low = cores[t].first;
                    let high = [low[0] + cores[t].cols as i64, low[1] + cores[t].rows as i64];
                    let runs = runs(&cores[t], low, high);
                    runs.iter().map(|run| quad(&world[t], run)).collect::<Vec<_>>()
                })
                .collect();
            let step = cores[s].count() / 60 + 1;
            for [i, j] in cores[s].iter().step_by(step) {
                let cell = quad(survey, &([i, j], [i + 1, j + 1]));
                let left = above.iter().fold(vec![region(&cell)], subtract);
                assert_eq!(kept[s].contains([i, j]), !left.is_empty(), "seed {seed} survey {s} cell {i} {j}");
                replaced += usize::from(left.is_empty());
            }
        }
        let boxes = print(&world);
        for p in &boxes {
            let greater = |q: &&PatchBox| {
                let by_error = (q.err, &q.key) < (p.err, &p.key);
                q.area > p.area || (q.area == p.area && by_error)
            };
            let mut above: Vec<&PatchBox> = boxes.iter().filter(greater).collect();
            above.sort_by(|a, b| a.err.total_cmp(&b.err));
            let fixed = |b: &PatchBox| b.kernel.iter().map(|k| [k[0], k[1], k[2], k[3]]).collect::<Vec<_>>();
            let mut left: Vec<Region> = fixed(p).iter().map(region).collect();
            let mut top = if left.is_empty() { 0.0 } else { f32::INFINITY };
            for q in above {
                if left.is_empty() {
                    break;
                }
                left = fixed(q).iter().fold(left, subtract);
                if left.is_empty() {
                    top = q.err;
                }
            }
            assert_eq!(p.top, top, "seed {seed} {} {} {:?}", p.survey, p.level, p.index);
            finite += usize::from(top.is_finite() && top > 0.0);
        }
    }
    println!("{replaced} replaced cells, {finite} finite tops");
    assert!(replaced > 20 && finite > 20);
}

#[test]
fn no_sampled_point_lies_outside_the_faces() {
    for seed in 200..206 {
        let world = random_world(seed, 90, 1 << 28);
        let cores = cores(&world);
        let faces = faces(&world, &cores);
        let known: HashSet<Vec<(usize, usize)>> = faces.iter().map(|face| face.collect()).collect();
        let mut random = Random(seed);
        let mut inside = 0;
        for _ in 0..20000 {
            let s = &world[random.within(0, world.len() as i64 - 1) as usize];
            let at = [random.within(0, 1000 * s.cols as i64), random.within(0, 1000 * s.rows as i64)];
            let place = [0, 1].map(|axis| {
                let along = |k: usize| (at[k] + 1000 * s.first[k]) as i128;
                let sum = along(0) * i128::from(s.u[axis]) + along(1) * i128::from(s.v[axis]);
                s.anchor[axis] as i128 + sum / 1000
            });
            // Cells by exact division; a point on a line belongs to no face.
            let cell = |t: &OracleSurvey| {
                let [[ux, uy], [vx, vy]] = [t.u, t.v].map(|p| p.map(i128::from));
                let [x, y] = [0, 1].map(|axis| place[axis] - t.anchor[axis] as i128);
                let d = ux * vy - uy * vx;
                let (i, j) = ((x * vy - y * vx) * d.signum(), (ux * y - uy * x) * d.signum());
                let d = d.abs();
                (i % d != 0 && j % d != 0).then(|| [i.div_euclid(d) as i64, j.div_euclid(d) as i64])
            };
            let cells: Option<Vec<[i64; 2]>> = world.iter().map(cell).collect();
            let Some(cells) = cells else { continue };
            let tuple: Vec<(usize, usize)> = (0..world.len())
                .filter(|&t| cores[t].contains(cells[t]))
                .map(|t| (t, cores[t].number(cells[t]).unwrap()))
                .collect();
            if !tuple.is_empty() {
                inside += 1;
                assert!(known.contains(&tuple), "seed {seed}: {place:?} is in no face");
            }
        }
        assert!(inside > 10000);
    }
}

#[test]
fn the_tree_follows_its_definition() {
    let quad = |x0: i64, y0: i64, x1: i64, y1: i64| [[x0, y0], [x1, y0], [x1, y1], [x0, y1]];
    let patch = |id: &str, top: f32, domain: [[i64; 2]; 4]| PatchBox {
        id: id.into(),
        key: id.into(),
        survey: "s".into(),
        level: 0,
        index: [0, 0],
        kernel: Vec::new(),
        domain,
        area: 1.0,
        err: 0.0,
        top,
        live: true,
        floor: false,
    };
    let leaf = |ids: &[&str]| {
        Some(Box::new(Node {
            ids: ids.iter().map(|&s| s.into()).collect(),
            children: [None, None, None, None],
        }))
    };
    let diamond = [[4, -4], [8, 0], [4, 4], [0, 0]];
    let boxes = [
        patch("d", 1.0, quad(-8, -8, 0, 0)), // touches the others, meets south-west only
        patch("c", 1.0, quad(-1, 1, 1, 2)),
        patch("b", 2.0, diamond),
        patch("a", f32::INFINITY, quad(0, 0, 1, 1)),
        patch("e", 9.0, quad(8, 0, 9, 1)), // beside the world
        PatchBox { live: false, ..patch("f", 9.0, quad(0, 0, 1, 1)) },
    ];
    let world = ([-8, -8], [8, 8]);
    let root = expected_tree(&boxes, world, 1, 1);
    assert_eq!(root.ids, ["a"]);
    assert_eq!(root.children, [leaf(&["d"]), leaf(&["b"]), leaf(&["c"]), leaf(&["b", "c"])]);
    let deeper = expected_tree(&boxes, world, 1, 2);
    let north_east = deeper.children[3].as_ref().unwrap();
    assert_eq!(north_east.ids, ["b"]);
    assert_eq!(north_east.children, [leaf(&["c"]), None, None, None]);
    assert_eq!(expected_tree(&boxes, world, 64, 9).ids, ["a", "b", "c", "d"]);
    assert_eq!(expected_tree(&[], world, 1, 1), *leaf(&[]).unwrap());
}

#[test]
fn every_live_patch_is_once_on_every_path_it_meets() {
    let world = random_world(5, 110, 1 << 30);
    let boxes = print(&world);
    let far = 1i64 << 60;
    let root = expected_tree(&boxes, ([-far, -far], [far, far]), 2, 30);
    let mut paths = 0;
    let mut walk = vec![(&root, [-far, -far], 2 * i128::from(far), Vec::<String>::new())];
    while let Some((node, low, side, mut above)) = walk.pop() {
        above.extend(node.ids.iter().cloned());
        for (quarter, child) in node.children.iter().enumerate() {
            let half = side / 2;
            let from = [0, 1].map(|axis| low[axis] + (half as i64) * ((quarter >> axis) & 1) as i64);
            match child {
                Some(child) => walk.push((child, from, half, above.clone())),
                None => {
                    paths += 1;
                    let cell =
                        [from[0] as i128, from[1] as i128, from[0] as i128 + half, from[1] as i128 + half];
                    let meeting = boxes.iter().filter(|b| b.live && apart(&b.domain, cell).is_none());
                    for b in meeting {
                        assert_eq!(above.iter().filter(|id| **id == b.id).count(), 1, "{}", b.id);
                    }
                }
            }
        }
    }
    assert!(paths > 20, "{paths}");
}

/// A separating axis of the interiors of a quad and a square, if there is one.
fn apart(quad: &[[i64; 2]; 4], cell: [i128; 4]) -> Option<[i128; 2]> {
    let quad = quad.map(|p| p.map(i128::from));
    let square = [[cell[0], cell[1]], [cell[2], cell[1]], [cell[2], cell[3]], [cell[0], cell[3]]];
    let edge = |k: usize| [quad[k][1] - quad[(k + 1) % 4][1], quad[(k + 1) % 4][0] - quad[k][0]];
    [[1, 0], [0, 1], edge(0), edge(1), edge(2), edge(3)].into_iter().find(|axis| {
        let along = |p: &[i128; 2]| axis[0] * p[0] + axis[1] * p[1];
        let range = |points: &[[i128; 2]; 4]| {
            (points.iter().map(along).min().unwrap(), points.iter().map(along).max().unwrap())
        };
        let (a, b) = (range(&quad), range(&square));
        a.1 <= b.0 || b.1 <= a.0
    })
}
