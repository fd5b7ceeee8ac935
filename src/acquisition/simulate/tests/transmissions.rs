//! Several loudspeakers and moved pairs: against Eq. 5 as printed, and against a simulation of each loudspeaker.

use super::cells::EarlierRun;
use super::*;

const SOURCES: [DVec3; 3] =
    [DVec3::new(0.3, 0.0, 0.0), DVec3::new(-0.2, 0.1, 0.05), DVec3::new(0.0, -0.4, -0.1)];

fn several() -> (Reflectors, Instrument) {
    let (reflectors, instrument) = scene(Sweep::stepped(10_000.0, 12_000.0, 100.0).expect("ok"));
    (reflectors, instrument.with_sources(&SOURCES).expect("three"))
}

#[test]
fn every_transmission_is_the_literal_sum_of_its_own_source() {
    let (reflectors, instrument) = several();
    let cube = simulate(&reflectors, &instrument, &SimulateOptions::default()).expect("small");
    assert_eq!(cube.samples.len(), 3 * 21 * 12);
    for (tx, source) in SOURCES.into_iter().enumerate() {
        let one = instrument.clone().with_geometry(Geometry::FixedSource { source });
        for (i, m) in cube.transmission(tx).iter().enumerate() {
            let (f, r) = (instrument.sweep.frequencies()[i / 12], instrument.array.positions()[i % 12]);
            let error = (m - literal(&reflectors, r, f, &one)).norm();
            assert!(error < 2e-4, "{tx} {i}: {error}");
        }
    }
    assert_threads_do_not_matter(&reflectors, &instrument, &SimulateOptions::default());
}

#[test]
fn a_moved_pair_is_the_literal_sum_with_all_losses() {
    let (reflectors, instrument) = scene(Sweep::stepped(10_000.0, 12_000.0, 100.0).expect("ok"));
    let offset = DVec3::new(0.2, -0.1, 0.05);
    let pair = instrument.clone().with_geometry(Geometry::Pair { offset });
    let losses = Losses { spreading: true, speaker_radius: 0.01, ..Losses::NONE };
    for options in [SimulateOptions::default(), SimulateOptions::default().with_losses(losses)] {
        let cube = simulate(&reflectors, &pair, &options).expect("small");
        // Each microphone by itself, with a loudspeaker that stands where the pair's is.
        for (mic, r) in instrument.array.positions().iter().enumerate() {
            let alone =
                Instrument::new(instrument.sweep.clone(), MicArray::from_positions(vec![*r]).expect("one"))
                    .with_geometry(Geometry::FixedSource { source: *r + offset });
            let one = simulate(&reflectors, &alone, &options.clone().with_tolerance(0.0)).expect("small");
            for (f, m) in one.samples.iter().enumerate() {
                assert!((cube.samples[f * 12 + mic] - m).norm() < 2e-4);
            }
        }
    }
}

#[test]
fn each_source_may_light_reflectors_of_its_own() {
    let (reflectors, instrument) = several();
    let half = |first: usize| {
        let (p, a) = (&reflectors.positions()[first..], &reflectors.amplitudes()[first..]);
        Reflectors::new(p.to_vec(), a.to_vec()).expect("finite")
    };
    let lit = [half(0), half(10), half(30)];
    let options = SimulateOptions::default();
    let cube = simulate_resumable(&lit, &instrument, &options, &mut NoStore, &Silent).expect("small");
    for (tx, reflectors) in lit.iter().enumerate() {
        let one = simulate(reflectors, &instrument.transmission(tx), &options).expect("small");
        assert_eq!(cube.transmission(tx), one.samples);
    }
}

#[test]
fn transmissions_have_noise_of_their_own_and_blocks_of_their_own() {
    let (reflectors, instrument) = several();
    let noisy = SimulateOptions::default().with_noise(Noise { snr_db: 10.0, seed: 3 });
    let run = |options: &SimulateOptions| simulate(&reflectors, &instrument, options).expect("small");
    let (clean, noisy) = (run(&SimulateOptions::default()), run(&noisy));
    let noise = |tx: usize| noisy.transmission(tx)[5] - clean.transmission(tx)[5];
    assert!((noise(0) - noise(1)).norm() > 1e-3 && (noise(1) - noise(2)).norm() > 1e-3);
    let mut store = EarlierRun { every: u64::MAX, ..EarlierRun::default() };
    let resumable = |store: &mut EarlierRun| {
        let lists = std::slice::from_ref(&reflectors);
        simulate_resumable(lists, &instrument, &SimulateOptions::default(), store, &Silent).expect("small")
    };
    assert_eq!(resumable(&mut store), clean);
    assert!(store.stored.len() >= 3, "a block for each transmission at least");
    let mut resumed = EarlierRun { stored: store.stored.clone(), every: 1, given: 0 };
    assert_eq!(resumable(&mut resumed), clean);
    assert_eq!(resumed.given, store.stored.len());
}
