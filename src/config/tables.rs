//! The tables of a run file, key by key, as typed: lengths in m, frequencies in Hz, angles in degrees.
//!
//! A key whose absence has a meaning of its own is an `Option`; every other key has the default that `Default` gives.

mod calibration;
mod coding;
mod import;
mod instrument;
mod measurement;
mod pair;
mod recording;
mod results;
mod scene;

pub use calibration::CalibrationTable;
pub(in crate::config) use calibration::MEAN;
pub use coding::CodingTable;
pub use import::{ImportTable, TypedFormulas, TypedPositions};
pub use instrument::InstrumentTable;
pub use measurement::{ArrayTable, DetectionTable, MediumTable, SweepTable};
pub use recording::{RecordingTable, ReferenceChannel};
pub use results::{DepthTable, ExpectTable, GridTable, Limit, OutputTable, ReconstructTable, RefineTable};
pub use scene::{ReflectorsTable, ScenePart, SceneTable};
