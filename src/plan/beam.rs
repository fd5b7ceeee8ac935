//! Sidelobes and grating lobes of any array, from its array factor over the whole band.
//!
//! A reflector seen from the array at the direction sines `u` appears, at the sines `u + Δ`, with the sum over the microphones
//! when each is delayed by `t_r = Δ·r/c`:
//!
//! `B(Δ) = max_τ |Σ_r w_r e^{−i2πf_c t_r} h(τ − t_r)| / Σ_r w_r`,  `h(t) = Σ_f w_f e^{i2π(f − f_c)t} / Σ_f w_f`
//!
//! the maximum over the ranges near the reflector's own, since a grating lobe need not be at the same range. On a lattice of
//! pitch d the pulses line up where Δ is a multiple of λ/d: grating lobes, which a wide band smears along τ. Elsewhere
//! there is no such Δ, and what remains has a mean power of 1/N. The far field of the array is assumed.

mod search;

pub(crate) use search::near_sidelobe_db;
#[cfg(test)]
mod tests;

use super::resolution::Histogram;
use crate::acquisition::Instrument;
use crate::reconstruct::Window;
use crate::wave::simd::double::phasors_f64;
use glam::DVec2;
use num_complex::Complex64;
use serde::Serialize;

/// Places of τ per 1/B.
const PER_CELL: f64 = 4.0;

/// The pulse h is followed this many 1/B to either side; beyond, without a window, it is 26 dB down.
const PULSE: usize = 6;

/// Operations for a microphone's phasor.
const PER_PHASOR: f64 = 20.0;

/// Above this number microphones are drawn together, in so many places along an axis, to find where the main lobe ends.
const MOST_SINGLE: usize = 1 << 14;
const PLACES: usize = 1 << 12;

/// A grating lobe of a lattice of microphones.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[non_exhaustive]
pub struct GratingLobe {
    /// The axis along which the microphones' pitch repeats: 0 is x, 1 is y.
    pub axis: usize,
    /// How many wavelengths the path changes by from microphone to microphone.
    pub order: i32,
    /// Offset Δ from the reflector's own direction sines.
    pub offset: [f64; 2],
    /// Amplitude against the reflector's own, dB.
    pub level_db: f64,
}

/// The array's response outside the main lobe.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Sidelobes {
    /// Largest differences of direction sines along x and y that were searched.
    pub reach: [f64; 2],
    /// What was not searched for, in words, since it would take longer than a plan should; empty where all was.
    pub skipped: Vec<String>,
    /// Largest amplitude outside the main lobe at any range, dB; `None` where nothing lies outside of it.
    pub peak_db: Option<f64>,
    /// Where it is, as an offset of direction sines.
    pub peak_offset: [f64; 2],
    /// Mean power outside the main lobe at the centre frequency, dB: about −10 log₁₀ N for N scattered microphones.
    pub mean_db: Option<f64>,
    /// Grating lobes within the reach, both signs of an order being alike.
    #[serde(rename = "ghosts")]
    pub grating_lobes: Vec<GratingLobe>,
}

/// An array factor, prepared for evaluation in any direction.
#[derive(Debug)]
pub struct Beam {
    /// Microphones' places about the centre and weights; the weights' sum is 1.
    microphones: Vec<(DVec2, f64)>,
    /// The same for a lattice, with every row and column drawn together.
    columns: Option<[Vec<(DVec2, f64)>; 2]>,
    /// Legs/c, s/m.
    slowness: f64,
    centre: f64,
    bandwidth: f64,
    /// h at multiples of 1/(4 B); empty for one tone.
    pulse: Vec<f64>,
    /// Wavelengths per pitch along each axis of a lattice, at the highest and the lowest frequency.
    gratings: [Option<[f64; 2]>; 2],
    /// Where the main lobe ends along x and y.
    lobe: [f64; 2],
    /// First to last microphone, m.
    extent: DVec2,
}

impl Beam {
    /// The array factor of an instrument with the weights of a window.
    pub fn new(instrument: &Instrument, window: Window) -> Self {
        let (array, sweep) = (&instrument.array, &instrument.sweep);
        let centre = array.centre().truncate();
        let weights = window.over_array(array);
        let total: f64 = weights.iter().sum();
        let microphones: Vec<(DVec2, f64)> =
            array.positions().iter().zip(weights).map(|(r, w)| (r.truncate() - centre, w / total)).collect();
        let columns = array.lattice().map(|lattice| {
            let mut along =
                [vec![(DVec2::ZERO, 0.0); lattice.x.count], vec![(DVec2::ZERO, 0.0); lattice.y.count]];
            for (i, (r, w)) in microphones.iter().enumerate() {
                let (ix, iy) = (i % lattice.x.count, i / lattice.x.count);
                along[0][ix] = (DVec2::new(r.x, 0.0), along[0][ix].1 + w);
                along[1][iy] = (DVec2::new(0.0, r.y), along[1][iy].1 + w);
            }
            along
        });
        let slowness = instrument.geometry.scanned_legs() / instrument.sound_speed;
        let gratings = [0, 1].map(|axis| {
            let lattice = array.lattice()?;
            let axis = [lattice.x, lattice.y][axis];
            (axis.count > 1).then(|| [sweep.stop(), sweep.start()].map(|f| 1.0 / (slowness * f * axis.pitch)))
        });
        let mut beam = Self {
            microphones,
            columns,
            slowness,
            centre: sweep.centre(),
            bandwidth: sweep.bandwidth(),
            pulse: Vec::new(),
            gratings,
            lobe: [f64::INFINITY; 2],
            extent: DVec2::ZERO,
        };
        if beam.bandwidth > 0.0 {
            let over_sweep = window.over_sweep(sweep);
            let total: f64 = over_sweep.iter().sum();
            let reach = PULSE * PER_CELL as usize;
            let mut phasors = vec![Complex64::ZERO; sweep.len()];
            let later: Vec<f64> = (0..=reach)
                .map(|i| {
                    let t = i as f64 / (PER_CELL * beam.bandwidth);
                    let cycles: Vec<f64> =
                        sweep.frequencies().iter().map(|f| (f - beam.centre) * t).collect();
                    phasors_f64(&cycles, &mut phasors);
                    phasors.iter().zip(&over_sweep).map(|(phasor, w)| w * phasor.re).sum::<f64>() / total
                })
                .collect();
            // Only its real part is followed, which is even.
            beam.pulse = later.iter().skip(1).rev().chain(&later).copied().collect();
        }
        let extent = array.extent();
        beam.extent = DVec2::new(extent.x, extent.y);
        beam.lobe = [DVec2::X, DVec2::Y].map(|axis| beam.main_lobe(axis));
        beam
    }

    /// Where the main lobe ends along an axis, at the centre frequency and with a little to spare.
    fn main_lobe(&self, axis: DVec2) -> f64 {
        let extent = self.extent.dot(axis);
        if extent <= 0.0 {
            return f64::INFINITY;
        }
        let microphones = self.microphones_along(axis);
        let drawn = (microphones.len() > MOST_SINGLE).then(|| {
            let along = microphones.iter().map(|(r, w)| (r.dot(axis), *w));
            let drawn = Histogram::of(PLACES, along);
            drawn.entries().map(|(r, w)| (r * axis, w)).collect::<Vec<_>>()
        });
        let microphones = drawn.as_deref().unwrap_or(microphones);
        let step = 0.05 / (self.slowness * self.centre * extent);
        let mut before = 1.0;
        for i in 1..400 {
            let amplitude = self.sum_at_centre(microphones, f64::from(i) * step * axis);
            if amplitude > before && before < 0.5 {
                return 1.2 * f64::from(i - 1) * step;
            }
            before = amplitude;
        }
        f64::INFINITY
    }

    /// Where the main lobe ends along x and y, as offsets of direction sines.
    pub fn lobe(&self) -> [f64; 2] {
        self.lobe
    }

    /// Whether an offset lies within the main lobe.
    pub fn is_main_lobe(&self, offset: DVec2) -> bool {
        (offset.x / self.lobe[0]).powi(2) + (offset.y / self.lobe[1]).powi(2) < 1.0
    }

    /// The microphones that matter in a direction: a lattice's columns or rows along its own axes.
    fn microphones_along(&self, offset: DVec2) -> &[(DVec2, f64)] {
        match &self.columns {
            Some([x, _]) if offset.y == 0.0 => x,
            Some([_, y]) if offset.x == 0.0 => y,
            _ => &self.microphones,
        }
    }

    /// |B| of the centre frequency alone.
    fn at_centre(&self, offset: DVec2) -> f64 {
        self.sum_at_centre(self.microphones_along(offset), offset)
    }

    fn sum_at_centre(&self, microphones: &[(DVec2, f64)], offset: DVec2) -> f64 {
        self.arrivals(microphones, offset).into_iter().sum::<Complex64>().norm()
    }

    /// What microphones hear of the centre frequency, each by its weight.
    fn arrivals(&self, microphones: &[(DVec2, f64)], offset: DVec2) -> Vec<Complex64> {
        let per_metre = -self.centre * self.slowness * offset;
        let cycles: Vec<f64> = microphones.iter().map(|(r, _)| per_metre.dot(*r)).collect();
        let mut arrivals = vec![Complex64::ZERO; cycles.len()];
        phasors_f64(&cycles, &mut arrivals);
        arrivals.iter_mut().zip(microphones).for_each(|(arrival, (_, w))| *arrival *= w);
        arrivals
    }

    /// Operations of [`Beam::strength`] and [`Beam::at_centre`]: for their microphones, and by the places of τ per offset of
    /// direction sines along x and y.
    fn work(&self, microphones: usize) -> (f64, DVec2) {
        let taps = self.pulse.len() as f64;
        let per_sine = taps * PER_CELL * self.bandwidth * self.slowness * self.extent;
        (2.0 * PER_PHASOR * microphones as f64 + 2.0 * taps, per_sine)
    }

    /// The same at one offset.
    fn work_at(&self, offset: DVec2) -> f64 {
        let (fixed, per_sine) = self.work(self.microphones_along(offset).len());
        fixed + per_sine.dot(offset.abs())
    }

    /// B(Δ) of the module's head, 1 at Δ = 0. Cost: microphones, and 200 operations per 1/B of delay.
    pub fn strength(&self, offset: DVec2) -> f64 {
        if self.pulse.is_empty() {
            return self.at_centre(offset);
        }
        let microphones = self.microphones_along(offset);
        let late = |r: DVec2| self.slowness * offset.dot(r);
        let (first, last) =
            microphones.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), (r, _)| {
                (low.min(late(*r)), high.max(late(*r)))
            });
        let rate = PER_CELL * self.bandwidth;
        let places = ((last - first) * rate) as usize + 2;
        let mut sums = vec![Complex64::ZERO; places];
        for ((r, _), arrival) in microphones.iter().zip(self.arrivals(microphones, offset)) {
            let place = (late(*r) - first) * rate;
            let i = (place as usize).min(places - 2);
            let share = place - i as f64;
            sums[i] += arrival * (1.0 - share);
            sums[i + 1] += arrival * share;
        }
        let reach = self.pulse.len() / 2;
        (0..places)
            .map(|at| {
                let (low, high) = (at.saturating_sub(reach), (at + reach + 1).min(places));
                let taps = &self.pulse[low + reach - at..];
                sums[low..high].iter().zip(taps).map(|(sum, h)| sum * h).sum::<Complex64>().norm_sqr()
            })
            .fold(0.0, f64::max)
            .sqrt()
    }
}
