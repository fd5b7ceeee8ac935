//! A folder of good and of damaged mesh files, each compared with its entry in `expected.toml`.

use crate::binary::{files_below, run};
use crate::named::{Warnings, all_named, assert_names};
use crate::support::data;
use glam::DVec3;
use holosonar::error::Result;
use holosonar::scene::{LoadOptions, MaterialRule, Scene};
use std::collections::{BTreeMap, BTreeSet};
use std::path::PathBuf;
use toml::{Table, Value};

fn table() -> BTreeMap<String, Table> {
    let text = std::fs::read_to_string(data("scenes/expected.toml")).unwrap();
    let table: Table = text.parse().unwrap();
    table.into_iter().map(|(name, value)| (name, value.as_table().unwrap().clone())).collect()
}

fn strings(list: &Value) -> Vec<String> {
    list.as_array().unwrap().iter().map(|word| word.as_str().unwrap().to_owned()).collect()
}

fn words(expected: &Table, key: &str) -> Vec<String> {
    expected.get(key).map(strings).unwrap_or_default()
}

fn number(expected: &Table, key: &str) -> Option<f64> {
    expected.get(key).map(|value| value.as_float().unwrap())
}

fn vector(expected: &Table, key: &str) -> DVec3 {
    let list = expected[key].as_array().unwrap();
    DVec3::from_slice(&list.iter().map(|v| v.as_float().unwrap()).collect::<Vec<_>>())
}

/// The options that the entry requests.
pub(crate) fn options(expected: &Table) -> LoadOptions {
    let word = |key: &str| expected.get(key).map(|value| value.as_str().unwrap());
    let mut options = LoadOptions::default();
    options.unit = word("unit").map(|unit| unit.parse().unwrap());
    options.up = word("up").map(|up| up.parse().unwrap());
    options.sensor = word("sensor").map(|sensor| sensor.parse().unwrap());
    for rule in expected.get("rules").and_then(Value::as_array).into_iter().flatten() {
        let rule = rule.as_table().unwrap();
        options.materials.push(MaterialRule {
            name: rule["name"].as_str().unwrap().to_owned(),
            reflectance: number(rule, "reflectance"),
            transmittance: number(rule, "transmittance"),
        });
    }
    options
}

/// Every mesh file of the folder, with the options that its entry requests.
pub(crate) fn inputs() -> Vec<(PathBuf, LoadOptions)> {
    table().iter().map(|(name, expected)| (data("scenes").join(name), options(expected))).collect()
}

#[test]
fn every_file_has_an_entry_and_every_entry_a_file() {
    let mut listed: BTreeSet<PathBuf> = BTreeSet::from([data("scenes/expected.toml")]);
    for (name, expected) in table() {
        listed.insert(data("scenes").join(name));
        listed.extend(words(&expected, "beside").iter().map(|name| data("scenes").join(name)));
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
        let loaded = Scene::load_with(&data("scenes").join(&name), &options(&expected), &warnings);
        if let Err(problem) = compare(&name, &expected, &loaded, &warnings.list()) {
            wrong.push(format!("{name}: {problem}"));
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

/// What is not as expected.
fn compare(
    name: &str,
    expected: &Table,
    loaded: &Result<Scene>,
    heard: &[String],
) -> std::result::Result<(), String> {
    let hold = |holds: bool, problem: String| if holds { Ok(()) } else { Err(problem) };
    let scene = match (loaded, expected.get("error")) {
        (Ok(scene), None) => scene,
        (Ok(_), Some(_)) => return Err("an error was expected".to_owned()),
        (Err(error), None) => return Err(error.to_string()),
        (Err(error), Some(_)) => {
            let message = error.to_string();
            hold(error.exit_status() == 2, format!("is the file's fault: {message}"))?;
            let file = std::path::Path::new(name).file_stem().unwrap().to_str().unwrap();
            hold(message.contains(file) && !message.contains('\n'), message.clone())?;
            return words(expected, "error").iter().try_for_each(|word| {
                hold(all_named(&message, &[word]), format!("{word:?} is not named: {message}"))
            });
        }
    };
    // What each warning names; of a list everything.
    let warnings: Vec<Vec<String>> =
        expected.get("warnings").and_then(Value::as_array).into_iter().flatten().map(strings).collect();
    hold(warnings.len() == heard.len(), format!("warnings: {heard:?}"))?;
    for parts in warnings {
        let parts: Vec<&str> = parts.iter().map(String::as_str).collect();
        hold(heard.iter().any(|h| all_named(h, &parts)), format!("{parts:?} is not named: {heard:?}"))?;
    }
    let triangles = expected["triangles"].as_integer().unwrap();
    hold(scene.triangles().len() as i64 == triangles, format!("{} triangles", scene.triangles().len()))?;
    let tolerance = number(expected, "tolerance").unwrap_or(1e-9);
    let (low, high) = scene.bounds().unwrap();
    for (found, key) in [(low, "low"), (high, "high")] {
        let off = (found - vector(expected, key)).abs().max_element();
        hold(off <= tolerance, format!("{key} is {found}"))?;
    }
    if let Some(area) = number(expected, "area") {
        let found = scene.surface_area();
        hold((found - area).abs() <= tolerance.max(1e-6 * area), format!("area is {found}"))?;
    }
    let materials: Vec<String> = scene
        .materials()
        .iter()
        .map(|m| format!("{} {} {} {}", m.name, m.reflectance, m.transmittance, m.source))
        .collect();
    let wanted = words(expected, "materials");
    hold(wanted.is_empty() || wanted == materials, format!("materials: {materials:?}"))
}

#[test]
fn a_wrong_entry_is_noticed() {
    let loaded = Scene::load(&data("scenes/f.gltf"), &LoadOptions::default());
    let right = "triangles = 6\nlow = [-0.3, -0.5, 2.0]\nhigh = [0.3, 0.5, 2.0]\ntolerance = 1e-6\narea = 0.34\n\
                 materials = [\"letter 1 0 default\"]\n";
    let held =
        |text: &str, heard: &[String]| compare("f.gltf", &text.parse().unwrap(), &loaded, heard).is_ok();
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
        ("alpha", "0.25", "0.75", "glTF alpha"),
        ("unblended", "1", "0", "default"),
        ("glass", "0.1", "0.5", "rule `gl?ss`"),
        ("measured", "0.125", "0.25", "glTF extras"),
    ] {
        in_one_line(&[name, "reflectance", reflectance, "transmittance", transmittance, source]);
    }
    assert_names(&warned, &["rule", "`steel*`"]);
    assert!(!warned.contains("`gl?ss`"), "{warned}");
}

#[test]
fn a_suspicious_scale_names_the_keys_to_change() {
    let (_, warned) = imaged("stl/binary.stl", "unit = 'mm'\ntranslate = [0, 0, 1]");
    assert_names(warned, &["2.00 mm", "wavelength", "22.9 mm", "[scene] unit", "scale"]);
    // 100 Hz repeat every 3.43 m of path.
    let (_, warned) = imaged("stl/binary.stl", "unit = 'cm'\nscale = 10.0\ntranslate = [0, 0, 3]");
    assert_names(warned, &["unambiguous", "1.72 m", "[scene] unit", "scale"]);
    let (_, warned) = imaged("stl/binary.stl", "unit = 'cm'\nscale = 10.0\ntranslate = [0, 0, 0.9]");
    assert!(!warned.contains("[scene] unit"), "{warned}");
}
