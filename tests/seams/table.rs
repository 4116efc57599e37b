//! The table of section 15.2: slopes along borders of real surveys, before and after.

use super::{helens, normals, read, slopes, world};
use crate::certified::reference::World;
use crate::certified::worlds::Ask;
use crate::support::{Grid, shared};
use terraquilt::db::Policy;
use terraquilt::height::source::Affine;
use terraquilt::height::surface::Seams;

fn row(name: &str, w: &World, ask: &Ask, normals: &[([f64; 2], [f64; 2])]) {
    let quantiles = |s: Seams| {
        let f = slopes(w, ask, s, normals);
        let at = |q: f64| f[((f.len() - 1) as f64 * q).round() as usize];
        format!("{:.2} / {:.2} / {:.2}", at(0.5), at(0.99), at(1.0))
    };
    println!(
        "| {name} | {} | {} | {} |",
        quantiles(Seams::Off),
        quantiles(Seams::All),
        quantiles(Seams::Consistent)
    );
}

/// The table of section 15.2. Run with `cargo test --release -- --ignored --nocapture slopes_along_borders`.
#[test]
#[ignore = "prints a table"]
fn slopes_along_borders() {
    println!("| slope along the border, p50 / p99 / max | off | all | consistent |\n|---|---|---|---|");
    let d = world(&helens(&[0, 3]), Policy::Newest);
    let n = normals(&d.surveys[1], 1500);
    for z in [0.0, 5.0, 20.0, 50.0] {
        row(&format!("D, z = {z}"), &d, &Ask::Metres(z), &n);
    }
    let rising = Ask::Eye {
        eye: [562_140.0, 5_116_100.0, d.z[1]],
        look: [563_900.0, 5_116_100.0, d.z[1]],
        fov: 60.0,
        viewport: [1000, 1000],
        pixels: 32.0,
    };
    let ends = [562_165.0, 563_215.0].map(|x| rising.at([x, 5_116_100.0], d.z));
    row(&format!("D, z rising from {:.1} to {:.1}", ends[0], ends[1]), &d, &rising, &n);
    let chain = world(&helens(&[0, 1, 2, 3]), Policy::Newest);
    row("D, two more between, z = 0", &chain, &Ask::Metres(0.0), &normals(&chain.surveys[3], 1500));
    let Some(s) = sierra() else { return };
    let n = normals(&s.surveys[1], 1500);
    for z in [0.0, 5.0, 15.0, 25.0, 40.0, 80.0] {
        row(&format!("S, z = {z}"), &s, &Ask::Metres(z), &n);
    }
}

/// The 30 m survey of the Sierra, and a base of 150 m from SRTM, both in its Albers coordinates.
fn sierra() -> Option<World> {
    let fine = read(&shared("overlap/sierra/sierra_30m_albers.tif")?, "fine", 1.0, None);
    let srtm = read(&shared("dem/sierra_srtm3.tif")?, "srtm", 10.0, None);
    let a = &fine.affine;
    let (west, north) = (a.origin[0] - 9000.0, a.origin[1] + 9000.0);
    let side = (fine.cols as f64 * 30.0 + 18_000.0) / 150.0;
    let n = side as usize;
    let affine = Affine { origin: [west, north], col_step: [150.0, 0.0], row_step: [0.0, -150.0] };
    let mut z = Vec::new();
    for r in 0..n {
        for c in 0..n {
            let [lon, lat] = geographic([west + c as f64 * 150.0, north - r as f64 * 150.0]);
            let (x, y) = (
                (lon - srtm.affine.origin[0]) / srtm.affine.col_step[0],
                (lat - srtm.affine.origin[1]) / srtm.affine.row_step[1],
            );
            let (i, j) = (x.floor() as usize, y.floor() as usize);
            let (s, t) = ((x - i as f64) as f32, (y - j as f64) as f32);
            let at = |i: usize, j: usize| srtm.z[j * srtm.cols + i];
            let left = at(i, j) * (1.0 - t) + at(i, j + 1) * t;
            let right = at(i + 1, j) * (1.0 - t) + at(i + 1, j + 1) * t;
            z.push(left * (1.0 - s) + right * s);
        }
    }
    let base = Grid {
        name: "base".into(),
        cols: n,
        rows: n,
        z,
        affine,
        accuracy: 10.0,
        precedence: None,
        date: None,
    };
    Some(world(&[base, fine], Policy::Accuracy))
}

/// Longitude and latitude of a place in USA Contiguous Albers (parallels 29.5 and 45.5, centre 96 W, 37.5 N, GRS 80).
fn geographic(p: [f64; 2]) -> [f64; 2] {
    let (a, e2): (f64, f64) = (6_378_137.0, 0.006_694_380_022_9);
    let e = e2.sqrt();
    let q = |f: f64| {
        let s = f.sin();
        (1.0 - e2) * (s / (1.0 - e2 * s * s) - ((1.0 - e * s) / (1.0 + e * s)).ln() / (2.0 * e))
    };
    let m2 = |f: f64| f.cos().powi(2) / (1.0 - e2 * f.sin().powi(2));
    let (f1, f2, f0) = (29.5f64.to_radians(), 45.5f64.to_radians(), 37.5f64.to_radians());
    let n = (m2(f1) - m2(f2)) / (q(f2) - q(f1));
    let c = m2(f1) + n * q(f1);
    let r0 = a * (c - n * q(f0)).sqrt() / n;
    let (x, y) = (p[0], r0 - p[1]);
    let r = x.hypot(y);
    let wanted = (c - (r * n / a).powi(2)) / n;
    let (mut lo, mut hi) = (0.3f64, 1.2f64);
    for _ in 0..60 {
        let mid = (lo + hi) / 2.0;
        if q(mid) < wanted { lo = mid } else { hi = mid }
    }
    [-96.0 + (x.atan2(y) / n).to_degrees(), lo.to_degrees()]
}
