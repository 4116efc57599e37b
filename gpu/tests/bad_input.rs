use crate::support::{gpu, open, shape, tile, tile_of};
use terraquilt_gpu::{Error, SAMPLES_MAX, Window, wgpu};

const WINDOW: Window = Window { x0: 0.0, y0: 0.0, step: 1.0, cols: 32, rows: 32, depth: 0 };

#[test]
fn windows_that_cannot_be_are_refused() {
    let Some(gpu) = gpu() else { return };
    let walk = tile(1, [32, 32], 1);
    let tile = gpu.upload(&walk).unwrap();
    let beyond = [
        Window { x0: -1.0, ..WINDOW },
        Window { y0: 0.5, ..WINDOW },
        Window { cols: 33, ..WINDOW },
        Window { step: 0.0, ..WINDOW },
        Window { step: -1.0, ..WINDOW },
        Window { step: f64::NAN, ..WINDOW },
        Window { step: f64::INFINITY, ..WINDOW },
        Window { x0: f64::NAN, ..WINDOW },
        Window { x0: f64::INFINITY, ..WINDOW },
        Window { y0: f64::NEG_INFINITY, ..WINDOW },
    ];
    for w in beyond {
        let e = tile.decode(&w).unwrap_err().to_string();
        assert!(e.starts_with("window: ") && e.contains("between 0 and 32"), "{w:?}: {e}");
    }
    let large = Window { cols: u32::MAX, rows: u32::MAX, step: 1e-12, ..WINDOW };
    let e = tile.decode(&large).unwrap_err().to_string();
    assert!(e.contains(&SAMPLES_MAX.to_string()), "{e}");
    let e = tile.decode(&Window { depth: 25, ..WINDOW }).unwrap_err().to_string();
    assert!(e.contains("25 wanted, at most 24 allowed"), "{e}");
    assert_eq!(tile.decode(&Window { cols: 0, ..WINDOW }).unwrap(), vec![]);
    assert_eq!(tile.decode(&WINDOW).unwrap().len(), 1024);
}

#[test]
fn zooms_that_cannot_be_are_refused() {
    for zoom in [0.0, -1.0, 0.5, f64::NAN, f64::INFINITY, 2_f64.powi(25)] {
        let e = Window::whole([32, 32], zoom).unwrap_err().to_string();
        assert!(e.contains("from 1 to 2^24"), "{zoom}: {e}");
    }
    let e = Window::whole([16384, 16384], 2_f64.powi(24)).unwrap_err().to_string();
    assert!(e.contains("samples of a window"), "{e}");
    assert_eq!(Window::whole([100, 75], 1.5).map(|w| (w.cols, w.rows, w.depth)), Ok((150, 112, 1)));
}

#[test]
fn heights_that_are_no_numbers_are_refused() {
    let Some(gpu) = gpu() else { return };
    let e = gpu.upload(&tile_of(shape(f64::MAX, [64, 64], 1), 2)).err().unwrap().to_string();
    assert!(e.starts_with("fractal tile: ") && e.contains("too far from the samples"), "{e}");
}

#[test]
fn a_fault_is_an_error_of_the_next_call_and_of_no_later_one() {
    let Some(gpu) = open() else { return };
    let walk = tile(2, [32, 32], 1);
    let size = gpu.device().limits().max_buffer_size + 1;
    let usage = wgpu::BufferUsages::STORAGE;
    let wrong = wgpu::BufferDescriptor { label: None, size, usage, mapped_at_creation: false };
    let _ = gpu.device().create_buffer(&wrong);
    let e = gpu.decode(&walk, &WINDOW).unwrap_err();
    assert!(matches!(e, Error::Failed { .. }) && e.to_string().contains(&size.to_string()), "{e}");
    assert_eq!(gpu.decode(&walk, &WINDOW).unwrap().len(), 1024);
}

#[test]
fn a_lost_device_is_an_error() {
    let Some(gpu) = open() else { return };
    let walk = tile(3, [32, 32], 1);
    let tile = gpu.upload(&walk).unwrap();
    gpu.device().destroy();
    for _ in 0..2 {
        let e = tile.decode(&WINDOW).unwrap_err();
        assert!(matches!(e, Error::Failed { .. }) && e.to_string().contains("decode on the CPU"), "{e}");
    }
    assert!(gpu.upload(&walk).is_err());
}
