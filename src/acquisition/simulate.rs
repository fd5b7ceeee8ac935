//! Reflectors to data cube: Eq. 5, at virtual tones, by cells, or term by term.
//!
//! The [literal] sum evaluates every reflector, microphone and frequency. With a tolerance, the microphones are cut into
//! [tiles]; for each tile the reflectors are [grouped](echoes) by path length and summed at a few
//! [virtual tones](virtual_tones), which an [expansion](expand) turns into all frequencies of the sweep. Many reflectors are
//! summed as [cells] at a few nodes of the array instead of at each microphone.
//! A count of operations decides between these and chooses tiles, cells and tones ([cost]).
//!
//! [Losses] are factors on each echo; those that depend on the frequency enter as a few separable [terms]. Imperfect
//! microphones ([`ArrayErrors`]) are not exactly at the positions in the cube, and change gain and phase of what they
//! record.

mod cells;
mod columns;
mod cost;
mod echoes;
mod errors;
mod expand;
mod literal;
mod losses;
mod noise;
mod paths;
mod stored;
mod terms;
mod virtual_tones;
#[cfg(test)]
mod tests;

pub(crate) use cost::bytes as simulation_bytes;
pub use errors::ArrayErrors;
pub use losses::Losses;
pub use noise::Noise;

use super::{DataCube, Detection, Electronics, Instrument, SourceCode};
use crate::blocks::{BlockStore, BlocksFrom, NoStore};
use crate::choice::choice;
use crate::error::{Error, Result};
use crate::progress::{Observer, Silent, stage};
use crate::reflectors::Reflectors;
use crate::wave::Geometry;
use crate::with_fields::with_fields;
use cells::CellPlan;
use columns::Columns;
use expand::{SimulationPlan, fast};
use glam::DVec3;
use literal::literal;
pub(super) use literal::simulate_moving;
use noise::finish;
use num_complex::Complex32;
pub(crate) use stored::simulation_plan_len;

choice! {
    /// The path lengths of a simulated sound.
    pub enum PropagationModel: "model" {
        /// Eq. 5: the true path.
        Exact = "exact",
        /// Eq. 6–7: the far-field approximation.
        Linear = "linear",
    }
}

/// Parameters of [`simulate`].
///
/// ```
/// use holosonar::acquisition::{Losses, Noise, SimulateOptions};
///
/// let options = SimulateOptions::default()
///     .with_tolerance(1e-4)
///     .with_losses(Losses { spreading: true, ..Losses::NONE })
///     .with_noise(Noise { snr_db: 20.0, seed: 1 });
/// assert!(options.errors.is_none());
/// ```
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct SimulateOptions {
    /// Exact or linear paths.
    pub model: PropagationModel,
    /// Spreading, absorption and directivity.
    pub losses: Losses,
    /// Errors of the microphones, if any.
    pub errors: Option<ArrayErrors>,
    /// What the electronics do, unless they are ideal; see [`Electronics`].
    pub electronics: Option<Electronics>,
    /// Noise, if any, at the converter.
    pub noise: Option<Noise>,
    /// Maximum error of virtual tones in any sample, relative to `Σ|A|` (with spreading, to the part of it that reaches the
    /// microphone); 0 sums every term of Eq. 5.
    ///
    /// It bounds the error of the expansion for each reflector, measured on a dense grid of path lengths. The f32
    /// arithmetic of either method adds up to 10⁻⁵ for a single echo, and far less for many of random phase, because their
    /// errors average: relative to the largest sample of a diffuse scene, a few 10⁻⁶ in total.
    pub tolerance: f64,
    /// How several loudspeakers that sound at once are told apart; `None`: they sound one after another.
    pub code: Option<SourceCode>,
    /// From one tone to the next, s; only [moving](Reflectors::with_velocities) reflectors need it.
    pub dwell: Option<f64>,
}

/// The default tolerance of a simulation: about the rounding of f32.
pub const SIMULATION_TOLERANCE: f64 = 1e-6;

impl Default for SimulateOptions {
    fn default() -> Self {
        Self {
            model: PropagationModel::Exact,
            losses: Losses::NONE,
            errors: None,
            electronics: None,
            noise: None,
            tolerance: SIMULATION_TOLERANCE,
            dwell: None,
            code: None,
        }
    }
}

with_fields! {
    SimulateOptions {
        with_model(model: PropagationModel),
        with_losses(losses: Losses),
        with_errors(errors: Option<ArrayErrors>),
        with_electronics(electronics: Option<Electronics>),
        with_noise(noise: Option<Noise>),
        with_tolerance(tolerance: f64),
        with_dwell(dwell: Option<f64>),
        with_code(code: Option<SourceCode>),
    }
}

impl SimulateOptions {
    /// Refuses a tolerance or electronics outside their bounds.
    pub(super) fn check(&self) -> Result<()> {
        if !(self.tolerance >= 0.0 && self.tolerance.is_finite()) {
            let problem = "must be a finite number of 0 or more; 0 sums every term";
            return Err(Error::input("detection.tolerance", problem));
        }
        self.electronics.as_ref().map_or(Ok(()), Electronics::check)
    }
}

impl PropagationModel {
    /// Length of the path via `p` to the microphone at `r`, m.
    #[inline]
    fn path_length(self, instrument: &Instrument, p: DVec3, r: DVec3) -> f64 {
        match self {
            Self::Exact => instrument.path_length(p, r),
            Self::Linear => instrument.geometry.linear_path_length(p, r),
        }
    }
}

/// The data cube that the instrument records from `reflectors`.
///
/// `m(f, r) = Σ_j A_j e^{+i2πf·path_j(r)/c}` — Eq. 5 in quadrature; its real part in phase.
///
/// - Shapes: `samples` is `[n_f, n_mic]`, in the microphones' order, or `[n_tx, n_f, n_mic]` for several loudspeakers.
/// - Error: see [`SimulateOptions::tolerance`].
/// - [`SimulateOptions::losses`] multiply each echo by a further factor, and [`SimulateOptions::errors`] change what the
///   microphones record; the positions in the cube remain those of `instrument`.
/// - Cost: per reflector and microphone about 80 operations, 7 more for each of Q virtual tones (Q about 10 to 30), and a
///   matrix product that expands them; for the literal sum, 8 operations (60 for an uneven sweep) per frequency. Losses
///   that depend on the frequency multiply the tones by K, about 3 to 10; the literal sum then takes about 300 operations
///   per frequency. For many reflectors the first two are paid at some hundred nodes instead of at every microphone.
/// - Memory in addition to the cube: 32 bytes per reflector and thread, and at most 160 MB of sums; for the literal sum,
///   64 columns of the cube.
/// - Results are bit-identical for any number of threads.
///
/// # Errors
/// [`Error::OutOfMemory`] if the cube does not fit in memory; [`Error::InvalidInput`] for a tolerance that is not a finite
/// number of 0 or more, a speed of sound outside [`SOUND_SPEEDS`](crate::wave::SOUND_SPEEDS), a loudspeaker beyond
/// [`FARTHEST`](crate::scene::FARTHEST), paths of more than 10¹¹ wavelengths, or samples beyond single precision.
pub fn simulate(
    reflectors: &Reflectors,
    instrument: &Instrument,
    options: &SimulateOptions,
) -> Result<DataCube> {
    simulate_with(reflectors, instrument, options, &Silent)
}

/// [`simulate`], reporting its progress to `observer`, which may stop it.
///
/// # Errors
/// As [`simulate`]; [`Error::Interrupted`](crate::error::Error::Interrupted) if the observer asks to stop.
pub fn simulate_with(
    reflectors: &Reflectors,
    instrument: &Instrument,
    options: &SimulateOptions,
    observer: &dyn Observer,
) -> Result<DataCube> {
    simulate_resumable(std::slice::from_ref(reflectors), instrument, options, &mut NoStore, observer)
}

/// [`simulate`] with a store of finished tiles of microphones, without noise. Of several loudspeakers each may light
/// `reflectors` of its own; one list is for all of them.
///
/// # Errors
/// As [`simulate`].
pub(crate) fn simulate_resumable(
    reflectors: &[Reflectors],
    instrument: &Instrument,
    options: &SimulateOptions,
    store: &mut dyn BlockStore,
    observer: &dyn Observer,
) -> Result<DataCube> {
    options.check()?;
    let mut samples = match &options.electronics {
        Some(electronics) => electronics.read_echoes(instrument, &mut |number, heard| {
            simulate_moving(reflectors, (number, heard), options, store, observer)
        })?,
        None => simulate_moving(reflectors, (0, instrument), options, store, observer)?,
    };
    finish(&mut samples, instrument, options)?;
    Ok(DataCube { instrument: instrument.clone(), samples, provenance: serde_json::Value::Null })
}

/// Simulates those tiles of microphones that a store wants, of every frequency heard; they are read together.
///
/// # Errors
/// As [`simulate`].
pub(crate) fn simulate_tiles(
    reflectors: &[Reflectors],
    instrument: &Instrument,
    options: &SimulateOptions,
    store: &mut dyn BlockStore,
    observer: &dyn Observer,
) -> Result<()> {
    options.check()?;
    if reflectors.iter().any(|list| !list.velocities().is_empty()) {
        let problem =
            "is simulated tone by tone, which processes cannot share; `simulate` a cube, and share its image";
        return Err(Error::input("[scene] velocity", problem));
    }
    let heard = match &options.electronics {
        Some(electronics) => electronics.instruments(instrument)?,
        None => vec![instrument.clone()],
    };
    heard
        .iter()
        .enumerate()
        .try_for_each(|heard| fill_echoes(reflectors, heard, options, (None, store), observer))
}

/// Eq. 5: the samples of an ideal instrument, without noise; the blocks of simulation `number` come after those before it.
fn simulate_echoes(
    reflectors: &[Reflectors],
    (number, instrument): (usize, &Instrument),
    options: &SimulateOptions,
    store: &mut dyn BlockStore,
    observer: &dyn Observer,
) -> Result<Vec<Complex32>> {
    let mut samples = Vec::new();
    fill_echoes(reflectors, (number, instrument), options, (Some(&mut samples), store), observer)?;
    Ok(samples)
}

/// The same into a cube, which is allocated, or into the store alone.
fn fill_echoes(
    reflectors: &[Reflectors],
    (number, instrument): (usize, &Instrument),
    options: &SimulateOptions,
    (mut cube, store): (Option<&mut Vec<Complex32>>, &mut dyn BlockStore),
    observer: &dyn Observer,
) -> Result<()> {
    let first = (number * instrument.transmissions() * instrument.array.len()) as u64;
    let store = &mut BlocksFrom { first, store };
    if instrument.interface.is_some() && (options.losses.any() || options.model == PropagationModel::Linear) {
        let problem = "is simulated with exact paths and without spreading, absorption and directivity";
        return Err(Error::input("interface", problem));
    }
    reflectors.iter().try_for_each(|list| paths::check(list, instrument, options))?;
    instrument.check()?;
    reflectors
        .iter()
        .filter_map(Reflectors::bounds)
        .try_for_each(|bounds| instrument.check_with("reflectors", bounds))?;
    let (n_f, n_mic, transmissions) =
        (instrument.sweep.len(), instrument.array.len(), instrument.transmissions());
    if let Some(cube) = &mut cube {
        **cube = DataCube::allocate([transmissions, n_f, n_mic])?;
    }
    let (real, responses) = match options.errors {
        Some(errors) => {
            errors.check()?;
            let displaced = errors.displaced(&instrument.array)?;
            (instrument.clone().with_moved(displaced), errors.responses(n_mic))
        }
        None => (instrument.clone(), Vec::new()),
    };
    stage(observer, "simulating", (transmissions * n_mic) as u64, || {
        for index in 0..transmissions {
            let (reflectors, instrument) =
                (&reflectors[index.min(reflectors.len() - 1)], &real.transmission(index));
            let job = SimulationJob { reflectors, instrument, options, responses: &responses };
            // A tile has one microphone at least, so that no two transmissions have a block of one number.
            let mut blocks = BlocksFrom { first: (index * n_mic) as u64, store: &mut *store };
            let mut columns = match &mut cube {
                Some(cube) => {
                    Columns::new(&mut cube[index * n_f * n_mic..][..n_f * n_mic], n_mic, &mut blocks)
                }
                None => Columns::for_store([n_f, n_mic], &mut blocks),
            };
            match SimulationMethod::shared(&job, columns.store())? {
                SimulationMethod::Cells(plan) => plan.simulate(&job, &mut columns, observer),
                SimulationMethod::Tiles(plan) => fast(&job, &plan, &mut columns, observer),
                SimulationMethod::Literal => literal(&job, &mut columns, observer),
            }?;
        }
        Ok(())
    })
}

/// The inputs of a simulation, with the instrument's actual microphone positions.
#[derive(Debug, Clone, Copy)]
struct SimulationJob<'a> {
    reflectors: &'a Reflectors,
    instrument: &'a Instrument,
    options: &'a SimulateOptions,
    /// Complex gain of each microphone; empty for perfect ones.
    responses: &'a [Complex32],
}

/// Minimum tolerance of virtual tones; their f32 weights are no more accurate.
const LEAST_TOLERANCE: f64 = 1e-7;

/// How a simulation is done.
#[derive(Debug)]
enum SimulationMethod<'a> {
    Cells(Box<CellPlan<'a>>),
    Tiles(Box<SimulationPlan>),
    Literal,
}

/// The cheapest method that meets the tolerance.
fn method<'a>(
    reflectors: &'a Reflectors,
    instrument: &Instrument,
    options: &SimulateOptions,
) -> SimulationMethod<'a> {
    // A band without width has no duration, and an index must fit into its half of a sorting key.
    let possible = options.tolerance >= LEAST_TOLERANCE
        && instrument.sweep.bandwidth() > 0.0
        && u32::try_from(reflectors.len()).is_ok();
    if !possible {
        return SimulationMethod::Literal;
    }
    // Tiles know one leg that moves, cells both of a pair.
    let (candidates, least) = if let Geometry::Pair { .. } = instrument.geometry {
        (Vec::new(), cost::literal(reflectors.len() as f64, instrument, options))
    } else {
        let candidates = cost::candidates(reflectors, instrument, options);
        // Without any there is nothing to gain, or no phase is accurate.
        let Some(&(least, _)) = candidates.first() else { return SimulationMethod::Literal };
        (candidates, least)
    };
    if let Some(plan) = CellPlan::find(reflectors, instrument, options, least) {
        return SimulationMethod::Cells(Box::new(plan));
    }
    candidates
        .into_iter()
        .find_map(|(_, candidate)| SimulationPlan::of(&candidate, reflectors, instrument, options))
        .map_or(SimulationMethod::Literal, |plan| SimulationMethod::Tiles(Box::new(plan)))
}

/// The error for sums that do not fit in memory.
fn no_room() -> Error {
    Error::out_of_memory(
        "the sums of a simulation do not fit in memory; use fewer reflectors, frequencies or threads (-j), or free some memory",
    )
}

/// A sample as recorded with the microphone's response and the detection.
fn record(detection: Detection, response: Option<&Complex32>, m: Complex32) -> Complex32 {
    let m = response.map_or(m, |response| m * response);
    match detection {
        Detection::Quadrature => m,
        Detection::InPhase => Complex32::new(m.re, 0.0),
    }
}
