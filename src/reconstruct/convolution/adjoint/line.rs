//! The same where nodes and voxels lie on a single line: sixteen tones fill the lanes.

use crate::reconstruct::convolution::line::{Line, places};
use crate::reconstruct::convolution::pointwise::{focus, multiply};
use crate::wave::Geometry;
use crate::wave::simd::{LANES, Lanes, lane_phasors, tone_phasors};
use num_complex::Complex32;

impl Line<'_> {
    /// Adds the products of kernels and voxels `[y, x]` of one sublattice of depth `iz` to spectra of tones,
    /// `[tone / 16, part, k]` in lanes of tones.
    pub(in crate::reconstruct::convolution) fn correlate(
        &mut self,
        iz: usize,
        part: usize,
        per_metre: &[f64],
        voxels: &[Complex32],
        spectra: &mut [Lanes],
    ) {
        self.place(iz, part);
        let layout = self.layout;
        let fft = &layout.along(self.axis).fft;
        let n = fft.len();
        let of_part = n * layout.node_parts.len();
        let squares = &self.squares[part * of_part..][..of_part];
        let of_line = || places(&layout.voxel_parts[part], self.axis, layout.grid.x.count);
        let count = of_line().count();
        let width = self.outward.len().max(count);
        for (tones, spectra) in per_metre.chunks(LANES).zip(spectra.chunks_exact_mut(of_part)) {
            let mut k = [0.0; LANES];
            k[..tones.len()].copy_from_slice(tones);
            // The voxels, conjugate, with the outer phase of each tone; transformed back rather than forth.
            self.kernel.fill(Lanes { re: [1.0; LANES], im: [0.0; LANES] });
            if layout.geometry != Geometry::Monostatic {
                lane_phasors(&k, &self.outward, &mut self.kernel[..width]);
            }
            self.transformed.fill(Lanes::ZERO);
            for (to, place) in self.transformed.iter_mut().zip(of_line()) {
                *to = Lanes { re: [voxels[place].re; LANES], im: [-voxels[place].im; LANES] };
            }
            multiply(&self.kernel, &self.transformed, &mut self.products, false);
            fft.transform(&self.products, &mut self.transformed, &mut self.work);
            std::mem::swap(&mut self.products, &mut self.transformed);
            for (squares, spectrum) in squares.chunks_exact(n).zip(spectra.chunks_exact_mut(n)) {
                tone_phasors(&k, squares, self.height, &mut self.kernel);
                fft.transform(&self.kernel, &mut self.transformed, &mut self.work);
                focus(&self.products, &self.transformed, spectrum);
            }
        }
    }
}
