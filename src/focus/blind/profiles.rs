//! Range profiles: what one microphone has of an echo, by the length of its path.

use crate::acquisition::DataCube;
use num_complex::{Complex32, Complex64};
use rayon::prelude::*;
use std::f64::consts::TAU;

/// Values of a profile for each c/B of path: between two, a straight line errs by 0.5 % at the band's edges.
const PER_CELL: f64 = 16.0;

/// Profiles of all microphones, of several loudspeakers one after another, `Σ_f m e^{−i2π(f − f_c)·path/c}`.
#[derive(Debug, Clone)]
pub(super) struct Profiles {
    values: Vec<Complex32>,
    /// Values of each.
    count: usize,
    /// Path of the first, and from one to the next, m.
    first: f64,
    pitch: f64,
    /// f_c/c, cycles per m.
    wavenumber: f64,
}

impl Profiles {
    /// Between two paths, m. Cost: a few operations for each sample and value.
    pub(super) fn new(cube: &DataCube, [shortest, longest]: [f64; 2]) -> Self {
        let instrument = &cube.instrument;
        let (n_mic, c, f) = (instrument.array.len(), instrument.sound_speed, instrument.sweep.frequencies());
        let centre = instrument.sweep.centre();
        let pitch = c / instrument.sweep.bandwidth().max(0.05 * centre) / PER_CELL;
        let count = ((longest - shortest) / pitch).ceil() as usize + 2;
        let of_path = |tone: f64, k: usize| {
            let turns = (tone - centre) * (shortest + k as f64 * pitch) / c;
            Complex64::cis(-TAU * (turns - turns.round()))
        };
        let profile = |(tx, r): (usize, usize)| {
            let mut sums = vec![Complex64::ZERO; count];
            for (i, tone) in f.iter().enumerate() {
                let m = cube.samples[(tx * f.len() + i) * n_mic + r];
                let (mut term, step) =
                    (of_path(*tone, 0), Complex64::cis(-TAU * (tone - centre) * pitch / c));
                term *= Complex64::new(m.re.into(), m.im.into());
                for sum in &mut sums {
                    *sum += term;
                    term *= step;
                }
            }
            sums.into_iter().map(|sum| Complex32::new(sum.re as f32, sum.im as f32)).collect::<Vec<_>>()
        };
        let columns = (0..instrument.transmissions()).flat_map(|tx| (0..n_mic).map(move |r| (tx, r)));
        let columns: Vec<(usize, usize)> = columns.collect();
        let values: Vec<Vec<Complex32>> = columns.into_par_iter().map(profile).collect();
        Self { values: values.concat(), count, first: shortest, pitch, wavenumber: centre / c }
    }

    /// `Σ_f m(f, r) e^{−i2πf·path/c}`, of loudspeaker `tx` for microphone `tx · n_mic + r`; 0 outside of the paths.
    pub(super) fn at(&self, microphone: usize, path: f64) -> Complex32 {
        let place = (path - self.first) / self.pitch;
        let k = place as usize;
        if place < 0.0 || k + 1 >= self.count {
            return Complex32::ZERO;
        }
        let two = &self.values[microphone * self.count + k..][..2];
        let value = two[0] + (two[1] - two[0]) * (place - k as f64) as f32;
        let turns = self.wavenumber * path;
        value * Complex32::cis((-TAU * (turns - turns.round())) as f32)
    }
}
