//! Back-projection by tiles against the literal sum.

use super::*;
use crate::acquisition::{DataCube, Instrument, MicArray, Sweep};
use crate::grid::{Axis, Volume};
use crate::progress::Silent;
use crate::reconstruct::compress::KeptTones;
use crate::reconstruct::upsampling::InterpolationError;
use crate::reconstruct::volume::{Batch, ResumedVolume};
use crate::reconstruct::window::Weights;
use crate::reconstruct::{ReconstructOptions, VolumeSink, Window, reconstruct};
use crate::wave::phasor;

fn fraction(i: usize, k: f64) -> f64 {
    (i as f64 * k).fract() - 0.5
}

fn axis(first: f64, pitch: f64, count: usize) -> Axis {
    Axis { first, pitch, count }
}

/// What microphones all over a bent plate hear of a point, where all terms are in phase.
fn echo(count: usize, even: bool, geometry: Geometry, point: DVec3) -> DataCube {
    let place = |i: usize| {
        let (x, y) = (0.5 * fraction(i, 0.618_034), 0.3 * fraction(i, 0.754_878));
        DVec3::new(x - 0.1, y, 0.6 * x * x + 0.02 * fraction(i, 0.569_84))
    };
    let positions: Vec<DVec3> = (0..count).map(place).collect();
    let uneven = |n: u32| if even { 0.0 } else { fraction(n as usize, 0.618_034) };
    let frequencies: Vec<f64> = (1..40).map(|n| 8_000.0 + 200.0 * (f64::from(n) + uneven(n))).collect();
    let sample = |f: &f64, r: &DVec3| phasor(f / 343.0 * geometry.path_length(point, *r));
    let samples = frequencies.iter().flat_map(|f| positions.iter().map(move |r| sample(f, r))).collect();
    let array = MicArray::from_positions(positions.clone()).expect("valid");
    let sweep = Sweep::from_frequencies(frequencies.clone()).expect("valid");
    DataCube::new(Instrument::new(sweep, array).with_geometry(geometry), samples).expect("finite")
}

fn grids() -> [Grid; 4] {
    let (x, y, z) = (axis(-0.15, 0.0025, 80), axis(-0.1, 0.003, 50), axis(0.8, 0.011, 25));
    [
        Grid { x, y, z },
        Grid { x, y: axis(0.07, 0.005, 1), z },
        Grid { x: axis(0.1, 0.1, 3), y, z: Axis { count: 70, ..z } },
        Grid { x, y, z: Axis { count: 1, ..z } },
    ]
}

/// The band of nodes that is assumed when work is estimated.
fn usual_band(cube: &DataCube, points: &GridPlaces, budget: ErrorBudget) -> Band {
    let band = Division::new(&cube.instrument, points, budget).band;
    Band { tolerance: factorised::usual_budget(budget).series(), ..band }
}

fn search<'a>(cube: &'a DataCube, points: &'a GridPlaces, budget: ErrorBudget) -> TileSearch<'a> {
    TileSearch::new(&cube.instrument, points, usual_band(cube, points, budget))
}

fn levels(cube: &DataCube, points: &GridPlaces, tolerance: f64) -> Option<TileLevels> {
    let budget = ErrorBudget::new(tolerance);
    search(cube, points, budget).find(budget, f64::INFINITY).expect("little")
}

/// With each number of sizes, whatever they err by.
fn of_each_depth(cube: &DataCube, points: &GridPlaces, tolerance: f64) -> Vec<TileLevels> {
    let budget = ErrorBudget::new(tolerance);
    let search = search(cube, points, budget);
    let of = |further: u32| (0..4).find_map(|least| search.between(2 * least, 2 * (least + further), budget));
    let measured = |levels: TileLevels| search.measured(levels).expect("little");
    (0..3).filter_map(of).filter_map(measured).collect()
}

fn tiled(
    cube: &DataCube,
    points: &GridPlaces,
    levels: &TileLevels,
    tolerance: f64,
    sink: &mut dyn VolumeSink,
) -> ReconstructionInfo {
    let (instrument, grid) = (&cube.instrument, points.grid());
    let weights = Weights::new(instrument, Window::Hann);
    let budget = ErrorBudget::new(tolerance);
    let band = Division::new(instrument, points, budget).band;
    let tiled = Tiled::new(levels, instrument, points, band);
    let (source, weights, batch) = (&mut &*cube, &weights, Batch::of_threads(2));
    let interpolation = InterpolationError::NONE;
    let kept = KeptTones::default();
    let job = Job { source, kept, weights, grid, budget, interpolation, batch, sink, observer: &Silent };
    tiled.image(job).expect("little")
}

/// The largest difference of two volumes.
fn worst(a: &Volume, b: &Volume) -> f64 {
    let each = a.samples.iter().zip(&b.samples).map(|(a, b)| (a - b).norm());
    f64::from(each.fold(0.0, f32::max))
}

#[test]
fn tiles_keep_their_bound_on_bent_arrays_and_any_grid() {
    let geometries = [
        Geometry::ORIGIN,
        Geometry::Monostatic,
        Geometry::FixedSource { source: DVec3::new(0.3, -0.2, -0.1) },
    ];
    for (i, geometry) in geometries.into_iter().enumerate() {
        for grid in grids() {
            let point = grid.position(grid.x.count / 3, grid.y.count / 2, 2 * grid.z.count / 3);
            let cube = echo(200, i != 1, geometry, point);
            let direct = ReconstructOptions::new(Method::Direct, Window::Hann);
            let direct = reconstruct(&cube, &grid, &direct).expect("little").volume;
            let points = GridPlaces::even(&grid);
            for tolerance in [1e-2, 1e-4] {
                let Some(levels) = levels(&cube, &points, tolerance) else {
                    panic!("no tiles at {tolerance} for {geometry:?} and {grid:?}")
                };
                let mut volume = Volume { grid, samples: Vec::new() };
                let info = tiled(&cube, &points, &levels, tolerance, &mut volume);
                assert!(info.error_bound <= tolerance * 1.000_1, "{:e} of {tolerance:e}", info.error_bound);
                let worst = worst(&volume, &direct);
                assert!(worst <= info.error_bound + 3e-6, "{worst:e} above {:e}", info.error_bound);
                assert!((volume.peak() - 1.0).abs() < 1e-2, "the point is a voxel");
            }
        }
    }
}

#[test]
fn tiles_keep_their_bound_with_fewer_nodes_where_they_are_far_away() {
    let (x, y) = (axis(-0.3, 0.006, 100), axis(-0.25, 0.01, 50));
    let grid = Grid { x, y, z: axis(0.7, 0.02, 90) };
    for (geometry, point) in
        [(Geometry::ORIGIN, grid.position(20, 30, 80)), (Geometry::Monostatic, grid.position(90, 5, 4))]
    {
        let cube = echo(200, true, geometry, point);
        let direct = ReconstructOptions::new(Method::Direct, Window::Hann);
        let direct = reconstruct(&cube, &grid, &direct).expect("little").volume;
        let points = GridPlaces::even(&grid);
        for tolerance in [1e-2, 1e-4] {
            let levels = levels(&cube, &points, tolerance).expect("tiles");
            let mut columns = Vec::new();
            for zone in &levels.levels[0].zones {
                columns.push(zone.columns());
            }
            assert!(columns.len() > 2 && columns.is_sorted_by(|near, far| far <= near), "{columns:?}");
            assert!(2 * columns[columns.len() - 1] < columns[0], "{columns:?}");
            let mut volume = Volume { grid, samples: Vec::new() };
            let info = tiled(&cube, &points, &levels, tolerance, &mut volume);
            let worst = worst(&volume, &direct);
            assert!(info.error_bound <= tolerance * 1.000_1 && worst <= info.error_bound + 3e-6, "{worst:e}");
        }
    }
}

/// As many points within a grid, here and there denser.
fn denser(grid: &Grid) -> GridPlaces {
    let along = |axis: Axis| -> Vec<f64> {
        let step = |k: usize| 0.8 * (k as f64 + 0.2 * (k as f64).sin());
        (0..axis.count).map(|k| axis.first + axis.pitch * step(k)).collect()
    };
    let [x, y, z] = [grid.x, grid.y, grid.z].map(along);
    GridPlaces::uneven(grid, [Some(&x[..]), Some(&y), Some(&z)])
}

#[test]
fn uneven_points_keep_the_bound() {
    let [grid, ..] = grids();
    let points = denser(&grid);
    let at = [30, 20, 17];
    for geometry in [Geometry::ORIGIN, Geometry::Monostatic] {
        let cube = echo(200, true, geometry, points.position(at));
        let levels = levels(&cube, &points, 1e-3).expect("fine voxels");
        let mut volume = Volume { grid, samples: Vec::new() };
        let info = tiled(&cube, &points, &levels, 1e-3, &mut volume);
        let (mut worst, mut peak) = (0.0f32, 0.0f32);
        for i in 0..=60 {
            let [x, y, z] = if i == 0 { at } else { [7 * i % 80, 11 * i % 50, 13 * i % 25] };
            let p = points.position([x, y, z]);
            let only = Grid { x: axis(p.x, 1.0, 1), y: axis(p.y, 1.0, 1), z: axis(p.z, 1.0, 1) };
            let direct = ReconstructOptions::new(Method::Direct, Window::Hann);
            let direct = reconstruct(&cube, &only, &direct).expect("little").volume.samples[0];
            worst = worst.max((direct - volume.samples[(z * grid.y.count + y) * grid.x.count + x]).norm());
            peak = peak.max(direct.norm());
        }
        assert!(f64::from(worst) <= info.error_bound + 3e-6, "{worst:e} above {:e}", info.error_bound);
        assert!(info.error_bound <= 1e-3 && (peak - 1.0).abs() < 1e-2);
    }
}

#[test]
fn taps_of_one_vector_and_of_two_keep_what_was_measured() {
    let grid = Grid { x: axis(-0.15, 0.003, 60), y: axis(-0.1, 0.003, 50), z: axis(0.8, 0.011, 70) };
    let (points, budget) = (GridPlaces::even(&grid), ErrorBudget::new(1e-4));
    let cube = echo(150, true, Geometry::ORIGIN, grid.position(20, 40, 50));
    let direct = ReconstructOptions::new(Method::Direct, Window::Hann);
    let direct = reconstruct(&cube, &grid, &direct).expect("little").volume;
    let search = search(&cube, &points, budget);
    for wide in [false, true] {
        let own = |levels: &TileLevels| levels.levels.iter().all(|of| (of.taps.count() > LANES) == wide);
        let levels = search.fewest(budget, own).expect("fine voxels");
        let levels = search.measured(levels).expect("little").expect("places");
        let mut volume = Volume { grid, samples: Vec::new() };
        let info = tiled(&cube, &points, &levels, 1e-3, &mut volume);
        let worst = worst(&volume, &direct);
        assert!(worst <= info.error_bound && levels.error < 3e-4, "{worst:e}, {:e}", levels.error);
    }
}

#[test]
fn tiles_of_tiles_keep_what_was_measured() {
    let grid = Grid { x: axis(-0.15, 0.003, 60), y: axis(-0.1, 0.003, 50), z: axis(0.8, 0.011, 70) };
    for geometry in [Geometry::ORIGIN, Geometry::Monostatic] {
        let cube = echo(300, true, geometry, grid.position(20, 40, 50));
        let direct = ReconstructOptions::new(Method::Direct, Window::Hann);
        let direct = reconstruct(&cube, &grid, &direct).expect("little").volume;
        let points = GridPlaces::even(&grid);
        let all = of_each_depth(&cube, &points, 1e-3);
        assert_eq!(all.iter().map(|levels| levels.levels.len()).collect::<Vec<_>>(), [1, 2, 3]);
        for levels in all {
            // In slabs of their own too.
            for (at_once, slab) in [(levels.at_once, levels.slab), (32, 64), (20, 20)] {
                let levels = TileLevels { at_once, slab, ..levels.clone() };
                let mut volume = Volume { grid, samples: Vec::new() };
                let info = tiled(&cube, &points, &levels, 1e-2, &mut volume);
                let worst = worst(&volume, &direct);
                assert!(worst <= info.error_bound, "{worst:e} above {:e}", info.error_bound);
                assert!(levels.error < 2e-3, "{:e}", levels.error);
            }
        }
    }
}

#[test]
fn resumed_depths_are_bit_identical() {
    let cube = echo(120, true, Geometry::ORIGIN, DVec3::new(0.01, 0.02, 0.8));
    let grid = Grid { x: axis(-0.2, 0.004, 70), y: axis(-0.1, 0.005, 51), z: axis(0.5, 0.007, 150) };
    let points = GridPlaces::even(&grid);
    let levels = levels(&cube, &points, 1e-3).expect("fine voxels");
    for slab in [1, 2, 4].map(|times| times * 50) {
        let levels = TileLevels { at_once: 50, slab, ..levels.clone() };
        let mut whole = Volume { grid, samples: Vec::new() };
        tiled(&cube, &points, &levels, 1e-3, &mut whole);
        for done in [50, 100] {
            let mut rest = ResumedVolume { volume: Volume { grid, samples: Vec::new() }, done };
            tiled(&cube, &points, &levels, 1e-3, &mut rest);
            let from = done * grid.plane_len();
            assert!(rest.volume.samples[from..] == whole.samples[from..]);
        }
    }
}

#[test]
fn coarse_voxels_and_those_beside_microphones_have_no_tiles() {
    let array = MicArray::rectangular([8, 8], [0.03; 2], DVec3::ZERO).expect("valid");
    let sweep = Sweep::stepped(8_000.0, 16_000.0, 100.0).expect("valid");
    let samples = vec![Complex32::ONE; sweep.len() * array.len()];
    let cube = DataCube::new(Instrument::new(sweep, array), samples).expect("finite");
    let found = |pitch: f64, z: f64| {
        let grid = Grid { x: axis(-0.2, pitch, 64), y: axis(-0.2, pitch, 64), z: axis(z, 0.01, 4) };
        levels(&cube, &GridPlaces::even(&grid), 1e-4).is_some()
    };
    assert!(found(0.004, 0.5));
    assert!(!found(0.05, 0.5));
    assert!(!found(0.004, 0.0));
}
