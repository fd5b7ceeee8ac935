//! Images beyond the matched filter: amplitudes of the voxels that explain the samples best.
//!
//! Eq. 13 is the adjoint of the model of measurement, `m(f, r) = Σ_p A(p) e^{i2πf·path(p, r)/c}` (Eq. 5 with a reflector at
//! every voxel), so it shows each reflector as the array's point spread: blurred, with sidelobes. Here A is found instead,
//! by a few steps that each apply the model once and Eq. 13 once, both at the speed of the convolution:
//!
//! - [`Solver::Cgls`]: conjugate gradients on the normal equations (Hestenes and Stiefel, J. Res. NBS 49, 1952), for the A of
//!   least squares. The misfit falls with every step; steps take the part of a regularisation.
//! - [`Solver::Fista`]: the fast iterative shrinkage-thresholding algorithm (Beck and Teboulle, SIAM J. Imaging Sci. 2, 2009),
//!   for the A that minimises `½ w/Σw · Σ|m − KA|² + λ Σ|A|`: few voxels that reflect, and nothing elsewhere.
//!
//! Both stop before they explain the noise: when the misfit is down to it (Morozov's discrepancy principle). The noise is
//! [measured](noise) as what no reflector within the grid can cause.

mod cgls;
mod cost;
mod descent;
mod fista;
mod noise;
mod operator;
mod options;
mod state;
#[cfg(test)]
mod tests;

pub(super) use cost::price;
pub(crate) use options::MOST_STEPS;
pub use options::{RefineOptions, Solver};

use super::convolution::ConvolutionPlan;
use super::plan::Sampled;
use super::volume::{Batch, VolumeSink};
use super::{ReconstructOptions, ReconstructionInfo};
use crate::acquisition::CubeSource;
use crate::blocks::BlockStore;
use crate::error::Result;
use crate::grid::Grid;
use crate::progress::{Observer, stage};
use operator::Operator;
use serde::Serialize;
use std::fmt;

/// How a volume was refined.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Refinement {
    /// How.
    pub solver: Solver,
    /// Steps that were done.
    pub steps: usize,
    /// What the volume leaves of the samples' root mean square unexplained: `‖m − KA‖/‖m‖`, with the window's weights.
    pub misfit: f64,
    /// The root mean square of the noise in a sample, measured or given; `None` where it is not known.
    pub noise: Option<f64>,
    /// Whether it ended because the misfit was down to the noise.
    pub down_to_noise: bool,
    /// λ, in the units of the volume; 0 for least squares.
    pub sparsity: f64,
}

impl fmt::Display for Refinement {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { solver, steps, misfit, noise, down_to_noise, .. } = self;
        let leave = if *steps == 1 { "step leaves" } else { "steps leave" };
        write!(f, "{solver}: {steps} {leave} {:.1} % of the samples", 100.0 * misfit)?;
        match noise {
            _ if *down_to_noise => f.write_str(", no more than their noise"),
            Some(noise) => write!(f, "; their noise is {noise:.3}"),
            None => Ok(()),
        }
    }
}

/// Gives the refined volume to a sink, by the plan of a convolution.
///
/// # Errors
/// As [`super::reconstruct_into`].
pub(super) fn refine(
    source: &mut dyn CubeSource,
    grid: &Grid,
    (plan, batch): (&Sampled<ConvolutionPlan>, Batch),
    (options, refine): (&ReconstructOptions, &RefineOptions),
    (store, sink): (&mut dyn BlockStore, &mut dyn VolumeSink),
    observer: &dyn Observer,
) -> Result<ReconstructionInfo> {
    let operator = Operator::new(source.instrument(), grid, plan, batch, options);
    let work = refine.steps as u64 * operator.work();
    let (volume, info) = stage(observer, "refining", work, || {
        let solve = match refine.solver {
            Solver::Cgls => cgls::cgls,
            Solver::Fista => fista::fista,
        };
        solve(&operator, source, refine, store, observer)
    })?;
    sink.begin(&info)?;
    let wanted = sink.wanted(0..grid.z.count);
    let planes = volume.chunks(grid.plane_len()).enumerate().take(wanted.end).skip(wanted.start);
    planes.into_iter().try_for_each(|(iz, plane)| sink.take(iz, plane))?;
    Ok(info)
}
