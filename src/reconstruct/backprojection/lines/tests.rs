//! Back-projection by lines against the literal sum.

use super::*;
use crate::acquisition::{DataCube, Instrument, MicArray, Sweep};
use crate::grid::{Axis, Grid, Volume};
use crate::progress::Silent;
use crate::reconstruct::compress::KeptTones;
use crate::reconstruct::error_budget::ErrorBudget;
use crate::reconstruct::job::Job;
use crate::reconstruct::upsampling::InterpolationError;
use crate::reconstruct::volume::{Batch, ResumedVolume};
use crate::reconstruct::window::Weights;
use crate::reconstruct::{Method, ReconstructOptions, ReconstructionInfo, VolumeSink, Window, reconstruct};
use crate::wave::{Geometry, phasor};
use glam::DVec3;

fn axis(first: f64, pitch: f64, count: usize) -> Axis {
    Axis { first, pitch, count }
}

const GEOMETRIES: [Geometry; 5] = [
    Geometry::ORIGIN,
    Geometry::Monostatic,
    Geometry::FixedSource { source: DVec3::new(0.3, -0.2, -0.1) },
    Geometry::Pair { offset: DVec3::new(-0.07, 0.0, 0.0) },
    Geometry::Pair { offset: DVec3::new(0.0, 0.3, 0.0) },
];

/// What a lattice of microphones hears of a point, where all terms are in phase.
fn echo(count: [usize; 2], even: bool, geometry: Geometry, point: DVec3) -> DataCube {
    let array = MicArray::rectangular(count, [0.031, 0.043], DVec3::new(0.02, -0.05, 0.01)).expect("valid");
    let uneven = |n: u32| if even { 0.0 } else { (f64::from(n) * 0.618_034).fract() - 0.5 };
    let frequencies: Vec<f64> = (1..40).map(|n| 8_000.0 + 200.0 * (f64::from(n) + uneven(n))).collect();
    let sample = |f: &f64, r: &DVec3| phasor(f / 343.0 * geometry.path_length(point, *r));
    let samples = frequencies.iter().flat_map(|f| array.positions().iter().map(move |r| sample(f, r)));
    let samples = samples.collect();
    let sweep = Sweep::from_frequencies(frequencies.clone()).expect("valid");
    DataCube::new(Instrument::new(sweep, array).with_geometry(geometry), samples).expect("finite")
}

fn plan(cube: &DataCube, grid: &Grid, tolerance: f64) -> Option<LinesPlan> {
    LinesPlan::find(&cube.instrument, grid, ErrorBudget::new(tolerance), f64::INFINITY).ok()
}

fn by_lines(
    cube: &DataCube,
    grid: &Grid,
    plan: &LinesPlan,
    tolerance: f64,
    sink: &mut dyn VolumeSink,
) -> ReconstructionInfo {
    let weights = Weights::new(&cube.instrument, Window::Hann);
    let job = Job {
        kept: KeptTones::default(),
        source: &mut &*cube,
        weights: &weights,
        grid,
        budget: ErrorBudget::new(tolerance),
        interpolation: InterpolationError::NONE,
        batch: Batch::of_threads(2),
        sink,
        observer: &Silent,
    };
    image(plan, job).expect("little")
}

#[test]
fn lines_keep_their_bound_along_both_axes_and_on_any_grid() {
    let (x, y, z) = (axis(-0.15, 0.0071, 37), axis(-0.1, 0.009, 23), axis(0.8, 0.011, 25));
    let grids = [
        Grid { x, y, z },
        Grid { x, y: axis(0.07, 0.005, 1), z },
        Grid { x: axis(0.1, 0.1, 3), y, z: Axis { count: 70, ..z } },
        Grid { x, y, z: Axis { count: 1, ..z } },
        Grid { x: axis(0.9, 0.01, 20), y, z: axis(0.35, 0.011, 30) },
    ];
    let mut along = [0; 2];
    for (i, geometry) in GEOMETRIES.into_iter().enumerate() {
        for grid in grids {
            let point = grid.position(grid.x.count / 3, grid.y.count / 2, 2 * grid.z.count / 3);
            let count = if i == 2 { [7, 18] } else { [13, 6] };
            let cube = echo(count, i != 1, geometry, point);
            let direct = ReconstructOptions::new(Method::Direct, Window::Hann);
            let direct = reconstruct(&cube, &grid, &direct).expect("little").volume;
            for tolerance in [1e-2, 1e-4] {
                let Some(plan) = plan(&cube, &grid, tolerance) else {
                    panic!("no lines at {tolerance} for {geometry:?} and {grid:?}")
                };
                along[plan.view.along] += 1;
                let mut volume = Volume { grid, samples: Vec::new() };
                let info = by_lines(&cube, &grid, &plan, tolerance, &mut volume);
                assert!(info.error_bound <= tolerance * 1.000_1, "{:e} of {tolerance:e}", info.error_bound);
                let each = volume.samples.iter().zip(&direct.samples).map(|(a, b)| (a - b).norm());
                let worst = f64::from(each.fold(0.0, f32::max));
                assert!(worst <= info.error_bound + 3e-6, "{worst:e} above {:e}", info.error_bound);
                assert!((volume.peak() - 1.0).abs() < 1e-2, "the point is a voxel");
            }
        }
    }
    assert!(along[0] > 0 && along[1] > 0, "{along:?}");
}

#[test]
fn depths_come_alike_in_any_slabs_and_from_any_depth_on() {
    let grid = Grid { x: axis(-0.2, 0.007, 40), y: axis(-0.1, 0.005, 31), z: axis(0.5, 0.007, 90) };
    for geometry in GEOMETRIES {
        let cube = echo([9, 7], true, geometry, DVec3::new(0.01, 0.02, 0.8));
        let plan = plan(&cube, &grid, 1e-3).expect("a lattice");
        let volume = |at_once: usize, done: usize| {
            let plan = LinesPlan { at_once, ..plan.clone() };
            let mut rest = ResumedVolume { volume: Volume { grid, samples: Vec::new() }, done };
            by_lines(&cube, &grid, &plan, 1e-3, &mut rest);
            rest.volume.samples
        };
        let whole = volume(90, 0);
        for (at_once, done) in [(30, 0), (30, 60), (17, 0), (1, 89)] {
            let from = done * grid.plane_len();
            assert!(volume(at_once, done)[from..] == whole[from..], "{at_once} from {done}");
        }
    }
}

#[test]
fn there_are_none_without_a_lattice_or_beside_the_lines() {
    let cube = echo([8, 8], true, Geometry::ORIGIN, DVec3::Z);
    let at = |z: f64| Grid { x: axis(-0.1, 0.004, 50), y: axis(-0.1, 0.004, 50), z: axis(z, 0.01, 4) };
    assert!(plan(&cube, &at(0.5), 1e-4).is_some());
    assert!(plan(&cube, &at(0.01), 1e-4).is_none());
    let pair = |x, y, z| Geometry::Pair { offset: DVec3::new(x, y, z) };
    for (geometry, on_lines) in
        [(pair(0.1, 0.0, 0.0), true), (pair(0.1, 0.01, 0.0), false), (pair(0.1, 0.0, -0.01), false)]
    {
        assert_eq!(plan(&echo([8, 8], true, geometry, DVec3::Z), &at(0.5), 1e-4).is_some(), on_lines);
    }
    let scattered = MicArray::spiral(64, [0.3; 2], DVec3::ZERO).expect("valid");
    let instrument = Instrument { array: scattered, ..cube.instrument };
    assert!(LinesPlan::find(&instrument, &at(0.5), ErrorBudget::new(1e-4), f64::INFINITY).is_err());
}
