//! What is measured: a stepped sweep of tones, an array of microphones, and the data cube `m(f, r)`.
//!
//! [`simulate`] makes a cube from reflectors by Eq. 5; [`DataCube::read`] takes a measured one. From here on
//! nothing tells them apart.

mod array;
mod setup;
mod source;
mod cube;
mod cube_file;
mod simulate;
mod sweep;

pub use array::{Lattice, MicArray};
pub use cube::DataCube;
pub use cube_file::CubeFile;
pub use setup::{Instrument, Setup};
pub use simulate::{
    ArrayErrors, Losses, Noise, PropagationModel, SIMULATION_TOLERANCE, SimulateOptions, simulate,
};
pub use source::{CubeSource, Visit};
pub use sweep::Sweep;

use serde::{Deserialize, Serialize};

/// How the microphone's signal is mixed down.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Detection {
    /// Both phases: `m = Σ A e^{+i2πf·path/c}`.
    Quadrature,
    /// One phase, the paper's real data: `m = Re Σ A e^{+i2πf·path/c}` (Eq. 5).
    InPhase,
}

impl Detection {
    /// The weight `w` of the reconstruction that makes a unit reflector peak at 1: the mirror half of an
    /// in-phase signal is lost to the negative frequencies (the ½ of Eq. 14).
    pub fn weight(self) -> f64 {
        match self {
            Self::Quadrature => 1.0,
            Self::InPhase => 2.0,
        }
    }
}
