//! A volume small enough for a page: the maximum amplitude of blocks of voxels, as 8-bit levels.

use super::payload::pack;
use crate::export::amplitude::Amplitude;
use crate::grid::{Axis, Grid, Volume};
use rayon::prelude::*;
use serde_json::{Value, json};

/// Range of the scale below the peak, dB.
pub(super) const RANGE_DB: f32 = 40.0;

/// Maximum number of voxels: 2 MB before compression.
const MOST_VOXELS: usize = 1 << 21;

/// Maximum number of voxels along one axis that every WebGL 2 supports.
const MOST_ALONG: usize = 256;

/// A reduced volume.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Miniature {
    full: Grid,
    /// Voxels per block along x, y, z.
    factors: [usize; 3],
    grid: Grid,
    /// Maximum amplitude of each block, `[z, y, x]`.
    maxima: Vec<f32>,
}

impl Miniature {
    /// An empty reduction of a volume with this grid: at most 2²¹ blocks, and 256 along each axis.
    pub(crate) fn new(full: Grid) -> Self {
        let counts = [full.x.count, full.y.count, full.z.count];
        let mut factors = [1_usize; 3];
        loop {
            let blocks: [usize; 3] = std::array::from_fn(|i| counts[i].div_ceil(factors[i]));
            let longest = (0..3).max_by_key(|&i| (blocks[i], i)).unwrap_or(0);
            if blocks[longest] <= MOST_ALONG && blocks.iter().product::<usize>() <= MOST_VOXELS {
                break;
            }
            factors[longest] += 1;
        }
        let reduced = |axis: Axis, factor: usize| Axis {
            first: axis.first + axis.pitch * (factor - 1) as f64 / 2.0,
            pitch: axis.pitch * factor as f64,
            count: axis.count.div_ceil(factor),
        };
        let grid = Grid {
            x: reduced(full.x, factors[0]),
            y: reduced(full.y, factors[1]),
            z: reduced(full.z, factors[2]),
        };
        let maxima = vec![0.0; grid.plane_len() * grid.z.count];
        Self { full, factors, grid, maxima }
    }

    /// The reduction of all values of a grid, `[z, y, x]`.
    fn of<T: Sync>(grid: Grid, values: &[T], amplitude: impl Fn(&T) -> f32 + Sync) -> Self {
        let mut miniature = Self::new(grid);
        let Self { factors, maxima, grid: reduced, .. } = &mut miniature;
        let blocks = maxima.par_chunks_mut(reduced.plane_len());
        blocks.zip(values.par_chunks(grid.plane_len() * factors[2])).for_each(|(blocks, planes)| {
            for plane in planes.chunks(grid.plane_len()) {
                raise(blocks, *factors, [grid.x.count, reduced.x.count], plane.iter().map(&amplitude));
            }
        });
        miniature
    }

    /// The reduction of a complex volume.
    pub(crate) fn of_volume(volume: &Volume) -> Self {
        Self::of(volume.grid, &volume.samples, |sample| sample.norm())
    }

    /// The reduction of a volume's amplitudes.
    pub(crate) fn of_amplitude(volume: &Amplitude) -> Self {
        Self::of(volume.grid, &volume.values, |value| *value)
    }

    /// Maximum amplitude.
    pub(crate) fn peak(&self) -> f32 {
        self.maxima.iter().copied().fold(0.0, f32::max)
    }

    pub(super) fn to_json(&self) -> Value {
        let peak = self.peak();
        let codes: Vec<u8> = self.maxima.par_iter().map(|&value| code(value, peak)).collect();
        json!({
            "x": self.grid.x,
            "y": self.grid.y,
            "z": self.grid.z,
            "voxels": [self.full.x.count, self.full.y.count, self.full.z.count],
            "reduced": self.factors,
            "peak": peak,
            "data": pack(&codes),
        })
    }
}

/// Raises the maxima of blocks `[y, x]` to the values of a plane, whose rows are `n_x` values and `columns` blocks long;
/// values that are not finite count as 0.
fn raise(
    blocks: &mut [f32],
    [f_x, f_y, _]: [usize; 3],
    [n_x, columns]: [usize; 2],
    plane: impl IntoIterator<Item = f32>,
) {
    for (i, value) in plane.into_iter().enumerate() {
        let block = &mut blocks[i / n_x / f_y * columns + i % n_x / f_x];
        if value > *block && value.is_finite() {
            *block = value;
        }
    }
}

/// An amplitude as an 8-bit level: 255 is the peak, 0 is [`RANGE_DB`] below it or less, with even steps in dB.
pub(super) fn code(value: f32, peak: f32) -> u8 {
    if !(value > 0.0 && peak > 0.0 && value.is_finite()) {
        return 0;
    }
    let decibels = 20.0 * (value / peak).log10();
    (255.0 * (1.0 + decibels / RANGE_DB)).round().clamp(0.0, 255.0) as u8
}

#[cfg(test)]
mod tests {
    use super::*;
    use num_complex::Complex32;

    fn grid(x: usize, y: usize, z: usize) -> Grid {
        let axis = |first, pitch, count| Axis { first, pitch, count };
        Grid { x: axis(-1.0, 0.5, x), y: axis(2.0, 0.25, y), z: axis(1.0, 0.01, z) }
    }

    #[test]
    fn a_small_volume_is_unchanged() {
        let samples = (0..60).map(|i| Complex32::new(0.0, -(i as f32))).collect();
        let miniature = Miniature::of_volume(&Volume::new(grid(3, 4, 5), samples));
        assert_eq!(miniature.grid, grid(3, 4, 5));
        assert!(miniature.maxima.iter().enumerate().all(|(i, v)| *v == i as f32));
        assert_eq!(miniature.peak(), 59.0);
    }

    #[test]
    fn blocks_have_their_maximum_voxel_and_their_position() {
        let full = grid(700, 3, 2);
        let mut values = [vec![0.0; 2100], vec![0.25_f32; 2100]].concat();
        values[2100 + 700 + 5] = 2.0;
        values[2100 + 1400] = f32::NAN;
        let miniature = Miniature::of(full, &values, |value| *value);
        assert_eq!(miniature.factors, [3, 1, 1]);
        let blocks = miniature.grid.x.count;
        assert_eq!((blocks, miniature.grid.plane_len()), (234, 702));
        let maxima: Vec<_> = (0..1404).filter(|&i| miniature.maxima[i] == 2.0).collect();
        assert_eq!(maxima, [702 + blocks + 1]);
        // Block 1 contains voxels 3, 4 and 5, and is at the middle one.
        assert!((miniature.grid.x.position(1) - full.x.position(4)).abs() < 1e-12);
        assert_eq!(miniature.maxima[702 + 2 * blocks], 0.25, "NaN counts as 0");
    }

    #[test]
    fn volumes_of_every_size_are_reduced_to_the_limits() {
        for counts in [[1024, 1024, 1024], [4000, 1, 1], [257, 256, 256], [128, 128, 128], [1, 1, 100_000]] {
            let miniature = Miniature::new(grid(counts[0], counts[1], counts[2]));
            let blocks = [miniature.grid.x.count, miniature.grid.y.count, miniature.grid.z.count];
            assert!(
                blocks.iter().product::<usize>() <= MOST_VOXELS && blocks.iter().all(|&n| n <= MOST_ALONG)
            );
            assert!(blocks.iter().zip(&counts).zip(&miniature.factors).all(|((b, n), f)| b * f >= *n));
        }
        assert_eq!(Miniature::new(grid(128, 128, 128)).factors, [1; 3]);
    }

    #[test]
    fn codes_are_even_steps_of_decibels() {
        assert_eq!([code(2.0, 2.0), code(0.02, 2.0), code(0.001, 2.0), code(0.0, 2.0)], [255, 0, 0, 0]);
        assert_eq!(code(0.2, 2.0), 128, "halfway in dB");
        assert_eq!([code(1.0, 0.0), code(f32::NAN, 1.0), code(f32::INFINITY, 1.0)], [0; 3]);
    }
}
