//! Against independent brute-force answers (NumPy, float64), kept in `tests/data/reference`.

use crate::support::{data, relative_difference};
use glam::DVec3;
use holosonar::acquisition::{DataCube, PropagationModel, SimulateOptions, simulate};
use holosonar::files::npz::NpzReader;
use holosonar::grid::{Axis, Grid};
use holosonar::progress::Silent;
use holosonar::reconstruct::{Method, ReconstructOptions, Window, reconstruct};
use holosonar::reflectors::Reflectors;

const LIMIT: u64 = 1 << 30;

fn forward(name: &str, model: PropagationModel) {
    let expected = DataCube::read(&data(&format!("reference/{name}.npz")), LIMIT).unwrap();
    let reflectors = Reflectors::read_csv(&data("reference/reflectors.csv")).unwrap();
    let options = SimulateOptions::default().with_model(model);
    let cube = simulate(&reflectors, &expected.instrument, &options, &Silent).unwrap();
    let error = relative_difference(&cube.samples, &expected.samples);
    assert!(error < 1e-4, "{name}: {error:e} of the maximum");
}

#[test]
fn forward_quadrature() {
    forward("forward_quadrature", PropagationModel::Exact);
}

#[test]
fn forward_in_phase() {
    forward("forward_in_phase", PropagationModel::Exact);
}

#[test]
fn forward_monostatic() {
    forward("forward_monostatic_quadrature", PropagationModel::Exact);
}

#[test]
fn forward_linear() {
    forward("forward_linear_in_phase", PropagationModel::Linear);
}

/// An expected volume: its grid and samples. Depths are three single planes, not evenly spaced to the last bit.
fn volume(name: &str) -> (Grid, Vec<num_complex::Complex32>) {
    let mut npz = NpzReader::open(&data(&format!("reference/{name}.npz")), LIMIT).unwrap();
    let axis = |values: Vec<f64>| Axis {
        first: values[0],
        pitch: (values[values.len() - 1] - values[0]) / (values.len() - 1) as f64,
        count: values.len(),
    };
    let grid = Grid {
        x: axis(npz.f64("x").unwrap().data),
        y: axis(npz.f64("y").unwrap().data),
        z: axis(npz.f64("z").unwrap().data),
    };
    (grid, npz.complex("samples").unwrap().data)
}

fn inverse(detection: &str, pitch: &str) {
    let cube = DataCube::read(&data(&format!("reference/cube_{detection}.npz")), LIMIT).unwrap();
    let (grid, expected) = volume(&format!("volume_{detection}_{pitch}"));
    for (method, tolerance) in [
        (Method::Direct, 0.0),
        (Method::Convolution, 0.0),
        (Method::Backprojection, 1e-5),
        (Method::Auto, 1e-5),
    ] {
        let mut options = ReconstructOptions::new(method, Window::None);
        options.tolerance = tolerance;
        let got = reconstruct(&cube, &grid, &options, &Silent).unwrap();
        assert!(got.method == method || got.method == Method::Convolution && method == Method::Auto);
        let error = relative_difference(&got.volume.samples, &expected);
        assert!(error < 1e-4, "{method:?} {tolerance} {detection} {pitch}: {error:e} of the maximum");
    }
}

#[test]
fn volumes_at_8_mm_between_the_microphones() {
    inverse("quadrature", "8mm");
    inverse("in_phase", "8mm");
}

#[test]
fn volumes_at_4_mm_on_half_the_pitch() {
    inverse("quadrature", "4mm");
    inverse("in_phase", "4mm");
}

#[test]
fn a_cube_file_comes_back_as_it_was_and_byte_for_byte() {
    let folder = tempfile::tempdir().unwrap();
    for name in ["cube_quadrature", "cube_in_phase", "forward_monostatic_quadrature"] {
        let cube = DataCube::read(&data(&format!("reference/{name}.npz")), LIMIT).unwrap();
        let paths = [folder.path().join("a.npz"), folder.path().join("b.npz")];
        cube.write(&paths[0]).unwrap();
        cube.write(&paths[1]).unwrap();
        assert_eq!(DataCube::read(&paths[0], LIMIT).unwrap(), cube);
        assert_eq!(std::fs::read(&paths[0]).unwrap(), std::fs::read(&paths[1]).unwrap());
    }
}

#[test]
fn the_other_phase_sign_is_conjugated_on_reading() {
    let cube = DataCube::read(&data("reference/cube_quadrature.npz"), LIMIT).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("conjugated.npz");
    let conjugated: Vec<_> = cube.samples.iter().map(num_complex::Complex::conj).collect();
    let positions: Vec<f64> = cube.instrument.array.positions().iter().flat_map(DVec3::to_array).collect();
    holosonar::files::npz::write_npz(&path, |npz| {
        npz.complex("samples", &[51, 143], &conjugated)?;
        npz.f64("frequencies", &[51], cube.instrument.sweep.frequencies())?;
        npz.f64("mic_positions", &[143, 3], &positions)?;
        npz.text("meta", r#"{"phase_sign": -1}"#)
    })
    .unwrap();
    assert_eq!(DataCube::read(&path, LIMIT).unwrap().samples, cube.samples);
}
