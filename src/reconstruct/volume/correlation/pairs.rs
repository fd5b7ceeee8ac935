//! The weights, sub-bands and instruments of a correlation, and what is summed of the samples before any voxel.

use crate::acquisition::{CubeSource, Detection, Instrument, Sweep};
use crate::alloc::try_zeroed;
use crate::error::{Error, Result};
use crate::grid::Grid;
use crate::reconstruct::volume::transmissions::slab_bytes;
use crate::reconstruct::{Method, ReconstructOptions, Window, no_room};
use num_complex::Complex32;
use rayon::prelude::*;
use std::ops::Range;

/// The weights and sub-bands of a correlation.
pub(super) struct MicrophonePairs<'a> {
    pub(super) instrument: &'a Instrument,
    pub(super) tones: usize,
    pub(super) of_sweep: Vec<f64>,
    pub(super) of_array: Vec<f64>,
    /// Σ_g (W_g² − V_g) of all loudspeakers.
    pub(super) norm: f64,
    /// The image of each sub-band, and that of the diagonal.
    pub(super) options: ReconstructOptions,
}

impl<'a> MicrophonePairs<'a> {
    /// # Errors
    /// In-phase samples; a single microphone; a refinement; a spreading that differs between loudspeakers; more tones in a
    /// sub-band than there are, or uneven ones.
    pub(super) fn new(instrument: &'a Instrument, options: &ReconstructOptions) -> Result<Self> {
        let (n_f, n_mic, tones) = (instrument.sweep.len(), instrument.array.len(), options.sub_band);
        let refused = |place: &str, problem: String| Err(Error::input(place, problem));
        if instrument.detection == Detection::InPhase {
            let problem = "\"correlation\" takes phases between microphones, which in-phase samples do not have; record in \
                           quadrature, or use another method";
            return refused("reconstruct.method", problem.to_owned());
        }
        if n_mic < 2 {
            let problem = "\"correlation\" takes pairs of microphones, and there is one; use another method";
            return refused("reconstruct.method", problem.to_owned());
        }
        if options.refine.is_some() {
            let problem = "refines a sum of samples, and \"correlation\" sums products of them; use method = \"none\" here, or \
                           another [reconstruct] method";
            return refused("refine.method", problem.to_owned());
        }
        if options.compensate && instrument.transmissions() > 1 {
            let problem = "has no single factor for the voxels of several loudspeakers whose powers are added; leave it out \
                           with method = \"correlation\"";
            return refused("reconstruct.compensate", problem.to_owned());
        }
        if options.motion.is_some() {
            let problem = "is not compensated with method = \"correlation\", which forgives its phases as well; leave it out";
            return refused("medium.velocity", problem.to_owned());
        }
        if !(1..=n_f).contains(&tones) {
            let problem = format!("found {tones}; expected 1 to {n_f}, the number of frequencies");
            return refused("reconstruct.sub_band", problem);
        }
        if tones > 1 && instrument.sweep.step().is_none() {
            let problem = format!(
                "found {tones}, but the frequencies are not evenly spaced, so that sub-bands have no differences in common; use 1"
            );
            return refused("reconstruct.sub_band", problem);
        }
        let of_sweep = options.window.over_sweep(&instrument.sweep);
        let of_array = options.window.over_array(&instrument.array);
        let [sum, squares] = of_array.iter().fold([0.0; 2], |[s, q], w| [s + w, q + w * w]);
        let bands: f64 = of_sweep.chunks(tones).map(|band| band.iter().sum::<f64>().powi(2)).sum();
        let norm = bands * (sum * sum - squares) * instrument.transmissions() as f64;
        let memory = options.memory;
        let options = ReconstructOptions {
            memory,
            tolerance: options.tolerance,
            ..ReconstructOptions::new(Method::Auto, Window::None)
        };
        Ok(Self { instrument, tones, of_sweep, of_array, norm, options })
    }

    /// The same with less memory for the images of sub-bands.
    pub(super) fn holding(mut self, grid: &Grid) -> Self {
        let held = self.held_bytes(grid);
        self.options.memory = self.options.memory.map(|memory| memory.saturating_sub(held));
        self
    }

    /// Bytes of the powers of a slab and of its voxels, of the samples of a sub-band, and of the diagonal's.
    pub(super) fn held_bytes(&self, grid: &Grid) -> u64 {
        let samples = |tones: usize| (tones * self.instrument.array.len() * size_of::<Complex32>()) as u64;
        let diagonals = samples(self.tones - 1).saturating_mul(self.instrument.transmissions() as u64);
        slab_bytes(grid).saturating_mul(2).saturating_add(samples(self.tones)).saturating_add(diagonals)
    }

    pub(super) fn bands(&self) -> usize {
        self.of_sweep.len().div_ceil(self.tones)
    }

    /// What a sub-band of a transmission was measured with.
    pub(super) fn of_band(&self, transmission: usize, tones: Range<usize>) -> Result<Instrument> {
        let frequencies = self.instrument.sweep.frequencies()[tones].to_vec();
        Ok(self.instrument.transmission(transmission).with_sweep(Sweep::from_frequencies(frequencies)?))
    }

    /// The tones of the sub-band in the middle of the sweep, which stands for all of them.
    pub(super) fn middle(&self) -> Range<usize> {
        let first = self.bands() / 2 * self.tones;
        first..(first + self.tones).min(self.of_sweep.len())
    }

    /// What the differences of a sub-band's frequencies would be measured with; `None` for single tones.
    pub(super) fn of_differences(&self, transmission: usize) -> Result<Option<Instrument>> {
        let Some(step) = self.instrument.sweep.step().filter(|_| self.tones > 1) else { return Ok(None) };
        let sweep = Sweep::from_frequencies((1..self.tones).map(|d| d as f64 * step).collect())?;
        Ok(Some(self.instrument.transmission(transmission).with_sweep(sweep)))
    }

    /// `y = w_f w_r m` of some tones, `[f, n_mic]`.
    pub(super) fn weighted(&self, tones: Range<usize>, samples: &[Complex32], to: &mut Vec<Complex32>) {
        to.clear();
        for (f, row) in tones.zip(samples.chunks_exact(self.of_array.len())) {
            let of_tone = self.of_sweep[f];
            to.extend(row.iter().zip(&self.of_array).map(|(m, w)| m * ((of_tone * w) as f32)));
        }
    }
}

/// Sums over samples that are known before any voxel is.
#[derive(Default)]
pub(super) struct PairSums {
    /// Of each loudspeaker `Σ_f y(f + d, r) y*(f, r)` by d and r, of all sub-bands; empty for single tones.
    pub(super) differences: Vec<Vec<Complex32>>,
    /// Of each loudspeaker `Σ |y|²`, what is constant of the diagonal.
    pub(super) powers: Vec<f64>,
    /// `Σ_g (Σ |y|)²`, to which the error of the power is relative, and `Σ_g (Σ |y|²)²`, that of random phases.
    pub(super) moduli: f64,
    pub(super) random: f64,
}

pub(super) fn measure(source: &mut dyn CubeSource, pairs: &MicrophonePairs) -> Result<PairSums> {
    let (n_mic, tones) = (pairs.of_array.len(), pairs.tones);
    let mut measured = PairSums::default();
    for transmission in 0..pairs.instrument.transmissions() {
        let len = ((tones - 1) * n_mic) as u64;
        let mut differences = try_zeroed(len).ok_or_else(|| no_room(tones as u64, n_mic as u64))?;
        let (mut all, mut y) = (0.0, Vec::new());
        source.visit_transmission(transmission, tones, &mut |range, samples| {
            pairs.weighted(range, samples, &mut y);
            let squares = y.iter().map(|y| f64::from(y.re).powi(2) + f64::from(y.im).powi(2));
            let power = squares.clone().sum::<f64>();
            all += power;
            measured.moduli += squares.map(f64::sqrt).sum::<f64>().powi(2);
            measured.random += power * power;
            differences.par_chunks_mut(n_mic).enumerate().for_each(|(d, sums)| {
                // Row by row, so that neighbours in memory are summed together.
                for (near, far) in y.chunks_exact(n_mic).zip(y.chunks_exact(n_mic).skip(d + 1)) {
                    for ((sum, near), far) in sums.iter_mut().zip(near).zip(far) {
                        *sum += far * near.conj();
                    }
                }
            });
            Ok(())
        })?;
        measured.powers.push(all);
        measured.differences.push(differences);
    }
    Ok(measured)
}
