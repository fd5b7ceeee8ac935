//! Voxels of nodes against the direct sum, for arrays and grids of all kinds.

#![allow(clippy::unwrap_used)]

use super::*;
use crate::acquisition::{DataCube, MicArray, Sweep};
use crate::error::Result;
use crate::grid::Volume;
use crate::progress::Silent;
use crate::reconstruct::backprojection::{BackprojectionPlan, backprojection};
use crate::reconstruct::compress::KeptTones;
use crate::reconstruct::convolution::{ConvolutionPlan, SharedLattice, convolution};
use crate::reconstruct::job::Job;
use crate::reconstruct::plan::Sampled;
use crate::reconstruct::volume::ResumedVolume;
use crate::reconstruct::window::Weights;
use crate::reconstruct::{
    Method, ReconstructOptions, ReconstructionInfo, VolumeSink, Window, on_nodes, reconstruct,
    reconstruct_into,
};
use crate::wave::{Geometry, phasor};
use std::cell::Cell;

pub(super) fn axis(first: f64, pitch: f64, count: usize) -> Axis {
    Axis { first, pitch, count }
}

fn fraction(i: usize, k: f64) -> f64 {
    (i as f64 * k).fract() - 0.5
}

/// Samples of a point, where all terms are in phase, and of noise, where none are.
pub(super) fn cube(array: &MicArray, geometry: Geometry, point: DVec3) -> DataCube {
    let sweep = Sweep::stepped(9_000.0, 15_000.0, 300.0).unwrap();
    let sample = |(i, (f, r)): (usize, (&f64, &DVec3))| {
        let noise = phasor(fraction(i, 0.618_034)) * fraction(i, 0.754_878) as f32;
        phasor(f / 343.0 * geometry.path_length(point, *r)) + noise
    };
    let places = array.positions();
    let each = sweep.frequencies().iter().flat_map(|f| places.iter().map(move |r| (f, r)));
    let samples = each.enumerate().map(sample).collect();
    DataCube::new(Instrument::new(sweep, array.clone()).with_geometry(geometry), samples).unwrap()
}

pub(super) fn scattered(count: usize) -> MicArray {
    let place = |i: usize| DVec3::new(0.4 * fraction(i, 0.618_034), 0.3 * fraction(i, 0.754_878), 0.0);
    MicArray::from_positions((0..count).map(place).collect()).unwrap()
}

pub(super) fn options(method: Method, tolerance: f64) -> ReconstructOptions {
    ReconstructOptions { tolerance, ..ReconstructOptions::new(method, Window::Hann) }
}

/// The largest difference of two volumes.
fn difference(a: &Volume, b: &Volume) -> f64 {
    let each = a.samples.iter().zip(&b.samples).map(|(a, b)| f64::from((a - b).norm()));
    each.fold(0.0, f64::max)
}

#[test]
fn voxels_of_nodes_are_those_of_the_direct_sum() {
    let lattice = MicArray::rectangular([9, 7], [0.05; 2], DVec3::new(0.01, -0.02, 0.0)).unwrap();
    let behind = Geometry::FixedSource { source: DVec3::new(0.1, 0.05, -0.2) };
    let inside = Geometry::FixedSource { source: DVec3::new(0.013, -0.021, 0.747) };
    // Fine along all axes; along z alone; of another pitch than the microphones'; a single row; near.
    let grids = [
        Grid { x: axis(-0.11, 0.004, 50), y: axis(-0.09, 0.0037, 40), z: axis(0.7, 0.003, 40) },
        Grid { x: axis(-0.1, 0.025, 9), y: axis(-0.1, 0.025, 8), z: axis(0.7, 0.002, 70) },
        Grid { x: axis(-0.2, 0.0101, 40), y: axis(-0.2, 0.0099, 38), z: axis(0.7, 0.03, 5) },
        Grid { x: axis(-0.2, 0.003, 120), y: axis(0.03, 0.01, 1), z: axis(0.6, 0.004, 60) },
        Grid { x: axis(-0.1, 0.004, 30), y: axis(-0.1, 0.004, 25), z: axis(0.04, 0.003, 25) },
    ];
    let mut used = 0;
    let pair = Geometry::Pair { offset: DVec3::new(0.1, -0.04, -0.05) };
    let all = [Geometry::ORIGIN, behind, inside, Geometry::Monostatic, pair];
    for (array, geometries) in [(lattice, &all[..]), (scattered(40), &all[2..])] {
        for (i, &geometry) in geometries.iter().enumerate() {
            for (j, grid) in grids.iter().enumerate() {
                let cube = cube(&array, geometry, grid.position(grid.x.count / 3, 0, 3));
                let exact = reconstruct(&cube, grid, &options(Method::Direct, 1e-4)).unwrap();
                let tolerance = if (i + j) % 2 == 0 { 1e-2 } else { 1e-4 };
                let budget = ErrorBudget::new(tolerance);
                let weights = Weights::new(&cube.instrument, Window::Hann);
                for nodes in Upsampling::find(&cube.instrument, grid, budget) {
                    used += 1;
                    assert!(nodes.error.with(nodes.error.left(budget).all()) < 1.0001 * tolerance);
                    // The sum on the nodes is exact here, so that only interpolation errs.
                    let mut volume = Volume { grid: *grid, samples: Vec::new() };
                    let sink = &mut Resampled::new(nodes.onto_voxels(), &mut volume).unwrap();
                    let direct = options(Method::Direct, 1e-4);
                    reconstruct_into(&mut &cube, &nodes.coarse, &direct, sink, &Silent).unwrap();
                    let modulus: f64 = cube
                        .samples
                        .chunks_exact(array.len())
                        .enumerate()
                        .map(|(f, row)| weights.modulus(f, row))
                        .sum();
                    let error = difference(&volume, &exact.volume);
                    let most = nodes.error.own * modulus + 2e-6;
                    assert!(error <= most, "{:?} {geometry:?}: {error:e} above {most:e}", grid.shape());
                }
                for method in [Method::Convolution, Method::Backprojection] {
                    let found = reconstruct(&cube, grid, &options(method, tolerance)).unwrap();
                    let error = difference(&found.volume, &exact.volume);
                    let most = found.error_bound + 3e-6;
                    assert!(error <= most, "{method} {:?}: {error:e} above {most:e}", grid.shape());
                }
            }
        }
    }
    assert!(used >= 16, "{used} grids of nodes were found");
}

#[test]
fn depths_come_alike_in_any_parts_and_from_any_depth_on() {
    let grid = Grid { x: axis(-0.1, 0.002, 80), y: axis(-0.1, 0.002, 75), z: axis(0.7, 0.002, 91) };
    let cube = cube(&scattered(30), Geometry::ORIGIN, grid.position(9, 9, 30));
    let tolerances = [1e-2, 1e-3, 1e-4].into_iter();
    let found: Vec<Upsampling> =
        tolerances.flat_map(|all| Upsampling::find(&cube.instrument, &grid, ErrorBudget::new(all))).collect();
    let along_all = |nodes: &&Upsampling| nodes.axes.iter().all(|axis| axis.nodes.interpolates());
    let Some(nodes) = found.iter().find(along_all) else { panic!("the voxels are fine: {found:?}") };
    let coarse = reconstruct(&cube, &nodes.coarse, &options(Method::Direct, 1e-2)).unwrap();
    let plane = nodes.coarse.plane_len();
    let voxels = |parts: usize, done: usize| {
        let mut sink = ResumedVolume { volume: Volume { grid, samples: Vec::new() }, done };
        let mut upsampled = Resampled::new(nodes.onto_voxels(), &mut sink).unwrap();
        // As few are finished together as of wide planes, too.
        upsampled.together = upsampled.together.min(parts);
        upsampled.begin(&coarse.info()).unwrap();
        let all = 0..nodes.coarse.z.count;
        let skipped = upsampled.wanted(all.clone()).start / parts * parts;
        for (i, planes) in coarse.volume.samples.chunks(parts * plane).enumerate() {
            if i * parts >= skipped {
                upsampled.take(i * parts, planes).unwrap();
            }
        }
        assert!(upsampled.wanted(all).is_empty(), "all voxels were passed on");
        sink.volume.samples
    };
    let whole = voxels(nodes.coarse.z.count, 0);
    assert_eq!(whole.len(), 91 * grid.plane_len());
    for (parts, done) in [(1, 0), (3, 0), (8, 0), (17, 0), (1, 20), (5, 37), (1, 90), (9, 90), (4, 91)] {
        let some = voxels(parts, done);
        let from = done * grid.plane_len();
        assert!(
            some.get(from..).unwrap_or_default() == &whole[from..],
            "{parts} at a time from depth {done}"
        );
    }
}

#[test]
fn finished_depths_of_wide_planes_take_no_more_than_others() {
    let array = MicArray::rectangular([24, 24], [0.024, 0.024], DVec3::ZERO).unwrap();
    let instrument = Instrument::new(Sweep::stepped(10e3, 20e3, 40.0).unwrap(), array);
    let bytes = |count: usize| {
        let sideways = axis(-0.5, 1.0 / count as f64, count);
        let grid = Grid { x: sideways, y: sideways, z: axis(1.4, 0.001, 800) };
        let found = Upsampling::find(&instrument, &grid, ErrorBudget::new(1e-3));
        found.last().unwrap().voxel_bytes()(1)
    };
    // What is held of the nodes grows with the plane, 8 bytes for each of some tens of depths.
    let (narrow, wide) = (bytes(1000), bytes(2000));
    assert!(narrow < 400 << 20 && wide < 4 * narrow, "{narrow} {wide}");
}

#[test]
fn nothing_is_interpolated_where_voxels_are_few_or_no_error_is_allowed() {
    let lattice = MicArray::rectangular([16, 16], [0.01; 2], DVec3::ZERO).unwrap();
    let grid = Grid { x: axis(-0.2, 0.02, 20), y: axis(-0.2, 0.02, 20), z: axis(1.0, 0.02, 20) };
    let instrument = cube(&lattice, Geometry::ORIGIN, DVec3::Z).instrument;
    assert!(Upsampling::find(&instrument, &grid, ErrorBudget::new(0.0)).is_empty());
    let close = Grid { z: axis(0.0, 0.001, 60), ..grid };
    for nodes in Upsampling::find(&instrument, &close, ErrorBudget::new(1e-4)) {
        assert!(
            !nodes.axes[2].nodes.interpolates(),
            "a voxel in the plane of the microphones has no nodes behind it"
        );
    }
}

#[test]
fn nodes_within_the_voxels_are_fewer_and_as_exact() {
    let behind = Geometry::FixedSource { source: DVec3::new(0.1, 0.05, -0.2) };
    let pair = Geometry::Pair { offset: DVec3::new(0.1, -0.04, -0.05) };
    let long = Grid { x: axis(-0.3, 0.004, 150), y: axis(-0.2, 0.0037, 110), z: axis(0.7, 0.003, 90) };
    let near = Grid { x: axis(-0.1, 0.002, 90), y: axis(0.0, 0.01, 1), z: axis(0.01, 0.002, 120) };
    let short = Grid { x: axis(-0.1, 0.003, 60), y: axis(-0.1, 0.003, 70), z: axis(0.6, 0.004, 30) };
    let mut found = 0;
    for (array, geometry, grid, tolerance) in [
        (scattered(40), Geometry::ORIGIN, long, 1e-4),
        (scattered(20), Geometry::Monostatic, long, 1e-2),
        (scattered(33), behind, near, 1e-3),
        (scattered(24), pair, short, 1e-3),
    ] {
        let cube = cube(&array, geometry, grid.position(grid.x.count / 3, 0, 3));
        let (instrument, budget) = (&cube.instrument, ErrorBudget::new(tolerance));
        let Some(even) = Upsampling::find(instrument, &grid, budget).pop() else {
            continue;
        };
        let Some(nodes) = even.within_voxels(instrument, budget) else { continue };
        found += 1;
        let fewest = even.coarse.voxel_count().min(grid.voxel_count());
        assert!(nodes.coarse.voxel_count() < fewest, "{:?} of {:?}", nodes.coarse.shape(), grid.shape());
        for (axis, voxels) in nodes.axes.iter().zip([grid.x, grid.y, grid.z]) {
            let Some([first, .., last]) = axis.nodes.uneven() else { continue };
            assert!(*first >= voxels.first && *last <= voxels.last() + 1e-12);
        }
        let left = nodes.error.left(budget);
        assert!(nodes.error.with(left.all()) < 1.0001 * tolerance);
        let plan = BackprojectionPlan::new(instrument, nodes.places(), left, 0.0);
        compare_with_direct_sum(
            &Sampled { upsampling: Some(nodes), plan },
            &cube,
            &grid,
            budget,
            backprojection,
        );
    }
    assert!(found >= 3, "{found} of 4");
}

#[test]
fn errors_are_the_same_whichever_place_is_tried_first() {
    let grid = Grid { x: axis(-0.3, 0.004, 150), y: axis(-0.2, 0.0037, 110), z: axis(0.7, 0.003, 90) };
    let cube = cube(&scattered(40), Geometry::ORIGIN, grid.position(50, 0, 3));
    let (instrument, budget) = (&cube.instrument, ErrorBudget::new(1e-3));
    let terms = SampledTerms::new(instrument, &grid);
    let even = Upsampling::find(instrument, &grid, budget).pop().unwrap();
    let uneven = even.within_voxels(instrument, budget).unwrap();
    let axes = [even, uneven].into_iter().flat_map(|nodes| nodes.axes.into_iter().enumerate());
    for (axis, Measured { nodes, error }) in axes {
        for first in [0, 1, 17, 100, 1_000_003] {
            let mut hardest = first;
            assert_eq!(terms.error(axis, &nodes, &mut hardest, |_| true), Some(error));
            assert_eq!(hardest, first);
            // What fails does so at once with the place that is then known.
            let most = 0.7 * error[0];
            assert_eq!(terms.error(axis, &nodes, &mut hardest, |[error, _]| error <= most), None);
            let known = hardest;
            let tried = Cell::new(0);
            let counted = |[error, _]: [f64; 2]| {
                tried.set(tried.get() + 1);
                error <= most
            };
            assert_eq!(terms.error(axis, &nodes, &mut hardest, counted), None);
            assert_eq!(hardest, known);
            // Both ends of the band, nine places all over the array and the nearest.
            assert!(tried.get() <= 2 * 10, "{} terms of the first place", tried.get());
        }
    }
}

#[test]
fn depths_within_the_voxels_are_fewer_and_as_exact() {
    let lattice = MicArray::rectangular([9, 7], [0.05; 2], DVec3::new(0.01, -0.02, 0.0)).unwrap();
    let long = Grid { x: axis(-0.1, 0.0125, 17), y: axis(-0.1, 0.0125, 15), z: axis(0.7, 0.003, 150) };
    let fine = Grid { x: axis(-0.1, 0.004, 50), y: axis(-0.1, 0.004, 45), z: axis(0.6, 0.004, 110) };
    let mut found = 0;
    for (array, geometry, grid, tolerance) in [
        (&lattice, Geometry::ORIGIN, long, 1e-4),
        (&lattice, Geometry::Monostatic, fine, 1e-3),
        (&scattered(30), Geometry::ORIGIN, fine, 1e-4),
        (&lattice, Geometry::Pair { offset: DVec3::new(0.1, -0.04, -0.05) }, fine, 1e-2),
    ] {
        let cube = cube(array, geometry, grid.position(grid.x.count / 3, 0, 3));
        let (instrument, budget) = (&cube.instrument, ErrorBudget::new(tolerance));
        // Of other nodes, and of the voxels themselves.
        for even in [Upsampling::find(instrument, &grid, budget).pop(), None] {
            let Some(nodes) = Upsampling::depths_within(even.as_ref(), (instrument, &grid), budget) else {
                continue;
            };
            found += 1;
            let fewest = even.as_ref().map_or(grid.z, |even| even.coarse.z).count.min(grid.z.count);
            assert!(nodes.coarse.z.count < fewest, "{:?} of {:?}", nodes.coarse.shape(), grid.shape());
            let Some([first, .., last]) = nodes.axes[2].nodes.uneven() else { panic!("depths are even") };
            assert!(*first >= grid.z.first && *last <= grid.z.last() + 1e-12);
            let left = nodes.error.left(budget);
            // With the tones of all slabs made of the volume's, and of those of stretches.
            for stretch in [usize::MAX, 1, 2] {
                let lattice = SharedLattice::find(instrument, &nodes.places(), left).unwrap().remove(0);
                let plan = ConvolutionPlan::new(instrument, nodes.places(), lattice, left);
                let plan = plan.in_stretches(stretch);
                let sampled = Sampled { upsampling: Some(nodes.clone()), plan };
                compare_with_direct_sum(&sampled, &cube, &grid, budget, convolution);
            }
        }
    }
    assert!(found >= 6, "{found} of 8");
}

/// Nodes that a method sums err as a bound says.
fn compare_with_direct_sum<P>(
    sampled: &Sampled<P>,
    cube: &DataCube,
    grid: &Grid,
    budget: ErrorBudget,
    method: fn(Job<'_>, &P) -> Result<ReconstructionInfo>,
) {
    let mut volume = Volume { grid: *grid, samples: Vec::new() };
    let job = Job {
        source: &mut &*cube,
        kept: KeptTones::default(),
        weights: &Weights::new(&cube.instrument, Window::Hann),
        grid,
        budget,
        interpolation: InterpolationError::NONE,
        batch: Batch::LEAST,
        sink: &mut volume,
        observer: &Silent,
    };
    let info = on_nodes(sampled, job, method).unwrap();
    let exact = reconstruct(cube, grid, &options(Method::Direct, 1e-4)).unwrap();
    let error = difference(&volume, &exact.volume);
    let geometry = cube.instrument.geometry;
    assert!(error <= info.error_bound + 3e-6, "{geometry:?}: {error:e} above {:e}", info.error_bound);
    assert!(error > 0.0, "another sum than the direct one");
}
