//! Eq. 16: on a shared lattice the sum over microphones is a convolution, done by padded 2-D FFTs.
//!
//! With voxels at `p₀ + i·h` and microphones at `r₀ + j·h`, `p − r = (p₀ − r₀) + (i − j)·h` depends on i − j alone:
//! one kernel `e^{−i2πf|p−r|/c}` per frequency and depth serves every pair. Where the voxel pitch is the microphone
//! pitch divided by u, the voxels split into u × u interleaved sub-lattices of the microphones' own pitch, and each
//! is a convolution with its own offset. The offset itself is free.

use super::Weights;
use super::fft2::{Fft2, Scratch};
use crate::acquisition::DataCube;
use crate::error::Result;
use crate::grid::{Axis, Grid, Volume};
use crate::progress::{Observer, advance, stage};
use crate::wave::Geometry;
use crate::wave::simd::phasors;
use glam::DVec3;
use num_complex::Complex32;
use rayon::prelude::*;

/// Bytes of data spectra held at a time; a whole small cube, or a block of frequencies of a large one.
const SPECTRA_BYTES: usize = 256 << 20;

/// How a grid lies on an array's lattice.
#[derive(Debug, Clone, Copy)]
pub(super) struct Fit {
    /// Voxels per microphone pitch, along x and y.
    u: [usize; 2],
    /// The microphones, with the pitch of an axis of one taken from the voxels.
    mics: [Axis; 2],
    z: f64,
}

impl Fit {
    /// Finds the fit, or says in words why there is none and what would mend it.
    pub(super) fn find(cube: &DataCube, grid: &Grid) -> std::result::Result<Self, String> {
        let Some(lattice) = cube.array.lattice() else {
            return Err("the microphones stand on no regular lattice".to_owned());
        };
        let shortest = cube.sound_speed / cube.sweep.stop();
        let fit_axis = |name: &str,
                        voxels: &Axis,
                        mics: &Axis|
         -> std::result::Result<(usize, Axis), String> {
            // A single voxel or microphone has no pitch that could fail to fit.
            if mics.count == 1 || voxels.count == 1 {
                let pitch = if mics.count == 1 { voxels.pitch } else { mics.pitch };
                return Ok((1, Axis { pitch, ..*mics }));
            }
            let u = (mics.pitch / voxels.pitch).round().max(1.0);
            // The mismatch adds up over the aperture; a millionth of a wavelength does no harm.
            let drift = (mics.pitch - u * voxels.pitch).abs() * mics.count.max(voxels.count) as f64;
            if drift <= 1e-6 * shortest {
                return Ok((u as usize, *mics));
            }
            let nearest = mics.pitch / u;
            Err(format!(
                "the voxel pitch along {name}, {} m, is not the microphones' {} m divided by a whole number \
                 ({} m would be)",
                voxels.pitch, mics.pitch, nearest
            ))
        };
        let (u_x, x) = fit_axis("x", &grid.x, &lattice.x)?;
        let (u_y, y) = fit_axis("y", &grid.y, &lattice.y)?;
        Ok(Self { u: [u_x, u_y], mics: [x, y], z: lattice.z })
    }

    /// The interleaved sub-lattices, as (first index, count) along x and y.
    fn sub_lattices(&self, grid: &Grid) -> Vec<[(usize, usize); 2]> {
        let parts = |u: usize, axis: &Axis| {
            (0..u.min(axis.count)).map(move |s| (s, (axis.count - s).div_ceil(u))).collect::<Vec<_>>()
        };
        let (x, y) = (parts(self.u[0], &grid.x), parts(self.u[1], &grid.y));
        y.iter().flat_map(|y| x.iter().map(move |x| [*x, *y])).collect()
    }
}

/// Fills `volume`, all frequencies of Eq. 16 in ascending order, planes in parallel.
///
/// Cost: per frequency, depth and sub-lattice one kernel of `n_x·n_y` phasors, one forward and one inverse FFT
/// (monostatic: one inverse per block of frequencies).
pub(super) fn convolution(
    cube: &DataCube,
    weights: &Weights,
    fit: &Fit,
    volume: &mut Volume,
    observer: &dyn Observer,
) -> Result<()> {
    let grid = volume.grid;
    let subs = fit.sub_lattices(&grid);
    let [m_x, m_y] = fit.mics.map(|axis| axis.count);
    let fft =
        Fft2::at_least(grid.x.count.div_ceil(fit.u[0]) + m_x - 1, grid.y.count.div_ceil(fit.u[1]) + m_y - 1);
    let block = (SPECTRA_BYTES / (fft.len() * size_of::<Complex32>())).clamp(1, cube.sweep.len());
    let total = (cube.sweep.len() * grid.z.count * subs.len()) as u64;
    stage(observer, "reconstructing", total, || {
        for first in (0..cube.sweep.len()).step_by(block) {
            let frequencies = first..(first + block).min(cube.sweep.len());
            let spectra = data_spectra(cube, weights, &fft, m_x, frequencies.clone());
            let per_metre: Vec<f64> =
                cube.sweep.frequencies()[frequencies].iter().map(|f| -f / cube.sound_speed).collect();
            volume.samples.par_chunks_mut(grid.plane_len()).enumerate().try_for_each_init(
                || Plane::new(&fft, cube.geometry),
                |plane, (iz, voxels)| {
                    for sub in &subs {
                        plane.place(fit, &grid, iz, sub);
                        plane.accumulate(&per_metre, &spectra, voxels, &grid, fit, sub);
                        advance(observer, per_metre.len() as u64)?;
                    }
                    Ok(())
                },
            )?;
        }
        Ok(())
    })
}

/// Spectra of the weighted samples, one after another; the inverse transform's scale is folded in.
fn data_spectra(
    cube: &DataCube,
    weights: &Weights,
    fft: &Fft2,
    m_x: usize,
    frequencies: std::ops::Range<usize>,
) -> Vec<Complex32> {
    let scale = 1.0 / fft.len() as f32;
    let mut spectra = vec![Complex32::ZERO; frequencies.len() * fft.len()];
    spectra.par_chunks_mut(fft.len()).zip(frequencies).for_each_init(
        || (fft.scratch(), vec![Complex32::ZERO; cube.array.len() / m_x * fft.n_x()]),
        |(scratch, padded), (spectrum, f)| {
            padded.fill(Complex32::ZERO);
            for (i, m) in weights.weighted(cube, f).enumerate() {
                padded[i / m_x * fft.n_x() + i % m_x] = m * scale;
            }
            fft.forward(padded, spectrum, scratch);
        },
    );
    spectra
}

/// One thread's work on one depth: the geometry of a sub-lattice, and buffers.
#[derive(Debug)]
struct Plane<'a> {
    fft: &'a Fft2,
    geometry: Geometry,
    /// `|p − r|` by lag, in FFT order (negative lags wrapped to the end), doubled for a scan, `[n_y, n_x]`.
    lengths: Vec<f64>,
    /// `|p − s|` per voxel of the sub-lattice; empty for a monostatic scan.
    outward: Vec<f64>,
    phase: [Vec<f32>; 2],
    kernel: Vec<Complex32>,
    spectrum: Vec<Complex32>,
    /// Sum of products over frequencies, for the monostatic scan.
    sum: Vec<Complex32>,
    scratch: Scratch,
}

impl<'a> Plane<'a> {
    fn new(fft: &'a Fft2, geometry: Geometry) -> Self {
        let zeros = || vec![Complex32::ZERO; fft.len()];
        Self {
            fft,
            geometry,
            lengths: vec![0.0; fft.len()],
            outward: Vec::new(),
            phase: [vec![0.0; fft.len()], vec![0.0; fft.len()]],
            kernel: zeros(),
            spectrum: zeros(),
            sum: zeros(),
            scratch: fft.scratch(),
        }
    }

    /// Works out every length of depth `iz` on one sub-lattice; they serve all frequencies.
    fn place(&mut self, fit: &Fit, grid: &Grid, iz: usize, sub: &[(usize, usize); 2]) {
        let (n_x, n_y) = (self.fft.n_x(), self.fft.n_y());
        let [mics_x, mics_y] = fit.mics;
        let offset = |axis: &Axis, mics: &Axis, start: usize| axis.position(start) - mics.first;
        let (x0, y0) = (offset(&grid.x, &mics_x, sub[0].0), offset(&grid.y, &mics_y, sub[1].0));
        let height = grid.z.position(iz) - fit.z;
        // Lags up to the last voxel are positive, the rest are the wrapped negative ones; what padding leaves
        // between them is never read.
        let lag = |i: usize, n: usize, voxels: usize| {
            if i < voxels { i as f64 } else { i as f64 - n as f64 }
        };
        let legs = self.geometry.return_legs();
        for (iy, row) in self.lengths.chunks_exact_mut(n_x).enumerate() {
            let dy = y0 + lag(iy, n_y, sub[1].1) * mics_y.pitch;
            let square = dy * dy + height * height;
            for (ix, length) in row.iter_mut().enumerate() {
                let dx = x0 + lag(ix, n_x, sub[0].1) * mics_x.pitch;
                *length = legs * (dx * dx + square).sqrt();
            }
        }
        self.outward.clear();
        if let Geometry::FixedSource { .. } = self.geometry {
            let z = grid.z.position(iz);
            for y in (0..sub[1].1).map(|k| grid.y.position(sub[1].0 + k * fit.u[1])) {
                for x in (0..sub[0].1).map(|k| grid.x.position(sub[0].0 + k * fit.u[0])) {
                    self.outward.push(self.geometry.outward_length(DVec3::new(x, y, z)));
                }
            }
        }
    }

    /// Adds one block of frequencies to the voxels of one sub-lattice.
    fn accumulate(
        &mut self,
        per_metre: &[f64],
        spectra: &[Complex32],
        voxels: &mut [Complex32],
        grid: &Grid,
        fit: &Fit,
        sub: &[(usize, usize); 2],
    ) {
        let [(start_x, count_x), (start_y, count_y)] = *sub;
        let scan = self.outward.is_empty();
        self.sum.fill(Complex32::ZERO);
        for (k, data) in per_metre.iter().zip(spectra.chunks_exact(self.fft.len())) {
            self.phasors_of(*k, false);
            for ((kernel, re), im) in self.kernel.iter_mut().zip(&self.phase[0]).zip(&self.phase[1]) {
                *kernel = Complex32::new(*re, *im);
            }
            self.fft.forward(&mut self.kernel, &mut self.spectrum, &mut self.scratch);
            if scan {
                // No outer phase remains, so frequencies add up before the one inverse FFT.
                for ((sum, a), b) in self.sum.iter_mut().zip(&self.spectrum).zip(data) {
                    *sum += a * b;
                }
                continue;
            }
            for (a, b) in self.spectrum.iter_mut().zip(data) {
                *a *= b;
            }
            self.phasors_of(*k, true);
            let focused = self.fft.inverse(&mut self.spectrum, count_y, &mut self.scratch);
            for row in 0..count_y {
                let to = &mut voxels[(start_y + row * fit.u[1]) * grid.x.count..][..grid.x.count];
                let from = &focused[row * self.fft.n_x()..][..count_x];
                let outer = row * count_x..(row + 1) * count_x;
                let phase = self.phase[0][outer.clone()].iter().zip(&self.phase[1][outer]);
                for ((voxel, a), (re, im)) in to[start_x..].iter_mut().step_by(fit.u[0]).zip(from).zip(phase)
                {
                    *voxel += a * Complex32::new(*re, *im);
                }
            }
        }
        if scan {
            let focused = self.fft.inverse(&mut self.sum, count_y, &mut self.scratch);
            for row in 0..count_y {
                let to = &mut voxels[(start_y + row * fit.u[1]) * grid.x.count..][..grid.x.count];
                let from = &focused[row * self.fft.n_x()..][..count_x];
                for (voxel, a) in to[start_x..].iter_mut().step_by(fit.u[0]).zip(from) {
                    *voxel += a;
                }
            }
        }
    }

    /// Phasors of the kernel's lengths, or of the outward legs, into `phase`.
    fn phasors_of(&mut self, per_metre: f64, outward: bool) {
        let lengths = if outward { &self.outward } else { &self.lengths };
        let [re, im] = &mut self.phase;
        phasors(per_metre, lengths, &mut re[..lengths.len()], &mut im[..lengths.len()]);
    }
}
