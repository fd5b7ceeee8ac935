//! Bounced echoes: against a sum over all pairs of patches, against their formula in f64, and what they are refused with.

use super::super::virtual_tones::TONE_DESIGNS;
use super::super::*;
use super::assert_threads_do_not_matter;
use super::cells::by_cells;
use super::losses::AIR;
use super::virtual_tones::{ROUNDING, forced, scattered, sweep_of};
use crate::acquisition::{MicArray, Sweep};
use crate::named::assert_names;
use crate::reflectors::{
    BounceOptions, EdgeOptions, Occlusion, SurfaceModel, SurfaceOptions, sample_surface,
};
use crate::scene::fixtures::{material, plate};
use crate::scene::{Scene, Triangle};
use crate::wave::{Interface, phasor};
use std::f64::consts::{PI, TAU};

const SPEAKER: DVec3 = DVec3::new(-0.1, 0.05, 0.0);
const C: f64 = 343.0;

/// A plate at z = 1.2, and one beside it that faces it, x = 0.4.
fn scene() -> Scene {
    let side = plate([0.5, 1.2], [-0.4, 0.4], 0.4, 0).map(|t| {
        let turned = t.vertices.map(|v| DVec3::new(v.z, v.y, v.x));
        Triangle { vertices: turned, ..t }
    });
    let triangles = [plate([-0.5, 0.4], [-0.4, 0.4], 1.2, 0), side].concat();
    Scene::new(triangles, vec![material(0.9, 0.0)]).expect("valid")
}

fn instrument(sweep: Sweep, array: MicArray) -> Instrument {
    Instrument::new(sweep, array).with_geometry(Geometry::FixedSource { source: SPEAKER })
}

fn reflectors(instrument: &Instrument, surface: SurfaceModel, spacing: f64, spreading: bool) -> Reflectors {
    sample_surface(&scene(), &options(instrument, surface, spacing, spreading)).expect("valid")
}

fn options(instrument: &Instrument, surface: SurfaceModel, spacing: f64, spreading: bool) -> SurfaceOptions {
    let sight = instrument.array.sight_points().to_vec();
    SurfaceOptions::new(spacing, instrument.wavelength())
        .with_surface(surface)
        .with_speaker(SPEAKER)
        .with_occlusion(Occlusion::Aperture(sight.clone()))
        .with_bounces(Some(BounceOptions::new(2, sight).with_spreading(spreading)))
}

/// The sum over all pairs of patches, whose areas and phases are those of the direct echoes.
#[test]
fn pairs_of_patches_are_the_double_sum() {
    let one = MicArray::from_positions(vec![DVec3::new(0.15, -0.1, 0.0)]).expect("one");
    let r = one.positions()[0];
    let instrument = instrument(Sweep::stepped(10e3, 11e3, 100.0).expect("valid"), one);
    let list = reflectors(&instrument, SurfaceModel::Diffuse, 0.06, false);
    let all = simulate(&list, &instrument, &SimulateOptions::default()).expect("small").samples;
    let direct = simulate(&list.clone().without_bounced(), &instrument, &SimulateOptions::default());
    let direct = direct.expect("small").samples;
    let normal = |p: DVec3| if p.x > 0.4 - 1e-9 { DVec3::X } else { DVec3::Z };
    let cosine = |p: DVec3, end: DVec3| normal(p).dot(p - end) / p.distance(end);
    // |A|² = ρ² a cos cos / π.
    let patches: Vec<(DVec3, f64, Complex32)> = list.positions()[..list.direct()]
        .iter()
        .zip(list.amplitudes())
        .map(|(&p, &a)| {
            let area = f64::from(a.norm_sqr()) * PI / (0.81 * cosine(p, SPEAKER) * cosine(p, r));
            (p, area, a / a.norm())
        })
        .collect();
    assert!(patches.len() > 150, "{}", patches.len());
    let mut most = 0.0f64;
    for (f, (all, direct)) in instrument.sweep.frequencies().iter().zip(all.iter().zip(&direct)) {
        let mut sum = [0.0; 2];
        for &(p, a, phase) in &patches {
            for &(q, b, other) in &patches {
                if normal(p) == normal(q) {
                    continue;
                }
                let d = p.distance(q);
                let scattered = cosine(p, SPEAKER) * -cosine(q, p) * -cosine(p, q) * cosine(q, r) * a * b;
                let amplitude = 0.81 * (scattered.max(0.0) / (d * d + (a * b).sqrt() / PI)).sqrt() / PI;
                let cycles = f * (p.distance(SPEAKER) + d + q.distance(r)) / C;
                let echo = phase * other * phasor(cycles);
                sum[0] += amplitude * f64::from(echo.re);
                sum[1] += amplitude * f64::from(echo.im);
            }
        }
        let expected = Complex32::new(sum[0] as f32, sum[1] as f32);
        let error = f64::from((all - direct - expected).norm());
        most = most.max(f64::from(expected.norm()));
        assert!(error < 1e-4 * most, "{error} of {most}");
    }
    assert!(most > 0.1, "{most}");
}

/// A sample and the part of Σ|A| that reaches the microphone, in f64 from the formula alone.
fn expected(list: &Reflectors, f: f64, r: DVec3, losses: Losses) -> ([f64; 2], f64) {
    let (mut sum, mut arriving) = ([0.0; 2], 0.0);
    for (j, (&q, a)) in list.positions().iter().zip(list.amplitudes()).enumerate() {
        let (out, near) = match list.transmit(j) {
            Some(transmit) => (transmit, 1.0),
            None => (q.distance(SPEAKER), q.distance(SPEAKER)),
        };
        let path = out + q.distance(r);
        let spreading = if losses.spreading { 1.0 / (near * q.distance(r)) } else { 1.0 };
        let factor = spreading * losses.air.map_or(1.0, |air| (-air.absorption(f) * path).exp());
        let (sin, cos) = (TAU * (f * path / C).fract()).sin_cos();
        let heard = f64::from(list.directivity(j, r));
        let factor = factor * heard;
        let (re, im) = (f64::from(a.re) * factor, f64::from(a.im) * factor);
        sum = [sum[0] + re * cos - im * sin, sum[1] + re * sin + im * cos];
        arriving += f64::from(a.norm()) * spreading * heard.abs();
    }
    (sum, arriving)
}

#[test]
fn literal_sums_virtual_tones_and_cells_are_the_formula() {
    let array = scattered(37, DVec3::new(0.8, 0.7, 0.1));
    for (kind, losses) in [
        (0, Losses::NONE),
        (3, Losses { spreading: true, ..Losses::NONE }),
        (1, Losses { spreading: true, air: Some(AIR), ..Losses::NONE }),
    ] {
        let instrument = instrument(sweep_of(kind), array.clone());
        let rough = SurfaceModel::Rough(0.08 * instrument.wavelength());
        let edges = EdgeOptions::new(instrument.shortest_wavelength()).with_spreading(losses.spreading);
        let surfaces = options(&instrument, rough, 0.08, losses.spreading).with_edges(Some(edges));
        let list = sample_surface(&scene(), &surfaces).expect("valid");
        let counts = list.bounce_counts().expect("edges");
        assert!(counts.edge_pieces > 500 && (counts.edge_length - 4.8).abs() < 1e-9, "{counts:?}");
        let options = SimulateOptions::default().with_losses(losses);
        let literal = simulate(&list, &instrument, &options.clone().with_tolerance(0.0)).expect("small");
        let tiled = TONE_DESIGNS.iter().zip([1, 4, 16, 64].into_iter().cycle());
        let tiled =
            tiled.step_by(3).map(|(design, tile)| forced(&list, &instrument, &options, *design, tile));
        let mut pairs = [0; 2];
        let by_cells = (kind.into()..24).step_by(7).filter_map(|choice| {
            let (samples, used) = by_cells(&list, &instrument, &options, [choice, choice])?;
            pairs = [pairs[0] + used[0], pairs[1] + used[1]];
            Some(samples)
        });
        let by_cells: Vec<_> = by_cells.collect();
        assert!(by_cells.len() > 1 && pairs[0] > 20 && pairs[1] > 20, "{} {pairs:?}", by_cells.len());
        let mut partly = 0;
        for samples in tiled.chain([literal.samples]).chain(by_cells) {
            for (mic, &r) in array.positions().iter().enumerate() {
                for f in (0..instrument.sweep.len()).step_by(23) {
                    let ([re, im], arriving) = expected(&list, instrument.sweep.frequencies()[f], r, losses);
                    let m = samples[f * array.len() + mic];
                    let error = (f64::from(m.re) - re).hypot(f64::from(m.im) - im) / arriving;
                    assert!(error < options.tolerance + ROUNDING, "{kind} {mic} {f}: {error:e}");
                }
            }
        }
        for j in 0..list.len() {
            let seen = array.positions().iter().filter(|&&r| list.directivity(j, r) != 0.0).count();
            partly += usize::from(seen > 0 && seen < array.len());
        }
        assert!(partly > 20, "{partly} images are open to some microphones only");
    }
    let instrument = instrument(sweep_of(0), array);
    let list = reflectors(&instrument, SurfaceModel::Diffuse, 0.1, false);
    assert_threads_do_not_matter(&list, &instrument, &SimulateOptions::default());
}

/// A part of the cells is interpolated, and those that are seen through mirrors are not; threads change nothing.
#[test]
fn cells_of_bounced_echoes_do_not_depend_on_threads() {
    let array = MicArray::rectangular([12, 10], [0.07; 2], DVec3::ZERO).expect("valid");
    let instrument = instrument(Sweep::stepped(10e3, 20e3, 100.0).expect("even"), array.clone());
    let list = reflectors(&instrument, SurfaceModel::Rough(0.06 * instrument.wavelength()), 0.06, true);
    let losses = Losses { spreading: true, ..Losses::NONE };
    let options = SimulateOptions::default().with_losses(losses);
    assert!(list.len() - list.direct() > 5 * list.direct(), "{} of {}", list.direct(), list.len());
    for choice in [[3, 0], [9, 1]] {
        let run = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool");
            pool.install(|| by_cells(&list, &instrument, &options, choice)).expect("tones that serve")
        };
        let (samples, pairs) = run(1);
        assert!(pairs[0] > 100 && pairs[1] > 100, "{pairs:?}");
        for (mic, f) in [(0, 0), (7, 100), (63, 41), (119, 77)] {
            let r = array.positions()[mic];
            let ([re, im], arriving) = expected(&list, instrument.sweep.frequencies()[f], r, losses);
            let m = samples[f * array.len() + mic];
            let error = (f64::from(m.re) - re).hypot(f64::from(m.im) - im);
            assert!(error < (options.tolerance + ROUNDING) * arriving, "{mic} {f}: {error:e}");
        }
        assert_eq!(run(7), (samples, pairs));
    }
}

#[test]
fn several_speakers_have_images_of_their_own() {
    let sources = [SPEAKER, DVec3::new(0.1, 0.0, 0.0)];
    let array = MicArray::rectangular([3, 2], [0.2; 2], DVec3::ZERO).expect("valid");
    let both = instrument(sweep_of(3), array).with_sources(&sources).expect("two");
    let lists = [0, 1].map(|index| {
        let one = both.transmission(index);
        let rough = SurfaceModel::Rough(0.08 * one.wavelength());
        let sight = one.array.sight_points().to_vec();
        let options = SurfaceOptions::new(0.1, one.wavelength()).with_surface(rough);
        let options = options.with_speaker(sources[index]).with_bounces(Some(BounceOptions::new(1, sight)));
        sample_surface(&scene(), &options).expect("valid")
    });
    let options = SimulateOptions::default();
    let cube = simulate_resumable(&lists, &both, &options, &mut NoStore, &Silent).expect("small");
    for (index, list) in lists.iter().enumerate() {
        let alone = simulate(list, &both.transmission(index), &options).expect("small");
        assert_eq!(cube.transmission(index), alone.samples);
    }
    assert_ne!(lists[0].positions(), lists[1].positions());
}

/// Every tone is the formula with the images of its time.
#[test]
fn bounced_echoes_move_with_their_surfaces() {
    const DWELL: f64 = 0.02;
    let array = scattered(5, DVec3::new(0.4, 0.3, 0.0));
    let instrument = instrument(Sweep::stepped(10e3, 11e3, 125.0).expect("even"), array.clone());
    let rough = SurfaceModel::Rough(0.08 * instrument.wavelength());
    let edges = EdgeOptions::new(instrument.shortest_wavelength());
    let velocity = DVec3::new(0.1, -0.05, 0.2);
    let surfaces = options(&instrument, rough, 0.1, false).with_edges(Some(edges));
    let list = sample_surface(&scene(), &surfaces.with_velocities(vec![(0..usize::MAX, velocity)]));
    let list = list.expect("valid");
    let options = SimulateOptions::default().with_dwell(DWELL);
    let cube = simulate(&list, &instrument, &options).expect("small");
    let mut moved_by = 0.0f64;
    for (tone, f) in instrument.sweep.frequencies().iter().enumerate() {
        let there = list.moved(tone as f64 * DWELL);
        for (mic, &r) in array.positions().iter().enumerate() {
            let ([re, im], arriving) = expected(&there, *f, r, Losses::NONE);
            let m = cube.samples[tone * array.len() + mic];
            let error = (f64::from(m.re) - re).hypot(f64::from(m.im) - im) / arriving;
            assert!(error < ROUNDING, "{tone} {mic}: {error:e}");
            let ([re, im], _) = expected(&list, *f, r, Losses::NONE);
            moved_by = moved_by.max((f64::from(m.re) - re).hypot(f64::from(m.im) - im) / arriving);
        }
    }
    assert!(moved_by > 1e-3, "{moved_by}");
}

#[test]
fn what_has_no_images_is_refused() {
    let array = MicArray::rectangular([3, 2], [0.2; 2], DVec3::ZERO).expect("valid");
    let usual = instrument(sweep_of(1), array);
    let list = reflectors(&usual, SurfaceModel::Diffuse, 0.1, false);
    let refused = |instrument: &Instrument, options: &SimulateOptions, part: &str| {
        let error = simulate(&list, instrument, options).expect_err(part).to_string();
        assert_names(error, &["bounces", part]);
    };
    let plain = SimulateOptions::default();
    refused(&usual.clone().with_geometry(Geometry::Monostatic), &plain, "scan");
    let offset = DVec3::X * 0.1;
    refused(&usual.clone().with_geometry(Geometry::Pair { offset }), &plain, "scan");
    refused(
        &usual.clone().with_interface(Some(Interface { depth: 0.1, sound_speed: 1480.0 })),
        &plain,
        "interface",
    );
    refused(&usual, &plain.clone().with_model(PropagationModel::Linear), "linear");
    let piston = Losses { speaker_radius: 0.01, ..Losses::NONE };
    refused(&usual, &plain.with_losses(piston), "speaker_radius");
}
