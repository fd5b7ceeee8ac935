//! Back-projection by tiles against the literal sum.

use super::factorised::Halvings;
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
fn usual_band(cube: &DataCube, grid: &Grid, budget: ErrorBudget) -> Band {
    let band = Division::new(&cube.instrument, &GridPlaces::even(grid), budget).band;
    Band { tolerance: factorised::usual_budget(budget).series(), ..band }
}

fn levels(cube: &DataCube, grid: &Grid, tolerance: f64) -> Option<TileLevels> {
    let budget = ErrorBudget::new(tolerance);
    let band = usual_band(cube, grid, budget);
    TileLevels::find(&cube.instrument, grid, &band, budget, f64::INFINITY).expect("little")
}

/// The cheapest of those with each number of sizes, whatever they err by.
fn of_each_depth(cube: &DataCube, grid: &Grid, tolerance: f64) -> Vec<TileLevels> {
    let budget = ErrorBudget::new(tolerance);
    let (instrument, band) = (&cube.instrument, usual_band(cube, grid, budget));
    let halvings = Halvings::of(instrument);
    let all = TileLevels::sequences(instrument, grid, &band, budget, &halvings);
    let of = |depth: usize| all.iter().find(|levels| levels.levels.len() == depth).cloned();
    let measured = |levels: TileLevels| levels.measured(instrument, grid, &halvings).expect("little");
    (1..6).filter_map(of).filter_map(measured).collect()
}

fn tiled(
    cube: &DataCube,
    grid: &Grid,
    levels: &TileLevels,
    tolerance: f64,
    sink: &mut dyn VolumeSink,
) -> ReconstructionInfo {
    let instrument = &cube.instrument;
    let weights = Weights::new(instrument, Window::Hann);
    let budget = ErrorBudget::new(tolerance);
    let band = Division::new(instrument, &GridPlaces::even(grid), budget).band;
    let tiled = Tiled::new(levels, instrument, grid, band);
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
            for tolerance in [1e-2, 1e-4] {
                let Some(levels) = levels(&cube, &grid, tolerance) else {
                    panic!("no tiles at {tolerance} for {geometry:?} and {grid:?}")
                };
                let mut volume = Volume { grid, samples: Vec::new() };
                let info = tiled(&cube, &grid, &levels, tolerance, &mut volume);
                assert!(info.error_bound <= tolerance * 1.000_1, "{:e} of {tolerance:e}", info.error_bound);
                let worst = worst(&volume, &direct);
                assert!(worst <= info.error_bound + 3e-6, "{worst:e} above {:e}", info.error_bound);
                assert!((volume.peak() - 1.0).abs() < 1e-2, "the point is a voxel");
            }
        }
    }
}

#[test]
fn tiles_of_tiles_keep_what_was_measured() {
    let grid = Grid { x: axis(-0.15, 0.003, 60), y: axis(-0.1, 0.003, 50), z: axis(0.8, 0.011, 70) };
    for geometry in [Geometry::ORIGIN, Geometry::Monostatic] {
        let cube = echo(300, true, geometry, grid.position(20, 40, 50));
        let direct = ReconstructOptions::new(Method::Direct, Window::Hann);
        let direct = reconstruct(&cube, &grid, &direct).expect("little").volume;
        let all = of_each_depth(&cube, &grid, 1e-3);
        assert!(all.len() >= 3, "{}", all.len());
        for levels in all {
            // In slabs of their own too.
            for (at_once, slab) in [(levels.at_once, levels.slab), (32, 64), (20, 20)] {
                let levels = TileLevels { at_once, slab, ..levels.clone() };
                let mut volume = Volume { grid, samples: Vec::new() };
                let info = tiled(&cube, &grid, &levels, 1e-2, &mut volume);
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
    let levels = levels(&cube, &grid, 1e-3).expect("fine voxels");
    for slab in [1, 2, 4].map(|times| times * 50) {
        let levels = TileLevels { at_once: 50, slab, ..levels.clone() };
        let mut whole = Volume { grid, samples: Vec::new() };
        tiled(&cube, &grid, &levels, 1e-3, &mut whole);
        for done in [50, 100] {
            let mut rest = ResumedVolume { volume: Volume { grid, samples: Vec::new() }, done };
            tiled(&cube, &grid, &levels, 1e-3, &mut rest);
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
        levels(&cube, &grid, 1e-4).is_some()
    };
    assert!(found(0.004, 0.5));
    assert!(!found(0.05, 0.5));
    assert!(!found(0.004, 0.0));
}
