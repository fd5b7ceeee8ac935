//! Phasors in blocks, at the processor's vector width.
//!
//! Each kernel is one plain loop, compiled three times (AVX-512, AVX2, baseline) and chosen at run time, up to a
//! [`limit`]. All three fuse the same multiplications and additions (`fused.rs`) and sum into a fixed number of lanes, so
//! that they give bit-identical results. Simulation uses them too. `inline(always)` lets a body be compiled for the
//! features of its caller. This file and `transpose.rs` have the only `unsafe` code: calls of functions compiled for a
//! feature, after a check for it.

#![allow(clippy::inline_always, clippy::needless_range_loop)]

pub(crate) mod double;
pub(crate) mod fused;
mod lanes;
mod level;
mod points;
mod range;
pub(crate) mod rows;
mod sweep;
mod transpose;

pub use level::{Level, level, limit};
pub(crate) use points::Points;
pub(crate) use range::{LaneProfiles, LaneTones, RangeScale};
pub(crate) use sweep::{Amplitudes, Steps, SweepSamples, sin_cos_exact};
pub(crate) use transpose::{lane_sums, transpose};

use fused::{fused, polynomial};
use lanes::{lane_phasors_body, tone_phasors_body};
use num_complex::Complex32;
use range::{back_project_body, range_profiles_body};
use sweep::{sum_over_sweep_body, waves_body, weighted_sweep_body};

/// Terms per block: the two stages pass through a buffer of this size, which stays in the first-level cache.
pub(crate) const BLOCK: usize = 256;

/// Independent partial sums of every reduction, and numbers in a [`Lanes`].
pub(crate) const LANES: usize = 16;

/// Sixteen complex numbers in the layout of vector registers: real parts, then imaginary parts.
#[derive(Debug, Clone, Copy, PartialEq)]
#[repr(C, align(64))]
pub(crate) struct Lanes {
    /// Real parts.
    pub(crate) re: [f32; LANES],
    /// Imaginary parts.
    pub(crate) im: [f32; LANES],
}

impl Lanes {
    /// Sixteen zeros.
    pub(crate) const ZERO: Self = Self { re: [0.0; LANES], im: [0.0; LANES] };

    /// The number in one lane.
    #[inline(always)]
    pub(crate) fn at(&self, lane: usize) -> Complex32 {
        Complex32::new(self.re[lane], self.im[lane])
    }
}

/// How many [`Lanes`] a loop takes at a time: with only one the compiler gathers across rows, ten times slower.
pub(crate) const ROWS: usize = 4;

/// Frequencies for which a phasor is updated by recurrence before it is recomputed; it drifts by 64 · 2⁻²⁴ ≈ 4·10⁻⁶.
const RECURRENCE: usize = 64;

/// Defines `$name` from `$body` in three instruction sets with run-time choice. After `fused` the body has a parameter
/// that says whether there is an instruction for it, and with `by` another: the numbers it takes at a time, which are
/// given for AVX-512 and for half as many registers of half the size.
macro_rules! dispatched {
    (
        $(#[$doc:meta])* $visible:vis fn $name:ident = fused $body:ident by [$wide:expr, $narrow:expr]($($args:tt)*)
    ) => {
        $crate::wave::simd::dispatched! {
            @ $(#[$doc])* $visible fn $name = [
                $body::<true, $wide>,
                $body::<true, $narrow>,
                $body::<{ $crate::wave::simd::fused::ON_TARGET }, $narrow>
            ]($($args)*)
        }
    };
    ($(#[$doc:meta])* $visible:vis fn $name:ident = fused $body:ident($($args:tt)*)) => {
        $crate::wave::simd::dispatched! {
            @ $(#[$doc])* $visible fn $name =
            [$body::<true>, $body::<true>, $body::<{ $crate::wave::simd::fused::ON_TARGET }>]($($args)*)
        }
    };
    ($(#[$doc:meta])* $visible:vis fn $name:ident = $body:ident($($args:tt)*)) => {
        $crate::wave::simd::dispatched! { @ $(#[$doc])* $visible fn $name = [$body, $body, $body]($($args)*) }
    };
    (
        @ $(#[$doc:meta])* $visible:vis fn $name:ident =
        [$wide:expr, $medium:expr, $baseline:expr]($($arg:ident: $type:ty),* $(,)?)
    ) => {
        $(#[$doc])*
        #[allow(unsafe_code)]
        $visible fn $name($($arg: $type),*) {
            #[cfg(target_arch = "x86_64")]
            {
                #[target_feature(enable = "avx512f,avx512dq,avx512vl,avx512bw,avx2,fma")]
                fn wide($($arg: $type),*) { $wide($($arg),*); }
                #[target_feature(enable = "avx2,fma")]
                fn medium($($arg: $type),*) { $medium($($arg),*); }
                match $crate::wave::simd::level() {
                    // SAFETY: a level is never above the processor's, which has the features of both.
                    $crate::wave::simd::Level::Avx512 => return unsafe { wide($($arg),*) },
                    // SAFETY: as above.
                    $crate::wave::simd::Level::Avx2 => return unsafe { medium($($arg),*) },
                    $crate::wave::simd::Level::Baseline => {}
                }
            }
            $baseline($($arg),*);
        }
    };
}
pub(crate) use dispatched;

/// Clears the upper halves of vector registers, which products of matrices (faer's kernels) leave filled.
///
/// The compiler does so after every AVX function that it generates. Without it, code for SSE, including the C library's
/// `exp` and `cos`, is ten times slower on that thread from then on. [`crate::linalg`] calls this on the thread that
/// called faer.
#[allow(unsafe_code)]
pub(crate) fn leave_wide_registers() {
    #[cfg(target_arch = "x86_64")]
    if is_x86_feature_detected!("avx") {
        // SAFETY: the feature was found on this processor a line above; no vector is held across the call.
        unsafe { std::arch::x86_64::_mm256_zeroupper() }
    }
}

/// `(sin 2πt, cos 2πt)` for |t| ≤ ½, by the half angle: no quadrant, no branch, error under 6·10⁻⁷.
#[inline(always)]
pub(super) fn sin_cos_turns<const FMA: bool>(t: f32) -> (f32, f32) {
    // Of sin πt and cos πt in powers of t², with the least error on |t| ≤ ½: 8·10⁻⁹ and 5·10⁻⁸.
    const S: [f32; 5] = [std::f32::consts::PI, -5.167_714, 2.550_125, -0.598_512_6, 0.078_012_32];
    const C: [f32; 5] = [1.0, -4.934_795_4, 4.058_451, -1.332_093_8, 0.220_080_67];
    let u = t * t;
    let (s, c) = (t * polynomial::<FMA>(&S, u), polynomial::<FMA>(&C, u));
    (2.0 * s * c, fused::<FMA>(-2.0 * s, s, 1.0))
}

/// Wraps cycles to ±½ with the magic-number rounding that vectorises.
#[inline(always)]
fn wrap_exact(cycles: f64) -> f64 {
    const MAGIC: f64 = 6_755_399_441_055_744.0; // 1.5 · 2^52: adding it rounds to an integer.
    cycles - ((cycles + MAGIC) - MAGIC)
}

/// Wraps cycles to ±½, then rounds them to f32.
#[inline(always)]
fn wrap_fast(cycles: f64) -> f32 {
    wrap_exact(cycles) as f32
}

/// Wraps cycles to ±½ in f32: for the few cycles of an offset.
#[inline(always)]
pub(super) fn wrap_few(cycles: f32) -> f32 {
    const MAGIC: f32 = 12_582_912.0; // 1.5 · 2^23: adding it rounds to an integer.
    cycles - ((cycles + MAGIC) - MAGIC)
}

#[inline(always)]
fn phasors_body<const FMA: bool>(cycles_per_metre: f64, lengths: &[f64], phasors: &mut [Complex32]) {
    assert!(lengths.len() == phasors.len(), "one phasor per length");
    let mut turns = [0.0f32; BLOCK];
    for (lengths, phasors) in lengths.chunks(BLOCK).zip(phasors.chunks_mut(BLOCK)) {
        // Two stages, because a loop that mixes f64 and f32 does not vectorise well (4 times slower).
        for (turn, length) in turns.iter_mut().zip(lengths) {
            *turn = wrap_fast(length * cycles_per_metre);
        }
        for (turn, phasor) in turns.iter().zip(phasors) {
            (phasor.im, phasor.re) = sin_cos_turns::<FMA>(*turn);
        }
    }
}

dispatched! {
    /// `e^{i2π·cycles_per_metre·length}` for every length (m); give `−f/c` for the conjugate.
    ///
    /// Cost: about 20 operations per phasor, 1 to 2·10⁹ phasors/s per thread.
    ///
    /// # Panics
    /// When the slices differ in length.
    pub(crate) fn phasors = fused phasors_body(cycles_per_metre: f64, lengths: &[f64], phasors: &mut [Complex32])
}

dispatched! {
    /// `e^{i2π·cycles_per_metre·√(square + height²)}`, squares in m², for a frequency in every lane; give `−f/c` for the conjugate.
    ///
    /// # Panics
    /// When the slices differ in length or are no multiple of [`ROWS`].
    pub(crate) fn tone_phasors = fused tone_phasors_body(
        cycles_per_metre: &[f64; LANES], squares: &[f64], height: f64, phasors: &mut [Lanes],
    )
}

dispatched! {
    /// `e^{i2π·cycles_per_metre·length}` lane by lane for every length (m); give `−f/c` for the conjugate.
    ///
    /// Cost: about 20 operations per phasor, 1 to 2·10⁹ phasors/s per thread.
    ///
    /// # Panics
    /// When the slices differ in length or are no multiple of [`ROWS`].
    pub(crate) fn lane_phasors = fused lane_phasors_body(
        cycles_per_metre: &[f64; LANES], lengths: &[[f64; LANES]], phasors: &mut [Lanes],
    )
}

dispatched! {
    /// `cos 2π·frequency·delay` and `sin 2π·frequency·delay` for every delay, in f64.
    ///
    /// # Panics
    /// When the slices differ in length.
    pub(crate) fn waves = waves_body(frequency: f64, delays: &[f64], cos: &mut [f64], sin: &mut [f64])
}

dispatched! {
    /// Adds `Σ_j A_j e^{i2π(start + n·step)·length_j}` to `sums[n]` (real, imaginary) for every n of the sweep.
    ///
    /// `lengths` is `[padded_len]` in m. Cost: 8 operations per term, by phasor recurrence that restarts every
    /// 64 frequencies.
    ///
    /// # Panics
    /// When the lengths do not match.
    pub(crate) fn sum_over_sweep = fused sum_over_sweep_body(
        amplitudes: &Amplitudes, lengths: &[f64], steps: Steps, sums: &mut [[f64; 2]],
    )
}

#[inline(always)]
fn weighted_sum_body<const FMA: bool>(
    cycles_per_metre: f64,
    lengths: &[f64],
    samples: [&[f32]; 2],
    total: &mut [f64; 2],
) {
    assert!(lengths.len() == samples[0].len() && lengths.len() == samples[1].len(), "one sample per length");
    let (mut turns, mut products) = ([0.0f32; BLOCK], [[0.0f32; LANES]; 2]);
    for ((lengths, re), im) in
        lengths.chunks(BLOCK).zip(samples[0].chunks(BLOCK)).zip(samples[1].chunks(BLOCK))
    {
        turns.fill(0.0);
        for (turn, length) in turns.iter_mut().zip(lengths) {
            *turn = wrap_fast(length * cycles_per_metre);
        }
        for lane in &mut products {
            lane.fill(0.0);
        }
        for ((turns, re), im) in
            turns.as_chunks::<LANES>().0.iter().zip(re.chunks(LANES)).zip(im.chunks(LANES))
        {
            if let (Ok(re), Ok(im)) = (<&[f32; LANES]>::try_from(re), <&[f32; LANES]>::try_from(im)) {
                for l in 0..LANES {
                    let (s, c) = sin_cos_turns::<FMA>(turns[l]);
                    products[0][l] = fused::<FMA>(re[l], c, fused::<FMA>(-im[l], s, products[0][l]));
                    products[1][l] = fused::<FMA>(re[l], s, fused::<FMA>(im[l], c, products[1][l]));
                }
            } else {
                for l in 0..re.len() {
                    let (s, c) = sin_cos_turns::<FMA>(turns[l]);
                    products[0][l] = fused::<FMA>(re[l], c, fused::<FMA>(-im[l], s, products[0][l]));
                    products[1][l] = fused::<FMA>(re[l], s, fused::<FMA>(im[l], c, products[1][l]));
                }
            }
        }
        for part in 0..2 {
            total[part] += f64::from(products[part].iter().sum::<f32>());
        }
    }
}

dispatched! {
    /// Adds `Σ_j m_j e^{i2π·cycles_per_metre·length_j}` to `total`: one frequency of Eq. 13, term by term.
    ///
    /// # Panics
    /// When the slices differ in length.
    pub(crate) fn weighted_sum = fused weighted_sum_body(
        cycles_per_metre: f64, lengths: &[f64], samples: [&[f32]; 2], total: &mut [f64; 2],
    )
}

dispatched! {
    /// Adds `Σ_r Σ_n m(n, r) e^{i2π(start + n·step)·length_r}` to the total of each point (real, imaginary): all of Eq. 13
    /// for an even sweep.
    ///
    /// `lengths` are `[points, padded_len]` in m. Cost: 8 operations per term, by Horner's rule that restarts every 64
    /// frequencies; the drift stays near 4·10⁻⁶ of a term.
    ///
    /// # Panics
    /// When the lengths do not match.
    pub(crate) fn weighted_sweep = fused weighted_sweep_body(
        samples: &SweepSamples, lengths: &[f64], steps: Steps, totals: &mut [[f64; 2]],
    )
}

dispatched! {
    /// The range profiles of 16 microphones about one centre: with `z_q = m_q e^{i2π·per_metre_q·length}`, coefficient k
    /// is `(−i)^k Σ_q expansion[q, k] z_q`.
    ///
    /// `lengths` are the centre's path lengths, m; `expansion` is `[Q, K]`, K a multiple of 4. Cost: per tone 40 + 4 K
    /// operations for each microphone. An expansion in powers has such coefficients as well.
    ///
    /// # Panics
    /// When the shapes do not match.
    pub(crate) fn range_profiles = fused range_profiles_body(
        tones: &LaneTones, per_metre: &[f64], lengths: &[f64; LANES], expansion: &[f32],
        profiles: &mut LaneProfiles,
    )
}

dispatched! {
    /// Adds to every point of a block `e^{i2π·carrier·δ} Σ_k g_k T_k(δ/H)` of each microphone, or the same with
    /// powers as [`RangeScale::powers`] says; δ is its path length minus that of the centre.
    ///
    /// `offsets` are the vectors from the microphones to the centre, m, at most 16; `sums` are real and imaginary parts.
    /// Cost: about 65 operations per point and microphone (more where a point's distance from the centre is not small
    /// compared with the microphone's), and 6 K or, with powers, 4 K more.
    ///
    /// # Panics
    /// When the shapes do not match.
    pub(crate) fn back_project = fused back_project_body by [{ points::WIDE }, { range::NARROW }](
        points: &Points, offsets: &[[f32; 3]], profiles: &LaneProfiles, scale: RangeScale,
        sums: [&mut [f32]; 2],
    )
}

#[cfg(test)]
mod tests;
