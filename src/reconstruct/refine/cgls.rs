//! CGLS: conjugate gradients on the normal equations, K*K A = K*m.

use super::descent::Descent;
use super::operator::Operator;
use super::state::State;
use super::{RefineOptions, Refinement, Solver};
use crate::acquisition::CubeSource;
use crate::blocks::BlockStore;
use crate::error::Result;
use crate::progress::Observer;
use crate::reconstruct::{Method, ReconstructionInfo};
use num_complex::Complex32;
use rayon::prelude::*;

/// A step that would leave less of the samples by no more than this part of their power is lost in rounding.
const LEAST_GAIN: f64 = 1e-11;

/// The volume `[z, y, x]` after the last step.
///
/// Cost: two sums of Eq. 13 for each step; three volumes.
pub(super) fn cgls(
    operator: &Operator<'_>,
    source: &mut dyn CubeSource,
    refine: &RefineOptions,
    store: &mut dyn BlockStore,
    observer: &dyn Observer,
) -> Result<(Vec<Complex32>, ReconstructionInfo)> {
    let plane_len = operator.grid.plane_len();
    let mut slopes = operator.darkness()?;
    // A and the direction of the next step; the echoes of A.
    let mut state = State::<2, 1>::empty(operator)?;
    state.resume(store, refine.steps)?;
    // |K*(m − KA)|², the powers of what is left and of the samples, the noise, and the error bound.
    let [mut square, mut power, mut energy, mut noise, mut error_bound, ..] = state.scalars;
    if state.step == 0 {
        noise = operator.noise(source, refine)?.unwrap_or(-1.0);
        let mut descent = Descent::new(&mut state.volumes[1], plane_len);
        let (info, of_samples) = operator.image(source, None, &mut descent, observer)?;
        (power, energy, error_bound, square) = (of_samples, of_samples, info.error_bound, descent.square);
    }
    let noise = (noise >= 0.0).then_some(noise);
    let is_enough = |power: f64| operator.is_noise(power, noise);
    // The first step shows what is below the noise of a sample.
    while state.step < refine.steps && square > 0.0 && (state.step == 0 || !is_enough(power)) {
        let [amplitudes, direction] = &mut state.volumes;
        let echoes = operator.echo(direction, observer)?;
        let curvature = operator.power(&echoes);
        let length = square / curvature.max(f64::MIN_POSITIVE);
        let gain = length * square;
        if curvature <= 0.0 || gain <= LEAST_GAIN * energy {
            break;
        }
        add(amplitudes, length, direction);
        add(&mut state.tones[0], length, &echoes);
        // In exact numbers that of what is left; it is measured where another step follows.
        let expected = power - gain;
        let before = std::mem::replace(&mut power, expected);
        state.step += 1;
        if state.step == refine.steps || is_enough(power) {
            break;
        }
        let mut descent = Descent::new(&mut slopes, plane_len);
        (_, power) = operator.image(source, Some(&state.tones[0]), &mut descent, observer)?;
        if before - power < 0.5 * gain {
            // Rounding is all that is left.
            break;
        }
        let conjugate = (descent.square / square) as f32;
        square = descent.square;
        let pairs = direction.par_iter_mut().zip(&slopes).with_min_len(1 << 12);
        pairs.for_each(|(direction, slope)| *direction = slope + *direction * conjugate);
        state.scalars = [square, power, energy, noise.unwrap_or(-1.0), error_bound, 0.0, 0.0, 0.0];
        state.save(store)?;
    }
    let refinement = Refinement {
        solver: Solver::Cgls,
        steps: state.step,
        misfit: (power.max(0.0) / energy.max(f64::MIN_POSITIVE)).sqrt(),
        noise,
        down_to_noise: is_enough(power),
        sparsity: 0.0,
    };
    let plain = ReconstructionInfo::plain(Method::Convolution, error_bound);
    let info = ReconstructionInfo { refinement: Some(refinement), ..plain };
    let [amplitudes, _] = state.volumes;
    Ok((amplitudes, info))
}

/// `to += factor · from`.
fn add(to: &mut [Complex32], factor: f64, from: &[Complex32]) {
    let factor = factor as f32;
    to.par_iter_mut().zip(from).with_min_len(1 << 12).for_each(|(to, from)| *to += from * factor);
}
