//! The model of measurement and its adjoint, from voxels to tones at the microphones and back.

use super::RefineOptions;
use super::noise::noise_of;
use crate::acquisition::{CubeSource, Detection, Instrument, Visit};
use crate::alloc::try_zeroed;
use crate::error::Result;
use crate::grid::{Grid, Volume, no_room_for};
use crate::progress::{Event, Observer};
use crate::reconstruct::compress::{KeptTones, frequencies_at_once};
use crate::reconstruct::convolution::{ConvolutionPlan, Skeletons, adjoint, convolution_with};
use crate::reconstruct::error_budget::ErrorBudget;
use crate::reconstruct::job::Job;
use crate::reconstruct::plan::Sampled;
use crate::reconstruct::upsampling::{InterpolationError, Resampled};
use crate::reconstruct::volume::Batch;
use crate::reconstruct::window::Weights;
use crate::reconstruct::{ReconstructOptions, ReconstructionInfo, VolumeSink, on_nodes, silence};
use num_complex::Complex32;
use rayon::prelude::*;
use std::ops::Range;

/// What is left of the samples is no more than noise when it is this many times as much: noise is measured to within a
/// percent.
const MORE: f64 = 1.01;

/// Neighbouring depths reach so many range resolutions to both sides.
const AROUND: f64 = 3.0;

/// K and its adjoint, with what all steps share: lattice, virtual tones, skeletons and weights.
///
/// The scalar product of samples is `w/Σw · Σ_tx Σ_f Σ_r w_f w_r Re(a b*)`, for which Eq. 13 is the adjoint of K.
pub(super) struct Operator<'a> {
    instrument: Instrument,
    pub(super) grid: &'a Grid,
    plan: &'a Sampled<ConvolutionPlan>,
    skeletons: &'a Skeletons,
    weights: Weights,
    budget: ErrorBudget,
    batch: Batch,
}

impl<'a> Operator<'a> {
    pub(super) fn new(
        instrument: &Instrument,
        grid: &'a Grid,
        plan: &'a Sampled<ConvolutionPlan>,
        batch: Batch,
        options: &ReconstructOptions,
    ) -> Self {
        Self {
            instrument: instrument.clone(),
            grid,
            plan,
            skeletons: plan.plan.skeletons(instrument).expect("refinement has a tolerance"),
            weights: Weights::new(instrument, options.window),
            budget: ErrorBudget::new(options.tolerance),
            batch,
        }
    }

    /// Whether voxels are made of nodes.
    #[cfg(test)]
    pub(super) fn interpolates(&self) -> bool {
        self.plan.upsampling.is_some()
    }

    /// Units of work of a step, as the observer of [`Operator::image`] and [`Operator::echo`] learns of them.
    pub(super) fn work(&self) -> u64 {
        (self.instrument.transmissions() * self.instrument.sweep.len()) as u64 + 2 * self.skeletons.work()
    }

    /// K* of what is left of the samples after the echoes of some tones: Eq. 13. Gives the power of what is left, too.
    pub(super) fn image(
        &self,
        source: &mut dyn CubeSource,
        echoes: Option<&[Complex32]>,
        sink: &mut dyn VolumeSink,
        observer: &dyn Observer,
    ) -> Result<(ReconstructionInfo, f64)> {
        let mut left = self.left(source, echoes);
        let job = Job {
            kept: KeptTones::default(),
            source: &mut left,
            weights: &self.weights,
            grid: self.grid,
            budget: self.budget,
            interpolation: InterpolationError::NONE,
            batch: self.batch,
            sink,
            observer: &Within(observer),
        };
        let info = on_nodes(self.plan, job, |job, plan| convolution_with(job, plan, self.skeletons))?;
        Ok((info, left.power))
    }

    /// A volume, all zero.
    pub(super) fn darkness(&self) -> Result<Vec<Complex32>> {
        try_zeroed(self.grid.voxel_count()).ok_or_else(|| no_room_for(self.grid))
    }

    /// Virtual tones at the microphones, `[transmission, tone, n_mic]`, all zero.
    pub(super) fn silence(&self) -> Result<Vec<Complex32>> {
        silence(self.instrument.transmissions() * self.skeletons.tones(), self.instrument.array.len())
    }

    /// K of a volume `[z, y, x]`, as virtual tones at the microphones.
    pub(super) fn echo(&self, voxels: &[Complex32], observer: &dyn Observer) -> Result<Vec<Complex32>> {
        self.echo_of(0..self.grid.z.count, voxels, observer)
    }

    /// The same of some of its depths.
    pub(super) fn echo_of(
        &self,
        depths: Range<usize>,
        voxels: &[Complex32],
        observer: &dyn Observer,
    ) -> Result<Vec<Complex32>> {
        let Sampled { upsampling, plan } = self.plan;
        let sum = |depths, samples| {
            adjoint(plan, self.skeletons, &self.instrument, self.batch, (depths, samples), &Within(observer))
        };
        let Some(upsampling) = upsampling else { return sum(depths, voxels) };
        let mut nodes = Volume { grid: upsampling.coarse, samples: Vec::new() };
        let mut resampled = Resampled::new(upsampling.onto_nodes(), &mut nodes)?;
        let plane = self.grid.plane_len();
        let silence = vec![Complex32::ZERO; plane];
        (0..depths.start).try_for_each(|iz| resampled.take(iz, &silence))?;
        resampled.take(depths.start, &voxels[depths.start * plane..depths.end * plane])?;
        (depths.end..self.grid.z.count).try_for_each(|iz| resampled.take(iz, &silence))?;
        sum(0..nodes.grid.z.count, &nodes.samples)
    }

    /// Depths around one, so many that the array tells the first from the last.
    pub(super) fn around(&self, depth: usize) -> Range<usize> {
        let reach = AROUND * self.instrument.range_resolution().unwrap_or(0.0) / self.grid.z.pitch;
        let reach = (reach.ceil() as usize).clamp(1, self.grid.z.count);
        depth.saturating_sub(reach)..(depth + reach + 1).min(self.grid.z.count)
    }

    /// The power of what is left of the samples after the echoes of some tones.
    pub(super) fn power_left(&self, source: &mut dyn CubeSource, echoes: &[Complex32]) -> Result<f64> {
        let mut left = self.left(source, Some(echoes));
        for transmission in 0..self.instrument.transmissions() {
            left.visit_transmission(transmission, self.frequencies(), &mut |_, _| Ok(()))?;
        }
        Ok(left.power)
    }

    /// The power of echoes.
    pub(super) fn power(&self, echoes: &[Complex32]) -> f64 {
        let (n_f, n_mic) = (self.instrument.sweep.len(), self.instrument.array.len());
        let mut samples = Vec::new();
        let blocks = (0..self.instrument.transmissions())
            .flat_map(|transmission| (0..n_f).step_by(self.frequencies()).map(move |f| (transmission, f)));
        let of_block = |(transmission, first): (usize, usize)| {
            let range = first..(first + self.frequencies()).min(n_f);
            self.expand(range.clone(), (transmission, echoes), &mut samples);
            power_of(&self.weights, range, &samples, n_mic)
        };
        blocks.map(of_block).sum()
    }

    /// The noise in a sample, its root mean square: as given, or else measured if that is possible.
    pub(super) fn noise(&self, source: &mut dyn CubeSource, refine: &RefineOptions) -> Result<Option<f64>> {
        match refine.noise {
            Some(noise) => Ok(Some(noise)),
            None => noise_of(source, |transmission| self.skeletons.virtual_tones(transmission)),
        }
    }

    /// Whether so much power is left of the samples that it may all be noise, where that is known.
    pub(super) fn is_noise(&self, left: f64, noise: Option<f64>) -> bool {
        let [f, r] = self.weight_sums(|w| w);
        noise.is_some_and(|noise| left <= MORE * noise * noise * f * r)
    }

    /// The root mean square that noise has in a voxel.
    pub(super) fn noise_in_voxels(&self, noise: f64) -> f64 {
        let [f, r] = self.weight_sums(|w| w * w);
        noise * (f * r).sqrt()
    }

    /// Over all frequencies, of every transmission, and over the microphones.
    fn weight_sums(&self, of: impl Fn(f64) -> f64) -> [f64; 2] {
        let [f, r] = [&self.weights.frequency, &self.weights.microphone]
            .map(|weights| weights.iter().map(|w| of(f64::from(*w))).sum());
        [self.instrument.transmissions() as f64 * f, r]
    }

    fn frequencies(&self) -> usize {
        frequencies_at_once(self.instrument.array.len())
    }

    /// Samples of some frequencies of a transmission that are echoes of virtual tones.
    fn expand(
        &self,
        range: Range<usize>,
        (transmission, echoes): (usize, &[Complex32]),
        samples: &mut Vec<Complex32>,
    ) {
        let n_mic = self.instrument.array.len();
        let tones = self.skeletons.tones() * n_mic;
        let echoes = &echoes[transmission * tones..][..tones];
        samples.resize(range.len() * n_mic, Complex32::ZERO);
        self.skeletons.virtual_tones(transmission).expand(range, echoes, n_mic, samples);
        if self.instrument.detection == Detection::InPhase {
            samples.par_iter_mut().with_min_len(1 << 12).for_each(|m| m.im = 0.0);
        }
    }

    fn left<'s>(&'s self, source: &'s mut dyn CubeSource, echoes: Option<&'s [Complex32]>) -> Left<'s> {
        Left { operator: self, source, echoes, power: 0.0 }
    }
}

/// `Σ w/Σw w_f w_r |m|²` of samples of some frequencies.
fn power_of(weights: &Weights, range: Range<usize>, samples: &[Complex32], n_mic: usize) -> f64 {
    let rows = samples.par_chunks_exact(n_mic).zip(&weights.frequency[range]);
    let of_row = |(row, weight): (&[Complex32], &f32)| {
        let squares =
            row.iter().zip(&weights.microphone).map(|(m, w)| f64::from(m.norm_sqr()) * f64::from(*w));
        f64::from(*weight) * squares.sum::<f64>()
    };
    // In order, so that it does not depend on the threads.
    rows.map(of_row).collect::<Vec<_>>().iter().sum()
}

/// What is left of a cube's samples after the echoes of a volume.
struct Left<'a> {
    operator: &'a Operator<'a>,
    source: &'a mut dyn CubeSource,
    echoes: Option<&'a [Complex32]>,
    /// Of all that was visited.
    power: f64,
}

impl CubeSource for Left<'_> {
    fn instrument(&self) -> &Instrument {
        &self.operator.instrument
    }

    fn held_bytes(&self) -> u64 {
        self.source.held_bytes()
    }

    fn visit_transmission(&mut self, transmission: usize, block: usize, visit: &mut Visit<'_>) -> Result<()> {
        let Self { operator, source, echoes, power } = self;
        let n_mic = operator.instrument.array.len();
        let mut left = Vec::new();
        source.visit_transmission(transmission, block, &mut |range, samples| {
            let left = match echoes {
                None => samples,
                Some(echoes) => {
                    operator.expand(range.clone(), (transmission, echoes), &mut left);
                    let pairs = left.par_iter_mut().zip(samples).with_min_len(1 << 12);
                    pairs.for_each(|(echo, m)| *echo = m - *echo);
                    &left
                }
            };
            *power += power_of(&operator.weights, range.clone(), left, n_mic);
            visit(range, left)
        })
    }
}

/// Stages within another one: their work is part of its.
struct Within<'a>(&'a dyn Observer);

impl Observer for Within<'_> {
    fn event(&self, event: Event<'_>) {
        if let Event::Advanced { .. } = event {
            self.0.event(event);
        }
    }

    fn warn(&self, message: &str) {
        self.0.warn(message);
    }

    fn should_stop(&self) -> bool {
        self.0.should_stop()
    }
}
