//! The integral of a wave times the mixer's reference, in closed form.
//!
//! A wave is `e^{zt}` with a complex z: an oscillation that may decay. The reference is `g(t) = 2 sin(ωt + φ)`, or the square
//! wave `π/2 sgn sin(ωt + φ)`, whose fundamental is the same. What comes of it is `∫ w(t) g(t) e^{zt} dt`, with w = 1/T over
//! the window of an integrator, or `w = λ e^{−λ(t₁−t)}` of a low-pass filter that is read at its end.

use num_complex::Complex64;
use std::f64::consts::{FRAC_PI_2, PI};

/// The reference of a mixer.
#[derive(Debug, Clone, Copy)]
pub(super) struct MixerReference {
    /// ω, rad/s.
    pub(super) omega: f64,
    /// φ, rad.
    pub(super) phase: f64,
    /// Whether it is a square wave.
    pub(super) square: bool,
}

/// The weights of times.
#[derive(Debug, Clone, Copy)]
pub(super) struct FilterWindow {
    /// First and last time, s.
    pub(super) times: [f64; 2],
    /// λ, 1/s; 0 of an integrator.
    pub(super) decay: f64,
}

impl FilterWindow {
    /// The factor of the weights.
    fn scale(&self) -> f64 {
        if self.decay > 0.0 { self.decay } else { 1.0 / (self.times[1] - self.times[0]) }
    }

    /// `e^{zt} e^{−λ(t₁−t)}`.
    fn wave(&self, z: Complex64, t: f64) -> Complex64 {
        (z * t - self.decay * (self.times[1] - t)).exp()
    }

    /// `∫ e^{zt} e^{−λ(t₁−t)} dt` over the window.
    fn integral(&self, z: Complex64) -> Complex64 {
        let [first, last] = self.times;
        let rate = z + self.decay;
        let turn = rate * (last - first);
        let end = self.wave(z, last);
        if turn.norm() < 1e-3 {
            // The difference below would cancel.
            return end * (last - first) * (1.0 - turn / 2.0 + turn * turn / 6.0 - turn * turn * turn / 24.0);
        }
        (end - self.wave(z, first)) / rate
    }

    /// The weighted integral of the wave `e^{zt}` times the reference.
    pub(super) fn mixed(&self, reference: &MixerReference, z: Complex64) -> Complex64 {
        let integral =
            if reference.square { self.switched(reference, z) } else { self.multiplied(reference, z) };
        integral * self.scale()
    }

    /// Of a sine: the sum and the difference of the frequencies.
    fn multiplied(&self, reference: &MixerReference, z: Complex64) -> Complex64 {
        let turn = Complex64::cis(reference.phase);
        let omega = Complex64::new(0.0, reference.omega);
        -Complex64::I * (turn * self.integral(z + omega) - turn.conj() * self.integral(z - omega))
    }

    /// Of a square wave: the antiderivative at both ends, and twice at each edge between them, which are a geometric series.
    fn switched(&self, reference: &MixerReference, z: Complex64) -> Complex64 {
        let rate = z + self.decay;
        let half = PI / reference.omega;
        let crossings = |t: f64| ((reference.omega * t + reference.phase) / PI).floor();
        let sign = |k: f64| if k.rem_euclid(2.0) == 0.0 { 1.0 } else { -1.0 };
        let edge = |k: f64| (k * PI - reference.phase) / reference.omega;
        let [first, last] = self.times.map(crossings);
        let ends = self.wave(z, self.times[1]) * sign(last) - self.wave(z, self.times[0]) * sign(first);
        let count = last - first;
        // From the end at which the waves are larger, so that powers of the ratio do not overflow.
        let (from, step) = if rate.re >= 0.0 { (last, -1.0) } else { (first + 1.0, 1.0) };
        let edges = if count > 0.0 {
            // The logarithm of −e^{±rate·half}, by less than half a turn.
            let exponent = rate * (step * half) + Complex64::new(0.0, PI);
            let exponent = Complex64::new(exponent.re, (exponent.im + PI).rem_euclid(2.0 * PI) - PI);
            self.wave(z, edge(from)) * -sign(from) * series(exponent, count)
        } else {
            Complex64::ZERO
        };
        FRAC_PI_2 * (ends + 2.0 * edges) / rate
    }
}

/// `Σ_{m<n} e^{mv}`.
fn series(v: Complex64, count: f64) -> Complex64 {
    if v.norm() * count < 1e-9 { count.into() } else { exp_m1(v * count) / exp_m1(v) }
}

/// `e^v − 1` without cancellation.
fn exp_m1(v: Complex64) -> Complex64 {
    let half = (v.im / 2.0).sin();
    Complex64::new(v.re.exp_m1() * v.im.cos() - 2.0 * half * half, v.re.exp() * v.im.sin())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The integral by the midpoint rule.
    fn literal(window: &FilterWindow, reference: &MixerReference, z: Complex64) -> Complex64 {
        let [first, last] = window.times;
        let count = 400_000;
        let interval = (last - first) / f64::from(count);
        let mut sum = Complex64::ZERO;
        for i in 0..count {
            let t = first + (f64::from(i) + 0.5) * interval;
            let sine = (reference.omega * t + reference.phase).sin();
            let g = if reference.square { FRAC_PI_2 * sine.signum() } else { 2.0 * sine };
            sum += window.wave(z, t) * g;
        }
        sum * interval * window.scale()
    }

    #[test]
    fn closed_forms_are_the_integrals() {
        for square in [false, true] {
            for (i, decay) in [0.0, 40.0, 900.0].into_iter().enumerate() {
                for (harmonic, fall) in
                    [(1.0, 0.0), (2.0, 0.0), (3.0, 0.0), (1.0, 300.0), (0.98, 300.0), (3.0, 20.0)]
                {
                    let omega = 2.0 * PI * (1000.0 + 37.0 * i as f64);
                    let reference = MixerReference { omega, phase: 0.3 + i as f64, square };
                    let window = FilterWindow { times: [0.0021 * i as f64, 0.0134], decay };
                    let z = Complex64::new(-fall, harmonic * omega);
                    let (found, expected) = (window.mixed(&reference, z), literal(&window, &reference, z));
                    let case = format!("{square} {decay} {harmonic} {fall}: {found} {expected}");
                    assert!((found - expected).norm() < 3e-4, "{case}");
                }
            }
        }
    }

    #[test]
    fn short_and_long_windows_do_not_overflow() {
        let reference = MixerReference { omega: 1e5, phase: 0.0, square: true };
        for (times, decay, fall) in
            [([0.0, 1.0], 0.0, 1e6), ([0.0, 1.0], 1e6, 0.0), ([0.5, 0.500_001], 0.0, 0.0)]
        {
            for square in [true, false] {
                let reference = MixerReference { square, ..reference };
                let found = FilterWindow { times, decay }.mixed(&reference, Complex64::new(-fall, 1e5));
                assert!(found.is_finite() && found.norm() < 3.0, "{found}");
            }
        }
    }
}
