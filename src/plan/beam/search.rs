//! The search for grating lobes and sidelobes, within a fixed number of operations: a plan takes no longer for an absurd
//! array than for a usual one, and says what was left out.

use super::{Beam, GratingLobe, PER_PHASOR, Sidelobes};
use crate::acquisition::Instrument;
use crate::reconstruct::Window;
use glam::DVec2;
use rayon::prelude::*;

/// Most operations of a search along one axis of a lattice, and of one over all directions of other arrays, about; they take
/// a fraction of a second. With the counters of a fuzzer each takes a hundred times as long.
const MOST_ALONG: f64 = if cfg!(fuzzing) { 2e5 } else { 2e8 };
pub(super) const MOST_AROUND: f64 = 5.0 * MOST_ALONG;

/// How many times as far apart as half a lobe directions may be for the strongest sidelobe to be told.
pub(super) const COARSEST: f64 = 4.0;

/// Highest order of grating lobes that is searched for.
const ORDERS: i32 = 2;

/// How far from a reflector sidelobes are near, in lateral resolutions.
const NEAR: f64 = 3.0;

/// A depth at which lateral resolutions are those of the far field, m.
const FAR: f64 = 1e9;

/// The strongest sidelobe near a reflector, dB; `None` for an array that has none there.
///
/// Cost: a few dozen directions.
pub(crate) fn near_sidelobe_db(instrument: &Instrument, window: Window) -> Option<f64> {
    let lobes = instrument.aperture().lateral_resolution(FAR);
    let reach = lobes.map(|lobe| NEAR * lobe.unwrap_or(0.0) / FAR);
    Beam::new(instrument, window).sidelobes(reach).peak_db
}

impl Beam {
    /// The grating lobes within `reach` of a reflector, stronger than −60 dB; of each order the positive side. An order that
    /// would take too long to search for is left out.
    pub fn grating_lobes(&self, reach: [f64; 2]) -> Vec<GratingLobe> {
        self.found_and_skipped(reach).0
    }

    /// The grating lobes, and which orders were left out.
    fn found_and_skipped(&self, reach: [f64; 2]) -> (Vec<GratingLobe>, Vec<String>) {
        let (mut grating_lobes, mut skipped) = (Vec::new(), Vec::new());
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
                if ((high - low) / step + 1.0) * self.work_at(high * unit) > MOST_ALONG {
                    let name = ["x", "y"][axis];
                    skipped.push(format!("the strength of grating lobes of order {order} along {name}"));
                    continue;
                }
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
        (grating_lobes, skipped)
    }

    /// Everything outside the main lobe, up to `reach` of direction sines along x and y.
    ///
    /// Cost: a fraction of a second. What would take longer is left out, and [`Sidelobes::skipped`] says so: of a lattice the
    /// offsets far from the main lobe; of other arrays directions between others, and with very few the strongest.
    pub fn sidelobes(&self, reach: [f64; 2]) -> Sidelobes {
        let (grating_lobes, mut skipped) = self.found_and_skipped(reach);
        let within = reach;
        let coarser = self.coarser(reach);
        let reach = if self.columns.is_some() { self.affordable(reach) } else { reach };
        for (axis, name) in
            ["x", "y"].into_iter().enumerate().filter(|(axis, _)| reach[*axis] < within[*axis])
        {
            let (most, of) = (reach[axis], within[axis]);
            skipped.push(format!("sidelobes beyond {most:.2e} of {of:.2} in direction sines along {name}"));
        }
        let offsets = self.offsets(reach, coarser);
        let told = if coarser <= COARSEST { &offsets[..] } else { &[] };
        let strengths: Vec<f64> = told.par_iter().map(|offset| self.strength(*offset)).collect();
        let strongest = told.iter().copied().zip(strengths).max_by(|a, b| a.1.total_cmp(&b.1));
        let peak = strongest.map(|(offset, strength)| {
            // Fewer than 75 directions more.
            let little = 75.0 * self.work_at(offset) <= MOST_ALONG;
            if little { self.refined(offset, strength, reach) } else { (offset, strength) }
        });
        if coarser > COARSEST {
            skipped.push("the strongest sidelobe".to_owned());
        } else if coarser > 1.0 {
            skipped.push(format!("directions between others that are {:.1} lobes apart", 0.5 * coarser));
        }
        let decibels = |amplitude: f64| 20.0 * amplitude.max(1e-10).log10();
        Sidelobes {
            reach,
            peak_db: peak.map(|(_, strength)| decibels(strength)),
            peak_offset: peak.map_or([0.0; 2], |(offset, _)| offset.to_array()),
            mean_db: self.mean_power(within, &offsets).map(|power| decibels(power.sqrt())),
            grating_lobes,
            skipped,
        }
    }

    /// Distance of evaluated directions along x and y: at most half a lobe.
    fn steps(&self, reach: [f64; 2]) -> [f64; 2] {
        [0, 1].map(|axis| (0.25 * self.lobe[axis]).min(reach[axis].max(1e-9)))
    }

    /// How far from the main lobe the axes of a lattice can be searched, as direction sines.
    pub(super) fn affordable(&self, reach: [f64; 2]) -> [f64; 2] {
        let Some(columns) = &self.columns else { return reach };
        let steps = self.steps(reach);
        std::array::from_fn(|axis| {
            let step = steps[axis] / 4.0;
            let (fixed, per_sine) = self.work(columns[axis].len());
            // n directions take `fixed·n + per_sine·step·n²/2`.
            let (square, linear) = (0.5 * per_sine[axis] * step, 0.5 * fixed);
            let most = MOST_ALONG / (linear + (linear * linear + square * MOST_ALONG).sqrt());
            if reach[axis] / step <= most { reach[axis] } else { most.floor() * step }
        })
    }

    /// How many times as far apart as half a lobe the directions have to be, of arrays that are no lattices.
    pub(super) fn coarser(&self, reach: [f64; 2]) -> f64 {
        if self.columns.is_some() {
            return 1.0;
        }
        let steps = self.steps(reach);
        let count = 2.0 * (reach[0] / steps[0] + 1.0) * (reach[1] / steps[1] + 1.0);
        let work = self.work_at(0.5 * DVec2::from(reach));
        (count * work / MOST_AROUND).sqrt().max(1.0)
    }

    /// The directions to evaluate, outside the main lobe. A lattice's strongest sidelobes lie along its axes; elsewhere the
    /// half plane y ≥ 0 is enough, since B(−Δ) = B(Δ).
    pub(super) fn offsets(&self, reach: [f64; 2], coarser: f64) -> Vec<DVec2> {
        let mut steps = self.steps(reach);
        let along =
            |axis: usize, step: f64| (1..=(reach[axis] / step) as usize).map(move |i| i as f64 * step);
        let mut offsets: Vec<DVec2> = if self.columns.is_some() {
            let x = along(0, steps[0] / 4.0).map(|u| DVec2::new(u, 0.0));
            x.chain(along(1, steps[1] / 4.0).map(|v| DVec2::new(0.0, v))).collect()
        } else {
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
            let offset = |(x, y): (i32, i32)| middle + step * DVec2::new(f64::from(x), f64::from(y)) * 0.5;
            let around: Vec<DVec2> = (-2..=2)
                .flat_map(|y| (-2..=2).map(move |x| (x, y)))
                .map(offset)
                .filter(|offset| {
                    let leaves = on_axis && (offset.x != 0.0 && offset.y != 0.0);
                    let outside = offset.x.abs() > reach[0] || offset.y.abs() > reach[1];
                    !leaves && !outside && !self.is_main_lobe(*offset)
                })
                .collect();
            let found: Vec<f64> = around.par_iter().map(|offset| self.strength(*offset)).collect();
            for (offset, found) in around.into_iter().zip(found) {
                if found > strength {
                    (best, strength) = (offset, found);
                }
            }
            step *= 0.5;
        }
        (best, strength)
    }

    /// Mean power at the centre frequency outside the main lobe; of a lattice from the product of its two axes.
    fn mean_power(&self, reach: [f64; 2], offsets: &[DVec2]) -> Option<f64> {
        if self.columns.is_none() {
            // Collected first, so that the sum does not depend on the number of threads.
            let powers: Vec<f64> = offsets.par_iter().map(|offset| self.at_centre(*offset).powi(2)).collect();
            return (!powers.is_empty()).then(|| powers.iter().sum::<f64>() / powers.len() as f64);
        }
        let steps = self.steps(reach);
        let axis = |axis: usize, unit: DVec2| -> Vec<(f64, f64)> {
            let along = self.microphones_along(unit).len() as f64;
            let most = (MOST_ALONG / (PER_PHASOR * along)).clamp(1.0, 2000.0) as usize;
            let count = ((reach[axis] / steps[axis]) as usize).min(most);
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
