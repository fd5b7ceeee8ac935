//! Paths worked out by hand, reciprocity, what hides a path, and limits.

use super::*;
use crate::progress::Silent;
use crate::reflectors::{EdgeOptions, Occlusion, sample_surface, sample_surface_with};
use crate::scene::Triangle;
use crate::scene::fixtures::material;
use std::f64::consts::PI;

const WAVELENGTH: f64 = 0.02;
const SPEAKER: DVec3 = DVec3::new(-0.2, 0.1, 0.0);
const MICROPHONE: DVec3 = DVec3::new(0.1, -0.1, 0.0);

/// A parallelogram with a corner and two sides.
fn wall(corner: DVec3, [u, v]: [DVec3; 2]) -> [Triangle; 2] {
    let [a, b, c, d] = [corner, corner + u, corner + u + v, corner + v];
    [[a, b, c], [a, c, d]].map(|vertices| Triangle { vertices, material: 0 })
}

/// Walls x = 0.5 and z = 2, which meet at a right angle.
fn dihedral() -> Vec<Triangle> {
    let side = wall(DVec3::new(0.5, -0.5, 0.5), [DVec3::Y, DVec3::Z * 1.5]);
    let back = wall(DVec3::new(-1.0, -0.5, 2.0), [DVec3::X * 1.5, DVec3::Y]);
    [side, back].concat()
}

fn options(order: u32, spacing: f64, roughness: Option<f64>) -> SurfaceOptions {
    let surface = roughness.map_or(SurfaceModel::Diffuse, |sigma| SurfaceModel::Rough(sigma * WAVELENGTH));
    SurfaceOptions::new(spacing, WAVELENGTH)
        .with_surface(surface)
        .with_speaker(SPEAKER)
        .with_occlusion(Occlusion::Aperture(vec![MICROPHONE]))
        .with_bounces(Some(BounceOptions::new(order, vec![MICROPHONE])))
}

fn scene(triangles: Vec<Triangle>, reflectance: f64) -> Scene {
    Scene::new(triangles, vec![material(reflectance, 0.0), material(0.5, 0.5)]).expect("valid")
}

/// Every bounced echo: mirrors before, patches, mirrors after; transmit length, place, amplitude.
type Echo<'a> = (&'a PathKind, f64, DVec3, f64);

fn bounced(list: &Reflectors) -> Vec<Echo<'_>> {
    let bounced = list.bounced.as_ref().expect("bounces");
    let echo = |(i, transmit): (usize, &f64)| {
        let j = bounced.first + i;
        let kind = &bounced.kinds[bounced.kind[i] as usize];
        (kind, *transmit, list.positions()[j], f64::from(list.amplitudes()[j].norm()))
    };
    bounced.transmit.iter().enumerate().map(echo).collect()
}

fn close(a: f64, b: f64) {
    assert!((a / b - 1.0).abs() < 1e-5, "{a} {b}");
}

/// exp(−2 (kσ cos)²).
fn coherent(sigma: f64, cosine: f64) -> f64 {
    (-2.0 * (2.0 * PI * sigma * cosine).powi(2)).exp()
}

/// What a patch of unit area scatters, by the coupled model, its mean by integration.
fn scatter(sigma: f64, [incident, scattered]: [f64; 2]) -> f64 {
    let rest = |cosine: f64| 1.0 - coherent(sigma, cosine).powi(2);
    let n = 4000;
    let mean: f64 = (0..n).map(|i| (f64::from(i) + 0.5) / f64::from(n)).map(|mu| 2.0 * mu * rest(mu)).sum();
    (incident * scattered * rest(incident) * rest(scattered) / (PI * mean / f64::from(n))).sqrt()
}

#[test]
fn two_perpendicular_walls_are_as_by_hand() {
    let sigma = 0.08;
    let list = sample_surface(&scene(dihedral(), 0.9), &options(1, 0.1, Some(sigma))).expect("valid");
    let (side, back) = (
        DVec3::new(1.0 - SPEAKER.x, SPEAKER.y, SPEAKER.z),
        DVec3::new(SPEAKER.x, SPEAKER.y, 4.0 - SPEAKER.z),
    );
    let both = DVec3::new(side.x, SPEAKER.y, back.z);
    // Mirrors alone: the back wall, and of the pair the one order in which neither is missed. The side wall begins beyond
    // its own image's path.
    let mirrors: Vec<_> = bounced(&list).into_iter().filter(|(kind, ..)| kind.patches == 0).collect();
    let [(one, _, at_one, first), (two, t, at_two, second)] = mirrors[..] else { panic!("{mirrors:?}") };
    assert_eq!((one.after.len(), two.after.len(), t), (1, 2, 0.0));
    assert!(at_one.distance(back) < 1e-12 && at_two.distance(both) < 1e-12);
    let length = MICROPHONE.distance(back);
    close(first, 0.9 * coherent(sigma, 4.0 / length) * length / 4.0);
    let length = MICROPHONE.distance(both);
    let kept = coherent(sigma, 4.0 / length) * coherent(sigma, (both.x - MICROPHONE.x) / length);
    close(second, 0.81 * kept * length / 4.0);
    // Patches of the back wall by the side wall, first or last: every one whose path meets the side wall.
    let facet_of = |x: f64| {
        let facets = &list.bounced.as_ref().expect("bounces").facets;
        facets.iter().position(|facet| (facet.centre.x - x).abs() < 1e-9).expect("a wall") as u32
    };
    let side_wall = facet_of(0.5);
    let meets = |from: DVec3, to: DVec3| {
        let x = from + (to - from) * ((0.5 - from.x) / (to.x - from.x));
        (0.5..2.0).contains(&x.z) && x.y.abs() < 0.5
    };
    let mut found = [0, 0];
    for (p, direct) in list.positions()[..list.direct()].iter().zip(list.amplitudes()) {
        if p.z < 2.0 - 1e-9 {
            continue;
        }
        let cosine = |end: DVec3| (p.z - end.z).abs() / p.distance(end);
        let area = |ends: [DVec3; 2]| scatter(sigma, ends.map(cosine));
        let patch = f64::from(direct.norm()) / area([SPEAKER, MICROPHONE]);
        let by = |end: DVec3| coherent(sigma, (end.x - p.x).abs() / p.distance(end)) * 0.9;
        let of = |before: &[u32], after: &[u32], t: f64, q: DVec3| {
            let same = |echo: &&Echo<'_>| {
                echo.0.patches == 1
                    && echo.0.before == before
                    && echo.0.after == after
                    && (echo.1 - t).abs() < 1e-9
                    && echo.2.distance(q) < 1e-9
            };
            bounced(&list).iter().find(same).map(|echo| echo.3)
        };
        let seen = DVec3::new(1.0 - p.x, p.y, p.z);
        let own = DVec3::new(1.0 - MICROPHONE.x, MICROPHONE.y, MICROPHONE.z);
        let cases = [
            (of(&[side_wall], &[], side.distance(*p), *p), meets(*p, side), [side, MICROPHONE], by(side)),
            (of(&[], &[side_wall], SPEAKER.distance(*p), seen), meets(*p, own), [SPEAKER, own], by(own)),
        ];
        for (k, (echo, expected, ends, mirror)) in cases.into_iter().enumerate() {
            assert_eq!(echo.is_some(), expected, "{p} {k}");
            if let Some(amplitude) = echo {
                close(amplitude, patch * area(ends) * mirror);
                found[k] += 1;
            }
        }
    }
    assert!(found.iter().all(|count| *count > 20), "{found:?}");
}

/// Walls y = 0.5 and y = −0.5, between which sound goes to and fro towards a microphone at z = 2.
#[test]
fn a_pair_of_parallel_walls_has_the_images_by_hand() {
    let (speaker, microphone, sigma) = (DVec3::new(0.0, 0.1, 0.0), DVec3::new(0.1, -0.2, 2.0), 0.1);
    let plate = |y: f64| wall(DVec3::new(-1.0, y, 0.2), [DVec3::X * 2.0, DVec3::Z * 2.8]);
    let options = |order| {
        options(order, 0.2, Some(sigma))
            .with_speaker(speaker)
            .with_bounces(Some(BounceOptions::new(order, vec![microphone])))
    };
    let heights = |order, extra: Vec<Triangle>| {
        let scene = scene([plate(0.5), plate(-0.5)].concat().into_iter().chain(extra).collect(), 0.8);
        let list = sample_surface(&scene, &options(order)).expect("valid");
        let mirrors = bounced(&list).into_iter().filter(|(kind, ..)| kind.patches == 0);
        let heights = mirrors.map(|(kind, t, q, amplitude)| {
            let (up, length) = (q.y - microphone.y, q.distance(microphone));
            assert!(t == 0.0 && q.x == 0.0 && q.z.abs() < 1e-12);
            let n = kind.after.len() as i32;
            close(amplitude, (0.8 * coherent(sigma, up.abs() / length)).powi(n) * length / 4.0);
            (up * 10.0).round() as i32
        });
        let mut heights: Vec<i32> = heights.collect();
        heights.sort_unstable();
        heights
    };
    assert_eq!(heights(1, vec![]), [-17, -9, 11, 23]);
    assert_eq!(heights(2, vec![]), [-29, -17, -9, 11, 23, 31]);
    // A screen below, beyond where the first image's path leaves the wall.
    let screen = wall(DVec3::new(-1.0, 0.3, 1.0), [DVec3::X * 2.0, DVec3::Y * 0.2]).to_vec();
    assert!(!heights(1, screen.clone()).contains(&11) && heights(1, screen).contains(&-9));
}

#[test]
fn speaker_and_microphone_may_be_exchanged() {
    let floor = wall(DVec3::new(-1.0, 0.5, 0.4), [DVec3::X * 1.5, DVec3::Z * 1.6]);
    // What is half transparent attenuates both ways.
    let curtain = wall(DVec3::new(-0.1, -0.4, 1.0), [DVec3::X * 0.3, DVec3::Y * 0.5])
        .map(|t| Triangle { material: 1, ..t });
    let scene = scene([dihedral(), floor.to_vec(), curtain.to_vec()].concat(), 0.7);
    for spreading in [false, true] {
        let echoes = |speaker: DVec3, microphone: DVec3| {
            let bounces = BounceOptions::new(2, vec![microphone]).with_spreading(spreading);
            let options = options(2, 0.15, Some(0.06))
                .with_speaker(speaker)
                .with_occlusion(Occlusion::Aperture(vec![microphone]))
                .with_bounces(Some(bounces));
            let list = sample_surface(&scene, &options).expect("valid");
            let counts = list.bounce_counts().expect("bounces");
            assert!(counts.partners[0] == counts.partners[1] && counts.mirrors == 4, "{counts:?}");
            let mut echoes: Vec<(i64, f64)> = (0..list.len())
                .filter(|&j| list.directivity(j, microphone) > 0.0)
                .map(|j| {
                    let q = list.positions()[j];
                    let (back, spread) = (q.distance(microphone), if spreading { 1.0 } else { 0.0 });
                    let out = list.transmit(j).map_or_else(|| q.distance(speaker), |_| 1.0);
                    let transmit = list.transmit(j).unwrap_or_else(|| q.distance(speaker));
                    let amplitude = f64::from(list.amplitudes()[j].norm()) / (out * back).powf(spread);
                    (((transmit + back) * 1e8).round() as i64, amplitude)
                })
                .collect();
            echoes.sort_by(|a, b| a.0.cmp(&b.0).then(a.1.total_cmp(&b.1)));
            echoes
        };
        let (there, back) = (echoes(SPEAKER, MICROPHONE), echoes(MICROPHONE, SPEAKER));
        assert_eq!(there.len(), back.len());
        assert!(there.len() > 2000, "{}", there.len());
        let total = |echoes: &[(i64, f64)]| -> f64 { echoes.iter().map(|(_, a)| a * a).sum() };
        close(total(&there), total(&back));
        for (a, b) in there.iter().zip(&back) {
            assert!((a.0 - b.0).abs() <= 1, "{a:?} {b:?}");
        }
        // Ties in length are in any order; sums over short stretches are not.
        for (a, b) in there.chunks(200).zip(back.chunks(200)) {
            assert!((total(a) / total(b) - 1.0).abs() < 0.05);
        }
    }
}

#[test]
fn walls_without_a_mirror_image_light_each_other_and_draws_keep_the_energy() {
    let scene = scene(dihedral(), 1.0);
    let energy = |spacing: f64| {
        let list = sample_surface(&scene, &options(1, spacing, None)).expect("valid");
        let counts = list.bounce_counts().expect("bounces");
        assert_eq!(counts.mirrors, 0);
        let all: f64 = bounced(&list).iter().map(|echo| echo.3 * echo.3).sum();
        let direct: f64 = list.amplitudes()[..list.direct()].iter().map(|a| f64::from(a.norm_sqr())).sum();
        (counts.partners, all / direct)
    };
    let ((few, coarse), (many, fine)) = (energy(0.1), energy(0.025));
    assert!(few[0] == few[1] && many[0] < many[1], "{few:?} {many:?}");
    assert!((coarse / fine - 1.0).abs() < 0.1, "{coarse} {fine}");
}

/// Patches in phase would be a mirror by themselves, whose echoes depend on how densely it is sampled.
#[test]
fn patches_of_rough_walls_have_random_phases() {
    let list = sample_surface(&scene(dihedral(), 1.0), &options(1, 0.03, Some(0.1))).expect("valid");
    let direct = &list.amplitudes()[..list.direct()];
    let mean = direct.iter().map(|a| a / a.norm()).sum::<Complex32>() / direct.len() as f32;
    assert!(direct.len() > 2000 && mean.norm() < 0.07, "{} {mean}", direct.len());
}

#[test]
fn a_seed_gives_bit_identical_bounces_for_any_number_of_threads() {
    let scene = scene(dihedral(), 1.0);
    let run = |threads, seed: u64| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool");
        pool.install(|| sample_surface(&scene, &options(2, 0.05, Some(0.1)).with_seed(seed)).expect("valid"))
    };
    assert_eq!(run(1, 3), run(5, 3));
    assert_ne!(run(1, 3), run(1, 4));
    let list = run(2, 3);
    assert_eq!(list.clone().without_bounced().len(), list.direct());
    assert!(list.transmit(0).is_none() && list.transmit(list.direct()).is_some());
}

#[test]
fn the_strongest_are_kept_in_their_order() {
    let echo = |a: f32| BouncedEcho {
        place: DVec3::ZERO,
        amplitude: Complex32::new(a, 0.0),
        origin: DVec3::ZERO,
        transmit: 0.0,
        kind: 0,
    };
    let mut echoes = [3.0, 1.0, 4.0, 1.0, 5.0].map(echo).to_vec();
    let dropped = keep_strongest(&mut echoes, 3);
    assert_eq!(echoes, [3.0, 4.0, 5.0].map(echo));
    assert!((dropped - 2.0 / 52.0).abs() < 1e-9);
    assert_eq!(keep_strongest(&mut echoes, 3), 0.0);
}

#[test]
fn surfaces_that_do_not_conserve_energy_are_refused() {
    let scene = scene(dihedral(), 1.0);
    let refused = |options: SurfaceOptions, parts: &[&str]| {
        let error = sample_surface_with(&scene, &options, &Silent).expect_err("refused").to_string();
        crate::named::assert_names(error, parts);
    };
    let usual = || options(1, 0.1, None);
    refused(usual().with_surface(SurfaceModel::Smooth), &["reflectors.surface", "rough"]);
    refused(usual().with_lambert(false), &["reflectors.shading", "lambert"]);
    refused(options(3, 0.1, None), &["scene.bounces", "1 or 2"]);
    refused(usual().with_bounces(Some(BounceOptions::new(1, vec![]))), &["scene.bounces", "one point"]);
}

/// A scene that moves is one that stays before a speaker and microphones that move the other way.
#[test]
fn what_moves_as_one_takes_its_images_along() {
    let (velocity, seconds) = (DVec3::new(0.2, -0.1, 0.3), 0.01);
    let by = velocity * seconds;
    let edges = EdgeOptions::new(0.1);
    let all = |speaker: DVec3, moves: bool| {
        let velocities = if moves { vec![(0..usize::MAX, velocity)] } else { Vec::new() };
        let options = options(2, 0.12, Some(0.08)).with_occlusion(Occlusion::None).with_edges(Some(edges));
        let options = options.with_speaker(speaker).with_velocities(velocities);
        sample_surface(&scene(dihedral(), 0.9), &options).expect("valid")
    };
    let (moving, still) = (all(SPEAKER, true), all(SPEAKER, false));
    assert_eq!(moving.velocities(), vec![velocity; still.len()]);
    assert_eq!(moving.moved(0.0).without_bounced(), still.clone().without_bounced());
    assert_eq!(bounced(&moving.moved(0.0)), bounced(&still));
    assert!(
        moving.still().is_empty() && moving.clone().without_bounced().velocities().len() == still.direct()
    );
    let (moved, seen) = (moving.moved(seconds), all(SPEAKER - by, false));
    assert_eq!((moved.len(), moved.direct()), (seen.len(), seen.direct()));
    let kinds =
        [0, 1, 2].map(|patches| bounced(&seen).iter().filter(|echo| echo.0.patches == patches).count());
    assert!(kinds.iter().all(|count| *count > 1), "{kinds:?}");
    let mut furthest = 0.0f64;
    let same = |a: f64, b: f64| assert!((a - b).abs() < 1e-9, "{a} {b}");
    for ((own, other), before) in bounced(&moved).iter().zip(bounced(&seen)).zip(bounced(&still)) {
        assert_eq!(own.0, other.0);
        same(own.1, other.1);
        same(own.2.distance(other.2 + by), 0.0);
        furthest = furthest.max((own.1 - before.1).abs()).max(own.2.distance(before.2));
    }
    assert!(furthest > 1e-3, "{furthest}");
    // Another process is told all of it.
    let told = |list: &Reflectors| {
        let places = Reflectors::new(list.positions().to_vec(), list.amplitudes().to_vec()).expect("valid");
        places.with_velocities(list.velocities().to_vec()).expect("slow")
    };
    for list in [&moving, &still] {
        assert_eq!(told(list).with_detours(list.detours().expect("some")).as_ref(), Some(list));
    }
    assert!(told(&still.clone().without_bounced()).with_detours(still.detours().expect("some")).is_none());
    // Openings and edges are where their surfaces are.
    let r = MICROPHONE + DVec3::new(0.03, 0.0, 0.0);
    let mut partly = 0;
    for j in 0..moved.len() {
        let (own, other) = (moved.directivity(j, r), seen.directivity(j, r - by));
        assert!((own - other).abs() < 1e-4 * other.abs().max(1.0), "{j}: {own} {other}");
        partly += usize::from(own != 1.0);
    }
    assert!(partly > 10 && moved.check_motion().is_ok() && moving.check_motion().is_ok());
    // Surfaces that move apart have no images that move.
    let apart = options(1, 0.12, Some(0.08)).with_velocities(vec![(0..2, velocity)]);
    let error = sample_surface(&scene(dihedral(), 0.9), &apart).expect_err("apart").to_string();
    assert!(error.contains("[scene] velocity") && error.contains("alike"), "{error}");
    let mut some = vec![velocity; still.len()];
    some[0] = DVec3::ZERO;
    let error = still.with_velocities(some).expect("numbers").check_motion().expect_err("apart").to_string();
    assert!(error.contains("mirror images"), "{error}");
}
