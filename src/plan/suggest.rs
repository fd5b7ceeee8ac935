//! A grid for a measurement that came without one.

use super::Instrument;
use crate::grid::{Axis, Grid};
use glam::DVec3;

/// A suggested grid is as wide as the array, but at least this many centre wavelengths.
const LEAST_WIDTH: f64 = 8.0;

/// It begins half its width away and is at most this many widths deep: farther out, lateral resolution is poor.
const DEEPEST: f64 = 3.0;

/// Fewer depths than this show nothing.
const FEWEST_DEPTHS: usize = 8;

/// Voxels beyond which a first look takes coarser ones.
const MOST_VOXELS: u64 = 32_000_000;

impl Instrument {
    /// A grid to begin with: as wide as the array and before it, as deep as the frequency step leaves unambiguous,
    /// and as fine as the resolution at its middle asks for. Where the step leaves very little, it is smaller.
    pub fn suggested_grid(&self) -> Grid {
        let mut scale = 1.0;
        loop {
            let grid = self.unambiguous_grid(scale);
            if grid.z.count >= FEWEST_DEPTHS || scale < 0.05 {
                return grid;
            }
            scale *= 0.7;
        }
    }

    /// The grid of `scale` times the width, its depths cut to what is unambiguous and not too many voxels.
    fn unambiguous_grid(&self, scale: f64) -> Grid {
        let (centre, extent) = (self.array.centre(), self.array.extent());
        let least = LEAST_WIDTH * self.wavelength();
        let [w_x, w_y] = [extent.x, extent.y].map(|extent| scale * extent.max(least));
        let width = w_x.max(w_y);
        let near = centre.z + 0.5 * width;
        let pitch = self.advised_pitch(near + 0.5 * DEEPEST * width);
        // Ends to the millimetre read better.
        let across = |middle: f64, width: f64, pitch: f64| {
            let first = ((middle - 0.5 * width) * 1e3).floor() / 1e3;
            let last = ((middle + 0.5 * width) * 1e3).ceil() / 1e3;
            Axis { first, pitch, count: ((last - first) / pitch + 1e-6) as usize + 1 }
        };
        let first = (near.max(0.0) * 1e3).ceil() / 1e3;
        let mut grid = Grid {
            x: across(centre.x, w_x, pitch[0]),
            y: across(centre.y, w_y, pitch[1]),
            z: Axis { first, pitch: pitch[2], count: (DEEPEST * width / pitch[2]) as usize + 1 },
        };
        let unambiguous = self.unambiguous_path().unwrap_or(f64::INFINITY);
        let ambiguous = |grid: &Grid| self.ambiguous_length(self.path_bounds(grid)) > unambiguous;
        while grid.z.count > 1 && (ambiguous(&grid) || grid.voxel_count() > MOST_VOXELS) {
            grid.z.count -= grid.z.count.div_ceil(20);
        }
        grid
    }

    /// [`Instrument::suggested_grid`] as the table of a run file, ready to be pasted.
    pub fn suggested_grid_table(&self) -> String {
        let grid = self.suggested_grid();
        // Half a pitch more keeps the last voxel whatever the rounding; the reader takes the largest that fits.
        let ends = |axis: &Axis| format!("[{:?}, {:.3}]", axis.first, axis.last() + 0.5 * axis.pitch);
        let pitch = DVec3::new(grid.x.pitch, grid.y.pitch, grid.z.pitch);
        format!(
            "[grid]\nx = {}\ny = {}\nz = {}\npitch = [{:?}, {:?}, {:?}]",
            ends(&grid.x),
            ends(&grid.y),
            ends(&grid.z),
            pitch.x,
            pitch.y,
            pitch.z
        )
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::test_instrument;
    use super::super::{JobArrays, estimate_job, plan};
    use crate::acquisition::Detection;
    use crate::reconstruct::ReconstructOptions;

    #[test]
    fn a_suggested_grid_is_unambiguous_fits_and_stands_before_the_array() {
        for (count, extent, step) in [(31, 1.0, 40.0), (4, 0.1, 400.0), (64, 2.0, 100.0), (2, 0.01, 20.0)] {
            for detection in [Detection::Quadrature, Detection::InPhase] {
                let instrument = &test_instrument(count, extent, step, detection);
                let grid = instrument.suggested_grid();
                let plan = plan(instrument, &grid);
                let ambiguous = plan.warnings.iter().any(|w| w.contains("unambiguous"));
                assert!(!ambiguous, "{:?}", plan.warnings);
                let (samples, volume) = (instrument.cube_bytes(), grid.volume_bytes());
                let arrays = JobArrays { volume, ..JobArrays::measured(instrument, samples) };
                let options = ReconstructOptions::default();
                let estimate = estimate_job(instrument, &grid, &options, &arrays, 2).expect("ok");
                assert!(estimate.check_memory(instrument, &grid, &arrays, Some(4 << 30)).is_ok());
                assert!(grid.z.first > 0.0 && grid.z.count >= 8, "{grid:?}");
                let width = grid.x.last() - grid.x.first;
                assert!(width > 0.9 * extent || (detection == Detection::InPhase && step > 40.0), "{grid:?}");
            }
        }
    }
}
