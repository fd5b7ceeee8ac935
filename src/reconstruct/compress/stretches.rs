//! Stretches of depths: slabs that are neighbours share tones between the volume's and their own.
//!
//! A slab's tones are made of all of the volume's, which are the more, the longer its paths differ. Those of a stretch are made
//! of the volume's by a narrow band of weights, as the volume's are of the measured ones, and are few; its slabs' are
//! made of them. Samples of a stretch are there while its slabs are summed.

use super::kept::{KeptTones, NUMBERS};
use super::tones::{SweepTones, VolumeTones};
use crate::error::Result;
use num_complex::Complex32;
use std::ops::Range;
use std::sync::Arc;

/// The tones of all stretches of a volume, whatever the samples are.
#[derive(Debug)]
pub(crate) struct StretchTones {
    /// Slabs of each but the last.
    slabs: usize,
    /// None where slabs follow from the volume's tones themselves.
    tones: Vec<Arc<SweepTones>>,
}

impl StretchTones {
    /// None yet, of so many slabs each.
    pub(crate) fn new(slabs: usize) -> Self {
        Self { slabs, tones: Vec::new() }
    }

    /// Whether slabs follow from the volume's tones themselves.
    pub(crate) fn is_empty(&self) -> bool {
        self.tones.is_empty()
    }

    /// Adds those of the next stretch.
    pub(crate) fn push(&mut self, tones: Arc<SweepTones>) {
        self.tones.push(tones);
    }

    /// Those that some slabs are of.
    fn of(&self, slabs: &Range<usize>) -> Range<usize> {
        slabs.start / self.slabs..slabs.end.div_ceil(self.slabs)
    }
}

/// The samples that slabs' tones are made of: the volume's at nodes, or those of stretches.
#[derive(Debug)]
pub(crate) struct HeldTones<'a, N> {
    stretches: &'a StretchTones,
    /// At the microphones, of which stretches are made that are not kept.
    volume: Option<VolumeTones>,
    /// Number of microphones.
    width: usize,
    /// `Σ|w m| / Σw`.
    pub(crate) modulus: f64,
    /// Stretches at nodes, by their number; the volume itself as the only one.
    held: Vec<(usize, VolumeTones)>,
    /// Spreads rows of samples at the microphones.
    onto_nodes: N,
}

impl<'a, N: Fn(Vec<Complex32>) -> Result<Vec<Complex32>>> HeldTones<'a, N> {
    /// From what is kept, or `compress` makes; others' are kept if they are asked for.
    ///
    /// # Errors
    /// They do not fit in memory; those of `compress` and `onto_nodes`.
    pub(crate) fn new(
        stretches: &'a StretchTones,
        width: usize,
        kept: &mut KeptTones<'_>,
        compress: impl FnOnce(&mut KeptTones<'_>) -> Result<VolumeTones>,
        onto_nodes: N,
    ) -> Result<Self> {
        let mut own = Self { stretches, volume: None, width, modulus: 0.0, held: Vec::new(), onto_nodes };
        if stretches.is_empty() {
            let mut volume = compress(kept)?;
            volume.tones.samples = (own.onto_nodes)(std::mem::take(&mut volume.tones.samples))?;
            own.modulus = volume.modulus;
            own.held.push((0, volume));
            return Ok(own);
        }
        let mut numbers = [Complex32::ZERO; NUMBERS];
        if let Some(modulus) = kept.load(&mut numbers)? {
            own.modulus = modulus;
            return Ok(own);
        }
        let volume = compress(&mut KeptTones::default())?;
        if kept.is_asked_for() {
            let mut room = Vec::new();
            for (stretch, tones) in stretches.tones.iter().enumerate() {
                room = tones.again(&volume, room)?.tones.samples;
                kept.save_stretch(stretch, &room);
            }
            kept.save(&mut numbers, volume.modulus)?;
        }
        own.modulus = volume.modulus;
        own.volume = Some(volume);
        Ok(own)
    }

    /// Takes the samples of all stretches that some slabs are of, in the place of others: what is kept, or made of the volume's,
    /// which `compress` makes where they are lost.
    ///
    /// # Errors
    /// They do not fit in memory; those of `compress` and `onto_nodes`.
    pub(crate) fn hold(
        &mut self,
        slabs: &Range<usize>,
        kept: &mut KeptTones<'_>,
        mut compress: impl FnMut() -> Result<VolumeTones>,
    ) -> Result<()> {
        let wanted = self.stretches.of(slabs);
        let (still, mut done): (Vec<_>, Vec<_>) =
            self.held.drain(..).partition(|(stretch, _)| wanted.contains(stretch));
        self.held = still;
        for (stretch, tones) in self.stretches.tones.iter().enumerate().take(wanted.end).skip(wanted.start) {
            if self.held.iter().any(|(held, _)| *held == stretch) {
                continue;
            }
            // Memory that is freed and allocated again is told to every processor.
            let mut room = done.pop().map_or_else(Vec::new, |(_, samples)| samples.tones.samples);
            let mut is_kept = false;
            if self.volume.is_none() {
                room = tones.silence(self.width, room)?;
                is_kept = kept.load_stretch(stretch, &mut room)?;
            }
            let mut samples = if is_kept {
                tones.with_samples(room, self.modulus)
            } else {
                let volume = match self.volume.take() {
                    Some(volume) => volume,
                    None => compress()?,
                };
                tones.again(self.volume.insert(volume), room)?
            };
            samples.tones.samples = (self.onto_nodes)(std::mem::take(&mut samples.tones.samples))?;
            self.held.push((stretch, samples));
        }
        Ok(())
    }

    /// What the tones of a slab are made of, one of those that are held.
    pub(crate) fn of(&self, slab: usize) -> &VolumeTones {
        let own = slab / self.stretches.slabs;
        let held = self.held.iter().find(|(stretch, _)| *stretch == own);
        held.map(|(_, samples)| samples).expect("stretches are held while their slabs are summed")
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::acquisition::{DataCube, Instrument, MicArray, Sweep};
    use crate::progress::Silent;
    use crate::reconstruct::compress::SlabTones;
    use crate::reconstruct::error_budget::ErrorBudget;
    use crate::reconstruct::window::Weights;
    use crate::wave::interval::PathInterval;
    use crate::wave::phasor;
    use glam::DVec3;
    use num_complex::Complex64;
    use std::f64::consts::TAU;

    #[test]
    fn slabs_of_a_stretch_sum_their_paths_as_the_measured_tones_do() {
        let sweep = Sweep::stepped(8_000.0, 14_000.0, 20.0).expect("valid");
        let array = MicArray::rectangular([3, 2], [0.1; 2], DVec3::ZERO).expect("valid");
        let (n_f, n_mic) = (sweep.len(), array.len());
        let samples: Vec<_> = (0..n_f * n_mic).map(|i| phasor((i as f64 * 0.754_878).sin() * 91.7)).collect();
        let cube = DataCube::new(Instrument::new(sweep.clone(), array), samples.clone()).expect("finite");
        let number = |i: usize| (i as f32 * 0.618_034).fract() - 0.3;
        let weights = Weights {
            frequency: (0..n_f).map(number).collect(),
            microphone: (0..n_mic).map(|r| 1.0 + number(r)).collect(),
        };
        let budget = ErrorBudget::new(1e-4);
        let interval = |shortest: f64, longest: f64| PathInterval { shortest, longest, sound_speed: 343.0 };
        // Of the longer volume the measured tones themselves serve.
        for (longest, are_measured) in [(6.0, false), (14.0, true)] {
            let volume = SweepTones::find(&sweep, interval(2.0, longest), budget);
            assert_eq!(volume.len() == n_f, are_measured);
            let part = |i: usize| 2.0 + (longest - 2.0) * i as f64 / 12.0;
            let mut stretches = StretchTones::new(4);
            let mut slabs: Vec<SlabTones> = Vec::new();
            for first in [0, 4, 8] {
                let tones = volume.narrowed(interval(part(first), part(first + 4)), budget);
                assert!(2 * tones.len() < volume.len() + 40, "{} of {}", tones.len(), volume.len());
                let paths = |slab: Range<usize>| interval(part(slab.start), part(slab.end));
                let own = (first..first + 4).map(|slab| slab..slab + 1);
                slabs.extend(tones.slabs(own, paths, |_, _, _| false, volume.left(budget)));
                stretches.push(tones);
            }
            assert!(slabs.iter().all(|slab| slab.len_if_found().is_none()), "found before they are needed");
            let about: Vec<usize> = slabs.iter().map(SlabTones::about_len).collect();
            let kept = &mut KeptTones::default();
            let compress = |kept: &mut KeptTones<'_>| volume.compress((&mut &cube, &weights), kept, &Silent);
            let mut held = HeldTones::new(&stretches, n_mic, kept, compress, Ok).expect("little");
            for wanted in [0..1, 3..5, 4..12, 2..3, 11..12] {
                held.hold(&wanted, kept, || panic!("there is the volume")).expect("little");
                for slab in wanted {
                    let tones = slabs[slab].of(held.of(slab), n_mic).expect("little");
                    assert_eq!(tones.per_metre.len(), slabs[slab].len());
                    assert!(about[slab].abs_diff(slabs[slab].len()) <= 2, "{about:?}");
                    let bound = volume.with(SlabTones::error(&slabs[slab..=slab]));
                    assert!(bound <= budget.all());
                    for i in 0..=20 {
                        let path = part(slab) + (part(slab + 1) - part(slab)) * f64::from(i) / 20.0;
                        for r in 0..n_mic {
                            let of_slab = tones.per_metre.iter().zip(tones.samples.chunks(n_mic));
                            let found: Complex64 =
                                of_slab.map(|(k, row)| wide(row[r]) * Complex64::cis(TAU * k * path)).sum();
                            let (mut sum, mut modulus) = (Complex64::ZERO, 0.0);
                            for (n, f) in sweep.frequencies().iter().enumerate() {
                                let weight = weights.frequency[n] * weights.microphone[r];
                                let m = wide(samples[n * n_mic + r]) * f64::from(weight);
                                sum += m * Complex64::cis(-TAU * f * path / 343.0);
                                modulus += m.norm();
                            }
                            let error = (found - sum).norm() / modulus;
                            assert!(error <= bound + 2e-6, "{slab}, {path} m: {error:e} above {bound:e}");
                        }
                    }
                }
            }
        }
    }

    fn wide(z: Complex32) -> Complex64 {
        Complex64::new(z.re.into(), z.im.into())
    }
}
