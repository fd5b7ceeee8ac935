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

#[cfg(test)]
mod tests;

use crate::acquisition::Instrument;
use crate::reconstruct::Window;
use glam::DVec2;
use num_complex::Complex64;
use rayon::prelude::*;
use serde::Serialize;
use std::f64::consts::TAU;

/// Places of τ per 1/B.
const PER_CELL: f64 = 4.0;

/// The pulse h is followed this many 1/B to either side; beyond, without a window, it is 26 dB down.
const PULSE: usize = 6;

/// Most microphones times directions that are evaluated; with more, directions are farther apart.
const MOST_TERMS: f64 = 1.2e8;

/// Highest order of grating lobes that is searched for.
const ORDERS: i32 = 2;

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
        let slowness = instrument.geometry.return_legs() / instrument.sound_speed;
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
        };
        if beam.bandwidth > 0.0 {
            let over_sweep = window.over_sweep(sweep);
            let total: f64 = over_sweep.iter().sum();
            let reach = PULSE * PER_CELL as usize;
            beam.pulse = (0..=2 * reach)
                .map(|i| {
                    let t = (i as f64 - reach as f64) / (PER_CELL * beam.bandwidth);
                    let tones = sweep.frequencies().iter().zip(&over_sweep);
                    tones.map(|(f, w)| w * (TAU * (f - beam.centre) * t).cos()).sum::<f64>() / total
                })
                .collect();
        }
        let extent = array.extent();
        beam.lobe =
            [(DVec2::X, extent.x), (DVec2::Y, extent.y)].map(|(axis, extent)| beam.main_lobe(axis, extent));
        beam
    }

    /// Where the main lobe ends along an axis, at the centre frequency and with a little to spare.
    fn main_lobe(&self, axis: DVec2, extent: f64) -> f64 {
        if extent <= 0.0 {
            return f64::INFINITY;
        }
        let step = 0.05 / (self.slowness * self.centre * extent);
        let mut before = 1.0;
        for i in 1..400 {
            let amplitude = self.at_centre(f64::from(i) * step * axis);
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
        let sum: Complex64 = self
            .microphones_along(offset)
            .iter()
            .map(|(r, w)| Complex64::from_polar(*w, -TAU * self.centre * self.slowness * offset.dot(*r)))
            .sum();
        sum.norm()
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
        let mut arrivals = vec![Complex64::ZERO; places];
        for (r, w) in microphones {
            let t = late(*r);
            let place = (t - first) * rate;
            let i = (place as usize).min(places - 2);
            let share = place - i as f64;
            let arrival = Complex64::from_polar(*w, -TAU * self.centre * t);
            arrivals[i] += arrival * (1.0 - share);
            arrivals[i + 1] += arrival * share;
        }
        let reach = self.pulse.len() / 2;
        (0..places)
            .map(|at| {
                let (low, high) = (at.saturating_sub(reach), (at + reach + 1).min(places));
                let taps = &self.pulse[low + reach - at..];
                arrivals[low..high].iter().zip(taps).map(|(a, h)| a * h).sum::<Complex64>().norm_sqr()
            })
            .fold(0.0, f64::max)
            .sqrt()
    }

    /// The grating lobes within `reach` of a reflector, stronger than −60 dB; of each order the positive side.
    pub fn grating_lobes(&self, reach: [f64; 2]) -> Vec<GratingLobe> {
        let mut grating_lobes = Vec::new();
        for (axis, unit) in [DVec2::X, DVec2::Y].into_iter().enumerate() {
            let Some([short, long]) = self.gratings[axis] else { continue };
            for order in 1..=ORDERS {
                // With a wide band the strongest place lies anywhere between the shortest wavelength's and the longest's.
                let (low, high) =
                    (0.97 * f64::from(order) * short, (1.03 * f64::from(order) * long).min(reach[axis]));
                if low > high || low < self.lobe[axis] {
                    continue;
                }
                let step = self.lobe[axis].min(high) / 12.0;
                let offsets = (0..=((high - low) / step) as usize).map(|i| low + i as f64 * step);
                let strongest = offsets
                    .map(|offset| (offset, self.strength(offset * unit)))
                    .max_by(|a, b| a.1.total_cmp(&b.1));
                if let Some((offset, strength)) = strongest.filter(|(_, strength)| *strength > 1e-3) {
                    let level_db = 20.0 * strength.log10();
                    grating_lobes.push(GratingLobe {
                        axis,
                        order,
                        offset: (offset * unit).to_array(),
                        level_db,
                    });
                }
            }
        }
        grating_lobes
    }

    /// Everything outside the main lobe, up to `reach` of direction sines along x and y.
    ///
    /// Cost: up to 10⁸ terms of [`Beam::strength`], so a fraction of a second.
    pub fn sidelobes(&self, reach: [f64; 2]) -> Sidelobes {
        let offsets = self.offsets(reach);
        let values: Vec<[f64; 2]> = offsets
            .par_iter()
            .map(|offset| [self.strength(*offset), self.at_centre(*offset).powi(2)])
            .collect();
        let peak = offsets.iter().zip(&values).map(|(o, [s, _])| (*o, *s)).max_by(|a, b| a.1.total_cmp(&b.1));
        let peak = peak.map(|(offset, strength)| self.refined(offset, strength, reach));
        let decibels = |amplitude: f64| 20.0 * amplitude.max(1e-10).log10();
        Sidelobes {
            reach,
            peak_db: peak.map(|(_, strength)| decibels(strength)),
            peak_offset: peak.map_or([0.0; 2], |(offset, _)| offset.to_array()),
            mean_db: self.mean_power(reach, &values).map(|power| decibels(power.sqrt())),
            grating_lobes: self.grating_lobes(reach),
        }
    }

    /// Distance of evaluated directions along x and y: at most half a lobe.
    fn steps(&self, reach: [f64; 2]) -> [f64; 2] {
        [0, 1].map(|axis| (0.25 * self.lobe[axis]).min(reach[axis].max(1e-9)))
    }

    /// The directions to evaluate, outside the main lobe. A lattice's strongest sidelobes lie along its axes; elsewhere the
    /// half plane y ≥ 0 is enough, since B(−Δ) = B(Δ).
    fn offsets(&self, reach: [f64; 2]) -> Vec<DVec2> {
        let mut steps = self.steps(reach);
        let along =
            |axis: usize, step: f64| (1..=(reach[axis] / step) as usize).map(move |i| i as f64 * step);
        let mut offsets: Vec<DVec2> = if self.columns.is_some() {
            let x = along(0, steps[0] / 4.0).map(|u| DVec2::new(u, 0.0));
            x.chain(along(1, steps[1] / 4.0).map(|v| DVec2::new(0.0, v))).collect()
        } else {
            let count = |steps: [f64; 2]| 2.0 * (reach[0] / steps[0] + 1.0) * (reach[1] / steps[1] + 1.0);
            let coarser = (count(steps) * self.microphones.len() as f64 / MOST_TERMS).sqrt().max(1.0);
            steps = steps.map(|step| step * coarser);
            let columns = (reach[0] / steps[0]) as i64;
            (0..=(reach[1] / steps[1]) as i64)
                .flat_map(|iy| (-columns..=columns).map(move |ix| (ix, iy)))
                .map(|(ix, iy)| DVec2::new(ix as f64 * steps[0], iy as f64 * steps[1]))
                .collect()
        };
        offsets.retain(|offset| !self.is_main_lobe(*offset));
        offsets
    }

    /// The strongest direction near one, by ever finer steps.
    fn refined(&self, mut best: DVec2, mut strength: f64, reach: [f64; 2]) -> (DVec2, f64) {
        let mut step = DVec2::from(self.steps(reach)) * 0.5;
        let on_axis = self.columns.is_some();
        for _ in 0..3 {
            let middle = best;
            for (x, y) in (-2..=2).flat_map(|y| (-2..=2).map(move |x| (x, y))) {
                let offset = middle + step * DVec2::new(f64::from(x), f64::from(y)) * 0.5;
                let leaves = on_axis && (offset.x != 0.0 && offset.y != 0.0);
                let outside = offset.x.abs() > reach[0] || offset.y.abs() > reach[1];
                if leaves || outside || self.is_main_lobe(offset) {
                    continue;
                }
                let found = self.strength(offset);
                if found > strength {
                    (best, strength) = (offset, found);
                }
            }
            step *= 0.5;
        }
        (best, strength)
    }

    /// Mean power at the centre frequency outside the main lobe; of a lattice from the product of its two axes.
    fn mean_power(&self, reach: [f64; 2], values: &[[f64; 2]]) -> Option<f64> {
        if self.columns.is_none() {
            return (!values.is_empty())
                .then(|| values.iter().map(|[_, power]| power).sum::<f64>() / values.len() as f64);
        }
        let steps = self.steps(reach);
        let axis = |axis: usize, unit: DVec2| -> Vec<(f64, f64)> {
            let count = ((reach[axis] / steps[axis]) as usize).min(2000);
            let step = if count > 0 { reach[axis] / count as f64 } else { 0.0 };
            (0..=count).map(|i| i as f64 * step).map(|u| (u, self.at_centre(u * unit).powi(2))).collect()
        };
        let (x, y) = (axis(0, DVec2::X), axis(1, DVec2::Y));
        let (mut sum, mut count) = (0.0, 0_usize);
        for (v, of_y) in &y {
            for (u, of_x) in &x {
                if !self.is_main_lobe(DVec2::new(*u, *v)) {
                    (sum, count) = (sum + of_x * of_y, count + 1);
                }
            }
        }
        (count > 0).then(|| sum / count as f64)
    }
}
