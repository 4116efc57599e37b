//! Distance fields as maps (acceptance F8).

use super::Threads;
use crate::solid::real;
use crate::support::shared;
use terraquilt_codecs::fractal::{Options, Partition, Search, Space, Tile, encode_volume};
use terraquilt_codecs::solid::{Border, Field, MARGIN, Samples, Window, separation, surface};

/// F8: the dragon at 128^3 with 40 000 maps and with 20 000, and the bunny at 64^3 with 10 000.
#[test]
fn published_rows_are_reached() {
    for (file, n, maps, decibels, ratio) in [
        ("mesh/stanford_bunny.ply", 64, 10_000, 39.74, 10.72),
        ("mesh/stanford_dragon_res3.ply", 128, 20_000, 42.55, 26.63),
        ("mesh/stanford_dragon_res3.ply", 128, 40_000, 42.7, 20.49),
    ] {
        let Some(path) = shared(file) else { continue };
        let mesh = real::read(&std::fs::read_to_string(path).unwrap());
        let window = Window::around(mesh.bounds().unwrap(), [n; 3], MARGIN).unwrap();
        let (field, _) = Field::of(&mesh, window, &Threads).unwrap();
        let options =
            Options { partition: Some(Partition::Maps(maps)), search: Search::Exact, ..Options::default() };
        let space = Space { origin: window.from_voxels([0.5; 3]), voxel: window.voxel };
        let started = std::time::Instant::now();
        let e = encode_volume([n; 3], &field.values, space, file, &options, &Threads).unwrap();
        let found = 20.0 * (255.0 / e.header.error_rms).log10();
        let found_ratio = field.values.len() as f64 / e.bytes.len() as f64;
        let tile = Tile::read(&e.bytes).unwrap();
        let again = tile.volume().unwrap();
        let samples = Samples { window, values: &again.values[..] };
        let [before, after] = [
            surface(&field.samples(), 0.0, Border::Open, &Threads).unwrap(),
            surface(&samples, 0.0, Border::Open, &Threads).unwrap(),
        ];
        let apart = separation(&before, &after, window.voxel / 2.0, &Threads).unwrap();
        let [there, back] = [apart.there, apart.back].map(|d| [d.max, d.rms].map(|v| v / window.voxel));
        println!(
            "{file}: {} maps, {found:.2} dB ({decibels}), ratio {found_ratio:.2} ({ratio}), surfaces apart by {:.3} voxels there, {:.3} back, rms {:.3} and {:.3}; {:.1} s",
            e.header.maps,
            there[0],
            back[0],
            there[1],
            back[1],
            started.elapsed().as_secs_f64()
        );
        assert!(found >= decibels && found_ratio >= ratio);
        assert!(there[0] <= 1.0 && back[0] <= 1.0 && there[1] <= 0.1 && back[1] <= 0.1);
    }
}
