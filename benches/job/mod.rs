//! Jobs for several benches.

#![allow(dead_code, reason = "no bench uses all of it")]

use glam::DVec3;
use holosonar::acquisition::{DataCube, Instrument, MicArray, Sweep};
use holosonar::config::RunFile;
use holosonar::grid::{Axis, Grid};
use num_complex::Complex32;
use std::f32::consts::TAU;
use std::path::Path;

/// `mics`² microphones and `voxels`² voxels, 8 mm apart and with a common centre, from 1 m; 10 to 20 kHz.
pub(crate) fn job(mics: usize, voxels: usize, frequencies: usize, depths: usize) -> (DataCube, Grid) {
    let array = MicArray::rectangular([mics; 2], [0.008; 2], DVec3::ZERO).expect("an array");
    let step = 10_000.0 / (frequencies - 1) as f64;
    let sweep = Sweep::stepped(10_000.0, 20_000.0, step).expect("a sweep");
    let lateral = Axis { first: -0.004 * (voxels - 1) as f64, pitch: 0.008, count: voxels };
    let grid = Grid { x: lateral, y: lateral, z: Axis { first: 1.0, pitch: 0.008, count: depths } };
    (noise(sweep, array), grid)
}

/// A cube of unrelated phasors.
pub(crate) fn noise(sweep: Sweep, array: MicArray) -> DataCube {
    let phasor = |i: usize| Complex32::cis(TAU * (i as f64 * 0.618_034).fract() as f32);
    let samples = (0..sweep.len() * array.len()).map(phasor).collect();
    DataCube::new(Instrument::new(sweep, array), samples).expect("finite")
}

/// The i-th quasi-random number in ±½ of a sequence.
pub(crate) fn fraction(i: usize, sequence: f64) -> f64 {
    (i as f64 * sequence).fract() - 0.5
}

/// The i-th quasi-random point in a cube of side 1 around the origin.
pub(crate) fn scattered(i: usize) -> DVec3 {
    DVec3::new(fraction(i, 0.618_034), fraction(i, 0.754_878), fraction(i, 0.569_84))
}

/// The same cube from microphones up to 2 mm off their lattice, and within `depth` m of their plane.
pub(crate) fn displaced(cube: &DataCube, depth: f64) -> DataCube {
    let size = DVec3::new(0.004, 0.004, 2.0 * depth);
    let place = |(i, r): (usize, &DVec3)| *r + size * scattered(i);
    let positions: Vec<DVec3> = cube.instrument.array.positions().iter().enumerate().map(place).collect();
    let array = MicArray::from_positions(positions).expect("an array");
    DataCube::new(cube.instrument.clone().with_array(array), cube.samples.clone()).expect("finite")
}

/// A run file in `folder`: the corner in front of 255 x 255 microphones, as 256 x 256 x 128 voxels; microphones and voxels
/// are 3.94 mm apart along x and y.
pub(crate) fn large(folder: &Path) -> RunFile {
    let mesh = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes/meshes/corner.obj");
    std::fs::copy(mesh, folder.join("corner.obj")).expect("the repository's mesh");
    let text = "[scene]\nmesh = \"corner.obj\"\nunit = \"m\"\nup = \"none\"\n[sweep]\nstart = 10000.0\nstop = 20000.0\nstep = 10.0\n\
                [array]\ncount = [255, 255]\npitch = [0.00394, 0.00394]\n\
                [grid]\nx = [-0.50235, 0.50235]\ny = [-0.50235, 0.50235]\nz = [1.0, 2.0]\ncount = [256, 256, 128]\n";
    let path = folder.join("large.toml");
    std::fs::write(&path, text).expect("a folder that can be written");
    RunFile::load(&path, &[]).expect("a run file")
}
