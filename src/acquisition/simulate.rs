//! Reflectors to data cube: Eq. 5, at virtual tones or term by term.
//!
//! The [literal] sum takes every reflector, microphone and frequency. With a tolerance, the microphones are cut into
//! [tiles]; for each tile the reflectors are [grouped](echoes) by path length and summed at a few
//! [virtual tones](virtual_tones), which an [expansion](expand) turns into all frequencies of the sweep.
//! A count of operations decides between them and picks tiles and tones ([cost]).
//!
//! A reflector's amplitude may depend on the reflector alone, so far. A factor that depends on the microphone too would
//! be one more weight where [echoes] lays out a tile's reflectors; one that depends on f and on all reflectors
//! alike belongs to the expansion's weights; any other needs a few separable terms, each a simulation of its own.

mod cost;
mod echoes;
mod expand;
mod kept;
mod literal;
mod noise;
mod tiles;
mod virtual_tones;
#[cfg(test)]
mod tests;
#[cfg(test)]
mod fast_tests;

pub use noise::Noise;

use super::{DataCube, Detection, MicArray, Sweep};
use crate::error::{Error, Result};
use crate::progress::{Forgetful, Keeper, Observer, stage};
use crate::reflectors::Reflectors;
use crate::wave::{DEFAULT_SOUND_SPEED, Geometry};
use expand::fast;
use glam::DVec3;
use kept::KeptSamples;
use literal::literal;
use noise::add_noise;
use num_complex::Complex32;
use serde::{Deserialize, Serialize};
use virtual_tones::VirtualTones;

/// Which path lengths a simulated sound follows.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum PropagationModel {
    /// Eq. 5: the true path.
    Exact,
    /// Eq. 6–7: the far-field approximation.
    Linear,
}

/// Parameters of [`simulate`].
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct SimulateOptions {
    /// c, m/s.
    pub sound_speed: f64,
    /// Fixed speaker or monostatic scan.
    pub geometry: Geometry,
    /// Quadrature or in-phase.
    pub detection: Detection,
    /// Exact or linear paths.
    pub model: PropagationModel,
    /// Noise, if any.
    pub noise: Option<Noise>,
    /// Greatest error that virtual tones may make in any sample, relative to `Σ|A|`; 0 sums every term of Eq. 5.
    ///
    /// It bounds what the expansion leaves out for each reflector, measured on a dense grid of path lengths. The f32
    /// arithmetic of either way adds up to 10⁻⁵ for a single echo, and far less to many of random phase: their errors
    /// average, so that of the greatest sample of a diffuse scene it is a few 10⁻⁶ in all.
    pub tolerance: f64,
}

/// The tolerance of a simulation that asks for none: about the rounding of f32.
pub const SIMULATION_TOLERANCE: f64 = 1e-6;

impl Default for SimulateOptions {
    fn default() -> Self {
        Self {
            sound_speed: DEFAULT_SOUND_SPEED,
            geometry: Geometry::ORIGIN,
            detection: Detection::Quadrature,
            model: PropagationModel::Exact,
            noise: None,
            tolerance: SIMULATION_TOLERANCE,
        }
    }
}

impl SimulateOptions {
    /// Length of the path by way of `p` to the microphone at `r` as this model has it, m.
    #[inline]
    fn path_length(&self, p: DVec3, r: DVec3) -> f64 {
        match self.model {
            PropagationModel::Exact => self.geometry.path_length(p, r),
            PropagationModel::Linear => self.geometry.linear_path_length(p, r),
        }
    }
}

/// The data cube that the array would record from `reflectors`.
///
/// `m(f, r) = Σ_j A_j e^{+i2πf·path_j(r)/c}` — Eq. 5 in quadrature; its real part in phase.
///
/// - Shapes: `samples` is `[n_f, n_mic]`, in the microphones' order.
/// - Error: see [`SimulateOptions::tolerance`].
/// - Cost: per reflector and microphone some 80 operations and 7 for each of Q virtual tones (Q about 10 to 30), and a
///   matrix product that expands them; or, literally, 8 operations (60 for an uneven sweep) per frequency.
/// - Memory beside the cube: 32 bytes per reflector and thread, and at most 128 MB of sums; literally, 64 columns of it.
/// - The bytes do not depend on the number of threads.
///
/// # Errors
/// [`Error::Environment`] when the cube does not fit in memory, [`Error::Interrupted`]; [`Error::Input`] for a tolerance that
/// is no number from 0 up.
pub fn simulate(
    reflectors: &Reflectors,
    sweep: &Sweep,
    array: &MicArray,
    options: &SimulateOptions,
    observer: &dyn Observer,
) -> Result<DataCube> {
    simulate_keeping(reflectors, sweep, array, options, &mut Forgetful, observer)
}

/// The same, tile by tile of microphones, each of which is handed to a keeper or taken from it.
///
/// A block is `[n_f, microphone of the tile]`, without noise.
///
/// # Errors
/// As [`simulate`], and what the keeper comes to.
pub fn simulate_keeping(
    reflectors: &Reflectors,
    sweep: &Sweep,
    array: &MicArray,
    options: &SimulateOptions,
    keeper: &mut dyn Keeper,
    observer: &dyn Observer,
) -> Result<DataCube> {
    if !(options.tolerance >= 0.0 && options.tolerance.is_finite()) {
        return Err(Error::input("detection.tolerance", "must be a number from 0 up; 0 sums every term"));
    }
    let (n_f, n_mic) = (sweep.len(), array.len());
    let mut samples = DataCube::allocate(n_f, n_mic)?;
    let mut kept = KeptSamples { samples: &mut samples, width: n_mic, keeper, finished: Vec::new() };
    stage(observer, "simulating", n_mic as u64, || match plan(reflectors, sweep, array, options) {
        Some(plan) => fast(reflectors, sweep, array, options, &plan, &mut kept, observer),
        None => literal(reflectors, sweep, array, options, &mut kept, observer),
    })?;
    if let Some(noise) = options.noise {
        add_noise(&mut samples, n_mic, noise, options.detection)?;
    }
    Ok(DataCube {
        sweep: sweep.clone(),
        array: array.clone(),
        geometry: options.geometry,
        detection: options.detection,
        sound_speed: options.sound_speed,
        samples,
        provenance: serde_json::Value::Null,
    })
}

/// Tiles and tones of a simulation.
#[derive(Debug)]
struct Plan {
    tiles: Vec<tiles::Tile>,
    tones: VirtualTones,
    /// Microphones whose sums are held between the two steps, at the least one tile.
    held: usize,
}

/// Tolerances below this are below what f32 weights hold, and want the literal sum.
const LEAST_TOLERANCE: f64 = 1e-7;

/// The cheapest plan that keeps the tolerance; `None` where the literal sum is cheaper.
fn plan(reflectors: &Reflectors, sweep: &Sweep, array: &MicArray, options: &SimulateOptions) -> Option<Plan> {
    // A band of no width has no duration, and an index must fit its half of a sorting key.
    let possible = options.tolerance >= LEAST_TOLERANCE
        && sweep.bandwidth() > 0.0
        && u32::try_from(reflectors.len()).is_ok();
    if !possible {
        return None;
    }
    cost::choices(reflectors, sweep, array, options).into_iter().find_map(|choice| {
        let tones = VirtualTones::find(sweep, choice.rung, options.tolerance)?;
        let tiles = tiles::tiles(array.positions(), choice.microphones, choice.radius);
        Some(Plan { tiles, tones, held: choice.held })
    })
}

/// A sample as the detection records it.
fn record(detection: Detection, re: f32, im: f32) -> Complex32 {
    match detection {
        Detection::Quadrature => Complex32::new(re, im),
        Detection::InPhase => Complex32::new(re, 0.0),
    }
}
