//! The measurement: an [`Instrument`] (a stepped sweep and an array of microphones) and the data cube `m(f, r)`.
//!
//! [`simulate`] computes a cube from reflectors by Eq. 5; [`DataCube::read`] reads a measured one, and [`import()`] makes
//! one of a laboratory's files. Later stages treat them alike.
//!
//! # Example
//! The echo of one reflector at one microphone, frequency by frequency, is Eq. 5:
//! ```
//! use holosonar::glam::DVec3;
//! use holosonar::acquisition::{Instrument, MicArray, SimulateOptions, Sweep, simulate};
//! use holosonar::reflectors::Reflectors;
//! use holosonar::num_complex::{Complex32, Complex64};
//! use std::f64::consts::TAU;
//!
//! let p = DVec3::new(0.1, 0.0, 1.0);
//! let sweep = Sweep::stepped(10e3, 12e3, 500.0)?;
//! let instrument = Instrument::new(sweep, MicArray::from_positions(vec![DVec3::ZERO])?);
//! let reflector = Reflectors::new(vec![p], vec![Complex32::ONE])?;
//! let cube = simulate(&reflector, &instrument, &SimulateOptions::default())?;
//! let path = 2.0 * p.length();
//! for (f, m) in instrument.sweep.frequencies().iter().zip(&cube.samples) {
//!     let exact = Complex64::cis(TAU * f * path / instrument.sound_speed);
//!     assert!((Complex64::new(m.re.into(), m.im.into()) - exact).norm() < 1e-5);
//! }
//! # Ok::<(), holosonar::error::Error>(())
//! ```

mod array;
mod ascan;
mod calibration;
mod import;
mod instrument;
mod source;
mod cube;
mod cube_file;
mod electronics;
mod health;
mod profile;
mod recording;
mod simulate;
mod sweep;

pub use array::{Lattice, MicArray, PositionFormulas};
pub(crate) use array::{RANDOM_BYTES, Tile, check_formula, halvings, tiles};
pub(crate) use ascan::columns;
pub use ascan::{AScan, AScanOptions, ScannedMicrophone};
pub(crate) use calibration::note;
pub use calibration::{AutoWord, Background, Calibration, ChannelMask, ChannelResponse, ResponseAxis};
pub use cube::{CubeView, DataCube};
pub use cube_file::{CubeFile, UncheckedSamples};
pub use electronics::{Electronics, InstrumentElement, Mixer, OutputFilter, QuadratureBy};
pub(crate) use electronics::{HeardTones, MOST_HARMONICS, simulate_heard};
pub use health::{
    ChannelLevels, Health, LikelySign, MeanProfile, NoiseEstimate, OddChannel, OddChannels, PhaseSign,
    SignEvidence, TransmissionHealth,
};
pub(crate) use import::check_columns;
pub use import::{
    ArrayName, FrequencyUnit, ImportAxis, ImportOptions, Imported, MeanWord, RawOffset, TraceColumn, import,
};
pub use instrument::{CodeKind, CodeReport, Decoding, Instrument, InstrumentChanges, SourceCode};
pub(crate) use instrument::{MOST_CODED, MOST_SOURCES};
pub use profile::ProfilePeak;
pub(crate) use profile::SweepTransform;
pub(crate) use recording::write_heard;
pub use recording::{
    DirectWord, Latency, RecorderOptions, RecordingOptions, RecordingSize, Reference, TestSignal, WavFormat,
    write_recording,
};
pub use simulate::{
    ArrayErrors, Losses, Noise, PropagationModel, SIMULATION_TOLERANCE, SimulateOptions, simulate,
    simulate_with,
};
pub(crate) use simulate::{simulate_resumable, simulate_tiles, simulation_bytes, simulation_plan_len};
pub(crate) use source::SomeTransmissions;
pub use source::{CubeSource, Visit};
pub use sweep::Sweep;

use crate::choice::choice;

choice! {
    /// How the microphone's signal is mixed down.
    pub enum Detection: "detection" {
        /// Both phases: `m = Σ A e^{+i2πf·path/c}`.
        Quadrature = "quadrature",
        /// One phase, the paper's real data: `m = Re Σ A e^{+i2πf·path/c}` (Eq. 5).
        InPhase = "in-phase",
    }
}

impl Detection {
    /// The weight `w` of the reconstruction with which a unit reflector peaks at 1: half of an in-phase signal is lost
    /// to the negative frequencies (the ½ of Eq. 14).
    pub fn weight(self) -> f64 {
        match self {
            Self::Quadrature => 1.0,
            Self::InPhase => 2.0,
        }
    }
}
