//! What a value does to a point's wavefront that no displacement of the point could do as well.
//!
//! A wrong parameter changes the path of a point to every microphone by ΔL(r). The image of the point moves to where that is
//! explained best, which the least-squares fit of the path's gradient to ΔL finds; only what is left blurs it. Nothing is left of
//! a tilt about a speaker in the array's centre, for example: the image turns, and is as sharp as before.

use super::parameter::{Corrected, FocusParameter};
use crate::acquisition::{DataCube, Instrument};
use crate::error::Result;
use crate::grid::Grid;
use crate::linalg::{LeastSquares, Matrix, product};
use glam::DVec3;

/// Most microphones that are looked at.
const MOST: usize = 400;

/// Relative to the columns of gradients, so that those that are nearly dependent do no harm.
const DAMPING: f64 = 1e-6;

/// rms of the phase, rad at the band's centre, by which microphones disagree about the best place of a point, with `value`
/// instead of the cube's own; the largest over the middle of the region and its corners.
pub(super) fn blur(
    parameter: FocusParameter,
    cube: &DataCube,
    corrected: Corrected,
    grid: &Grid,
    value: f64,
) -> Result<f64> {
    let own = parameter.of(&cube.instrument, corrected);
    if let Some(motion) = corrected.motion.filter(|_| parameter.is_velocity()) {
        // A phase of q x² cycles over -1 < x < 1 has an rms of q √(4/45) about its mean.
        let [_, cycles] = FocusParameter::of_velocity(&cube.instrument, motion);
        return Ok(std::f64::consts::TAU * ((value - own) * cycles).abs() * (4.0_f64 / 45.0).sqrt());
    }
    let [before, after] = [own, value].map(|value| parameter.instrument(cube, corrected, value));
    let (before, after) = (before?, after?);
    let delay = if parameter == FocusParameter::Delay { value - own } else { 0.0 };
    let (low, high) = grid.bounds();
    let places = grid.corners().into_iter().chain([low.midpoint(high)]);
    let left = places.map(|p| residual(&before, &after, p, delay)).fold(0.0, f64::max);
    Ok(std::f64::consts::TAU * before.sweep.centre() / before.sound_speed * left)
}

/// rms of what is left of ΔL at a point, m of path at the speed of sound before.
fn residual(before: &Instrument, after: &Instrument, p: DVec3, delay: f64) -> f64 {
    let n_mic = before.array.len();
    let some: Vec<usize> = (0..n_mic).step_by(n_mic.div_ceil(MOST)).collect();
    // Of every transmission those microphones.
    let each = (0..before.transmissions()).map(|index| [before, after].map(|all| all.transmission(index)));
    let each: Vec<[Instrument; 2]> = each.collect();
    let rows = each.len() * some.len();
    let change = |row: usize| {
        let ([before, after], r) = (&each[row / some.len()], some[row % some.len()]);
        let path = |at: &Instrument| at.path_length_at(p, r) / at.sound_speed;
        before.sound_speed * (path(after) - path(before)) + delay
    };
    let changes = Matrix::from_fn(rows, 1, |row, _| change(row));
    let of_row =
        |row: usize, axis: usize| gradient(&each[row / some.len()][0], p, some[row % some.len()], axis);
    let gradients = Matrix::from_fn(rows, 3, of_row);
    let moved = LeastSquares::damped(&gradients, DAMPING).solve(&changes);
    let explained = product(&gradients, &moved);
    let left = (0..rows).map(|i| (changes[(i, 0)] - explained[(i, 0)]).powi(2)).sum::<f64>();
    (left / rows as f64).sqrt()
}

/// How the path from speaker to microphone changes as the point moves along an axis.
fn gradient(instrument: &Instrument, p: DVec3, microphone: usize, axis: usize) -> f64 {
    let step = DVec3::AXES[axis] * (1e-3 * instrument.shortest_wavelength());
    let path = |p: DVec3| instrument.path_length_at(p, microphone);
    (path(p + step) - path(p - step)) / (2.0 * step[axis])
}
