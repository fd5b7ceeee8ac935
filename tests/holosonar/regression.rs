//! Scenes are checked against their own `[expect]`: small variants in every run of the tests, and the shipped ones, which take
//! seconds, among the heavier tests. Negative controls prove that the limits can be missed.

use crate::binary::{done, done_json, shipped, small};
use holosonar::config::RunFile;
use holosonar::grid::Volume;
use holosonar::metrics::{METRIC_NAMES, Metrics, error_map};
use holosonar::pipeline::{JobOptions, check_scene, image_scene};
use std::path::Path;

fn overrides(typed: &[&str]) -> Vec<String> {
    typed.iter().map(|&s| s.to_owned()).collect()
}

/// Checks a scene against its `[expect]`, with the caller's or the scene's own seeds; limits of shares may be missed by
/// `slack`.
fn keeps_its_limits(scene: &Path, seeds: &[u32], slack: f64) {
    let run = RunFile::load(scene, &[]).unwrap();
    let judgement = check_scene(scene, &run, seeds, false, &JobOptions::default()).unwrap();
    let scene = scene.display();
    println!("{scene} {:?}", judgement.seeds);
    assert!(!judgement.verdicts.is_empty());
    for verdict in judgement.verdicts {
        println!("  {} {:?} {:?}", verdict.bound.measure, verdict.value, verdict.each);
        let (value, limit) = (verdict.value.unwrap(), verdict.bound.limit);
        let nearly = limit.min.is_none_or(|min| value >= min - slack)
            && limit.max.is_none_or(|max| value <= max + slack);
        let share = !Metrics::is_length(&verdict.bound.measure.metric);
        assert!(verdict.kept || (share && nearly), "{scene}: {verdict:?}");
    }
}

fn metrics(path: &Path, typed: &[&str]) -> Metrics {
    let run = RunFile::load(path, &overrides(typed)).unwrap();
    let metrics = image_scene(&run, &JobOptions::default()).unwrap().metrics().unwrap();
    println!("{} {typed:?}: {metrics:?}", path.display());
    metrics
}

#[test]
fn corner() {
    keeps_its_limits(&small("corner.toml"), &[], 0.0);
}

#[test]
fn corner2() {
    keeps_its_limits(&small("corner2.toml"), &[1], 0.0);
}

#[test]
fn a_grid_beside_the_scene_comes_out_empty() {
    let folder = tempfile::tempdir().unwrap();
    let scene = small("corner.toml");
    for grid in ["grid.z=[0.3,0.8]", "grid.z=[2.6,3.3]", "grid.x=[2.0,3.0] --set grid.y=[2.0,3.0]"] {
        for refine in ["surface", "column"] {
            let words = format!("image {} -o out --set {grid} --set depth.refine={refine}", scene.display());
            let report = done_json(folder.path(), &words);
            assert_eq!(report["accepted"], 0, "{grid}, {refine}");
            assert!(
                report["warnings"].to_string().contains("no return was accepted"),
                "{}",
                report["warnings"]
            );
        }
        // From the volume's file alone the same.
        done(folder.path(), "depth out/volume.npz -o again.exr");
        assert_eq!(done_json(folder.path(), "info again.exr")["accepted"], 0, "{grid}");
    }
}

/// An object of a few resolution cells, whose sidelobes nothing in the grid outshines: lattices with grating lobes and without, a
/// spiral and a scan. The strongest of them may be left where microphones are few.
#[test]
fn a_grid_beside_a_small_object_comes_out_empty() {
    let folder = tempfile::tempdir().unwrap();
    let scene = small("bracket.toml");
    let arrays = [
        ("array.count=[31,31] --set array.pitch=[0.032,0.032]", 0.005),
        ("array.count=[31,31] --set array.pitch=[0.032,0.032] --set array.geometry=monostatic", 0.0),
        ("array.layout=spiral --set array.count=[10,10] --set array.extent=[1,1]", 0.0),
        ("array.count=[61,61] --set array.pitch=[0.016,0.016]", 0.0),
        ("array.count=[63,63] --set array.pitch=[0.032,0.032]", 0.0),
    ];
    for (array, most) in arrays {
        for grid in ["grid.x=[0.5,1.2]", "grid.y=[-1.2,-0.4]", "grid.z=[1.5,2.0]"] {
            let words = format!("image {} -o out --set {array} --set {grid}", scene.display());
            let report = done_json(folder.path(), &words);
            let accepted = report["accepted"].as_f64().unwrap();
            assert!(accepted <= most * report["pixels"].as_f64().unwrap(), "{array}, {grid}: {accepted}");
            // From the volume's file alone the same.
            done(folder.path(), "depth out/volume.npz -o again.exr");
            let again = done_json(folder.path(), "info again.exr");
            assert_eq!(again["accepted"], report["accepted"], "{array}, {grid}");
        }
    }
}

#[test]
fn transparent_foreground() {
    keeps_its_limits(&small("transparent_foreground.toml"), &[], 0.0);
}

#[test]
fn bracket() {
    keeps_its_limits(&small("bracket.toml"), &[], 0.0);
}

#[test]
fn cad() {
    keeps_its_limits(&small("cad.toml"), &[], 0.0);
}

#[test]
fn standard_errors_hold_about_68_percent_of_the_errors() {
    let (mut within, mut all) = (0usize, 0usize);
    for scene in ["bracket.toml", "cad.toml", "corner.toml", "transparent_foreground.toml"] {
        let run = RunFile::load(&small(scene), &[]).unwrap();
        let found = image_scene(&run, &JobOptions::default()).unwrap();
        let stated = found.depth.picked.error.as_ref().unwrap();
        let errors = error_map(&found.depth, found.truth.as_ref().unwrap()).unwrap();
        let known: Vec<_> = errors.iter().zip(stated).filter(|(error, _)| !error.is_nan()).collect();
        let inside = known.iter().filter(|(error, stated)| error.abs() <= **stated).count();
        println!("{scene}: {:.3}", inside as f64 / known.len() as f64);
        (within, all) = (within + inside, all + known.len());
    }
    let share = within as f64 / all as f64;
    assert!((0.63..0.75).contains(&share), "{share} of the errors are within the standard error");
}

/// The scenes that have a test above.
const HELD: [&str; 5] =
    ["bracket.toml", "cad.toml", "corner.toml", "corner2.toml", "transparent_foreground.toml"];

#[test]
fn every_shipped_scene_with_limits_is_held_to_them_here() {
    for entry in std::fs::read_dir(shipped("")).unwrap() {
        let path = entry.unwrap().path();
        if path.extension().is_some_and(|e| e == "toml") {
            let held = !RunFile::load(&path, &[]).unwrap().expect.limits.is_empty();
            let name = path.file_name().unwrap().to_str().unwrap();
            assert_eq!(held, HELD.contains(&name), "{name}: a scene with [expect] needs a test above");
        }
    }
}

#[test]
#[ignore = "half a minute: the shipped scenes, as large as they are"]
fn shipped_scenes_show_what_the_method_can_do() {
    for scene in HELD {
        keeps_its_limits(&shipped(scene), &[], 0.0);
    }
}

#[test]
#[ignore = "fifteen more runs of what the tests above hold"]
fn limits_hold_for_other_seeds() {
    for scene in HELD {
        // Limits that other seeds were not chosen for.
        keeps_its_limits(&small(scene), &[4, 5, 6], 0.015);
    }
}

#[test]
#[ignore = "negative control: several seconds, of no use while the scenes themselves pass"]
fn a_mirror_corner_is_nearly_invisible() {
    let found = metrics(&small("corner.toml"), &["reflectors.surface=smooth"]);
    assert!(found.completeness.unwrap() < 0.20, "{found:?}");
}

#[test]
#[ignore = "a minute: mirrors by surfaces and by columns, at two sizes"]
fn surfaces_of_mirrors_are_no_more_false_than_columns() {
    let room = ["array.extent=[2.0,2.0]", "grid.x=[-0.664,0.664]", "grid.y=[-0.664,0.664]"];
    let room =
        [&room[..], &["grid.pitch=[0.016,0.016,0.008]", "array.count=[63,63]", "sweep.step=20"]].concat();
    for scene in HELD {
        for typed in [&[][..], &room] {
            if scene == "bracket.toml" && !typed.is_empty() {
                continue; // of a tenth of the size
            }
            let of = |refine: &str| {
                let mirrors = ["reflectors.surface=smooth", &format!("depth.refine={refine}")];
                let typed = [typed, &mirrors].concat();
                metrics(&small(scene), &typed).false_returns.unwrap()
            };
            let (surface, column) = (of("surface"), of("column"));
            // Where a step ends is a matter of a pixel or two of some two hundred.
            assert!(surface <= column + 0.01, "{scene} {typed:?}: {surface}, by columns {column}");
        }
    }
}

#[test]
#[ignore = "negative control: several seconds, of no use while the scenes themselves pass"]
fn a_sparse_array_cannot_tell_two_surfaces_apart() {
    // 2/14 m between microphones, a quarter of it between voxels.
    let found = metrics(
        &small("transparent_foreground.toml"),
        &[
            "array.count=[15,15]",
            "array.extent=[2.0,2.0]",
            "grid.pitch=[0.03571428571428571,0.03571428571428571,0.01]",
        ],
    );
    assert!(found.two_returns.unwrap() < 0.20, "{found:?}");
}

#[test]
#[ignore = "negative control: several seconds, of no use while the scenes themselves pass"]
fn without_occlusion_the_backs_of_closed_bodies_drown_their_fronts() {
    // The truth must be the visible surfaces either way, so the second run is scored against the first's truth.
    let image = |occlusion: &str| {
        let run = RunFile::load(&small("cad.toml"), &[format!("scene.occlusion={occlusion}")]).unwrap();
        image_scene(&run, &JobOptions::default()).unwrap()
    };
    let (seen, all) = (image("speaker"), image("none"));
    let truth = seen.truth.as_ref().unwrap();
    let score = |depth| holosonar::metrics::evaluate(depth, truth, 0.01715).unwrap();
    let (with, without) = (score(&seen.depth), score(&all.depth));
    println!("cad speaker {with:?}\ncad none {without:?}\nagainst its own truth {:?}", all.metrics());
    let [with, without] = [with, without].map(|m| m.completeness.unwrap());
    assert!(without < 0.55 && with > without + 0.15, "speaker {with}, none {without}");
}

/// Relative difference of two volumes' amplitudes, root mean square over root mean square.
fn difference(a: &Volume, b: &Volume) -> f64 {
    let norm =
        |values: &mut dyn Iterator<Item = f32>| values.map(|v| f64::from(v).powi(2)).sum::<f64>().sqrt();
    let mut apart = a.samples.iter().zip(&b.samples).map(|(a, b)| a.norm() - b.norm());
    norm(&mut apart) / norm(&mut b.samples.iter().map(|b| b.norm()))
}

#[test]
#[ignore = "negative control: several seconds, of no use while the scenes themselves pass"]
fn in_phase_data_folds_back_when_the_step_is_too_coarse() {
    let volume = |kind: &str, step: &str| {
        let typed = [format!("detection.kind={kind}"), format!("sweep.step={step}")];
        let run = RunFile::load(&small("corner.toml"), &typed).unwrap();
        image_scene(&run, &JobOptions::default()).unwrap().image.volume
    };
    // At every multiple of δf the cosine of a path L is that of c/δf − L, so real data shows a mirror image there: every path
    // must be shorter than c/2δf, which is 8.6 m, 4.3 m and 3.4 m for these steps, and the corner's reach some 4.5 m.
    let [fine, middle, coarse] = ["20.0", "40.0", "50.0"]
        .map(|step| difference(&volume("in-phase", step), &volume("quadrature", step)));
    println!("in phase against quadrature: 20 Hz {fine:.4}, 40 Hz {middle:.4}, 50 Hz {coarse:.4}");
    assert!(fine < 0.02, "{fine}");
    // 40 Hz, the scene's own step, is too coarse already: the rule is the longest path's, not the image's depth.
    assert!(middle > 0.10 && coarse > middle, "{middle} {coarse}");
}

/// The mean of a metric that every seed has.
fn mean(seeds: &[Metrics], name: &str) -> Option<f64> {
    let values: Option<Vec<f64>> = seeds.iter().map(|metrics| metrics.get(name).unwrap()).collect();
    values.map(|values| values.iter().sum::<f64>() / values.len() as f64)
}

/// Means of three seeds at 63 x 63 microphones on 2 m.
fn large(scene: &str, typed: &[&str]) -> Vec<(&'static str, f64)> {
    let seeds = [1, 2, 3].map(|seed| {
        let mut typed: Vec<String> = overrides(typed);
        typed.extend(overrides(&["array.count=[63,63]", "sweep.step=20"]));
        typed.push(format!("reflectors.seed={seed}"));
        let run = RunFile::load(&small(scene), &typed).unwrap();
        image_scene(&run, &JobOptions::default()).unwrap().metrics().unwrap()
    });
    let means: Vec<_> =
        METRIC_NAMES.into_iter().filter_map(|name| mean(&seeds, name).map(|mean| (name, mean))).collect();
    println!("{scene}: {means:?}");
    means
}

#[test]
#[ignore = "a minute: the picture that an array of 2 m makes"]
fn a_large_array_shows_surfaces_as_they_are() {
    let room = ["array.extent=[2.0,2.0]", "grid.x=[-0.664,0.664]", "grid.y=[-0.664,0.664]"];
    let room = [&room[..], &["grid.pitch=[0.016,0.016,0.008]"]].concat();
    let near = ["array.pitch=[0.03225806451612903,0.03225806451612903]"];
    // Least completeness, then the most of each other metric; a step's edge is within a pixel, and half of it is false.
    for (scene, typed, complete, most) in [
        ("corner.toml", &room[..], 0.985, &[("false_returns", 0.005), ("median_error", 0.002)][..]),
        ("transparent_foreground.toml", &room, 0.985, &[("false_returns", 0.01), ("spurious_returns", 0.04)]),
        ("cad.toml", &room, 0.94, &[("false_returns", 0.025), ("spurious_returns", 0.03)]),
        ("bracket.toml", &near, 0.98, &[("false_returns", 0.005)]),
    ] {
        let means = large(scene, typed);
        let mean = |name: &str| means.iter().find(|(n, _)| *n == name).unwrap().1;
        assert!(mean("completeness") >= complete, "{scene}: {means:?}");
        for (name, most) in most {
            assert!(mean(name) <= *most, "{scene}: {name} {}", mean(name));
        }
        assert!(!scene.starts_with("transparent") || mean("two_returns") >= 0.995, "{means:?}");
    }
}

#[test]
#[ignore = "several seconds, of no use while the scenes themselves pass"]
fn noise_and_errors_of_the_array_harm_surfaces_no_more_than_columns() {
    // As depth was found before there were surfaces.
    let literal = [
        "depth.refine=column",
        "reconstruct.window=taylor",
        "depth.return_contrast_db=5",
        "depth.return_threshold_db=-20",
        "depth.return_gate_db=-12",
    ];
    for set in
        ["detection.snr_db=0", "detection.snr_db=-10", "array.position_error=0.002", "array.phase_error=40"]
    {
        for scene in ["corner.toml", "transparent_foreground.toml", "cad.toml", "bracket.toml"] {
            let seeds = |typed: &[&str]| {
                ["1", "2", "3"].map(|seed| {
                    let seed = format!("reflectors.seed={seed}");
                    metrics(&small(scene), &[&[set, &*seed][..], typed].concat())
                })
            };
            let (surface, column) = (seeds(&[]), seeds(&literal));
            let better = |name: &str, sign: f64| {
                let [surface, column] = [surface, column].map(|seeds| mean(&seeds, name));
                assert!(
                    surface.zip(column).is_none_or(|(s, c)| sign * (s - c) >= -0.01),
                    "{set} {scene}: {name} {surface:?}, {column:?} by columns"
                );
            };
            better("completeness", 1.0);
            better("false_returns", -1.0);
            better("two_returns", 1.0);
            better("spurious_returns", -1.0);
        }
    }
}
