//! Eq. 16 as it is written, over `rustfft`: the oracle of this folder, and what sums images of one line at tolerance 0.
//!
//! `Â(p) = Σ_f e^{−i2πf|p−s|/c} · F⁻¹{ F{e^{−i2πf|p−r|/c}} · F{w m(f, r)} }`, for every frequency and depth one kernel, its
//! transform, a product and an inverse transform, on a plane padded to `n_voxels + n_nodes − 1` along each axis. Each
//! pair of interleaved sublattices is one such convolution. Nothing is shared, mirrored or left out.

use super::lattice::{Sublattice, Sublattices};
use super::layout::Layout;
use crate::alloc::{try_with_capacity, try_zeroed};
use crate::error::Result;
use crate::grid::{Axis, Grid, no_room_for};
use crate::progress::{Observer, advance};
use crate::reconstruct::compress::Tones;
use crate::reconstruct::numerics::fast_size;
use crate::reconstruct::volume::Batch;
use crate::wave::{Geometry, phasor};
use glam::{DVec2, DVec3};
use num_complex::Complex32;
use rayon::prelude::*;
use rustfft::{Fft, FftDirection, FftPlanner};
use std::sync::Arc;

/// The transforms of one padded plane, `[y, x]`; spectra are `[k_x, k_y]`.
struct PaddedPlane {
    /// n_x, n_y.
    shape: [usize; 2],
    forward: [Arc<dyn Fft<f32>>; 2],
    inverse: [Arc<dyn Fft<f32>>; 2],
}

impl PaddedPlane {
    fn new(shape: [usize; 2]) -> Self {
        let mut planner = FftPlanner::new();
        let [forward, inverse] = [FftDirection::Forward, FftDirection::Inverse]
            .map(|direction| shape.map(|n| planner.plan_fft(n, direction)));
        Self { shape, forward, inverse }
    }

    fn len(&self) -> usize {
        self.shape[0] * self.shape[1]
    }

    /// From `[y, x]` to `[k_x, k_y]`.
    fn transform(&self, plane: &mut Vec<Complex32>, work: &mut Vec<Complex32>) {
        self.forward[0].process(plane);
        self.turn(self.shape, plane, work);
        self.forward[1].process(plane);
    }

    /// From `[k_x, k_y]` to `[y, x]`, without the factor 1/n.
    fn transform_back(&self, plane: &mut Vec<Complex32>, work: &mut Vec<Complex32>) {
        self.inverse[1].process(plane);
        self.turn([self.shape[1], self.shape[0]], plane, work);
        self.inverse[0].process(plane);
    }

    /// Transposes rows of `columns` values; a single row or column lies the same either way.
    fn turn(&self, [columns, rows]: [usize; 2], plane: &mut Vec<Complex32>, work: &mut Vec<Complex32>) {
        if columns > 1 && rows > 1 {
            work.clear();
            work.extend((0..self.len()).map(|i| plane[i % rows * columns + i / rows]));
            std::mem::swap(plane, work);
        }
    }
}

/// Sums tones at any depth of one layout.
pub(crate) struct Literal<'a> {
    layout: &'a Layout,
    padded: PaddedPlane,
}

impl std::fmt::Debug for Literal<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Literal").field("shape", &self.padded.shape).finish_non_exhaustive()
    }
}

impl<'a> Literal<'a> {
    pub(crate) fn new(layout: &'a Layout) -> Self {
        let longest =
            |parts: &[Sublattices], axis: usize| parts.iter().map(|p| p[axis].count).max().unwrap_or(1);
        let shape = [0, 1].map(|axis| {
            fast_size(longest(&layout.voxel_parts, axis) + longest(&layout.node_parts, axis) - 1, 1)
        });
        Self { layout, padded: PaddedPlane::new(shape) }
    }

    /// Bytes of one tone's spectra, and of one thread's planes.
    pub(crate) fn bytes(&self) -> [u64; 2] {
        let plane = (self.padded.len() * size_of::<Complex32>()) as u64;
        [plane * self.layout.node_parts.len() as u64, 3 * plane]
    }

    /// Adds tones to the planes from depth `first` on, `[plane, y, x]`.
    ///
    /// # Errors
    /// Spectra or planes do not fit in memory; [`crate::error::Error::Interrupted`].
    pub(crate) fn add(
        &self,
        tones: &Tones,
        batch: Batch,
        first: usize,
        planes: &mut [Complex32],
        observer: &dyn Observer,
    ) -> Result<()> {
        let grid = &self.layout.grid;
        let nodes = tones.samples.par_chunks_exact(self.layout.lattice.width());
        let spectra: Vec<_> = nodes
            .map(|nodes| self.layout.node_parts.iter().map(|part| self.spectrum(nodes, part)).collect())
            .collect::<Option<Vec<Vec<_>>>>()
            .ok_or_else(|| no_room_for(grid))?;
        let planes = planes.par_chunks_mut(grid.plane_len());
        let run = batch.least_run(planes.len());
        planes.with_min_len(run).enumerate().try_for_each_init(
            || [(); 3].map(|()| try_zeroed(self.padded.len() as u64)),
            |buffers, (iz, voxels)| {
                let [Some(kernel), Some(sum), Some(work)] = buffers else { return Err(no_room_for(grid)) };
                for (k, spectra) in tones.per_metre.iter().zip(&spectra) {
                    for part in &self.layout.voxel_parts {
                        sum.fill(Complex32::ZERO);
                        for (nodes, spectrum) in self.layout.node_parts.iter().zip(spectra) {
                            self.kernel(*k, first + iz, part, nodes, kernel);
                            self.padded.transform(kernel, work);
                            let products = kernel.iter().zip(spectrum).map(|(a, b)| a * b);
                            sum.iter_mut().zip(products).for_each(|(sum, product)| *sum += product);
                        }
                        self.padded.transform_back(sum, work);
                        self.add_to_voxels(*k, first + iz, part, sum, voxels);
                    }
                }
                advance(observer, tones.per_metre.len() as u64)
            },
        )
    }

    /// The spectrum of one sublattice of a tone's nodes, `[k_x, k_y]`; the inverse transform's factor is folded in.
    fn spectrum(&self, nodes: &[Complex32], [x, y]: &Sublattices) -> Option<Vec<Complex32>> {
        let [n_x, _] = self.padded.shape;
        let mut plane = try_zeroed(self.padded.len() as u64)?;
        let mut work = try_with_capacity(self.padded.len() as u64)?;
        let (width, scale) = (self.layout.lattice.nodes()[0].count, 1.0 / self.padded.len() as f32);
        for j in 0..y.count {
            for i in 0..x.count {
                plane[j * n_x + i] = nodes[(y.start + j * y.stride) * width + x.start + i * x.stride] * scale;
            }
        }
        self.padded.transform(&mut plane, &mut work);
        Some(plane)
    }

    /// `e^{−i2πf|p−r|/c}` by lag: from the first voxel and node up to the last voxel, then the wrapped negative lags.
    fn kernel(
        &self,
        per_metre: f64,
        iz: usize,
        voxels: &Sublattices,
        nodes: &Sublattices,
        kernel: &mut [Complex32],
    ) {
        let (Layout { grid, lattice, geometry, .. }, [n_x, n_y]) = (self.layout, self.padded.shape);
        let first = self.first(voxels, &[grid.x, grid.y]) - self.first(nodes, &lattice.nodes());
        let pitch = DVec2::from_array(lattice.common_pitch());
        let height = grid.z.position(iz) - lattice.z;
        let lag = |i: usize, n: usize, voxels: usize| i as f64 - if i < voxels { 0.0 } else { n as f64 };
        for (i, value) in kernel.iter_mut().enumerate() {
            let lag = DVec2::new(lag(i % n_x, n_x, voxels[0].count), lag(i / n_x, n_y, voxels[1].count));
            let distance = (first + pitch * lag).extend(height).length();
            *value = phasor(per_metre * geometry.return_legs() * distance);
        }
    }

    /// Position of the first place of a sublattice, m.
    fn first(&self, parts: &Sublattices, axes: &[Axis; 2]) -> DVec2 {
        let first = |axis: &Axis, part: &Sublattice| axis.position(part.start);
        DVec2::new(first(&axes[0], &parts[0]), first(&axes[1], &parts[1]))
    }

    /// Adds the convolution to one sublattice of voxels, with the phase of the way from the speaker.
    fn add_to_voxels(
        &self,
        k: f64,
        iz: usize,
        [x, y]: &Sublattices,
        sum: &[Complex32],
        voxels: &mut [Complex32],
    ) {
        let grid: &Grid = &self.layout.grid;
        for j in 0..y.count {
            for i in 0..x.count {
                let (ix, iy) = (x.start + i * x.stride, y.start + j * y.stride);
                let p: DVec3 = grid.position(ix, iy, iz);
                let outer = match self.layout.geometry {
                    Geometry::FixedSource { .. } => phasor(k * self.layout.geometry.outward_length(p)),
                    Geometry::Monostatic => Complex32::ONE,
                };
                voxels[iy * grid.x.count + ix] += sum[j * self.padded.shape[0] + i] * outer;
            }
        }
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;
    use crate::acquisition::{Detection, MicArray, Setup, Sweep};
    use crate::progress::Silent;
    use crate::reconstruct::convolution::lattice::SharedLattice;
    use crate::reconstruct::convolution::{Depths, Workspaces};
    use crate::reconstruct::error_budget::ErrorBudget;

    /// Numbers in −½ .. ½ that look random.
    fn noise(count: usize, seed: f64) -> Vec<Complex32> {
        let value = |i: usize, k: f64| ((i as f64 + seed) * k).fract() as f32 - 0.5;
        (0..count).map(|i| Complex32::new(value(i, 0.618_033_988_75), value(i, 0.754_877_666_2))).collect()
    }

    /// The literal image and the fast one of five tones of noise, every depth of the grid.
    fn both(array: &MicArray, grid: Grid, geometry: Geometry) -> [Vec<Complex32>; 2] {
        let sweep = Sweep::stepped("sweep", 10_000.0, 18_000.0, 2_000.0).unwrap();
        let (detection, sound_speed) = (Detection::Quadrature, 343.0);
        let setup = Setup { sweep: &sweep, array, geometry, detection, sound_speed };
        let lattice = SharedLattice::find(&setup, &grid, ErrorBudget::new(0.0)).unwrap().remove(0);
        let layout = Layout::new(lattice, grid, geometry);
        let tones = Tones {
            per_metre: sweep.frequencies().iter().map(|f| -f / sound_speed).collect(),
            samples: noise(sweep.len() * layout.lattice.width(), 3.0),
        };
        let batch = Batch::of_threads(2);
        let mut literal = vec![Complex32::ZERO; grid.voxel_count() as usize];
        Literal::new(&layout).add(&tones, batch, 0, &mut literal, &Silent).unwrap();
        let mut fast = vec![Complex32::ZERO; grid.voxel_count() as usize];
        let workspaces = Workspaces::new(&layout);
        let depths = Depths { layout: &layout, workspaces, near: None, batch, observer: &Silent };
        depths.add(&tones, &mut layout.room(sweep.len()).unwrap(), 0, &mut fast).unwrap();
        [literal, fast]
    }

    #[test]
    fn convolution_in_lanes_is_the_literal_equation_16() {
        let mut compared = 0;
        for (n, seed) in (0..60_usize).zip(1..) {
            let random = noise(8, f64::from(seed));
            let whole = |i: usize, most: usize| 1 + ((random[i].re + 0.5) * most as f32) as usize;
            // Grids finer and coarser than the array, centred on it and aside; planes, lines and single places.
            let count = [whole(0, 12), if n % 5 == 0 { 1 } else { whole(1, 9) }];
            let voxels = [whole(2, 14), if n % 5 == 0 { 1 } else { whole(3, 11) }];
            let pitch = [0.011, 0.017];
            let array = MicArray::rectangular("array", count, pitch, DVec3::new(0.02, 0.0, 0.01)).unwrap();
            let factor = [1.0, 0.5, 2.0, 1.0 / 3.0][n % 4];
            let (low, _) = array.bounds();
            let axis = |axis: usize, aside: f64| Axis {
                first: low[axis] + aside * pitch[axis],
                pitch: pitch[axis] * factor,
                count: voxels[axis],
            };
            let aside = [0.0, 0.5, -2.25, 30.0][n / 4 % 4];
            let z = Axis { first: 0.1 * (n % 3) as f64, pitch: 0.2, count: 3 };
            let grid = Grid { x: axis(0, aside), y: axis(1, -aside), z };
            let source = DVec3::new(0.1, -0.05, 0.0);
            let geometry = if n % 3 == 0 { Geometry::Monostatic } else { Geometry::FixedSource { source } };
            let [literal, fast] = both(&array, grid, geometry);
            let peak = literal.iter().map(|z| z.norm()).fold(0.0, f32::max);
            let worst = literal.iter().zip(&fast).map(|(a, b)| (a - b).norm()).fold(0.0, f32::max);
            assert!(peak > 0.1 && worst < 3e-6 * peak.max(1.0), "case {n}: {worst:e} of {peak}");
            compared += literal.len();
        }
        assert!(compared > 5000, "{compared} voxels");
    }
}
