//! Several loudspeakers at once, told apart by a code: Hadamard's signs over several sweeps, tones of their own in one, or any
//! sequences (Tamura & Akatsuka 1989).
//!
//! Sweep k records `y(k, f, r) = Σ_s C(k, s) m(s, f, r)`, where m is what speaker s would have been heard with alone, and
//! `m̂(s, f, r) = Σ_k D(s, k) y(k, f, r)` decodes it: by the inverse of C, or by what each sequence has in common with what was heard
//! (matched). A comb has one sweep, in which tone n is that of speaker n mod n_tx alone; decoded, each speaker has its own tones
//! n_tx times, and no others, so that a unit reflector still peaks at 1.

use super::Instrument;
use crate::acquisition::{DataCube, Detection};
use crate::choice::choice;
use crate::error::{Error, Result};
use crate::linalg::{LeastSquares, Matrix, pivoted_qr};
use glam::DVec3;
use num_complex::{Complex32, Complex64};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use rand_distr::{Distribution, StandardNormal};
use rayon::prelude::*;
use serde::Serialize;
use std::fmt;

choice! {
    /// How loudspeakers that sound at once are told apart.
    pub enum CodeKind: "code" {
        /// By Hadamard's (Walsh's) signs, over as many sweeps as the next power of two.
        Hadamard = "hadamard",
        /// By tones of their own, in one sweep.
        Comb = "comb",
        /// By given amplitudes in each sweep.
        Sequences = "sequences",
    }
}

choice! {
    /// How sequences are decoded.
    #[derive(Default)]
    pub enum Decoding: "decoding" {
        /// By their inverse, without cross-talk of ideal sequences.
        #[default]
        Inverse = "inverse",
        /// Each by itself, with the cross-talk of sequences that are not orthogonal, and the least noise.
        Matched = "matched",
    }
}

/// The most loudspeakers, and sweeps, of a code.
pub(crate) const MOST_CODED: usize = 1024;

/// The code of loudspeakers that sound at once.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct SourceCode {
    /// How they are told apart.
    pub kind: CodeKind,
    /// Of `Sequences`: of each sweep the amplitude of each loudspeaker, -1 to 1.
    pub sequences: Vec<Vec<f64>>,
    /// How they are decoded.
    pub decoding: Decoding,
    /// rms of the error of each amplitude, the same at all tones, that decoding knows nothing of.
    pub error: f64,
    /// Seed of these errors alone.
    pub seed: u64,
}

/// What a code is worth, against the same loudspeakers one after another.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[non_exhaustive]
pub struct CodeReport {
    /// How loudspeakers are told apart.
    pub kind: CodeKind,
    /// Loudspeakers, and the sweeps that these would take one after another.
    pub loudspeakers: usize,
    /// Sweeps that the code takes; a part of one where several tones sound at once.
    pub sweeps: f64,
    /// By how much an image has more signal to noise, dB, where a reading has the same noise.
    pub snr_gain_db: f64,
    /// The same in the same time.
    pub equal_time_gain_db: f64,
    /// Power of all others in what is decoded of a loudspeaker, dB relative to its own, over all tones together; `None` without any.
    pub cross_talk_db: Option<f64>,
    /// Step of the tones of each loudspeaker, Hz, if it is not that of the sweep.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub own_step: Option<f64>,
}

impl fmt::Display for CodeReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { kind, loudspeakers, sweeps, snr_gain_db, equal_time_gain_db, .. } = self;
        write!(
            f,
            "{loudspeakers} speakers at once, told apart by \"{kind}\" in {sweeps:.3} sweeps instead of {loudspeakers}: {snr_gain_db:+.1} dB \
             of signal to noise, {equal_time_gain_db:+.1} dB in the same time"
        )?;
        match self.cross_talk_db {
            Some(level) => write!(f, "; cross-talk {level:.1} dB")?,
            None => f.write_str("; no cross-talk")?,
        }
        self.own_step.map_or(Ok(()), |step| write!(f, "; each has tones {step} Hz apart"))
    }
}

impl SourceCode {
    /// An ideal code of a kind.
    pub fn new(kind: CodeKind) -> Self {
        Self { kind, sequences: Vec::new(), decoding: Decoding::Inverse, error: 0.0, seed: 1 }
    }

    /// Refuses a code that so many loudspeakers cannot be told apart by.
    ///
    /// # Errors
    /// One loudspeaker, or more than 1024; more than there are tones for a comb; sequences of other numbers of loudspeakers, with amplitudes
    /// beyond 1, or that are not independent; an error that is none.
    pub fn check(&self, instrument: &Instrument) -> Result<()> {
        let (n_tx, n_f) = (instrument.transmissions(), instrument.sweep.len());
        let refused = |key: &str, problem: String| Err(Error::input(format!("coding.{key}"), problem));
        if !(2..=MOST_CODED).contains(&n_tx) {
            let problem = format!(
                "tells speakers apart, and there are {n_tx}; expected 2 to {MOST_CODED} [array] sources"
            );
            return refused("kind", problem);
        }
        if self.kind == CodeKind::Comb && n_tx > n_f {
            let problem =
                format!("a comb of {n_tx} speakers needs as many tones at least, and there are {n_f}");
            return refused("kind", problem);
        }
        if !(0.0..=1.0).contains(&self.error) {
            return refused("error", format!("found {}; expected an rms from 0 to 1", self.error));
        }
        if self.kind != CodeKind::Sequences {
            return Ok(());
        }
        let rows = self.sequences.len();
        if !(1..=MOST_CODED).contains(&rows) || self.sequences.iter().any(|row| row.len() != n_tx) {
            let problem = format!(
                "expected 1 to {MOST_CODED} rows, one for each sweep, of {n_tx} amplitudes, one for each speaker, as [[1, 1], [1, -1]]"
            );
            return refused("sequences", problem);
        }
        if self.sequences.iter().flatten().any(|a| !(-1.0..=1.0).contains(a)) {
            return refused("sequences", "expected amplitudes from -1 to 1".to_owned());
        }
        let columns = pivoted_qr(&Matrix::from_fn(rows, n_tx, |k, s| self.sequences[k][s]));
        let largest = columns.diagonal.first().copied().unwrap_or(0.0);
        let independent = columns.diagonal.iter().filter(|d| **d > 1e-6 * largest).count();
        let silent = (0..n_tx).any(|s| self.sequences.iter().all(|row| row[s] == 0.0));
        let inverse = self.decoding == Decoding::Inverse;
        if silent || (inverse && independent < n_tx) {
            let problem = format!(
                "have only {independent} independent columns, and tell no {n_tx} speakers apart; give other amplitudes, or more sweeps"
            );
            return refused("sequences", problem);
        }
        Ok(())
    }

    /// Sweeps that are recorded.
    pub fn sweeps(&self, loudspeakers: usize) -> usize {
        match self.kind {
            CodeKind::Hadamard => loudspeakers.next_power_of_two(),
            CodeKind::Comb => 1,
            CodeKind::Sequences => self.sequences.len(),
        }
    }

    /// Kinds of tones that are coded alike: tone n is of kind n mod so many.
    fn classes(&self, loudspeakers: usize) -> usize {
        if self.kind == CodeKind::Comb { loudspeakers } else { 1 }
    }

    /// C of a kind of tones, `[sweep, loudspeaker]`, as it is meant to be.
    fn nominal(&self, class: usize, loudspeakers: usize) -> Matrix {
        Matrix::from_fn(self.sweeps(loudspeakers), loudspeakers, |k, s| match self.kind {
            // Sylvester's construction: the parity of the bits that both numbers have.
            CodeKind::Hadamard => {
                if (k & s).count_ones() % 2 == 0 {
                    1.0
                } else {
                    -1.0
                }
            }
            CodeKind::Comb => f64::from(u8::from(s == class)),
            CodeKind::Sequences => self.sequences[k][s],
        })
    }

    /// C of each kind of tones, `[class][sweep][loudspeaker]`, as it is.
    fn actual(&self, instrument: &Instrument) -> Vec<Vec<Vec<Complex64>>> {
        let loudspeakers = instrument.transmissions();
        let mut random = ChaCha8Rng::seed_from_u64(self.seed);
        let complex = instrument.detection == Detection::Quadrature;
        let mut gauss = |scale: f64| -> f64 {
            let g: f64 = StandardNormal.sample(&mut random);
            g * scale
        };
        let mut error = || {
            if complex {
                let each = self.error / 2_f64.sqrt();
                Complex64::new(gauss(each), gauss(each))
            } else {
                Complex64::from(gauss(self.error))
            }
        };
        let of_class = |class: usize| {
            let nominal = self.nominal(class, loudspeakers);
            let row = |k: usize| (0..loudspeakers).map(|s| nominal[(k, s)] + error()).collect();
            (0..nominal.nrows()).map(row).collect()
        };
        (0..self.classes(loudspeakers)).map(of_class).collect()
    }

    /// D of each kind of tones, `[class][loudspeaker][sweep]`.
    fn decoders(&self, loudspeakers: usize) -> Vec<Vec<Vec<f64>>> {
        let of_class = |class: usize| -> Vec<Vec<f64>> {
            let nominal = self.nominal(class, loudspeakers);
            let sweeps = nominal.nrows();
            let rows = |of: &dyn Fn(usize, usize) -> f64| {
                (0..loudspeakers).map(|s| (0..sweeps).map(|k| of(s, k)).collect()).collect()
            };
            match (self.kind, self.decoding) {
                (CodeKind::Hadamard, _) => rows(&|s, k| nominal[(k, s)] / sweeps as f64),
                (CodeKind::Comb, _) => rows(&|s, k| nominal[(k, s)] * loudspeakers as f64),
                (CodeKind::Sequences, Decoding::Inverse) => {
                    let unit = Matrix::from_fn(sweeps, sweeps, |i, j| f64::from(u8::from(i == j)));
                    let inverse = LeastSquares::new(&nominal).solve(&unit);
                    rows(&|s, k| inverse[(s, k)])
                }
                (CodeKind::Sequences, Decoding::Matched) => {
                    let power = |s: usize| (0..sweeps).map(|k| nominal[(k, s)].powi(2)).sum::<f64>();
                    rows(&|s, k| nominal[(k, s)] / power(s))
                }
            }
        };
        (0..self.classes(loudspeakers)).map(of_class).collect()
    }

    /// What is recorded of the samples that each loudspeaker would cause alone, `[n_tx, n_f, n_mic]`: `[sweep, n_f, n_mic]`.
    ///
    /// # Errors
    /// Those of [`SourceCode::check`]; no memory.
    pub fn encode(&self, instrument: &Instrument, samples: &[Complex32]) -> Result<Vec<Complex32>> {
        self.check(instrument)?;
        let actual = self.actual(instrument);
        let sweeps = self.sweeps(instrument.transmissions());
        mixed(instrument, samples, sweeps, &|class, k, s| actual[class][k][s], actual.len())
    }

    /// What each loudspeaker would have caused alone, `[n_tx, n_f, n_mic]`, of what was recorded, `[sweep, n_f, n_mic]`.
    ///
    /// # Errors
    /// As [`SourceCode::encode`].
    ///
    /// # Panics
    /// With another number of samples.
    pub fn decode(&self, instrument: &Instrument, recorded: &[Complex32]) -> Result<Vec<Complex32>> {
        self.check(instrument)?;
        let loudspeakers = instrument.transmissions();
        let decoders = self.decoders(loudspeakers);
        let of = |class: usize, s: usize, k: usize| Complex64::from(decoders[class][s][k]);
        mixed(instrument, recorded, loudspeakers, &of, decoders.len())
    }

    /// Decodes a cube whose transmissions are sweeps, of loudspeakers at these places, m, or, if none are given, at its own; says in
    /// words what was done.
    ///
    /// # Errors
    /// Another number of sweeps than the code has; those of [`SourceCode::check`].
    pub fn decode_cube(&self, cube: &mut DataCube, loudspeakers: &[DVec3]) -> Result<String> {
        let recorded = cube.instrument.transmissions();
        let mut instrument = cube.instrument.clone();
        if !loudspeakers.is_empty() {
            instrument = instrument.with_sources(loudspeakers)?;
        }
        self.check(&instrument)?;
        let sweeps = self.sweeps(instrument.transmissions());
        if sweeps != recorded {
            let problem = format!(
                "takes {sweeps} sweeps of {} speakers, and the cube has {recorded}; give the speakers as [array] sources",
                instrument.transmissions()
            );
            return Err(Error::input("calibration.decode", problem));
        }
        cube.samples = self.decode(&instrument, &cube.samples)?;
        cube.instrument = instrument;
        Ok(format!("decoded: {}", self.report(&cube.instrument)?))
    }

    /// What the code is worth, with the errors that it has.
    ///
    /// # Errors
    /// Those of [`SourceCode::check`].
    pub fn report(&self, instrument: &Instrument) -> Result<CodeReport> {
        self.check(instrument)?;
        let n_tx = instrument.transmissions();
        let (actual, decoders) = (self.actual(instrument), self.decoders(n_tx));
        let classes = decoders.len() as f64;
        let squares = decoders.iter().flatten().flatten().map(|d| d * d).sum::<f64>();
        let snr_gain_db = -10.0 * (squares / (classes * n_tx as f64)).log10();
        // Tones that sound at once take one step together.
        let sweeps = self.sweeps(n_tx) as f64 / classes;
        let heard = |s: usize, other: usize| {
            let of_class = decoders.iter().zip(&actual).map(|(decoder, actual)| {
                decoder[s].iter().zip(actual).map(|(d, row)| row[other] * d).sum::<Complex64>()
            });
            (of_class.sum::<Complex64>() / classes).norm_sqr()
        };
        let of = |s: usize| {
            let others: f64 = (0..n_tx).filter(|other| *other != s).map(|other| heard(s, other)).sum();
            others / heard(s, s)
        };
        let cross_talk = (0..n_tx).map(of).sum::<f64>() / n_tx as f64;
        Ok(CodeReport {
            kind: self.kind,
            loudspeakers: n_tx,
            sweeps,
            snr_gain_db,
            equal_time_gain_db: snr_gain_db + 10.0 * (n_tx as f64 / sweeps).log10(),
            cross_talk_db: (cross_talk > 1e-24).then(|| 10.0 * cross_talk.log10()),
            own_step: instrument.sweep.step().filter(|_| classes > 1.0).map(|step| step * classes),
        })
    }
}

/// Samples `[out, n_f, n_mic]` that are sums over those `[in, n_f, n_mic]`, with factors by kind of tone, output and input.
fn mixed(
    instrument: &Instrument,
    samples: &[Complex32],
    outputs: usize,
    factor: &(dyn Fn(usize, usize, usize) -> Complex64 + Sync),
    classes: usize,
) -> Result<Vec<Complex32>> {
    let (n_f, n_mic) = (instrument.sweep.len(), instrument.array.len());
    let inputs = samples.len() / (n_f * n_mic);
    assert_eq!(samples.len(), inputs * n_f * n_mic, "whole sweeps");
    let mut mixed = DataCube::allocate([outputs, n_f, n_mic])?;
    mixed.par_chunks_mut(n_mic).enumerate().for_each(|(row, sums)| {
        let (output, f) = (row / n_f, row % n_f);
        for input in 0..inputs {
            let times = factor(f % classes, output, input);
            let times = Complex32::new(times.re as f32, times.im as f32);
            if times != Complex32::ZERO {
                let own = &samples[(input * n_f + f) * n_mic..][..n_mic];
                sums.iter_mut().zip(own).for_each(|(sum, m)| *sum += m * times);
            }
        }
    });
    Ok(mixed)
}

#[cfg(test)]
mod tests;
