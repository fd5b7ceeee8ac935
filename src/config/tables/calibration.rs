//! `[calibration]`: how a measured cube is corrected before it is imaged.

use crate::acquisition::{ChannelMask, TraceColumn};
use crate::config::choices::InputFile;
use serde::{Deserialize, Serialize};

/// `[calibration]`: corrections of a measured cube, applied in this order.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct CalibrationTable {
    /// Microphones that are silenced: `"auto"`, or a list of indices, counted from 0.
    pub mask: ChannelMask,
    /// Whether the cube's transmissions are sweeps of `[coding]`, to be decoded.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub decode: bool,
    /// What is subtracted: a cube of the empty room, or `"mean"`, that over the microphones.
    pub background: Option<InputFile>,
    /// Diameter of the disc around a microphone whose mean is subtracted, m.
    pub high_pass: Option<f64>,
    /// Responses by which the samples are divided: `.npz` of `calibrate`, `.csv`, or `.npy` of phases in rad.
    pub response: Option<InputFile>,
    /// Columns of a `.csv`; left out: its header.
    pub columns: Vec<TraceColumn>,
    /// -1 if the phases of a `.csv` or `.npy` fall with the path.
    pub phase_sign: Option<i32>,
    /// By how much recorded paths are too long, m.
    pub delay: f64,
    /// The paths that are kept, from and to, m.
    pub gate: Option<[f64; 2]>,
    /// By how much the array is tilted about its centre, degrees: about x, then about y.
    pub tilt: [f64; 2],
}

impl CalibrationTable {
    /// Whether nothing of it was typed.
    pub(in crate::config) fn is_default(&self) -> bool {
        *self == Self::default()
    }

    /// The files that it names.
    pub(in crate::config) fn files_mut(&mut self) -> impl Iterator<Item = &mut InputFile> {
        let background = self.background.as_mut().filter(|background| background.typed != MEAN);
        background.into_iter().chain(self.response.as_mut())
    }
}

/// The background that is no file.
pub(in crate::config) const MEAN: &str = "mean";
