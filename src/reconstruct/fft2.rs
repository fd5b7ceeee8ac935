//! Padded 2-D FFTs over rustfft, with only the rows that hold or need something.
//!
//! The spectrum is kept transposed, `[k_x, k_y]`, which saves one transposition each way. Transforms carry no
//! scale; the caller divides by [`Fft2::len`] once.

use num_complex::Complex32;
use rustfft::{Fft, FftPlanner};
use std::fmt;
use std::sync::Arc;

/// Plans for one padded size; shared by threads, each with its own [`Scratch`].
#[derive(Clone)]
pub(super) struct Fft2 {
    n_x: usize,
    n_y: usize,
    rows: [Arc<dyn Fft<f32>>; 2],
    columns: [Arc<dyn Fft<f32>>; 2],
}

/// One thread's buffers.
#[derive(Debug, Clone)]
pub(super) struct Scratch {
    plane: Vec<Complex32>,
    fft: Vec<Complex32>,
}

const FORWARD: usize = 0;
const INVERSE: usize = 1;

/// Side of the tiles of a transposition: 16 complex numbers are two cache lines.
const TILE: usize = 16;

impl fmt::Debug for Fft2 {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Fft2({} x {})", self.n_x, self.n_y)
    }
}

impl Fft2 {
    /// Plans transforms of at least the given size, rounded up to one that is fast.
    pub(super) fn at_least(n_x: usize, n_y: usize) -> Self {
        let (n_x, n_y) = (fast_size(n_x), fast_size(n_y));
        let mut planner = FftPlanner::new();
        let mut both = |n| [planner.plan_fft_forward(n), planner.plan_fft_inverse(n)];
        Self { n_x, n_y, rows: both(n_x), columns: both(n_y) }
    }

    /// Padded columns.
    pub(super) fn n_x(&self) -> usize {
        self.n_x
    }

    /// Padded rows.
    pub(super) fn n_y(&self) -> usize {
        self.n_y
    }

    /// `n_x · n_y`: the scale that forward and inverse together leave.
    pub(super) fn len(&self) -> usize {
        self.n_x * self.n_y
    }

    /// Buffers for one thread.
    pub(super) fn scratch(&self) -> Scratch {
        let need = |plan: &Arc<dyn Fft<f32>>| plan.get_inplace_scratch_len();
        let fft = self.rows.iter().chain(&self.columns).map(need).max().unwrap_or(0);
        Scratch { plane: vec![Complex32::ZERO; self.len()], fft: vec![Complex32::ZERO; fft] }
    }

    /// Transforms `plane`, `[rows, n_x]` with the other rows zero, into `spectrum`, `[n_x, n_y]`. Destroys `plane`.
    pub(super) fn forward(&self, plane: &mut [Complex32], spectrum: &mut [Complex32], scratch: &mut Scratch) {
        let rows = plane.len() / self.n_x;
        self.rows[FORWARD].process_with_scratch(plane, &mut scratch.fft);
        transpose(plane, self.n_x, rows, spectrum, self.n_y);
        if rows < self.n_y {
            for column in spectrum.chunks_exact_mut(self.n_y) {
                column[rows..].fill(Complex32::ZERO);
            }
        }
        self.columns[FORWARD].process_with_scratch(spectrum, &mut scratch.fft);
    }

    /// Transforms `spectrum`, `[n_x, n_y]`, back and gives its first `rows` rows, `[rows, n_x]`. Destroys `spectrum`.
    pub(super) fn inverse<'a>(
        &self,
        spectrum: &mut [Complex32],
        rows: usize,
        scratch: &'a mut Scratch,
    ) -> &'a [Complex32] {
        self.columns[INVERSE].process_with_scratch(spectrum, &mut scratch.fft);
        let plane = &mut scratch.plane[..rows * self.n_x];
        transpose_rows(spectrum, self.n_y, self.n_x, plane, rows);
        self.rows[INVERSE].process_with_scratch(plane, &mut scratch.fft);
        plane
    }
}

/// `to[x · stride + y] = from[y · n_x + x]` for y < rows.
fn transpose(from: &[Complex32], n_x: usize, rows: usize, to: &mut [Complex32], stride: usize) {
    for y0 in (0..rows).step_by(TILE) {
        for x0 in (0..n_x).step_by(TILE) {
            for x in x0..(x0 + TILE).min(n_x) {
                for y in y0..(y0 + TILE).min(rows) {
                    to[x * stride + y] = from[y * n_x + x];
                }
            }
        }
    }
}

/// `to[y · n_x + x] = from[x · stride + y]` for y < rows.
fn transpose_rows(from: &[Complex32], stride: usize, n_x: usize, to: &mut [Complex32], rows: usize) {
    for x0 in (0..n_x).step_by(TILE) {
        for y0 in (0..rows).step_by(TILE) {
            for y in y0..(y0 + TILE).min(rows) {
                for x in x0..(x0 + TILE).min(n_x) {
                    to[y * n_x + x] = from[x * stride + y];
                }
            }
        }
    }
}

/// The smallest 2^a 3^b 5^c that is at least n.
fn fast_size(n: usize) -> usize {
    let smooth = |mut m: usize| {
        for factor in [2, 3, 5] {
            while m.is_multiple_of(factor) {
                m /= factor;
            }
        }
        m == 1
    };
    let n = n.max(1);
    (n..=n.next_power_of_two()).find(|m| smooth(*m)).expect("a power of two is among them")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_have_small_factors_only() {
        for (n, expected) in [(1, 1), (7, 8), (71, 72), (77, 80), (127, 128), (513, 540)] {
            assert_eq!(fast_size(n), expected);
        }
    }

    #[test]
    fn a_pruned_round_trip_returns_the_rows() {
        let fft = Fft2::at_least(23, 37);
        let rows = 20;
        let plane: Vec<Complex32> =
            (0..rows * fft.n_x()).map(|i| crate::wave::phasor((i as f64 * 0.377).fract())).collect();
        let mut scratch = fft.scratch();
        let mut spectrum = vec![Complex32::ZERO; fft.len()];
        fft.forward(&mut plane.clone(), &mut spectrum, &mut scratch);
        let back = fft.inverse(&mut spectrum, rows, &mut scratch);
        for (a, b) in plane.iter().zip(back) {
            assert!((a - b / fft.len() as f32).norm() < 1e-5);
        }
    }

    #[test]
    fn the_spectrum_is_the_literal_transform_transposed() {
        let fft = Fft2::at_least(5, 6);
        let mut plane = vec![Complex32::ZERO; 2 * 5];
        (plane[0], plane[7]) = (Complex32::new(1.0, 2.0), Complex32::new(-0.5, 0.25));
        let literal = |k_x: usize, k_y: usize| {
            let turn = |x: usize, y: usize| -((k_x * x) as f64 / 5.0 + (k_y * y) as f64 / 6.0);
            Complex32::new(1.0, 2.0) + Complex32::new(-0.5, 0.25) * crate::wave::phasor(turn(2, 1))
        };
        let mut spectrum = vec![Complex32::ZERO; fft.len()];
        fft.forward(&mut plane, &mut spectrum, &mut fft.scratch());
        for k_x in 0..5 {
            for k_y in 0..6 {
                assert!((spectrum[k_x * 6 + k_y] - literal(k_x, k_y)).norm() < 1e-6);
            }
        }
    }
}
