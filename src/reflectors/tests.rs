//! Shading, occlusion, roughness and seeds of sampled surfaces.

use super::*;
use crate::scene::fixtures::{material, plate};

/// A square plate before a square backdrop.
fn scene() -> Scene {
    let square = |half: f64, z, material| plate([-half, half], [-half, half], z, material);
    let triangles = [square(0.2, 1.0, 0), square(0.6, 1.5, 1)].concat();
    Scene::new(triangles, vec![material(0.4, 0.6), material(1.0, 0.0)]).expect("valid")
}

fn mean_power(reflectors: &Reflectors, keep: impl Fn(DVec3) -> bool) -> f64 {
    let powers: Vec<f64> = reflectors
        .positions()
        .iter()
        .zip(reflectors.amplitudes())
        .filter(|(p, _)| keep(**p))
        .map(|(_, a)| f64::from(a.norm_sqr()))
        .collect();
    powers.iter().sum::<f64>() / powers.len() as f64
}

#[test]
fn what_lies_behind_a_plate_is_weakened_there_and_back() {
    let options = SurfaceOptions::new(0.02, 0.02).with_lambert(false);
    let reflectors = sample_surface(&scene(), &options).expect("valid");
    // The plate's shadow on the backdrop is 1.5 times the plate.
    let shadowed = |p: DVec3| p.z > 1.2 && p.x.abs() < 0.28 && p.y.abs() < 0.28;
    let open = |p: DVec3| p.z > 1.2 && (p.x.abs() > 0.32 || p.y.abs() > 0.32);
    let ratio = mean_power(&reflectors, shadowed) / mean_power(&reflectors, open);
    // Amplitude falls by 0.6², power by 0.6⁴.
    assert!((ratio / 0.6f64.powi(4) - 1.0).abs() < 0.05, "{ratio}");
}

#[test]
fn power_does_not_depend_on_the_sampling_density() {
    let total = |spacing: f64| {
        let options = SurfaceOptions::new(spacing, 0.02).with_occlusion(Occlusion::None);
        let reflectors = sample_surface(&scene(), &options).expect("valid");
        mean_power(&reflectors, |_| true) * reflectors.len() as f64
    };
    assert!((total(0.03) / total(0.012) - 1.0).abs() < 0.02);
}

#[test]
fn lambert_follows_the_cosine_at_the_speaker() {
    let options = SurfaceOptions::new(0.05, 0.02).with_occlusion(Occlusion::None);
    let options = options.with_surface(SurfaceModel::Smooth);
    let [shaded, flat] = [true, false]
        .map(|lambert| sample_surface(&scene(), &options.clone().with_lambert(lambert)).expect("valid"));
    assert_eq!(shaded.positions(), flat.positions());
    for ((p, a), b) in shaded.positions().iter().zip(shaded.amplitudes()).zip(flat.amplitudes()) {
        assert!((f64::from(a.norm() / b.norm()) - p.z / p.length()).abs() < 1e-6);
    }
}

#[test]
fn an_aperture_at_the_speaker_equals_the_speaker_and_one_aside_does_not() {
    let options = SurfaceOptions::new(0.03, 0.02);
    let sample =
        |by: Occlusion| sample_surface(&scene(), &options.clone().with_occlusion(by)).expect("valid");
    let (nine, speaker) = (sample(Occlusion::Aperture(vec![DVec3::ZERO; 9])), sample(Occlusion::Speaker));
    for (a, b) in nine.amplitudes().iter().zip(speaker.amplitudes()) {
        assert!((a - b).norm() <= 1e-6 * b.norm(), "an aperture at the speaker is the speaker");
    }
    let aside = sample(Occlusion::Aperture(vec![DVec3::new(5.0, 0.0, 0.0)]));
    assert_ne!(aside.amplitudes(), speaker.amplitudes());
}

#[test]
fn roughness_displaces_along_the_normal_by_its_rms() {
    let options = SurfaceOptions::new(0.01, 0.02).with_occlusion(Occlusion::None);
    let options = options.with_surface(SurfaceModel::Rough(0.002));
    let reflectors = sample_surface(&scene(), &options).expect("valid");
    let squares: f64 = reflectors
        .positions()
        .iter()
        .map(|p| if p.z < 1.25 { p.z - 1.0 } else { p.z - 1.5 })
        .map(|d| d * d)
        .sum();
    let rms = (squares / reflectors.len() as f64).sqrt();
    assert!((rms / 0.002 - 1.0).abs() < 0.05, "{rms}");
    assert!(reflectors.amplitudes().iter().all(|a| a.im == 0.0 && a.re > 0.0));
}

#[test]
fn a_seed_gives_bit_identical_results_for_any_number_of_threads() {
    let run = |threads, seed: u64| {
        let options = SurfaceOptions::new(0.02, 0.02).with_seed(seed);
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool");
        pool.install(|| sample_surface(&scene(), &options).expect("valid"))
    };
    assert_eq!(run(1, 3), run(5, 3));
    assert_ne!(run(1, 3), run(1, 4));
}

#[test]
fn an_absurd_spacing_is_refused() {
    for spacing in [0.0, -1.0, f64::NAN, 1e-7] {
        assert!(sample_surface(&scene(), &SurfaceOptions::new(spacing, 0.02)).is_err(), "{spacing}");
    }
}

/// Asks to stop once some work is done, and counts it.
#[derive(Default)]
struct StopEarly(std::sync::atomic::AtomicU64);

impl Observer for StopEarly {
    fn event(&self, event: crate::progress::Event<'_>) {
        if let crate::progress::Event::Advanced { amount } = event {
            self.0.fetch_add(amount, std::sync::atomic::Ordering::Relaxed);
        }
    }

    fn should_stop(&self) -> bool {
        self.0.load(std::sync::atomic::Ordering::Relaxed) > 0
    }
}

#[test]
fn sampling_stops_when_asked() {
    let (scene, options, observer) = (scene(), SurfaceOptions::new(0.005, 0.02), StopEarly::default());
    let whole = poisson::work(scene.surface_area(), options.spacing);
    assert_eq!(sample_surface_with(&scene, &options, &observer), Err(Error::Interrupted));
    let done = observer.0.into_inner();
    assert!(done < whole / 4, "{done} of {whole} candidates");
}
