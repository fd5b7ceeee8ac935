//! Reflectors to data cube: Eq. 5, at virtual tones or term by term.
//!
//! The [literal] sum takes every reflector, microphone and frequency. With a tolerance, the microphones are cut into
//! [tiles]; for each tile the reflectors are [grouped](echoes) by path length and summed at a few
//! [virtual tones](virtual_tones), which an [expansion](expand) turns into all frequencies of the sweep.
//! A count of operations decides between them and picks tiles and tones ([cost]).
//!
//! [Losses] are factors on each echo: those that depend on the frequency enter as a few separable [terms]. Imperfect
//! microphones ([`ArrayErrors`]) stand elsewhere than the cube says, and turn and weigh what they record.

mod columns;
mod cost;
mod echoes;
mod errors;
mod expand;
mod literal;
mod losses;
mod noise;
mod planes;
mod terms;
mod virtual_tones;
#[cfg(test)]
mod tests;
#[cfg(test)]
mod fast_tests;
#[cfg(test)]
mod loss_tests;

pub(crate) use cost::bytes as simulation_bytes;
pub use errors::ArrayErrors;
pub use losses::Losses;
pub use noise::Noise;

use super::{DataCube, Detection, Instrument, Tile, tiles};
use crate::blocks::{BlockStore, NoStore};
use crate::choice::choice;
use crate::error::{Error, Result};
use crate::progress::{Observer, Silent, stage};
use crate::reflectors::Reflectors;
use crate::wave::Geometry;
use columns::Columns;
use expand::fast;
use glam::DVec3;
use literal::literal;
use noise::add_noise;
use num_complex::Complex32;
use terms::{Spread, Terms};
use virtual_tones::VirtualTones;

choice! {
    /// Which path lengths a simulated sound follows.
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
    /// Imperfect microphones, if they are.
    pub errors: Option<ArrayErrors>,
    /// Noise, if any.
    pub noise: Option<Noise>,
    /// Greatest error that virtual tones may make in any sample, relative to `Σ|A|` (with spreading, to what of it reaches
    /// the microphone); 0 sums every term of Eq. 5.
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
            model: PropagationModel::Exact,
            losses: Losses::NONE,
            errors: None,
            noise: None,
            tolerance: SIMULATION_TOLERANCE,
        }
    }
}

impl SimulateOptions {
    /// Sets the model of the path lengths.
    #[must_use]
    pub fn with_model(self, model: PropagationModel) -> Self {
        Self { model, ..self }
    }

    /// Sets the losses.
    #[must_use]
    pub fn with_losses(self, losses: Losses) -> Self {
        Self { losses, ..self }
    }

    /// Adds errors of the microphones.
    #[must_use]
    pub fn with_errors(self, errors: ArrayErrors) -> Self {
        Self { errors: Some(errors), ..self }
    }

    /// Adds noise.
    #[must_use]
    pub fn with_noise(self, noise: Noise) -> Self {
        Self { noise: Some(noise), ..self }
    }

    /// Sets the [`tolerance`](Self::tolerance); 0 sums every term.
    #[must_use]
    pub fn with_tolerance(self, tolerance: f64) -> Self {
        Self { tolerance, ..self }
    }
}

impl PropagationModel {
    /// Length of the path by way of `p` to the microphone at `r`, m.
    #[inline]
    fn path_length(self, geometry: &Geometry, p: DVec3, r: DVec3) -> f64 {
        match self {
            Self::Exact => geometry.path_length(p, r),
            Self::Linear => geometry.linear_path_length(p, r),
        }
    }
}

/// The data cube that the instrument would record from `reflectors`.
///
/// `m(f, r) = Σ_j A_j e^{+i2πf·path_j(r)/c}` — Eq. 5 in quadrature; its real part in phase.
///
/// - Shapes: `samples` is `[n_f, n_mic]`, in the microphones' order.
/// - Error: see [`SimulateOptions::tolerance`].
/// - With [`SimulateOptions::losses`] each echo has a factor more, and [`SimulateOptions::errors`] change what the
///   microphones record; the cube's own positions stay those of `instrument`.
/// - Cost: per reflector and microphone some 80 operations and 7 for each of Q virtual tones (Q about 10 to 30), and a
///   matrix product that expands them; or, literally, 8 operations (60 for an uneven sweep) per frequency. Losses that
///   depend on the frequency take K times the tones, K about 3 to 10; literally, some 300 operations per frequency.
/// - Memory beside the cube: 32 bytes per reflector and thread, and at most 128 MB of sums; literally, 64 columns of it.
/// - The bytes do not depend on the number of threads.
///
/// # Errors
/// [`Error::OutOfMemory`] when the cube does not fit in memory; [`Error::InvalidInput`] for a tolerance that is no number
/// from 0 up, or a speed of sound that is not positive.
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
/// As [`simulate`]; [`Error::Interrupted`](crate::error::Error::Interrupted) when the observer asks to stop.
pub fn simulate_with(
    reflectors: &Reflectors,
    instrument: &Instrument,
    options: &SimulateOptions,
    observer: &dyn Observer,
) -> Result<DataCube> {
    simulate_resumable(reflectors, instrument, options, &mut NoStore, observer)
}

/// [`simulate`] with a store of finished tiles of microphones; noise is no part of them.
///
/// # Errors
/// As [`simulate`].
pub(crate) fn simulate_resumable(
    reflectors: &Reflectors,
    instrument: &Instrument,
    options: &SimulateOptions,
    store: &mut dyn BlockStore,
    observer: &dyn Observer,
) -> Result<DataCube> {
    if !(options.tolerance >= 0.0 && options.tolerance.is_finite()) {
        return Err(Error::input("detection.tolerance", "must be a number from 0 up; 0 sums every term"));
    }
    instrument.check()?;
    let (n_f, n_mic) = (instrument.sweep.len(), instrument.array.len());
    let mut samples = DataCube::allocate(n_f, n_mic)?;
    let (real, responses) = match options.errors {
        Some(errors) => {
            errors.check()?;
            let displaced = errors.displaced(&instrument.array)?;
            (instrument.clone().with_array(displaced), errors.responses(n_mic))
        }
        None => (instrument.clone(), Vec::new()),
    };
    let job = Job { reflectors, instrument: &real, options, responses: &responses };
    let mut columns = Columns::new(&mut samples, n_mic, store);
    stage(observer, "simulating", n_mic as u64, || match plan(reflectors, &real, options) {
        Some(plan) => fast(&job, &plan, &mut columns, observer),
        None => literal(&job, &mut columns, observer),
    })?;
    if let Some(noise) = options.noise {
        add_noise(&mut samples, n_mic, noise, instrument.detection)?;
    }
    Ok(DataCube { instrument: instrument.clone(), samples, provenance: serde_json::Value::Null })
}

/// What is simulated, with the instrument as it really is.
#[derive(Debug, Clone, Copy)]
struct Job<'a> {
    reflectors: &'a Reflectors,
    instrument: &'a Instrument,
    options: &'a SimulateOptions,
    /// What each microphone multiplies its samples with; empty for perfect ones.
    responses: &'a [Complex32],
}

/// Tiles, tones and terms of a simulation.
#[derive(Debug)]
struct Plan {
    tiles: Vec<Tile>,
    tones: VirtualTones,
    /// Losses, if there are any.
    terms: Option<Terms>,
    /// Weights of the expansion, `[n_f][K Q]`.
    weights: Vec<f32>,
    /// Microphones whose sums are held between the two steps, at the least one tile.
    held: usize,
}

impl Plan {
    /// K Q: sums per microphone and group.
    fn columns(&self) -> usize {
        self.tones.count() * self.terms.as_ref().map_or(1, Terms::count)
    }

    /// What a choice comes to; `None` where tones or terms do not keep the tolerance.
    fn of(
        choice: &cost::Choice,
        reflectors: &Reflectors,
        instrument: &Instrument,
        options: &SimulateOptions,
    ) -> Option<Self> {
        let Instrument { sweep, array, sound_speed, .. } = instrument;
        let rung = choice.rung;
        let spread = Spread::new(reflectors, instrument, options);
        let half = 0.5 * rung.spread / sweep.bandwidth() * sound_speed;
        // Tones and terms share the tolerance; the terms pass the tones' error on, greater by their own size.
        let share = if options.losses.vary() { 0.5 } else { 1.0 };
        let count = spread.count(half, share * options.tolerance)?;
        let mut tones = VirtualTones::find(sweep, rung, share * options.tolerance / count.amplification)?;
        let mut terms = None;
        let mut weights = std::mem::take(&mut tones.weights);
        if options.losses.any() {
            let made = Terms::new(&count, &spread, half, reflectors, instrument, options)?;
            weights = made.weights(&weights);
            terms = Some(made);
        }
        let tiles = tiles(array.positions(), choice.microphones, choice.radius);
        Some(Self { tiles, tones, terms, weights, held: choice.held })
    }
}

/// Tolerances below this are below what f32 weights hold, and want the literal sum.
const LEAST_TOLERANCE: f64 = 1e-7;

/// The cheapest plan that keeps the tolerance; `None` where the literal sum is cheaper.
fn plan(reflectors: &Reflectors, instrument: &Instrument, options: &SimulateOptions) -> Option<Plan> {
    // A band of no width has no duration, and an index must fit its half of a sorting key.
    let possible = options.tolerance >= LEAST_TOLERANCE
        && instrument.sweep.bandwidth() > 0.0
        && u32::try_from(reflectors.len()).is_ok();
    if !possible {
        return None;
    }
    cost::choices(reflectors, instrument, options)
        .into_iter()
        .find_map(|choice| Plan::of(&choice, reflectors, instrument, options))
}

/// The refusal of sums that do not fit.
fn no_room() -> Error {
    Error::out_of_memory(
        "the sums of a simulation do not fit; take fewer reflectors, frequencies or threads (-j), or free some memory",
    )
}

/// A sample as the microphone's response and the detection record it.
fn record(detection: Detection, response: Option<&Complex32>, m: Complex32) -> Complex32 {
    let m = response.map_or(m, |response| m * response);
    match detection {
        Detection::Quadrature => m,
        Detection::InPhase => Complex32::new(m.re, 0.0),
    }
}
