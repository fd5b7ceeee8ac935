//! Helpers for several topics: seeded random cubes and comparisons of volumes.

use glam::DVec3;
use holosonar::acquisition::{DataCube, Detection, Instrument, MicArray, Sweep};
use holosonar::grid::{Axis, Grid, Volume};
use holosonar::wave::Geometry;
use num_complex::Complex32;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};
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

/// A seeded source of numbers.
pub(crate) struct Random(ChaCha8Rng);

impl Random {
    pub(crate) fn new(seed: u64) -> Self {
        Self(ChaCha8Rng::seed_from_u64(seed))
    }

    /// Uniform in [low, high).
    pub(crate) fn uniform(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * (self.0.next_u64() >> 11) as f64 / (1u64 << 53) as f64
    }

    /// Uniform among low ..= high.
    pub(crate) fn whole(&mut self, low: usize, high: usize) -> usize {
        low + (self.0.next_u64() % (high - low + 1) as u64) as usize
    }

    pub(crate) fn complex(&mut self) -> Complex32 {
        Complex32::new(self.uniform(-1.0, 1.0) as f32, self.uniform(-1.0, 1.0) as f32)
    }
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

/// Maximum difference of two volumes over the maximum amplitude of the second.
pub(crate) fn relative_difference(a: &[Complex32], b: &[Complex32]) -> f64 {
    assert_eq!(a.len(), b.len());
    let difference = a.iter().zip(b).map(|(a, b)| (a - b).norm()).fold(0.0, f32::max);
    let peak = b.iter().map(|b| b.norm()).fold(0.0, f32::max);
    f64::from(difference / peak)
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
