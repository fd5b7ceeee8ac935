//! Losses and microphone errors from run file to image, each compared with theory.

use crate::support::{relative_difference, unit_reflector};
use glam::DVec3;
use holosonar::acquisition::{
    ArrayErrors, DataCube, Instrument, Losses, MicArray, SimulateOptions, Sweep, simulate,
};
use holosonar::config::RunFile;
use holosonar::grid::{Axis, Grid};
use holosonar::pipeline::{JobOptions, forecast_scene, image_scene};
use holosonar::reconstruct::{Method, ReconstructOptions, Window, reconstruct};
use holosonar::wave::Geometry;
use std::path::Path;

fn grid() -> Grid {
    let axis = |first: f64, pitch: f64| Axis { first, pitch, count: 9 };
    Grid { x: axis(-0.032, 0.008), y: axis(-0.032, 0.008), z: axis(1.96, 0.01) }
}

/// 15 x 15 microphones see a unit reflector in the middle of the grid.
fn cube(geometry: Geometry, errors: Option<ArrayErrors>) -> DataCube {
    let array = MicArray::rectangular([15; 2], [0.016; 2], DVec3::new(0.1, 0.0, 0.0)).unwrap();
    let sweep = Sweep::stepped(10_000.0, 20_000.0, 50.0).unwrap();
    let one = unit_reflector(DVec3::new(0.0, 0.0, 2.0));
    let mut options = SimulateOptions::default().with_losses(Losses { spreading: true, ..Losses::NONE });
    options.errors = errors;
    let instrument = Instrument::new(sweep, array).with_geometry(geometry);
    simulate(&one, &instrument, &options).unwrap()
}

#[test]
fn every_method_and_geometry_compensates_spreading() {
    for geometry in [Geometry::ORIGIN, Geometry::Monostatic] {
        let cube = cube(geometry, None);
        let images = [Method::Direct, Method::Convolution, Method::Backprojection].map(|method| {
            let mut options = ReconstructOptions::new(method, Window::Taylor);
            let plain = reconstruct(&cube, &grid(), &options).unwrap();
            // Either leg is 2 m long.
            assert!((plain.volume.peak() - 0.25).abs() < 0.003, "{method:?}: {}", plain.volume.peak());
            options.compensate = true;
            let undone = reconstruct(&cube, &grid(), &options).unwrap();
            assert!((undone.volume.peak() - 1.0).abs() < 0.012, "{method:?}: {}", undone.volume.peak());
            assert!(undone.error_bound >= 3.9 * plain.error_bound);
            undone.volume
        });
        for image in &images[1..] {
            assert!(relative_difference(&image.samples, &images[0].samples) < 1e-3);
        }
    }
}

#[test]
fn phase_errors_reduce_the_peak_as_theory_says() {
    // The mean of e^{iφ} over Gaussian φ is e^{−σ²/2}.
    let errors = ArrayErrors { gain_db: 0.0, phase: 40.0, position: 0.0, seed: 5 };
    let options = ReconstructOptions::new(Method::Direct, Window::None);
    let peak = |errors| {
        let cube = cube(Geometry::ORIGIN, errors);
        reconstruct(&cube, &grid(), &options).unwrap().volume.plane(4)[4 * 9 + 4].norm()
    };
    let expected = (-0.5 * 40.0f32.to_radians().powi(2)).exp();
    let got = peak(Some(errors)) / peak(None);
    // 225 microphones average the errors to within a few percent.
    assert!((got - expected).abs() < 0.08, "{got} {expected}");
}

fn point(overrides: &[&str]) -> RunFile {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes/point.toml");
    let overrides: Vec<String> = overrides.iter().map(ToString::to_string).collect();
    RunFile::load(&path, &overrides).unwrap()
}

#[test]
fn a_run_file_enables_losses_and_the_report_lists_them() {
    let plain = image_scene(&point(&[]), &JobOptions::default()).unwrap();
    assert!(plain.physics.is_empty());
    let spread = image_scene(&point(&["medium.spreading=true"]), &JobOptions::default()).unwrap();
    let undone = ["medium.spreading=true", "reconstruct.compensate=true"];
    let undone = image_scene(&point(&undone), &JobOptions::default()).unwrap();
    let peaks = [plain, spread, undone].map(|outcome| outcome.image.volume.peak());
    // Nearer than 1 m spreading is a gain.
    let gain = 1.0 / DVec3::new(0.09, -0.06, 0.8).length_squared() as f32;
    assert!((peaks[1] / peaks[0] / gain - 1.0).abs() < 0.03, "{peaks:?}");
    assert!((peaks[2] / peaks[0] - 1.0).abs() < 0.03, "{peaks:?}");

    let all = point(&[
        "medium.temperature=20",
        "medium.absorption=true",
        "medium.spreading=true",
        "array.speaker_radius=0.012",
        "array.microphone_radius=0.003",
        "array.gain_error_db=0.5",
        "reconstruct.compensate=true",
    ]);
    let lines = forecast_scene(&all, &JobOptions::default()).unwrap().physics;
    for words in
        ["343.87 m/s", "spherical spreading", "ISO 9613-1", "12.0 mm", "3.0 mm", "0.5 dB", "spreading undone"]
    {
        assert!(lines.iter().any(|line| line.contains(words)), "{words}: {lines:?}");
    }
    let outcome = image_scene(&all, &JobOptions::default()).unwrap();
    assert_eq!(outcome.physics, lines);
    assert!((outcome.instrument.sound_speed - 343.87).abs() < 0.01);
}
