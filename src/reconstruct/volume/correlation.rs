//! Correlation imaging: the phases between pairs of microphones, without that of the loudspeaker.
//!
//! `P(p) = Σ_g Σ_{r≠r'} x_g(p, r) x_g*(p, r') / Σ_g (W_g² − V_g)` with `x_g(p, r) = Σ_{f∈g} w_f w_r m(f, r) e^{−i2πf·path(p, r)/c}`
//!
//! over sub-bands g of neighbouring tones (several loudspeakers have their own), `W_g = Σ_f w_f Σ_r w_r` and
//! `V_g = (Σ_f w_f)² Σ_r w_r²`, so that a unit reflector on a voxel peaks at 1. The voxel is `√P`, and 0 where P is negative.
//! A phase that a whole sub-band has in common cancels. In sub-bands of one tone so does the way out, `e^{−i2πf|p − s|/c}`:
//! what is left is the cross-spectral matrix `m(f, r) m*(f, r')`, steered with the ways back alone.
//!
//! `Σ_{r≠r'} x x'* = |Σ_r x|² − Σ_r |x|²` makes the sum over pairs a coherent image for each sub-band, by any method. The
//! diagonal is constant for sub-bands of one tone; for others it is what each microphone sees by itself,
//! `Σ_f |y|² + 2 Re Σ_d e^{−i2πdδf·path/c} Σ_f y(f + d) y*(f)` with `y = w_f w_r m`: one more image, of difference frequencies, of
//! all sub-bands together.

mod depth_resolution;
mod pairs;

use super::parts::{PartOfGrid, in_slabs};
use super::transmissions::end_slabs;
use super::{Checked, Compensated, Gain};
use crate::acquisition::{CubeSource, CubeView, Instrument};
use crate::alloc::{try_filled, try_zeroed};
use crate::error::Result;
use crate::grid::{Grid, no_room_for};
use crate::progress::Observer;
use crate::reconstruct::plan::{Candidates, Estimate, Estimates, estimate};
use crate::reconstruct::{Method, ReconstructOptions, ReconstructionInfo, VolumeSink};
use num_complex::Complex32;
use pairs::{MicrophonePairs, PairSums, measure};
use serde::Serialize;
use std::sync::OnceLock;

/// How the microphones' signals are correlated, and what that tells of depth.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Correlation {
    /// Tones that are summed with their phases before pairs are formed; 1 for every tone by itself.
    pub sub_band: usize,
    /// Sub-bands of each loudspeaker; the last may have fewer tones.
    pub sub_bands: usize,
    /// What can be told apart in depth at the nearest and farthest voxels before the array's middle, m: the width of a point
    /// at 2/π of its amplitude, which is c/2B for a coherent image.
    pub depth_resolution: [f64; 2],
}

impl Correlation {
    /// That of the options, if they ask for one.
    pub fn of(instrument: &Instrument, grid: &Grid, options: &ReconstructOptions) -> Option<Self> {
        if options.method != Method::Correlation {
            return None;
        }
        let sub_band = options.sub_band.clamp(1, instrument.sweep.len());
        let at = |z: f64| depth_resolution::depth_resolution(instrument, z, sub_band);
        let depth_resolution = [at(grid.z.first), at(grid.z.last())];
        Some(Self { sub_band, sub_bands: instrument.sweep.len().div_ceil(sub_band), depth_resolution })
    }

    /// What can be told apart in the middle of the grid, m.
    pub fn mean_resolution(&self) -> f64 {
        f64::midpoint(self.depth_resolution[0], self.depth_resolution[1])
    }
}

/// As in `correlation of 501 sub-bands of 1 tone each; 73.1 to 210.4 mm in depth, near to far`.
impl std::fmt::Display for Correlation {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let [near, far] = self.depth_resolution.map(|length| 1e3 * length);
        let tones = if self.sub_band == 1 { "tone" } else { "tones" };
        write!(
            f,
            "pairs of microphones in {} sub-bands of {} {tones}; {near:.1} to {far:.1} mm in depth, near to far",
            self.sub_bands, self.sub_band
        )
    }
}

/// The volume `√P` of a cube.
///
/// # Errors
/// Those of [`MicrophonePairs::new`], and of a coherent image of a sub-band.
pub(in crate::reconstruct) fn correlate(
    source: &mut dyn CubeSource,
    grid: &Grid,
    options: &ReconstructOptions,
    sink: &mut dyn VolumeSink,
    observer: &dyn Observer,
) -> Result<ReconstructionInfo> {
    let instrument = source.instrument().clone();
    let pairs = MicrophonePairs::new(&instrument, options)?.holding(grid);
    let middle = pairs.of_band(0, pairs.middle())?;
    let threads = rayon::current_num_threads();
    let candidates = Candidates::new(&middle, grid, &pairs.options, threads)?;
    let method = candidates.chosen(Method::Auto).method;
    if let (_, Some(warning)) = candidates.choose(&middle, grid, Method::Auto)? {
        observer.warn(&warning);
    }
    let of_differences = match pairs.of_differences(0)? {
        Some(differences) => {
            let candidates = Candidates::new(&differences, grid, &pairs.options, threads)?;
            candidates.chosen(Method::Auto).method
        }
        None => method,
    };
    let measured = measure(source, &pairs)?;
    let info = info(&pairs, &measured, (method, of_differences), (grid, options));
    let level = info.incoherent_level.map(OnceLock::from);
    let gain = options.compensate.then(|| Gain::new(&instrument, grid));
    let sink: &mut dyn VolumeSink = &mut Checked { grid: *grid, incoherent_level: level.as_ref(), sink };
    let sink: &mut dyn VolumeSink = &mut Compensated::new(gain, sink);
    sink.begin(&info)?;
    let images = instrument.transmissions() * (pairs.bands() + usize::from(pairs.tones > 1));
    in_slabs(grid, sink, ("correlating", images), observer, &mut |part| {
        let powers = powers(part, &pairs, source, &measured, (method, of_differences))?;
        let mut planes: Vec<Complex32> =
            try_zeroed(part.grid.voxel_count()).ok_or_else(|| no_room_for(grid))?;
        planes.iter_mut().zip(powers).for_each(|(a, power)| a.re = power.max(0.0).sqrt() as f32);
        Ok(planes)
    })?;
    Ok(gain.map_or(info, |gain| gain.info(&info)))
}

/// What is known before the first depth: the bound on the error and the level of the samples.
fn info(
    pairs: &MicrophonePairs,
    measured: &PairSums,
    (method, of_differences): (Method, Method),
    (grid, options): (&Grid, &ReconstructOptions),
) -> ReconstructionInfo {
    // A sub-band's sum S errs by E, to within the tolerance of its moduli M >= |S|, and |S|² by no more than 2 M E + E².
    let tolerance = |method: Method| if method == Method::Direct { 0.0 } else { options.tolerance };
    let error = tolerance(method);
    let of_diagonal: f64 =
        measured.differences.iter().flatten().map(|sum| f64::from(sum.norm())).sum::<f64>() * 2.0;
    let power = (2.0 * error + error * error) * measured.moduli + tolerance(of_differences) * of_diagonal;
    let level = (!options.compensate).then(|| (measured.random.sqrt() / pairs.norm).sqrt());
    ReconstructionInfo {
        incoherent_level: level,
        correlation: Correlation::of(pairs.instrument, grid, options),
        ..ReconstructionInfo::plain(Method::Correlation, (power / pairs.norm).sqrt())
    }
}

/// P of the voxels of a part of the grid.
fn powers(
    part: &PartOfGrid<'_>,
    pairs: &MicrophonePairs,
    source: &mut dyn CubeSource,
    measured: &PairSums,
    (method, of_differences): (Method, Method),
) -> Result<Vec<f64>> {
    let n_mic = pairs.of_array.len();
    let constant: f64 = measured.powers.iter().sum::<f64>() / pairs.norm;
    let count = part.grid.voxel_count();
    let mut powers = try_filled(-constant, count).ok_or_else(|| no_room_for(&part.grid))?;
    let mut y = Vec::new();
    for transmission in 0..pairs.instrument.transmissions() {
        source.visit_transmission(transmission, pairs.tones, &mut |range, samples| {
            let instrument = pairs.of_band(transmission, range.clone())?;
            // Of the mean that an image is, the sum.
            let times = ((range.len() * n_mic) as f64).powi(2) / pairs.norm;
            pairs.weighted(range, samples, &mut y);
            let band = CubeView::new(&instrument, &y)?;
            part.add((method, &pairs.options), band, &mut powers, |power, a| {
                *power += times * (f64::from(a.re).powi(2) + f64::from(a.im).powi(2));
            })
        })?;
        let Some(instrument) = pairs.of_differences(transmission)? else { continue };
        let times = -2.0 * ((pairs.tones - 1) * n_mic) as f64 / pairs.norm;
        let differences = CubeView::new(&instrument, &measured.differences[transmission])?;
        part.add((of_differences, &pairs.options), differences, &mut powers, |power, a| {
            *power += times * f64::from(a.re);
        })?;
    }
    Ok(powers)
}

/// What a correlation takes: as many images as there are sub-bands and, for the diagonal, another one.
pub(in crate::reconstruct) fn estimate_of_correlation(
    instrument: &Instrument,
    grid: &Grid,
    options: &ReconstructOptions,
    threads: usize,
) -> Result<Estimates> {
    let pairs = MicrophonePairs::new(instrument, options)?.holding(grid);
    let chosen = |instrument: &Instrument, grid: &Grid| -> Result<Estimate> {
        Ok(estimate(instrument, grid, &pairs.options, threads)?.chosen().clone())
    };
    let mut images = vec![pairs.of_band(0, pairs.middle())?];
    let of_band = chosen(&images[0], grid)?;
    let mut operations = of_band.operations * pairs.bands() as f64;
    if let Some(differences) = pairs.of_differences(0)? {
        let products = instrument.cube_bytes() as f64 * pairs.tones as f64 / 2.0;
        operations += chosen(&differences, grid)?.operations + products;
        images.push(differences);
    }
    let mut bytes = 0;
    for part in end_slabs(grid) {
        for image in &images {
            bytes = bytes.max(chosen(image, &part)?.bytes);
        }
    }
    let correlation = Estimate {
        method: Method::Correlation,
        operations: operations * instrument.transmissions() as f64,
        bytes: bytes.saturating_add(pairs.held_bytes(grid)),
        ..of_band
    };
    Ok(Estimates { methods: vec![correlation], chosen: 0 })
}

#[cfg(test)]
mod tests;
