//! Paths of a certain length alone.

use super::background::{change, power};
use crate::acquisition::{DataCube, Detection};
use crate::error::{Error, Result};
use num_complex::{Complex32, Complex64};
use rayon::prelude::*;
use rustfft::FftPlanner;
use std::f64::consts::{PI, TAU};

/// How many times as many samples the profile has as the band.
const FINER: usize = 4;

/// Keeps the echoes of `paths`, from and to, m; edges fall within a range cell, c/B.
///
/// Over the band, gating is a convolution, which at its ends misses what lies beyond them: there an echo in the middle of
/// the gate would be lowered. Samples are divided by what is left of such an echo, as network analysers do.
pub(super) fn keep(cube: &mut DataCube, paths: [f64; 2]) -> Result<String> {
    let place = "[calibration] gate";
    let sweep = &cube.instrument.sweep;
    let (n_f, n_mic) = (sweep.len(), cube.instrument.array.len());
    let Some(step) = sweep.step().filter(|_| n_f >= 8) else {
        let problem = "needs 8 or more evenly spaced frequencies";
        return Err(Error::input(place, problem));
    };
    let c = cube.instrument.sound_speed;
    let (unambiguous, cell) = (c / step, c / sweep.bandwidth());
    let [from, to] = paths;
    let is_real = cube.instrument.detection == Detection::InPhase;
    // Without phases a path and its mirror, which repeats as well, are one.
    let repeats = if is_real { unambiguous / 2.0 } else { unambiguous };
    if to - from >= repeats {
        let problem =
            format!("is {:.3} m long, and paths repeat after {repeats:.3} m: it would keep all", to - from);
        return Err(Error::input(place, problem));
    }
    let length = FINER * n_f;
    let mut planner = FftPlanner::<f64>::new();
    let (forward, inverse) = (planner.plan_fft_forward(length), planner.plan_fft_inverse(length));
    let start = sweep.frequencies()[0];
    let weights: Vec<f64> = (0..length)
        .map(|k| {
            let path = k as f64 / length as f64 * unambiguous;
            let both = if is_real { weight(-path, paths, unambiguous, cell) } else { 0.0 };
            weight(path, paths, unambiguous, cell).max(both) / length as f64
        })
        .collect();
    let gated = |column: &mut Vec<Complex64>| {
        column.resize(length, Complex64::ZERO);
        // The transform of exp(+i2πf·path/c) has its peak at the path.
        forward.process(column);
        column.iter_mut().zip(&weights).for_each(|(value, weight)| *value *= weight);
        inverse.process(column);
        column.truncate(n_f);
    };
    let middle = f64::midpoint(from, to) / c;
    let echo = |f: usize| Complex64::cis(TAU * (start + step * f as f64) * middle);
    let mut unit: Vec<Complex64> = (0..n_f).map(echo).collect();
    gated(&mut unit);
    // Of a gate much narrower than a cell little is left of anything; its edges are not raised beyond that.
    let ends: Vec<f64> = unit.iter().map(|left| left.norm().max(LEAST_LEFT)).collect();
    let before = power(&cube.samples);
    for samples in cube.samples.chunks_exact_mut(n_f * n_mic) {
        gate_transmission(samples, n_mic, is_real, &ends, &gated);
    }
    Ok(format!("paths from {from} to {to} m kept, {}", change(before, power(&cube.samples))))
}

/// Gates the samples of one transmission, `[n_f, n_mic]`.
fn gate_transmission(
    samples: &mut [Complex32],
    n_mic: usize,
    is_real: bool,
    ends: &[f64],
    gated: &(impl Fn(&mut Vec<Complex64>) + Sync),
) {
    let shared = &*samples;
    let columns: Vec<Vec<Complex32>> = (0..n_mic)
        .into_par_iter()
        .map(|r| {
            let own = shared[r..].iter().step_by(n_mic);
            let mut column: Vec<Complex64> = own.map(|m| Complex64::new(m.re.into(), m.im.into())).collect();
            gated(&mut column);
            let raised = column.iter().zip(ends).map(|(m, end)| m / end);
            raised.map(|m| Complex32::new(m.re as f32, m.im as f32)).collect()
        })
        .collect();
    for (r, column) in columns.iter().enumerate() {
        for (f, m) in column.iter().enumerate() {
            samples[f * n_mic + r] = if is_real { Complex32::new(m.re, 0.0) } else { *m };
        }
    }
}

/// The least share of an echo that the ends of the band are taken to keep.
const LEAST_LEFT: f64 = 0.2;

/// 1 between the `paths`, falling to 0 within a cell beyond; paths repeat.
fn weight(path: f64, [from, to]: [f64; 2], unambiguous: f64, cell: f64) -> f64 {
    let half = (to - from) / 2.0;
    let offset = (path - f64::midpoint(from, to)).rem_euclid(unambiguous);
    let beyond = offset.min(unambiguous - offset) - half;
    if beyond <= 0.0 {
        1.0
    } else if beyond >= cell {
        0.0
    } else {
        (PI / 2.0 * beyond / cell).cos().powi(2)
    }
}
