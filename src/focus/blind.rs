//! Blind self-calibration: errors of tones or microphones, found from the echoes of a scene that nobody knows.
//!
//! By turns the brightest voxels are imaged, and each channel, a tone or a microphone, is fitted to what the image of the
//! *others* predicts for it, within a prior on the size of its error. That can fake sharpness: where more echoes overlap than
//! channels can tell apart, an image without errors gets sharper, too. So a fifth of the microphones is kept aside. They take no
//! part in the images, and only if these predict *them* better than before, the corrections are to be trusted.

mod contributions;
mod fit;
mod judgement;
mod profiles;
mod voxels;

pub use judgement::{HeldOut, SelfCalibration, SelfCalibrationVerdict};

use super::one_of_many::OneOfMany;
use crate::acquisition::{DataCube, Detection};
use crate::choice::choice;
use crate::error::{Error, Result};
use crate::grid::Grid;
use crate::progress::{Observer, advance, stage};
use crate::reconstruct::{Method, ReconstructOptions, Window};
use contributions::Contributions;
use fit::{Errors, fit_channels};
use glam::DVec3;
use judgement::Judge;
use voxels::Bright;

choice! {
    /// Which errors are looked for.
    pub enum ChannelError: "blind" {
        /// A phase of each tone.
        Frequency = "frequency",
        /// A phase of each microphone.
        Phase = "phase",
        /// A delay of each microphone.
        Delay = "delay",
        /// The place of each microphone.
        Position = "position",
    }
}

impl ChannelError {
    /// The unit of the prior and of what is found, as it is printed: degrees or m.
    pub fn unit(self) -> &'static str {
        match self {
            Self::Frequency | Self::Phase => "degrees",
            Self::Delay | Self::Position => "m",
        }
    }

    /// Degrees to radians; m as they are.
    fn factor(self) -> f64 {
        match self {
            Self::Frequency | Self::Phase => 1.0_f64.to_radians(),
            Self::Delay | Self::Position => 1.0,
        }
    }

    /// Numbers that one channel's error has.
    fn dimensions(self) -> usize {
        if self == Self::Position { 3 } else { 1 }
    }

    /// Channels of a cube: tones or microphones.
    fn channels(self, cube: &DataCube) -> usize {
        match self {
            Self::Frequency => cube.instrument.sweep.len(),
            _ => cube.instrument.array.len(),
        }
    }
}

/// Times that voxels are chosen anew, and that all channels are fitted to each choice.
const ROUNDS: usize = 3;
const FITS: usize = 4;

/// Fewest microphones: of less, a fifth tells nothing.
const FEWEST_MICROPHONES: usize = 20;

/// Fewest resolution cells that the bright voxels fill, in effect: one echo alone fits any error.
const FEWEST_CELLS: f64 = 4.0;

/// Finds the errors of a cube's channels from the echoes in a region, with errors of `prior` rms (degrees, or m along each
/// axis) expected, and judges them by microphones that were kept aside.
///
/// The cube is not changed: [`SelfCalibration::correct`] does that.
///
/// Cost: 4 images of the region, and about 50 operations for each bright voxel, channel and value tried. Memory: the region,
/// range profiles of the microphones, and what each channel adds to each bright voxel.
///
/// # Errors
/// In-phase samples; fewer than 20 microphones that are not silent; a prior that is not positive; a silent region; echoes of less than 4 resolution
/// cells, which fit any errors; those of [`reconstruct`](crate::reconstruct::reconstruct()).
pub fn self_calibrate(
    cube: &DataCube,
    grid: &Grid,
    kind: ChannelError,
    prior: f64,
    memory: Option<u64>,
    observer: &dyn Observer,
) -> Result<SelfCalibration> {
    if kind == ChannelError::Position {
        cube.instrument.need_even_pairs("--blind position")?;
    }
    if cube.instrument.detection == Detection::InPhase {
        let problem = "fits phases, and in-phase samples have none; record both, I and Q";
        return Err(Error::input("--blind", problem));
    }
    if !(prior > 0.0 && prior.is_finite()) {
        let problem = format!("must be a positive number of {}, not {prior}", kind.unit());
        return Err(Error::input("--prior", problem));
    }
    let heard = heard(cube);
    if heard.len() < FEWEST_MICROPHONES {
        let problem = format!(
            "needs {FEWEST_MICROPHONES} microphones or more, some of which are kept aside; there are {} that are not silent",
            heard.len()
        );
        return Err(Error::input("--blind", problem));
    }
    let (kept, aside) = divide(&heard);
    let fitted = match kind {
        ChannelError::Frequency => (0..cube.instrument.sweep.len()).collect(),
        _ => kept.clone(),
    };
    let images = ReconstructOptions::new(Method::Auto, Window::None).with_memory(memory);
    let scale = prior * kind.factor();
    let reach = 4.0 * scale;
    let work = (ROUNDS * FITS + ROUNDS + 1) as u64;
    stage(observer, "fitting channels", work, || {
        let quiet = OneOfMany(observer);
        let mut errors = Errors::none(kind, kind.channels(cube));
        let look = |errors: &Errors| {
            let bright =
                Bright::choose(&errors.corrected(cube)?, &kept, fitted.len(), grid, &images, &quiet)?;
            advance(observer, 1)?;
            Ok(bright)
        };
        let judge = |bright: &Bright, errors: &mut Errors| {
            let contributions = Contributions::new(cube, kind, bright, &kept, reach);
            Judge::of(&contributions, bright, &fitted, &aside, errors, scale)
        };
        let mut bright: Bright = look(&errors)?;
        if bright.cells < FEWEST_CELLS {
            let problem = format!(
                "wants many echoes: the bright voxels fill {:.1} resolution cells in effect, and fewer than {FEWEST_CELLS} fit \
                 any errors; of a target at a known place --reference measures the response",
                bright.cells
            );
            return Err(Error::input("--blind", problem));
        }
        let before = judge(&bright, &mut errors);
        for _ in 0..ROUNDS {
            let contributions = Contributions::new(cube, kind, &bright, &kept, reach);
            for _ in 0..FITS {
                fit_channels(&contributions, &fitted, &aside, &mut errors, scale);
                advance(observer, 1)?;
            }
            bright = look(&errors)?;
        }
        let after = judge(&bright, &mut errors);
        Ok(SelfCalibration::new(kind, prior, [&kept, &fitted], &[before, after], errors))
    })
}

/// The microphones that are not silent.
fn heard(cube: &DataCube) -> Vec<usize> {
    let n_mic = cube.instrument.array.len();
    let mut power = vec![0.0; n_mic];
    for (i, m) in cube.samples.iter().enumerate() {
        power[i % n_mic] += f64::from(m.norm_sqr());
    }
    (0..n_mic).filter(|r| power[*r] > 0.0).collect()
}

/// Microphones that are imaged, and a fifth that are kept aside: one of every five neighbours, which one is scattered, so that the
/// others have no regular gaps.
fn divide(heard: &[usize]) -> (Vec<usize>, Vec<usize>) {
    let (mut kept, mut aside) = (Vec::new(), Vec::new());
    for (group, five) in heard.chunks(5).enumerate() {
        // The fractional parts of multiples of the golden ratio are spread evenly, and never repeat.
        let chosen = ((group as f64 * std::f64::consts::GOLDEN_RATIO).fract() * 5.0) as usize;
        for (i, channel) in five.iter().enumerate() {
            if i == chosen { aside.push(*channel) } else { kept.push(*channel) }
        }
    }
    (kept, aside)
}

/// A place of a channel's error: a phase in rad or a delay in m along x, or a displacement in m.
type ErrorValue = DVec3;

/// How a channel with an error agrees with an image of some places: by contributions, and, of microphones, by predictions.
#[cfg(test)]
pub(super) fn agreements(
    cube: &DataCube,
    kind: ChannelError,
    places: Vec<DVec3>,
    (channel, error): (usize, ErrorValue),
    image: &[num_complex::Complex32],
) -> [f64; 2] {
    let bright = Bright { places, cells: 0.0, sharpness: 0.0 };
    let all: Vec<usize> = (0..cube.instrument.array.len()).collect();
    let contributions = Contributions::new(cube, kind, &bright, &all, 0.05);
    let whole = contributions.inner(channel, error, image).re;
    if kind == ChannelError::Frequency {
        return [whole, whole];
    }
    if kind != ChannelError::Phase {
        assert!((contributions.agreement(channel, error, image) - whole).abs() < 1e-3 * whole.abs().max(1.0));
    }
    [whole, contributions.prediction(channel, error, &[], image).agreement]
}
