//! The literal sum against Eq. 5 as printed, noise, and what other tests share.

mod bounces;
mod cells;
mod losses;
mod transmissions;
mod virtual_tones;

use super::*;
use crate::acquisition::{MicArray, Sweep};
use crate::wave::Geometry;
use crate::wave::phasor;
use glam::DVec3;

fn scene(sweep: Sweep) -> (Reflectors, Instrument) {
    let positions = (0..37)
        .map(|i| {
            let t = |k: f64| (f64::from(i) * k).fract() - 0.5;
            DVec3::new(t(0.618), t(0.755), 1.5 + t(0.57))
        })
        .collect::<Vec<_>>();
    let amplitudes = (0..37).map(|i| phasor(f64::from(i) * 0.37) * (1.0 + i as f32 / 37.0)).collect();
    let reflectors = Reflectors::new(positions, amplitudes).expect("finite");
    let array = MicArray::rectangular([4, 3], [0.05, 0.04], DVec3::new(0.1, 0.0, 0.0)).expect("ok");
    (reflectors, Instrument::new(sweep, array))
}

/// Eq. 5 as printed.
fn literal(reflectors: &Reflectors, r: DVec3, f: f64, instrument: &Instrument) -> Complex32 {
    reflectors
        .positions()
        .iter()
        .zip(reflectors.amplitudes())
        .map(|(&p, a)| a * phasor(f * instrument.geometry.path_length(p, r) / instrument.sound_speed))
        .sum()
}

/// Simulates on one thread and on several, with bit-identical results.
fn assert_threads_do_not_matter(reflectors: &Reflectors, instrument: &Instrument, options: &SimulateOptions) {
    let run = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool");
        pool.install(|| simulate(reflectors, instrument, options).expect("ok").samples)
    };
    assert_eq!(run(1), run(7));
}

#[test]
fn the_cube_is_the_literal_sum_for_even_and_uneven_sweeps() {
    let even = Sweep::stepped(10_000.0, 20_000.0, 100.0).expect("ok");
    let uneven = Sweep::from_frequencies(vec![9_000.0, 9_500.5, 12_000.0, 20_100.25]).expect("ok");
    for geometry in [Geometry::ORIGIN, Geometry::Monostatic] {
        for sweep in [&even, &uneven] {
            let (reflectors, instrument) = scene(sweep.clone());
            let instrument = instrument.with_geometry(geometry);
            let options = SimulateOptions::default();
            let cube = simulate(&reflectors, &instrument, &options).expect("small");
            let array = &instrument.array;
            for (f, frequency) in sweep.frequencies().iter().enumerate() {
                for (mic, &r) in array.positions().iter().enumerate() {
                    let exact = literal(&reflectors, r, *frequency, &instrument);
                    let error = (cube.samples[f * array.len() + mic] - exact).norm();
                    assert!(error < 2e-4, "{f} {mic}: {error}");
                }
            }
        }
    }
}

#[test]
fn in_phase_is_the_real_part_of_quadrature() {
    let (reflectors, instrument) = scene(Sweep::stepped(10_000.0, 11_000.0, 100.0).expect("ok"));
    let run = |detection| {
        let instrument = instrument.clone().with_detection(detection);
        simulate(&reflectors, &instrument, &SimulateOptions::default()).expect("ok")
    };
    let (quadrature, in_phase) = (run(Detection::Quadrature), run(Detection::InPhase));
    for (q, i) in quadrature.samples.iter().zip(&in_phase.samples) {
        assert_eq!((q.re, 0.0), (i.re, i.im));
    }
}

#[test]
fn noise_has_the_requested_power_and_depends_on_its_seed() {
    let (reflectors, instrument) = scene(Sweep::stepped(10_000.0, 20_000.0, 10.0).expect("ok"));
    for detection in [Detection::Quadrature, Detection::InPhase] {
        let instrument = instrument.clone().with_detection(detection);
        let run = |noise| {
            let options = SimulateOptions { noise, ..SimulateOptions::default() };
            simulate(&reflectors, &instrument, &options).expect("ok").samples
        };
        let (clean, noisy) = (run(None), run(Some(Noise { snr_db: 6.0, seed: 4 })));
        let power = |m: &mut dyn Iterator<Item = Complex32>| m.map(|m| f64::from(m.norm_sqr())).sum::<f64>();
        let snr =
            power(&mut clean.iter().copied()) / power(&mut clean.iter().zip(&noisy).map(|(a, b)| b - a));
        assert!((10.0 * snr.log10() - 6.0).abs() < 0.2, "{snr}");
        assert_eq!(noisy, run(Some(Noise { snr_db: 6.0, seed: 4 })));
        assert_ne!(noisy, run(Some(Noise { snr_db: 6.0, seed: 5 })));
    }
}

#[test]
fn the_number_of_threads_does_not_change_the_literal_sum() {
    let (reflectors, instrument) = scene(Sweep::stepped(10_000.0, 20_000.0, 50.0).expect("ok"));
    let options = SimulateOptions::default().with_noise(Noise { snr_db: 0.0, seed: 1 });
    assert_threads_do_not_matter(&reflectors, &instrument, &options);
}
