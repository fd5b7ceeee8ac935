//! Products of spectra and of images, sixteen lanes at a time.
//!
//! Real and imaginary parts of the products are exchanged until they are focused: between the two, forward transforms
//! are inverse ones.

#![allow(clippy::inline_always, clippy::needless_range_loop)]

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
fn multiply_body(kernel: &[Lanes], data: &[Lanes], products: &mut [Lanes], add: bool) {
    if add {
        combine(kernel, data, products, |a, b, sum| sum + exchanged(a * b));
    } else {
        combine(kernel, data, products, |a, b, _| exchanged(a * b));
    }
}

dispatched! {
    /// Products of spectra, exchanged, in the place of `products` or added to them.
    pub(super) fn multiply = multiply_body(kernel: &[Lanes], data: &[Lanes], products: &mut [Lanes], add: bool)
}

#[inline(always)]
fn focus_body(exchanged_sum: &[Lanes], outer: &[Lanes], image: &mut [Lanes]) {
    combine(exchanged_sum, outer, image, |a, b, voxel| voxel + exchanged(a) * b);
}

dispatched! {
    /// Adds the sum over microphones, times the outer phase, to the voxels.
    pub(super) fn focus = focus_body(exchanged_sum: &[Lanes], outer: &[Lanes], image: &mut [Lanes])
}
