use super::*;
use proptest::prelude::*;

fn close(z: &Vertices, scale: f64, offset: f64) -> usize {
    let bytes = pack(z, scale, offset);
    let back = unpack(&bytes).unwrap();
    for (k, (a, b)) in z.iter().zip(back.iter()).enumerate() {
        assert!((a - b).abs() <= ERROR_M, "vertex {k}: {a} became {b}");
    }
    assert_eq!(pack(z, scale, offset), bytes);
    bytes.len()
}

fn exact(z: &Vertices, scale: f64, offset: f64) -> usize {
    assert_eq!(*unpack(&pack(z, scale, offset)).unwrap(), *z);
    close(z, scale, offset)
}

fn hills(k: usize) -> f64 {
    let (x, y) = ((k % SIDE) as f64, (k / SIDE) as f64);
    1234.5 + 3.0 * x + 20.0 * (y / 5.0).sin() + ((k * 7919 + k * k * 31) % 97) as f64 / 40.0
}

#[test]
fn samples_come_back_exactly() {
    let whole: Vertices = std::array::from_fn(|k| hills(k).round());
    assert!(exact(&whole, 1.0, 0.0) < 600);
    let scaled: Vertices = std::array::from_fn(|k| hills(k).round() * 0.01 + 7.0);
    assert!(exact(&scaled, 0.01, 7.0) < 620);
    let centimetres: Vertices = std::array::from_fn(|k| f64::from(hills(k) as f32 * 100.0).round() / 100.0);
    let centimetres = centimetres.map(|z| f64::from(z as f32));
    let bytes = exact(&centimetres, 1.0, 0.0);
    assert!(bytes < 1300, "{bytes}");
    let floats: Vertices = std::array::from_fn(|k| f64::from(hills(k) as f32));
    assert!(exact(&floats, 1.0, 0.0) < 2400);
    let feet: Vertices = std::array::from_fn(|k| f64::from(hills(k) as f32) * 0.3048);
    assert!(exact(&feet, 0.3048, 0.0) < 2400);
    assert_eq!(exact(&[-7.25; COUNT], 1.0, 0.0), 3);
    assert_eq!(exact(&[0.0; COUNT], 1.0, 0.0), 3);
}

#[test]
fn voids_cost_little() {
    // Valid on one side of a slanted line, fills beside it, nothing beyond.
    let z: Vertices = std::array::from_fn(|k| match k % SIDE * 2 + k / SIDE {
        n if n < 40 => hills(k).round(),
        n if n < 42 => f64::from((hills(k) / 3.0) as f32),
        _ => 0.0,
    });
    let bytes = close(&z, 1.0, 0.0);
    assert!(bytes < 500, "{bytes}");
    let back = unpack(&pack(&z, 1.0, 0.0)).unwrap();
    assert!((0..COUNT).all(|k| k % SIDE * 2 + k / SIDE < 42 || back[k] == 0.0));
}

#[test]
fn the_bytes_are_as_drawn() {
    // Flags 8 (flat), exponent 1, first number 500 as zigzag LEB128: 1000 m.
    assert_eq!(pack(&[1000.0; COUNT], 1.0, 0.0), [0x08, 3, 0xfa, 0x01]);
    // A plane: W + N - NW says it all. Row 0 is predicted from the west and column 0 from the north.
    let z: Vertices = std::array::from_fn(|k| (5 + k % SIDE + 3 * (k / SIDE)) as f64);
    let bytes = pack(&z, 1.0, 0.0);
    assert_eq!(&bytes[..3], [0x00, 0, 10]);
    assert_eq!(bytes[3..8], [64u8, 0xc0, 0, 0, 0]);
    assert_eq!(*unpack(&bytes).unwrap(), z);
}

/// Low ground by the sea, with a few fills: every class, escapes, fitted coefficients.
fn golden() -> Vertices {
    std::array::from_fn(|k| match (k % SIDE, k / SIDE) {
        (a, _) if a > 22 => 0.0,
        (22, b) => 100.0 + b as f64 / 3.0,
        (a, b) => (100 + a * a / 9 + b + (a * b) % 3 + if (a, b) == (5, 20) { 5000 } else { 0 }) as f64,
    })
}

#[test]
fn bytes_of_today_are_read_for_ever() {
    let known: Vec<u8> = include_str!("golden.hex")
        .split_ascii_whitespace()
        .flat_map(|line| {
            (0..line.len() / 2).map(|k| u8::from_str_radix(&line[2 * k..2 * k + 2], 16).unwrap())
        })
        .collect();
    let bytes = pack(&golden(), 1.0, 0.0);
    let hex: String = bytes.iter().map(|b| format!("{b:02x}")).collect();
    assert_eq!(bytes, known, "{hex}");
    let back = unpack(&known).unwrap();
    assert!(back.iter().zip(&golden()).all(|(a, b)| (a - b).abs() <= ERROR_M));
}

#[test]
fn truncated_and_flipped_bytes_never_panic() {
    let z: Vertices = std::array::from_fn(|k| if k % 11 == 0 { 0.1 } else { hills(k).round() });
    for z in [z, std::array::from_fn(|k| 1e300 * (k as f64 - 500.0)), [3.0; COUNT]] {
        let bytes = pack(&z, 1.0, 0.0);
        for n in 0..bytes.len() {
            assert!(unpack(&bytes[..n]).is_err(), "{n} of {} bytes", bytes.len());
        }
        let mut long = bytes.clone();
        long.push(0);
        assert!(unpack(&long).is_err());
        for k in 0..(bytes.len() * 8).min(4000) {
            let mut b = bytes.clone();
            b[k / 8] ^= 1 << (k % 8);
            if let Ok(z) = unpack(&b) {
                assert!(z.iter().all(|z| z.is_finite()));
            }
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn any_heights_come_back(
        seed in proptest::collection::vec(prop_oneof![
            Just(0.0), -1e6..1e6f64, -10.0..10.0f64, proptest::num::f64::NORMAL, (-9000i32..9000).prop_map(f64::from),
            (-1e5..1e5f32).prop_map(f64::from),
        ], 40),
        scale in prop_oneof![Just(1.0), Just(0.01), Just(-0.3048), Just(0.0), 1e-3..10.0f64],
        pick in proptest::collection::vec(0usize..40, COUNT),
    ) {
        let z: Vertices = std::array::from_fn(|k| seed[pick[k]]);
        let back = unpack(&pack(&z, scale, 0.5)).unwrap();
        for (a, b) in z.iter().zip(back.iter()) {
            prop_assert!((a - b).abs() <= ERROR_M, "{} became {}", a, b);
        }
    }

    #[test]
    fn any_bytes_are_refused_or_are_heights(bytes in proptest::collection::vec(any::<u8>(), 0..3000)) {
        if let Ok(z) = unpack(&bytes) {
            prop_assert!(z.iter().all(|z| z.is_finite()));
        }
    }
}
