//! A job seen from lines of microphones along one axis.

use crate::acquisition::Instrument;
use crate::grid::{Axis, Grid};
use crate::wave::Geometry;
use crate::wave::simd::ROWS;
use num_complex::Complex32;

/// A job seen from lines of microphones along one axis.
#[derive(Debug, Clone)]
pub(crate) struct LineView {
    /// 0 where the lines are along x, 1 along y.
    pub(crate) along: usize,
    /// Voxels along the lines.
    pub(crate) columns: Axis,
    /// Voxels across them.
    pub(crate) rows: Axis,
    pub(crate) depths: Axis,
    /// Microphones along a line.
    pub(crate) microphones: Axis,
    /// Lines, across.
    pub(crate) lines: Axis,
    /// z of all microphones, m.
    pub(crate) height: f64,
    /// The loudspeaker's place along, across and z; `None` for a scan.
    pub(crate) source: Option<[f64; 3]>,
    /// How many times a path contains the way back.
    pub(crate) legs: f64,
}

impl LineView {
    /// `None` where the microphones are on no lattice.
    pub(crate) fn new(instrument: &Instrument, grid: &Grid, along: usize) -> Option<Self> {
        let lattice = instrument.array.lattice()?;
        let across = 1 - along;
        let source = match instrument.geometry {
            Geometry::FixedSource { source } => Some([source[along], source[across], source.z]),
            Geometry::Monostatic => None,
            // Its lines would have two places along each.
            Geometry::Pair { .. } => return None,
        };
        let voxels = [grid.x, grid.y];
        let microphones = [lattice.x, lattice.y];
        Some(Self {
            along,
            columns: voxels[along],
            rows: voxels[across],
            depths: grid.z,
            microphones: microphones[along],
            lines: microphones[across],
            height: lattice.z,
            source,
            legs: instrument.geometry.return_legs(),
        })
    }

    /// How far a voxel is from a line, m.
    pub(crate) fn rho(&self, line: f64, row: f64, depth: f64) -> f64 {
        (row - line).hypot(depth - self.height)
    }

    /// The square of the distance from the line through the loudspeaker that is parallel to the others, m².
    pub(crate) fn over_source(&self, row: f64, depth: f64) -> f64 {
        self.source.map_or(0.0, |[_, y, z]| (row - y).powi(2) + (depth - z).powi(2))
    }

    /// How far microphones are aside of a column, along the line: the least and the most, m.
    pub(crate) fn aside(&self, column: f64) -> [f64; 2] {
        let (first, last) = (self.microphones.first, self.microphones.last());
        let nearest = (first - column).max(column - last).max(0.0);
        [nearest, (column - first).abs().max((column - last).abs())]
    }

    /// The samples of one tone by lines, `[line, microphone, line]` with [`ROWS`] neighbouring lines together, zeros after the
    /// last.
    pub(crate) fn by_lines(&self, samples: &[Complex32]) -> Vec<Complex32> {
        let (lines, microphones) = (self.lines.count, self.microphones.count);
        let [of_line, of_microphone] = if self.along == 0 { [microphones, 1] } else { [1, lines] };
        let mut sorted = vec![Complex32::ZERO; lines.next_multiple_of(ROWS) * microphones];
        for line in 0..lines {
            let together = &mut sorted[line / ROWS * ROWS * microphones..];
            for (a, sample) in
                together.iter_mut().skip(line % ROWS).step_by(ROWS).take(microphones).enumerate()
            {
                *sample = samples[line * of_line + a * of_microphone];
            }
        }
        sorted
    }
}
