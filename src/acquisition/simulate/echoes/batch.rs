//! Batches of reflectors as structures of arrays for the kernels, and the losses on their amplitudes.

use crate::acquisition::simulate::terms::LossTerms;
use crate::wave::NEAREST_LEG;
use crate::wave::legs::return_legs;
use crate::wave::offsets::{Echoes, WIDE, sum_over_tones};
use glam::DVec3;
use num_complex::Complex32;

/// A batch of reflectors, padded to whole blocks.
#[derive(Debug, Default)]
pub(in super::super) struct ReflectorBatch {
    pub(in super::super) positions: Vec<DVec3>,
    /// Path lengths to the centre: absolute, and relative to the group's middle, m.
    pub(in super::super) paths: Vec<f64>,
    pub(in super::super) from_middle: Vec<f64>,
    pub(in super::super) phasors: Vec<Complex32>,
    pub(in super::super) toward: [Vec<f32>; 3],
    pub(in super::super) distance: Vec<f32>,
    pub(in super::super) turn: Vec<f32>,
    pub(in super::super) amplitude: [Vec<f32>; 2],
    /// The amplitudes with the losses of one term at one microphone.
    pub(in super::super) weighted: [Vec<f32>; 2],
    pub(in super::super) offsets: Vec<f32>,
    /// Those of one leg of several.
    pub(in super::super) of_leg: Vec<f32>,
    pub(in super::super) losses: LossBatch,
    /// Their numbers among all.
    pub(in super::super) members: Vec<u32>,
    /// The reflectors that are not the same from everywhere: their places in the batch, and among all.
    pub(in super::super) directive: Vec<(u32, u32)>,
    /// The amplitudes as heard by one microphone; empty where they are the same from everywhere.
    heard: [Vec<f32>; 2],
}

/// The arrays for losses; empty without any.
#[derive(Debug, Default)]
pub(in super::super) struct LossBatch {
    /// From the tile's centre, m, whatever the model of the paths.
    away: [Vec<f32>; 3],
    from_middle: Vec<f32>,
    /// The speaker's directivity, `[K][n]`.
    speaker: Vec<Vec<f32>>,
    spreading: Vec<f32>,
    of_leg: Vec<f32>,
    squares: Vec<f32>,
    differences: Vec<f32>,
    factors: Vec<f32>,
}

impl ReflectorBatch {
    /// Allocates `count` reflectors; the padding has no amplitude, and a distance that keeps its offset finite.
    pub(in super::super) fn resize(&mut self, count: usize) {
        self.positions.resize(count, DVec3::ZERO);
        self.paths.resize(count, 0.0);
        self.members.resize(count, 0);
        self.from_middle.resize(count, 0.0);
        self.phasors.resize(count, Complex32::ZERO);
        let padded = count.next_multiple_of(WIDE);
        let zeroed = self.toward.iter_mut().chain(&mut self.amplitude);
        clear_to_zeros(zeroed.chain([&mut self.turn, &mut self.offsets, &mut self.of_leg]), padded);
        self.distance.clear();
        self.distance.resize(padded, 1.0);
    }

    /// Multiplies the reflectors that are not the same from everywhere by their `directivity` towards a microphone.
    pub(in super::super) fn hear(&mut self, directivity: impl Fn(usize) -> f32) {
        let Self { amplitude, heard, directive, .. } = self;
        for (heard, amplitude) in heard.iter_mut().zip(&*amplitude) {
            heard.clear();
            if !directive.is_empty() {
                heard.extend_from_slice(amplitude);
            }
        }
        for (i, j) in &*directive {
            let factor = directivity(*j as usize);
            for part in heard.iter_mut() {
                part[*i as usize] *= factor;
            }
        }
    }

    /// Adds the echoes, whose offsets are known, to the sums of a microphone, the first of the `ends` of its legs: `[K][Q]`.
    pub(in super::super) fn add(
        &mut self,
        per_metre: [f32; 2],
        terms: Option<&LossTerms>,
        (ends, spread_legs): (&[[f32; 3]], Option<f64>),
        sums: &mut [[f64; 2]],
    ) {
        let Self { amplitude, weighted, offsets, losses, turn, heard, directive, .. } = self;
        let amplitude = if directive.is_empty() { amplitude } else { heard };
        let Some(terms) = terms else {
            let echoes = Echoes { turn, amplitude: [&amplitude[0], &amplitude[1]] };
            return sum_over_tones(echoes, offsets, per_metre, sums);
        };
        losses.set_microphone(ends, offsets, spread_legs.unwrap_or(0.0));
        let tones = sums.len() / terms.count();
        for (k, sums) in sums.chunks_exact_mut(tones).enumerate() {
            let factors = losses.factors(terms, k);
            for (weighted, amplitude) in weighted.iter_mut().zip(amplitude.iter()) {
                weighted.clear();
                weighted.extend(amplitude.iter().zip(factors).map(|(a, factor)| a * factor));
            }
            let echoes = Echoes { turn, amplitude: [&weighted[0], &weighted[1]] };
            sum_over_tones(echoes, offsets, per_metre, sums);
        }
    }
}

/// Sets arrays to `count` zeros.
fn clear_to_zeros<'a>(arrays: impl Iterator<Item = &'a mut Vec<f32>>, count: usize) {
    for array in arrays {
        array.clear();
        array.resize(count, 0.0);
    }
}

impl LossBatch {
    /// Fills the batch with the reflectors `members`, which are at `positions`, relative to `centre`.
    pub(in super::super) fn fill(
        &mut self,
        terms: &LossTerms,
        members: &(impl Iterator<Item = usize> + Clone),
        positions: &[DVec3],
        from_middle: &[f64],
        centre: DVec3,
    ) {
        let padded = positions.len().next_multiple_of(WIDE);
        self.speaker.resize(terms.speaker.len(), Vec::new());
        let arrays = self.away.iter_mut().chain(&mut self.speaker);
        let more = [
            &mut self.from_middle,
            &mut self.spreading,
            &mut self.of_leg,
            &mut self.squares,
            &mut self.differences,
            &mut self.factors,
        ];
        clear_to_zeros(arrays.chain(more), padded);
        for (i, (p, from_middle)) in positions.iter().zip(from_middle).enumerate() {
            for (plane, x) in self.away.iter_mut().zip((*p - centre).to_array()) {
                plane[i] = x as f32;
            }
            self.from_middle[i] = *from_middle as f32;
        }
        for (plane, all) in self.speaker.iter_mut().zip(&terms.speaker) {
            for (factor, j) in plane.iter_mut().zip(members.clone()) {
                *factor = all[j];
            }
        }
    }

    /// Prepares the factors for the microphone, the first of the `ends` of legs from the tile's centre, whose path lengths differ by
    /// `offsets`. `spread_legs` is the number of times that each leg has spreading: none, one or two.
    pub(in super::super) fn set_microphone(&mut self, ends: &[[f32; 3]], offsets: &[f32], spread_legs: f64) {
        let away = [&self.away[0][..], &self.away[1], &self.away[2]];
        self.spreading.fill(1.0);
        // The microphone last, whose angles count.
        for end in ends.iter().rev() {
            return_legs(away, *end, NEAREST_LEG as f32, &mut self.of_leg, &mut self.squares);
            for (spreading, of_leg) in self.spreading.iter_mut().zip(&self.of_leg) {
                *spreading *= match spread_legs as u8 {
                    0 => 1.0,
                    1 => *of_leg,
                    _ => *of_leg * *of_leg,
                };
            }
        }
        for ((difference, from_middle), offset) in
            self.differences.iter_mut().zip(&self.from_middle).zip(offsets)
        {
            *difference = from_middle + offset;
        }
    }

    /// The factors of term `k`.
    pub(in super::super) fn factors(&mut self, terms: &LossTerms, k: usize) -> &[f32] {
        self.factors.copy_from_slice(&self.spreading);
        if let Some(angles) = terms.angles.get(k) {
            angles.multiply(&self.squares, &mut self.factors);
        }
        if let Some(differences) = terms.differences.get(k) {
            differences.multiply(&self.differences, &mut self.factors);
        }
        if let Some(speaker) = self.speaker.get(k) {
            for (factor, speaker) in self.factors.iter_mut().zip(speaker) {
                *factor *= speaker;
            }
        }
        &self.factors
    }
}
