//! One step of the alternation: every channel is fitted to the image of the others.

use super::contributions::{Contributions, Prediction};
use super::{ChannelError, ErrorValue};
use crate::acquisition::DataCube;
use crate::error::Result;
use glam::DVec3;
use num_complex::Complex32;
use rayon::prelude::*;
use std::f64::consts::TAU;

/// Errors of all channels.
#[derive(Debug, Clone)]
pub(super) struct Errors {
    pub(super) kind: ChannelError,
    pub(super) values: Vec<ErrorValue>,
}

/// Microphones kept aside by which the strength of the prior is weighed.
const WEIGHED: usize = 64;

/// Largest error that is tried, in units of the prior.
const REACH: f64 = 3.0;

/// Steps of a scan, wavelengths of path.
const STEP: f64 = 0.125;

/// Times that a place is looked for with half of the steps, from those of the scan.
const HALVINGS: usize = 4;

/// Voxels that one thread sums at a time.
const TOGETHER: usize = 256;

impl Errors {
    pub(super) fn none(kind: ChannelError, channels: usize) -> Self {
        Self { kind, values: vec![DVec3::ZERO; channels] }
    }

    /// The cube without these errors.
    pub(super) fn corrected(&self, cube: &DataCube) -> Result<DataCube> {
        let mut corrected = cube.clone();
        let (instrument, n_mic) = (&cube.instrument, cube.instrument.array.len());
        if self.kind == ChannelError::Position {
            let places = instrument.array.positions().iter().zip(&self.values).map(|(r, error)| *r + *error);
            corrected.instrument.array = instrument.array.with_positions(places.collect())?;
            return Ok(corrected);
        }
        let f = instrument.sweep.frequencies();
        corrected.samples.par_chunks_mut(n_mic).enumerate().for_each(|(row_of_all, row)| {
            let i = row_of_all % f.len();
            for (r, m) in row.iter_mut().enumerate() {
                let turns = match self.kind {
                    ChannelError::Frequency => self.values[i].x / TAU,
                    ChannelError::Phase => self.values[r].x / TAU,
                    _ => f[i] * self.values[r].x / instrument.sound_speed,
                };
                *m *= Complex32::cis((-TAU * (turns - turns.round())) as f32);
            }
        });
        Ok(corrected)
    }

    /// The error of one microphone's own.
    pub(super) fn of_microphone(&self, r: usize) -> ErrorValue {
        if self.kind == ChannelError::Frequency { DVec3::ZERO } else { self.values[r] }
    }

    /// rms of the errors of some channels, along each axis.
    pub(super) fn rms(&self, channels: &[usize]) -> f64 {
        let squares: f64 = channels.iter().map(|channel| self.values[*channel].length_squared()).sum();
        (squares / (channels.len() * self.kind.dimensions()) as f64).sqrt()
    }

    /// Takes away what all errors have in common, which moves the image and blurs nothing.
    fn centre(&mut self, channels: &[usize]) {
        if self.kind == ChannelError::Delay || self.kind == ChannelError::Position {
            let mean = channels.iter().map(|c| self.values[*c]).sum::<DVec3>() / channels.len() as f64;
            self.values.iter_mut().for_each(|value| *value -= mean);
        }
    }
}

/// What each of the channels adds to each voxel, and their sum, in the order of the channels.
pub(super) fn image(
    contributions: &Contributions,
    channels: &[usize],
    errors: &Errors,
) -> (Vec<Vec<Complex32>>, Vec<Complex32>) {
    let of = |channel: &usize| {
        let mut own = vec![Complex32::ZERO; contributions.voxels()];
        contributions.of(*channel, errors.values[*channel], &mut own);
        own
    };
    let each: Vec<Vec<Complex32>> = channels.par_iter().map(of).collect();
    let mut image = vec![Complex32::ZERO; contributions.voxels()];
    image.par_chunks_mut(TOGETHER).enumerate().for_each(|(chunk, sums)| {
        let first = chunk * TOGETHER;
        for own in &each {
            sums.iter_mut().zip(&own[first..]).for_each(|(sum, value)| *sum += value);
        }
    });
    (each, image)
}

/// How a channel is fitted.
#[derive(Debug, Clone, Copy)]
pub(super) struct ChannelFit {
    /// Agreement times this is the logarithm of a likelihood.
    weight: f64,
    /// rms of the prior, rad or m.
    scale: f64,
}

impl ChannelFit {
    /// Weighs samples against the prior by what an image leaves unexplained of microphones that are not in it.
    pub(super) fn weigh(
        contributions: &Contributions,
        image: &[Complex32],
        aside: &[usize],
        errors: &Errors,
        scale: f64,
    ) -> Self {
        let some = &aside[..aside.len().min(WEIGHED)];
        let of = |r: &usize| contributions.prediction(*r, errors.of_microphone(*r), &errors.values, image);
        let each: Vec<Prediction> = some.par_iter().map(of).collect();
        let sum = |of: fn(&Prediction) -> f64| each.iter().map(of).sum::<f64>();
        let (agreement, predicted, measured) =
            (sum(|p| p.agreement), sum(|p| p.predicted), sum(|p| p.measured));
        let gain = if predicted > 0.0 { (agreement / predicted).max(0.0) } else { 0.0 };
        let noise = ((measured - gain * agreement) / (contributions.samples() * some.len()) as f64)
            .max(f64::MIN_POSITIVE);
        Self { weight: 2.0 * gain / noise, scale }
    }

    /// The error of a channel that is likeliest given the image of the others and the prior.
    pub(super) fn best(
        &self,
        contributions: &Contributions,
        channel: usize,
        image: &[Complex32],
    ) -> ErrorValue {
        let posterior = |error: ErrorValue| {
            let prior = 0.5 * error.length_squared() / (self.scale * self.scale);
            self.weight * contributions.agreement(channel, error, image) - prior
        };
        let axes: &[DVec3] = match contributions.kind {
            ChannelError::Frequency | ChannelError::Phase => {
                let inner = contributions.inner(channel, DVec3::ZERO, image);
                // A likelihood of |inner| cos(φ − φ₀) is nearly Gaussian where it is strong.
                let known = self.weight * inner.norm() * self.scale * self.scale;
                return DVec3::X * (inner.arg() * known / (1.0 + known));
            }
            ChannelError::Delay => &[DVec3::X],
            ChannelError::Position => &[DVec3::Z, DVec3::X, DVec3::Y],
        };
        let step = STEP * contributions.wavelength();
        let count = (REACH * self.scale / step).ceil() as i32;
        let scanned = (-count..=count).map(|i| axes[0] * (step * f64::from(i)));
        let mut best = (f64::NEG_INFINITY, DVec3::ZERO);
        for error in scanned {
            let value = posterior(error);
            if value > best.0 {
                best = (value, error);
            }
        }
        for halving in 0..HALVINGS {
            let step = step * 0.5_f64.powi(halving as i32);
            for axis in axes {
                let sides = [-step, step].map(|step| posterior(best.1 + *axis * step));
                let curvature = sides[0] + sides[1] - 2.0 * best.0;
                // The top of a parabola where there is one within the steps, else the better side.
                let moved =
                    if curvature < 0.0 { 0.5 * (sides[0] - sides[1]) / curvature } else { f64::INFINITY };
                let moved = if moved.abs() <= 1.0 { moved } else { (sides[1] - sides[0]).signum() };
                let error = best.1 + *axis * (step * moved);
                let value = posterior(error);
                if value > best.0 {
                    best = (value, error);
                }
            }
        }
        best.1
    }
}

/// Fits every channel to the image of the others, tones or the microphones that are kept.
pub(super) fn fit_channels(
    contributions: &Contributions,
    fitted: &[usize],
    aside: &[usize],
    errors: &mut Errors,
    scale: f64,
) {
    let (each, sum) = image(contributions, fitted, errors);
    let fit = ChannelFit::weigh(contributions, &sum, aside, errors, scale);
    let of = |(channel, own): (&usize, &Vec<Complex32>)| {
        let others: Vec<Complex32> = sum.iter().zip(own).map(|(sum, own)| sum - own).collect();
        fit.best(contributions, *channel, &others)
    };
    let found: Vec<ErrorValue> = fitted.par_iter().zip(&each).map(of).collect();
    for (channel, error) in fitted.iter().zip(found) {
        errors.values[*channel] = error;
    }
    errors.centre(fitted);
}
