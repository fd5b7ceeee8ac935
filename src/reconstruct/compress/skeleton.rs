//! Skeleton frequencies: the few tones of a sweep that represent all of them.
//!
//! Within a box of voxels every path length lies in an interval. On that interval the functions
//! `e^{−i2πf_n·path/c}` of a sweep of bandwidth B span, numerically, only about `B·T + 10` dimensions, where T is the
//! interval in seconds. An interpolative decomposition picks Q of the *measured* frequencies and a matrix W with
//!
//! `e^{−i2πf_n·path/c} = Σ_q W[q, n] e^{−i2πf_q·path/c} + O(ε)` on the whole interval,
//!
//! so that, for any data at all,
//!
//! `Σ_n m_n(r) e^{−i2πf_n·path/c} = Σ_q m̂_q(r) e^{−i2πf_q·path/c}` with `m̂_q(r) = Σ_n W[q, n] m_n(r)`,
//!
//! to within `ε Σ_n |m_n(r)|`: one small matrix product, and Eq. 13 runs over Q frequencies instead of n_f. The engine
//! takes them among the virtual tones of a volume, for one slab of depths at a time.
//! Method: column-pivoted QR of the matrix of those functions on Chebyshev points (Cheng, Gimbutas, Martinsson and
//! Rokhlin, SIAM J. Sci. Comput. 26, 2005), in real numbers: with delays counted from the interval's middle, the best W
//! is real. The error is then *measured* on a dense grid, not trusted.

use crate::linalg::{LeastSquares, Matrix, PivotedQr, even_waves, max_modulus, pivoted_qr, product, waves};
use crate::wave::interval::PathInterval;
use std::f64::consts::GOLDEN_RATIO;

/// The decomposition of one sweep on one interval of path lengths.
#[derive(Debug, Clone)]
pub(crate) struct Skeleton {
    chosen: Vec<usize>,
    /// W where delays are counted from the interval's middle, `[Q, n_f]`.
    weights: Matrix,
    error: f64,
}

/// Of more frequencies than this many per dimension, evenly spread ones are candidates; the rest add nothing.
const CANDIDATES_PER_DIMENSION: f64 = 4.0;

/// The error is measured at this many per dimension: between them it can hide no more than a few hundredths of itself,
/// since as a function of f it is band-limited to the interval's half duration.
const WITNESSES_PER_DIMENSION: f64 = 5.0;

/// The error is measured at this many times as many delays as weights are fitted at: more than four for each half turn
/// of the fastest tone.
pub(crate) const DENSER: usize = 2;

/// What weights are damped by, of the tolerance, at first and at the least. Without that, weights for tolerances below 10⁻⁷ are as
/// large as 10⁵ where the last tones chosen are nearly made of the others, and rounding, which is single precision's in samples,
/// grows by them; with it by some tens, for a few hundredths more tones.
const DAMPING: f64 = 0.03;
const LEAST_DAMPING: f64 = 1e-4;

/// Frequencies so sparse that an interval has this many dimensions for each are not compressed: fewer do not represent
/// them, and the matrices of so long an interval would grow without bound (microphones 100 km apart, say).
const SPARSE: f64 = 2.0;

/// Whether so many frequencies represent only themselves on an interval of `bandwidth_duration` B·T.
pub(crate) fn is_sparse(bandwidth_duration: f64, frequencies: f64) -> bool {
    bandwidth_duration > SPARSE * frequencies
}

/// Dimensions, with a margin, of the tones of an interval of `bandwidth_duration` B·T.
pub(crate) fn dimensions(bandwidth_duration: f64) -> f64 {
    bandwidth_duration + 12.0
}

/// Candidates among many frequencies on an interval of `bandwidth_duration` B·T.
pub(crate) fn candidates_for(bandwidth_duration: f64) -> f64 {
    CANDIDATES_PER_DIMENSION * dimensions(bandwidth_duration)
}

/// Frequencies at which an error is measured on such an interval.
pub(crate) fn witnesses_for(bandwidth_duration: f64) -> f64 {
    WITNESSES_PER_DIMENSION * dimensions(bandwidth_duration)
}

/// About how many tones represent a sweep on an interval of `bandwidth_duration` B·T to within `tolerance`: the numbers
/// of its singular value decomposition to within two.
pub(crate) fn tones_for(bandwidth_duration: f64, tolerance: f64) -> f64 {
    let digits = (1.0 / tolerance).ln();
    bandwidth_duration + 2.0 + digits * (0.22 + 0.2 * (1.0 + bandwidth_duration).ln())
}

/// Frequencies, as indices, so spread over the band that none lies further than a `most`-th of it from one; all where they
/// are no more than that.
fn spread_out(frequencies: &[f64], most: f64) -> Vec<usize> {
    let last = frequencies.len() - 1;
    if frequencies.len() as f64 <= most {
        return (0..=last).collect();
    }
    let step = (frequencies[last] - frequencies[0]) / most;
    let mut chosen = vec![0];
    for (n, f) in frequencies.iter().enumerate().skip(1) {
        let far = *f - frequencies[chosen[chosen.len() - 1]] >= step * (1.0 - 1e-9);
        if far || n == last {
            chosen.push(n);
        }
    }
    chosen
}

/// Finds skeleton frequencies and weights for `frequencies` (ascending, Hz) with an error of at most `tolerance`.
///
/// - Shapes: `weights` is `[Q, n_f]`.
/// - Error: the largest `|e_n − Σ_q W[q, n] e_q|` on a dense grid of the interval and the band, [`Skeleton::error`];
///   the factorisation is repeated more strictly if it exceeds `tolerance`.
/// - Cost: a real QR of `1.7·B·T + 36` rows and some `4·(B·T + 12)` columns, and a product with all n_f.
///
/// # Panics
/// Without frequencies, or with a tolerance that is not positive.
pub(crate) fn skeleton(frequencies: &[f64], interval: PathInterval, tolerance: f64) -> Skeleton {
    assert!(!frequencies.is_empty() && tolerance > 0.0, "a skeleton needs frequencies and a tolerance");
    let bandwidth = frequencies[frequencies.len() - 1] - frequencies[0];
    let bandwidth_duration = bandwidth * interval.duration();
    if is_sparse(bandwidth_duration, frequencies.len() as f64) {
        return Skeleton::all(frequencies.len());
    }
    let candidates = spread_out(frequencies, candidates_for(bandwidth_duration));
    let witnesses = spread_out(frequencies, witnesses_for(bandwidth_duration));
    let points = interval.points_for(bandwidth).div_ceil(2);
    let carrier = f64::midpoint(frequencies[0], frequencies[frequencies.len() - 1]);
    let about: Vec<f64> = frequencies.iter().map(|f| f - carrier).collect();
    let all = waves(&interval.chebyshev(points), &about);
    let at_witnesses = columns(&all, &witnesses);
    let PivotedQr { order, diagonal } = pivoted_qr(&without_ties(&columns(&all, &candidates)));
    let ranks = diagonal.len();
    let dense = |chosen: &[usize]| {
        even_waves(&interval, DENSER * points, &chosen.iter().map(|&n| about[n]).collect::<Vec<_>>())
    };
    let dense_witnesses = dense(&witnesses);
    // The largest residual of a column is a sum over the points; its root mean square is what ε bounds.
    let length = (points as f64).sqrt();
    let first = tolerance / 3.0 * length;
    let (mut threshold, mut damping) = (first, DAMPING);
    loop {
        let rank = diagonal.iter().position(|left| *left <= threshold).unwrap_or(ranks).max(1);
        let mut chosen: Vec<usize> = order[..rank].iter().map(|&j| candidates[j]).collect();
        chosen.sort_unstable();
        let fit = LeastSquares::damped(&columns(&all, &chosen), damping * tolerance * length);
        let weights = fit.solve(&at_witnesses);
        let error = max_modulus(&(&dense_witnesses - product(&dense(&chosen), &weights)));
        if error <= tolerance || (rank == ranks && damping < LEAST_DAMPING) {
            let weights = if witnesses.len() == about.len() { weights } else { fit.solve(&all) };
            return Skeleton { chosen, weights, error };
        }
        // Where all together err too much, they may be weighted more.
        (threshold, damping) =
            if rank == ranks { (first, damping / 10.0) } else { (threshold / 2.0, damping) };
    }
}

impl Skeleton {
    /// Every frequency represents itself.
    fn all(count: usize) -> Self {
        let weights = Matrix::from_fn(count, count, |q, n| f64::from(u8::from(q == n)));
        Self { chosen: (0..count).collect(), weights, error: 0.0 }
    }

    /// The chosen frequencies, as ascending indices of those given.
    pub(crate) fn chosen(&self) -> &[usize] {
        &self.chosen
    }

    /// `W[q, n]` where delays are counted from the interval's middle: all that it depends on is how long the interval is.
    pub(crate) fn about_middle(&self, q: usize, n: usize) -> f64 {
        self.weights[(q, n)]
    }

    /// The largest error measured on a dense grid of the interval, relative to one.
    pub(crate) fn error(&self) -> f64 {
        self.error
    }
}

/// The columns `chosen` of `all`.
fn columns(all: &Matrix, chosen: &[usize]) -> Matrix {
    Matrix::from_fn(all.nrows(), chosen.len(), |k, q| all[(k, chosen[q])])
}

/// Columns made longer by less than a hundredth, each by another share (the golden ratio's multiples).
///
/// All are equally long, and those at equal distances from the carrier stay so when others are projected out: rounding,
/// which is the processor's, would pick the pivots among them.
fn without_ties(columns: &Matrix) -> Matrix {
    let length = |j: usize| 1.0 + 0.01 * (j as f64 * GOLDEN_RATIO).fract();
    Matrix::from_fn(columns.nrows(), columns.ncols(), |k, j| columns[(k, j)] * length(j))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::wave::interval::phasor_f64;
    use num_complex::Complex64;
    use std::f64::consts::TAU;

    fn sweep(bandwidth: f64, count: usize) -> Vec<f64> {
        (0..count).map(|n| 20_000.0 - bandwidth + bandwidth * n as f64 / (count - 1) as f64).collect()
    }

    fn interval(duration: f64) -> PathInterval {
        PathInterval { shortest: 2.0, longest: 2.0 + 343.0 * duration, sound_speed: 343.0 }
    }

    /// The error as the module's formula says it, by plain sums on points of its own.
    fn literal_error(frequencies: &[f64], interval: PathInterval, skeleton: &Skeleton) -> f64 {
        let mut worst = 0.0f64;
        // Weights are for delays about the interval's middle; these are for delays from zero.
        let turns: Vec<_> = frequencies.iter().map(|f| phasor_f64(f * interval.middle())).collect();
        let weight = |q: usize, k: usize, n: usize| skeleton.about_middle(q, n) * turns[k] * turns[n].conj();
        for i in 0..=400 {
            let path = interval.shortest + (interval.longest - interval.shortest) * f64::from(i) / 400.0;
            let tone = |f: f64| Complex64::cis(-TAU * (f * path / interval.sound_speed).fract());
            for (n, f) in frequencies.iter().enumerate().step_by(7) {
                let sum: Complex64 = skeleton
                    .chosen()
                    .iter()
                    .enumerate()
                    .map(|(q, &k)| weight(q, k, n) * tone(frequencies[k]))
                    .sum();
                worst = worst.max((tone(*f) - sum).norm());
            }
        }
        worst
    }

    #[test]
    fn rounding_does_not_choose_the_tones() {
        for (bandwidth, count, duration) in
            [(10_000.0, 101, 1e-3), (10_000.0, 1001, 4e-3), (7_000.0, 301, 9e-3)]
        {
            let even = sweep(bandwidth, count);
            for tolerance in [1e-2, 1e-4, 1e-6] {
                let chosen = skeleton(&even, interval(duration), tolerance).chosen;
                for seed in 1..4 {
                    // Some frequencies are the next number up: as much as another order of sums changes.
                    let up = |n: usize| (n * n + seed * n) % (2 * seed + 3) < 2;
                    let other = even.iter().enumerate().map(|(n, f)| if up(n) { f.next_up() } else { *f });
                    let found = skeleton(&other.collect::<Vec<_>>(), interval(duration), tolerance).chosen;
                    assert_eq!(found, chosen, "{bandwidth} Hz, {count}, {duration} s, {tolerance}");
                }
            }
        }
    }

    #[test]
    fn few_tones_stand_for_all_within_the_tolerance() {
        // Bandwidth, frequencies, duration, tolerance, and the numerical rank of the exponentials there.
        for (bandwidth, count, duration, tolerance, needed) in [
            (2_000.0, 1001, 0.57e-3, 1e-3, 6),
            (2_000.0, 1001, 0.57e-3, 1e-6, 8),
            (2_000.0, 1001, 2.3e-3, 1e-4, 12),
            (10_000.0, 1001, 2.3e-3, 1e-4, 33),
            (10_000.0, 5001, 2.3e-3, 1e-4, 33),
            (10_000.0, 1001, 6e-3, 1e-4, 72),
        ] {
            let (frequencies, interval) = (sweep(bandwidth, count), interval(duration));
            let skeleton = skeleton(&frequencies, interval, tolerance);
            let q = skeleton.chosen().len();
            assert!(q <= needed + 3, "{q} tones where {needed} do, BT {}", bandwidth * duration);
            let error = literal_error(&frequencies, interval, &skeleton);
            assert!(error <= tolerance * 1.05, "{error:e} above {tolerance:e}");
            assert!(skeleton.error() <= tolerance && error <= skeleton.error() * 1.2 + 1e-12);
            let bound = 2.0 * (q as f64).sqrt() + 5.0;
            // By how much the noise of single samples can grow.
            let sum = |n: usize| (0..q).map(|q| skeleton.about_middle(q, n).abs()).sum::<f64>();
            let largest = (0..count).map(sum).fold(0.0, f64::max);
            assert!(largest < bound, "{largest} of {bound}");
        }
    }

    #[test]
    fn weights_stay_small_however_strict_the_tolerance() {
        // Twice as many as the longest interval needs, as virtual tones are.
        let frequencies = sweep(10_000.0, 200);
        for tolerance in [1e-6, 3e-8, 3e-9, 1e-9] {
            for hundredths in 1..=100 {
                let interval = interval(0.7e-4 * f64::from(hundredths));
                let found = skeleton(&frequencies, interval, tolerance);
                assert!(found.error() <= tolerance, "{:e} of {tolerance:e}", found.error());
                let squares = |n: usize| (0..found.chosen().len()).map(move |q| (q, n));
                let square = |(q, n): (usize, usize)| found.about_middle(q, n).powi(2);
                let norms = (0..frequencies.len()).map(|n| squares(n).map(square).sum::<f64>().sqrt());
                let largest = norms.fold(0.0, f64::max);
                assert!(largest < 500.0, "{largest} for {tolerance:e} and {hundredths}");
            }
        }
    }

    #[test]
    fn uneven_and_tiny_sweeps_have_skeletons_too() {
        let mut uneven = sweep(5_000.0, 300);
        for (n, f) in uneven.iter_mut().enumerate() {
            *f += 5.0 * (n as f64 * 0.618_034).fract();
        }
        for frequencies in [uneven, sweep(1000.0, 2), vec![12_345.0]] {
            let skeleton = skeleton(&frequencies, interval(1.5e-3), 1e-5);
            assert!(literal_error(&frequencies, interval(1.5e-3), &skeleton) < 1.1e-5);
        }
    }

    #[test]
    fn sparse_frequencies_represent_themselves_however_long_the_interval() {
        for duration in [0.03, 600.0, 1e9] {
            let frequencies = sweep(10_000.0, 101);
            let found = skeleton(&frequencies, interval(duration), 1e-4);
            assert!(found.chosen().iter().copied().eq(0..101) && found.error() == 0.0, "{duration}");
            assert!(duration > 1.0 || literal_error(&frequencies, interval(duration), &found) < 1e-9);
        }
    }

    #[test]
    fn an_interval_of_no_length_needs_one_tone() {
        let skeleton = skeleton(&sweep(10_000.0, 101), interval(0.0), 1e-4);
        assert_eq!(skeleton.chosen().len(), 1);
    }

    #[test]
    fn tones_are_about_those_that_skeletons_find() {
        // B·T, tolerance, and the numerical rank found by a singular value decomposition.
        for (bandwidth_duration, tolerance, found) in [
            (1.14, 1e-3, 6.0),
            (1.14, 1e-6, 8.0),
            (4.6, 1e-4, 12.0),
            (23.0, 1e-3, 31.0),
            (23.0, 1e-6, 37.0),
            (60.0, 1e-4, 72.0),
        ] {
            let about = tones_for(bandwidth_duration, tolerance);
            assert!((about - found).abs() <= 2.0, "{about} for {found}");
        }
    }
}
