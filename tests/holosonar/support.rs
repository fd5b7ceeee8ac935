//! Helpers for several topics: seeded random cubes and comparisons of volumes.

pub(crate) use crate::random::Random;
use glam::DVec3;
use holosonar::acquisition::{DataCube, Detection, Instrument, MicArray, Sweep};
use holosonar::grid::{Axis, Grid, Volume};
use holosonar::reconstruct::{Method, ReconstructOptions, Window, reconstruct};
use holosonar::reflectors::Reflectors;
use holosonar::wave::Geometry;
use num_complex::{Complex32, Complex64};
use std::f64::consts::TAU;
use std::io::Write;
use std::path::{Path, PathBuf};

/// A file of `tests/data`.
pub(crate) fn data(name: &str) -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("tests/data").join(name)
}

/// An array of an `.npz` file: its name, its type as NumPy writes it, its shape and its bytes.
pub(crate) type NpzArray<'a> = (&'a str, &'a str, &'a [usize], &'a [u8]);

/// Writes an `.npz` file of whatever arrays, as `numpy.savez` does.
pub(crate) fn write_npz(path: &Path, arrays: &[NpzArray<'_>]) {
    let mut zip = zip::ZipWriter::new(std::fs::File::create(path).unwrap());
    let stored = zip::write::SimpleFileOptions::default().compression_method(zip::CompressionMethod::Stored);
    for (name, descr, shape, bytes) in arrays {
        let lengths = shape.iter().map(|n| format!("{n},")).collect::<Vec<_>>().concat();
        let header = format!("{{'descr': '{descr}', 'fortran_order': False, 'shape': ({lengths}), }}\n");
        zip.start_file(format!("{name}.npy"), stored).unwrap();
        zip.write_all(b"\x93NUMPY\x01\x00").unwrap();
        zip.write_all(&(header.len() as u16).to_le_bytes()).unwrap();
        zip.write_all(header.as_bytes()).unwrap();
        zip.write_all(bytes).unwrap();
    }
    zip.finish().unwrap();
}

/// A folder with two reflectors before an array, `two.csv`.
pub(crate) fn folder_with_two_reflectors() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let text = "x,y,z,amplitude\n0.02,-0.02,0.8,1\n-0.08,0.05,1.0,0.4\n";
    std::fs::write(folder.path().join("two.csv"), text).unwrap();
    folder
}

/// Writes one reflector, `point.csv`, and a run file about it, `run.toml`.
pub(crate) fn write_point_run(folder: &Path, run: &str) {
    std::fs::write(folder.join("point.csv"), "x,y,z,amplitude\n0.02,0.0,0.9,1\n").unwrap();
    std::fs::write(folder.join("run.toml"), run).unwrap();
}

/// A small cube of a file.
pub(crate) fn read_cube(path: &Path) -> DataCube {
    DataCube::read(path, 1 << 24).unwrap()
}

/// A cube of random samples.
pub(crate) fn random_cube(
    random: &mut Random,
    sweep: Sweep,
    array: MicArray,
    geometry: Geometry,
    detection: Detection,
) -> DataCube {
    let samples = (0..sweep.len() * array.len())
        .map(|_| match detection {
            Detection::Quadrature => random.complex(),
            Detection::InPhase => Complex32::new(random.complex().re, 0.0),
        })
        .collect();
    let instrument = Instrument::new(sweep, array).with_geometry(geometry).with_detection(detection);
    DataCube::new(instrument, samples).unwrap()
}

/// A grid whose voxel pitch is the microphones' divided by `u`, anywhere beside and before the array.
pub(crate) fn lattice_grid(random: &mut Random, array: &MicArray, u: [usize; 2], count: [usize; 3]) -> Grid {
    let lattice = array.lattice().unwrap();
    let mut axis = |mics: &Axis, u: usize, count: usize| Axis {
        first: mics.first + random.uniform(-3.0, 3.0) * mics.pitch,
        pitch: mics.pitch / u as f64,
        count,
    };
    Grid {
        x: axis(&lattice.x, u[0], count[0]),
        y: axis(&lattice.y, u[1], count[1]),
        z: Axis { first: random.uniform(0.3, 0.8), pitch: 0.013, count: count[2] },
    }
}

/// A reflector of amplitude 1.
pub(crate) fn unit_reflector(p: DVec3) -> Reflectors {
    Reflectors::new(vec![p], vec![Complex32::ONE]).unwrap()
}

/// Position of sample `voxel` of a volume, m.
pub(crate) fn position_of(grid: &Grid, voxel: usize) -> DVec3 {
    let (row, ix) = (voxel / grid.x.count, voxel % grid.x.count);
    grid.position(ix, row % grid.y.count, row / grid.y.count)
}

/// `Σ_f Σ_r w_f w_r m e^{−i2πf·path/c}` for some voxels, term by term in f64, without blocks, lanes and buffers.
pub(crate) fn literal(
    cube: &DataCube,
    grid: &Grid,
    window: Window,
    path_length: impl Fn(&Geometry, DVec3, DVec3) -> f64,
    voxels: impl Iterator<Item = usize>,
) -> Vec<Complex32> {
    let instrument = &cube.instrument;
    let (w_f, w_r) = (window.over_sweep(&instrument.sweep), window.over_array(&instrument.array));
    let scale = instrument.detection.weight() / (w_f.iter().sum::<f64>() * w_r.iter().sum::<f64>());
    let image = |v: usize| {
        let p = position_of(grid, v);
        let mut sum = Complex64::ZERO;
        for (j, r) in instrument.array.positions().iter().enumerate() {
            let delay = path_length(&instrument.geometry, p, *r) / instrument.sound_speed;
            for (q, f) in instrument.sweep.frequencies().iter().enumerate() {
                let m = cube.samples[q * instrument.array.len() + j];
                let m = Complex64::new(m.re.into(), m.im.into());
                sum += m * Complex64::cis(-TAU * f * delay) * (w_f[q] * w_r[j] * scale);
            }
        }
        Complex32::new(sum.re as f32, sum.im as f32)
    };
    voxels.map(image).collect()
}

/// The image by direct summation.
pub(crate) fn direct(cube: &DataCube, grid: &Grid, window: Window) -> Vec<Complex32> {
    reconstruct(cube, grid, &ReconstructOptions::new(Method::Direct, window)).unwrap().volume.samples
}

/// Asserts for each tolerance that the maximum difference from the direct sum is within the bound that comes with the
/// volume, except for f32 rounding, and that the bound is within the tolerance.
pub(crate) fn assert_within_bounds(
    seed: u64,
    cube: &DataCube,
    grid: &Grid,
    options: &ReconstructOptions,
    tolerances: &[f64],
) {
    let exact = direct(cube, grid, options.window);
    let peak = peak(&exact);
    let moduli: f64 = cube.samples.iter().map(|m| f64::from(m.norm())).sum();
    for &tolerance in tolerances {
        let image = reconstruct(cube, grid, &options.with_tolerance(tolerance)).unwrap();
        assert_eq!(image.method, options.method);
        let error = relative_difference(&image.volume.samples, &exact) * peak;
        let (bound, what) = (image.error_bound, format!("seed {seed} {:?} {tolerance}", grid.shape()));
        assert!(bound.is_finite() && error <= bound + 1e-5 * peak, "{what}: {error:e} above {bound:e}");
        let most = tolerance * cube.instrument.detection.weight() * moduli / cube.samples.len() as f64;
        assert!(options.window != Window::None || bound <= most * 1.01, "{what}: {bound:e} above {most:e}");
    }
}

/// Maximum amplitude.
pub(crate) fn peak(samples: &[Complex32]) -> f64 {
    f64::from(samples.iter().map(|sample| sample.norm()).fold(0.0, f32::max))
}

/// Maximum difference of two volumes over the maximum amplitude of the second.
pub(crate) fn relative_difference(a: &[Complex32], b: &[Complex32]) -> f64 {
    assert_eq!(a.len(), b.len());
    let difference: Vec<Complex32> = a.iter().zip(b).map(|(a, b)| a - b).collect();
    peak(&difference) / peak(b)
}

/// The voxel of maximum amplitude, as (ix, iy, iz).
pub(crate) fn brightest(volume: &Volume) -> (usize, usize, usize) {
    let best = (0..volume.samples.len())
        .max_by(|a, b| volume.samples[*a].norm_sqr().total_cmp(&volume.samples[*b].norm_sqr()))
        .unwrap();
    let (n_x, plane) = (volume.grid.x.count, volume.grid.plane_len());
    (best % n_x, best % plane / n_x, best / plane)
}

/// A point a little off every lattice.
pub(crate) fn off_lattice() -> DVec3 {
    DVec3::new(0.0437, -0.0291, 1.0173)
}
