//! Phasors in double precision, with which errors are measured.

use super::{dispatched, wrap_exact};
use num_complex::Complex64;

/// Coefficients of `x^(first + 2k)` in the Taylor series of sin πx (first 1) or cos πx (0).
const fn half_turn_series<const N: usize>(first: usize) -> [f64; N] {
    let (mut series, mut power, mut term) = ([0.0; N], 0, 1.0);
    while power < first + 2 * N {
        if power % 2 == first {
            series[power / 2] = term;
            term = -term;
        }
        power += 1;
        term *= std::f64::consts::PI / power as f64;
    }
    series
}

#[inline(always)]
fn phasors_f64_body(cycles: &[f64], phasors: &mut [Complex64]) {
    // On |t| ≤ ½ the next terms are below 1e-12.
    const S: [f64; 9] = half_turn_series(1);
    const C: [f64; 10] = half_turn_series(0);
    assert!(cycles.len() == phasors.len(), "one phasor per phase");
    for (cycles, phasor) in cycles.iter().zip(phasors) {
        let t = wrap_exact(*cycles);
        let series = |c: &[f64]| c.iter().rev().fold(0.0, |sum, c| sum * (t * t) + c);
        let (s, c) = (t * series(&S), series(&C));
        *phasor = Complex64::new(1.0 - 2.0 * s * s, 2.0 * s * c);
    }
}

dispatched! {
    /// `e^{i2π·cycles}` for every phase, to 10⁻¹¹.
    ///
    /// Cost: about 45 operations per phasor.
    ///
    /// # Panics
    /// When the slices differ in length.
    pub(crate) fn phasors_f64 = phasors_f64_body(cycles: &[f64], phasors: &mut [Complex64])
}
