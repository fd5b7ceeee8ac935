//! Multipath: what it does to the picture of a corner, and that processes share its work.

use crate::binary::small;
use holosonar::checkpoint::Checkpoint;
use holosonar::config::RunFile;
use holosonar::pipeline::{JobOptions, Outcome, Wanted, image_scene, work_on_scene};
use std::time::Duration;

/// The corner with walls that mirror, of this roughness in wavelengths, and so many bounces.
fn corner(roughness: f64, bounces: u32, typed: &[&str]) -> RunFile {
    let own = ["reflectors.surface=rough".to_owned(), format!("reflectors.roughness={roughness}")];
    let typed = typed.iter().map(|&s| s.to_owned());
    let all: Vec<String> = own.into_iter().chain([format!("scene.bounces={bounces}")]).chain(typed).collect();
    RunFile::load(&small("corner.toml"), &all).unwrap()
}

fn image(run: &RunFile) -> Outcome {
    image_scene(run, &JobOptions::default()).unwrap()
}

/// Completeness and false returns.
fn scores(outcome: &Outcome) -> [f64; 2] {
    let metrics = outcome.metrics().unwrap();
    [metrics.completeness.unwrap(), metrics.false_returns.unwrap()]
}

#[test]
fn smooth_walls_of_a_corner_are_lost_in_their_multipath() {
    let of = |roughness, bounces| {
        let outcome = image(&corner(roughness, bounces, &[]));
        let scores = scores(&outcome);
        println!("{roughness} wavelengths, {bounces} bounces: {scores:?}");
        (outcome, scores)
    };
    for roughness in [0.25, 0.125, 0.0625] {
        let (outcome, [complete, wrong]) = of(roughness, 0);
        assert!(complete > 0.89 && wrong < 0.04 && outcome.multipath.is_none());
    }
    // Walls of a quarter of a wavelength still show, of an eighth less than half.
    let (_, [complete, wrong]) = of(0.25, 2);
    assert!(complete > 0.75 && wrong < 0.15);
    let (outcome, [complete, wrong]) = of(0.125, 2);
    assert!(complete < 0.6 && wrong > 0.35);
    let multipath = outcome.multipath.unwrap();
    let glint = multipath.strongest.iter().find(|kind| kind.path.matches("mirror").count() == 3).unwrap();
    let [x, y, z] = glint.place;
    assert!(x.hypot(y) < 0.01 && (z - 2.2).abs() < 0.01, "{glint:?}");
}

/// Levels and picture do not depend on how densely surfaces are sampled.
#[test]
fn spacing_changes_neither_levels_nor_picture() {
    let of = |spacing: &str| {
        let outcome = image(&corner(0.125, 1, &[&format!("reflectors.spacing={spacing}")]));
        let scores = scores(&outcome);
        let levels: Vec<f64> =
            outcome.multipath.unwrap().strongest.iter().map(|kind| kind.level_db).collect();
        println!("{spacing} m: {scores:?}, {levels:?}");
        (scores, levels)
    };
    let ((fine, fine_levels), (coarse, coarse_levels)) = (of("0.0115"), of("0.02"));
    assert!((0..2).all(|k| (fine[k] - coarse[k]).abs() < 0.08), "{fine:?} {coarse:?}");
    assert_eq!(fine_levels.len(), coarse_levels.len());
    assert!(fine_levels.iter().zip(&coarse_levels).all(|(a, b)| (a - b).abs() < 0.3));
}

#[test]
fn several_processes_make_the_same_volume() {
    let settings = ["reflectors.spacing=0.03", "grid.z=[1.9,2.3]", "array.count=[9,8]", "sweep.step=100"];
    let run = corner(0.1, 2, &settings);
    let whole = image(&run).image.volume.samples;
    let folder = tempfile::tempdir().unwrap();
    let checkpoint = Checkpoint::within(folder.path(), Duration::ZERO);
    let job = JobOptions::default().with_checkpoint(&checkpoint);
    for _ in 0..2 {
        for part in 1..=3 {
            work_on_scene(&run, &Wanted::Part { part, of: 3 }, &job).unwrap();
        }
    }
    assert!(image_scene(&run, &job).unwrap().image.volume.samples == whole);
}
