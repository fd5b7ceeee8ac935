//! The same where nodes and voxels lie on a single line: sixteen tones fill the lanes.

use crate::reconstruct::convolution::line::{Line, places};
use crate::reconstruct::convolution::pointwise::{focus, multiply};
use crate::wave::simd::{LANES, Lanes, lane_phasors};
use num_complex::Complex32;

impl Line<'_> {
    /// Adds the products of kernels and voxels `[y, x]` of one sublattice of depth `iz` to spectra of tones,
    /// `[tone / 16, transmission, part, k]` in lanes of tones.
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
        let squares = part * of_part..(part + 1) * of_part;
        let of_block = of_part * layout.transmissions();
        let axis = self.axis;
        let of_line = || places(&layout.voxel_parts[part], axis, layout.grid().x.count);
        let count = of_line().count();
        let width = (self.outward.len() / layout.transmissions()).max(count);
        for (tones, spectra) in per_metre.chunks(LANES).zip(spectra.chunks_exact_mut(of_block)) {
            let mut k = [0.0; LANES];
            k[..tones.len()].copy_from_slice(tones);
            self.keep_kernels(fft, &k, squares.clone());
            for (transmission, spectra) in spectra.chunks_exact_mut(of_part).enumerate() {
                // The voxels, conjugate, with the outer phase of each tone; transformed back rather than forth.
                self.kernel.fill(Lanes { re: [1.0; LANES], im: [0.0; LANES] });
                if !layout.scans() {
                    let outward = &self.outward[transmission * width..][..width];
                    lane_phasors(&k, outward, &mut self.kernel[..width]);
                }
                self.transformed.fill(Lanes::ZERO);
                for (to, place) in self.transformed.iter_mut().zip(of_line()) {
                    *to = Lanes { re: [voxels[place].re; LANES], im: [-voxels[place].im; LANES] };
                }
                multiply(&self.kernel, &self.transformed, &mut self.products, false);
                fft.transform(&self.products, &mut self.transformed, &mut self.work);
                std::mem::swap(&mut self.products, &mut self.transformed);
                for (kernel, spectrum) in self.kernels.chunks_exact(n).zip(spectra.chunks_exact_mut(n)) {
                    focus(&self.products, kernel, spectrum);
                }
            }
        }
    }
}
