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
    /// How many times a path contains the way back, on average of both of a pair's.
    pub(crate) legs: f64,
    /// Where a pair's loudspeaker is along the lines, from its microphone, m; else 0.
    pub(crate) apart: f64,
}

impl LineView {
    /// `None` where the microphones are on no lattice, or loudspeakers of pairs beside their lines.
    pub(crate) fn new(instrument: &Instrument, grid: &Grid, along: usize) -> Option<Self> {
        let lattice = instrument.array.lattice()?;
        let across = 1 - along;
        let (source, apart) = match instrument.geometry {
            Geometry::FixedSource { source } => (Some([source[along], source[across], source.z]), 0.0),
            Geometry::Monostatic => (None, 0.0),
            Geometry::Pair { offset } => {
                let on_lines = offset[across] == 0.0 && offset.z == 0.0 && !instrument.has_differing_pairs();
                (None, on_lines.then_some(offset[along])?)
            }
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
            legs: instrument.geometry.scanned_legs(),
            apart,
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

    /// The way back, in one of its legs, from ρ to a microphone so far along the line: the mean of both of a pair's, m.
    #[inline]
    pub(crate) fn leg(&self, rho: f64, along: f64) -> f64 {
        let length = |along: f64| (rho * rho + along * along).sqrt();
        if self.apart == 0.0 { length(along) } else { 0.5 * (length(along) + length(along + self.apart)) }
    }

    /// How far microphones and loudspeakers of pairs are aside of a column, along the line: the least and the most, m.
    pub(crate) fn aside(&self, column: f64) -> [f64; 2] {
        let first = self.microphones.first + self.apart.min(0.0);
        let last = self.microphones.last() + self.apart.max(0.0);
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
