//! Parameters and errors found, and not found, on small cubes whose truth is known.
#![allow(clippy::unwrap_used)]

mod blind;
mod search;

use crate::acquisition::{DataCube, Instrument, MicArray, Sweep};
use crate::grid::{Axis, Grid};
use crate::wave::phasor;
use glam::DVec3;
use num_complex::Complex32;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use rand_distr::{Distribution, StandardNormal};

/// 11 x 11 microphones on a square, 10 to 14 kHz.
fn instrument(extent: f64) -> Instrument {
    let array = MicArray::rectangular([11, 11], [extent / 10.0; 2], DVec3::ZERO).unwrap();
    Instrument::new(Sweep::stepped(10e3, 14e3, 100.0).unwrap(), array)
}

/// Normal deviates of a seed.
fn normal(seed: u64) -> impl FnMut() -> f64 {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    move || StandardNormal.sample(&mut random)
}

/// Echoes of amplitude 1, by Eq. 5 as written, for microphones at `places` that the instrument may not know.
fn echoes_at(instrument: &Instrument, places: &[DVec3], points: &[DVec3]) -> DataCube {
    let sweeps = (0..instrument.transmissions()).flat_map(|tx| {
        let one = instrument.transmission(tx);
        instrument.sweep.frequencies().iter().map(move |f| (one.geometry, f))
    });
    let samples = sweeps.flat_map(|(geometry, f)| {
        places.iter().map(move |r| {
            let path = |p: &DVec3| geometry.path_length(*p, *r) / instrument.sound_speed;
            points.iter().map(|p| phasor(f * path(p))).sum::<Complex32>()
        })
    });
    DataCube::new(instrument.clone(), samples.collect()).unwrap()
}

fn echoes(instrument: &Instrument, points: &[DVec3]) -> DataCube {
    echoes_at(instrument, instrument.array.positions(), points)
}

/// Noise of independent samples, of this rms.
fn noise(instrument: &Instrument, rms: f64, seed: u64) -> Vec<Complex32> {
    let mut normal = normal(seed);
    let mut part = || (rms * 0.5_f64.sqrt() * normal()) as f32;
    let count = instrument.transmissions() * instrument.sweep.len() * instrument.array.len();
    (0..count).map(|_| Complex32::new(part(), part())).collect()
}

/// Points that are spread over the region.
fn points(count: usize) -> Vec<DVec3> {
    let part = |i: usize, ratio: f64| (i as f64 * ratio).fract() - 0.5;
    let point =
        |i| DVec3::new(0.4 * part(i, 0.618_034), 0.4 * part(i, 0.754_878), 1.1 + 0.3 * part(i, 0.569_840));
    (1..=count).map(point).collect()
}

/// Voxels of half a cell about the points.
fn region() -> Grid {
    let lateral = Axis::spanning(-0.24, 0.24, 0.015).unwrap();
    Grid { x: lateral, y: lateral, z: Axis::spanning(0.9, 1.3, 0.02).unwrap() }
}
