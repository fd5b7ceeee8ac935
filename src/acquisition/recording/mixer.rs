//! The paper's receiver, literally: a mixer and a low-pass filter (Eqs. 1 to 3). It is the oracle of [`super::tones`].

use num_complex::Complex64;
use std::f64::consts::TAU;

/// Homodyne demodulation of a recorded tone, relative to the sine that was sent, with the sign of a cube.
///
/// The mixer multiplies `r(t) = α sin(2πft − φ)` by `sin(2πft)` and, for the other phase, by `cos(2πft)` (Eq. 2). The filter,
/// an integral over the T of all samples, leaves `αT/2 cos φ` (Eq. 3) and `−αT/2 sin φ`. The result is `α e^{+iφ}`, twice
/// their integrals over T.
///
/// What the filter lets pass of the mixer's second product, `α/2 cos(4πft − φ)`, has an integral of at most `α/(4πf)`: a
/// part of `1/(2πfT)` of the result, and nothing if T holds a whole number of half periods.
///
/// - `samples` are those at times `first + k·interval`, s, from the beginning of the sine on.
/// - Cost: a sine and a cosine per sample.
pub(super) fn homodyne(samples: &[f32], frequency: f64, first: f64, interval: f64) -> Complex64 {
    let (mut in_phase, mut quadrature) = (0.0, 0.0);
    for (k, sample) in samples.iter().enumerate() {
        let (sin, cos) = (TAU * frequency * (first + k as f64 * interval)).sin_cos();
        in_phase += f64::from(*sample) * sin * interval;
        quadrature -= f64::from(*sample) * cos * interval;
    }
    let period = samples.len() as f64 * interval;
    Complex64::new(in_phase, quadrature) * (2.0 / period)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// `α sin(2πft − 2πfd/c)` of Eq. 1, sampled.
    fn tone(frequency: f64, [alpha, d, c]: [f64; 3], rate: f64, count: usize) -> Vec<f32> {
        let phase = |k: usize| TAU * frequency * (k as f64 / rate - d / c);
        (0..count).map(|k| (alpha * phase(k).sin()) as f32).collect()
    }

    #[test]
    fn equation_3_holds_over_whole_periods_and_nearly_over_others() {
        let (alpha, c, rate) = (0.7, 343.0, 48_000.0);
        for (frequency, d) in [(12_000.0, 1.234), (15_000.0, 3.3), (7_500.0, 0.05)] {
            let expected = Complex64::from_polar(alpha, TAU * frequency * d / c);
            // 480 samples are a whole number of periods of each.
            let whole = homodyne(&tone(frequency, [alpha, d, c], rate, 480), frequency, 0.0, 1.0 / rate);
            assert!((whole - expected).norm() < 1e-7, "{whole} {expected}");
            // Of the mixer, Eq. 3 itself is the real part times T/2.
            let correlation = whole.re * 0.01 / 2.0;
            assert!((correlation - alpha * 0.01 / 2.0 * (TAU * frequency * d / c).cos()).abs() < 1e-9);
            let mut worst = 0_f64;
            for count in [101, 333, 470, 4801] {
                let part = homodyne(&tone(frequency, [alpha, d, c], rate, count), frequency, 0.0, 1.0 / rate);
                // As α/(2πfT), with the sum of samples in place of the integral.
                let bound = alpha / (count as f64 * (TAU * frequency / rate).sin().abs()) + 1e-7;
                let error = (part - expected).norm();
                assert!(error <= bound, "{frequency} Hz, {count}: {error} {bound}");
                worst = worst.max(error);
            }
            assert!(worst > 1e-4, "T matters: {worst}");
        }
    }
}
