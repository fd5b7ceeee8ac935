//! How strong and how clear a peak is.

use super::{ArraySidelobes, DepthOptions};
use crate::error::Result;
use crate::grid::pixel_values;

/// Least power of a detection, over that of the noise: smoothed noise is seldom so strong, and its neighbours do not continue
/// it where it is.
const DETECTABLE: f32 = 3.7;

/// How much of the noise floor is left where it is all that there is.
const REST: f32 = 0.1;

/// Mean noise over the power that a quarter of the voxels are below, when smoothed.
const MEAN_NOISE: f32 = 1.2;

/// Contrast beyond which a peak is clear, dB: a mirror's glint has any contrast, and so have its far sidelobes.
const CLEAR: f64 = 20.0;

/// What is outside the grid counts from so far above what a volume shows at the least, dB, since what is in it is heard outside up to 4 dB
/// above it; and at the most, since of arcs of constant path the densest array leaves some.
const LOUDER_DB: [f64; 2] = [6.0, 30.0];

/// What is so far above an array's mean sidelobes is none, dB: the strongest of a small object are 15 dB above them. So many
/// microphones see a weak surface beside a bright one that is not shown.
const ABOVE_MEAN_DB: f64 = 18.0;

/// The part of its power that levels are against: at least what smoothing and the gate leave of surfaces, and more with fewer
/// microphones, as if the sidelobes of so many of its resolution cells were added up.
const LEFT: [f64; 2] = [0.2, 0.5];
const CELLS: f64 = 480.0;

/// Voxels from which the noise floor is estimated.
const SAMPLES: usize = 1 << 16;

/// What the power of a peak is compared with.
#[derive(Debug, Clone, Copy)]
pub(super) struct Levels {
    /// 99th percentile of the columns' maxima; the maximum itself is driven by speckle.
    pub(super) reference: f32,
    /// Mean power of the noise; 0 where it is not told from the rest.
    pub(super) noise: f32,
    /// Least power of any return.
    pub(super) floor: f32,
}

impl Levels {
    /// Those of columns with these maxima, whatever noise is in them.
    ///
    /// # Errors
    /// When a copy of the maxima does not fit in memory.
    pub(super) fn of(maxima: &[(f32, usize)], options: &DepthOptions) -> Result<Self> {
        let mut powers = pixel_values(0.0, maxima.len())?;
        powers.iter_mut().zip(maxima).for_each(|(power, (maximum, _))| *power = *maximum);
        let floor = (options.floor * options.floor) as f32;
        Ok(Self { reference: percentile_99(&mut powers), noise: 0.0, floor })
    }

    /// The same, with the noise floor of the volume: a quarter of its voxels are taken to hold nothing else.
    ///
    /// Without noise that is the floor of sidelobes, which is everywhere as well.
    pub(super) fn with_noise_of(self, power: &[f32]) -> Self {
        let mut some: Vec<f32> =
            power.iter().copied().step_by(power.len() / SAMPLES + 1).filter(|p| *p > 0.0).collect();
        if some.is_empty() {
            return self;
        }
        let quarter = some.len() / 4;
        Self { noise: MEAN_NOISE * *some.select_nth_unstable_by(quarter, f32::total_cmp).1, ..self }
    }

    /// The same beside the strongest echo outside the grid, if that is far above `shown`, the 99th percentile of the columns' maxima
    /// before they are smoothed and gated: its sidelobes are no surfaces.
    pub(super) fn beside(self, shown: f32, outside: f64, sidelobes: ArraySidelobes) -> Self {
        let outside = outside * outside;
        let [least, most] = LOUDER_DB;
        let louder_db = -(sidelobes.mean_db + ABOVE_MEAN_DB);
        if outside <= f64::from(shown) * 10f64.powf(louder_db.clamp(least, most) / 10.0) {
            return self;
        }
        let left = (CELLS * 10f64.powf(sidelobes.mean_db / 10.0)).clamp(LEFT[0], LEFT[1]);
        Self { reference: self.reference.max((left * outside) as f32), ..self }
    }

    /// The least power of a peak for a threshold in dB against the reference; never below the floor.
    pub(super) fn detectable(self, threshold_db: f64) -> f32 {
        let relative = self.reference * 10f64.powf(threshold_db / 10.0) as f32;
        relative.max(DETECTABLE * self.noise).max(self.floor)
    }

    /// Power beyond that of the noise.
    pub(super) fn beyond_noise(self, power: f32) -> f32 {
        (power - self.noise).max(REST * self.noise)
    }

    /// The median of a column beyond the noise. Where a ray has left the grid, its column is 0, which does not count.
    pub(super) fn clutter(self, column: &[f32]) -> f32 {
        let mut inside: Vec<f32> = column.iter().copied().filter(|v| *v > 0.0).collect();
        let middle = (inside.len() / 2).min(inside.len().saturating_sub(1));
        let median =
            if inside.is_empty() { 0.0 } else { *inside.select_nth_unstable_by(middle, f32::total_cmp).1 };
        self.beyond_noise(median)
    }

    /// The confidence in a peak, dB: its level against the reference, plus half of its contrast, at most [`CLEAR`], to the
    /// clutter of its column.
    pub(super) fn confidence(self, peak: f32, clutter: f32) -> f64 {
        let peak = f64::from(peak);
        let level = |ratio: f64| 10.0 * ratio.max(1e-20).log10();
        let clutter = f64::from(clutter).max(peak * 1e-20);
        level(peak / f64::from(self.reference)) + 0.5 * level(peak / clutter).min(CLEAR)
    }
}

/// The 99th percentile of values, which it sorts, interpolated linearly.
fn percentile_99(sorted: &mut [f32]) -> f32 {
    sorted.sort_unstable_by(f32::total_cmp);
    let Some(last) = sorted.len().checked_sub(1) else { return 0.0 };
    let place = 0.99 * last as f64;
    let (below, above) = (sorted[place.floor() as usize], sorted[place.ceil() as usize]);
    below + (above - below) * place.fract() as f32
}

/// Whether `column[i]` is a local maximum; the first of equal neighbours counts.
pub(super) fn is_peak(column: &[f32], i: usize) -> bool {
    (i == 0 || column[i] > column[i - 1]) && (i + 1 == column.len() || column[i] >= column[i + 1])
}

/// Offset of the vertex of the parabola through a peak and its neighbours, in voxels, within ±½.
pub(super) fn parabola(column: &[f32], i: usize) -> f64 {
    if i == 0 || i + 1 >= column.len() {
        return 0.0;
    }
    let [a, b, c] = [column[i - 1], column[i], column[i + 1]].map(f64::from);
    let curvature = a - 2.0 * b + c;
    if curvature < 0.0 { (0.5 * (a - c) / curvature).clamp(-0.5, 0.5) } else { 0.0 }
}
