//! Sums over loudspeakers against sums written out, by every method; resumed, reversed, by slabs, and of a moved pair.

#![allow(clippy::unwrap_used)]

use super::*;
use crate::acquisition::Sweep;
use crate::grid::Volume;
use crate::progress::Silent;
use crate::reconstruct::volume::ResumedVolume;
use crate::reconstruct::volume::fixtures::{axis, cube, lattice, scattered};
use crate::reconstruct::{RefineOptions, Solver, estimate, reconstruct, reconstruct_into};
use crate::wave::Geometry;
use glam::DVec3;
use num_complex::Complex64;
use std::f64::consts::TAU;

fn instrument(array: MicArray) -> Instrument {
    Instrument::new(Sweep::stepped(8_000.0, 14_000.0, 200.0).unwrap(), array)
}

const SOURCES: [DVec3; 3] =
    [DVec3::new(0.2, 0.0, 0.0), DVec3::new(-0.3, 0.1, 0.02), DVec3::new(0.05, -0.25, -0.1)];

/// The equation of the module, written out, with the path of the literal definition.
fn literal(cube: &DataCube, path: impl Fn(usize, DVec3) -> f64) -> Complex64 {
    let Instrument { sweep, array, sound_speed, .. } = &cube.instrument;
    let (mut sum, mut samples) = (Complex64::ZERO, cube.samples.iter());
    for tx in 0..cube.instrument.transmissions() {
        for f in sweep.frequencies() {
            for r in array.positions() {
                let m = samples.next().unwrap();
                let turned = Complex64::cis(-TAU * f * path(tx, *r) / sound_speed);
                sum += Complex64::new(m.re.into(), m.im.into()) * turned;
            }
        }
    }
    sum / cube.samples.len() as f64
}

/// The largest difference of any voxel from the literal sum, relative to the largest amplitude.
fn error(cube: &DataCube, volume: &Volume, path: impl Fn(DVec3, usize, DVec3) -> f64) -> f64 {
    let [n_z, n_y, n_x] = volume.grid.shape();
    let mut worst = 0.0_f64;
    for (i, a) in volume.samples.iter().enumerate() {
        let p = volume.grid.position(i % n_x, i / n_x % n_y, i / n_x / n_y);
        let exact = literal(cube, |tx, r| path(p, tx, r));
        worst = worst.max((Complex64::new(a.re.into(), a.im.into()) - exact).norm());
    }
    assert_eq!(volume.samples.len(), n_x * n_y * n_z);
    worst / f64::from(volume.peak())
}

fn small_grid() -> Grid {
    Grid { x: axis(-0.12, 0.03, 9), y: axis(-0.11, 0.03, 7), z: axis(0.6, 0.012, 5) }
}

#[test]
fn several_sources_are_their_coherent_sum_by_every_method() {
    for (array, count, methods) in [
        (lattice([6, 5]), 2, &[Method::Direct, Method::Convolution, Method::Backprojection][..]),
        (scattered(23), 3, &[Method::Direct, Method::Backprojection]),
    ] {
        let cube = cube(instrument(array).with_sources(&SOURCES[..count]).unwrap());
        let path = |p: DVec3, tx: usize, r: DVec3| p.distance(SOURCES[tx]) + p.distance(r);
        for method in methods {
            let options = ReconstructOptions::new(*method, Window::None).with_tolerance(1e-5);
            let found = reconstruct(&cube, &small_grid(), &options).unwrap();
            assert_eq!(found.method, *method);
            let error = error(&cube, &found.volume, path);
            assert!(error < 1e-4, "{method} of {count}: {error:e}");
            assert!(error * f64::from(found.volume.peak()) < found.error_bound + 1e-6);
        }
    }
}

/// Instruments whose transmissions share kernels, in every way that a convolution has.
fn sharing() -> Vec<(&'static str, Instrument, Grid)> {
    let of = |array, sources: &[DVec3]| instrument(array).with_sources(sources).unwrap();
    let line = MicArray::rectangular([9, 1], [0.02; 2], DVec3::ZERO).unwrap();
    let flat = scattered(23).positions().iter().map(|r| r.with_z(0.0)).collect();
    let many: Vec<DVec3> = (0..9).map(|i| SOURCES[i % 3] * (1.0 - 0.1 * i as f64)).collect();
    let steel = crate::wave::Interface { depth: 0.63, sound_speed: 800.0 };
    let near = Grid { z: axis(0.01, 0.04, 5), ..small_grid() };
    let flat_line = Grid { x: axis(-0.15, 0.02, 16), y: axis(0.0, 0.03, 1), ..small_grid() };
    vec![
        ("lattice", of(lattice([6, 5]), &SOURCES), small_grid()),
        ("two groups", of(lattice([6, 5]), &many), small_grid()),
        ("finer voxels", of(lattice([6, 5]), &SOURCES), Grid { x: axis(-0.1, 0.01, 14), ..small_grid() }),
        ("scattered, near", of(MicArray::from_positions(flat).unwrap(), &SOURCES), near),
        ("two media", of(lattice([6, 5]), &SOURCES).with_interface(Some(steel)), small_grid()),
        ("line", of(line, &SOURCES), flat_line),
    ]
}

#[test]
fn transmissions_that_share_kernels_are_their_literal_sum() {
    for (name, instrument, grid) in sharing() {
        let cube = cube(instrument);
        let options = ReconstructOptions::new(Method::Convolution, Window::None).with_tolerance(1e-5);
        let course = Course::new(&cube.instrument, &grid, &options, 2).unwrap();
        let count = cube.instrument.transmissions();
        assert_eq!(runs(count, course.group).count(), count.div_ceil(8), "{name}");
        let found = reconstruct(&cube, &grid, &options).unwrap();
        let path = |p: DVec3, tx: usize, r: DVec3| cube.instrument.transmission(tx).path_length(p, r);
        let error = error(&cube, &found.volume, path);
        assert!(error < 1e-4, "{name}: {error:e}");
        // The bound is the one measured, not what is allowed.
        let modulus =
            cube.samples.iter().map(|m| f64::from(m.norm())).sum::<f64>() / cube.samples.len() as f64;
        let peak = f64::from(found.volume.peak());
        assert!(error * peak < found.error_bound + 1e-6 && found.error_bound < 1e-5 * modulus, "{name}");
    }
}

/// What takes least may be another method, which takes one transmission at a time.
#[test]
fn only_convolution_takes_several_transmissions_together() {
    let few = Grid { x: axis(-0.12, 0.03, 2), y: axis(-0.11, 0.03, 2), z: axis(0.6, 0.012, 2) };
    let mut others = 0;
    for (name, instrument, grid) in sharing() {
        let cube = cube(instrument);
        for grid in [few, grid] {
            let options = ReconstructOptions::new(Method::Auto, Window::None).with_tolerance(1e-5);
            let found = reconstruct(&cube, &grid, &options).unwrap();
            let course = Course::new(&cube.instrument, &grid, &options, 2).unwrap();
            assert!(course.group == 1 || found.method == Method::Convolution, "{name}: {}", found.method);
            others += usize::from(found.method != Method::Convolution);
            let path = |p: DVec3, tx: usize, r: DVec3| cube.instrument.transmission(tx).path_length(p, r);
            let error = error(&cube, &found.volume, path);
            assert!(error < 1e-4, "{name} by {}: {error:e}", found.method);
        }
    }
    assert!(others > 0, "no job took another method");
}

#[test]
fn a_moved_pair_is_summed_as_written() {
    let offsets = [[0.08, -0.03, 0.02], [0.06, 0.0, 0.0], [0.0, 0.2, 0.0], [0.0, 0.0, -0.1]].map(DVec3::from);
    let on_a_plane = scattered(23).positions().iter().map(|r| r.with_z(0.0)).collect();
    let arrays = [lattice([6, 5]), MicArray::from_positions(on_a_plane).unwrap(), scattered(23)];
    for (array, offset) in arrays.iter().flat_map(|array| offsets.map(|offset| (array, offset))) {
        let flat = array.bounds().0.z == array.bounds().1.z;
        let cube = cube(instrument(array.clone()).with_geometry(Geometry::Pair { offset }));
        let path = |p: DVec3, _: usize, r: DVec3| p.distance(r + offset) + p.distance(r);
        let methods = [Method::Direct, Method::Backprojection, Method::Convolution];
        for method in methods.into_iter().take(if flat { 3 } else { 2 }) {
            let options = ReconstructOptions::new(method, Window::None).with_tolerance(1e-5);
            let found = reconstruct(&cube, &small_grid(), &options).unwrap();
            let error = error(&cube, &found.volume, path);
            assert!(error < 1e-4, "{method}, {offset}: {error:e}");
            assert!(error * f64::from(found.volume.peak()) < found.error_bound + 1e-6, "{method}, {offset}");
        }
    }
    // Each with an offset of its own: a common midpoint, and any.
    for array in [lattice([6, 5]), scattered(23)] {
        let own = array.positions().iter().enumerate();
        let midpoint = own.clone().map(|(_, r)| DVec3::new(0.04, 0.0, 0.0) - *r).collect::<Vec<_>>();
        let any = own.map(|(i, _)| SOURCES[i % 3] * (1.0 + 0.03 * i as f64)).collect::<Vec<_>>();
        for sources in [midpoint, any] {
            let cube = cube(instrument(array.clone()).with_pairs(&sources).unwrap());
            assert!(cube.instrument.has_differing_pairs());
            for method in [Method::Direct, Method::Backprojection] {
                let options = ReconstructOptions::new(method, Window::None).with_tolerance(1e-5);
                let found = reconstruct(&cube, &small_grid(), &options).unwrap();
                let source_of =
                    |r: DVec3| sources[array.positions().iter().position(|own| *own == r).unwrap()];
                let error = error(&cube, &found.volume, |p, _, r| p.distance(source_of(r)) + p.distance(r));
                assert!(error < 1e-4, "{method}: {error:e}");
                assert!(error * f64::from(found.volume.peak()) < found.error_bound + 1e-6);
            }
            let options = ReconstructOptions::new(Method::Convolution, Window::None);
            let refused = reconstruct(&cube, &small_grid(), &options).unwrap_err().to_string();
            crate::named::assert_names(refused, &["convolution", "pair", "backprojection"]);
            let refine = ReconstructOptions::default().with_refine(Some(RefineOptions::new(Solver::Cgls)));
            let refused = reconstruct(&cube, &small_grid(), &refine).unwrap_err().to_string();
            crate::named::assert_names(refused, &["convolution", "pair"]);
        }
    }
    // A pair in one place is a monostatic scan.
    let scan = cube(instrument(lattice([6, 5])).with_geometry(Geometry::Monostatic));
    let pair = cube(instrument(lattice([6, 5])).with_geometry(Geometry::Pair { offset: DVec3::ZERO }));
    for method in [Method::Backprojection, Method::Convolution] {
        let options = ReconstructOptions::new(method, Window::Hann).with_tolerance(1e-5);
        let [scan, pair] =
            [&scan, &pair].map(|cube| reconstruct(cube, &small_grid(), &options).unwrap().volume);
        let apart = |(a, b): (&Complex32, &Complex32)| (a - b).norm();
        let worst = scan.samples.iter().zip(&pair.samples).map(apart).fold(0.0, f32::max);
        assert!(worst < 2e-5 * scan.peak(), "{method}: {worst}");
    }
}

#[test]
fn microphones_and_sources_may_change_places() {
    let few = MicArray::from_positions(SOURCES[..2].to_vec()).unwrap();
    let cube = cube(instrument(few).with_sources(lattice([6, 5]).positions()).unwrap());
    let options = ReconstructOptions::new(Method::Auto, Window::None).with_tolerance(1e-5);
    let turned_round = reversed(&cube.instrument, &options).unwrap().unwrap();
    assert_eq!((turned_round.transmissions(), turned_round.array.len()), (2, 30));
    assert!(turned_round.array.lattice().is_some(), "the sources' lattice is recognised");
    let found = reconstruct(&cube, &small_grid(), &options).unwrap();
    let path = |p: DVec3, tx: usize, r: DVec3| p.distance(lattice([6, 5]).positions()[tx]) + p.distance(r);
    let error = error(&cube, &found.volume, path);
    assert!(error < 1e-4, "{error:e}");
    let windowed = ReconstructOptions { window: Window::Hann, ..options };
    assert!(reversed(&cube.instrument, &windowed).unwrap().is_none(), "a window weighs the microphones");
}

#[test]
fn slabs_and_interruptions_change_no_byte() {
    let cube = cube(instrument(lattice([6, 5])).with_sources(&SOURCES[..2]).unwrap());
    // Three slabs.
    let side = 1024;
    let lateral = axis(-0.3, 0.6 / side as f64, side);
    let grid = Grid { x: lateral, y: lateral, z: axis(0.6, 0.05, 17) };
    assert_eq!(slabs(&grid).collect::<Vec<_>>(), [0..8, 8..16, 16..17]);
    let part = part_of(&grid, &(8..16));
    assert!((part.z.position(3) - grid.z.position(11)).abs() < 1e-12);
    let grid = Grid { x: axis(-0.15, 0.03, 11), y: axis(-0.1, 0.03, 9), z: axis(0.6, 0.01, 20) };
    for (method, compensate) in [(Method::Convolution, false), (Method::Backprojection, true)] {
        let options = ReconstructOptions::new(method, Window::Hann).with_compensate(compensate);
        let whole = reconstruct(&cube, &grid, &options).unwrap();
        for done in [0, 7, 20] {
            let mut rest = ResumedVolume { volume: Volume { grid, samples: Vec::new() }, done };
            let info = reconstruct_into(&mut &cube, &grid, &options, &mut rest, &Silent).unwrap();
            assert_eq!(info, whole.info());
            let from = done * grid.plane_len();
            assert!(rest.volume.samples.get(from..).unwrap_or_default() == &whole.volume.samples[from..]);
        }
        let tight = ReconstructOptions { memory: Some(0), ..options };
        assert_eq!(reconstruct(&cube, &grid, &tight).unwrap().volume, whole.volume);
    }
}

#[test]
fn estimates_add_up_and_shared_kernels_take_less() {
    let one = instrument(lattice([6, 5]));
    let both = one.clone().with_sources(&SOURCES[..2]).unwrap();
    let of = |instrument: &Instrument, method| {
        let options = ReconstructOptions::new(method, Window::None);
        let estimates = estimate(instrument, &small_grid(), &options, 1).unwrap();
        (estimates.chosen().operations, estimates.chosen().bytes)
    };
    let first = one.with_geometry(both.geometry);
    assert_eq!(of(&both, Method::Direct).0, 2.0 * of(&first, Method::Direct).0);
    assert!(of(&both, Method::Direct).1 > slab_bytes(&small_grid()));
    assert!(of(&both, Method::Convolution).0 < 2.0 * of(&first, Method::Convolution).0);
    assert!(of(&both, Method::Convolution).1 > of(&first, Method::Convolution).1);
}

/// What several loudspeakers recorded of two points is explained by these, and by fewer microphones than loudspeakers.
#[test]
fn several_sources_are_refined_together() {
    let points = [[4, 3, 1], [6, 2, 3]];
    let options = ReconstructOptions::new(Method::Auto, Window::None);
    let few = MicArray::from_positions(SOURCES[..2].to_vec()).unwrap();
    for instrument in [
        instrument(lattice([6, 5])).with_sources(&SOURCES).unwrap(),
        instrument(few).with_sources(lattice([6, 5]).positions()).unwrap(),
    ] {
        let grid = small_grid();
        let mut samples = Vec::new();
        for tx in 0..instrument.transmissions() {
            let one = instrument.transmission(tx);
            for f in instrument.sweep.frequencies() {
                let echo = |[x, y, z]: [usize; 3], r| {
                    crate::wave::phasor(f * one.path_length(grid.position(x, y, z), r) / one.sound_speed)
                };
                let of_both = |r: &DVec3| points.iter().map(|p| echo(*p, *r)).sum::<Complex32>();
                samples.extend(one.array.positions().iter().map(of_both));
            }
        }
        let cube = DataCube::new(instrument.clone(), samples).unwrap();
        for solver in [Solver::Cgls, Solver::Fista] {
            let refine = RefineOptions::new(solver).with_steps(25_usize);
            let options = options.with_refine(Some(refine));
            let found = reconstruct(&cube, &grid, &options).unwrap();
            let refinement = found.refinement.unwrap();
            assert!(refinement.misfit < 0.1, "{refinement}");
            let tight = ReconstructOptions { memory: Some(0), ..options };
            assert_eq!(reconstruct(&cube, &grid, &tight).unwrap().volume, found.volume);
        }
        let options = options.with_refine(Some(RefineOptions::new(Solver::Cgls)));
        let estimates = estimate(&instrument, &grid, &options, 1).unwrap();
        assert_eq!(estimates.chosen().method, Method::Convolution);
    }
}
