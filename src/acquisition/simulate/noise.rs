//! What comes once all echoes of a cube are there: white Gaussian noise, and the converter.

use super::SimulateOptions;
use crate::acquisition::electronics::convert;
use crate::acquisition::{Detection, Instrument};
use crate::error::{Error, Result};
use num_complex::Complex32;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use rand_distr::{Distribution, StandardNormal};
use rayon::prelude::*;

/// Noise added to a simulated cube.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Noise {
    /// Mean `|m|²` over the cube against `E|n|²`, dB; n is complex in quadrature and real in phase.
    pub snr_db: f64,
    /// Seed of the noise alone.
    pub seed: u64,
}

/// Adds noise to the readings of an instrument, and converts them; those of coded loudspeakers while these sound at once.
///
/// # Errors
/// Noise that is no number; samples beyond single precision; a code that cannot be.
pub(super) fn finish(
    samples: &mut Vec<Complex32>,
    instrument: &Instrument,
    options: &SimulateOptions,
) -> Result<()> {
    // The noise of a reading does not depend on how many sound: it is that of one after another.
    let power: f64 = samples.iter().map(|m| f64::from(m.norm_sqr())).sum::<f64>() / samples.len() as f64;
    if let Some(code) = &options.code {
        *samples = code.encode(instrument, samples)?;
    }
    if let Some(noise) = options.noise {
        add_noise(samples, instrument.array.len(), (noise, power), instrument.detection)?;
    }
    if let Some(electronics) = &options.electronics {
        convert(electronics, samples);
    }
    if let Some(code) = &options.code {
        *samples = code.decode(instrument, samples)?;
    }
    if samples.par_iter().all(|m| m.norm_sqr().is_finite()) {
        return Ok(());
    }
    let problem =
        "come out beyond single precision; use smaller amplitudes, or less noise ([detection] snr_db)";
    Err(Error::input("simulated samples", problem))
}

/// Adds white Gaussian noise; every frequency has its own stream, so the number of threads does not matter.
fn add_noise(
    samples: &mut [Complex32],
    n_mic: usize,
    (noise, power): (Noise, f64),
    detection: Detection,
) -> Result<()> {
    if !noise.snr_db.is_finite() {
        return Err(Error::input("detection.snr_db", "must be a finite number of dB"));
    }
    let variance = power / 10f64.powf(noise.snr_db / 10.0);
    samples.par_chunks_mut(n_mic).enumerate().for_each(|(f, row)| {
        let mut random = ChaCha8Rng::seed_from_u64(noise.seed);
        random.set_stream(f as u64);
        let mut gauss = |variance: f64| {
            let g: f64 = StandardNormal.sample(&mut random);
            (g * variance.sqrt()) as f32
        };
        for m in row {
            *m += match detection {
                Detection::Quadrature => Complex32::new(gauss(variance / 2.0), gauss(variance / 2.0)),
                Detection::InPhase => Complex32::new(gauss(variance), 0.0),
            };
        }
    });
    Ok(())
}
