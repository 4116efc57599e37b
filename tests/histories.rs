//! Histories of tiles that once went wrong, and random ones like them: every state equals a fresh build and verifies.

use crate::support::{Grid, Random, Scratch, ground, seeds};
use terraquilt::db::{Change, Ingest, Policy};
use terraquilt::height::source::Affine;

fn grid(name: &str, x: f64, y: f64, cols: usize, rows: usize, prec: i64) -> Grid {
    let affine = Affine { origin: [x, y], col_step: [1.0, 0.0], row_step: [0.0, -1.0] };
    let mut z = Vec::new();
    for j in 0..rows {
        for i in 0..cols {
            z.push(ground(x + i as f64 - 500_000.0, y - j as f64 - 4_000_000.0).round() as f32);
        }
    }
    Grid { name: name.into(), cols, rows, z, affine, accuracy: 0.5, precedence: Some(prec), date: None }
}
fn into(g: &Grid, tiles: Vec<&Grid>) -> Change {
    Change::Ingest(Ingest {
        into: Some(g.name.clone()),
        precedence: None,
        accuracy_m: None,
        ..g.tiles_of(tiles.iter().map(|t| t.source()).collect())
    })
}
fn remove(s: &Scratch, g: &Grid) {
    let tile = format!("{}-{}-{}.mem", g.name, g.affine.origin[0], g.affine.origin[1]);
    s.change(Change::Remove { surveys: vec![g.name.clone()], tile: Some(tile) }).unwrap();
}

#[test]
fn a_place_that_vanishes_leaves_the_kernels_above_it() {
    let a = grid("h", 499_996.0, 4_000_000.0, 58, 200, 0);
    let b = grid("h", 500_054.0, 4_000_000.0, 60, 200, 0);
    let s = Scratch::new(Policy::Accuracy);
    s.ingest(&a);
    let fresh = s.fingerprint();
    s.change(into(&a, vec![&b])).unwrap();
    remove(&s, &b);
    s.verify();
    assert_eq!(fresh, s.fingerprint());
}
#[test]
fn ground_under_a_removed_tile_comes_back() {
    let a = grid("h", 500_000.0, 4_000_000.0, 100, 100, 1);
    let b = grid("h", 501_000.0, 4_000_000.0, 100, 100, 1);
    let g = grid("g", 500_980.0, 4_000_020.0, 140, 140, 0);
    let s = Scratch::new(Policy::Accuracy);
    s.ingest(&g);
    s.ingest(&a);
    let fresh = s.fingerprint();
    s.change(into(&a, vec![&b])).unwrap();
    remove(&s, &b);
    s.verify();
    assert_eq!(fresh, s.fingerprint());
}
#[test]
fn a_tile_delivered_again_beside_a_new_one_costs_nothing() {
    let a = grid("h", 500_000.0, 4_000_000.0, 100, 100, 0);
    let b = grid("h", 500_100.0, 4_000_000.0, 100, 100, 0);
    let s = Scratch::new(Policy::Accuracy);
    s.ingest(&a);
    s.change(into(&a, vec![&a, &b])).unwrap();
    s.verify();
}
#[test]
fn a_diagonal_tile_equals_both_at_once() {
    let a = grid("h", 500_000.0, 4_000_000.0, 700, 700, 0);
    let b = grid("h", 500_700.0, 3_999_300.0, 700, 700, 0);
    let s = Scratch::new(Policy::Accuracy);
    s.ingest(&a);
    let fresh = s.fingerprint();
    s.change(into(&a, vec![&b])).unwrap();
    let one = Scratch::new(Policy::Accuracy);
    one.change(Change::Ingest(Ingest { name: Some("h".into()), ..a.tiles_of(vec![a.source(), b.source()]) }))
        .unwrap();
    one.verify();
    s.verify();
    remove(&s, &b);
    assert_eq!(fresh, s.fingerprint());
    s.verify();
}
#[test]
fn ids_of_operations_that_are_the_programs_own_are_refused() {
    let s = Scratch::new(Policy::Accuracy);
    let stop = std::sync::atomic::AtomicBool::new(false);
    let p = terraquilt::db::Progress { report: &|_, _| (), stop: &stop };
    let a = grid("a", 500_000.0, 4_000_000.0, 100, 100, 0);
    let refused =
        s.db.change(Change::Ingest(a.ingest()), Some("commit-2"), false, &p, &mut || ()).unwrap_err();
    assert!(refused.to_string().contains("commit-"), "{refused}");
    s.ingest(&a);
    s.ingest(&grid("b", 500_000.0, 4_000_000.0, 100, 100, 0));
}

#[test]
fn tiles_too_far_apart_are_refused_before_anything_is_allocated() {
    let s = Scratch::new(Policy::Accuracy);
    let a = grid("h", 500_000.0, 4_000_000.0, 64, 64, 0);
    s.ingest(&a);
    let before = s.fingerprint();
    let b = grid("h", 600_000.0, 3_900_000.0, 64, 64, 0);
    let refused = s.change(into(&a, vec![&b])).unwrap_err().to_string();
    assert!(refused.contains("far apart"), "{refused}");
    assert_eq!(before, s.fingerprint());
}

#[test]
fn random_tiles_in_and_out_equal_fresh_builds() {
    for seed in seeds(25) {
        let mut r = Random::new(seed);
        let s = Scratch::new(Policy::Accuracy);
        // Surveys: name -> all tiles, cut at random places; some far away.
        let mut all: Vec<(Vec<Grid>, f64)> = Vec::new();
        for n in 0..3u64 {
            let step = [1.0, 2.0, 5.0][r.below(3) as usize];
            let (c, rr) = (60 + r.below(160) as usize, 60 + r.below(160) as usize);
            let x = 499_996.0 + (r.below(100) as f64) * 10.0;
            let y = 4_000_000.0 - (r.below(20) as f64) * 10.0;
            let mut g = grid(&format!("s{n}"), x, y, c, rr, r.below(3) as i64);
            g.affine = Affine { origin: [x, y], col_step: [step, 0.0], row_step: [0.0, -step] };
            g.accuracy = [0.0, 0.5, 0.5, 1.0][r.below(4) as usize];
            for j in 0..rr {
                for i in 0..c {
                    let v = ground(x + i as f64 * step - 500_000.0, y - j as f64 * step - 4_000_000.0);
                    g.z[j * c + i] = if r.chance(0.0005) { f32::NAN } else { v.round() as f32 };
                }
            }
            // cuts at multiples of 28 + 2 or anywhere
            let mut xs = vec![0, c];
            let mut ys = vec![0, rr];
            for _ in 0..2 {
                xs.push(if r.chance(0.6) {
                    let i0 = (x / step) as i64;
                    let k = r.below((c as u64) / 28) as i64;
                    let at = (28 - i0.rem_euclid(28)) % 28 + 28 * k + r.below(4) as i64;
                    at.clamp(0, c as i64) as usize
                } else {
                    r.below(c as u64) as usize
                });
                ys.push(r.below(rr as u64) as usize);
            }
            xs.sort();
            ys.sort();
            let mut tiles = Vec::new();
            for a in xs.windows(2) {
                for b in ys.windows(2) {
                    if a[1] - a[0] >= 5 && b[1] - b[0] >= 5 {
                        let t = g.cut(a[0], b[0], a[1] - a[0], b[1] - b[0]);
                        if t.z.iter().filter(|v| v.is_finite()).count() > 20 {
                            tiles.push(t);
                        }
                    }
                }
            }
            if r.chance(0.5) {
                // one far tile
                let mut t = tiles[0].clone();
                t.affine.origin[0] += (300 + r.below(300)) as f64 * step;
                tiles.push(t);
            }
            if !tiles.is_empty() {
                all.push((tiles, step));
            }
        }
        let mut present: Vec<Vec<usize>> = vec![Vec::new(); all.len()];
        for step in 0..14 {
            let n = r.below(all.len() as u64) as usize;
            let (tiles, _) = &all[n];
            let absent: Vec<usize> = (0..tiles.len()).filter(|k| !present[n].contains(k)).collect();
            let what;
            if present[n].is_empty() || (r.chance(0.55) && !absent.is_empty()) {
                let k = absent[r.below(absent.len() as u64) as usize];
                what = format!("add {n} {k}");
                let res = if present[n].is_empty() {
                    s.change(Change::Ingest(tiles[k].ingest()))
                } else {
                    s.change(into(&tiles[k], vec![&tiles[k]]))
                };
                match res {
                    Ok(_) => present[n].push(k),
                    Err(e) => {
                        assert!(e.to_string().contains("no cell"), "{e}");
                        continue;
                    }
                }
            } else {
                let at = r.below(present[n].len() as u64) as usize;
                let k = present[n][at];
                what = format!("remove {n} {k}");
                let t = &tiles[k];
                let tile = format!("{}-{}-{}.mem", t.name, t.affine.origin[0], t.affine.origin[1]);
                match s.change(Change::Remove { surveys: vec![t.name.clone()], tile: Some(tile) }) {
                    Ok(_) => {
                        present[n].remove(at);
                    }
                    Err(e) => {
                        assert!(e.to_string().contains("no cell"), "{e}");
                        continue;
                    }
                }
            }
            let fresh = Scratch::new(Policy::Accuracy);
            for (n, p) in present.iter().enumerate() {
                if !p.is_empty() {
                    let t = &all[n].0;
                    fresh
                        .change(Change::Ingest(Ingest {
                            name: Some(t[0].name.clone()),
                            ..t[0].tiles_of(p.iter().map(|k| t[*k].source()).collect())
                        }))
                        .unwrap();
                }
            }
            assert_eq!(
                s.fingerprint(),
                if present.iter().all(Vec::is_empty) { s.fingerprint() } else { fresh.fingerprint() },
                "seed {seed} step {step} {what} {present:?}"
            );
            s.verify();
        }
    }
}
