//! One reflector: it peaks where it is, at 1, as wide as theory says.

use crate::support::{brightest, off_lattice, relative_difference, unit_reflector};
use glam::DVec3;
use holosonar::acquisition::{DataCube, Detection, Instrument, MicArray, SimulateOptions, Sweep, simulate};
use holosonar::grid::{Axis, Grid, Volume};
use holosonar::reconstruct::{Method, ReconstructOptions, Window, reconstruct};

const SOUND_SPEED: f64 = 343.0;

/// `count`² microphones over `extent` m and 10–20 kHz see a unit reflector at p.
fn measure(p: DVec3, count: usize, extent: f64, detection: Detection) -> DataCube {
    let pitch = extent / (count - 1) as f64;
    let array = MicArray::rectangular([count; 2], [pitch; 2], DVec3::ZERO).unwrap();
    let sweep = Sweep::stepped(10_000.0, 20_000.0, 50.0).unwrap();
    let instrument = Instrument::new(sweep, array).with_detection(detection);
    simulate(&unit_reflector(p), &instrument, &SimulateOptions::default()).unwrap()
}

/// Voxels of the given pitches about `centre`, `reach` of them to every side.
fn around(centre: DVec3, pitch: [f64; 3], reach: [usize; 3]) -> Grid {
    let axis = |centre: f64, pitch: f64, reach: usize| Axis {
        first: centre - pitch * reach as f64,
        pitch,
        count: 2 * reach + 1,
    };
    Grid {
        x: axis(centre.x, pitch[0], reach[0]),
        y: axis(centre.y, pitch[1], reach[1]),
        z: axis(centre.z, pitch[2], reach[2]),
    }
}

fn image(cube: &DataCube, grid: &Grid, method: Method, window: Window) -> Volume {
    reconstruct(cube, grid, &ReconstructOptions::new(method, window)).unwrap().volume
}

#[test]
fn a_reflector_on_a_voxel_peaks_there_at_one() {
    let p = DVec3::new(0.032, -0.048, 0.8);
    for detection in [Detection::Quadrature, Detection::InPhase] {
        let cube = measure(p, 15, 14.0 * 0.016, detection);
        let grid = around(p, [0.008, 0.008, 0.01], [6, 5, 4]);
        for method in [Method::Convolution, Method::Direct] {
            for window in [Window::None, Window::Hann, Window::Taylor] {
                let volume = image(&cube, &grid, method, window);
                assert_eq!(brightest(&volume), (6, 5, 4), "{method:?} {window:?} {detection:?}");
                assert!((volume.peak() - 1.0).abs() < 0.01, "{method:?} {window:?}: {}", volume.peak());
            }
        }
    }
}

#[test]
fn a_reflector_between_voxels_peaks_within_half_a_voxel() {
    let p = off_lattice();
    let cube = measure(p, 15, 14.0 * 0.032, Detection::Quadrature);
    let grid = around(DVec3::new(0.048, -0.032, 1.02), [0.016, 0.016, 0.008], [5, 4, 4]);
    let volume = image(&cube, &grid, Method::Convolution, Window::None);
    let (ix, iy, iz) = brightest(&volume);
    let off = grid.position(ix, iy, iz) - p;
    assert!(off.x.abs() <= 0.008 && off.y.abs() <= 0.008 && off.z.abs() <= 0.004, "{off}");
    let direct = image(&cube, &grid, Method::Direct, Window::None);
    assert!(relative_difference(&volume.samples, &direct.samples) < 1e-4);
}

/// Full width at −3 dB of a line of samples `pitch` m apart through its peak, interpolated linearly.
fn width(line: &[f32], pitch: f64) -> f64 {
    let peak = (0..line.len()).max_by(|a, b| line[*a].total_cmp(&line[*b])).unwrap();
    let half = line[peak] * std::f32::consts::FRAC_1_SQRT_2;
    let crossing = |mut i: usize, step: isize| {
        loop {
            let next = (i as isize + step) as usize;
            if line[next] < half {
                return i as f64 + step as f64 * f64::from((line[i] - half) / (line[i] - line[next]));
            }
            i = next;
        }
    };
    (crossing(peak, 1) - crossing(peak, -1)) * pitch
}

#[test]
fn widths_are_those_of_theory() {
    let wavelength = SOUND_SPEED / 15_000.0;
    for (p, count, extent) in [
        (DVec3::new(0.0, 0.0, 1.2), 31, 1.0),
        (DVec3::new(0.12, -0.1, 1.2), 31, 1.0),
        (DVec3::new(0.1, 0.05, 1.0), 31, 0.5),
    ] {
        let cube = measure(p, count, extent, Detection::Quadrature);
        let lateral = wavelength * p.z / extent;
        let line = |axis: usize, pitch: f64| {
            let mut reach = [0; 3];
            reach[axis] = 60;
            let volume = image(&cube, &around(p, [pitch; 3], reach), Method::Direct, Window::None);
            let amplitudes: Vec<f32> = volume.samples.iter().map(|a| a.norm()).collect();
            width(&amplitudes, pitch)
        };
        for axis in 0..2 {
            let ratio = line(axis, lateral / 40.0) / (0.886 * lateral);
            assert!((ratio - 1.0).abs() < 0.12, "{p} {count} axis {axis}: {ratio}");
        }
        let cell = SOUND_SPEED / (2.0 * 10_000.0);
        let ratio = line(2, cell / 40.0) / (0.886 * cell);
        assert!((ratio - 1.0).abs() < 0.12, "{p} {count} depth: {ratio}");
    }
}
