//! Products of spectra and of images, sixteen lanes at a time.
//!
//! Real and imaginary parts of the products are exchanged until they are focused: between the two, forward transforms
//! are inverse ones.

#![allow(clippy::inline_always, clippy::needless_range_loop)]

use crate::wave::simd::fused::{plus_product, product};
use crate::wave::simd::{LANES, Lanes, ROWS, dispatched};
use num_complex::Complex32;

/// Combines numbers of `a`, `b` and `to` into new ones of `to`.
#[inline(always)]
fn combine(
    a: &[Lanes],
    b: &[Lanes],
    to: &mut [Lanes],
    with: impl Fn(Complex32, Complex32, Complex32) -> Complex32,
) {
    let (a, b, to) = (a.as_chunks::<ROWS>().0, b.as_chunks::<ROWS>().0, to.as_chunks_mut::<ROWS>().0);
    for ((a, b), to) in a.iter().zip(b).zip(to) {
        for l in 0..LANES {
            for row in 0..ROWS {
                let z = with(a[row].at(l), b[row].at(l), to[row].at(l));
                (to[row].re[l], to[row].im[l]) = (z.re, z.im);
            }
        }
    }
}

/// Exchanges real and imaginary part.
#[inline(always)]
fn exchanged(z: Complex32) -> Complex32 {
    Complex32::new(z.im, z.re)
}

#[inline(always)]
fn multiply_body<const FMA: bool>(kernel: &[Lanes], data: &[Lanes], products: &mut [Lanes], add: bool) {
    if add {
        combine(kernel, data, products, |a, b, sum| exchanged(plus_product::<FMA>(exchanged(sum), a, b)));
    } else {
        combine(kernel, data, products, |a, b, _| exchanged(product::<FMA>(a, b)));
    }
}

dispatched! {
    /// Products of spectra, exchanged, in the place of `products` or added to them.
    pub(crate) fn multiply = fused multiply_body(kernel: &[Lanes], data: &[Lanes], products: &mut [Lanes], add: bool)
}

#[inline(always)]
fn focus_body<const FMA: bool>(exchanged_sum: &[Lanes], outer: &[Lanes], image: &mut [Lanes]) {
    combine(exchanged_sum, outer, image, |a, b, voxel| plus_product::<FMA>(voxel, exchanged(a), b));
}

dispatched! {
    /// Adds the sum over microphones, times the outer phase, to the voxels.
    pub(crate) fn focus = fused focus_body(exchanged_sum: &[Lanes], outer: &[Lanes], image: &mut [Lanes])
}

#[inline(always)]
fn sums_body<const FMA: bool>(exchanged_sum: &[Lanes], outer: &[Lanes], sums: &mut [Complex32]) {
    let (rows, sums) = (exchanged_sum.as_chunks::<ROWS>().0, sums.as_chunks_mut::<ROWS>().0);
    for ((a, b), sums) in rows.iter().zip(outer.as_chunks::<ROWS>().0).zip(sums) {
        let mut image = [Lanes::ZERO; ROWS];
        combine(a, b, &mut image, |a, b, _| product::<FMA>(exchanged(a), b));
        for row in 0..ROWS {
            sums[row] = Complex32::new(sum(&image[row].re), sum(&image[row].im));
        }
    }
}

/// Halves are added to halves: one lane after another would wait for each addition.
#[inline(always)]
fn sum(lanes: &[f32; LANES]) -> f32 {
    let (mut eight, mut four) = ([0.0; 8], [0.0; 4]);
    for l in 0..8 {
        eight[l] = lanes[l] + lanes[l + 8];
    }
    for l in 0..4 {
        four[l] = eight[l] + eight[l + 4];
    }
    (four[0] + four[2]) + (four[1] + four[3])
}

dispatched! {
    /// The sums over microphones, times the outer phases, of all lanes together.
    pub(crate) fn sums = fused sums_body(exchanged_sum: &[Lanes], outer: &[Lanes], sums: &mut [Complex32])
}

#[cfg(test)]
mod tests {
    use super::*;

    fn numbers(k: f64) -> Vec<Lanes> {
        let value = |i: usize| (i as f64 * k).fract() as f32 - 0.5;
        let lanes = |i: usize| std::array::from_fn(|l| value(i * LANES + l));
        (0..2 * ROWS).map(|i| Lanes { re: lanes(i), im: lanes(i + 99) }).collect()
    }

    #[test]
    fn products_are_the_literal_ones_and_the_same_bytes_for_every_instruction_set() {
        let (a, b, sum) = (numbers(0.618_034), numbers(0.754_878), numbers(0.569_84));
        for add in [false, true] {
            let (mut products, mut plain) = (sum.clone(), sum.clone());
            multiply(&a, &b, &mut products, add);
            multiply_body::<false>(&a, &b, &mut plain, add);
            assert_eq!(products, plain);
            for (i, product) in products.iter().enumerate() {
                for l in 0..LANES {
                    let before = if add { sum[i].at(l) } else { Complex32::ZERO };
                    let expected = before + exchanged(a[i].at(l) * b[i].at(l));
                    assert!((product.at(l) - expected).norm() < 1e-7, "{} for {expected}", product.at(l));
                }
            }
        }
        let (mut image, mut plain) = (sum.clone(), sum.clone());
        focus(&a, &b, &mut image);
        focus_body::<false>(&a, &b, &mut plain);
        assert_eq!(image, plain);
        for (i, voxel) in image.iter().enumerate() {
            let expected = sum[i].at(3) + exchanged(a[i].at(3)) * b[i].at(3);
            assert!((voxel.at(3) - expected).norm() < 1e-7, "{} for {expected}", voxel.at(3));
        }
        let (mut of_lanes, mut plain) = ([Complex32::ZERO; 2 * ROWS], [Complex32::ZERO; 2 * ROWS]);
        sums(&a, &b, &mut of_lanes);
        sums_body::<false>(&a, &b, &mut plain);
        assert_eq!(of_lanes, plain);
        for (i, of_lanes) in of_lanes.iter().enumerate() {
            let expected: Complex32 = (0..LANES).map(|l| exchanged(a[i].at(l)) * b[i].at(l)).sum();
            assert!((of_lanes - expected).norm() < 1e-5, "{of_lanes} for {expected}");
        }
    }
}
