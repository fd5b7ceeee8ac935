//! The surface at a pixel: a plane through the power around it.

use super::power::Power;
use super::{DepthOptions, stride, visited};
use crate::wave::simd::{LANES, dispatched};
use glam::{DMat3, DVec3};

/// σ of the neighbourhood, in lateral resolutions and at least in voxels, and where it ends, in σ.
const NEIGHBOURHOOD: f64 = 0.67;
const LEAST_NEIGHBOURHOOD: f64 = 0.6;
const EXTENT: f64 = 2.5;

/// How far along z power counts: at first, when no slope is known, and then at most, in Δd, and at least in lateral
/// resolutions, as a slope blurs.
const REACH: [f64; 2] = [4.0, 5.0];
const LEAST_REACH: [f64; 2] = [1.5, 2.0];

/// The same of a facing plane, in Δd, and what a slope adds, in lateral resolutions times the slope.
const REACH_FACING: f64 = 2.0;
const REACH_SLOPE: f64 = 1.2;

/// Most steps of the fit, and the change of the plane within the neighbourhood with which it ends, in Δd.
const STEPS: usize = 5;
const CONVERGED: f64 = 0.003;

/// Maximum slope.
const STEEPEST: f64 = 4.0;

/// Weight of a plane without slope, in σ².
const RIDGE: f64 = 0.01;

/// Variance of power about a plane that is no error but the width of a point's image, in Δd², and the least share of it that
/// counts as error. With these, 68 % of the errors in the shipped scenes are within the standard error.
const IMAGE_VARIANCE: f64 = 0.14;
const LEAST_VARIANCE: f64 = 0.1;

/// A plane's place at a pixel.
#[derive(Debug, Clone, Copy)]
pub(super) struct TangentPlane {
    /// Depth at which the pixel's ray meets it, m.
    pub(super) depth: f64,
    /// How fast its depth grows along x and y.
    pub(super) slope: [f64; 2],
    /// Standard error of the depth, m.
    pub(super) error: f64,
    /// Power around it, weighted.
    pub(super) mass: f64,
}

impl TangentPlane {
    /// The unit normal that faces the array.
    pub(super) fn normal(&self) -> [f32; 3] {
        let [a, b] = self.slope;
        DVec3::new(a, b, -1.0).normalize().as_vec3().to_array()
    }
}

/// A column of a row of the neighbourhood.
#[derive(Debug, Clone, Copy)]
struct Column {
    /// Where its voxels begin.
    start: usize,
    /// Offset along x, in σ.
    u: f32,
    weight: f32,
    /// The plane's height there, in voxels.
    middle: f32,
}

/// Weighted sums over the voxels of a row of columns, lane by lane: of 1, u, u², e, e u, e² and of the weight itself, with e
/// the distance from the plane over the reach.
type RowSums = [[f32; LANES]; 7];

dispatched! {
    /// Adds the voxels of columns with the weights w = weight · P (1 − e²)² where |e| < 1.
    fn add_row = add_row_body(values: &[f32], depths: usize, columns: &[Column], scale: f32, sums: &mut RowSums)
}

#[allow(clippy::inline_always)]
#[inline(always)]
fn add_row_body(values: &[f32], depths: usize, columns: &[Column], scale: f32, sums: &mut RowSums) {
    let reach = 1.0 / scale;
    for column in columns {
        let first = (column.middle - reach).ceil().max(0.0);
        let end = ((column.middle + reach).floor() + 1.0).min(depths as f32);
        if first >= end {
            continue;
        }
        let mut at = first as usize;
        while at < end as usize {
            // Voxels behind the column's last belong to no plane.
            let mut powers = [0.0f32; LANES];
            let here = column.start + at;
            if at + LANES <= depths {
                powers.copy_from_slice(&values[here..here + LANES]);
            } else {
                powers[..depths - at].copy_from_slice(&values[here..column.start + depths]);
            }
            let offset = (at as f32 - column.middle) * scale;
            for lane in 0..LANES {
                let e = offset + lane as f32 * scale;
                let inside = (1.0 - e * e).max(0.0);
                let w = column.weight * powers[lane] * (inside * inside);
                let (wu, we) = (w * column.u, w * e);
                sums[0][lane] += w;
                sums[1][lane] += wu;
                sums[2][lane] += wu * column.u;
                sums[3][lane] += we;
                sums[4][lane] += we * column.u;
                sums[5][lane] += we * e;
                sums[6][lane] += w * w;
            }
            at += LANES;
        }
    }
}

/// Weighted sums over a neighbourhood: the normal equations of a + b · u, in units of σ across and of the reach along z.
struct NormalEquations {
    matrix: [[f64; 3]; 3],
    right: [f64; 3],
    /// Σ w.
    mass: f64,
    /// Σ w e².
    spread: f64,
    /// Σ w².
    squares: f64,
}

impl NormalEquations {
    /// Those of the power around `here`, σ m across and `reach` m along z from a plane through it with a slope.
    fn around(power: &Power, here: DVec3, slope: [f64; 2], sigma: [f64; 2], reach: f64) -> Self {
        let grid = &power.grid;
        let (mut matrix, mut right) = ([[0.0; 3]; 3], [0.0; 3]);
        let (mut spread, mut squares) = (0.0, 0.0);
        let across: Vec<(usize, f64, f64)> =
            visited(&grid.x, here.x, EXTENT * sigma[0], sigma[0] / NEIGHBOURHOOD)
                .map(|ix| {
                    let u = (grid.x.position(ix) - here.x) / sigma[0];
                    (ix, u, (-0.5 * u * u).exp())
                })
                .collect();
        let mut columns = Vec::with_capacity(across.len());
        for iy in visited(&grid.y, here.y, EXTENT * sigma[1], sigma[1] / NEIGHBOURHOOD) {
            let v = (grid.y.position(iy) - here.y) / sigma[1];
            let weight = (-0.5 * v * v).exp();
            let inside = across.iter().filter(|(_, u, _)| u * u + v * v <= EXTENT * EXTENT);
            columns.clear();
            columns.extend(inside.map(|(ix, u, w)| {
                let height = here.z + slope[0] * u * sigma[0] + slope[1] * v * sigma[1];
                Column {
                    start: (iy * grid.x.count + ix) * grid.z.count,
                    u: *u as f32,
                    weight: (weight * w) as f32,
                    middle: ((height - grid.z.first) / grid.z.pitch) as f32,
                }
            }));
            let mut sums = [[0.0; LANES]; 7];
            add_row(&power.values, grid.z.count, &columns, (grid.z.pitch / reach) as f32, &mut sums);
            let [m, mu, muu, e, eu, ee, ww] = sums.map(|lanes| f64::from(lanes.iter().sum::<f32>()));
            let row = [[m, mu, m * v], [mu, muu, mu * v], [m * v, mu * v, m * v * v]];
            for (sums, row) in matrix.iter_mut().zip(row) {
                sums.iter_mut().zip(row).for_each(|(sum, term)| *sum += term);
            }
            right.iter_mut().zip([e, eu, e * v]).for_each(|(sum, term)| *sum += term);
            (spread, squares) = (spread + ee, squares + ww);
        }
        Self { matrix, right, mass: matrix[0][0], spread, squares }
    }
}

/// Fits a plane to the power around a ray that leaves `origin`, from depth `start` on; `None` without any power there.
pub(super) fn fit(
    power: &Power,
    (origin, ray): (DVec3, DVec3),
    start: f64,
    options: &DepthOptions,
) -> Option<TangentPlane> {
    let grid = &power.grid;
    let cell = options.resolution.range;
    let mut patch = TangentPlane { depth: start, slope: [0.0; 2], error: f64::NAN, mass: 0.0 };
    for step in 0..STEPS {
        let here = origin + ray * patch.depth;
        let lateral = options.lateral_resolution(patch.depth, grid);
        let sigma = [(lateral[0], grid.x.pitch), (lateral[1], grid.y.pitch)]
            .map(|(cell, pitch)| (NEIGHBOURHOOD * cell).max(LEAST_NEIGHBOURHOOD * pitch));
        let along = (lateral[0] * patch.slope[0]).hypot(lateral[1] * patch.slope[1]);
        let widest = lateral[0].max(lateral[1]);
        let most = [0, 1].map(|k: usize| (REACH[k] * cell).max(LEAST_REACH[k] * widest));
        let reach = match step {
            0 => most[0],
            _ => (REACH_FACING * cell + REACH_SLOPE * along).min(most[1]),
        };
        let NormalEquations { mut matrix, mut right, mass, spread, squares } =
            NormalEquations::around(power, here, patch.slope, sigma, reach);
        if mass <= 0.0 {
            return None;
        }
        for axis in 0..2 {
            matrix[axis + 1][axis + 1] += RIDGE * mass;
            right[axis + 1] -= RIDGE * mass * patch.slope[axis] * sigma[axis] / reach;
        }
        let change = solve(matrix, right)?;
        patch.depth += change[0] * reach;
        for axis in 0..2 {
            patch.slope[axis] += change[axis + 1] * reach / sigma[axis];
        }
        let steepness = patch.slope[0].hypot(patch.slope[1]);
        if steepness > STEEPEST {
            patch.slope = patch.slope.map(|b| b * STEEPEST / steepness);
        }
        // Where the pixel's own ray meets the plane, which a tilted ray does elsewhere.
        let tilt = patch.slope[0] * ray.x + patch.slope[1] * ray.y;
        if tilt < 0.9 {
            let aside = origin + ray * patch.depth - here;
            patch.depth += (patch.slope[0] * aside.x + patch.slope[1] * aside.y) / (1.0 - tilt);
        }
        // Of as many independent values as there are resolution cells.
        let voxels = |cell: f64, pitch: f64| (cell / pitch / stride(cell / pitch) as f64).max(1.0);
        let dependent =
            voxels(lateral[0], grid.x.pitch) * voxels(lateral[1], grid.y.pitch) * voxels(cell, grid.z.pitch);
        let variance = spread / mass * reach * reach;
        let random = (variance - IMAGE_VARIANCE * cell * cell).max(LEAST_VARIANCE * variance);
        let of_depth = solve(matrix, [1.0, 0.0, 0.0])?[0];
        patch.error = (dependent * random * of_depth * squares / mass).sqrt();
        patch.mass = mass;
        if step > 0 && change.iter().all(|part| part.abs() * reach < CONVERGED * cell) {
            break;
        }
    }
    let (first, last) = (grid.z.first - 0.5 * grid.z.pitch, grid.z.last() + 0.5 * grid.z.pitch);
    (first..=last).contains(&patch.depth).then_some(patch)
}

/// Solves three equations of a symmetric positive matrix; `None` where it is singular.
fn solve(m: [[f64; 3]; 3], r: [f64; 3]) -> Option<[f64; 3]> {
    let m = DMat3::from_cols_array_2d(&m);
    let inverse = m.try_inverse()?;
    Some((inverse * DVec3::from(r)).to_array())
}
