//! Fused multiply-add: `a·b + c`, rounded once, with the same bits on every processor.

#![allow(clippy::inline_always)]

use num_complex::Complex32;

/// Whether code that is compiled for the target's own instructions has one for it.
pub(crate) const ON_TARGET: bool = cfg!(any(target_feature = "fma", target_arch = "aarch64"));

/// `a·b + c`, by one instruction where there is one.
#[inline(always)]
pub(crate) fn fused<const FMA: bool>(a: f32, b: f32, c: f32) -> f32 {
    if FMA { a.mul_add(b, c) } else { in_double(a, b, c) }
}

/// By f64 arithmetic, in which the product is exact.
///
/// The sum is rounded to odd: of the two f64 that it lies between, the one whose last bit is set. From there to f32 the
/// rounding is that of the exact value, since no f32 and no midpoint of two is odd in f64 (Boldo and Melquiond, 2008).
/// Plain operations throughout, which become vector code, unlike calls of the C library's `fmaf`.
#[inline(always)]
fn in_double(a: f32, b: f32, c: f32) -> f32 {
    let (product, c) = (f64::from(a) * f64::from(b), f64::from(c));
    let sum = product + c;
    // What the sum left out, exactly (Knuth's two-sum). It is NaN where the sum is infinite or NaN, and not used.
    let part = sum - product;
    let rest = (product - (sum - part)) + (c - part);
    let beyond = u64::from(rest * sum < 0.0);
    let inexact = u64::from(rest.abs() > 0.0);
    f64::from_bits((sum.to_bits() - beyond) | inexact) as f32
}

/// `a·b`.
#[inline(always)]
pub(crate) fn product<const FMA: bool>(a: Complex32, b: Complex32) -> Complex32 {
    let (re, im) = (-a.im * b.im, a.im * b.re);
    Complex32::new(fused::<FMA>(a.re, b.re, re), fused::<FMA>(a.re, b.im, im))
}

/// `sum + a·b`.
#[inline(always)]
pub(crate) fn plus_product<const FMA: bool>(sum: Complex32, a: Complex32, b: Complex32) -> Complex32 {
    let (re, im) = (fused::<FMA>(-a.im, b.im, sum.re), fused::<FMA>(a.im, b.re, sum.im));
    Complex32::new(fused::<FMA>(a.re, b.re, re), fused::<FMA>(a.re, b.im, im))
}

/// `sum + a·scale`.
#[inline(always)]
pub(crate) fn plus_scaled<const FMA: bool>(sum: Complex32, a: Complex32, scale: f32) -> Complex32 {
    Complex32::new(fused::<FMA>(a.re, scale, sum.re), fused::<FMA>(a.im, scale, sum.im))
}

/// `Σ_k c_k x^k` by Horner's rule.
#[inline(always)]
pub(crate) fn polynomial<const FMA: bool>(coefficients: &[f32], x: f32) -> f32 {
    let mut powers = coefficients.iter().rev();
    let highest = powers.next().copied().unwrap_or(0.0);
    powers.fold(highest, |sum, c| fused::<FMA>(sum, x, *c))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Numbers of all sizes, with every kind of last bits.
    fn any_number(state: &mut u64) -> f32 {
        *state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        f32::from_bits((*state >> 32) as u32)
    }

    fn check(a: f32, b: f32, c: f32) {
        // The C library's, which is exact by its definition.
        let (expected, found) = (a.mul_add(b, c), in_double(a, b, c));
        assert!(
            expected.to_bits() == found.to_bits() || expected.is_nan() && found.is_nan(),
            "{a:e} {b:e} {c:e}: {found:e}, not {expected:e}"
        );
    }

    #[test]
    fn doubles_give_the_bits_of_one_rounding() {
        let mut state = 1;
        for _ in 0..200_000 {
            let [a, b, c] = [(); 3].map(|()| any_number(&mut state));
            check(a, b, c);
            // Sums of which both terms matter: near cancellation, and at every distance of the smaller.
            let (a, b) =
                (1.0 + (a.to_bits() & 0x7f_ffff) as f32 / 8_388_608.0, b.signum() * (1.0 + a.fract()));
            let scale = 2f32.powi((state >> 40) as i32 % 60 - 30);
            check(a, b, c.signum() * scale * (1.0 + (c.to_bits() & 0x7f_ffff) as f32 / 8_388_608.0));
            check(a, b, -a * b);
        }
    }

    #[test]
    fn halves_of_a_last_digit_and_the_ends_of_the_range_are_rounded_once() {
        let step = f32::EPSILON;
        // 1 + ε/2 plus or minus next to nothing, which f64 cannot hold: rounding twice would lose it.
        for tiny in [1e-30f32, -1e-30, f32::MIN_POSITIVE, f32::from_bits(1), 0.0, -0.0] {
            for half in [0.5 * step, 1.5 * step] {
                for sign in [1.0, -1.0] {
                    check(sign * (1.0 + step), half / (1.0 + step), sign + sign * tiny);
                    check(tiny, sign, 1.0 + half);
                    check(half, sign * 1.0, tiny);
                    check(1.0 + step, sign * (1.0 - step), tiny);
                }
            }
        }
        let ends = [0.0, -0.0, f32::MAX, f32::MIN, f32::INFINITY, f32::NEG_INFINITY, f32::NAN];
        let ends =
            [&ends[..], &[f32::MIN_POSITIVE, f32::from_bits(1), -f32::from_bits(3), 1.0, 0.5]].concat();
        for a in &ends {
            for b in &ends {
                for c in &ends {
                    check(*a, *b, *c);
                }
            }
        }
        // 1·1 + 2^-24 is a midpoint; with a product slightly above or below, it is not.
        assert_eq!(in_double(1.0 + step, 2f32.powi(-24), 1.0).to_bits(), (1.0 + step).to_bits());
        assert_eq!(in_double(1.0 - step, 2f32.powi(-24), 1.0).to_bits(), 1f32.to_bits());
    }

    #[test]
    fn products_and_polynomials_are_the_literal_ones() {
        let (a, b, sum) = (Complex32::new(0.3, -0.7), Complex32::new(1.1, 0.4), Complex32::new(-2.0, 0.9));
        let (one, more) = (product::<false>(a, b), plus_product::<false>(sum, a, b));
        assert!((one - a * b).norm() < 1e-7 && (more - sum - a * b).norm() < 3e-7);
        assert_eq!((one, more), (product::<true>(a, b), plus_product::<true>(sum, a, b)));
        assert_eq!(polynomial::<false>(&[2.0, 3.0, 5.0], 2.0), 28.0);
        assert_eq!(polynomial::<true>(&[], 2.0), 0.0);
    }
}
