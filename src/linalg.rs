//! Linear algebra: least squares, a pivoted factorisation and products, over faer.
//!
//! Only this module uses faer. Its kernels leave the upper halves of vector registers filled, which slows down later code
//! for SSE tenfold; every function here clears them before it returns, so that no caller has to.

mod exponentials;

pub(crate) use exponentials::{even_waves, max_modulus, waves};

use crate::wave::simd::leave_wide_registers;
use faer::linalg::matmul::matmul;
use faer::linalg::triangular_solve::solve_upper_triangular_in_place;
use faer::{Accum, Mat, MatMut, MatRef, Par};
use num_complex::Complex32;
use rayon::prelude::*;

/// A dense real matrix, by columns.
pub(crate) type Matrix = Mat<f64>;

/// `a · b`.
pub(crate) fn product(a: &Matrix, b: &Matrix) -> Matrix {
    let product = a * b;
    leave_wide_registers();
    product
}

/// The columns of a matrix in the order of pivoting, and the norm of what is left of each at that step.
pub(crate) struct PivotedQr {
    /// Indices of columns.
    pub(crate) order: Vec<usize>,
    /// |R[k, k]|, as many as rows or as columns, whichever are fewer.
    pub(crate) diagonal: Vec<f64>,
}

/// Factorises a matrix with column pivoting.
pub(crate) fn pivoted_qr(matrix: &Matrix) -> PivotedQr {
    let factored = matrix.col_piv_qr();
    leave_wide_registers();
    let r = factored.thin_R();
    let ranks = r.nrows().min(r.ncols());
    PivotedQr {
        order: factored.P().arrays().0.to_vec(),
        diagonal: (0..ranks).map(|k| r[(k, k)].abs()).collect(),
    }
}

/// Least squares in the columns of one matrix, factored once.
#[derive(Debug, Clone)]
pub(crate) struct LeastSquares {
    q: Matrix,
    r: Matrix,
}

impl LeastSquares {
    /// Prepares least squares in the columns of `basis`, which are independent.
    pub(crate) fn new(basis: &Matrix) -> Self {
        // By an explicit Q: for many right-hand sides a product is far cheaper than as many reflections.
        let qr = basis.qr();
        let (q, r) = (qr.compute_thin_Q(), qr.thin_R().to_owned());
        leave_wide_registers();
        Self { q, r }
    }

    /// Prepares weights that stay small where columns are nearly dependent: their squares, times `damping`², are minimised
    /// together with those of the residual, to which this adds at most `damping` times the norm of the weights.
    pub(crate) fn damped(basis: &Matrix, damping: f64) -> Self {
        let (rows, columns) = basis.shape();
        let damped = Matrix::from_fn(rows + columns, columns, |k, a| match k.checked_sub(rows) {
            None => basis[(k, a)],
            Some(below) if below == a => damping,
            Some(_) => 0.0,
        });
        let Self { q, r } = Self::new(&damped);
        Self { q: q.subrows(0, rows).to_owned(), r }
    }

    /// An orthonormal basis of the same columns.
    pub(crate) fn orthonormal(&self) -> &Matrix {
        &self.q
    }

    /// The weights, `[columns of the basis, columns]`, for which `basis · weights` is nearest to `columns`.
    pub(crate) fn solve(&self, columns: &Matrix) -> Matrix {
        let mut weights = self.q.transpose() * columns;
        solve_upper_triangular_in_place(self.r.as_ref(), weights.as_mut(), Par::Seq);
        leave_wide_registers();
        weights
    }
}

/// `product = a · b` in f32, all by columns: `a` is `[rows, inner]`, `b` `[inner, columns]`.
///
/// # Panics
/// When a slice is not as long as its shape says.
pub(crate) fn product_f32(product: &mut [f32], a: &[f32], b: &[f32], [rows, inner, columns]: [usize; 3]) {
    matmul(
        MatMut::from_column_major_slice_mut(product, rows, columns),
        Accum::Replace,
        MatRef::from_column_major_slice(a, rows, inner),
        MatRef::from_column_major_slice(b, inner, columns),
        1.0,
        Par::Seq,
    );
    leave_wide_registers();
}

/// Columns of a complex product that one thread processes at a time: minimum and maximum.
const BLOCK: [usize; 2] = [64, 1024];

/// `rows += W · samples`, both in rows of `width`; `weight` gives `W[row, sample]`.
///
/// # Panics
/// When the length of a slice is not a whole number of rows.
pub(crate) fn add_product_of_rows(
    weight: impl Fn(usize, usize) -> Complex32,
    samples: &[Complex32],
    width: usize,
    rows: &mut [Complex32],
) {
    let weights = Mat::from_fn(rows.len() / width, samples.len() / width, weight);
    let samples = MatRef::from_row_major_slice(samples, samples.len() / width, width);
    // A few blocks for each thread, but no small ones.
    let columns = (width / 8).next_multiple_of(BLOCK[0]).clamp(BLOCK[0], BLOCK[1]);
    let mut blocks = Vec::with_capacity(width.div_ceil(columns));
    let mut rest = MatMut::from_row_major_slice_mut(rows, rows.len() / width, width);
    while rest.ncols() > columns {
        let (block, others) = rest.split_at_col_mut(columns);
        blocks.push(block);
        rest = others;
    }
    blocks.push(rest);
    blocks.into_par_iter().enumerate().for_each(|(index, block)| {
        let samples = samples.subcols(index * columns, block.ncols());
        matmul(block, Accum::Add, weights.as_ref(), samples, Complex32::ONE, Par::Seq);
        leave_wide_registers();
    });
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::PI;

    #[test]
    fn products_of_rows_and_of_columns_are_the_plain_sums() {
        let value = |i: usize, k: f32| Complex32::new((i as f32 * k).fract() - 0.5, (i as f32 * 0.3).fract());
        for (rows, inner, width) in [(1, 1, 1), (3, 5, 70), (7, 4, 1300)] {
            let samples: Vec<_> = (0..inner * width).map(|i| value(i, 0.618)).collect();
            let weight = |q: usize, k: usize| value(q * inner + k, 0.755);
            let mut sums = vec![Complex32::ONE; rows * width];
            add_product_of_rows(weight, &samples, width, &mut sums);
            for (i, sum) in sums.iter().enumerate() {
                let plain: Complex32 =
                    (0..inner).map(|k| weight(i / width, k) * samples[k * width + i % width]).sum();
                assert!((sum - plain - Complex32::ONE).norm() < 1e-5, "{rows} {inner} {width}: {i}");
            }
        }
        let mut product = [0.0; 4];
        product_f32(&mut product, &[1.0, 2.0, 3.0, 4.0], &[5.0, 6.0, 7.0, 8.0], [2, 2, 2]);
        assert_eq!(product, [23.0, 34.0, 31.0, 46.0]);
    }

    #[test]
    fn pivoting_takes_the_longest_column_first_and_finds_the_rank() {
        // The third column is the sum of the others.
        let columns = [[1.0, 0.0, 0.0], [0.0, 3.0, 0.0], [1.0, 3.0, 0.0]];
        let qr = pivoted_qr(&Matrix::from_fn(3, 3, |k, j| columns[j][k]));
        assert_eq!(qr.order[0], 2);
        assert!((qr.diagonal[0] - 10f64.sqrt()).abs() < 1e-12 && qr.diagonal[2] < 1e-12, "{:?}", qr.diagonal);
    }

    #[test]
    fn damped_weights_are_small_where_columns_are_nearly_the_same() {
        let delays: Vec<f64> = (0..12).map(|k| f64::from(k) / 24.0).collect();
        let right = waves(&delays, &[0.9]);
        for spacing in [0.4, 1e-3, 1e-7, 0.0] {
            let basis = waves(&delays, &[1.0 - spacing, 1.0, 1.0 + spacing]);
            let weights = LeastSquares::damped(&basis, 1e-9).solve(&right);
            assert!((0..3).all(|a| weights[(a, 0)].abs() < 1e7), "{weights:?}");
            let left = max_modulus(&(product(&basis, &weights) - &right));
            let plain = PI * 0.1;
            assert!(left < if spacing > 0.1 { 0.05 } else { plain }, "{spacing}: {left}");
            if spacing > 1e-4 {
                let exact = LeastSquares::new(&basis).solve(&right);
                assert!(max_modulus(&product(&basis, &(&weights - &exact))) < 1e-6);
            }
        }
    }
}
