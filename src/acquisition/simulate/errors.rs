//! Imperfect microphones: errors of their gains, phases and positions.

use crate::acquisition::MicArray;
use crate::error::{Error, Result};
use glam::DVec3;
use num_complex::Complex32;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use rand_distr::{Distribution, StandardNormal};

/// Gaussian errors of the microphones, the same at every frequency.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ArrayErrors {
    /// Gain error, dB rms.
    pub gain_db: f64,
    /// Phase error, degrees rms.
    pub phase: f64,
    /// Position error, m rms along each axis: the simulation uses the actual positions, the cube contains the nominal ones.
    pub position: f64,
    /// Seed of these errors alone.
    pub seed: u64,
}

/// Streams of the seed, one per kind of error, so that changing one does not affect the others.
const GAIN_STREAM: u64 = 0;
const PHASE_STREAM: u64 = 1;
const POSITION_STREAM: u64 = 2;

impl ArrayErrors {
    fn random(&self, stream: u64) -> ChaCha8Rng {
        let mut random = ChaCha8Rng::seed_from_u64(self.seed);
        random.set_stream(stream);
        random
    }

    /// Rejects values that are not an rms.
    pub(super) fn check(&self) -> Result<()> {
        for (key, rms) in [
            ("array.gain_error_db", self.gain_db),
            ("array.phase_error", self.phase),
            ("array.position_error", self.position),
        ] {
            if !(rms >= 0.0 && rms.is_finite()) {
                return Err(Error::input(key, format!("must be an rms value of 0 or more, not {rms}")));
            }
        }
        Ok(())
    }

    /// Complex gain of each microphone; empty without errors of gain or phase.
    pub(super) fn responses(&self, count: usize) -> Vec<Complex32> {
        if self.gain_db == 0.0 && self.phase == 0.0 {
            return Vec::new();
        }
        let (mut gains, mut phases) = (self.random(GAIN_STREAM), self.random(PHASE_STREAM));
        let mut draw = || -> Complex32 {
            let gain: f64 = StandardNormal.sample(&mut gains);
            let phase: f64 = StandardNormal.sample(&mut phases);
            let gain = 10f64.powf(self.gain_db * gain / 20.0);
            let (sin, cos) = (self.phase * phase).to_radians().sin_cos();
            Complex32::new((gain * cos) as f32, (gain * sin) as f32)
        };
        (0..count).map(|_| draw()).collect()
    }

    /// The actual positions of the microphones.
    pub(super) fn displaced(&self, array: &MicArray) -> Result<MicArray> {
        if self.position == 0.0 {
            return Ok(array.clone());
        }
        let mut random = self.random(POSITION_STREAM);
        let mut gauss = || -> f64 { StandardNormal.sample(&mut random) };
        let positions: Vec<DVec3> = array
            .positions()
            .iter()
            .map(|&r| r + self.position * DVec3::new(gauss(), gauss(), gauss()))
            .collect();
        let displaced = match array.lattice() {
            Some(lattice) => MicArray::from_rows([lattice.y.count, lattice.x.count], positions),
            None => MicArray::from_positions(positions),
        };
        displaced.map_err(|error| error.at("array.position_error"))
    }
}
