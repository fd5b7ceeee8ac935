//! A folder of good and of damaged mesh files, each compared with its entry in `expected.toml`.

use crate::binary::{files_below, run};
use crate::named::{Warnings, all_named, assert_names};
use crate::support::data;
use glam::DVec3;
use holosonar::error::Result;
use holosonar::scene::{LoadOptions, MaterialRule, Scene, Sensor, Unit, Up};
use serde::Deserialize;
use std::collections::{BTreeMap, BTreeSet};
use std::path::PathBuf;

/// An entry of `expected.toml`: options for reading, and the scene or the error that is expected.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Expected {
    unit: Option<Unit>,
    up: Option<Up>,
    sensor: Option<String>,
    #[serde(default)]
    rules: Vec<MaterialRule>,
    /// Files that belong to this one.
    #[serde(default)]
    beside: Vec<String>,
    /// What the error names.
    error: Option<Vec<String>>,
    /// What each warning names.
    #[serde(default)]
    warnings: Vec<Vec<String>>,
    triangles: Option<usize>,
    tolerance: Option<f64>,
    low: Option<[f64; 3]>,
    high: Option<[f64; 3]>,
    area: Option<f64>,
    #[serde(default)]
    materials: Vec<String>,
}

impl Expected {
    /// The options that the entry requests.
    fn options(&self) -> LoadOptions {
        let sensor: Option<Sensor> = self.sensor.as_ref().map(|sensor| sensor.parse().unwrap());
        let options = LoadOptions::default().with_unit(self.unit).with_up(self.up).with_sensor(sensor);
        options.with_materials(self.rules.clone())
    }
}

fn table() -> BTreeMap<String, Expected> {
    toml::from_str(&std::fs::read_to_string(data("scenes/expected.toml")).unwrap()).unwrap()
}

/// Every mesh file of the folder, with the options that its entry requests.
pub(crate) fn inputs() -> Vec<(PathBuf, LoadOptions)> {
    table().iter().map(|(name, expected)| (data("scenes").join(name), expected.options())).collect()
}

#[test]
fn every_file_has_an_entry_and_every_entry_a_file() {
    let mut listed: BTreeSet<PathBuf> = BTreeSet::from([data("scenes/expected.toml")]);
    for (name, expected) in table() {
        listed.insert(data("scenes").join(name));
        listed.extend(expected.beside.iter().map(|name| data("scenes").join(name)));
    }
    let found: BTreeSet<PathBuf> = files_below(&data("scenes")).into_iter().collect();
    let strangers: Vec<_> = found.symmetric_difference(&listed).collect();
    assert!(strangers.is_empty(), "listed without a file, or there without an entry: {strangers:?}");
}

#[test]
fn every_file_comes_to_what_was_expected() {
    let mut wrong = Vec::new();
    for (name, expected) in table() {
        let warnings = Warnings::default();
        let loaded = Scene::load_with(&data("scenes").join(&name), &expected.options(), &warnings);
        if let Err(problem) = compare(&name, &expected, &loaded, &warnings.list()) {
            wrong.push(format!("{name}: {problem}"));
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

/// What is not as expected.
fn compare(
    name: &str,
    expected: &Expected,
    loaded: &Result<Scene>,
    heard: &[String],
) -> std::result::Result<(), String> {
    let hold = |holds: bool, problem: String| if holds { Ok(()) } else { Err(problem) };
    let scene = match (loaded, &expected.error) {
        (Ok(scene), None) => scene,
        (Ok(_), Some(_)) => return Err("an error was expected".to_owned()),
        (Err(error), None) => return Err(error.to_string()),
        (Err(error), Some(words)) => {
            let message = error.to_string();
            hold(error.exit_status() == 2, format!("is the file's fault: {message}"))?;
            let file = std::path::Path::new(name).file_stem().unwrap().to_str().unwrap();
            hold(message.contains(file) && !message.contains('\n'), message.clone())?;
            return words.iter().try_for_each(|word| {
                hold(all_named(&message, &[word]), format!("{word:?} is not named: {message}"))
            });
        }
    };
    hold(expected.warnings.len() == heard.len(), format!("warnings: {heard:?}"))?;
    for parts in &expected.warnings {
        let parts: Vec<&str> = parts.iter().map(String::as_str).collect();
        hold(heard.iter().any(|h| all_named(h, &parts)), format!("{parts:?} is not named: {heard:?}"))?;
    }
    let triangles = scene.triangles().len();
    hold(expected.triangles == Some(triangles), format!("{triangles} triangles"))?;
    let tolerance = expected.tolerance.unwrap_or(1e-9);
    let (low, high) = scene.bounds().unwrap();
    for (found, key, corner) in [(low, "low", expected.low), (high, "high", expected.high)] {
        let off = (found - DVec3::from(corner.unwrap())).abs().max_element();
        hold(off <= tolerance, format!("{key} is {found}"))?;
    }
    if let Some(area) = expected.area {
        let found = scene.surface_area();
        hold((found - area).abs() <= tolerance.max(1e-6 * area), format!("area is {found}"))?;
    }
    let materials: Vec<String> = scene
        .materials()
        .iter()
        .map(|m| format!("{} {} {} {}", m.name, m.reflectance, m.transmittance, m.source))
        .collect();
    let wanted = &expected.materials;
    hold(wanted.is_empty() || *wanted == materials, format!("materials: {materials:?}"))
}

#[test]
fn a_wrong_entry_is_noticed() {
    let loaded = Scene::load(&data("scenes/f.gltf"), &LoadOptions::default());
    let right = "triangles = 6\nlow = [-0.3, -0.5, 2.0]\nhigh = [0.3, 0.5, 2.0]\ntolerance = 1e-6\narea = 0.34\n\
                 materials = [\"letter 1 0 default\"]\n";
    let held = |text: &str, heard: &[String]| {
        compare("f.gltf", &toml::from_str(text).unwrap(), &loaded, heard).is_ok()
    };
    assert!(held(right, &[]));
    assert!(!held(right, &["a warning".to_owned()]));
    assert!(!held("error = []", &[]));
    for (from, to) in
        [("= 6", "= 7"), ("-0.5", "-0.6"), ("0.5, 2.0]", "0.5, 3.0]"), ("0.34", "0.35"), ("letter", "lettre")]
    {
        assert!(!held(&right.replace(from, to), &[]), "{from} {to}");
    }
}

/// Images a mesh of this folder with few microphones and voxels; what was printed and what was warned of.
fn imaged(mesh: &str, scene: &str) -> (String, String) {
    let folder = tempfile::tempdir().unwrap();
    let mesh = data("scenes").join(mesh);
    let run_file = format!(
        "[scene]\nmesh = '{}'\n{scene}\n[sweep]\nstep = 100.0\n[array]\ncount = [7, 7]\n\
         [grid]\nx = [-0.5, 1.5]\ny = [-0.5, 1.5]\nz = [0.5, 1.2]\npitch = [0.1, 0.1, 0.02]\n",
        mesh.display()
    );
    std::fs::write(folder.path().join("run.toml"), run_file).unwrap();
    let ran = run(folder.path(), "image run.toml -o out");
    assert_eq!(ran.status, 0, "{}", ran.stderr);
    (ran.stdout, ran.stderr)
}

#[test]
fn the_box_and_the_resolved_materials_are_printed() {
    let rules = "[[materials]]\nname = 'gl?ss'\nreflectance = 0.1\n[[materials]]\nname = 'steel*'\nreflectance = 0.1\n";
    let (said, warned) =
        imaged("gltf/materials.gltf", &format!("up = 'none'\ntranslate = [0, 0, 1]\n{rules}"));
    // 343 m/s at the centre of 10 to 20 kHz is 22.87 mm: a metre has 43.7 of it.
    let in_one_line = |parts: &[&str]| {
        assert!(said.lines().any(|line| all_named(line, parts)), "no line names {parts:?}: {said}");
    };
    in_one_line(&["1.000 x 1.000 x 0.000 m", "43.7 x 43.7 x 0.0"]);
    in_one_line(&["z", "1.000 to 1.000 m"]);
    for (name, reflectance, transmittance, source) in [
        ("alpha", "0.99", "0", "glTF alpha, as glass"),
        ("unblended", "1", "0", "default"),
        ("glass", "0.1", "0", "rule `gl?ss`"),
        ("measured", "0.125", "0.25", "glTF extras"),
    ] {
        in_one_line(&[name, "reflectance", reflectance, "transmittance", transmittance, source]);
    }
    assert_names(&warned, &["rule", "`steel*`"]);
    assert!(!warned.contains("`gl?ss`"), "{warned}");
}

#[test]
fn a_suspicious_scale_names_the_keys_to_change() {
    let (_, warned) = imaged("stl/binary.stl", "unit = 'mm'\nup = 'none'\ntranslate = [0, 0, 1]");
    assert_names(warned, &["2.00 mm", "wavelength", "22.9 mm", "[scene] unit", "scale"]);
    // 100 Hz repeat every 3.43 m of path.
    let (_, warned) =
        imaged("stl/binary.stl", "unit = 'cm'\nup = 'none'\nscale = 10.0\ntranslate = [0, 0, 3]");
    assert_names(warned, &["unambiguous", "1.72 m", "[scene] unit", "scale"]);
    let (_, warned) =
        imaged("stl/binary.stl", "unit = 'cm'\nup = 'none'\nscale = 10.0\ntranslate = [0, 0, 0.9]");
    assert!(!warned.contains("[scene] unit"), "{warned}");
}
