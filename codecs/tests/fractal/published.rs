//! The rows of the specification's table, on the same files (acceptance F1), and what classes lose (F3).

use super::{Picture, Threads, fuji, photograph, puget};
use terraquilt_codecs::fractal::{Options, Partition, Search, Tile, encode_picture};

/// Encodes and holds quality and size to a row: at most 0.3 dB and 3 % worse. Quality is that of the decoded samples as they are; rounded to whole
/// levels, as a picture has them, they may be exact: a row without quality wants that.
fn row(name: &str, picture: &Option<Picture>, options: &Options, decibels: Option<f64>, ratio: f64) {
    let Some((cols, rows, samples)) = picture else { return };
    let e = encode_picture([*cols, *rows], 1, samples, name, &[], options, &Threads).unwrap();
    let found = Tile::read(&e.bytes).unwrap().plane(0).unwrap();
    let sum: f64 = found.values.iter().zip(samples).map(|(a, b)| (a - f64::from(*b)).powi(2)).sum();
    let found = 10.0 * (255.0 * 255.0 * samples.len() as f64 / sum).log10();
    let rounded = 20.0 * (255.0 / e.header.error_rms).log10();
    let found_ratio = samples.len() as f64 / e.bytes.len() as f64;
    println!(
        "{name}: {} maps, {found:.2} dB ({decibels:?}), rounded {rounded:.2}, ratio {found_ratio:.3} ({ratio}), greatest error {}",
        e.header.maps, e.header.error_max
    );
    match decibels {
        Some(d) => assert!(found >= d - 0.3, "{name}: {found:.2} dB, {d} wanted"),
        None => assert_eq!(e.header.error_max, 0.0, "{name}"),
    }
    assert!(found_ratio >= ratio * 0.97, "{name}: ratio {found_ratio:.3}, {ratio} wanted");
}

/// F1.
#[test]
fn rows_of_the_table_are_reached() {
    let maps = |n| Options { partition: Some(Partition::Maps(n)), ..Options::default() };
    let two = Options { partition: Some(Partition::Const(2)), ..Options::default() };
    let photo = photograph();
    row("photograph, 5000 maps", &photo, &maps(5000), Some(40.8), 3.92);
    row("photograph, 10000 maps", &photo, &maps(10_000), Some(50.2), 2.05);
    row("photograph, ranges of 2", &photo, &two, Some(54.9), 1.25);
    let smooth = fuji();
    row("Fuji, 5000 maps", &smooth, &maps(5000), Some(53.3), 16.1);
    row("Fuji, 20000 maps", &smooth, &maps(20_000), Some(56.3), 4.62);
    row("Fuji, 40000 maps", &smooth, &maps(40_000), Some(67.1), 2.45);
    row("Fuji, ranges of 2", &smooth, &two, None, 1.95);
    let rough = puget();
    row("Puget Sound, 5000 maps", &rough, &maps(5000), Some(34.9), 14.9);
    row("Puget Sound, 20000 maps", &rough, &maps(20_000), Some(44.8), 3.78);
    let finer = Options { scale_bits: Some(7), ..maps(40_000) };
    row("Puget Sound, 40000 maps", &rough, &finer, Some(52.4), 1.68);
}

/// F3: what the classes with both signs lose, of the collage by ranges of 4 and of 8.
#[test]
fn classes_lose_little() {
    for (name, picture) in [("photograph", photograph()), ("Fuji", fuji()), ("Puget Sound", puget())] {
        let Some((cols, rows, samples)) = picture else { continue };
        for side in [4, 8] {
            let decibels = |search| {
                let options = Options {
                    partition: Some(Partition::Const(side)),
                    search,
                    near: Some(0),
                    ..Options::default()
                };
                let e = encode_picture([cols, rows], 1, &samples, name, &[], &options, &Threads).unwrap();
                20.0 * (255.0 / e.header.error_rms).log10()
            };
            let (exact, classes) = (decibels(Search::Exact), decibels(Search::Classes));
            println!("{name}, ranges of {side}: exact {exact:.2} dB, classes {classes:.2} dB");
            assert!(exact - classes <= 0.7, "{name}, ranges of {side}: {exact:.2}, {classes:.2}");
        }
    }
}
