//! Range profiles as Chebyshev series on short intervals of delay, and the error of cutting them off.
//!
//! `e^{−ixt} = J₀(x) + 2 Σ_k (−i)^k J_k(x) T_k(t)` for |t| ≤ 1 (Jacobi–Anger). With `x = 2π(f − f_c)H/c` this is a tone
//! of the demodulated profile on delays within ±H/c of a centre. The coefficients fall off faster than any power once
//! k > x, so that what is left out is bounded by the first few of them.

use std::f64::consts::PI;
use std::sync::OnceLock;

/// Neighbouring rungs differ by this factor of half-width.
const RATIO: f64 = 1.08;

/// Smallest half-width worth a rung of its own, in units of x at the band's edge.
const LEAST: f64 = 0.2;

/// Up to this x at the band's edge, series are summed as powers of `T_2(t)`, which takes fewer operations; their coefficients
/// add up to some `2 e^{0.35x}`, by which f32 rounding grows where all of them conspire.
pub(crate) const MOST_FOR_POWERS: f64 = 12.0;

/// The largest x of a profile at the band's edge.
const MOST_EDGE: f64 = 60.0;

/// The most turns of the carrier between a block's centre and a point: its f32 phase then errs by some 10⁻⁶.
const MOST_TURNS: f64 = 8.0;

/// A half-width of delays with the series of every tone on it.
#[derive(Debug, Clone)]
pub(crate) struct Rung {
    /// H as a path length, m.
    pub(crate) half: f64,
    /// Coefficients that are kept, even in number.
    pub(crate) terms: usize,
    /// Whether the series are in powers of `T_2(t)`.
    pub(crate) powers: bool,
    /// `[Q, columns]`: `J₀(x_q), 2 J_1(x_q), …`, or the same for powers, those of t times powers at odd places; padded with
    /// zeros. A factor of `(−i)^k` is left out, so that all are real.
    pub(crate) expansion: Vec<f32>,
    /// Length of a row of `expansion`, a multiple of 4.
    pub(crate) columns: usize,
}

/// Half-widths whose series serve all profiles up to the greatest of them, each found when it is first used: often few are.
#[derive(Debug)]
pub(crate) struct Ladder {
    band: Band,
    /// Of the tones, Hz.
    frequencies: Vec<f64>,
    /// Ascending.
    rungs: Vec<(f64, OnceLock<Rung>)>,
}

impl Ladder {
    /// The first rung that reaches `half` m, or the last.
    pub(crate) fn rung(&self, half: f64) -> &Rung {
        let first = self.rungs.partition_point(|(own, _)| *own < half).min(self.rungs.len() - 1);
        let (half, rung) = &self.rungs[first];
        rung.get_or_init(|| self.band.rung(*half, &self.frequencies))
    }
}

/// A band and the accuracy wanted of its profiles.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Band {
    /// f_c, Hz.
    pub(crate) carrier: f64,
    /// B, Hz.
    pub(crate) bandwidth: f64,
    /// c, m/s.
    pub(crate) sound_speed: f64,
    /// Error allowed to any tone of the band, relative to one.
    pub(crate) tolerance: f64,
}

impl Band {
    /// x at the band's edge for a half-width, m.
    pub(crate) fn edge(&self, half: f64) -> f64 {
        PI * self.bandwidth * half / self.sound_speed
    }

    /// Whether profiles of this half-width, m, are neither absurdly long nor lose their phase in f32.
    pub(crate) fn holds(&self, half: f64) -> bool {
        self.edge(half) <= MOST_EDGE && self.carrier * half / self.sound_speed <= MOST_TURNS
    }

    /// The least number of coefficients that keeps every tone of the band on ±`half` m within the tolerance, and
    /// the error that leaves: `2 Σ_{k ≥ terms} J_k(x)`, which for k > x grows with x and so holds for all tones.
    pub(crate) fn terms(&self, half: f64) -> (usize, f64) {
        let edge = self.edge(half);
        // Beyond this J_k(edge) is below 1e-16.
        let count = (edge + 14.0 * edge.cbrt()) as usize + 32;
        let bessel = bessel(edge, count);
        let mut tail = vec![0.0; count + 1];
        for k in (0..count).rev() {
            tail[k] = tail[k + 1] + 2.0 * bessel[k].abs();
        }
        let first = edge.ceil() as usize + 1;
        let terms = (first..count).find(|&k| tail[k] <= self.tolerance).unwrap_or(count);
        (terms, tail[terms])
    }

    /// Rungs that end with `greatest` m, for tones at `frequencies` Hz.
    pub(crate) fn ladder(&self, greatest: f64, frequencies: Vec<f64>) -> Ladder {
        let steps = ((self.edge(greatest) / LEAST).max(1.0).ln() / RATIO.ln()).ceil() as i32;
        let half = |rung: i32| greatest / RATIO.powi(steps - rung);
        let rungs = (0..=steps).map(|rung| (half(rung), OnceLock::new())).collect();
        Ladder { band: *self, frequencies, rungs }
    }

    fn rung(&self, half: f64, frequencies: &[f64]) -> Rung {
        let (terms, _) = self.terms(half);
        let powers = self.edge(half) <= MOST_FOR_POWERS;
        // Sums take two at a time.
        let terms = terms.next_multiple_of(2);
        let columns = terms.next_multiple_of(4);
        let mut expansion = vec![0.0; frequencies.len() * columns];
        for (row, f) in expansion.chunks_exact_mut(columns).zip(frequencies) {
            let x = 2.0 * PI * (f - self.carrier) * half / self.sound_speed;
            let mut series = bessel(x, terms);
            series.iter_mut().skip(1).for_each(|j| *j *= 2.0);
            if powers {
                series = in_powers(&series);
            }
            for (value, coefficient) in row.iter_mut().zip(series) {
                *value = coefficient as f32;
            }
        }
        Rung { half, terms, powers, expansion, columns }
    }
}

/// `Σ_k (−i)^k b_k T_k(t)` as `Σ_k (−i)^k a_k t^p T_2(t)^j` with k = 2j + p, p 0 or 1: b to a.
fn in_powers(series: &[f64]) -> Vec<f64> {
    let mut powers = vec![0.0; series.len()];
    // With S_k = (−i)^k T_k(t) and u = S_2, S_{k+2} = 2u S_k − S_{k−2}: all S_k are polynomials of u, those of odd k times S_1,
    // with real coefficients. Both begin with 1; before that are S_{−2} = u, and S_{−1} = −S_1.
    for (parity, before) in [[0.0, 1.0], [-1.0, 0.0]].into_iter().enumerate() {
        let count = series.len() / 2 + 1;
        let polynomial = |begin: [f64; 2]| -> Vec<f64> {
            begin.into_iter().chain(std::iter::repeat(0.0)).take(count).collect()
        };
        let (mut before, mut this) = (polynomial(before), polynomial([1.0, 0.0]));
        for b in series.iter().skip(parity).step_by(2) {
            for (power, coefficient) in powers.iter_mut().skip(parity).step_by(2).zip(&this) {
                *power += b * coefficient;
            }
            let times_u = std::iter::once(&0.0).chain(&this);
            let next = times_u.zip(&before).map(|(power, before)| 2.0 * power - before).collect();
            (before, this) = (this, next);
        }
    }
    powers
}

/// By how much an error of the function can grow in a Chebyshev series cut off after `terms` coefficients: Lebesgue's
/// constant, below `1 + 4/π² · ln(2n + 1)` (Watson 1930).
pub(crate) fn lebesgue(terms: usize) -> f64 {
    1.0 + 4.0 / (PI * PI) * (2.0 * terms as f64 + 1.0).ln()
}

/// `J_0(x) … J_{count−1}(x)` by Miller's backward recurrence, normalised by `J₀ + 2 Σ J_2k = 1`. All orders at
/// once: `libm::jn` recurs again for each.
fn bessel(x: f64, count: usize) -> Vec<f64> {
    let mut values = vec![0.0; count];
    let magnitude = x.abs();
    if magnitude < 1e-30 {
        values.iter_mut().take(1).for_each(|j| *j = 1.0);
        return values;
    }
    let top = (magnitude as usize).max(count) + 24 + (12.0 * magnitude.cbrt()) as usize;
    let (mut after, mut this, mut sum) = (0.0f64, 1e-280f64, 0.0f64);
    for k in (0..=top).rev() {
        // `this` is J_k but for a factor common to all.
        if k < count {
            values[k] = this;
        }
        if k % 2 == 0 {
            sum += if k == 0 { this } else { 2.0 * this };
        }
        let before = 2.0 * k as f64 / magnitude * this - after;
        (after, this) = (this, before);
        if this.abs() > 1e200 {
            for value in values.iter_mut().skip(k).chain([&mut after, &mut this, &mut sum]) {
                *value *= 1e-220;
            }
        }
    }
    for (k, value) in values.iter_mut().enumerate() {
        *value /= if x < 0.0 && k % 2 == 1 { -sum } else { sum };
    }
    values
}

#[cfg(test)]
mod tests {
    use super::*;
    use num_complex::Complex64;

    #[test]
    fn bessel_functions_are_those_of_the_tables() {
        // Abramowitz & Stegun, tables 9.1 and 9.4.
        for (x, k, expected) in [
            (1.0, 0, 0.765_197_686_557_966_6),
            (1.0, 1, 0.440_050_585_744_933_5),
            (5.0, 0, -0.177_596_771_314_338_3),
            (5.0, 10, 1.467_802_647_310e-3),
            (50.0, 20, -0.116_704_352_759_574),
        ] {
            assert!((bessel(x, 40)[k] - expected).abs() < 1e-12, "J_{k}({x}) = {}", bessel(x, 40)[k]);
            let mirrored = if k % 2 == 1 { -expected } else { expected };
            assert!((bessel(-x, k + 1)[k] - mirrored).abs() < 1e-12);
        }
        assert_eq!(bessel(0.0, 3), [1.0, 0.0, 0.0]);
        assert!((bessel(1e-12, 3)[1] - 5e-13).abs() < 1e-20);
        assert!(bessel(3000.0, 3200).iter().all(|j| j.abs() < 0.2));
    }

    /// The measured error of every tone on a dense grid of delays is within the bound, and not far from it.
    #[test]
    fn the_bound_of_a_series_holds_for_every_tone_and_delay() {
        for tolerance in [1e-2, 1e-4, 1e-6, 1e-12] {
            let band = Band { carrier: 15_000.0, bandwidth: 10_000.0, sound_speed: 343.0, tolerance };
            for half in [0.0, 1e-5, 0.003, 0.03, 0.1, 0.7, 5.0] {
                let (terms, bound) = band.terms(half);
                assert!(bound <= tolerance, "{terms} terms leave {bound:e} of {tolerance:e}");
                let mut worst = 0.0f64;
                for i in 0..=20 {
                    let x = band.edge(half) * (f64::from(i) / 10.0 - 1.0);
                    let coefficients = bessel(x, terms);
                    for j in 0..=400 {
                        let t = f64::from(j) / 200.0 - 1.0;
                        let sum: Complex64 = coefficients
                            .iter()
                            .enumerate()
                            .map(|(k, j)| {
                                let chebyshev = (k as f64 * t.acos()).cos();
                                (-Complex64::I).powu(k as u32)
                                    * chebyshev
                                    * j
                                    * if k == 0 { 1.0 } else { 2.0 }
                            })
                            .sum();
                        worst = worst.max((sum - Complex64::cis(-x * t)).norm());
                    }
                }
                assert!(worst <= bound + 1e-13, "half {half}: {worst:e} above {bound:e}");
                assert!(worst >= 0.2 * bound - 1e-13, "half {half}: {worst:e} of {bound:e}");
            }
        }
    }

    #[test]
    fn powers_are_the_same_polynomial() {
        let series = [0.3, -0.7, 0.2, 0.05, -0.4, 0.01, 0.6];
        for series in [&series[..1], &series[..2], &series[..6], &series] {
            let powers = in_powers(series);
            for i in -10..=10 {
                let t = f64::from(i) / 10.0;
                let factor = |k: usize| (-Complex64::I).powu(k as u32);
                let chebyshev = |k: usize| (k as f64 * t.acos()).cos();
                let power = |k: usize| t.powi(k as i32 % 2) * chebyshev(2).powi(k as i32 / 2);
                let sum = |coefficients: &[f64], of: &dyn Fn(usize) -> f64| -> Complex64 {
                    coefficients.iter().enumerate().map(|(k, a)| factor(k) * *a * of(k)).sum()
                };
                assert!((sum(&powers, &power) - sum(series, &chebyshev)).norm() < 1e-14);
            }
        }
    }

    #[test]
    fn a_ladder_reaches_the_greatest_half_width() {
        let band = Band { carrier: 15_000.0, bandwidth: 10_000.0, sound_speed: 343.0, tolerance: 1e-4 };
        let ladder = band.ladder(0.1, vec![10_000.0, 15_000.0]);
        assert_eq!((ladder.rung(0.1).half, ladder.rung(0.2).half), (0.1, 0.1));
        let least = LEAST / band.edge(1.0);
        for half in [0.0, 1e-4, 0.003, 0.05, 0.092, 0.093, 0.0999] {
            let rung = ladder.rung(half);
            assert!(half <= rung.half && rung.half < RATIO * half.max(least), "{half}: {}", rung.half);
            assert!(rung.terms.is_multiple_of(2) && rung.terms >= band.terms(half).0);
        }
        let single = Band { bandwidth: 0.0, ..band }.ladder(0.1, vec![15_000.0]);
        assert_eq!((single.rungs.len(), &single.rung(0.0).expansion[..]), (1, &[1.0, 0.0, 0.0, 0.0][..]));
    }
}
