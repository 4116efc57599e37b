//! Acceptance G-a: the lemma, closure, no crack, the count, strips; on random selections, n = 0 to 9.

use crate::support::random::Random;
use std::collections::HashMap;
use terraquilt_codecs::gtb::{bitree, surface};
use terraquilt_codecs::lattice::Lattice;

fn lattice(n: u32) -> Lattice {
    Lattice::new(n).unwrap()
}

fn heights(lattice: Lattice, random: &mut Random) -> Vec<f64> {
    (0..lattice.side() * lattice.side()).map(|_| random.below(4001) as f64 - 2000.0).collect()
}

/// Twice the area of a triangle, positive if it runs counter-clockwise seen from above with rows to the south.
fn area(side: usize, t: [u32; 3]) -> i64 {
    let p = t.map(|k| [k as i64 % side as i64, -(k as i64 / side as i64)]);
    (p[1][0] - p[0][0]) * (p[2][1] - p[0][1]) - (p[1][1] - p[0][1]) * (p[2][0] - p[0][0])
}

/// Linear interpolation in each triangle at every post that it holds; compared with `z`. Returns how often posts were met.
fn compare(side: usize, triangles: &[[u32; 3]], z: &[f64]) -> Vec<u8> {
    let mut met = vec![0u8; side * side];
    for t in triangles {
        let p = t.map(|k| [(k as usize / side) as f64, (k as usize % side) as f64]);
        let h = t.map(|k| z[k as usize]);
        let range = |k: usize| {
            let v = p.map(|q| q[k] as usize);
            *v.iter().min().unwrap()..=*v.iter().max().unwrap()
        };
        let [dy1, dx1, dy2, dx2] =
            [p[1][0] - p[0][0], p[1][1] - p[0][1], p[2][0] - p[0][0], p[2][1] - p[0][1]];
        let whole = dy1 * dx2 - dx1 * dy2;
        for y in range(0) {
            for x in range(1) {
                let (v, u) = (y as f64 - p[0][0], x as f64 - p[0][1]);
                let (w1, w2) = ((v * dx2 - u * dy2) / whole, (dy1 * u - dx1 * v) / whole);
                if w1 >= 0.0 && w2 >= 0.0 && w1 + w2 <= 1.0 {
                    let at = y * side + x;
                    let here = h[0] + w1 * (h[1] - h[0]) + w2 * (h[2] - h[0]);
                    assert!(
                        (here - z[at]).abs() < 1e-6,
                        "post {at}: {here} in the triangle, {} by midpoints",
                        z[at]
                    );
                    met[at] += 1;
                }
            }
        }
    }
    met
}

#[test]
fn the_surface_is_the_drawn_one() {
    for n in 1..=9 {
        let lattice = lattice(n);
        let mut random = Random::new(u64::from(n));
        for _ in 0..if n < 7 { 40 } else { 6 } {
            let selected = random.selection(lattice);
            let mut z = heights(lattice, &mut random);
            surface::fill(lattice, &mut z, |at| selected[at]);
            let needed = bitree::needed(lattice, &selected);
            assert!(needed.iter().zip(&selected).all(|(n, s)| *n || !s), "a selected post is not needed");
            let met = compare(lattice.side(), &bitree::triangles(lattice, &needed), &z);
            assert!(met.iter().all(|m| *m > 0), "a post lies in no triangle");
        }
    }
}

#[test]
fn triangles_meet_edge_to_edge_and_are_counted() {
    for n in 0..=9 {
        let (lattice, side) = (lattice(n), lattice(n).side());
        let mut random = Random::new(100 + u64::from(n));
        for _ in 0..if n < 7 { 40 } else { 6 } {
            let needed = bitree::needed(lattice, &random.selection(lattice));
            let triangles = bitree::triangles(lattice, &needed);
            assert_eq!(triangles.len() as u64, bitree::count(lattice, &needed));
            let mut edges: HashMap<(u32, u32), i32> = HashMap::new();
            let mut covered = 0;
            for t in &triangles {
                assert!(area(side, *t) > 0, "{t:?} runs clockwise");
                covered += area(side, *t);
                for k in 0..3 {
                    let (a, b) = (t[k], t[(k + 1) % 3]);
                    assert!(needed[a as usize]);
                    // The neighbour runs along the edge the other way.
                    *edges.entry((a.min(b), a.max(b))).or_default() += if a < b { 1 } else { 4 };
                }
            }
            assert_eq!(covered, 2 * (lattice.last() * lattice.last()) as i64);
            for ((a, b), uses) in edges {
                let [p, q] = [a, b].map(|k| [k as usize / side, k as usize % side]);
                let border = (0..2).any(|k| p[k] == q[k] && (p[k] == 0 || p[k] == lattice.last()));
                assert!(if border { uses == 1 || uses == 4 } else { uses == 5 }, "edge {p:?} {q:?}: {uses}");
            }
        }
    }
}

/// Needed posts without a child are selected ones: the closure adds nothing that it need not.
#[test]
fn the_closure_is_the_smallest() {
    for n in 1..=6 {
        let (lattice, side) = (lattice(n), lattice(n).side());
        let mut random = Random::new(200 + u64::from(n));
        for _ in 0..20 {
            let selected = random.selection(lattice);
            let needed = bitree::needed(lattice, &selected);
            let mut asked = selected.clone();
            lattice.corners().into_iter().for_each(|[y, x]| asked[y * side + x] = true);
            for pass in lattice.passes() {
                for p in pass.posts(lattice).filter(|p| needed[p[0] * side + p[1]]) {
                    pass.parents(lattice, p)
                        .1
                        .into_iter()
                        .flatten()
                        .for_each(|[y, x]| asked[y * side + x] = true);
                }
            }
            assert_eq!(asked, needed);
        }
    }
}

#[test]
fn strips_are_the_triangles() {
    for n in 0..=8 {
        let (lattice, side) = (lattice(n), lattice(n).side());
        let mut random = Random::new(300 + u64::from(n));
        for _ in 0..if n < 7 { 40 } else { 6 } {
            let needed = bitree::needed(lattice, &random.selection(lattice));
            let mut drawn = Vec::new();
            let strips = bitree::strips(lattice, &needed);
            for strip in &strips {
                for (k, t) in strip.windows(3).enumerate() {
                    let t = if k % 2 == 0 { [t[0], t[1], t[2]] } else { [t[1], t[0], t[2]] };
                    if t[0] != t[1] && t[1] != t[2] && t[0] != t[2] {
                        assert!(area(side, t) > 0, "{t:?} runs clockwise");
                        drawn.push(t);
                    }
                }
            }
            let sorted = |mut all: Vec<[u32; 3]>| {
                all.iter_mut().for_each(|t| t.sort_unstable());
                all.sort_unstable();
                all
            };
            let triangles = bitree::triangles(lattice, &needed);
            let length: usize = strips.iter().map(Vec::len).sum();
            assert!(
                length
                    <= if triangles.len() > 1000 {
                        triangles.len() * 8 / 5
                    } else {
                        10 + 2 * triangles.len()
                    },
                "{length} posts for {} triangles",
                triangles.len()
            );
            assert_eq!(sorted(drawn), sorted(triangles));
        }
    }
}

/// Posts in a plane go, the surface stays to the bit.
#[test]
fn bent_posts_are_enough() {
    for n in 1..=8 {
        let (lattice, side) = (lattice(n), lattice(n).side());
        let mut random = Random::new(400 + u64::from(n));
        let mut z = heights(lattice, &mut random);
        // A slope, and a rough north-west.
        for (at, z) in z.iter_mut().enumerate() {
            let (y, x) = (at / side, at % side);
            *z = (3 * y + 5 * x) as f64 + if y < side / 3 && x < side / 3 { *z } else { 0.0 };
        }
        let bent = bitree::bent(lattice, &z);
        let kept = bent.iter().filter(|b| **b).count();
        assert!(kept * 3 < side * side + 9 && (n < 3 || kept > 0), "{kept} of {}", side * side);
        let mut thin = z.clone();
        surface::fill(lattice, &mut thin, |at| bent[at]);
        assert_eq!(thin, z);
    }
}
