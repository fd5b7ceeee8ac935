//! The scene of the paper's Figure 2, as far as it can be inferred, and its simulated recording.
//!
//! Two straight lines, one pixel wide, cross right of the middle. Every pixel centre on a line is a reflector of
//! amplitude 1. The centre of the lower left pixel is the origin, with the speaker, in the middle of the row of microphones.

use super::Case;
use crate::acquisition::{
    DataCube, Detection, Instrument, MicArray, PropagationModel, SimulateOptions, Sweep, simulate,
};
use crate::error::Result;
use crate::grid::{Axis, Grid};
use crate::reflectors::Reflectors;
use glam::DVec3;
use num_complex::Complex32;

/// Number of columns, of 1 cm, and of rows, of 5 cm.
pub(super) const PIXELS: usize = 100;

/// f₀ + B, Hz.
const HIGHEST: f64 = 20_000.0;

/// δf, Hz.
const STEP: f64 = 2.0;

/// Rows of the two lines in the first and the last column: 2.0 to 3.5 m and 4.5 to 2.75 m.
const LINES: [[f64; 2]; 2] = [[40.0, 70.0], [90.0, 55.0]];

/// Where the lines cross, m.
pub(super) const CROSSING: DVec3 = DVec3::new(0.76, 0.0, 3.15);

/// The paper's pixels: a grid with a single y.
pub(super) fn grid() -> Grid {
    let axis = |pitch: f64, count: usize| Axis { first: 0.0, pitch, count };
    Grid { x: axis(0.01, PIXELS), y: axis(1.0, 1), z: axis(0.05, PIXELS) }
}

/// The row of a line in a column.
fn line_row(line: usize, column: usize) -> usize {
    let [first, last] = LINES[line];
    (first + (last - first) * column as f64 / (PIXELS - 1) as f64).round() as usize
}

/// The true picture, `[z, x]`: 1 on the lines, 0 elsewhere.
pub(super) fn truth() -> Vec<f32> {
    let mut truth = vec![0.0; PIXELS * PIXELS];
    for column in 0..PIXELS {
        for line in 0..LINES.len() {
            truth[line_row(line, column) * PIXELS + column] = 1.0;
        }
    }
    truth
}

/// The RMSE of a black picture.
pub(super) fn truth_rms() -> f64 {
    super::rmse(&truth(), &vec![0.0; PIXELS * PIXELS])
}

/// A reflector of amplitude 1 on every pixel of the lines.
pub(super) fn reflectors() -> Result<Reflectors> {
    let grid = grid();
    let positions: Vec<DVec3> = truth()
        .iter()
        .enumerate()
        .filter(|(_, a)| **a > 0.0)
        .map(|(pixel, _)| grid.position(pixel % PIXELS, 0, pixel / PIXELS))
        .collect();
    let amplitudes = vec![Complex32::ONE; positions.len()];
    Reflectors::new(positions, amplitudes)
}

/// Distance between the microphones of a case, m.
pub(super) fn pitch(case: &Case) -> f64 {
    case.extent / (case.microphones - 1) as f64
}

/// The recording of the scene, real and without noise, by summing every term.
pub(super) fn cube(case: &Case, model: PropagationModel) -> Result<DataCube> {
    cube_of(&reflectors()?, case, model)
}

/// The recording of other reflectors.
pub(super) fn cube_of(reflectors: &Reflectors, case: &Case, model: PropagationModel) -> Result<DataCube> {
    let sweep = Sweep::stepped(HIGHEST - case.bandwidth, HIGHEST, STEP)?;
    let array = MicArray::rectangular([case.microphones, 1], [pitch(case); 2], DVec3::ZERO)?;
    let instrument = Instrument::new(sweep, array).with_detection(Detection::InPhase);
    let options = SimulateOptions::default().with_model(model).with_tolerance(0.0);
    simulate(reflectors, &instrument, &options)
}
