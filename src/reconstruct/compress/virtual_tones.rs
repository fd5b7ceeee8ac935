//! Virtual tones of a sweep: some `2·B·T + 5` within its band, of a dozen of which every measured tone is made.
//!
//! On an interval of delays of duration T a tone `e^{−i2πfδ}`, as a function of f, is band-limited to T/2. On nodes half
//! as far apart as that allows, a short least-squares interpolator ([`Taps`]) carries it:
//!
//! `e^{−i2πf_n·path/c} = Σ_k W[n, k] e^{−i2πf_k·path/c} + O(ε)`, k in a window of nodes about f_n,
//!
//! and so, as for [`crate::reconstruct::compress::skeleton`], the sum over any measured tones is one over the virtual ones. There are twice as
//! many of these as of skeleton tones, but finding them costs almost nothing, and W is a narrow band: compressing a
//! sweep costs a dozen products per sample, whatever T is. Towards the ends of the band the nodes draw together, as
//! Chebyshev points do, so that one-sided windows are as exact as those amid the band, and no tone is needed beyond it.

#![allow(clippy::inline_always)]

use super::banded::Banded;
use crate::acquisition::Sweep;
use crate::linalg::Matrix;
use crate::reconstruct::numerics::Taps;
use crate::reconstruct::window::Weights;
use crate::wave::interval::{PathInterval, greater, phasor_f64};
use crate::wave::simd::dispatched;
use crate::wave::simd::fused::plus_product;
use num_complex::{Complex32, Complex64};
use rayon::prelude::*;
use std::f64::consts::PI;
use std::ops::Range;
use std::sync::Arc;

/// Nodes per period of the fastest tone: twice what would just do.
const OVERSAMPLING: f64 = 2.0;

/// The ends of the band within which nodes draw together, in nodes per tap.
const END: f64 = 0.3;

/// Samples that one thread turns at a time, at the least.
const SUMMED: usize = 1 << 14;

/// The most taps that are tried.
const MOST_TAPS: usize = 24;

/// With eight taps the error is about this, and with each two more it is a sixth: what the search starts from.
const ERROR_OF_EIGHT: f64 = 6e-4;
const FALL: f64 = 6.0;

/// The tones that a sweep is compressed to, with their weights.
#[derive(Debug, Clone)]
pub(crate) struct VirtualTones {
    /// f_k, Hz, ascending.
    frequencies: Vec<f64>,
    /// The first node of each measured tone's window.
    first: Arc<[usize]>,
    /// W where delays are counted from the interval's middle, `[taps, n_f]`.
    weights: Arc<Matrix>,
    /// e^{i2πf·middle} of measured and of virtual tones.
    turns: [Vec<Complex64>; 2],
    /// The largest error of a tone on the interval, measured between nodes, relative to one.
    pub(crate) error: f64,
    /// The largest sum of |W| of a tone: by how much errors of virtual tones can grow.
    pub(crate) growth: f64,
}

/// Nodes of a band of `span`, no further than 1 apart, for this many taps.
fn nodes(span: f64, taps: usize) -> Vec<f64> {
    let mut count = taps / 2 + 1;
    loop {
        let mut places = vec![0.0];
        for i in 0..count - 1 {
            let from_end = 0.5 + i.min(count - 2 - i) as f64;
            let gap = (0.5 * PI * (from_end / end(taps)).min(1.0)).sin();
            places.push(places[i] + gap);
        }
        let last = places[count - 1];
        if last >= span {
            return places.iter().map(|place| place / last * span).collect();
        }
        // This many more are needed at least.
        count += ((span - last) as usize).max(1);
    }
}

/// Gaps at either end of the band that are narrower.
fn end(taps: usize) -> f64 {
    END * taps as f64
}

/// About how many taps keep a tolerance, an even number.
fn usual_taps(tolerance: f64) -> usize {
    let more = (ERROR_OF_EIGHT / tolerance).ln() / FALL.ln();
    (8 + 2 * more.ceil().clamp(-2.0, 100.0) as isize) as usize
}

/// e^{i2πf·middle} of measured and of virtual tones.
fn turns(sweep: &Sweep, tones: &[f64], middle: f64) -> [Vec<Complex64>; 2] {
    [sweep.frequencies(), tones].map(|tones| tones.iter().map(|f| phasor_f64(f * middle)).collect())
}

/// B·T in nodes.
fn span(sweep: &Sweep, interval: &PathInterval) -> f64 {
    OVERSAMPLING * sweep.bandwidth() * interval.duration()
}

/// How many virtual tones a sweep has on an interval, to within two.
pub(crate) fn count(sweep: &Sweep, interval: &PathInterval, tolerance: f64) -> usize {
    let (span, taps, most) = (span(sweep, interval), usual_taps(tolerance), sweep.len());
    if span < most as f64 && taps <= MOST_TAPS { nodes(span, taps).len().min(most) } else { most }
}

impl VirtualTones {
    /// The tones for all path lengths of `interval` to within `tolerance`; where measured ones are as few, or no
    /// interpolator is as exact, the measured ones themselves.
    ///
    /// Cost: a factorisation of some `4·taps` rows for each window at the ends of the band and one amid it, and for each
    /// measured tone a few sines and `2·taps²` products.
    pub(crate) fn find(sweep: &Sweep, interval: PathInterval, tolerance: f64) -> Self {
        let mut taps = usual_taps(tolerance);
        while taps <= MOST_TAPS && count(sweep, &interval, tolerance) < sweep.len() {
            let found = Self::with_taps(sweep, &interval, taps);
            if found.error <= tolerance {
                return found;
            }
            taps += 2;
        }
        let (own, one) = ((0..sweep.len()).collect(), Matrix::from_fn(1, sweep.len(), |_, _| 1.0));
        Self::new(sweep, sweep.frequencies().to_vec(), &interval, own, one, (0.0, 1.0))
    }

    fn new(
        sweep: &Sweep,
        frequencies: Vec<f64>,
        interval: &PathInterval,
        first: Vec<usize>,
        weights: Matrix,
        (error, growth): (f64, f64),
    ) -> Self {
        let turns = turns(sweep, &frequencies, interval.middle());
        Self { frequencies, first: first.into(), weights: Arc::new(weights), turns, error, growth }
    }

    /// The same tones for delays about another middle, s.
    pub(crate) fn about(&self, sweep: &Sweep, middle: f64) -> Self {
        Self { turns: turns(sweep, &self.frequencies, middle), ..self.clone() }
    }

    fn with_taps(sweep: &Sweep, interval: &PathInterval, taps: usize) -> Self {
        let span = span(sweep, interval);
        let nodes = nodes(span, taps);
        let (count, taps) = (nodes.len(), taps.min(nodes.len()));
        let [lowest, bandwidth] = [sweep.frequencies()[0], sweep.bandwidth()];
        // In nodes; all the same where the interval has no length.
        let places: Vec<f64> = sweep.frequencies().iter().map(|f| (f - lowest) / bandwidth * span).collect();
        let window = |place: &f64| {
            let after = nodes.partition_point(|node| node <= place);
            after.saturating_sub(taps / 2).min(count - taps)
        };
        let first: Vec<usize> = places.iter().map(window).collect();
        // Windows of even gaps are all alike, and those at one end the mirror images of those at the other.
        let evens = (end(taps) - 0.5).ceil() as usize;
        let kind = |window: usize| window.min(count - taps - window).min(evens);
        let about = |place: f64, window: usize| {
            place - nodes[window] - 0.5 * (nodes[window + taps - 1] - nodes[window])
        };
        let interpolator = |window: usize| {
            let own = nodes[window..window + taps].iter().map(|node| about(*node, window)).collect();
            let interpolator = Taps::on(own, PI / OVERSAMPLING);
            // The gaps that it serves: the first and the last window more than the one in its middle.
            let from = if window == 0 { 0 } else { window + taps / 2 - 1 };
            let to = if window == count - taps { count - 1 } else { window + taps / 2 };
            let between = (from..to).flat_map(|gap| {
                let (node, next) = (nodes[gap], nodes[gap + 1]);
                [0.1, 0.3, 0.5, 0.7, 0.9].map(|t| about(node + t * (next - node), window))
            });
            let worst = interpolator.error_at(PI / OVERSAMPLING, &between.collect::<Vec<_>>());
            (interpolator, worst)
        };
        let kinds = kind((count - taps) / 2);
        let interpolators: Vec<_> = (0..=kinds).into_par_iter().map(interpolator).collect();
        let mut weights = Matrix::zeros(taps, sweep.len());
        let mut start = 0;
        for run in first.chunk_by(|a, b| a == b || (kind(*a) == evens && kind(*b) == evens)) {
            let mirrored = kind(run[0]) < evens && run[0] > count - taps - run[0];
            let sign = if mirrored { -1.0 } else { 1.0 };
            let measured =
                run.iter().zip(&places[start..]).map(|(window, place)| sign * about(*place, *window));
            let some = interpolators[kind(run[0])].0.weights_of(&measured.collect::<Vec<_>>());
            let some = if mirrored { some.reverse_rows() } else { some.as_ref() };
            weights.subcols_mut(start, run.len()).copy_from(some);
            start += run.len();
        }
        let worst = interpolators.iter().map(|(_, worst)| *worst);
        let worst = worst.fold((0.0, 0.0), |(e, g), (error, sum)| (greater(e, error), greater(g, sum)));
        let frequencies = nodes.iter().enumerate().map(|(k, node)| {
            // Where any tones would do, they still are to differ.
            let share = if span > 0.0 { node / span } else { k as f64 / (count - 1) as f64 };
            lowest + share * bandwidth
        });
        Self::new(sweep, frequencies.collect(), interval, first, weights, worst)
    }

    /// From the first to the last, Hz.
    pub(crate) fn bandwidth(&self) -> f64 {
        self.frequencies[self.frequencies.len() - 1] - self.frequencies[0]
    }

    /// f_k, Hz, ascending and within the band.
    pub(crate) fn frequencies(&self) -> &[f64] {
        &self.frequencies
    }

    /// Adds measured samples of `range`, `[range, n_mic]`, with the weights of a window over frequencies, to virtual ones
    /// `[tones, n_mic]`, about the interval's middle; gives `Σ|w m|`, if moduli are asked for.
    pub(crate) fn add(
        &self,
        range: Range<usize>,
        samples: &[Complex32],
        (window, moduli): (&Weights, bool),
        rows: &mut [Complex32],
    ) -> f64 {
        let frequency = &window.frequency[range.clone()];
        let turn = |(turn, w): (&Complex64, &f32)| {
            let turn = turn.conj() * f64::from(*w);
            Complex32::new(turn.re as f32, turn.im as f32)
        };
        let weights: Vec<f32> =
            range.clone().flat_map(|n| self.weights.col_as_slice(n)).map(|w| *w as f32).collect();
        let turns: Vec<_> = self.turns[0][range.clone()].iter().zip(frequency).map(turn).collect();
        let banded = Banded {
            first: &self.first[range.clone()],
            taps: self.weights.nrows(),
            weights: &weights,
            turns: &turns,
            window: moduli.then_some(frequency),
        };
        banded.add(samples, &window.microphone, rows)
    }

    /// Turns samples of virtual tones `[tones, n_mic]`, to which all measured ones were added, back to delays from zero,
    /// with the weights of a window over microphones.
    pub(crate) fn finish(&self, window: &Weights, rows: &mut [Complex32]) {
        let n_mic = window.microphone.len();
        let rows = rows.par_chunks_exact_mut(n_mic).with_min_len(SUMMED / n_mic + 1);
        rows.zip(&self.turns[1]).for_each(|(row, turn)| {
            let turn = Complex32::new(turn.re as f32, turn.im as f32);
            row.iter_mut().zip(&window.microphone).for_each(|(m, w)| *m *= turn * w);
        });
    }

    /// The adjoint of [`VirtualTones::add`] and [`VirtualTones::finish`] without a window: measured tones of `range`,
    /// `[range, n_mic]`, from virtual ones, `[tones, n_mic]`.
    pub(crate) fn expand(
        &self,
        range: Range<usize>,
        virtual_tones: &[Complex32],
        n_mic: usize,
        samples: &mut [Complex32],
    ) {
        samples.par_chunks_exact_mut(n_mic).zip(range).for_each(|(row, n)| {
            row.fill(Complex32::ZERO);
            for (k, w) in (self.first[n]..).zip(self.weights.col_as_slice(n)) {
                let weight = *w * self.turns[0][n] * self.turns[1][k].conj();
                let weight = Complex32::new(weight.re as f32, weight.im as f32);
                add_weighted(weight, &virtual_tones[k * n_mic..][..n_mic], row);
            }
        });
    }

    /// The measured tones that virtual ones can make, as a basis of its columns, `[n_f, tones]`, real with delays counted from
    /// the interval's middle.
    pub(crate) fn basis(&self) -> Matrix {
        let mut basis = Matrix::zeros(self.first.len(), self.frequencies.len());
        for (n, first) in self.first.iter().enumerate() {
            for (tap, w) in self.weights.col_as_slice(n).iter().enumerate() {
                basis[(n, first + tap)] = *w;
            }
        }
        basis
    }

    /// The phasors `e^{i2πf·middle}` of the measured tones.
    pub(crate) fn turns(&self) -> &[Complex64] {
        &self.turns[0]
    }
}

#[inline(always)]
fn add_weighted_body<const FMA: bool>(weight: Complex32, samples: &[Complex32], sum: &mut [Complex32]) {
    for (sum, m) in sum.iter_mut().zip(samples) {
        *sum = plus_product::<FMA>(*sum, weight, *m);
    }
}

dispatched! {
    /// Adds a row of samples, times a weight.
    fn add_weighted = fused add_weighted_body(weight: Complex32, samples: &[Complex32], sum: &mut [Complex32])
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::TAU;

    fn interval(duration: f64) -> PathInterval {
        PathInterval { shortest: 2.0, longest: 2.0 + 343.0 * duration, sound_speed: 343.0 }
    }

    fn even(count: usize) -> Sweep {
        let f = |n: usize| 10_000.0 + 10_000.0 * n as f64 / (count - 1) as f64;
        Sweep::from_frequencies((0..count).map(f).collect()).expect("ascending")
    }

    fn uneven(count: usize) -> Sweep {
        let mut f: Vec<f64> = even(count).frequencies().to_vec();
        f.iter_mut().enumerate().for_each(|(n, f)| *f += 3.0 * (n as f64 * 0.618_034).fract());
        // And one far from the others.
        f.push(23_456.0);
        Sweep::from_frequencies(f).expect("ascending")
    }

    /// W as the product carries it out, `[virtual, measured]`: what becomes of one microphone for each tone, which hears
    /// that tone alone.
    fn weights(found: &VirtualTones, count: usize) -> Vec<Complex32> {
        let ones = Weights { frequency: vec![1.0; count], microphone: vec![1.0; count] };
        let mut rows = vec![Complex32::ZERO; found.frequencies().len() * count];
        let starts = (0..count).step_by(300);
        let mut modulus = 0.0;
        for range in starts.map(|first| first..(first + 300).min(count)) {
            let mut samples = vec![Complex32::ZERO; range.len() * count];
            for (row, n) in samples.chunks_exact_mut(count).zip(range.clone()) {
                row[n] = Complex32::ONE;
            }
            modulus += found.add(range, &samples, (&ones, true), &mut rows);
        }
        assert!((modulus - count as f64).abs() < 1e-4 * count as f64);
        found.finish(&ones, &mut rows);
        rows
    }

    /// `e^{−i2πfτ} − Σ_k W[n, k] e^{−i2πf_kτ}` as written, at its largest over places of its own.
    fn literal_error(sweep: &Sweep, interval: PathInterval, found: &VirtualTones) -> f64 {
        let (count, weights) = (sweep.len(), weights(found, sweep.len()));
        let mut worst = 0.0f64;
        for i in 0..=100 {
            let path = interval.shortest + (interval.longest - interval.shortest) * f64::from(i) / 100.0;
            let tone = |f: f64| Complex64::cis(-TAU * (f * path / interval.sound_speed).fract());
            let mut left: Vec<Complex64> = sweep.frequencies().iter().map(|f| tone(*f)).collect();
            for (f, weights) in found.frequencies().iter().zip(weights.chunks_exact(count)) {
                let e = tone(*f);
                for (left, w) in left.iter_mut().zip(weights) {
                    *left -= Complex64::new(w.re.into(), w.im.into()) * e;
                }
            }
            worst = left.iter().map(|left| left.norm()).fold(worst, f64::max);
        }
        worst
    }

    #[test]
    fn every_measured_tone_is_made_of_a_few_virtual_ones_within_the_band() {
        for sweep in [even(1001), uneven(700)] {
            for duration in [0.0, 1e-5, 1e-4, 4e-4, 2e-3, 9e-3] {
                for tolerance in [1e-2, 3e-5, 1e-6, 1e-7] {
                    let found = VirtualTones::find(&sweep, interval(duration), tolerance);
                    let spread = sweep.bandwidth() * duration;
                    let what = format!("{} tones, BT {spread}, {tolerance:e}", sweep.len());
                    assert!(found.error <= tolerance, "{what}: {:e}", found.error);
                    let error = literal_error(&sweep, interval(duration), &found);
                    // The weights are held in f32.
                    assert!(error <= 1.1 * found.error + 1e-6, "{what}: {error:e} above {:e}", found.error);
                    assert!(found.growth < 4.0, "{what}: weights of {}", found.growth);
                    let tones = found.frequencies();
                    assert!(tones.len() as f64 <= 2.0 * spread + 14.0, "{what}: {}", tones.len());
                    let most = count(&sweep, &interval(duration), tolerance);
                    assert!(tones.len().abs_diff(most) <= 2, "{what}: {} of {most}", tones.len());
                    assert!(tones.is_sorted_by(|a, b| a < b));
                    assert!(tones[0] >= sweep.frequencies()[0] - 1e-9);
                    assert!(tones[tones.len() - 1] <= sweep.frequencies()[sweep.len() - 1] + 1e-9);
                }
            }
        }
    }

    #[test]
    fn where_virtual_tones_are_no_fewer_the_measured_ones_stay() {
        for sweep in [even(60), Sweep::from_frequencies(vec![12_345.0]).expect("one")] {
            let found = VirtualTones::find(&sweep, interval(9e-3), 1e-4);
            assert_eq!(found.frequencies(), sweep.frequencies());
            assert_eq!((found.error, found.growth), (0.0, 1.0));
            assert!(literal_error(&sweep, interval(9e-3), &found) < 1e-6);
            assert_eq!(count(&sweep, &interval(9e-3), 1e-4), sweep.len());
        }
    }
}
