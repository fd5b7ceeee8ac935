//! Against independent brute-force answers (NumPy, float64) in `tests/data/reference`, which `tests/reference/generate.py`
//! writes and `.ci/run` generates again and compares.

use crate::support::{data, relative_difference, write_npz};
use glam::DVec3;
use holosonar::acquisition::{DataCube, PropagationModel, SimulateOptions, simulate};
use holosonar::export::volume_npz::read_volume_npz;
use holosonar::reconstruct::{Method, ReconstructOptions, Window, reconstruct};
use holosonar::reflectors::Reflectors;

const LIMIT: u64 = 1 << 30;

fn forward(name: &str, model: PropagationModel) {
    let expected = DataCube::read(&data(&format!("reference/{name}.npz")), LIMIT).unwrap();
    let reflectors = Reflectors::read_csv(&data("reference/reflectors.csv")).unwrap();
    let options = SimulateOptions::default().with_model(model);
    let cube = simulate(&reflectors, &expected.instrument, &options).unwrap();
    let error = relative_difference(&cube.samples, &expected.samples);
    assert!(error < 1e-4, "{name}: {error:e} of the maximum");
}

#[test]
fn cubes_of_every_model() {
    for name in ["forward_quadrature", "forward_in_phase", "forward_monostatic_quadrature"] {
        forward(name, PropagationModel::Exact);
    }
    forward("forward_linear_in_phase", PropagationModel::Linear);
}

fn inverse(detection: &str, pitch: &str) {
    let cube = DataCube::read(&data(&format!("reference/cube_{detection}.npz")), LIMIT).unwrap();
    let file = data(&format!("reference/volume_{detection}_{pitch}.npz"));
    let expected = read_volume_npz(&file, LIMIT).unwrap().0;
    for (method, tolerance) in [
        (Method::Direct, 0.0),
        (Method::Convolution, 0.0),
        (Method::Backprojection, 1e-5),
        (Method::Auto, 1e-5),
    ] {
        let options = ReconstructOptions::new(method, Window::None).with_tolerance(tolerance);
        let got = reconstruct(&cube, &expected.grid, &options).unwrap();
        assert!(got.method == method || got.method == Method::Convolution && method == Method::Auto);
        let error = relative_difference(&got.volume.samples, &expected.samples);
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
fn a_cube_file_survives_reading_and_writing_bit_for_bit() {
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
    let meta = br#"{"phase_sign": -1}"#;
    write_npz(
        &path,
        &[
            ("samples", "<c8", &[51, 143], bytemuck::cast_slice(&conjugated)),
            ("frequencies", "<f8", &[51], bytemuck::cast_slice(cube.instrument.sweep.frequencies())),
            ("mic_positions", "<f8", &[143, 3], bytemuck::cast_slice(&positions)),
            ("meta", "|u1", &[meta.len()], meta),
        ],
    );
    assert_eq!(DataCube::read(&path, LIMIT).unwrap().samples, cube.samples);
}
