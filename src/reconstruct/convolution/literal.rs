//! Eq. 16 as it is written, over `rustfft`: the oracle of this folder, and the faster form for narrow planes at tolerance
//! 0 ([`Literal::is_faster`]).
//!
//! `Â(p) = Σ_f e^{−i2πf|p−s|/c} · F⁻¹{ F{e^{−i2πf|p−r|/c}} · F{w m(f, r)} }`, for every frequency and depth one kernel, its
//! transform, a product and an inverse transform, on a plane padded to `n_voxels + n_nodes − 1` along each axis. Each
//! pair of interleaved sublattices is one such convolution. Nothing is shared, mirrored or left out.

use super::lattice::{Sublattice, Sublattices};
use super::layout::Layout;
use crate::alloc::{try_filled, try_zeroed};
use crate::error::Result;
use crate::grid::{Axis, no_room_for};
use crate::progress::{Observer, advance};
use crate::reconstruct::compress::Tones;
use crate::reconstruct::numerics::fast_size;
use crate::reconstruct::volume::Batch;
use crate::wave::Geometry;
use crate::wave::simd::{LANES, Lanes, ROWS, lane_phasors};
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
    scratch_len: usize,
}

impl PaddedPlane {
    fn new(shape: [usize; 2]) -> Self {
        let mut planner = FftPlanner::new();
        let [forward, inverse] = [FftDirection::Forward, FftDirection::Inverse]
            .map(|direction| shape.map(|n| planner.plan_fft(n, direction)));
        let scratch = forward.iter().chain(&inverse).map(|fft| fft.get_inplace_scratch_len());
        let scratch_len = scratch.fold(shape[0] * shape[1], usize::max);
        Self { shape, forward, inverse, scratch_len }
    }

    fn len(&self) -> usize {
        self.shape[0] * self.shape[1]
    }

    /// From `[y, x]` to `[k_x, k_y]`.
    fn transform(&self, plane: &mut [Complex32], scratch: &mut [Complex32]) {
        self.forward[0].process_with_scratch(plane, scratch);
        if self.transpose(self.shape, plane, scratch) {
            self.forward[1].process_with_scratch(plane, scratch);
        }
    }

    /// From `[k_x, k_y]` to `[y, x]`, without the factor 1/n.
    fn transform_back(&self, plane: &mut [Complex32], scratch: &mut [Complex32]) {
        let [n_x, n_y] = self.shape;
        if n_y > 1 {
            self.inverse[1].process_with_scratch(plane, scratch);
        }
        self.transpose([n_y, n_x], plane, scratch);
        self.inverse[0].process_with_scratch(plane, scratch);
    }

    /// Transposes rows of `columns` values; false for a single row or column, which needs nothing.
    fn transpose(
        &self,
        [columns, rows]: [usize; 2],
        plane: &mut [Complex32],
        scratch: &mut [Complex32],
    ) -> bool {
        if columns == 1 || rows == 1 {
            // A transform of length 1 along x is the identity, and the values are a line along y.
            return columns == 1;
        }
        let turned = &mut scratch[..self.len()];
        for (column, to) in turned.chunks_exact_mut(rows).enumerate() {
            to.iter_mut().enumerate().for_each(|(row, to)| *to = plane[row * columns + column]);
        }
        plane.copy_from_slice(turned);
        true
    }
}

/// Lengths of a padded plane along x and y.
fn padded_shape(layout: &Layout) -> [usize; 2] {
    let longest =
        |parts: &[Sublattices], axis: usize| parts.iter().map(|part| part[axis].count).max().unwrap_or(1);
    [0, 1]
        .map(|axis| fast_size(longest(&layout.voxel_parts, axis) + longest(&layout.node_parts, axis) - 1, 1))
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

/// One thread's buffers: path lengths of one depth in lanes, their phasors, and padded planes.
struct Buffers {
    /// The part of the path that moves with the microphone, by lag, m: `[node sublattice][lag]`.
    lengths: Vec<[f64; LANES]>,
    /// `|p − s|` by place on the padded plane, m; empty for a scan.
    outward: Vec<[f64; LANES]>,
    phasors: Vec<Lanes>,
    kernel: Vec<Complex32>,
    sum: Vec<Complex32>,
    scratch: Vec<Complex32>,
}

impl<'a> Literal<'a> {
    pub(crate) fn new(layout: &'a Layout) -> Self {
        Self { layout, padded: PaddedPlane::new(padded_shape(layout)) }
    }

    /// Whether this is faster than transforms in lanes, of which a narrow plane fills few, and a line as many as there are
    /// frequencies. Measured in one run on two cores, in multiples of the lanes' time:
    ///
    /// | nodes, as many voxels | 1 | 4 | 16 | 64 frequencies |
    /// |---|---|---|---|---|
    /// | 256 x 1 | 0.3 | 0.6 | 2.1 | 2.4 |
    /// | 1 x 64 | 0.6 | 1.5 | 5.3 | 11 |
    /// | 64 x 2 | 0.5 | 0.4 | 0.3 | 0.3 |
    /// | 4 x 4 | 0.6 | 0.4 | 0.3 | 0.2 |
    /// | 64 x 4 | 1.1 | 0.8 | 0.7 | 0.7 |
    /// | 8 x 8 | 2.2 | 2.1 | 2.2 | 2.2 |
    /// | 16 x 16 | 4.4 | 3.9 | 2.4 | 2.4 |
    pub(crate) fn is_faster(layout: &Layout, frequencies: usize) -> bool {
        if layout.line.is_some() {
            return frequencies <= LANES / 8;
        }
        padded_shape(layout).into_iter().any(|n| n <= LANES / 2)
    }

    /// Numbers of a padded plane in whole lanes.
    fn lanes(&self) -> usize {
        self.padded.len().next_multiple_of(ROWS * LANES) / LANES
    }

    /// Bytes of one tone's spectra, and of one thread's buffers.
    pub(crate) fn bytes(&self) -> [u64; 2] {
        let parts = self.layout.node_parts.len() as u64;
        let plane = (self.padded.len() * size_of::<Complex32>()) as u64;
        [plane * parts, plane * (5 + parts)]
    }

    fn buffers(&self) -> Option<Buffers> {
        let (len, lanes) = (self.padded.len() as u64, self.lanes() as u64);
        Some(Buffers {
            lengths: try_filled([0.0; LANES], lanes * self.layout.node_parts.len() as u64)?,
            outward: try_filled([0.0; LANES], lanes)?,
            phasors: try_filled(Lanes::ZERO, lanes)?,
            kernel: try_zeroed(len)?,
            sum: try_zeroed(len)?,
            scratch: try_zeroed(self.padded.scratch_len as u64)?,
        })
    }

    /// Adds tones to the planes from depth `first` on, `[plane, y, x]`.
    ///
    /// # Errors
    /// Spectra or buffers do not fit in memory; [`crate::error::Error::Interrupted`].
    pub(crate) fn add(
        &self,
        tones: &Tones,
        batch: Batch,
        first: usize,
        planes: &mut [Complex32],
        observer: &dyn Observer,
    ) -> Result<()> {
        let grid = self.layout.grid();
        let nodes = tones.samples.par_chunks_exact(self.layout.lattice.width());
        let spectra: Vec<_> = nodes
            .map(|nodes| self.layout.node_parts.iter().map(|part| self.spectrum(nodes, part)).collect())
            .collect::<Option<Vec<Vec<_>>>>()
            .ok_or_else(|| no_room_for(grid))?;
        let planes = planes.par_chunks_mut(grid.plane_len());
        let run = batch.least_run(planes.len());
        planes.with_min_len(run).enumerate().try_for_each_init(
            || self.buffers(),
            |buffers, (iz, voxels)| {
                let buffers = buffers.as_mut().ok_or_else(|| no_room_for(grid))?;
                for part in &self.layout.voxel_parts {
                    self.measure(first + iz, part, buffers);
                    for (k, spectra) in tones.per_metre.iter().zip(&spectra) {
                        self.convolve(*k, spectra, buffers);
                        self.add_to_voxels(*k, part, buffers, voxels);
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
        let mut scratch = try_zeroed(self.padded.scratch_len as u64)?;
        let (width, scale) = (self.layout.lattice.nodes()[0].count, 1.0 / self.padded.len() as f32);
        for j in 0..y.count {
            for i in 0..x.count {
                plane[j * n_x + i] = nodes[(y.start + j * y.stride) * width + x.start + i * x.stride] * scale;
            }
        }
        self.padded.transform(&mut plane, &mut scratch);
        Some(plane)
    }

    /// All path lengths of one depth and voxel sublattice. By lag: from the first voxel and node up to the last voxel, then
    /// the wrapped negative lags.
    fn measure(&self, iz: usize, voxels: &Sublattices, buffers: &mut Buffers) {
        let (Layout { places, lattice, geometry, refraction, .. }, [n_x, n_y]) =
            (self.layout, self.padded.shape);
        let grid = places.grid();
        let pitch = DVec2::from_array(lattice.common_pitch());
        let (z, microphone) = (places.at(2, iz), DVec3::Z * lattice.z);
        let leg = |from: DVec3, p: DVec3| match refraction {
            None => p.distance(from),
            Some(refraction) => refraction.leg_length(from, p),
        };
        let lag = |i: usize, n: usize, voxels: usize| i as f64 - if i < voxels { 0.0 } else { n as f64 };
        for (part, lengths) in
            self.layout.node_parts.iter().zip(buffers.lengths.chunks_exact_mut(self.lanes()))
        {
            let first = Self::first(voxels, &[grid.x, grid.y]) - Self::first(part, &lattice.nodes());
            for (i, length) in lengths.as_flattened_mut()[..self.padded.len()].iter_mut().enumerate() {
                let lag = DVec2::new(lag(i % n_x, n_x, voxels[0].count), lag(i / n_x, n_y, voxels[1].count));
                let p = (first + pitch * lag).extend(z);
                let back = leg(microphone, p);
                *length = match geometry {
                    Geometry::FixedSource { .. } => back,
                    Geometry::Monostatic => 2.0 * back,
                    Geometry::Pair { offset } => leg(microphone + *offset, p) + back,
                };
            }
        }
        let [x, y] = voxels;
        let outward = buffers.outward.as_flattened_mut();
        for (j, i) in (0..y.count).flat_map(|j| (0..x.count).map(move |i| (j, i))) {
            let p = places.position([x.start + i * x.stride, y.start + j * y.stride, iz]);
            outward[j * n_x + i] = match geometry {
                Geometry::FixedSource { source } => leg(*source, p),
                Geometry::Monostatic | Geometry::Pair { .. } => 0.0,
            };
        }
    }

    /// Position of the first place of a sublattice, m.
    fn first(parts: &Sublattices, axes: &[Axis; 2]) -> DVec2 {
        let first = |axis: &Axis, part: &Sublattice| axis.position(part.start);
        DVec2::new(first(&axes[0], &parts[0]), first(&axes[1], &parts[1]))
    }

    /// The convolution of one tone, into the sum.
    fn convolve(&self, k: f64, spectra: &[Vec<Complex32>], buffers: &mut Buffers) {
        let Buffers { lengths, phasors, kernel, sum, scratch, .. } = buffers;
        for (n, (lengths, spectrum)) in lengths.chunks_exact(self.lanes()).zip(spectra).enumerate() {
            lane_phasors(&[k; LANES], lengths, phasors);
            interleave(phasors, kernel);
            self.padded.transform(kernel, scratch);
            for ((sum, a), b) in sum.iter_mut().zip(&*kernel).zip(spectrum) {
                *sum = if n == 0 { a * b } else { *sum + a * b };
            }
        }
        self.padded.transform_back(sum, scratch);
    }

    /// Adds the sum to one sublattice of voxels, with the phase of the path from the speaker.
    fn add_to_voxels(&self, k: f64, [x, y]: &Sublattices, buffers: &mut Buffers, voxels: &mut [Complex32]) {
        let Buffers { outward, phasors, kernel, sum, .. } = buffers;
        lane_phasors(&[k; LANES], outward, phasors);
        interleave(phasors, kernel);
        let width = self.layout.grid().x.count;
        for j in 0..y.count {
            let row = j * self.padded.shape[0]..j * self.padded.shape[0] + x.count;
            let to =
                voxels[(y.start + j * y.stride) * width..][..width][x.start..].iter_mut().step_by(x.stride);
            for ((voxel, sum), outer) in to.zip(&sum[row.clone()]).zip(&kernel[row]) {
                *voxel += sum * outer;
            }
        }
    }
}

/// Real and imaginary lanes as complex numbers.
fn interleave(lanes: &[Lanes], numbers: &mut [Complex32]) {
    for (lanes, numbers) in lanes.iter().zip(numbers.chunks_mut(LANES)) {
        for (number, (re, im)) in numbers.iter_mut().zip(lanes.re.iter().zip(&lanes.im)) {
            *number = Complex32::new(*re, *im);
        }
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;
    use crate::acquisition::{Instrument, MicArray, Sweep};
    use crate::grid::Grid;
    use crate::progress::Silent;
    use crate::reconstruct::convolution::lattice::SharedLattice;
    use crate::reconstruct::convolution::{Depths, Workspaces};
    use crate::reconstruct::error_budget::ErrorBudget;
    use crate::reconstruct::numerics::GridPlaces;
    use crate::wave::Interface;

    /// Numbers in −½ .. ½ that look random.
    fn noise(count: usize, seed: f64) -> Vec<Complex32> {
        let value = |i: usize, k: f64| ((i as f64 + seed) * k).fract() as f32 - 0.5;
        (0..count).map(|i| Complex32::new(value(i, 0.618_033_988_75), value(i, 0.754_877_666_2))).collect()
    }

    /// The literal image and the fast one of five tones of noise, every depth of the grid.
    fn both(array: &MicArray, grid: Grid, geometry: Geometry, n: usize) -> [Vec<Complex32>; 2] {
        let sweep = Sweep::stepped(10_000.0, 18_000.0, 2_000.0).unwrap();
        let interface = [None, Some(Interface { depth: 0.25, sound_speed: 900.0 })][n / 2 % 2];
        let instrument =
            Instrument::new(sweep.clone(), array.clone()).with_geometry(geometry).with_interface(interface);
        let lattice = SharedLattice::find(&instrument, &GridPlaces::even(&grid), ErrorBudget::new(0.0))
            .unwrap()
            .remove(0);
        let layout = Layout::new(lattice, GridPlaces::even(&grid), &instrument);
        let tones = Tones {
            per_metre: sweep.frequencies().iter().map(|f| -f / instrument.sound_speed).collect(),
            samples: noise(sweep.len() * layout.lattice.width(), 3.0),
        };
        let batch = Batch::of_threads(2);
        let mut literal = vec![Complex32::ZERO; grid.voxel_count() as usize];
        Literal::new(&layout).add(&tones, batch, 0, &mut literal, &Silent).unwrap();
        let mut fast = vec![Complex32::ZERO; grid.voxel_count() as usize];
        let workspaces = Workspaces::new(&layout);
        let depths = Depths { layout: &layout, workspaces, near: Vec::new(), batch, observer: &Silent };
        depths.add((&[tones], sweep.len()), &mut Vec::new(), 0, &mut fast).unwrap();
        [literal, fast]
    }

    #[test]
    fn convolution_in_lanes_is_the_literal_equation_16() {
        let mut compared = 0;
        for (n, seed) in (0..96_usize).zip(1..) {
            let random = noise(8, f64::from(seed));
            let whole = |i: usize, most: usize| 1 + ((random[i].re + 0.5) * most as f32) as usize;
            // Grids finer and coarser than the array, centred on it and aside; planes, lines and single places.
            let count = [whole(0, 12), if n % 5 == 0 { 1 } else { whole(1, 9) }];
            let voxels = [whole(2, 14), if n % 5 == 0 { 1 } else { whole(3, 11) }];
            let pitch = [0.011, 0.017];
            let array = MicArray::rectangular(count, pitch, DVec3::new(0.02, 0.0, 0.01)).unwrap();
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
            // Pairs beside one another along an axis, by whole pitches and others; across both; one before the other; in one place.
            let offsets =
                [[0.022, 0.0, 0.0], [0.0, 0.1, 0.0], [0.03, -0.05, 0.0], [0.0, 0.0, -0.04], [0.0; 3]];
            let offset = DVec3::from(offsets[n / 3 % 5]);
            let geometry =
                [Geometry::Monostatic, Geometry::FixedSource { source }, Geometry::Pair { offset }][n % 3];
            let [literal, fast] = both(&array, grid, geometry, n);
            let peak = literal.iter().map(|z| z.norm()).fold(0.0, f32::max);
            let worst = literal.iter().zip(&fast).map(|(a, b)| (a - b).norm()).fold(0.0, f32::max);
            assert!(peak > 0.1 && worst < 3e-6 * peak.max(1.0), "case {n}: {worst:e} of {peak}");
            compared += literal.len();
        }
        assert!(compared > 8000, "{compared} voxels");
    }
}
