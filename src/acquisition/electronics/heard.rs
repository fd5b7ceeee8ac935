//! What the microphones hear of each tone: the instrument up to the mixer, by the same clock, amplifier, room and microphone.
//!
//! With the gain `c_j H(jf)` of each harmonic and the response M of Eq. 5 the signal of a tone is `Σ_j Im X_j e^{ijωt}`,
//! `X_j = c_j H(jf) M*(jf)` ([`chain`](super::chain)). A mixer reads it in closed form; a recorder samples it.

use super::readings::SimulateEchoes;
use super::{Electronics, Mixer, OutputFilter, QuadratureBy};
use crate::acquisition::simulate::simulate_moving;
use crate::acquisition::{DataCube, Instrument, SimulateOptions};
use crate::blocks::BlockStore;
use crate::error::{Error, Result};
use crate::progress::Observer;
use crate::reflectors::Reflectors;
use num_complex::{Complex32, Complex64};
use rayon::prelude::*;
use std::borrow::Cow;

/// A harmonic of the tones as the microphones hear it.
#[derive(Debug)]
pub(in crate::acquisition) struct HeardHarmonic<'a> {
    /// What sounds, tone by tone, Hz.
    pub(in crate::acquisition) frequencies: Vec<f64>,
    /// `X_j*`, as of a cube: `[n_f, n_mic]`.
    pub(in crate::acquisition) samples: Cow<'a, [Complex32]>,
}

/// The tones as the microphones hear them, once the room is as loud as it gets.
#[derive(Debug)]
pub(crate) struct HeardTones<'a> {
    pub(in crate::acquisition) instrument: Instrument,
    /// The fundamental first.
    pub(in crate::acquisition) harmonics: Vec<HeardHarmonic<'a>>,
}

/// The shares of a tone and of the one before it, `since` s after a step, in a room that follows with the time constant `decay`.
pub(in crate::acquisition) fn settled(decay: f64, since: f64) -> [f64; 2] {
    let left = if decay > 0.0 { (-since / decay).exp() } else { 0.0 };
    [1.0 - left, left]
}

impl Electronics {
    /// What the microphones hear of all harmonics below `limit` Hz; others are kept from a converter.
    ///
    /// # Errors
    /// Those of `simulate`; a clock with which the frequencies do not ascend.
    fn hear(
        &self,
        instrument: &Instrument,
        limit: f64,
        simulate: &mut SimulateEchoes,
    ) -> Result<HeardTones<'static>> {
        let tones = self.sweep(instrument, 0, 1)?;
        let (n_mic, mut harmonics) = (instrument.array.len(), Vec::new());
        for harmonic in 1..self.harmonics_db.len() + 2 {
            let sweep = self.sweep(instrument, 0, harmonic)?;
            if harmonic > 1 && sweep.stop() >= limit {
                break;
            }
            let mut samples = simulate(harmonic - 1, &instrument.clone().with_sweep(sweep.clone()))?;
            samples.par_chunks_mut(n_mic).zip(tones.frequencies()).for_each(|(row, tone)| {
                let gain = self.heard(harmonic, *tone).conj();
                for m in row {
                    let heard = gain * Complex64::new(m.re.into(), m.im.into());
                    *m = Complex32::new(heard.re as f32, heard.im as f32);
                }
            });
            harmonics
                .push(HeardHarmonic { frequencies: sweep.frequencies().to_vec(), samples: samples.into() });
        }
        Ok(HeardTones { instrument: instrument.clone(), harmonics })
    }

    /// Refuses what is behind the microphones' converter, of which a recording has nothing.
    pub(crate) fn check_recording(&self) -> Result<()> {
        let refused = [
            (self.mixer != Mixer::Sine, "mixer", "is a switch"),
            (self.filter == OutputFilter::LowPass, "filter", "is a low-pass"),
            (self.quadrature_error != 0.0, "quadrature_error", "is one of the mixers"),
            (self.quadrature == QuadratureBy::Passes, "quadrature", "is a second pass"),
        ];
        let Some((_, key, what)) = refused.into_iter().find(|(found, ..)| *found) else { return Ok(()) };
        let problem = format!(
            "{what}, and a recording is what the microphones hear, before any mixer; `import` mixes it by a sine and integrates. \
             Write a cube (.npz), or leave it out"
        );
        Err(Error::input(format!("[instrument] {key}"), problem))
    }
}

/// The tones as the microphones of an instrument hear them, with their harmonics below `limit` Hz; without noise.
///
/// # Errors
/// As `simulate`.
pub(crate) fn simulate_heard(
    reflectors: &[Reflectors],
    instrument: &Instrument,
    (options, limit): (&SimulateOptions, f64),
    store: &mut dyn BlockStore,
    observer: &dyn Observer,
) -> Result<HeardTones<'static>> {
    options.check()?;
    let electronics = options.electronics.clone().unwrap_or_default();
    electronics.hear(instrument, limit, &mut |number, heard| {
        simulate_moving(reflectors, (number, heard), options, store, observer)
    })
}

impl<'a> HeardTones<'a> {
    /// A cube as what is heard, of tones by the clock of some electronics.
    ///
    /// # Errors
    /// A clock with which the frequencies do not ascend.
    pub(in crate::acquisition) fn of_cube(cube: &'a DataCube, electronics: &Electronics) -> Result<Self> {
        let frequencies = electronics.sweep(&cube.instrument, 0, 1)?.frequencies().to_vec();
        let harmonics = vec![HeardHarmonic { frequencies, samples: Cow::from(&cube.samples) }];
        Ok(Self { instrument: cube.instrument.clone(), harmonics })
    }
}
