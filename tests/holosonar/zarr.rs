//! Zarr stores from outside: cubes and volumes as inputs and outputs of commands, replaced and refused, and damaged at random.

use crate::binary::{done, done_json, files_below, refused, shipped};
use crate::mutation::{Structure, damage, restructure, retouch};
use crate::named::assert_names;
use crate::readers::LIMIT;
use crate::support::Random;
use holosonar::acquisition::{DataCube, Detection, Instrument, MicArray, Sweep};
use holosonar::config::RunFile;
use holosonar::error::ErrorKind;
use holosonar::export::amplitude::Amplitude;
use holosonar::export::read_volume;
use holosonar::glam::DVec3;
use holosonar::pipeline::write_volume;
use holosonar::wave::Geometry;
use num_complex::Complex32;
use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

/// Every file below a folder, by its name from there.
fn contents(folder: &Path) -> Vec<(PathBuf, Vec<u8>)> {
    let named = |path: PathBuf| (path.strip_prefix(folder).unwrap().to_owned(), fs::read(&path).unwrap());
    let mut all: Vec<_> = files_below(folder).into_iter().filter(|path| path.is_file()).map(named).collect();
    all.sort();
    all
}

fn cube() -> DataCube {
    let sweep = Sweep::stepped(10_000.0, 10_400.0, 100.0).unwrap();
    let array = MicArray::rectangular([3, 2], [0.02; 2], DVec3::ZERO).unwrap();
    let samples = (0..30).map(|i| Complex32::new(i as f32, 1.0)).collect();
    DataCube::new(Instrument::new(sweep, array), samples).unwrap()
}

#[test]
fn cubes_of_every_kind_are_read_as_they_were_written() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("cube.zarr");
    let cube = cube();
    let scattered = MicArray::from_positions(cube.instrument.array.positions().to_vec()).unwrap();
    let real: Vec<Complex32> = cube.samples.iter().map(|m| Complex32::new(m.re, 0.0)).collect();
    let instrument = &cube.instrument;
    let several = instrument.clone().with_sources(&[DVec3::ZERO, DVec3::X]).unwrap();
    let spread: Vec<DVec3> = (0..6).map(|i| DVec3::Y * f64::from(i)).collect();
    for (instrument, samples) in [
        (instrument.clone(), cube.samples.clone()),
        (Instrument::new(instrument.sweep.clone(), scattered), cube.samples.clone()),
        (instrument.clone().with_detection(Detection::InPhase), real),
        (several, [&cube.samples[..]; 2].concat()),
        (instrument.clone().with_geometry(Geometry::Monostatic), cube.samples.clone()),
        (instrument.clone().with_pairs(&spread).unwrap(), cube.samples.clone()),
    ] {
        let cube = DataCube::new(instrument, samples).unwrap();
        cube.write(&path).unwrap();
        // Which rounds the speakers of pairs, too.
        cube.write(&path.with_extension("npz")).unwrap();
        let [zarr, npz] =
            ["zarr", "npz"].map(|end| DataCube::read(&path.with_extension(end), LIMIT).unwrap());
        assert_eq!((&zarr.samples, &zarr), (&cube.samples, &npz));
    }
}

/// A folder with a scene of one point.
fn point_scene() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    for name in ["point.toml", "meshes/point.csv"] {
        let to = folder.path().join(name);
        fs::create_dir_all(to.parent().unwrap()).unwrap();
        fs::copy(shipped(name), to).unwrap();
    }
    folder
}

/// Files of units, by number, but for what all processes share.
fn units(folder: &Path) -> BTreeMap<u64, PathBuf> {
    let number = |path: &PathBuf| {
        let name = path.file_name()?.to_str()?.strip_suffix(".unit")?.to_owned();
        name.rsplit('.').next()?.parse().ok()
    };
    files_below(folder).into_iter().filter_map(|path| Some((number(&path)?, path))).collect()
}

#[test]
fn a_store_is_written_from_shards_that_any_number_of_processes_encode() {
    let folder = point_scene();
    let path = folder.path();
    done(path, "simulate point.toml -o cube.npz");
    let typed = "cube.npz -c point.toml --set output.components=complex --set output.formats=[\"zarr\"] \
                 --set grid.x=[-0.1,0.1] --set grid.y=[-0.1,0.1] --set grid.z=[0.6,1.6] --set grid.pitch=[0.02,0.02,0.01]";
    done(path, &format!("reconstruct {typed} -o whole/v.zarr"));
    let whole = contents(&path.join("whole/v.zarr"));
    // 101 depths in four shards of samples and four of amplitudes.
    let listed = done_json(path, &format!("plan {typed} --units"));
    let is_encoded = |unit: &&serde_json::Value| unit["stage"] == "encode";
    let first = listed.as_array().unwrap().len() as u64 - 8;
    assert_eq!(listed.as_array().unwrap().iter().filter(is_encoded).count(), 8);
    for of in [1, 3, 40] {
        let output = format!("parts{of}/v.zarr");
        let work = |part: u64| done(path, &format!("work {typed} -o {output} --part {part}/{of}"));
        // The last one finds all the depths that its shards begin in; the others may have to come again.
        let told: Vec<String> = (1..=of).rev().map(work).collect();
        if of == 3 {
            assert_names(&told[2], &["are left", "shards of the store", "`reconstruct`"]);
            assert!(units(path).range(first..).count() < 8);
        }
        (1..of).for_each(|part| drop(work(part)));
        assert_names(work(of), &["all are there"]);
        let encoded = units(path).split_off(&first);
        assert_eq!(encoded.len(), 8);
        // Lost, cut off and altered ones are encoded again.
        let [lost, cut, altered] = [0, 1, 2].map(|i| &encoded[&(first + i)]);
        fs::remove_file(lost).unwrap();
        let bytes = fs::read(cut).unwrap();
        fs::write(cut, &bytes[..bytes.len() - 9]).unwrap();
        let mut bytes = fs::read(altered).unwrap();
        let middle = bytes.len() / 2;
        bytes[middle] ^= 1;
        fs::write(altered, bytes).unwrap();
        if of > 1 {
            let again = done_json(path, &format!("work {typed} -o {output} --units {first}-{}", first + 3));
            assert_eq!((again["computed"].as_array().unwrap().len(), again["found"].as_u64()), (3, Some(1)));
        }
        done(path, &format!("reconstruct {typed} -o {output}"));
        assert!(contents(&path.join(&output)) == whole, "{of} parts");
        assert!(units(path).is_empty(), "nothing is left");
    }
    // Of an image, too; and without compression, whose units are others.
    let image = format!("{typed} --set output.compression=\"none\"");
    done(path, &format!("image {image} -o whole_image"));
    (1..=2).for_each(|part| drop(done(path, &format!("work {image} -o image --part {part}/2"))));
    assert_eq!(units(path).range(first..).count(), 8);
    done(path, &format!("image {image} -o image"));
    let [whole, shared] = ["whole_image", "image"].map(|of| contents(&path.join(of).join("volume.zarr")));
    assert!(whole == shared && units(path).is_empty());
}

#[test]
fn every_command_takes_stores_and_gives_the_same_results() {
    let folder = point_scene();
    let path = folder.path();
    done(path, "simulate point.toml -o cube.npz");
    done(path, "simulate point.toml -o cube.zarr");
    let complex = "--set output.components=complex";
    done(path, "reconstruct cube.npz -c point.toml -o a.npz");
    done(path, &format!("reconstruct cube.zarr -c point.toml -o b.npz -o b.zarr {complex}"));
    let [a, b] = ["a.npz", "b.npz"].map(|name| read_volume(&path.join(name), LIMIT).unwrap());
    assert!(a.0 == b.0);
    assert!(read_volume(&path.join("b.zarr"), LIMIT).unwrap() == b);
    // A job goes on from a store, and a store takes the place of one.
    let before = contents(&path.join("b.zarr"));
    done(path, &format!("-j 1 reconstruct cube.zarr -c point.toml -o b.zarr {complex}"));
    assert!(contents(&path.join("b.zarr")) == before);
    done(path, "depth b.npz -c point.toml -o a.exr");
    done(path, "depth b.zarr -c point.toml -o b.exr");
    assert!(fs::read(path.join("a.exr")).unwrap() == fs::read(path.join("b.exr")).unwrap());
    done(path, "image cube.zarr -c point.toml -o out --set output.formats=[\"zarr\"]");
    assert!(path.join("out/volume.zarr/amplitude/zarr.json").exists());
    let page = fs::read(path.join("out/report.html")).unwrap();
    done(path, "report out");
    assert!(fs::read(path.join("out/report.html")).unwrap() == page);
    for (name, word) in [("cube.zarr", "data cube"), ("b.zarr", "volume"), ("out/volume.zarr", "volume")] {
        assert_names(done(path, &format!("info {name}")), &[word]);
    }
    done(path, "info cube.zarr --health");
    done(path, "ascan cube.zarr");
    refused(path, "depth out/volume.zarr -o c.exr", 2, &["volume.zarr", "output.components=complex"]);
    refused(path, "depth cube.zarr -o c.exr", 2, &["cube.zarr", "data cube"]);
    refused(path, "reconstruct b.zarr -c point.toml -o c.npz", 2, &["b.zarr", "is a volume"]);
    // Its input, a folder of somebody's, and a file.
    let before = contents(path);
    refused(
        path,
        "reconstruct cube.zarr -c point.toml -o cube.zarr",
        2,
        &["cube.zarr", "input", "overwritten"],
    );
    fs::create_dir(path.join("mine.zarr")).unwrap();
    fs::write(path.join("mine.zarr/notes.txt"), "mine").unwrap();
    refused(path, "reconstruct cube.zarr -c point.toml -o mine.zarr", 2, &["mine.zarr", "did not write"]);
    fs::remove_dir_all(path.join("mine.zarr")).unwrap();
    fs::write(path.join("file.zarr"), "x").unwrap();
    refused(path, "simulate point.toml -o file.zarr", 2, &["file.zarr", "is a file"]);
    fs::remove_file(path.join("file.zarr")).unwrap();
    refused(path, "reconstruct cube.zarr -c point.toml -o c.zarr -o c.zarr", 2, &["c.zarr", "twice"]);
    assert!(contents(path) == before);
}

#[test]
fn damaged_stores_are_refused_or_read_and_never_panic() {
    let folder = tempfile::tempdir_in("/dev/shm").or_else(|_| tempfile::tempdir()).unwrap();
    let path = folder.path().join("a.zarr");
    let run = RunFile::of_overrides(&["output.components=complex".to_owned()]).unwrap().0;
    let axis = |first, count| holosonar::grid::Axis { first, pitch: 0.1, count };
    let grid = holosonar::grid::Grid { x: axis(-0.2, 5), y: axis(-0.1, 3), z: axis(1.0, 4) };
    let volume = holosonar::grid::Volume::new(grid, (0..60).map(|i| Complex32::new(0.5, i as f32)).collect());
    let mut random = Random::new(1);
    let (mut refused, mut read) = (0, 0);
    for round in 0..1500 {
        let _ = fs::remove_dir_all(&path);
        if round % 2 == 0 {
            cube().write(&path).unwrap();
        } else {
            write_volume(&path, &volume, &run.output, &serde_json::json!({ "sound_speed": 343.0 })).unwrap();
        }
        let files: Vec<PathBuf> = files_below(&path).into_iter().filter(|path| path.is_file()).collect();
        let file = random.one(&files);
        let bytes = fs::read(file).unwrap();
        let is_json = file.extension().is_some_and(|e| e == "json");
        let damaged = match random.whole(0, 3) {
            0 => retouch(&bytes, &mut random),
            1 if is_json => damage(&bytes, &mut random),
            _ if is_json => restructure(&bytes, Structure::Json, &mut random),
            _ => damage(&bytes, &mut random),
        };
        fs::write(file, damaged).unwrap();
        let results = [
            DataCube::read(&path, LIMIT).map(drop),
            read_volume(&path, LIMIT).map(drop),
            Amplitude::read(&path, LIMIT).map(drop),
        ];
        let taken = results.iter().any(Result::is_ok);
        for error in results.into_iter().filter_map(Result::err) {
            assert!(matches!(error.kind(), ErrorKind::InvalidInput | ErrorKind::NotFound), "{error:?}");
        }
        if taken { read += 1 } else { refused += 1 }
    }
    println!("{refused} refused, {read} read");
    assert!(refused > 500 && read > 100);
}
