//! The linear method: the far-field Fourier transform of Eq. 9, which the paper tried first and dropped.
//!
//! With the path of Eq. 6–7, `2|p| − p̂·r`, Eq. 13 reads
//!
//! `Â(p) = w/(Σ_f w_f · Σ_r w_r) · Σ_f e^{−i2πf·2|p|/c} Σ_r w_f w_r m(f, r) e^{+i2πf p̂·r/c}`,
//!
//! a Fourier transform over the array at `k = f·p̂₂/c`, so the angular axis scales with f (Eq. 9 drops that factor), and
//! one over the band. It is the adjoint of a simulation with `model = "linear"`, as Eq. 13 is that of Eq. 5, and images such
//! data as sharply. Of true data it is out of focus by the error of Eq. 6, about `r²/2|p|` of path: a wavelength
//! where an array of 1 m looks 7 m away at 20 kHz. It exists for comparison, `auto` never selects it, and so it is summed
//! as written, by the [direct](super) sum over these path lengths.

use super::{DirectPlan, sum_over_paths};
use crate::acquisition::Instrument;
use crate::error::Result;
use crate::reconstruct::job::Job;
use crate::reconstruct::{Method, ReconstructionInfo};

/// Gives the far-field image to the job's sink; any grid, any microphones. Cost: that of [`super::direct`].
pub(in crate::reconstruct) fn linear(job: Job<'_>, plan: &DirectPlan) -> Result<ReconstructionInfo> {
    let path = |instrument: &Instrument, p, microphone: usize| {
        let r = instrument.array.positions()[microphone];
        instrument.geometry_of(microphone).linear_path_length(p, r)
    };
    sum_over_paths(job, plan, Method::Linear, path)
}
