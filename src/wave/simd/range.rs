//! The bodies of back-projection's kernels: range profiles about a block's centre, and their sum over its points.
//!
//! About the centre c of a block, one microphone's share of Eq. 13 is `e^{−i2πf_c·δ/c} · Σ_k g_k T_k(δ/H)` with δ the
//! path length minus that of the centre, f_c the middle of the band, T_k Chebyshev's polynomials, and H the half-width
//! of the block's delays. No sample of a profile is looked up, so no gather instructions are needed.

use super::fused::{fused, polynomial};
use super::points::Points;
use super::{LANES, sin_cos_turns, wrap_fast, wrap_few};
use std::array;

/// Coefficients that [`range_profiles_body`] sums at a time, in registers.
const COLUMNS: usize = 4;

/// Tones that are rotated at a time.
const TONES: usize = 32;

/// Points at a time without AVX-512. A recurrence takes their real and imaginary parts in turn, so that all is in registers.
pub(super) const NARROW: usize = 32;

/// Up to this |q|, [`SHORT_RISE`] is used.
const SMALL: f32 = 0.25;

/// `(√(1 + q) − 1)/q` for |q| ≤ ¼, by powers of q: Chebyshev's interpolation, error 2·10⁻⁸.
const SHORT_RISE: [f32; 7] =
    [0.5, -0.125_000_38, 0.062_500_74, -0.039_014_136, 0.027_285_57, -0.022_025_92, 0.017_570_542];

/// Tones of 16 microphones, `[Q, 16]`.
#[derive(Debug, Clone, Default)]
pub(crate) struct LaneTones {
    /// Real parts.
    pub(crate) re: Vec<[f32; LANES]>,
    /// Imaginary parts.
    pub(crate) im: Vec<[f32; LANES]>,
}

/// Range profiles of 16 microphones about one centre, as coefficients of T_k, `[K, 16]`.
#[derive(Debug, Clone, Default)]
pub(crate) struct LaneProfiles {
    /// Real parts.
    pub(crate) re: Vec<[f32; LANES]>,
    /// Imaginary parts.
    pub(crate) im: Vec<[f32; LANES]>,
}

#[inline(always)]
pub(super) fn range_profiles_body<const FMA: bool>(
    tones: &LaneTones,
    per_metre: &[f64],
    lengths: &[f64; LANES],
    expansion: &[f32],
    profiles: &mut LaneProfiles,
) {
    let count = profiles.re.len();
    assert!(tones.re.len() == per_metre.len() && tones.im.len() == per_metre.len(), "one row per tone");
    assert!(profiles.im.len() == count && count.is_multiple_of(COLUMNS), "coefficients in whole groups");
    assert!(expansion.len() == per_metre.len() * count, "one coefficient per tone and polynomial");
    let LaneProfiles { re: profile_re, im: profile_im } = profiles;
    profile_re.fill([0.0; LANES]);
    profile_im.fill([0.0; LANES]);
    // Tones are rotated to the centre in blocks that stay in the first-level cache.
    let (mut turned_re, mut turned_im) = ([[0.0f32; LANES]; TONES], [[0.0f32; LANES]; TONES]);
    for (((re, im), per_metre), expansion) in tones
        .re
        .chunks(TONES)
        .zip(tones.im.chunks(TONES))
        .zip(per_metre.chunks(TONES))
        .zip(expansion.chunks(TONES * count.max(1)))
    {
        for (q, per_metre) in per_metre.iter().enumerate() {
            let mut turns = [0.0f32; LANES];
            for l in 0..LANES {
                turns[l] = wrap_fast(lengths[l] * per_metre);
            }
            for l in 0..LANES {
                let (s, c) = sin_cos_turns::<FMA>(turns[l]);
                turned_re[q][l] = fused::<FMA>(re[q][l], c, -im[q][l] * s);
                turned_im[q][l] = fused::<FMA>(re[q][l], s, im[q][l] * c);
            }
        }
        let (turned_re, turned_im) = (&turned_re[..per_metre.len()], &turned_im[..per_metre.len()]);
        add_products::<FMA>(turned_re, expansion, profile_re);
        add_products::<FMA>(turned_im, expansion, profile_im);
    }
    // The factor (−i)^k that T_k has in the expansion of a tone.
    for (k, (re, im)) in profile_re.iter_mut().zip(profile_im).enumerate() {
        if k % 2 == 1 {
            std::mem::swap(re, im);
        }
        if k % 4 > 1 {
            negate(re);
        }
        if matches!(k % 4, 1 | 2) {
            negate(im);
        }
    }
}

#[inline(always)]
fn negate(lanes: &mut [f32; LANES]) {
    for value in lanes {
        *value = -*value;
    }
}

/// Adds `Σ_q expansion[q, k] turned[q]` to every coefficient k.
#[inline(always)]
fn add_products<const FMA: bool>(turned: &[[f32; LANES]], expansion: &[f32], profile: &mut [[f32; LANES]]) {
    let count = profile.len();
    for (first, profile) in profile.chunks_exact_mut(COLUMNS).enumerate() {
        // One array for each column: the compiler treats an array of them as a matrix, and scatters it.
        let mut sums = ([0.0f32; LANES], [0.0f32; LANES], [0.0f32; LANES], [0.0f32; LANES]);
        for (turned, row) in turned.iter().zip(expansion.chunks_exact(count)) {
            let row = &row[first * COLUMNS..][..COLUMNS];
            for (l, turned) in turned.iter().enumerate() {
                sums.0[l] = fused::<FMA>(*turned, row[0], sums.0[l]);
                sums.1[l] = fused::<FMA>(*turned, row[1], sums.1[l]);
                sums.2[l] = fused::<FMA>(*turned, row[2], sums.2[l]);
                sums.3[l] = fused::<FMA>(*turned, row[3], sums.3[l]);
            }
        }
        for (profile, sums) in profile.iter_mut().zip([sums.0, sums.1, sums.2, sums.3]) {
            for l in 0..LANES {
                profile[l] += sums[l];
            }
        }
    }
}

/// Converts the difference of path lengths into a phase and a position on the profile.
#[derive(Debug, Clone, Copy)]
pub(crate) struct RangeScale {
    /// Number of times that the path contains the leg to the microphone.
    pub(crate) legs: f32,
    /// f_c/c with the sign of the inverse, −1/m.
    pub(crate) carrier: f32,
    /// 1/H, 1/m.
    pub(crate) inverse_half: f32,
    /// Number of coefficients in use, even; the rest are zero.
    pub(crate) terms: usize,
    /// Whether the coefficients are those of powers instead of Chebyshev's polynomials: of `T_2(t)^j` those of even number,
    /// of `t T_2(t)^j` those of odd.
    pub(crate) powers: bool,
}

#[inline(always)]
pub(super) fn back_project_body<const FMA: bool, const W: usize>(
    points: &Points,
    offsets: &[[f32; 3]],
    profiles: &LaneProfiles,
    scale: RangeScale,
    sums: [&mut [f32]; 2],
) {
    let [sums_re, sums_im] = sums;
    assert!(offsets.len() <= LANES, "a lane per microphone");
    assert!(scale.terms >= 2 && scale.terms.is_multiple_of(2), "coefficients in pairs");
    let (profile_re, profile_im) = (&profiles.re[..scale.terms], &profiles.im[..scale.terms]);
    assert!(sums_re.len() == points.padded_len() && sums_im.len() == points.padded_len(), "a sum per point");
    // Padding is left out where it fills whole chunks.
    let used = points.count.next_multiple_of(W);
    for (lane, [x_c, y_c, z_c]) in offsets.iter().enumerate() {
        let centre = (x_c * x_c + y_c * y_c + z_c * z_c).sqrt();
        // Where the centre is the microphone, 0/0 must become 0.
        let centre = centre + f32::MIN_POSITIVE;
        let twice = [x_c, y_c, z_c].map(|offset| 2.0 * scale.legs * offset);
        let aside = points.radius / centre;
        let near = 2.0 * aside + aside * aside <= SMALL;
        let (inverse, per_square) = (1.0 / centre, 1.0 / (scale.legs * centre * centre));
        let chunks = points.x[..used].as_chunks::<W>().0.iter();
        let chunks = chunks.zip(points.y.as_chunks::<W>().0).zip(points.z.as_chunks::<W>().0);
        let chunks = chunks.zip(points.square.as_chunks::<W>().0);
        let chunks = chunks.zip(points.outward.as_chunks::<W>().0);
        let chunks = chunks.zip(sums_re.as_chunks_mut::<W>().0).zip(sums_im.as_chunks_mut::<W>().0);
        for ((((((x, y), z), square), outward), sum_re), sum_im) in chunks {
            let (mut place, mut turns) = ([0.0f32; W], [0.0f32; W]);
            let mut enter = |l: usize, longer: f32| {
                place[l] = longer * scale.inverse_half;
                turns[l] = wrap_few(longer * scale.carrier);
            };
            // |p − r| − |c − r| without cancellation, from |p − r|² − |c − r|².
            let rise = |l: usize| {
                let over = fused::<FMA>(z[l], twice[2], square[l]);
                fused::<FMA>(x[l], twice[0], fused::<FMA>(y[l], twice[1], over))
            };
            if near {
                for l in 0..W {
                    let rise = rise(l);
                    let short = polynomial::<FMA>(&SHORT_RISE, rise * per_square);
                    enter(l, fused::<FMA>(rise * inverse, short, outward[l]));
                }
            } else {
                for l in 0..W {
                    let (px, py, pz) = (x[l] + x_c, y[l] + y_c, z[l] + z_c);
                    let length = fused::<FMA>(px, px, fused::<FMA>(py, py, pz * pz)).sqrt();
                    enter(l, outward[l] + rise(l) / (length + centre));
                }
            }
            let mut value = [[0.0f32; W]; 2];
            if scale.powers && W > NARROW {
                sum_of_powers::<FMA, W, { 2 * LANES }>(&place, [profile_re, profile_im], lane, &mut value);
            } else if scale.powers {
                sum_of_powers::<FMA, W, LANES>(&place, [profile_re, profile_im], lane, &mut value);
            } else if W > NARROW {
                clenshaw::<FMA, W, 2>(&place, [profile_re, profile_im], lane, &mut value);
            } else {
                let [re, im] = &mut value;
                clenshaw::<FMA, W, 1>(&place, [profile_re], lane, array::from_mut(re));
                clenshaw::<FMA, W, 1>(&place, [profile_im], lane, array::from_mut(im));
            }
            for l in 0..W {
                let (s, c) = sin_cos_turns::<FMA>(turns[l]);
                sum_re[l] = fused::<FMA>(value[0][l], c, fused::<FMA>(-value[1][l], s, sum_re[l]));
                sum_im[l] = fused::<FMA>(value[0][l], s, fused::<FMA>(value[1][l], c, sum_im[l]));
            }
        }
    }
}

/// `Σ_j (g_2j + g_{2j+1} t) T_2(t)^j`, N places at a time: as many as two vectors hold, so that with both parts and parities
/// eight chains of additions are in registers.
#[inline(always)]
fn sum_of_powers<const FMA: bool, const W: usize, const N: usize>(
    place: &[f32; W],
    [profile_re, profile_im]: [&[[f32; LANES]]; 2],
    lane: usize,
    [value_re, value_im]: &mut [[f32; W]; 2],
) {
    let values = value_re.as_chunks_mut::<N>().0.iter_mut().zip(value_im.as_chunks_mut::<N>().0);
    for (place, (value_re, value_im)) in place.as_chunks::<N>().0.iter().zip(values) {
        let (mut double, mut even, mut odd) = ([0.0f32; N], [[0.0f32; N]; 2], [[0.0f32; N]; 2]);
        for l in 0..N {
            double[l] = fused::<FMA>(2.0 * place[l], place[l], -1.0);
        }
        for k in (0..profile_re.len()).step_by(2).rev() {
            for (part, profile) in [profile_re, profile_im].into_iter().enumerate() {
                let (low, high) = (profile[k][lane], profile[k + 1][lane]);
                for l in 0..N {
                    even[part][l] = fused::<FMA>(even[part][l], double[l], low);
                }
                for l in 0..N {
                    odd[part][l] = fused::<FMA>(odd[part][l], double[l], high);
                }
            }
        }
        for l in 0..N {
            value_re[l] = fused::<FMA>(odd[0][l], place[l], even[0][l]);
            value_im[l] = fused::<FMA>(odd[1][l], place[l], even[1][l]);
        }
    }
}

/// `Σ_k g_k T_k(t)` of N parts by Clenshaw's recurrence, two steps at a time so that no value has to be copied.
#[inline(always)]
fn clenshaw<const FMA: bool, const W: usize, const N: usize>(
    place: &[f32; W],
    profile: [&[[f32; LANES]]; N],
    lane: usize,
    value: &mut [[f32; W]; N],
) {
    let (mut twice, mut above) = ([0.0f32; W], [[0.0f32; W]; N]);
    for l in 0..W {
        twice[l] = 2.0 * place[l];
    }
    for k in (2..profile[0].len()).step_by(2).rev() {
        for part in 0..N {
            let (high, low) = (profile[part][k + 1][lane], profile[part][k][lane]);
            for l in 0..W {
                above[part][l] = fused::<FMA>(twice[l], value[part][l], high - above[part][l]);
            }
            for l in 0..W {
                value[part][l] = fused::<FMA>(twice[l], above[part][l], low - value[part][l]);
            }
        }
    }
    for part in 0..N {
        let (high, low) = (profile[part][1][lane], profile[part][0][lane]);
        for l in 0..W {
            above[part][l] = fused::<FMA>(twice[l], value[part][l], high - above[part][l]);
            value[part][l] = fused::<FMA>(place[l], above[part][l], low - value[part][l]);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::wave::Geometry;
    use crate::wave::phasor;
    use crate::wave::simd::points::WIDE;
    use crate::wave::simd::{back_project, range_profiles};
    use glam::DVec3;
    use num_complex::Complex64;

    fn fraction(i: usize, k: f64) -> f64 {
        (i as f64 * k).fract()
    }

    fn lanes(seed: usize) -> [f32; LANES] {
        array::from_fn(|l| fraction(seed * LANES + l, 0.618_033_99) as f32 - 0.5)
    }

    fn profiles(count: usize) -> LaneProfiles {
        LaneProfiles { re: (0..count).map(lanes).collect(), im: (50..50 + count).map(lanes).collect() }
    }

    #[test]
    fn profiles_are_the_literal_sums_in_every_instruction_set() {
        for (q, count) in [(1, 4), (32, 8), (75, 12)] {
            let tones = LaneTones { re: (0..q).map(lanes).collect(), im: (90..90 + q).map(lanes).collect() };
            let per_metre: Vec<f64> = (0..q).map(|i| -29.0 - 0.7 * i as f64).collect();
            let lengths: [f64; LANES] = array::from_fn(|l| 2.0 + fraction(l, 0.754_877_67));
            let expansion: Vec<f32> =
                (0..q * count).map(|i| fraction(i, 0.569_840_29) as f32 - 0.5).collect();
            let (mut got, mut plain) = (profiles(count), profiles(count));
            range_profiles(&tones, &per_metre, &lengths, &expansion, &mut got);
            range_profiles_body::<false>(&tones, &per_metre, &lengths, &expansion, &mut plain);
            assert!(got.re == plain.re && got.im == plain.im, "bit-identical results");
            for (l, length) in lengths.iter().enumerate() {
                for k in 0..count {
                    let sum: Complex64 = (0..q)
                        .map(|i| {
                            let turned = phasor(per_metre[i] * length);
                            Complex64::new(tones.re[i][l].into(), tones.im[i][l].into())
                                * Complex64::new(turned.re.into(), turned.im.into())
                                * f64::from(expansion[i * count + k])
                        })
                        .sum();
                    let expected = sum * (-Complex64::I).powu(k as u32);
                    let got = Complex64::new(got.re[k][l].into(), got.im[k][l].into());
                    assert!((got - expected).norm() < 2e-6, "{q} tones, {k}, {l}: {got} for {expected}");
                }
            }
        }
    }

    #[test]
    fn points_get_the_literal_sum_in_every_instruction_set() {
        let place =
            |i: usize| [0.618_033_99, 0.754_877_67, 0.569_840_29].map(|k| 0.1 * (fraction(i, k) - 0.5));
        let (centre, source) = (DVec3::new(0.2, -0.1, 0.9), DVec3::new(0.5, 0.3, -0.2));
        // The last microphone is at the centre, and so is the first point.
        let offsets = [[0.3f32, -0.2, 1.4], [0.01, 0.02, 0.0], [0.0, 0.0, 0.0]];
        let fixed = Geometry::FixedSource { source };
        for (count, terms, powers, geometry) in
            [(1, 2, true, fixed), (64, 8, false, fixed), (100, 10, true, Geometry::Monostatic)]
        {
            let legs = geometry.return_legs();
            let along = |axis: usize| (0..count).map(|i| centre[axis] + place(i)[axis]).collect::<Vec<f64>>();
            let points = Points::about(centre.to_array(), &geometry, [&along(0), &along(1), &along(2)]);
            let farthest = (0..count).map(|i| DVec3::from(place(i)).length()).fold(0.0, f64::max);
            assert!((f64::from(points.radius()) - farthest).abs() < 1e-8);
            let scale = RangeScale { legs: legs as f32, carrier: -43.7, inverse_half: 5.0, terms, powers };
            let profiles = profiles(12);
            let sums = || vec![0.0f32; points.padded_len()];
            let (mut re, mut im) = (sums(), sums());
            back_project(&points, &offsets, &profiles, scale, [&mut re, &mut im]);
            for wide in [false, true] {
                let (mut plain_re, mut plain_im) = (sums(), sums());
                let plain = [&mut plain_re[..], &mut plain_im[..]];
                if wide {
                    back_project_body::<false, WIDE>(&points, &offsets, &profiles, scale, plain);
                } else {
                    back_project_body::<false, NARROW>(&points, &offsets, &profiles, scale, plain);
                }
                let alike = |a: &[f32], b: &[f32]| a[..count] == b[..count];
                assert!(alike(&re, &plain_re) && alike(&im, &plain_im), "bit-identical results");
            }
            for i in 0..count {
                let [x, y, z] = place(i);
                let outward = match geometry {
                    Geometry::FixedSource { .. } => {
                        (centre + DVec3::new(x, y, z)).distance(source) - centre.distance(source)
                    }
                    Geometry::Monostatic | Geometry::Pair { .. } => 0.0,
                };
                let mut expected = Complex64::ZERO;
                for (l, offset) in offsets.iter().enumerate() {
                    let [a, b, c] = offset.map(f64::from);
                    let length = |x: f64, y: f64, z: f64| (x * x + y * y + z * z).sqrt();
                    let longer = outward + legs * (length(x + a, y + b, z + c) - length(a, b, c));
                    let t = longer * 5.0;
                    let value: Complex64 = (0..terms)
                        .map(|k| {
                            let basis = if powers {
                                t.powi(k as i32 % 2) * (2.0 * t * t - 1.0).powi(k as i32 / 2)
                            } else {
                                (k as f64 * t.acos()).cos()
                            };
                            Complex64::new(profiles.re[k][l].into(), profiles.im[k][l].into()) * basis
                        })
                        .sum();
                    expected += value * Complex64::cis(std::f64::consts::TAU * -43.7 * longer);
                }
                let got = Complex64::new(re[i].into(), im[i].into());
                assert!((got - expected).norm() < 2e-5, "{count} points, {i}: {got} for {expected}");
            }
        }
    }
}
