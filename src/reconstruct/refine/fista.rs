//! FISTA: proximal gradient steps with momentum, for amplitudes that are few.
//!
//! With F(A) the half power of what A leaves of the samples, a step from z = x + β (x − x_before) goes to the A that minimises
//! `F(z) + <∇F(z), A − z> + L/2 |A − z|² + λ Σ|A|`: the moduli of `z − ∇F(z)/L` less λ/L. L has to be at least the largest
//! eigenvalue of K*K. It begins a little above its Rayleigh quotient at K*m, and grows after a step that turns out to have
//! needed more. Where the objective would rise, the step is taken again without momentum, which begins anew (O'Donoghue and
//! Candès, Found. Comput. Math. 15, 2015).

use super::descent::Descent;
use super::operator::Operator;
use super::state::State;
use super::{RefineOptions, Refinement, Solver};
use crate::acquisition::CubeSource;
use crate::blocks::BlockStore;
use crate::error::Result;
use crate::progress::Observer;
use crate::reconstruct::{Method, ReconstructionInfo, VolumeSink};
use num_complex::Complex32;
use rayon::prelude::*;

/// L begins at this many Rayleigh quotients.
const ABOVE: f64 = 1.2;

/// It grows by at least so much.
const GROWTH: f64 = 1.3;

/// Rounding of powers, relative to that of the samples.
const ROUNDING: f64 = 1e-6;

/// λ is at least so many times the noise in a voxel.
const ABOVE_NOISE: f64 = 2.0;

/// Tries of one step.
const TRIES: usize = 20;

/// What a step needs beside volumes and tones.
#[derive(Debug, Clone, Copy)]
struct Scalars {
    /// L and λ.
    steepness: f64,
    sparsity: f64,
    /// t of the momentum.
    momentum: f64,
    /// F, and F + λ Σ|A|.
    half_power: f64,
    objective: f64,
    /// Half the power of the samples.
    half_energy: f64,
    noise: Option<f64>,
    error_bound: f64,
}

impl Scalars {
    fn pack(self) -> [f64; 8] {
        let Self { steepness, sparsity, momentum, half_power, objective, half_energy, noise, error_bound } =
            self;
        let noise = noise.unwrap_or(-1.0);
        [steepness, sparsity, momentum, half_power, objective, half_energy, noise, error_bound]
    }

    fn unpack(packed: [f64; 8]) -> Self {
        let [steepness, sparsity, momentum, half_power, objective, half_energy, noise, error_bound] = packed;
        let noise = (noise >= 0.0).then_some(noise);
        Self { steepness, sparsity, momentum, half_power, objective, half_energy, noise, error_bound }
    }
}

/// The volume `[z, y, x]` after the last step.
///
/// Cost: two sums of Eq. 13 for each step; two volumes.
pub(super) fn fista(
    operator: &Operator<'_>,
    source: &mut dyn CubeSource,
    refine: &RefineOptions,
    store: &mut dyn BlockStore,
    observer: &dyn Observer,
) -> Result<(Vec<Complex32>, ReconstructionInfo)> {
    let mut state = State::empty(operator)?;
    state.resume(store, refine.steps)?;
    let mut scalars = if state.step > 0 {
        Scalars::unpack(state.scalars)
    } else {
        begin(operator, source, refine, &mut state, observer)?
    };
    let noise = scalars.noise;
    let is_enough = |half_power: f64| operator.is_noise(2.0 * half_power, noise);
    // The first step shows what is below the noise of a sample.
    while state.step < refine.steps && (state.step == 0 || !is_enough(scalars.half_power)) {
        step(operator, source, &mut state, &mut scalars, observer)?;
        state.scalars = scalars.pack();
        state.save(store)?;
    }
    let refinement = Refinement {
        solver: Solver::Fista,
        steps: state.step,
        misfit: (scalars.half_power / scalars.half_energy.max(f64::MIN_POSITIVE)).sqrt(),
        noise: scalars.noise,
        down_to_noise: is_enough(scalars.half_power),
        sparsity: scalars.sparsity,
    };
    let plain = ReconstructionInfo::plain(Method::Convolution, scalars.error_bound);
    let info = ReconstructionInfo { refinement: Some(refinement), ..plain };
    let [volume, _] = state.volumes;
    Ok((volume, info))
}

/// λ and L from the volume of Eq. 13, which takes the place of the volume before the first.
fn begin(
    operator: &Operator<'_>,
    source: &mut dyn CubeSource,
    refine: &RefineOptions,
    state: &mut State<2, 2>,
    observer: &dyn Observer,
) -> Result<Scalars> {
    let noise = operator.noise(source, refine)?;
    let [_, other] = &mut state.volumes;
    let mut matched = Descent::new(other, operator.grid.plane_len());
    let (info, energy) = operator.image(source, None, &mut matched, observer)?;
    let Descent { largest, brightest, .. } = matched;
    // Rayleigh's quotient of the depths around the brightest, which are as steep as all and take less.
    let depths = operator.around(brightest);
    let plane_len = operator.grid.plane_len();
    let some = &other[depths.start * plane_len..depths.end * plane_len];
    let square: f64 = some.iter().map(|a| f64::from(a.norm_sqr())).sum();
    let echoes = operator.echo_of(depths, other, observer)?;
    let quotient = if square > 0.0 { operator.power(&echoes) / square } else { 1.0 };
    let in_voxels = noise.map_or(0.0, |noise| ABOVE_NOISE * operator.noise_in_voxels(noise));
    Ok(Scalars {
        steepness: ABOVE * quotient,
        sparsity: (refine.sparsity * largest.sqrt()).max(in_voxels),
        momentum: 1.0,
        half_power: 0.5 * energy,
        objective: 0.5 * energy,
        half_energy: 0.5 * energy,
        noise,
        error_bound: info.error_bound,
    })
}

/// One step that does not raise the objective.
fn step(
    operator: &Operator<'_>,
    source: &mut dyn CubeSource,
    state: &mut State<2, 2>,
    scalars: &mut Scalars,
    observer: &dyn Observer,
) -> Result<()> {
    let [current, other] = &mut state.volumes;
    let [echoes, others] = &mut state.tones;
    let next = 0.5 * (1.0 + (1.0 + 4.0 * scalars.momentum.powi(2)).sqrt());
    let mut momentum = (scalars.momentum - 1.0) / next;
    let slack = ROUNDING * scalars.half_energy;
    for tried in 1.. {
        // z, as its echoes.
        let weight = momentum as f32;
        let pairs = others.par_iter_mut().zip(&*echoes).with_min_len(1 << 12);
        pairs.for_each(|(other, echo)| *other = echo + (echo - *other) * weight);
        let mut shrunk = Shrunk {
            plane_len: operator.grid.plane_len(),
            current,
            other,
            momentum: weight,
            per_steepness: 1.0 / scalars.steepness,
            threshold: scalars.sparsity / scalars.steepness,
            sums: [0.0; 3],
        };
        let power = if state.step == 0 && tried == 1 {
            shrunk.take_own()?;
            2.0 * scalars.half_energy
        } else {
            operator.image(source, Some(others), &mut shrunk, observer)?.1
        };
        let [along, square, moduli] = shrunk.sums;
        let found = operator.echo(other, observer)?;
        let half_power = 0.5 * operator.power_left(source, &found)?;
        let objective = half_power + scalars.sparsity * moduli;
        // By how much F is above its tangent plane at z.
        let above = half_power - (0.5 * power - along);
        if above > 0.5 * scalars.steepness * square + slack {
            let needed = 2.0 * above / square.max(f64::MIN_POSITIVE);
            scalars.steepness = (GROWTH * scalars.steepness).max(1.05 * needed);
        }
        if objective <= scalars.objective + slack || tried == TRIES {
            std::mem::swap(current, other);
            *others = std::mem::replace(echoes, found);
            // After a new beginning, that of a first step.
            scalars.momentum = if tried == 1 { next } else { 0.5 * (1.0 + 5f64.sqrt()) };
            (scalars.half_power, scalars.objective) = (half_power, objective);
            break;
        }
        // Again from the last volume, without momentum.
        momentum = 0.0;
        others.copy_from_slice(echoes);
    }
    state.step += 1;
    Ok(())
}

/// A sink for −∇F(z) that puts the step's end in the place of the volume before the last.
struct Shrunk<'a> {
    plane_len: usize,
    current: &'a [Complex32],
    other: &'a mut [Complex32],
    momentum: f32,
    /// 1/L.
    per_steepness: f64,
    /// λ/L.
    threshold: f64,
    /// `<−∇F, A − z>`, `|A − z|²` and `Σ|A|`.
    sums: [f64; 3],
}

impl Shrunk<'_> {
    /// Takes what is in the place of the volume before the last: that of Eq. 13, before the first step.
    fn take_own(&mut self) -> Result<()> {
        for iz in 0..self.other.len() / self.plane_len {
            let plane = self.other[iz * self.plane_len..][..self.plane_len].to_vec();
            self.take(iz, &plane)?;
        }
        Ok(())
    }
}

impl VolumeSink for Shrunk<'_> {
    fn begin(&mut self, _: &ReconstructionInfo) -> Result<()> {
        Ok(())
    }

    fn take(&mut self, first: usize, planes: &[Complex32]) -> Result<()> {
        let range = first * self.plane_len..first * self.plane_len + planes.len();
        let (momentum, rate) = (self.momentum, self.per_steepness as f32);
        let threshold = self.threshold as f32;
        let of_voxel = |current: &Complex32, other: &mut Complex32, descent: &Complex32| {
            let z = current + (current - *other) * momentum;
            let free = z + descent * rate;
            let modulus = free.norm();
            let kept = (modulus - threshold).max(0.0);
            *other = if kept > 0.0 { free * (kept / modulus) } else { Complex32::ZERO };
            let moved = *other - z;
            let along =
                f64::from(descent.re) * f64::from(moved.re) + f64::from(descent.im) * f64::from(moved.im);
            [along, f64::from(moved.norm_sqr()), f64::from(kept)]
        };
        let planes = planes.par_chunks(self.plane_len);
        let pairs = self.current[range.clone()].par_chunks(self.plane_len).zip(planes);
        let of_plane = |((current, descent), other): ((&[Complex32], &[Complex32]), &mut [Complex32])| {
            let voxels = current.iter().zip(other).zip(descent);
            voxels.fold([0.0; 3], |sums: [f64; 3], ((current, other), descent)| {
                let own = of_voxel(current, other, descent);
                std::array::from_fn(|k| sums[k] + own[k])
            })
        };
        let sums: Vec<[f64; 3]> =
            pairs.zip(self.other[range].par_chunks_mut(self.plane_len)).map(of_plane).collect();
        for own in sums {
            self.sums = std::array::from_fn(|k| self.sums[k] + own[k]);
        }
        Ok(())
    }
}
