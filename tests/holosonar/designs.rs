//! Sweeps that are simulated: the numbers of single images, the same bytes however they are divided and resumed, and nothing
//! taken from a record that is damaged or of something else.

use crate::binary::{done, done_json, files_below, json_file, refused, run};
use crate::named::assert_names;
use holosonar::config::RunFile;
use holosonar::error::Error;
use holosonar::metrics::Measure;
use holosonar::pipeline::{
    DesignSweep, JobOptions, SweepSimulation, SweptKey, check_scene, image_scene, simulate_designs,
    work_on_designs,
};
use holosonar::progress::{Event, Observer};
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};

/// The corner by few microphones and large voxels: an image takes milliseconds.
const RUN: &str = r#"
[scene]
mesh = "corner.obj"
unit = "m"
up = "none"
[sweep]
start = 10e3
stop = 14e3
step = 200.0
[array]
count = [7, 7]
extent = [0.5, 0.5]
[grid]
x = [-0.5, 0.5]
y = [-0.5, 0.5]
z = [1.4, 2.2]
pitch = [0.1, 0.1, 0.02]
[expect]
seeds = [1, 2]
completeness = { min = 0.1 }
"#;

/// A run file of four valid combinations and two that are refused.
const KEYS: [&str; 2] = ["array.count=5,7", "sweep.step=200,400,300"];

fn scene() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let mesh = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes/meshes/corner.obj");
    fs::copy(mesh, folder.path().join("corner.obj")).unwrap();
    fs::write(folder.path().join("run.toml"), RUN).unwrap();
    folder
}

fn words(more: &str) -> String {
    format!("plan run.toml --sweep {} --sweep {} --simulate {more}", KEYS[0], KEYS[1])
}

fn records(folder: &Path) -> Vec<PathBuf> {
    files_below(&folder.join("combinations"))
}

/// The results of a folder.
fn results(folder: &Path) -> Vec<Vec<u8>> {
    ["sweep.csv", "sweep.json", "sweep.png", "pareto.png"]
        .map(|name| fs::read(folder.join(name)).unwrap())
        .to_vec()
}

/// The sweep by the library.
fn simulated(
    folder: &Path,
    measure: &str,
    finished: Option<&Path>,
    job: &JobOptions,
) -> holosonar::error::Result<DesignSweep> {
    let keys = KEYS.map(|key| SweptKey::parse(key).unwrap());
    let run_with = |set: &[String]| RunFile::load(&folder.join("run.toml"), set);
    let measure = Measure::parse(measure).unwrap();
    simulate_designs(
        &keys,
        &run_with,
        &SweepSimulation { seeds: &[], measure: &measure, folder: finished },
        job,
    )
}

#[test]
fn a_combination_has_the_numbers_of_its_images() {
    let folder = scene();
    let path = folder.path().join("run.toml");
    let sweep = simulated(folder.path(), "completeness", None, &JobOptions::default()).unwrap();
    assert_eq!(sweep.combinations.len(), 6);
    for combination in &sweep.combinations {
        let set: Vec<String> =
            sweep.keys.iter().zip(&combination.values).map(|(key, value)| format!("{key}={value}")).collect();
        if combination.values[1] == "300" {
            let why = combination.refused.as_deref().unwrap();
            assert_names(why, &["sweep.step", "300"]);
            assert!(combination.simulated.is_none() && combination.design.is_none());
            continue;
        }
        let run = RunFile::load(&path, &set).unwrap();
        let judged = check_scene(&path, &run, &[], false, &JobOptions::default()).unwrap();
        let found = combination.simulated.as_ref().unwrap();
        assert_eq!((&found.seeds, &found.scores), (&vec![1, 2], &judged.scores));
        assert_eq!(found.expected, Some(judged.verdicts.iter().all(|verdict| verdict.kept)));
        let one = |seed: u32| {
            let mut run = run.clone();
            run.reflectors.seed = seed;
            image_scene(&run, &JobOptions::default()).unwrap().metrics().unwrap()
        };
        let [first, second] = [1, 2].map(|seed| one(seed).completeness.unwrap());
        assert_eq!(found.mean.completeness, Some(f64::midpoint(first, second)));
        assert_eq!(found.error, Some(1.0 - f64::midpoint(first, second)));
        let spread = found.spread.completeness.unwrap();
        assert!((spread - (first - second).abs() / 2.0_f64.sqrt()).abs() < 1e-12, "{spread}");
        let design = combination.design.as_ref().unwrap();
        let step: f64 = combination.values[1].parse().unwrap();
        assert_eq!((design.tones, design.cost), ((4000.0 / step) as usize + 1, None));
        let expected = design.tones as f64 * design.acquisition.tone_seconds;
        assert!((design.acquisition.seconds - expected).abs() < 1e-9);
    }
    assert!(sweep.combinations.iter().any(|c| c.simulated.as_ref().is_some_and(|s| s.front.all)));
}

#[test]
fn divided_resumed_and_damaged_sweeps_have_the_bytes_of_one() {
    let folder = scene();
    let at = |name: &str| folder.path().join(name);
    done(folder.path(), &words("-o whole -j 1"));
    let whole = results(&at("whole"));
    assert_eq!(records(&at("whole")).len(), 4, "refused combinations are not recorded");
    let table = String::from_utf8(whole[0].clone()).unwrap();
    assert!(table.starts_with("array.count,sweep.step,microphones,tones,"), "{table}");
    assert_eq!(table.lines().count(), 7);
    assert_eq!(table.matches(",met,").count() + table.matches(",missed,").count(), 4, "{table}");

    // In parts, with other threads, and the last part twice.
    for part in ["3/3", "1/3", "2/3", "2/3"] {
        let work = done_json(folder.path(), &words(&format!("-o parts --part {part} -j 3")));
        assert_eq!((&work["combinations"], &work["part"]), (&6.into(), &2.into()), "{work}");
        assert!(!at("parts/sweep.csv").exists(), "a part makes no table");
    }
    let ran = run(folder.path(), &words("-o parts -j 2"));
    assert!(!ran.stderr.contains("are to be simulated"), "{}", ran.stderr);
    assert!(results(&at("parts")) == whole);
    let same = |a: &Path, b: &Path| fs::read(a).unwrap() == fs::read(b).unwrap();
    assert!(records(&at("parts")).iter().zip(records(&at("whole"))).all(|(a, b)| same(a, &b)));

    // One record is altered, one cut off, one is another's, and one is lost.
    let paths = records(&at("parts"));
    let mut altered = fs::read(&paths[0]).unwrap();
    let middle = altered.len() / 2;
    altered[middle] ^= 1;
    fs::write(&paths[0], &altered).unwrap();
    fs::write(&paths[1], &fs::read(&paths[1]).unwrap()[..100]).unwrap();
    fs::copy(&paths[3], &paths[2]).unwrap();
    fs::remove_file(&paths[3]).unwrap();
    let ran = run(folder.path(), &words("-o parts"));
    assert!(ran.stderr.contains("of 6 combinations 4 are to be simulated: 8 images"), "{}", ran.stderr);
    assert!(results(&at("parts")) == whole);

    // More values use what is there; other limits change no record, another seed and another mesh all of them.
    let more = words("-o parts").replace("5,7", "5,6,7");
    let ran = run(folder.path(), &more);
    assert!(ran.stderr.contains("of 9 combinations 2 are to be simulated: 4 images"), "{}", ran.stderr);
    let strict = words("-o parts --set expect.completeness={min=0.999}");
    let ran = run(folder.path(), &strict);
    assert!(ran.status == 0 && !ran.stderr.contains("are to be simulated"), "{}", ran.stderr);
    let table = fs::read_to_string(at("parts/sweep.csv")).unwrap();
    assert_eq!(table.matches(",missed,").count(), 4, "{table}");
    let ran = run(folder.path(), &words("-o parts --seeds 3"));
    assert!(ran.stderr.contains("4 are to be simulated: 4 images"), "{}", ran.stderr);
    let mesh = fs::read_to_string(at("corner.obj")).unwrap();
    fs::write(at("corner.obj"), format!("{mesh}v 0 0 1.9\nv 0.1 0 1.9\nv 0 0.1 1.9\nf -1 -2 -3\n")).unwrap();
    let ran = run(folder.path(), &words("-o parts"));
    assert!(ran.stderr.contains("4 are to be simulated: 8 images"), "{}", ran.stderr);
    assert!(results(&at("parts")) != whole);
}

#[test]
fn a_record_that_cannot_be_written_ends_the_sweep() {
    let folder = scene();
    done(folder.path(), &words("-o out"));
    let kept = folder.path().join("out");
    let table = fs::read(kept.join("sweep.csv")).unwrap();
    let taken = records(&kept).remove(0);
    fs::remove_file(&taken).unwrap();
    fs::create_dir(&taken).unwrap();
    refused(folder.path(), &words("-o out -q"), 1, &[taken.file_name().unwrap().to_str().unwrap()]);
    assert_eq!(records(&kept).len(), 3, "nothing unfinished is left");
    assert_eq!(fs::read(kept.join("sweep.csv")).unwrap(), table, "the older table stays");
}

/// Asks to stop after so many images.
struct StopAfter(AtomicU64, std::sync::Mutex<String>);

impl Observer for StopAfter {
    fn event(&self, event: Event<'_>) {
        match event {
            Event::Started { stage, .. } => stage.clone_into(&mut self.1.lock().unwrap()),
            Event::Advanced { amount } if *self.1.lock().unwrap() == "simulating" => {
                let _ = self.0.fetch_update(Ordering::Relaxed, Ordering::Relaxed, |left| {
                    Some(left.saturating_sub(amount))
                });
            }
            _ => {}
        }
    }

    fn should_stop(&self) -> bool {
        self.0.load(Ordering::Relaxed) == 0
    }
}

#[test]
fn what_is_finished_before_an_interruption_is_kept() {
    let folder = scene();
    let finished = folder.path().join("kept");
    let whole = simulated(folder.path(), "chamfer_distance", None, &JobOptions::default()).unwrap();
    let stop = StopAfter(AtomicU64::new(2), std::sync::Mutex::default());
    let job = JobOptions::default().with_observer(&stop);
    let interrupted = simulated(folder.path(), "chamfer_distance", Some(&finished), &job);
    assert_eq!(interrupted.unwrap_err(), Error::Interrupted);
    let kept = files_below(&finished).len();
    assert!((1..4).contains(&kept), "{kept} of 4 combinations");
    let resumed =
        simulated(folder.path(), "chamfer_distance", Some(&finished), &JobOptions::default()).unwrap();
    assert_eq!(resumed, whole);
}

#[test]
fn what_cannot_be_simulated_is_refused() {
    let folder = scene();
    fs::write(folder.path().join("points.csv"), "x,y,z,amplitude\n0,0,1.5,1\n").unwrap();
    fs::write(folder.path().join("file"), "").unwrap();
    for (more, parts) in [
        ("--part 0/2 -o out", &["--part", "0/2", "K/N"][..]),
        ("--part 3/2 -o out", &["--part", "3/2", "K/N"]),
        ("--part half -o out", &["--part", "half", "K/N"]),
        ("--part 1/2", &["--output"]),
        ("--seeds 1,x", &["--seeds", "x"]),
        ("--measure median", &["--measure", "median", "median_error"]),
        ("-o file", &["file", "folder"]),
        ("--set scene.mesh=points.csv", &["points.csv", "mesh", "surfaces"]),
        ("--set sweep.stop=10e3", &["sweep"]),
    ] {
        refused_with(folder.path(), &words(more), parts);
    }
    fs::create_dir(folder.path().join("taken")).unwrap();
    fs::write(folder.path().join("taken/combinations"), "").unwrap();
    refused_with(folder.path(), &words("-o taken"), &["combinations", "folder"]);
    refused_with(folder.path(), "plan run.toml --simulate", &["--sweep"]);
    refused_with(folder.path(), "plan run.toml --sweep sweep.step=200 --seeds 1", &["--simulate"]);
    assert!(!folder.path().join("out").exists());
    let keys = KEYS.map(|key| SweptKey::parse(key).unwrap());
    let run_with = |set: &[String]| RunFile::load(&folder.path().join("run.toml"), set);
    let measure = Measure::parse("rmse").unwrap();
    let simulation = SweepSimulation { seeds: &[], measure: &measure, folder: None };
    for (part, culprit) in [((0, 1), "0/1"), ((3, 2), "3/2"), ((1, 2), "-o")] {
        let refusal = work_on_designs(&keys, &run_with, &simulation, part, &JobOptions::default());
        assert_names(refusal.unwrap_err().to_string(), &["--part", culprit]);
    }
}

/// Refused with status 2, by the program or by its parser of options.
fn refused_with(folder: &Path, words: &str, parts: &[&str]) {
    let ran = run(folder, words);
    assert_eq!((ran.status, ran.stdout.as_str()), (2, ""), "{words}: {}", ran.stderr);
    assert_names(ran.stderr, parts);
}

#[test]
fn a_predicted_sweep_has_a_table_too() {
    let folder = scene();
    done(folder.path(), "plan run.toml --sweep sweep.step=200,300,400 --set recording.dwell=0.05 -o out");
    let table = fs::read_to_string(folder.path().join("out/sweep.csv")).unwrap();
    let rows: Vec<&str> = table.lines().collect();
    assert!(rows.len() == 4 && rows[0].ends_with(",mean_sidelobe_db,refused"), "{table}");
    assert!(rows[1].starts_with("200,49,21,1,1,0.05,dwell,1.05,"), "{table}");
    assert!(rows[2].starts_with("300,,,") && rows[2].contains("300"), "{table}");
    let json = json_file(&folder.path().join("out/sweep.json"));
    assert!(json["combinations"][0]["design"]["peak_bytes"].as_u64().unwrap() > 0);
    refused(folder.path(), "plan run.toml --sweep sweep.step=1:60000:1", 2, &["--sweep", "50000"]);
}
