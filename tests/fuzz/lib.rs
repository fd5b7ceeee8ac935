//! What the fuzz targets do with their bytes. The guide's chapter "code" says how to run them.

#[path = "../holosonar/mutation.rs"]
mod mutation;
#[allow(dead_code)] // tests use more of it
#[path = "../holosonar/random.rs"]
mod random;
#[path = "../holosonar/readers.rs"]
mod readers;

use holosonar::checkpoint::fuzzing::read_journal;
use holosonar::config::RunFile;
use holosonar::error::{Error, Result};
use holosonar::pipeline::{Forecast, JobOptions, forecast_scene, image_scene, write_outputs};
use holosonar::scene::{LoadOptions, Unit};
use random::Random;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::LazyLock;

/// Bytes that a job may take.
const MEMORY: u64 = 64 << 20;

/// Operations of a job of milliseconds.
const OPERATIONS: f64 = 3e7;

/// A folder of this process, in memory where that can be.
static FOLDER: LazyLock<PathBuf> = LazyLock::new(|| {
    let shared = Path::new("/dev/shm");
    let parent = if shared.is_dir() { shared.to_owned() } else { std::env::temp_dir() };
    let folder = parent.join(format!("holosonar-fuzz-{}", std::process::id()));
    fs::create_dir_all(&folder).expect("a folder for inputs");
    folder
});

/// A target that reads its bytes as a file of this format, and changes them by the format's structure.
#[macro_export]
macro_rules! reader {
    ($extension:literal) => {
        libfuzzer_sys::fuzz_target!(|data: &[u8]| $crate::read($extension, data));
        $crate::mutator!($extension);
    };
}

/// Changes to a target's bytes: every other one by the structure of this format.
#[macro_export]
macro_rules! mutator {
    ($extension:literal) => {
        libfuzzer_sys::fuzz_mutator!(|data: &mut [u8], size: usize, max_size: usize, seed: u32| {
            $crate::mutate($extension, data, size, max_size, seed)
        });
    };
}

/// The format of files whose names end like this.
fn format(extension: &str) -> &'static readers::Format {
    readers::FORMATS.iter().find(|format| format.extension == extension).expect("a format")
}

/// Reads a file of these bytes by all readers of its format.
pub fn read(extension: &str, data: &[u8]) {
    let path = FOLDER.join("input").with_extension(extension);
    fs::write(&path, data).expect("an input that can be written");
    let options = match extension {
        "gltf" | "glb" => LoadOptions::default(),
        _ => LoadOptions::default().with_unit(Unit::Metre),
    };
    readers::read(format(extension), &path, &options);
}

/// Changes the first `size` bytes, which may become `max_size`; returns how many they have become.
pub fn mutate(extension: &str, data: &mut [u8], size: usize, max_size: usize, seed: u32) -> usize {
    let mut random = Random::new(seed.into());
    if random.whole(0, 1) == 0 {
        return libfuzzer_sys::fuzzer_mutate(data, size, max_size);
    }
    let changed = mutation::restructure(&data[..size], format(extension).structure, &mut random);
    let length = changed.len().min(max_size);
    data[..length].copy_from_slice(&changed[..length]);
    length
}

/// Opens a journal of these bytes, of which the first says which seals are made right, and goes on with it.
pub fn journal(data: &[u8]) {
    let Some((seals, bytes)) = data.split_first() else { return };
    read_journal(&FOLDER.join("cube.npz"), bytes, seals & 1 != 0, seals & 2 != 0);
}

/// The run file of a small job with lines of `--set`, and what is predicted of it.
fn predicted(data: &[u8]) -> Option<(RunFile, Forecast)> {
    let text = str::from_utf8(data).ok()?;
    let overrides: Vec<String> = text.lines().take(8).map(str::to_owned).collect();
    let folder = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut run = user_fault(RunFile::load(&folder.join("small.toml"), &overrides))?;
    run.memory = Some(MEMORY);
    let forecast = user_fault(forecast_scene(&run, &JobOptions::default()))?;
    Some((run, forecast))
}

/// A result, or nothing if the input was wrong or took too much memory.
fn user_fault<T>(result: Result<T>) -> Option<T> {
    match result {
        Ok(value) => Some(value),
        Err(Error::InvalidInput { .. } | Error::NotFound { .. } | Error::OutOfMemory { .. }) => None,
        Err(other) => panic!("{other}"),
    }
}

/// Plans a small job with these lines of `--set`.
pub fn set(data: &[u8]) {
    predicted(data);
}

/// Runs a small job with these lines of `--set`, if it remains small; one in eight writes its files.
pub fn pipeline(data: &[u8]) {
    let Some((run, forecast)) = predicted(data) else { return };
    if forecast.methods[forecast.chosen].operations > OPERATIONS {
        return;
    }
    let Some(outcome) = user_fault(image_scene(&run, &JobOptions::default())) else { return };
    assert!(outcome.image.volume.samples.iter().all(|sample| sample.is_finite()));
    // Pictures take a hundred times as long as all else.
    if data.len() % 8 == 0 {
        user_fault(write_outputs(&run, &outcome, &FOLDER.join("out"), &JobOptions::default()));
    }
}
