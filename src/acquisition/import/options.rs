//! What an import is told, and what it gives.

use super::{ArrayName, ImportAxis, RawOffset, TraceColumn};
use crate::acquisition::{DataCube, Detection, MicArray, PositionFormulas, RecordingOptions, Sweep};
use crate::choice::choice;
use crate::scene::Unit;
use crate::wave::{Geometry, Interface};
use glam::DVec3;
use serde_json::{Value, json};
use std::path::PathBuf;

choice! {
    /// Unit of frequencies.
    pub enum FrequencyUnit: "frequency unit" {
        /// 1 Hz.
        Hertz = "Hz",
        /// 10³ Hz.
        Kilohertz = "kHz",
        /// 10⁶ Hz.
        Megahertz = "MHz",
        /// 10⁹ Hz.
        Gigahertz = "GHz",
    }
}

impl FrequencyUnit {
    /// The unit in Hz.
    pub fn hertz(self) -> f64 {
        match self {
            Self::Hertz => 1.0,
            Self::Kilohertz => 1e3,
            Self::Megahertz => 1e6,
            Self::Gigahertz => 1e9,
        }
    }
}

/// What is imported, and what its files do not say; `None` where nobody said it.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct ImportOptions {
    /// The files of all positions (`.npy`, `.npz`, or `.wav` in the order of the microphones), or one of each position in the order of the microphones (`.sNp`,
    /// `.csv`), or the pattern of their names.
    pub samples: Vec<PathBuf>,
    /// The array of the samples, or two: I and Q. Empty: the only ones that there are.
    pub arrays: Vec<ArrayName>,
    /// What each axis is; empty: the only order that suits the lengths.
    pub axes: Vec<ImportAxis>,
    /// Subtracted from the raw numbers.
    pub offset: Option<RawOffset>,
    /// Name of an array in the samples' `.npz`, or a `.npy` or `.csv` file.
    pub frequencies: Option<PathBuf>,
    /// Unit of these, and of those in CSV files.
    pub frequency_unit: FrequencyUnit,
    /// Name of an array in the samples' `.npz`, or a `.npy` file: `[n, 3]` or `[n_y, n_x, 3]`, m.
    pub positions: Option<PathBuf>,
    /// Formulas of the positions, instead of [`ImportOptions::positions`] and [`ImportOptions::array`].
    pub formulas: Option<PositionFormulas>,
    /// Unit of the numbers in names of files.
    pub name_unit: Option<Unit>,
    /// The parameter of Touchstone files; `None`: S11 of one port, S21 of two.
    pub parameter: Option<String>,
    /// The columns of CSV files; empty: their header says it.
    pub columns: Vec<TraceColumn>,
    /// −1 if a path delays the phase negatively; `None`: as the format defines, or else 1.
    pub phase_sign: Option<i32>,
    /// The frequencies, where no file has them.
    pub sweep: Option<Sweep>,
    /// The microphones, where no file has them.
    pub array: Option<MicArray>,
    /// Where the middle of positions from names of files goes, m; `None`: they are in the array's frame.
    pub centre: Option<DVec3>,
    /// Speaker; `None`: at the origin.
    pub geometry: Option<Geometry>,
    /// Several loudspeakers, m, in the order in which they sounded: the order of the axis [`ImportAxis::Transmission`], or
    /// of as many files for each. With an axis [`ImportAxis::Pair`] one for each microphone.
    pub sources: Vec<DVec3>,
    /// Name of an array in the samples' `.npz`, or a `.npy` or `.csv` file, `[n, 3]`, that holds them.
    pub source_file: Option<PathBuf>,
    /// What was detected; it must suit the samples.
    pub detection: Option<Detection>,
    /// m/s; `None`: that of air at 20 °C.
    pub sound_speed: Option<f64>,
    /// A plane beyond which sound has another speed.
    pub interface: Option<Interface>,
    /// How recordings (`.wav`) were made.
    pub recording: RecordingOptions,
    /// Maximum bytes of an array, a text or a recording; `None`: no limit.
    pub memory: Option<u64>,
}

impl ImportOptions {
    /// Of these files, without anything else said.
    pub fn new(samples: Vec<PathBuf>) -> Self {
        Self {
            samples,
            arrays: Vec::new(),
            axes: Vec::new(),
            offset: None,
            frequencies: None,
            frequency_unit: FrequencyUnit::Hertz,
            positions: None,
            formulas: None,
            name_unit: None,
            parameter: None,
            columns: Vec::new(),
            phase_sign: None,
            sweep: None,
            array: None,
            centre: None,
            geometry: None,
            sources: Vec::new(),
            source_file: None,
            detection: None,
            sound_speed: None,
            interface: None,
            recording: RecordingOptions::default(),
            memory: None,
        }
    }

    pub(super) fn limit(&self) -> u64 {
        self.memory.unwrap_or(u64::MAX)
    }
}

/// A cube, and what had to be guessed for it.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct Imported {
    /// The cube, with phase sign +1; its provenance says how it was imported.
    pub cube: DataCube,
    /// What nobody said, one sentence each.
    pub guesses: Vec<String>,
    /// What is probably wrong with the files, one sentence each.
    pub warnings: Vec<String>,
}

impl Imported {
    /// What was found, and the guesses, as JSON.
    pub fn facts(&self) -> Value {
        let instrument = &self.cube.instrument;
        let (sweep, array) = (&instrument.sweep, &instrument.array);
        let mut facts = json!({
            "kind": "import",
            "frequencies": sweep.len(),
            "start_hz": sweep.start(), "stop_hz": sweep.stop(), "step_hz": sweep.step(),
            "microphones": array.len(),
            "array_shape": array.shape(),
            "on_a_lattice": array.lattice().is_some(),
            "array_centre_m": array.centre().to_array(),
            "array_extent_m": array.extent().to_array(),
            "geometry": instrument.geometry.kind(),
            "source_m": match instrument.geometry {
                Geometry::FixedSource { source } => Some(source.to_array()),
                Geometry::Monostatic | Geometry::Pair { .. } => None,
            },
            "detection": instrument.detection,
            "sound_speed_m_per_s": instrument.sound_speed,
            "range_resolution_m": instrument.range_resolution(),
        });
        if instrument.transmissions() > 1 {
            let sources = instrument.sources();
            facts["speakers"] = json!(sources.len());
            facts["sources_m"] = json!(sources.iter().map(DVec3::to_array).collect::<Vec<_>>());
        }
        if let (Some(facts), Some(import)) =
            (facts.as_object_mut(), self.cube.provenance["import"].as_object())
        {
            facts.extend(import.clone());
        }
        facts
    }
}
