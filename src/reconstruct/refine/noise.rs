//! The noise in samples, measured as what no reflector within the grid can cause.
//!
//! Delays of the grid's voxels lie in an interval, and its virtual tones make every sweep that such delays can cause. What is
//! left of a microphone's samples beyond their span is noise, or echoes from beyond the grid, which an image of the grid
//! cannot explain either. It has as many dimensions as there are more frequencies than virtual tones.

use crate::acquisition::{CubeSource, Detection};
use crate::error::Result;
use crate::linalg::{LeastSquares, Matrix, add_product_of_rows};
use crate::reconstruct::compress::{VirtualTones, frequencies_at_once};
use num_complex::{Complex32, Complex64};

/// The part of the dimensions that has to be left.
const LEAST_LEFT: f64 = 0.1;

/// Microphones at which it is measured, about.
const MICROPHONES: usize = 512;

/// The root mean square of the noise in a sample; `None` where the grid's delays take almost all dimensions.
///
/// Cost: a factorisation of `[n_f, tones]` real numbers, twice the columns for data in phase, and a product with the samples
/// of some hundreds of microphones.
///
/// # Errors
/// Those of the source.
pub(super) fn noise_of<'a>(
    source: &mut dyn CubeSource,
    tones: impl Fn(usize) -> &'a VirtualTones,
) -> Result<Option<f64>> {
    let transmissions = source.instrument().transmissions();
    let (mut power, mut dimensions) = (0.0, 0.0);
    for transmission in 0..transmissions {
        let Some([own, left]) = left_of(source, transmission, tones(transmission))? else { return Ok(None) };
        power += own;
        dimensions += left;
    }
    Ok(Some((power / dimensions).sqrt()))
}

/// The power of some of a transmission's samples beyond the span of its tones, and the dimensions that it has there.
fn left_of(
    source: &mut dyn CubeSource,
    transmission: usize,
    tones: &VirtualTones,
) -> Result<Option<[f64; 2]>> {
    let instrument = source.instrument();
    let (n_f, n_mic) = (instrument.sweep.len(), instrument.array.len());
    let turns: Vec<Complex64> = tones.turns().to_vec();
    let basis = tones.basis();
    // Real samples are made of the real and of the imaginary parts of turned tones.
    let in_phase = instrument.detection == Detection::InPhase;
    let columns = basis.ncols() * if in_phase { 2 } else { 1 };
    let left = n_f as f64 - columns as f64;
    if left < LEAST_LEFT * n_f as f64 {
        return Ok(None);
    }
    let basis = Matrix::from_fn(n_f, columns, |n, k| match (in_phase, k.checked_sub(basis.ncols())) {
        (false, _) => basis[(n, k)],
        (true, None) => basis[(n, k)] * turns[n].re,
        (true, Some(k)) => basis[(n, k)] * turns[n].im,
    });
    let orthogonal = LeastSquares::new(&basis);
    let stride = n_mic.div_ceil(MICROPHONES);
    let width = n_mic.div_ceil(stride);
    let mut within = vec![Complex32::ZERO; columns * width];
    let (mut power, mut some) = (0.0, Vec::new());
    source.visit_transmission(transmission, frequencies_at_once(n_mic), &mut |range, samples| {
        some.clear();
        for (n, row) in range.clone().zip(samples.chunks_exact(n_mic)) {
            let turn = if in_phase { Complex64::ONE } else { turns[n].conj() };
            let turn = Complex32::new(turn.re as f32, turn.im as f32);
            some.extend(row.iter().step_by(stride).map(|m| m * turn));
        }
        power += some.iter().map(|m| f64::from(m.norm_sqr())).sum::<f64>();
        let weight =
            |k: usize, n: usize| Complex32::new(orthogonal.orthonormal()[(range.start + n, k)] as f32, 0.0);
        add_product_of_rows(weight, &some, width, &mut within);
        Ok(())
    })?;
    let within: f64 = within.iter().map(|m| f64::from(m.norm_sqr())).sum();
    Ok(Some([(power - within).max(0.0), left * width as f64]))
}
