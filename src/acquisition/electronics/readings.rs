//! The readings of a cube: the responses of the echoes put together, tone by tone, with jitter, the filter's memory and the
//! converter.
//!
//! They are put together once the responses are complete, so that blocks of them that are stored or computed elsewhere are
//! those of the echoes alone.

use super::chain::ToneReading;
use super::{Electronics, QuadratureBy};
use crate::acquisition::{DataCube, Detection, Instrument};
use crate::error::Result;
use num_complex::{Complex32, Complex64};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use rand_distr::{Distribution, StandardNormal};
use rayon::prelude::*;
use std::f64::consts::TAU;

/// Simulates the echoes before an instrument; its number says which of the simulations it is.
pub(in crate::acquisition) type SimulateEchoes<'a> =
    dyn FnMut(usize, &Instrument) -> Result<Vec<Complex32>> + 'a;

impl Electronics {
    /// The instruments of the simulations.
    ///
    /// # Errors
    /// A clock with which the frequencies do not ascend.
    pub(in crate::acquisition) fn instruments(&self, instrument: &Instrument) -> Result<Vec<Instrument>> {
        Ok(self.responses(instrument)?.iter().map(|response| response.instrument(instrument)).collect())
    }

    /// The readings of an instrument, `[n_tx, n_f, n_mic]`, before noise and converter.
    ///
    /// # Errors
    /// Those of `simulate`; no memory.
    pub(in crate::acquisition) fn read_echoes(
        &self,
        instrument: &Instrument,
        simulate: &mut SimulateEchoes,
    ) -> Result<Vec<Complex32>> {
        let (n_f, n_mic, n_tx) = (instrument.sweep.len(), instrument.array.len(), instrument.transmissions());
        let mut samples = DataCube::allocate([n_tx, n_f, n_mic])?;
        for (number, response) in self.responses(instrument)?.iter().enumerate() {
            let echoes = simulate(number, &response.instrument(instrument))?;
            for (pass, readings) in &response.readings {
                samples.par_chunks_mut(n_mic).enumerate().for_each(|(row, samples)| {
                    let n = row % n_f;
                    let own = (&echoes[row * n_mic..][..n_mic], response.sweep.frequencies()[n]);
                    let before = n
                        .checked_sub(1)
                        .map(|n| (&echoes[(row - 1) * n_mic..][..n_mic], response.sweep.frequencies()[n]));
                    self.add(samples, &readings[n], [Some(own), before], (row as u64, *pass));
                });
            }
        }
        let memory = self.memory() as f32;
        if memory > 0.0 {
            for samples in samples.chunks_exact_mut(n_f * n_mic) {
                for row in 1..n_f {
                    let (before, own) = samples[(row - 1) * n_mic..(row + 1) * n_mic].split_at_mut(n_mic);
                    own.iter_mut().zip(before).for_each(|(m, last)| *m += *last * memory);
                }
            }
        }
        if instrument.detection == Detection::InPhase {
            samples.par_iter_mut().for_each(|m| m.im = 0.0);
        }
        Ok(samples)
    }

    /// Adds what is read of the echoes at a tone and the one before; each comes with its frequency, Hz. Every row has random
    /// numbers of its own.
    fn add(
        &self,
        samples: &mut [Complex32],
        reading: &ToneReading,
        [own, before]: [Option<(&[Complex32], f64)>; 2],
        (row, pass): (u64, usize),
    ) {
        let mut random = ChaCha8Rng::seed_from_u64(self.seed);
        random.set_stream(row);
        let draws = if self.quadrature == QuadratureBy::Passes { 2 } else { 1 };
        for (mic, sample) in samples.iter_mut().enumerate() {
            let mut late = 0.0;
            if self.jitter > 0.0 {
                for draw in 0..draws {
                    let number: f64 = StandardNormal.sample(&mut random);
                    if draw == pass {
                        late = self.jitter * number;
                    }
                }
            }
            let mut read = |echoes: Option<(&[Complex32], f64)>, [alpha, beta]: [Complex64; 2]| {
                let Some((echoes, frequency)) = echoes else { return };
                let mut m = Complex64::new(echoes[mic].re.into(), echoes[mic].im.into());
                if late != 0.0 {
                    m *= Complex64::cis(TAU * frequency * late);
                }
                let sum = alpha * m + beta * m.conj();
                *sample += Complex32::new(sum.re as f32, sum.im as f32);
            };
            read(own, reading.own);
            if reading.before != [Complex64::ZERO; 2] {
                read(before, reading.before);
            }
        }
    }
}

/// A converter of b bits and full scale A: values become multiples of `2A/2^b`, from −A to A less one.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(in crate::acquisition) struct Converter {
    bits: Option<u32>,
    full: f64,
}

impl Converter {
    /// That of some electronics, with full scale `full` where they do not say it; `None` where nothing is converted.
    pub(in crate::acquisition) fn of(electronics: &Electronics, full: impl FnOnce() -> f64) -> Option<Self> {
        let Electronics { adc_bits, adc_full_scale, .. } = *electronics;
        let converts = adc_bits.is_some() || adc_full_scale.is_some();
        let converter = converts.then(|| Self { bits: adc_bits, full: adc_full_scale.unwrap_or_else(full) });
        converter.filter(|converter| converter.full > 0.0)
    }

    /// The same for values that are `gain` times as large.
    pub(in crate::acquisition) fn times(self, gain: f64) -> Self {
        Self { full: self.full * gain, ..self }
    }

    /// A value as it is read.
    pub(in crate::acquisition) fn convert(self, value: f64) -> f64 {
        let Self { bits, full } = self;
        let Some(bits) = bits else { return value.clamp(-full, full) };
        let half = 2_f64.powi(bits as i32 - 1);
        (value / full * half).round().clamp(-half, half - 1.0) / half * full
    }
}

/// Rounds readings as a converter does that the largest of them fills, if its full scale is not said.
pub(in crate::acquisition) fn convert(electronics: &Electronics, samples: &mut [Complex32]) {
    let largest = || samples.iter().map(|m| m.re.abs().max(m.im.abs())).fold(0.0, f32::max);
    let Some(converter) = Converter::of(electronics, || largest().into()) else { return };
    let convert = |value: f32| converter.convert(value.into()) as f32;
    samples.par_iter_mut().for_each(|m| *m = Complex32::new(convert(m.re), convert(m.im)));
}
