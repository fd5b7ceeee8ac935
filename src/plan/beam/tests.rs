//! The array factor against its literal sum, and against the rules of thumb.

#![allow(clippy::unwrap_used)]

use super::search::{COARSEST, MOST_AROUND};
use super::*;
use crate::acquisition::{MicArray, Sweep};
use glam::DVec3;
use std::f64::consts::TAU;

fn beam(array: &MicArray, [start, stop]: [f64; 2], window: Window) -> Beam {
    let sweep = Sweep::stepped(start, stop, 50.0).unwrap();
    Beam::new(&Instrument::new(sweep, array.clone()), window)
}

fn square(count: usize, extent: f64) -> MicArray {
    MicArray::rectangular([count; 2], [extent / (count - 1) as f64; 2], DVec3::ZERO).unwrap()
}

/// The sum of the module's head over every tone and microphone, at many τ.
fn literal(array: &MicArray, offset: DVec2) -> f64 {
    let tones: Vec<f64> = (0..=100).map(|n| 1e4 + 100.0 * f64::from(n)).collect();
    (-400..=400)
        .map(|i| {
            let tau = f64::from(i) * 1e-5;
            let sum: Complex64 = tones
                .iter()
                .flat_map(|f| array.positions().iter().map(move |r| (f, r)))
                .map(|(f, r)| Complex64::cis(TAU * f * (tau - offset.dot(r.truncate()) / 343.0)))
                .sum();
            sum.norm() / (tones.len() * array.len()) as f64
        })
        .fold(0.0, f64::max)
}

#[test]
fn strength_is_the_greatest_sum_over_ranges() {
    for array in [square(4, 0.3), MicArray::spiral(17, [0.4, 0.3], DVec3::ZERO).unwrap()] {
        let beam = beam(&array, [1e4, 2e4], Window::None);
        assert!((beam.strength(DVec2::ZERO) - 1.0).abs() < 1e-6);
        for offset in [DVec2::new(0.2, 0.0), DVec2::new(0.0, -0.35), DVec2::new(0.3, 0.4)] {
            let (fast, slow) = (beam.strength(offset), literal(&array, offset));
            assert!((fast / slow - 1.0).abs() < 0.06, "{offset}: {fast} {slow}");
        }
    }
}

/// Grating lobes at k λ/d, about −20 log₁₀(k (N − 1) B/f_c) dB.
#[test]
fn a_lattice_has_grating_lobes_where_and_as_strong_as_the_rule_says() {
    for (count, level, tolerance) in [(15, -3.4, 1.5), (31, -10.0, 1.5)] {
        let narrow = beam(&square(count, 2.0), [1.8e4, 2e4], Window::None);
        let grating_lobe = narrow.grating_lobes([1.0; 2])[0];
        let pitch = 2.0 / (count - 1) as f64;
        assert!((grating_lobe.offset[0] / (343.0 / 1.9e4 / pitch) - 1.0).abs() < 0.05, "{grating_lobe:?}");
        assert!((grating_lobe.level_db - level).abs() < tolerance, "{grating_lobe:?}");
        let peak = narrow.sidelobes([0.5; 2]);
        assert!(peak.peak_db.unwrap() >= grating_lobe.level_db - 0.5, "{peak:?}");
    }
    let wide = beam(&square(15, 2.0), [1e4, 2e4], Window::None).grating_lobes([0.3; 2])[0];
    assert!((wide.level_db + 19.4).abs() < 3.0, "a wide band smears them: {wide:?}");
    let fine = beam(&square(63, 0.5), [1.8e4, 2e4], Window::None);
    assert!(fine.grating_lobes([1.0; 2]).is_empty());
}

/// Scattered microphones: no grating lobes, and a mean power of 1/N.
#[test]
fn scattered_microphones_have_a_floor_instead_of_grating_lobes() {
    let array = MicArray::random(256, [1.0, 1.0], DVec3::ZERO, Some(0.0), 3).unwrap();
    let beam = beam(&array, [1.8e4, 2e4], Window::None);
    let sidelobes = beam.sidelobes([0.6; 2]);
    assert!(sidelobes.grating_lobes.is_empty());
    let floor = -10.0 * 256_f64.log10();
    assert!((sidelobes.mean_db.unwrap() - floor).abs() < 1.5, "{sidelobes:?}");
    assert!(sidelobes.peak_db.unwrap() > floor && sidelobes.peak_db.unwrap() < -10.0, "{sidelobes:?}");
}

#[test]
fn one_microphone_and_one_tone_are_no_trouble() {
    let one =
        beam(&MicArray::rectangular([1, 1], [0.1; 2], DVec3::ZERO).unwrap(), [1e4, 1e4], Window::Taylor);
    let sidelobes = one.sidelobes([1.0; 2]);
    assert_eq!((sidelobes.peak_db, sidelobes.grating_lobes.len()), (None, 0));
}

#[test]
fn the_search_of_any_array_is_bounded_and_says_what_it_leaves_out() {
    let sweep = Sweep::stepped(1e4, 2e4, 50.0).unwrap();
    let scene = [0.9; 2];
    let searched = |instrument: &Instrument| {
        let beam = Beam::new(instrument, Window::None);
        let (reach, coarser) = (beam.affordable(scene), beam.coarser(scene));
        let work: f64 = beam.offsets(reach, coarser).into_iter().map(|offset| beam.work_at(offset)).sum();
        assert!(work < 1.2 * MOST_AROUND, "{work:e}");
        (reach, coarser)
    };
    let usual = Instrument::new(sweep.clone(), square(31, 1.0));
    assert_eq!(searched(&usual), (scene, 1.0));
    assert_eq!(Beam::new(&usual, Window::None).sidelobes([0.1; 2]).skipped, Vec::<String>::new());
    let slow = usual.clone().with_sound_speed(0.343);
    let (reach, _) = searched(&slow);
    assert!(reach[0] > 0.0 && reach[0] < 0.1, "{reach:?}");
    assert!(searched(&Instrument::new(sweep.clone(), square(31, 9e3))).0[1] < 0.1);
    searched(&Instrument::new(sweep.clone(), square(31, 3e7)));
    searched(&Instrument::new(Sweep::stepped(1.0, 1e7, 1e4).unwrap(), square(31, 1.0)));
    let many = MicArray::random(200_000, [1.0; 2], DVec3::ZERO, Some(0.0), 3).unwrap();
    assert!(searched(&Instrument::new(sweep, many)).1 > COARSEST);
}

#[test]
fn what_is_left_out_is_named() {
    let lattice = beam(&square(31, 9e6), [1e4, 2e4], Window::None).sidelobes([0.9; 2]);
    assert!(lattice.skipped.iter().any(|what| what.contains("along x")), "{lattice:?}");
    assert!(lattice.reach[0] < 0.9);
    // Long enough that its search does not pay: it takes no time either.
    let scattered = MicArray::random(40, [9e6; 2], DVec3::ZERO, Some(0.0), 3).unwrap();
    let scattered = beam(&scattered, [1e4, 2e4], Window::None).sidelobes([0.9; 2]);
    assert!(scattered.skipped.iter().any(|what| what.contains("strongest sidelobe")), "{scattered:?}");
    assert_eq!(scattered.peak_db, None);
}

/// Many microphones are drawn together where phases hardly differ.
#[test]
fn the_main_lobe_of_very_many_microphones_is_that_of_many() {
    let line = |count: usize| {
        let array = MicArray::rectangular([count, 1], [1.0 / (count - 1) as f64; 2], DVec3::ZERO).unwrap();
        beam(&array, [1e4, 2e4], Window::Taylor).lobe()[0]
    };
    let (many, very_many) = (line(MOST_SINGLE), line(2 * MOST_SINGLE));
    assert!((very_many / many - 1.0).abs() < 1e-6, "{many} {very_many}");
}
