//! What a run file means: what is accepted, filled in and written again. `refusals` has what is refused, and `hostile`
//! that nothing panics.

#![allow(clippy::unwrap_used)]

mod hostile;
mod refusals;

use super::*;
use crate::export::Fill;
use crate::named::assert_names;
use crate::scene::{CommonMaterial, Unit};
use glam::DVec3;
use std::path::PathBuf;

fn read(text: &str) -> Result<RunFile> {
    RunFile::from_str_at(text, "run.toml", Path::new("folder"), &[])
}

fn read_with(text: &str, overrides: &[&str]) -> Result<RunFile> {
    let overrides: Vec<String> = overrides.iter().map(ToString::to_string).collect();
    RunFile::from_str_at(text, "run.toml", Path::new("folder"), &overrides)
}

#[track_caller]
fn refused(text: &str) -> String {
    let error = read(text).expect_err(text);
    assert_eq!(error.exit_status(), 2);
    let message = error.to_string();
    assert!(!message.contains('\n'), "one paragraph: {message}");
    message
}

/// Asserts that `text` is refused by a message that names every one of `parts`.
#[track_caller]
fn refused_with(text: &str, parts: &[&str]) {
    assert_names(refused(text), parts);
}

fn scenes() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes")
}

#[test]
fn an_empty_file_means_the_defaults() {
    assert_eq!(read("").unwrap(), RunFile::default());
    assert_eq!(read("\u{feff}# nothing\r\n[sweep]\r\n").unwrap(), RunFile::default());
    RunFile::default().check().unwrap();
    assert_eq!(RunFile::default().array.pitch, Some([0.016, 0.016]));
    assert_eq!(read("[array]\nextent = [1, 1]").unwrap().array.pitch, None);
}

#[test]
fn every_shipped_scene_survives_a_round_trip_through_toml_and_json() {
    let mut seen = 0;
    for entry in std::fs::read_dir(scenes()).unwrap() {
        let path = entry.unwrap().path();
        if path.extension().is_some_and(|extension| extension == "toml") {
            let run = RunFile::load(&path, &[]).unwrap();
            let again = RunFile::from_str_at(&run.to_toml(), "resolved", &scenes(), &[]).unwrap();
            assert_eq!(run, again, "{}", path.display());
            let mut from_json: RunFile = serde_json::from_value(run.to_json()).unwrap();
            if let Some(mesh) = &mut from_json.scene.mesh {
                mesh.locate(&scenes());
            }
            assert_eq!(run, from_json, "{}", path.display());
            seen += 1;
        }
    }
    assert!(seen >= 5, "the scenes are shipped");
}

#[test]
fn every_scene_has_voxels_on_a_lattice_shared_with_its_array() {
    for name in ["corner", "corner2", "transparent_foreground", "cad", "bracket", "point"] {
        let run = RunFile::load(&scenes().join(name).with_extension("toml"), &[]).unwrap();
        let pitch = run.grid.pitch.unwrap();
        for (axis, ends) in [run.grid.x.unwrap(), run.grid.y.unwrap()].into_iter().enumerate() {
            let intervals = f64::from(run.array.count.unwrap()[axis] - 1);
            let mics = run
                .array
                .pitch
                .map_or_else(|| run.array.extent.unwrap()[axis] / intervals, |pitch| pitch[axis]);
            let whole = |value: f64| (value - value.round()).abs() < 1e-9;
            assert!(whole(mics / pitch[axis]), "{name}: {mics} m is a multiple of {} m", pitch[axis]);
            assert!(whole((ends[0] + mics * intervals / 2.0) / pitch[axis]), "{name}: same offset");
            assert!(whole((ends[1] - ends[0]) / pitch[axis]), "{name}: centred");
        }
    }
}

#[test]
fn the_annotated_file_equals_the_corner_scene() {
    let annotated = RunFile::from_str_at(ANNOTATED, "annotated", &scenes(), &[]).unwrap();
    assert_eq!(annotated, RunFile::load(&scenes().join("corner.toml"), &[]).unwrap());
    let defaults = RunFile::default().to_json();
    for (table, keys) in defaults.as_object().unwrap() {
        assert!(ANNOTATED.contains(&format!("[{table}]")), "[{table}]");
        for key in keys.as_object().unwrap().keys() {
            assert!(
                ANNOTATED.contains(&format!("\n{key} =")) || ANNOTATED.contains(&format!("\n# {key} =")),
                "{key}"
            );
        }
    }
    // Keys that are commented out are valid too, apart from those that exclude one another.
    let open: Vec<&str> = ANNOTATED
        .lines()
        .map(|line| {
            let key = line.strip_prefix("# ").filter(|rest| {
                rest.starts_with("[[") || rest.split_once(" = ").is_some_and(|(key, _)| !key.contains(' '))
            });
            let exclusive = "size translate sensor parts source_offset source_file elements extent spacing=0.016 seed file fov pixels temperature humidity \
                             pressure low_pass sub_band velocity sequences #";
            let is_exclusive = |rest: &str| {
                let compact = rest.replace(' ', "");
                exclusive.split(' ').any(|start| compact.starts_with(start))
            };
            key.filter(|rest| !is_exclusive(rest)).unwrap_or(line)
        })
        .collect();
    let open = read(&open.join("\n")).unwrap();
    assert_eq!((open.materials.len(), open.grid.count), (1, Some([145, 161, 126])));
}

#[test]
fn parts_are_named_after_their_files_and_written_with_those_names() {
    let text = "[[scene.parts]]\nmesh = \"a/cup.obj\"\n[[scene.parts]]\nmesh = \"cup.stl\"\n[[scene.parts]]\nmesh = \"b.obj\"\n\
                name = \"cup 2\"\nmaterial = \"glass\"\nfit = [0, 0, 1]\n[[scene.parts]]\nmesh = \"b.ply\"\nunit = \"ft\"";
    let run = read(text).unwrap();
    let names: Vec<_> = run.scene.parts.iter().map(|part| part.name.as_deref().unwrap()).collect();
    assert_eq!(names, ["cup", "cup 3", "cup 2", "b"]);
    let files = run.part_files();
    assert_eq!(files[0].path, Path::new("folder/a/cup.obj"));
    assert_eq!((files[2].material, files[2].options.fit), (Some(CommonMaterial::Glass), Some(DVec3::Z)));
    assert_eq!(files[3].options.unit, Some(Unit::Foot));
    assert_eq!(read(&run.to_toml()).unwrap(), run);
    let moved = read_with(text, &["scene.parts.1.translate=[1, 0, 0]", "scene.fit=[0, 0, 2]"]).unwrap();
    assert_eq!((moved.part_files()[1].options.translate, moved.scene.fit), (DVec3::X, Some([0.0, 0.0, 2.0])));
    // A mesh instead of the parts, and the other way round.
    let one = read_with(text, &["scene.mesh=a.obj"]).unwrap();
    assert!(one.scene.parts.is_empty());
    let several = read_with("[scene]\nmesh = \"a.obj\"", &["scene.parts=[{mesh=\"b.obj\"}]"]).unwrap();
    assert!(several.scene.mesh.is_none() && several.scene.files().count() == 1);
}

#[test]
fn files_are_relative_to_the_run_file_and_written_as_typed() {
    let run = read("[scene]\nmesh = \"a/b.obj\"").unwrap();
    let mesh = run.scene.mesh.clone().unwrap();
    assert_eq!(mesh.path, Path::new("folder/a/b.obj"));
    assert_eq!(mesh.typed, "a/b.obj");
    assert!(run.to_toml().contains("mesh = \"a/b.obj\""));
    assert_eq!(run.to_json()["scene"]["mesh"], "a/b.obj");
}

#[test]
fn a_grid_axis_needs_two_of_end_pitch_and_count() {
    let spanned = read("[grid]\nx=[0,1]\ny=[0,1]\nz=[1,2]\npitch=[0.5,0.5,0.25]").unwrap().grid;
    let follows = read("[grid]\nx=0\ny=0.0\nz=1\npitch=[0.5,0.5,0.25]\ncount=[3,3,5]").unwrap().grid;
    let counted = read("[grid]\nx=[0,1]\ny=[0,1]\nz=[1,2]\ncount=[3,3,5]").unwrap().grid;
    assert_eq!(follows, counted);
    assert_eq!((spanned.x, spanned.z, spanned.pitch), (counted.x, counted.z, counted.pitch));
    refused_with("[grid]\nx = 0", &["`grid.x`", "pitch", "count"]);
    refused_with(
        "[grid]\nx=[0,1]\ny=[0,1]\nz=[1,2]\npitch=[0.5,0.5,0.5]\ncount=[3,3,5]",
        &["`grid.z`", "3 voxels", "5"],
    );
    refused_with("[grid]\nx=[0,1]\ny=[0,1]\nz=[1,1]\ncount=[3,3,1]", &["`grid.count`", "`pitch`"]);
    refused_with("[grid]\ncount=[3,3,1]", &["`grid.count`", "x, y", "z"]);
    refused_with("[grid]\nx=0\ny=0\nz=0\ncount=[0,1,1]\npitch=[1,1,1]", &["`grid.count", "1"]);
}

#[test]
fn fill_is_a_word_or_a_depth() {
    for (typed, fill) in [
        ("\"nan\"", Fill::NaN),
        ("inf", Fill::Infinity),
        ("nan", Fill::NaN),
        ("0", Fill::Depth(0.0)),
        ("9.5", Fill::Depth(9.5)),
    ] {
        let run = read(&format!("[depth]\nfill = {typed}")).unwrap();
        assert_eq!(run.depth.fill, fill);
        assert_eq!(read(&run.to_toml()).unwrap(), run);
    }
}

#[test]
fn overrides_are_values_or_bare_words() {
    let text = "[scene]\nmesh = \"a.obj\"\ntranslate = [0, 0, 2]\n[[materials]]\nname = \"a\"\n[array]\npitch = [1, 1]";
    let run = read_with(
        text,
        &[
            "scene.mesh=other mesh.obj",
            "scene.unit=mm",
            "scene.fit = [0, 0, 1]",
            "materials.0.reflectance=0.25",
            "array.extent=[1.0,1.0]",
            "depth.fill=\"nan\"",
            "expect.rmse.max=0.1",
            "grid.pitch=[1,2,3]",
            "grid.pitch=[0.1,0.1,0.1]",
        ],
    )
    .unwrap();
    assert_eq!(run.scene.mesh.as_ref().unwrap().path, Path::new("folder/other mesh.obj"));
    assert_eq!(
        (run.scene.unit, run.scene.fit, run.scene.translate),
        (Some(Unit::Millimetre), Some([0.0, 0.0, 1.0]), None)
    );
    assert_eq!((run.array.extent, run.array.pitch), (Some([1.0, 1.0]), None));
    assert_eq!(run.materials[0].reflectance, Some(0.25));
    assert_eq!((run.depth.fill, run.grid.pitch), (Fill::NaN, Some([0.1, 0.1, 0.1])));
    assert_eq!(run.expect.limits["rmse"], Limit { min: None, max: Some(0.1) });
    // TOML asks for the zeros that people leave out; text stays text.
    let run = read_with(text, &["scene.scale=.5", "scene.fit=[-.25, 0, 3.]", "scene.mesh=v1.obj"]).unwrap();
    assert_eq!((run.scene.scale, run.scene.fit), (0.5, Some([-0.25, 0.0, 3.0])));
    assert_eq!(run.scene.mesh.as_ref().unwrap().path, Path::new("folder/v1.obj"));
    let run = read_with(text, &["materials=[{name=\"b\"}]"]).unwrap();
    assert_eq!(run.materials[0].name, "b");
}

#[test]
fn the_speed_of_sound_is_typed_or_that_of_the_air() {
    assert_eq!(read("").unwrap().medium.speed(), 343.0);
    assert_eq!(read("[medium]\nsound_speed = 1480").unwrap().medium.speed(), 1480.0);
    let run = read("[medium]\ntemperature = 20\nhumidity = 0\nabsorption = true").unwrap();
    assert!((run.medium.speed() - 343.2).abs() < 0.05);
    assert_eq!(run.simulate_options().losses.air, run.medium.air());
    let again = RunFile::from_str_at(&run.to_toml(), "resolved", Path::new("folder"), &[]).unwrap();
    assert_eq!(run, again);
    // Overriding one key removes the other.
    let run = read_with("[medium]\nsound_speed = 340", &["medium.temperature=0"]).unwrap();
    assert_eq!((run.medium.sound_speed, run.medium.humidity), (None, Some(50.0)));
    assert_eq!(run.simulate_options().losses.air, None, "air absorbs only on request");
}

#[test]
fn one_run_file_serves_every_layout_with_the_same_number_of_microphones() {
    let text = "[array]\ncount = [16, 16]\nextent = 1.0";
    for layout in ["grid", "spiral", "random"] {
        let array = read_with(text, &[&format!("array.layout={layout}")]).unwrap().microphones().unwrap();
        assert_eq!(array.len(), 256, "{layout}");
        assert!((array.extent().x - 1.0).abs() < 0.1, "{layout}: {}", array.extent());
    }
    let elements = read("[array]\nelements = 256\npitch = 0.02").unwrap();
    assert_eq!(elements.microphones().unwrap().lattice().unwrap().x.count, 16);
    let again = RunFile::from_str_at(&elements.to_toml(), "resolved", Path::new("folder"), &[]).unwrap();
    assert_eq!(elements, again);
    // A row spans nothing across, where its pitch is that along it.
    for (text, pitch) in [("[3, 1]\nextent = [1, 0]", 0.5), ("[1, 5]\nextent = [0, 1]", 0.25)] {
        let row = read(&format!("[array]\ncount = {text}")).unwrap().microphones().unwrap();
        let lattice = row.lattice().unwrap();
        assert_eq!([lattice.x.pitch, lattice.y.pitch], [pitch; 2]);
    }
    assert_eq!(read("[array]\ncount = 1\nextent = 0").unwrap().microphones().unwrap().len(), 1);
    let spans = read("[array]\ncount = [3, 1]\nextent = 2").unwrap_err().to_string();
    assert!(
        spans.contains("one microphone along y spans 0, not 2.0 m; write extent = [2.0, 0.0]"),
        "{spans}"
    );
    // A layout on the command line removes keys of other layouts only, and one number of microphones the other.
    let random = "[array]\nlayout = \"random\"\nelements = 256\nextent = [1, 1]\nseed = 4\nspacing = 0.02";
    assert!(read(random).unwrap().microphones().unwrap().lattice().is_none());
    assert!(read_with(random, &["array.layout=grid"]).unwrap().microphones().unwrap().lattice().is_some());
    assert_eq!(read_with(random, &["array.count=9"]).unwrap().microphones().unwrap().len(), 81);
    // 400 x 400 on a spiral are more than anybody means.
    let warned = |typed: &[&str]| read_with(random, typed).unwrap().array.count_warning();
    assert!(warned(&["array.count=400"]).unwrap().contains("elements = 400"));
    for typed in ["array.count=20", "array.count=[400,100]", "array.elements=160000"] {
        assert!(warned(&[typed]).is_none(), "{typed}");
    }
}
