//! Losses by virtual tones: factors that depend on the frequency as a few separable terms.
//!
//! In a group of reflectors the absorption of the middle path is factored out exactly, together with the middle's phase.
//! The remainder, `R(f; p, r) = e^{−α(f)(path − middle)} D D`, is smooth in f. It is interpolated between the K Chebyshev
//! frequencies of the band,
//!
//! `R(f; p, r) = Σ_k L_k(f) R(f_k; p, r) + O(ε)`,
//!
//! so each term is a simulation whose weights are the factor at f_k, and L_k multiplies the weights of the expansion.
//! The error is measured on a grid of path differences, angles and frequencies.

use super::losses::{sine, wave_number};
use super::{Losses, SimulateOptions};
use crate::acquisition::{Instrument, MicArray};
use crate::reflectors::Reflectors;
use crate::wave::interval::chebyshev_point;
use crate::wave::series::Series;
use crate::wave::{Geometry, NEAREST_LEG};
use glam::DVec3;
use rayon::prelude::*;

/// Maximum number of terms; more are no faster than the literal sum.
pub(super) const MOST_TERMS: usize = 24;

/// Frequencies, sines and path differences at which the error is measured.
const FREQUENCIES: usize = 49;
const SINES: usize = 17;
const DIFFERENCES: usize = 5;

/// The loss terms of a simulation.
#[derive(Debug, Clone)]
pub(super) struct LossTerms {
    /// `L_k(f_n)`, `[n_f][K]`.
    shares: Vec<f32>,
    /// Each term's factor as a function of the squared sine at the microphone; empty without directivity there.
    pub(super) angles: Vec<Series>,
    /// Each term's factor as a function of the path relative to the group's middle; empty without absorption.
    pub(super) differences: Vec<Series>,
    /// The speaker's directivity, `[K][n_p]`; empty for an omnidirectional speaker or a monostatic scan.
    pub(super) speaker: Vec<Vec<f32>>,
    /// α(f_n), Np/m; empty without absorption.
    pub(super) absorption: Vec<f64>,
    count: usize,
}

/// Upper bounds of the sines of the angles at the speaker and at the microphones.
fn maximum_sines(reflectors: &Reflectors, array: &MicArray, geometry: &Geometry) -> [f64; 2] {
    let (low, high) = array.bounds();
    let back = reflectors.positions().iter().map(|&p| {
        let far = (p - low).abs().max((p - high).abs());
        let near = (low.z - p.z).max(p.z - high.z).max(0.0);
        sine(DVec3::new(far.x, far.y, near))
    });
    let back = back.fold(0.0, f64::max);
    match *geometry {
        // The speaker takes every place that it has beside a microphone; only sums term by term have its directivity.
        Geometry::Pair { .. } => [1.0, back],
        Geometry::FixedSource { source } => {
            let out = reflectors.positions().iter().map(|&p| sine(p - source)).fold(0.0, f64::max);
            [out, back]
        }
        Geometry::Monostatic => [back, back],
    }
}

/// The losses of a simulation within its band, from which the terms are determined.
#[derive(Debug, Clone)]
pub(super) struct LossModel {
    losses: Losses,
    sines: [f64; 2],
    band: [f64; 2],
    sound_speed: f64,
    monostatic: bool,
}

/// The frequencies between which the losses are interpolated.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct ChebyshevNodes {
    /// f_k, Hz.
    pub(super) nodes: Vec<f64>,
    /// The maximum of `Σ_k |L_k|` in the band.
    pub(super) lebesgue_constant: f64,
}

impl LossModel {
    pub(super) fn new(reflectors: &Reflectors, instrument: &Instrument, options: &SimulateOptions) -> Self {
        let Instrument { sweep, array, geometry, sound_speed, .. } = instrument;
        let losses = options.losses;
        let directed = losses.speaker_radius > 0.0 || losses.microphone_radius > 0.0;
        Self {
            losses,
            sines: if directed { maximum_sines(reflectors, array, geometry) } else { [0.0; 2] },
            band: [sweep.start(), sweep.stop()],
            sound_speed: *sound_speed,
            monostatic: *geometry == Geometry::Monostatic,
        }
    }

    fn chebyshev(&self, count: usize) -> Vec<f64> {
        let [start, stop] = self.band;
        let node = |k: usize| f64::midpoint(start, stop) - 0.5 * (stop - start) * chebyshev_point(k, count);
        (0..count).map(node).collect()
    }

    /// The fewest terms whose error stays within `tolerance` for paths up to `half` m from the middle of their group.
    pub(super) fn chebyshev_nodes(&self, half: f64, tolerance: f64) -> Option<ChebyshevNodes> {
        if !self.losses.vary() {
            return Some(ChebyshevNodes { nodes: self.chebyshev(1), lebesgue_constant: 1.0 });
        }
        let [start, stop] = self.band;
        let dense: Vec<f64> =
            (0..FREQUENCIES).map(|i| start + (stop - start) * i as f64 / (FREQUENCIES - 1) as f64).collect();
        let wanted: Vec<Vec<f64>> = dense.iter().map(|&f| self.samples(f, half)).collect();
        (1..=MOST_TERMS).find_map(|count| {
            let nodes = self.chebyshev(count);
            let known: Vec<Vec<f64>> = nodes.iter().map(|&f| self.samples(f, half)).collect();
            let mut lebesgue_constant = 0.0f64;
            for (f, wanted) in dense.iter().zip(&wanted) {
                let shares = lagrange(&nodes, *f);
                lebesgue_constant = lebesgue_constant.max(shares.iter().map(|s| s.abs()).sum());
                for (i, wanted) in wanted.iter().enumerate() {
                    let got: f64 = shares.iter().zip(&known).map(|(share, known)| share * known[i]).sum();
                    let fine = (got - wanted).abs() <= tolerance;
                    // NaN fails, too.
                    if !fine {
                        return None;
                    }
                }
            }
            Some(ChebyshevNodes { nodes, lebesgue_constant })
        })
    }

    /// R at a frequency for every combination of path differences and sines.
    fn samples(&self, f: f64, half: f64) -> Vec<f64> {
        let even = |i: usize, n: usize| i as f64 / (n - 1) as f64;
        let (absorption, k) = (self.losses.absorption(f), wave_number(f, self.sound_speed));
        let decay = (0..DIFFERENCES).map(|i| (-absorption * half * (2.0 * even(i, DIFFERENCES) - 1.0)).exp());
        let decay: Vec<f64> = if absorption > 0.0 { decay.collect() } else { vec![1.0] };
        let steps = |radius: f64| if radius > 0.0 { SINES } else { 1 };
        let end = |out: Option<usize>, back: Option<usize>| {
            let place = |i: Option<usize>, greatest: f64| i.map_or(0.0, |i| greatest * even(i, SINES));
            self.losses.directivity(k, [place(out, self.sines[0]), place(back, self.sines[1])])
        };
        let directed: Vec<f64> = if self.monostatic {
            (0..SINES).map(|i| end(Some(i), Some(i))).collect()
        } else {
            let out: Vec<f64> = (0..steps(self.losses.speaker_radius)).map(|i| end(Some(i), None)).collect();
            let back = (0..steps(self.losses.microphone_radius)).map(|i| end(None, Some(i)));
            back.flat_map(|back| out.iter().map(move |out| out * back)).collect()
        };
        decay.iter().flat_map(|decay| directed.iter().map(move |directed| decay * directed)).collect()
    }
}

/// `L_k(f)` for the given nodes.
fn lagrange(nodes: &[f64], f: f64) -> Vec<f64> {
    let share = |k: usize| {
        nodes
            .iter()
            .enumerate()
            .filter(|(j, _)| *j != k)
            .map(|(_, other)| (f - other) / (nodes[k] - other))
            .product()
    };
    (0..nodes.len()).map(share).collect()
}

impl LossTerms {
    /// The terms at the nodes; `None` if a factor is not a smooth function of its variable.
    pub(super) fn new(
        chebyshev: &ChebyshevNodes,
        model: &LossModel,
        half: f64,
        reflectors: &Reflectors,
        instrument: &Instrument,
        options: &SimulateOptions,
    ) -> Option<Self> {
        let sweep = &instrument.sweep;
        let losses = options.losses;
        let shares = sweep.frequencies().iter().flat_map(|&f| lagrange(&chebyshev.nodes, f));
        let k = |f: f64| wave_number(f, instrument.sound_speed);
        let own = match instrument.geometry {
            Geometry::FixedSource { source } if losses.speaker_radius > 0.0 => Some(source),
            _ => None,
        };
        let at_microphone =
            Losses { speaker_radius: if model.monostatic { losses.speaker_radius } else { 0.0 }, ..losses };
        let directed = at_microphone.speaker_radius > 0.0 || at_microphone.microphone_radius > 0.0;
        // Slightly larger, because f32 rounds.
        let greatest = (model.sines[1] * model.sines[1] * 1.0001).max(1e-6);
        let mut terms = Self {
            shares: shares.map(|s| s as f32).collect(),
            angles: Vec::new(),
            differences: Vec::new(),
            speaker: Vec::new(),
            absorption: Vec::new(),
            count: chebyshev.nodes.len(),
        };
        for &f in &chebyshev.nodes {
            if directed {
                let factor = |square: f64| at_microphone.directivity(k(f), [square.max(0.0).sqrt(); 2]);
                terms.angles.push(Series::fit(factor, 0.0, greatest)?);
            }
            if losses.air.is_some() {
                let absorption = losses.absorption(f);
                let half = 1.0001 * half;
                terms.differences.push(Series::fit(|d| (-absorption * d).exp(), -half, half)?);
            }
            if let Some(source) = own {
                let alone = Losses { microphone_radius: 0.0, ..losses };
                let directivity = |p: &DVec3| alone.directivity(k(f), [sine(*p - source), 0.0]) as f32;
                terms.speaker.push(reflectors.positions().par_iter().map(directivity).collect());
            }
        }
        if losses.air.is_some() {
            terms.absorption = sweep.frequencies().iter().map(|&f| losses.absorption(f)).collect();
        }
        Some(terms)
    }

    /// K.
    pub(super) fn count(&self) -> usize {
        self.count
    }

    /// Weights `[n_f][Q]` of the tones times the shares: `[n_f][K Q]`.
    pub(super) fn weights(&self, tones: &[f32]) -> Vec<f32> {
        let n_f = self.shares.len() / self.count;
        let mut weights = Vec::with_capacity(tones.len() * self.count);
        for (shares, tones) in
            self.shares.chunks_exact(self.count).zip(tones.chunks_exact(tones.len() / n_f.max(1)))
        {
            weights.extend(shares.iter().flat_map(|share| tones.iter().map(move |w| w * share)));
        }
        weights
    }
}

/// `1 m / d₁`, which does not depend on the microphone; 1 where it does, or without spreading.
pub(super) fn outward_spreading(outward: f64, geometry: &Geometry, options: &SimulateOptions) -> f64 {
    let fixed = matches!(geometry, Geometry::FixedSource { .. });
    if options.losses.spreading && fixed { 1.0 / outward.max(NEAREST_LEG) } else { 1.0 }
}
