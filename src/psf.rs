//! The point-spread function: the image of one reflector, measured, and the prediction.
//!
//! Takes an instrument and a point; simulates a unit reflector there, reconstructs fine lines, planes and the whole box
//! around it with the crate's own `simulate` and [`reconstruct`](crate::reconstruct::reconstruct), and reads off widths,
//! sidelobes and grating lobes. Predictions come from [`Profile`](crate::plan::Profile) and [`Beam`], which use neither.

mod look;

use crate::acquisition::{Instrument, SimulateOptions, simulate_with};
use crate::error::{Error, Result};
use crate::grid::{Axis, Grid};
use crate::plan::beam::Beam;
use crate::progress::{Observer, Silent};
use crate::reconstruct::{Correlation, ReconstructOptions};
use crate::reflectors::Reflectors;
use glam::DVec3;
use look::{Look, cube_grid};
use num_complex::Complex32;
use serde::Serialize;

/// Full widths of the main lobe along one axis, m; `None` where it has no end.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Width {
    /// Where the amplitude is 3 dB below the peak (0.71 of it).
    pub at_3_db: Option<f64>,
    /// What the plan predicts for that, m.
    pub predicted_at_3_db: Option<f64>,
    /// Where it is 6 dB below (half of it).
    pub at_6_db: Option<f64>,
    /// What the plan predicts for that, m.
    pub predicted_at_6_db: Option<f64>,
}

/// A place outside the main lobe and its amplitude relative to the peak.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Lobe {
    /// dB below the peak, so negative.
    pub level_db: f64,
    /// Where, m.
    pub position: [f64; 3],
}

/// A grating lobe, predicted and measured.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[non_exhaustive]
pub struct MeasuredGratingLobe {
    /// Axis along which the microphones' pitch repeats: 0 is x, 1 is y.
    pub axis: usize,
    /// Order and side.
    pub order: i32,
    /// By the array factor.
    pub predicted: Lobe,
    /// The largest amplitude near there.
    pub measured: Lobe,
    /// Lateral distances from the point, m: predicted, measured.
    pub offset: [f64; 2],
    /// Whether it lies within the grid.
    pub in_grid: bool,
}

/// A plane through the point, with the amplitudes on it.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct PlaneCut {
    /// Which plane: "x y", "x z", "y z" through the point, or "front": the largest along z.
    pub name: &'static str,
    /// Columns.
    pub columns: Axis,
    /// Rows.
    pub rows: Axis,
    /// dB below the peak, `[row, column]`.
    pub decibels: Vec<f32>,
}

/// Full widths of sin(πx)/(πx) where it falls 3 and 6 dB below its peak; at 2/π it is 1 wide.
const OF_SINC: [f64; 2] = [0.886, 1.204];

/// The image of one point.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct PointSpread {
    /// The point, m.
    pub point: [f64; 3],
    /// Amplitude found there; 1 for a perfect instrument.
    pub amplitude: f64,
    /// Along x, y and z through the point.
    pub widths: [Width; 3],
    /// The strongest place outside the main lobe, in the grid at ranges near the point's; grating lobes included.
    pub peak_sidelobe: Option<Lobe>,
    /// What the array factor and the band's window predict for its level, dB.
    pub predicted_peak_sidelobe_db: Option<f64>,
    /// Mean power outside the main lobe in the same box, dB.
    pub mean_sidelobe_db: Option<f64>,
    /// Grating lobes before the array, whether or not in the grid.
    #[serde(rename = "ghosts")]
    pub grating_lobes: Vec<MeasuredGratingLobe>,
    /// To be drawn.
    #[serde(skip)]
    pub cuts: Vec<PlaneCut>,
}

/// Measures the point-spread function at `p`; `scene` is the grid in which sidelobes matter.
///
/// Cost: one simulation of a single reflector, three lines, three planes, and one reconstruction of at most 4 million
/// voxels.
///
/// # Errors
/// A point behind the array or where no microphone receives its echo; those of `simulate` and
/// [`reconstruct`](crate::reconstruct::reconstruct).
pub fn point_spread(
    instrument: &Instrument,
    options: &ReconstructOptions,
    scene: &Grid,
    p: DVec3,
) -> Result<PointSpread> {
    point_spread_with(instrument, options, scene, p, &Silent)
}

/// [`point_spread`], reporting its progress to `observer`, which may stop it.
///
/// # Errors
/// As [`point_spread`]; `Error::Interrupted` when the observer asks to stop.
pub fn point_spread_with(
    instrument: &Instrument,
    options: &ReconstructOptions,
    scene: &Grid,
    p: DVec3,
    observer: &dyn Observer,
) -> Result<PointSpread> {
    let (low, high) = instrument.array.bounds();
    if !(p.is_finite() && p.z > high.z.max(0.0)) {
        return Err(Error::input(
            "--at",
            format!("{p} m is not in front of the array; expected x,y,z with z greater than {}", high.z),
        ));
    }
    let reflector = Reflectors::new(vec![p], vec![Complex32::ONE])?;
    let cube = simulate_with(&reflector, instrument, &SimulateOptions::default(), observer)?;
    let mut widths = [3.0, 6.0].map(|below| instrument.predicted_widths(p, options.window, below));
    let here = Axis { first: p.z, pitch: 1.0, count: 1 };
    if let Some(correlation) = Correlation::of(instrument, &Grid { z: here, ..*scene }, options) {
        for ([_, _, along], of_sinc) in widths.iter_mut().zip(OF_SINC) {
            *along = Some(of_sinc * correlation.mean_resolution());
        }
    }
    // An axis without resolution takes a scale like the others'.
    let otherwise = widths[0]
        .into_iter()
        .flatten()
        .fold((high - low).max_element().max(instrument.wavelength()), f64::min);
    let scale = DVec3::from(widths[0].map(|width| width.unwrap_or(otherwise)));
    let seen = &*instrument.equivalent();
    let beam = Beam::new(seen, options.window);
    let mut look = Look { seen, options, cube, p, amplitude: 1.0, beam, scale };
    look.amplitude = f64::from(look.image(&cube_grid(p, DVec3::splat(1e-4), [0; 3]))?.peak());
    if look.amplitude <= 0.0 {
        return Err(Error::input("--at", format!("no microphone receives an echo from {p} m")));
    }
    let measured = [look.line(0, &widths)?, look.line(1, &widths)?, look.line(2, &widths)?];
    let mut cuts = vec![look.cut("x y", 0, 1)?, look.cut("x z", 0, 2)?, look.cut("y z", 1, 2)?];
    let (peak_sidelobe, mean_sidelobe_db, front) = look.sidelobes(scene)?;
    cuts.insert(0, front);
    let beside = look.beam.sidelobes(look.reach(scene)).peak_db;
    let range = look.range_sidelobe_db();
    Ok(PointSpread {
        point: p.to_array(),
        amplitude: look.amplitude,
        widths: measured,
        peak_sidelobe,
        predicted_peak_sidelobe_db: [beside, range].into_iter().flatten().max_by(f64::total_cmp),
        mean_sidelobe_db,
        grating_lobes: look.grating_lobes(scene)?,
        cuts,
    })
}
