//! A run that resumes gives the depths that are left bit-identical to those of a whole run, by every method; and the level
//! of samples without coherence.

#![allow(clippy::unwrap_used)]

use super::*;
use crate::acquisition::{Instrument, MicArray, Sweep, Visit};
use crate::grid::Axis;
use crate::progress::Silent;
use crate::reconstruct::volume::ResumedVolume;
use crate::wave::{Geometry, phasor};
use glam::DVec3;
use num_complex::Complex32;
use std::collections::HashMap;

#[test]
fn resumed_depths_are_bit_identical_by_every_method() {
    let axis = |first, pitch, count| Axis { first, pitch, count };
    let grid = Grid { x: axis(-0.15, 0.03, 11), y: axis(-0.1, 0.03, 9), z: axis(0.6, 0.01, 70) };
    let array = MicArray::rectangular([6, 5], [0.03; 2], DVec3::ZERO).unwrap();
    let sweep = Sweep::stepped(8_000.0, 14_000.0, 200.0).unwrap();
    let point = grid.position(3, 5, 40);
    let path = |r: &DVec3| Geometry::ORIGIN.path_length(point, *r);
    let echo = |f: &f64| array.positions().iter().map(|r| phasor(f / 343.0 * path(r))).collect::<Vec<_>>();
    let samples = sweep.frequencies().iter().flat_map(echo).collect();
    let cube = DataCube::new(Instrument::new(sweep.clone(), array.clone()), samples).unwrap();
    for (method, tolerance) in [
        (Method::Direct, 1e-4),
        (Method::Linear, 1e-4),
        (Method::Convolution, 0.0),
        (Method::Convolution, 1e-4),
        (Method::Backprojection, 1e-4),
    ] {
        let options = ReconstructOptions {
            tolerance,
            compensate: true,
            ..ReconstructOptions::new(method, Window::Hann)
        };
        let whole = reconstruct(&cube, &grid, &options).unwrap();
        assert!(whole.volume.peak() > 0.5, "{method:?} shows the point");
        for done in [0, 1, 31, 32, 50, 69, 70] {
            let mut rest = ResumedVolume { volume: Volume { grid, samples: Vec::new() }, done };
            let info = reconstruct_into(&mut &cube, &grid, &options, &mut rest, &Silent).unwrap();
            assert_eq!(info, whole.info());
            let from = done * grid.plane_len();
            let same = rest.volume.samples.get(from..).unwrap_or_default() == &whole.volume.samples[from..];
            assert!(same, "{method:?} to within {tolerance:e}, from depth {done}");
        }
    }
}

/// Keeps blocks, as another process would.
#[derive(Default)]
struct SomeBlocks(HashMap<u64, Vec<Complex32>>);

impl BlockStore for SomeBlocks {
    fn load(&mut self, k: u64, block: &mut [Complex32]) -> Result<bool> {
        let Some(kept) = self.0.get(&k).filter(|kept| kept.len() == block.len()) else {
            // Content that nobody may rely on.
            block.fill(Complex32::new(f32::NAN, 1.0));
            return Ok(false);
        };
        block.copy_from_slice(kept);
        Ok(true)
    }

    fn keeps(&self) -> bool {
        true
    }

    fn save(&mut self, k: u64, block: &[Complex32]) {
        assert!(!self.0.contains_key(&0), "the first comes last");
        assert_eq!(self.0.insert(k, block.to_vec()), None, "saved once");
    }
}

/// Samples that nobody may read.
struct SilentSamples(Instrument);

impl CubeSource for SilentSamples {
    fn instrument(&self) -> &Instrument {
        &self.0
    }

    fn held_bytes(&self) -> u64 {
        0
    }

    fn visit_transmission(&mut self, _: usize, _: usize, _: &mut Visit) -> Result<()> {
        Err(Error::input("the samples", "were read"))
    }
}

#[test]
fn a_sweep_that_was_compressed_before_gives_the_same_without_its_samples() {
    let axis = |first, pitch, count| Axis { first, pitch, count };
    let coarse = Grid { x: axis(-0.15, 0.03, 11), y: axis(-0.1, 0.03, 9), z: axis(0.6, 0.01, 70) };
    let fine = Grid { x: axis(-0.05, 0.002, 50), z: axis(0.6, 0.002, 70), ..coarse };
    let lattice = MicArray::rectangular([6, 5], [0.03; 2], DVec3::ZERO).unwrap();
    let places =
        (0..30).map(|i: i32| DVec3::new((f64::from(i) * 0.37).sin(), f64::from(i * i % 7) * 0.05, 0.0));
    let scattered = MicArray::from_positions(places.collect()).unwrap();
    let sweep = Sweep::stepped(8_000.0, 14_000.0, 50.0).unwrap();
    let sample = |i: usize| phasor((i as f64 * 0.754_877_666).sin() * 91.7);
    for (array, grid) in [(&lattice, coarse), (&lattice, fine), (&scattered, coarse), (&scattered, fine)] {
        for (method, compensate) in
            [(Method::Convolution, false), (Method::Backprojection, false), (Method::Auto, true)]
        {
            let instrument = Instrument::new(sweep.clone(), array.clone());
            let cube = DataCube::new(instrument.clone(), (0..121 * 30).map(sample).collect()).unwrap();
            let options = ReconstructOptions::new(method, Window::Hann).with_compensate(compensate);
            let whole = reconstruct(&cube, &grid, &options).unwrap();
            let mut store = SomeBlocks::default();
            for mut source in [Box::new(&cube) as Box<dyn CubeSource>, Box::new(SilentSamples(instrument))] {
                let mut volume = Volume { grid, samples: Vec::new() };
                let info =
                    reconstruct_stored(&mut *source, &grid, &options, &mut volume, &mut store, &Silent);
                assert_eq!((info.unwrap(), &volume), (whole.info(), &whole.volume), "{method}");
            }
        }
    }
}

#[test]
fn depths_of_a_long_volume_are_those_of_all_however_they_are_divided_and_kept() {
    let axis = |first, pitch, count| Axis { first, pitch, count };
    let grid = Grid { x: axis(-0.15, 0.03, 11), y: axis(-0.1, 0.03, 9), z: axis(0.6, 0.1, 75) };
    let array = MicArray::rectangular([30, 24], [0.03; 2], DVec3::ZERO).unwrap();
    let sweep = Sweep::stepped(8_000.0, 14_000.0, 10.0).unwrap();
    let sample = |i: usize| phasor((i as f64 * 0.754_877_666).sin() * 91.7);
    let samples = (0..sweep.len() * array.len()).map(sample).collect();
    let cube = DataCube::new(Instrument::new(sweep, array), samples).unwrap();
    let options = ReconstructOptions::new(Method::Convolution, Window::Hann);
    let whole = reconstruct(&cube, &grid, &options).unwrap();
    let exact = reconstruct(&cube, &grid, &options.with_method(Method::Direct)).unwrap();
    let differences = whole.volume.samples.iter().zip(&exact.volume.samples).map(|(a, b)| (a - b).norm());
    assert!(differences.fold(0.0, f32::max) <= whole.error_bound as f32);
    let mut store = SomeBlocks::default();
    let rest = |source: &mut dyn CubeSource, store: &mut SomeBlocks, done: usize| {
        let mut rest = ResumedVolume { volume: Volume { grid, samples: Vec::new() }, done };
        let info = reconstruct_stored(source, &grid, &options, &mut rest, store, &Silent).unwrap();
        assert_eq!(info, whole.info());
        let from = done * grid.plane_len();
        let samples = rest.volume.samples.get(from..).unwrap_or_default();
        assert!(samples == &whole.volume.samples[from..], "from depth {done}");
    };
    // Whoever is first compresses the sweep, and stores every stretch of depths.
    rest(&mut &cube, &mut store, 75);
    assert!(store.0.len() > 3 && store.0[&0].len() < 8, "{} blocks", store.0.len());
    for done in [0, 20, 41, 74] {
        rest(&mut SilentSamples(cube.instrument.clone()), &mut store, done);
    }
    // One that is lost is made again.
    store.0.remove(&2);
    rest(&mut &cube, &mut store, 0);
    rest(&mut &cube, &mut SomeBlocks::default(), 30);
}

#[test]
fn samples_of_random_phases_are_at_the_incoherent_level_everywhere() {
    let axis = |first, pitch, count| Axis { first, pitch, count };
    let grid = Grid { x: axis(-0.15, 0.03, 11), y: axis(-0.1, 0.03, 9), z: axis(0.6, 0.01, 70) };
    let array = MicArray::rectangular([6, 5], [0.03; 2], DVec3::ZERO).unwrap();
    let instrument = Instrument::new(Sweep::stepped(8_000.0, 14_000.0, 100.0).unwrap(), array);
    // Phases without order, and amplitudes that differ from tone to tone.
    let sample = |i: usize| phasor((i as f64 * 0.754_877_666).sin() * 91.7) * (1.0 + (i / 30 % 3) as f32);
    let cube = DataCube::new(instrument, (0..61 * 30).map(sample).collect()).unwrap();
    for window in [Window::None, Window::Hann] {
        for method in [Method::Direct, Method::Convolution] {
            let found = reconstruct(&cube, &grid, &ReconstructOptions::new(method, window)).unwrap();
            let level = found.incoherent_level.unwrap();
            let weights = Weights::new(&cube.instrument, window);
            let literal: f64 = (0..61)
                .flat_map(|f| weights.weighted(f, cube.frequency(f)))
                .map(|m| f64::from(m.norm_sqr()))
                .sum();
            assert!((level / literal.sqrt() - 1.0).abs() < 1e-5, "{level} {literal}");
            let voxels = &found.volume.samples;
            let power = voxels.iter().map(|a| f64::from(a.norm_sqr())).sum::<f64>() / voxels.len() as f64;
            assert!((power.sqrt() / level - 1.0).abs() < 0.25, "{window} {}", power.sqrt() / level);
        }
    }
    let compensated = ReconstructOptions::default().with_compensate(true);
    assert_eq!(reconstruct(&cube, &grid, &compensated).unwrap().incoherent_level, None);
}
