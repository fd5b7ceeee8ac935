//! The judgement by microphones that were kept aside: whether the image of the others explains them better than before.

use super::contributions::Contributions;
use super::fit::{ChannelFit, Errors, image};
use super::voxels::Bright;
use super::{ChannelError, ErrorValue};
use crate::acquisition::{DataCube, note};
use crate::choice::choice;
use crate::error::Result;
use rayon::prelude::*;
use serde::Serialize;

choice! {
    /// Whether a self-calibration is to be trusted.
    pub enum SelfCalibrationVerdict: "verdict" {
        /// Microphones that were kept aside are explained better.
        Better = "better",
        /// They are not: what was found sharpens the image, and is not in the echoes.
        NotBetter = "not better",
        /// What was found is larger than the prior allows.
        LargerThanPrior = "larger than the prior",
    }
}

/// The image before or after, and what it explains.
#[derive(Debug, Clone)]
pub(super) struct Judge {
    /// Share of the power of each microphone kept aside that the image of the others predicts.
    explained: Vec<f64>,
    /// Power of each.
    power: Vec<f64>,
    sharpness: f64,
    cells: f64,
}

impl Judge {
    /// Fits microphones kept aside to the image of the others, stores their errors, and measures what is explained.
    ///
    /// A microphone's own error is fitted before as after, so that only the image makes the difference; of tones, it has the
    /// errors that the others found.
    pub(super) fn of(
        contributions: &Contributions,
        bright: &Bright,
        fitted: &[usize],
        aside: &[usize],
        errors: &mut Errors,
        scale: f64,
    ) -> Self {
        let (_, sum) = image(contributions, fitted, errors);
        let fit = ChannelFit::weigh(contributions, &sum, aside, errors, scale);
        let of = |r: &usize| {
            let error = match errors.kind {
                ChannelError::Frequency => ErrorValue::ZERO,
                _ => fit.best(contributions, *r, &sum),
            };
            (error, contributions.prediction(*r, error, &errors.values, &sum))
        };
        let found: Vec<_> = aside.par_iter().map(of).collect();
        if errors.kind != ChannelError::Frequency {
            for (r, (error, _)) in aside.iter().zip(&found) {
                errors.values[*r] = *error;
            }
        }
        let explained = found.iter().map(|(_, p)| {
            let whole = p.predicted * p.measured;
            if whole > 0.0 { p.product / whole } else { 0.0 }
        });
        Self {
            explained: explained.collect(),
            power: found.iter().map(|(_, p)| p.measured).collect(),
            sharpness: bright.sharpness,
            cells: bright.cells,
        }
    }

    /// The share of the power of all of them.
    fn share(&self) -> f64 {
        let explained: f64 = self.explained.iter().zip(&self.power).map(|(share, power)| share * power).sum();
        explained / self.power.iter().sum::<f64>().max(f64::MIN_POSITIVE)
    }
}

/// What the microphones kept aside say.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[non_exhaustive]
pub struct HeldOut {
    /// Microphones that were kept aside.
    pub count: usize,
    /// Share of their power that the image of the others explains: before.
    pub explained_before: f64,
    /// After.
    pub explained_after: f64,
    /// Mean gain of a microphone in units of its standard error.
    pub significance: f64,
}

/// Errors that were found, and whether they are to be trusted.
#[derive(Debug, Clone, Serialize)]
#[non_exhaustive]
pub struct SelfCalibration {
    /// What was looked for.
    pub kind: ChannelError,
    /// The unit of prior and rms.
    pub unit: &'static str,
    /// rms that was expected.
    pub prior: f64,
    /// rms that was found, along each axis.
    pub rms: f64,
    /// Microphones that made the images.
    pub microphones: usize,
    /// Resolution cells that the bright voxels fill in effect, at first.
    pub cells: f64,
    /// `N Σ I² / (Σ I)²` of the region, by these microphones: before.
    pub sharpness_before: f64,
    /// After. That it rises proves nothing.
    pub sharpness_after: f64,
    /// What does.
    pub held_out: HeldOut,
    /// The verdict.
    pub verdict: SelfCalibrationVerdict,
    #[serde(skip)]
    errors: Errors,
}

/// The least significance, and the least gain relative to what was explained before.
const SIGNIFICANT: f64 = 4.0;
const LEAST_GAIN: f64 = 0.02;

/// The rms may be so many times the prior.
const MOST_RMS: f64 = 2.0;

impl SelfCalibration {
    pub(super) fn new(
        kind: ChannelError,
        prior: f64,
        [kept, fitted]: [&[usize]; 2],
        [before, after]: &[Judge; 2],
        errors: Errors,
    ) -> Self {
        let gains = after.explained.iter().zip(&before.explained).map(|(after, before)| after - before);
        let n = after.explained.len() as f64;
        let mean = gains.clone().sum::<f64>() / n;
        let variance = gains.map(|gain| (gain - mean).powi(2)).sum::<f64>() / (n - 1.0).max(1.0);
        let held_out = HeldOut {
            count: after.explained.len(),
            explained_before: before.share(),
            explained_after: after.share(),
            significance: mean / (variance / n).sqrt().max(f64::MIN_POSITIVE),
        };
        let rms = errors.rms(fitted) / kind.factor();
        let gain = held_out.explained_after / held_out.explained_before - 1.0;
        let verdict = match () {
            () if !(held_out.significance >= SIGNIFICANT && gain >= LEAST_GAIN) => {
                SelfCalibrationVerdict::NotBetter
            }
            () if rms > MOST_RMS * prior => SelfCalibrationVerdict::LargerThanPrior,
            () => SelfCalibrationVerdict::Better,
        };
        Self {
            kind,
            unit: kind.unit(),
            prior,
            rms,
            microphones: kept.len(),
            cells: before.cells,
            sharpness_before: before.sharpness,
            sharpness_after: after.sharpness,
            held_out,
            verdict,
            errors,
        }
    }

    /// The errors that were found, of all tones or microphones: phases in rad or delays in m, or places in m relative to those
    /// that the cube has. 0 of silent ones.
    pub fn errors(&self) -> Vec<[f64; 3]> {
        self.errors.values.iter().map(glam::DVec3::to_array).collect()
    }

    /// The cube without the errors, whatever the verdict; its provenance says so.
    ///
    /// # Errors
    /// Places of microphones beyond what an array may have.
    pub fn correct(&self, cube: &DataCube) -> Result<DataCube> {
        let mut corrected = self.errors.corrected(cube)?;
        let HeldOut { explained_before, explained_after, .. } = self.held_out;
        let words = format!(
            "{} errors of {:.4} {} rms taken out, found in the echoes; they explain {:.1} % instead of {:.1} % of microphones kept aside",
            self.kind,
            self.rms,
            self.unit,
            100.0 * explained_after,
            100.0 * explained_before
        );
        note(&mut corrected, &[words]);
        Ok(corrected)
    }
}
