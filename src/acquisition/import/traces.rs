//! Files of one position each: Touchstone and CSV, in the order of the microphones or found by their names.

use super::{
    FileSamples, ImportOptions, names, place_of_key, positions_of, sweep_of, text_of, touchstone,
    typed_frequencies,
};
use crate::acquisition::{DataCube, Sweep};
use crate::error::{Error, Result};
use crate::files::extension;
use num_complex::Complex32;
use serde_json::{Map, json};
use std::path::Path;

/// The samples of one microphone.
#[derive(Debug)]
pub(super) struct Trace {
    /// Hz, where the file has them.
    pub(super) frequencies: Option<Vec<f64>>,
    pub(super) values: Vec<Complex32>,
    /// Whether there are no imaginary parts.
    pub(super) real: bool,
}

/// The samples of one microphone, in a file of its own.
fn read_trace(path: &Path, options: &ImportOptions) -> Result<Trace> {
    let ending = extension(path);
    if let Some(ports) = touchstone::ports(&ending) {
        return touchstone::parse(
            path,
            &text_of(path, options.limit())?,
            ports,
            options.parameter.as_deref(),
        );
    }
    let unit = options.frequency_unit.hertz();
    match ending.as_str() {
        "csv" | "txt" => super::table::parse(path, &text_of(path, options.limit())?, &options.columns, unit),
        _ => {
            let problem =
                "is of an unknown kind; .npy, .npz, .wav, Touchstone (.s1p, .s2p, ...) or .csv was expected";
            Err(Error::input(path.display(), problem))
        }
    }
}

/// What the first of several files says, and the others must repeat.
struct FirstTrace {
    sweep: (Sweep, &'static str),
    frequencies: Option<Vec<f64>>,
    real: bool,
}

/// Files of one position each, in the order of the microphones.
pub(super) fn read_traces(options: &ImportOptions, guesses: &mut Vec<String>) -> Result<FileSamples> {
    let (files, positions) = match &options.samples[..] {
        [pattern] if names::is_pattern(pattern) => names::find(pattern, options, guesses)?,
        files => {
            let positions = positions_of(options, None)?;
            if files.len() != positions.array.len() {
                let problem = format!(
                    "has {} files for {}; give one each, in the order of the microphones, or the pattern of their names",
                    files.len(),
                    positions.described()
                );
                return Err(Error::input(place_of_key("samples"), problem));
            }
            (files.to_vec(), positions)
        }
    };
    let n_mic = files.len();
    let typed = typed_frequencies(options, None)?;
    let mut samples: Vec<Complex32> = Vec::new();
    let mut known: Option<FirstTrace> = None;
    for (mic, path) in files.iter().enumerate() {
        let trace = read_trace(path, options)?;
        let place = path.display().to_string();
        if known.is_none() {
            let sweep = sweep_of(options, typed.clone(), trace.frequencies.clone(), &place)?;
            samples = DataCube::allocate([1, sweep.0.len(), n_mic])?;
            known = Some(FirstTrace { sweep, frequencies: trace.frequencies.clone(), real: trace.real });
        }
        let Some(FirstTrace { sweep, frequencies, real }) = &known else { continue };
        let same = |a: &f64, b: &f64| (a - b).abs() <= 1e-9 * a.abs();
        let alike = match (frequencies, &trace.frequencies) {
            (Some(a), Some(b)) => a.len() == b.len() && a.iter().zip(b).all(|(a, b)| same(a, b)),
            (a, b) => a.is_none() && b.is_none(),
        };
        if !alike || *real != trace.real {
            let problem = format!("has other frequencies or columns than {}", files[0].display());
            return Err(Error::input(place, problem));
        }
        if trace.values.len() != sweep.0.len() {
            let problem =
                format!("has {} samples; {} has {} frequencies", trace.values.len(), sweep.1, sweep.0.len());
            return Err(Error::input(place, problem));
        }
        trace.values.iter().enumerate().for_each(|(f, value)| samples[f * n_mic + mic] = *value);
    }
    let Some(FirstTrace { sweep, real, .. }) = known else {
        return Err(Error::input(place_of_key("samples"), "names no files"));
    };
    let all_touchstone = files.iter().all(|path| touchstone::ports(&extension(path)).is_some());
    let mut facts = Map::new();
    if all_touchstone {
        let default = if extension(&files[0]) == "s1p" { "S11" } else { "S21" };
        if options.parameter.is_none() {
            guesses.push(format!("parameter: {default}"));
        }
        facts.insert("parameter".into(), json!(options.parameter.as_deref().unwrap_or(default)));
    }
    let (place, phase_sign) = (place_of_key("samples"), all_touchstone.then_some(-1));
    Ok(FileSamples { samples, real, sweep, positions, place, phase_sign, facts })
}
