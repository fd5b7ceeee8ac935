//! Small instruments and cubes for tests.

#![allow(clippy::unwrap_used)]

use crate::acquisition::{DataCube, Detection, Instrument, MicArray, Sweep};
use crate::grid::Axis;
use glam::DVec3;
use num_complex::Complex32;

/// An axis of a grid, m.
pub(super) fn axis(first: f64, pitch: f64, count: usize) -> Axis {
    Axis { first, pitch, count }
}

/// Scattered numbers within ±½.
pub(super) fn random(i: usize, k: f64) -> f64 {
    (i as f64 * k).fract() - 0.5
}

/// Microphones on a lattice.
pub(super) fn lattice(count: [usize; 2]) -> MicArray {
    MicArray::rectangular(count, [0.03; 2], DVec3::new(0.01, -0.02, 0.0)).unwrap()
}

/// Microphones off every lattice and plane.
pub(super) fn scattered(count: usize) -> MicArray {
    let place = |i: usize| {
        DVec3::new(random(i, 0.618_033_99), random(i, 0.754_877_67), 0.1 * random(i, 0.569_840_29))
    };
    MicArray::from_positions((1..=count).map(|i| 0.3 * place(i)).collect()).unwrap()
}

/// Nine tones.
pub(super) fn instrument(array: MicArray) -> Instrument {
    Instrument::new(Sweep::stepped(8_000.0, 12_000.0, 500.0).unwrap(), array)
}

/// Samples as good as random, real ones of an in-phase instrument.
pub(super) fn cube(instrument: Instrument) -> DataCube {
    let count = instrument.transmissions() * instrument.sweep.len() * instrument.array.len();
    let real = instrument.detection == Detection::InPhase;
    let sample = |i: usize| {
        let m = [0.618_033_99, 0.754_877_67].map(|k| random(i + 1, k) as f32);
        Complex32::new(m[0], if real { 0.0 } else { m[1] })
    };
    DataCube::new(instrument, (0..count).map(sample).collect()).unwrap()
}
