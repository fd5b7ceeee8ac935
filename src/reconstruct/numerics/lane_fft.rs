//! Fourier transforms of sixteen neighbouring columns at once.
//!
//! A vector register holds one element of sixteen columns, so a transform along the columns needs no shuffle and a
//! plane's second axis no strided access: between the two axes are transpositions of 16 × 16 tiles. Stockham's
//! algorithm, radix 8, 6, 5, 4, 3 and 2, between buffers. The same plain loops at every vector width give the same bytes.
//! Only forward and without a scale: the inverse is the forward transform with real and imaginary parts exchanged.

#![allow(clippy::inline_always, clippy::needless_range_loop)]

use crate::wave::simd::fused::{plus_scaled, product};
use crate::wave::simd::{LANES, Lanes, dispatched};
use num_complex::Complex32;
use std::f64::consts::TAU;

/// Transforms of one length.
#[derive(Debug, Clone)]
pub(crate) struct LaneFft {
    n: usize,
    passes: Vec<Pass>,
}

/// One pass of Stockham's algorithm: `n / radix` butterflies.
#[derive(Debug, Clone)]
struct Pass {
    radix: usize,
    /// Product of the radices before this one: neighbours that share their twiddle factors.
    stride: usize,
    /// `e^{−i2π·p·k/(n/stride)}` for each group p of butterflies and output k < radix; all 1 in the last pass.
    twiddles: Vec<Complex32>,
}

/// The smallest 2^a 3^b 5^c that is at least `n` and a multiple of `step`.
pub(crate) fn fast_size(n: usize, step: usize) -> usize {
    let smooth = |mut m: usize| {
        for factor in [2, 3, 5] {
            while m.is_multiple_of(factor) {
                m /= factor;
            }
        }
        m == 1
    };
    let multiples = n.max(1).div_ceil(step)..;
    multiples
        .map(|m| m * step)
        .find(|m| smooth(*m))
        .expect("there is one below the next power of two times step")
}

/// Radices that make up a number in as few passes as can be.
///
/// # Panics
/// When it has other prime factors than 2, 3 and 5.
fn radices(n: usize) -> Vec<usize> {
    let mut left = n;
    let [twos, threes, fives] = [2, 3, 5].map(|factor| {
        let before = left;
        while left.is_multiple_of(factor) {
            left /= factor;
        }
        (before / left).ilog(factor) as usize
    });
    assert_eq!(left, 1, "fast sizes have no other factors");
    let passes = |sixes: &usize| (twos - sixes).div_ceil(3) + threes;
    let sixes = (0..=twos.min(threes)).min_by_key(passes).unwrap_or(0);
    let (eights, rest) = ((twos - sixes) / 3, 1 << ((twos - sixes) % 3));
    let counts = [(8, eights), (6, sixes), (5, fives), (rest, usize::from(rest > 1)), (3, threes - sixes)];
    counts.into_iter().flat_map(|(radix, count)| std::iter::repeat_n(radix, count)).collect()
}

impl LaneFft {
    /// # Panics
    /// When `n` has other prime factors than 2, 3 and 5.
    pub(crate) fn new(n: usize) -> Self {
        let (mut left, mut stride, mut passes) = (n, 1, Vec::new());
        for radix in radices(n) {
            let twiddle = |p: usize, k: usize| {
                let (sin, cos) = (-TAU * (p * k) as f64 / left as f64).sin_cos();
                Complex32::new(cos as f32, sin as f32)
            };
            let twiddles =
                (0..left / radix).flat_map(|p| (0..radix).map(move |k| (p, k))).map(|(p, k)| twiddle(p, k));
            passes.push(Pass { radix, stride, twiddles: twiddles.collect() });
            (left, stride) = (left / radix, stride * radix);
        }
        Self { n, passes }
    }

    /// Length of the columns.
    pub(crate) fn len(&self) -> usize {
        self.n
    }

    /// `to[k] = Σ_j from[j] e^{−i2πjk/n}` in every lane; `work` is overwritten.
    ///
    /// # Panics
    /// When a slice is not of the transform's length.
    pub(crate) fn transform(&self, from: &[Lanes], to: &mut [Lanes], work: &mut [Lanes]) {
        assert!(from.len() == self.n && to.len() == self.n && work.len() == self.n, "columns of one length");
        transform(self, from, to, work);
    }
}

#[inline(always)]
fn transform_body<const FMA: bool>(fft: &LaneFft, from: &[Lanes], to: &mut [Lanes], work: &mut [Lanes]) {
    let Some((first, rest)) = fft.passes.split_first() else {
        to.copy_from_slice(from);
        return;
    };
    // The last pass writes to `to`, those before alternate.
    let (mut a, mut b) = if rest.len().is_multiple_of(2) { (to, work) } else { (work, to) };
    first.run::<FMA>(from, a);
    for pass in rest {
        pass.run::<FMA>(a, b);
        std::mem::swap(&mut a, &mut b);
    }
}

dispatched! {
    fn transform = fused transform_body(fft: &LaneFft, from: &[Lanes], to: &mut [Lanes], work: &mut [Lanes])
}

impl Pass {
    #[inline(always)]
    fn run<const FMA: bool>(&self, from: &[Lanes], to: &mut [Lanes]) {
        match self.radix {
            8 => self.butterflies::<FMA, 8>(from, to, dft8::<FMA>),
            6 => self.butterflies::<FMA, 6>(from, to, dft6::<FMA>),
            5 => self.butterflies::<FMA, 5>(from, to, dft5::<FMA>),
            4 => self.butterflies::<FMA, 4>(from, to, dft4),
            3 => self.butterflies::<FMA, 3>(from, to, dft3::<FMA>),
            _ => self.butterflies::<FMA, 2>(from, to, dft2),
        }
    }

    /// Inputs lie n/R apart, outputs `stride`.
    #[inline(always)]
    fn butterflies<const FMA: bool, const R: usize>(
        &self,
        from: &[Lanes],
        to: &mut [Lanes],
        dft: impl Dft<R>,
    ) {
        let apart = from.len() / R;
        let inputs = |first: usize| std::array::from_fn(|k| &from[first + k * apart]);
        // A loop over lanes becomes vector code only if its outputs lie at fixed distances: in place where they are
        // neighbours, else in a tile of their own.
        let mut tile = [Lanes::ZERO; R];
        if apart == self.stride {
            for q in 0..apart {
                butterfly(inputs(q), dft, |_, z| z, &mut tile);
                for k in 0..R {
                    to[q + k * self.stride] = tile[k];
                }
            }
            return;
        }
        let groups = self.twiddles.as_chunks::<R>().0.iter().enumerate();
        if self.stride == 1 {
            for ((group, twiddles), to) in groups.zip(to.as_chunks_mut::<R>().0) {
                butterfly(inputs(group), dft, |k, z| product::<FMA>(z, twiddles[k]), to);
            }
            return;
        }
        for ((group, twiddles), to) in groups.zip(to.chunks_exact_mut(R * self.stride)) {
            for q in 0..self.stride {
                butterfly(
                    inputs(group * self.stride + q),
                    dft,
                    |k, z| product::<FMA>(z, twiddles[k]),
                    &mut tile,
                );
                for k in 0..R {
                    to[q + k * self.stride] = tile[k];
                }
            }
        }
    }
}

/// A transform of R numbers, before `twiddle` makes it part of a longer one, in every lane.
#[inline(always)]
fn butterfly<const R: usize>(
    from: [&Lanes; R],
    dft: impl Dft<R>,
    twiddle: impl Fn(usize, Complex32) -> Complex32,
    to: &mut [Lanes; R],
) {
    for l in 0..LANES {
        let z = dft(std::array::from_fn(|k| from[k].at(l)));
        for k in 0..R {
            let z = if k == 0 { z[0] } else { twiddle(k, z[k]) };
            (to[k].re[l], to[k].im[l]) = (z.re, z.im);
        }
    }
}

/// A transform of R numbers.
trait Dft<const R: usize>: Fn([Complex32; R]) -> [Complex32; R] + Copy {}
impl<const R: usize, F: Fn([Complex32; R]) -> [Complex32; R] + Copy> Dft<R> for F {}

/// −i·z.
#[inline(always)]
fn turned(z: Complex32) -> Complex32 {
    Complex32::new(z.im, -z.re)
}

#[inline(always)]
fn dft2([a, b]: [Complex32; 2]) -> [Complex32; 2] {
    [a + b, a - b]
}

#[inline(always)]
fn dft3<const FMA: bool>([a, b, c]: [Complex32; 3]) -> [Complex32; 3] {
    const SIN: f32 = 0.866_025_4;
    let (sum, difference) = (b + c, turned(b - c));
    let middle = plus_scaled::<FMA>(a, sum, -0.5);
    [a + sum, plus_scaled::<FMA>(middle, difference, SIN), plus_scaled::<FMA>(middle, difference, -SIN)]
}

#[inline(always)]
fn dft4([a, b, c, d]: [Complex32; 4]) -> [Complex32; 4] {
    let ([p, q], [r, s]) = (dft2([a, c]), dft2([b, d]));
    let s = turned(s);
    [p + r, q + s, p - r, q - s]
}

#[inline(always)]
fn dft5<const FMA: bool>([a, b, c, d, e]: [Complex32; 5]) -> [Complex32; 5] {
    /// cos and sin of 2π/5 and 4π/5.
    const COS: [f32; 2] = [0.309_017, -0.809_017];
    const SIN: [f32; 2] = [0.951_056_5, 0.587_785_25];
    let ([p, q], [r, s]) = (dft2([b, e]), dft2([c, d]));
    let add = plus_scaled::<FMA>;
    let (m, n) = (add(add(a, p, COS[0]), r, COS[1]), add(add(a, p, COS[1]), r, COS[0]));
    let (u, v) = (turned(add(q * SIN[0], s, SIN[1])), turned(add(q * SIN[1], s, -SIN[0])));
    [a + p + r, m + u, n + v, n - v, m - u]
}

#[inline(always)]
fn dft6<const FMA: bool>([a, b, c, d, e, f]: [Complex32; 6]) -> [Complex32; 6] {
    // Two and three have no common factor: nothing is turned between the two.
    let ([p, q], [r, s], [t, u]) = (dft2([a, d]), dft2([c, f]), dft2([e, b]));
    let ([p, r, t], [q, s, u]) = (dft3::<FMA>([p, r, t]), dft3::<FMA>([q, s, u]));
    [p, s, t, q, r, u]
}

#[inline(always)]
fn dft8<const FMA: bool>([a, b, c, d, e, f, g, h]: [Complex32; 8]) -> [Complex32; 8] {
    const HALF: f32 = std::f32::consts::FRAC_1_SQRT_2;
    let ([p, q, r, s], [t, u, v, w]) = (dft4([a, c, e, g]), dft4([b, d, f, h]));
    let u = Complex32::new(u.re + u.im, u.im - u.re);
    let v = turned(v);
    let w = Complex32::new(w.im - w.re, -w.re - w.im);
    let add = plus_scaled::<FMA>;
    [p + t, add(q, u, HALF), r + v, add(s, w, HALF), p - t, add(q, u, -HALF), r - v, add(s, w, -HALF)]
}

#[cfg(test)]
mod tests {
    use super::*;
    use num_complex::Complex64;
    use rustfft::FftPlanner;

    /// Columns that look random, another in every lane.
    fn columns(n: usize) -> Vec<Lanes> {
        let value = |i: usize, k: f64| (i as f64 * k).fract() as f32 - 0.5;
        let lanes = |j: usize, k: f64| std::array::from_fn(|l| value(j * LANES + l, k));
        (0..n).map(|j| Lanes { re: lanes(j, 0.618_033_988_75), im: lanes(j, 0.754_877_67) }).collect()
    }

    #[test]
    fn every_fast_size_agrees_with_rustfft_in_every_lane() {
        let mut planner = FftPlanner::new();
        for n in (1..=1080).filter(|n| fast_size(*n, 1) == *n) {
            let from = columns(n);
            let (mut to, mut work) = (vec![Lanes::ZERO; n], vec![Lanes::ZERO; n]);
            LaneFft::new(n).transform(&from, &mut to, &mut work);
            for lane in 0..LANES {
                // In f64, so that what differs is our rounding alone.
                let mut column: Vec<Complex64> =
                    from.iter().map(|row| Complex64::new(row.re[lane].into(), row.im[lane].into())).collect();
                planner.plan_fft_forward(n).process(&mut column);
                for (row, expected) in to.iter().zip(&column) {
                    let value = Complex64::new(row.re[lane].into(), row.im[lane].into());
                    let error = (value - expected).norm();
                    assert!(error < 1e-6 * (n as f64).sqrt(), "n {n} lane {lane}: {error:e}");
                }
            }
        }
    }

    #[test]
    fn every_instruction_set_gives_the_same_bytes() {
        for n in [64, 90, 192] {
            let (from, zeros) = (columns(n), vec![Lanes::ZERO; n]);
            let (mut a, mut b, mut work) = (zeros.clone(), zeros.clone(), zeros);
            let fft = LaneFft::new(n);
            fft.transform(&from, &mut a, &mut work);
            transform_body::<false>(&fft, &from, &mut b, &mut work);
            assert_eq!(a, b);
        }
    }

    #[test]
    fn sizes_have_small_factors_only() {
        for (n, step, expected) in [
            (1, 1, 1),
            (7, 1, 8),
            (71, 1, 72),
            (77, 1, 80),
            (127, 1, 128),
            (513, 1, 540),
            (191, 32, 192),
            (200, 32, 256),
            (1, 16, 16),
            (205, 16, 240),
        ] {
            assert_eq!(fast_size(n, step), expected);
        }
    }
}
