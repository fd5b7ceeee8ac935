//! What each channel adds to each bright voxel, and what the voxels predict of a microphone's samples.

use super::profiles::Profiles;
use super::voxels::Bright;
use super::{ChannelError, ErrorValue};
use crate::acquisition::{DataCube, Instrument};
use num_complex::{Complex32, Complex64};
use rayon::prelude::*;
use std::f64::consts::TAU;

/// The echoes of bright voxels in every channel, with any error of it.
#[derive(Debug)]
pub(super) struct Contributions<'a> {
    pub(super) kind: ChannelError,
    cube: &'a DataCube,
    /// The instrument of each transmission.
    each: Vec<Instrument>,
    bright: &'a Bright,
    source: ChannelData,
}

#[derive(Debug)]
enum ChannelData {
    /// Of microphones: their profiles.
    Profiles(Profiles),
    /// Of tones, without an error: `[tone, voxel]`.
    Tones(Vec<Complex32>),
}

impl<'a> Contributions<'a> {
    /// Tones are those of the microphones that are kept; `reach` bounds the delays and displacements, m, that will be asked for.
    pub(super) fn new(
        cube: &'a DataCube,
        kind: ChannelError,
        bright: &'a Bright,
        kept: &[usize],
        reach: f64,
    ) -> Self {
        let instrument = &cube.instrument;
        let each: Vec<_> =
            (0..instrument.transmissions()).map(|index| instrument.transmission(index)).collect();
        let source = if kind == ChannelError::Frequency {
            ChannelData::Tones(tones(cube, &each, bright, kept))
        } else {
            let paths = bright.places.iter().map(|p| instrument.path_bounds_of((*p, *p)));
            let [low, high] = paths.fold([f64::INFINITY, 0.0_f64], |[a, b], [c, d]| [a.min(c), b.max(d)]);
            let reach = if kind == ChannelError::Phase { 0.0 } else { 2.0 * reach * 3.0_f64.sqrt() };
            ChannelData::Profiles(Profiles::new(cube, [low - reach, high + reach]))
        };
        Self { kind, cube, each, bright, source }
    }

    /// Bright voxels.
    pub(super) fn voxels(&self) -> usize {
        self.bright.places.len()
    }

    /// `Σ m e^{−i2πf·path/c}` over the channel's samples at each voxel, with an error of the channel taken out.
    pub(super) fn of(&self, channel: usize, error: ErrorValue, sums: &mut [Complex32]) {
        match &self.source {
            ChannelData::Tones(tones) => {
                let turn = Complex32::cis(-error.x as f32);
                let own = &tones[channel * self.voxels()..][..self.voxels()];
                sums.iter_mut().zip(own).for_each(|(sum, tone)| *sum = tone * turn);
            }
            ChannelData::Profiles(profiles) => {
                let turn = match self.kind {
                    ChannelError::Phase => Complex32::cis(-error.x as f32),
                    _ => Complex32::ONE,
                };
                for (sum, p) in sums.iter_mut().zip(&self.bright.places) {
                    *sum = self.profile(profiles, channel, error, *p) * turn;
                }
            }
        }
    }

    /// `Re Σ conj(image) · contribution`: how well a channel with a delay or at a place fits an image.
    pub(super) fn agreement(&self, channel: usize, error: ErrorValue, image: &[Complex32]) -> f64 {
        let ChannelData::Profiles(profiles) = &self.source else {
            return self.inner(channel, error, image).re;
        };
        let mut sum = 0.0;
        for (a, p) in image.iter().zip(&self.bright.places) {
            let value = self.profile(profiles, channel, error, *p);
            sum += f64::from(a.re * value.re + a.im * value.im);
        }
        sum
    }

    /// The same product with its phase.
    pub(super) fn inner(&self, channel: usize, error: ErrorValue, image: &[Complex32]) -> Complex64 {
        let mut own = vec![Complex32::ZERO; self.voxels()];
        self.of(channel, error, &mut own);
        let terms = image.iter().zip(&own).map(|(a, value)| a.conj() * value);
        terms.fold(Complex64::ZERO, |sum, term| sum + double(term))
    }

    /// Samples of a microphone: frequencies, of each loudspeaker.
    pub(super) fn samples(&self) -> usize {
        self.each.len() * self.cube.instrument.sweep.len()
    }

    /// `Σ m e^{−i2πf·path/c}` over a microphone's samples at a place, of all loudspeakers.
    fn profile(
        &self,
        profiles: &Profiles,
        microphone: usize,
        error: ErrorValue,
        p: glam::DVec3,
    ) -> Complex32 {
        let n_mic = self.cube.instrument.array.len();
        let of = |tx: usize| profiles.at(tx * n_mic + microphone, self.path((tx, microphone), error, p));
        (1..self.each.len()).fold(of(0), |sum, tx| sum + of(tx))
    }

    /// Wavelength at the centre of the band, m.
    pub(super) fn wavelength(&self) -> f64 {
        self.cube.instrument.wavelength()
    }

    /// The path from a loudspeaker to the channel's microphone that a delay makes longer, or another place other.
    fn path(&self, (tx, microphone): (usize, usize), error: ErrorValue, p: glam::DVec3) -> f64 {
        let instrument = &self.each[tx];
        match self.kind {
            ChannelError::Delay => instrument.path_length_at(p, microphone) + error.x,
            ChannelError::Position => {
                instrument.path_length(p, instrument.array.positions()[microphone] + error)
            }
            _ => instrument.path_length_at(p, microphone),
        }
    }

    /// Of a microphone that is not in an image, with an error of its own: sums over its samples m, corrected by the errors of
    /// tones if those are looked for, and what the image predicts for them, `p = Σ image e^{+i2πf·path/c}`. Literal: a phasor for
    /// each voxel and sample.
    pub(super) fn prediction(
        &self,
        microphone: usize,
        error: ErrorValue,
        tones: &[ErrorValue],
        image: &[Complex32],
    ) -> Prediction {
        let (instrument, n_mic) = (&self.cube.instrument, self.cube.instrument.array.len());
        let (f, c) = (instrument.sweep.frequencies(), instrument.sound_speed);
        // [n_tx, n_f].
        let mut predicted = vec![Complex64::ZERO; self.samples()];
        for (tx, predicted) in predicted.chunks_exact_mut(f.len()).enumerate() {
            for (a, p) in image.iter().zip(&self.bright.places) {
                let (a, delay) = (double(*a), self.path((tx, microphone), error, *p) / c);
                match instrument.sweep.step() {
                    Some(step) => {
                        let (mut term, turn) = (a * turned(f[0] * delay), turned(step * delay));
                        for sum in &mut *predicted {
                            *sum += term;
                            term *= turn;
                        }
                    }
                    None => predicted.iter_mut().zip(f).for_each(|(sum, f)| *sum += a * turned(f * delay)),
                }
            }
        }
        let (mut sums, mut product) = (Prediction::default(), Complex64::ZERO);
        for (row, p) in predicted.into_iter().enumerate() {
            let (i, m) = (row % f.len(), double(self.cube.samples[row * n_mic + microphone]));
            let phase = match self.kind {
                ChannelError::Frequency => tones[i].x,
                ChannelError::Phase => error.x,
                ChannelError::Delay | ChannelError::Position => 0.0,
            };
            product += m * Complex64::cis(-phase) * p.conj();
            sums.predicted += p.norm_sqr();
            sums.measured += m.norm_sqr();
        }
        (sums.agreement, sums.product) = (product.re, product.norm_sqr());
        sums
    }
}

/// Sums over the samples of a microphone.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Prediction {
    /// `Re Σ m conj(p)`.
    pub(super) agreement: f64,
    /// `|Σ m conj(p)|²`.
    pub(super) product: f64,
    /// `Σ |p|²`.
    pub(super) predicted: f64,
    /// `Σ |m|²`.
    pub(super) measured: f64,
}

fn double(value: Complex32) -> Complex64 {
    Complex64::new(value.re.into(), value.im.into())
}

fn turned(turns: f64) -> Complex64 {
    Complex64::cis(TAU * (turns - turns.round()))
}

/// Every tone's image of the bright voxels by the microphones that are kept.
fn tones(cube: &DataCube, each: &[Instrument], bright: &Bright, kept: &[usize]) -> Vec<Complex32> {
    let (instrument, n_mic) = (&cube.instrument, cube.instrument.array.len());
    let (f, c) = (instrument.sweep.frequencies(), instrument.sound_speed);
    let of_voxel = |p: &glam::DVec3| -> Vec<Complex32> {
        let mut sums = vec![Complex64::ZERO; f.len()];
        let channels = each.iter().enumerate().flat_map(|(tx, one)| kept.iter().map(move |r| (tx, one, r)));
        for (tx, one, r) in channels {
            let delay = -one.path_length_at(*p, *r) / c;
            let step = instrument.sweep.step().map(|step| turned(step * delay));
            let mut turn = turned(f[0] * delay);
            for (i, sum) in sums.iter_mut().enumerate() {
                let m = cube.samples[(tx * f.len() + i) * n_mic + *r];
                match step {
                    Some(step) if i > 0 => turn *= step,
                    _ => turn = turned(f[i] * delay),
                }
                *sum += double(m) * turn;
            }
        }
        sums.into_iter().map(|sum| Complex32::new(sum.re as f32, sum.im as f32)).collect()
    };
    let by_voxel: Vec<Vec<Complex32>> = bright.places.par_iter().map(of_voxel).collect();
    (0..f.len()).flat_map(|i| by_voxel.iter().map(move |sums| sums[i])).collect()
}
