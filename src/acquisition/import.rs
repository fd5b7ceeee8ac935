//! From a laboratory's files to a data cube: NumPy arrays, Touchstone, CSV and WAV files, one for all positions or one each.
//!
//! [`import`] reads; what files do not say (frequencies, positions, axes, the sign of the phase) comes from
//! [`ImportOptions`] or is refused, and what is guessed is in [`Imported::guesses`].

mod array;
mod axes;
mod names;
mod options;
mod recordings;
mod sources;
mod table;
#[cfg(test)]
mod tests;
mod touchstone;
mod traces;

pub use array::{ArrayName, MeanWord, RawOffset};
pub use axes::ImportAxis;
pub use options::{FrequencyUnit, ImportOptions, Imported};
pub use table::TraceColumn;
pub(crate) use table::check_columns;
pub(super) use table::frequency_response;

use super::{DataCube, Detection, Instrument, MicArray, Sweep};
use crate::error::{Error, Result, gib};
use crate::files::npz::Array;
use crate::files::{extension, open_input};
use crate::wave::{DEFAULT_SOUND_SPEED, Geometry};
use array::NumpyFiles;
use axes::{SampleOrder, words};
use glam::DVec3;
use num_complex::Complex32;
use recordings::read_recordings;
use serde_json::{Map, Value, json};
use sources::{loudspeakers, read_each};
use std::io::Read;
use std::path::Path;
use traces::read_traces;

/// The microphones of an import.
#[derive(Debug)]
struct Positions {
    array: MicArray,
    /// Rows and columns, where they are known.
    rows: Option<[usize; 2]>,
    from: &'static str,
}

/// Samples, and what the files said about them.
struct FileSamples {
    samples: Vec<Complex32>,
    real: bool,
    sweep: (Sweep, &'static str),
    positions: Positions,
    place: String,
    /// The sign of the phase that the format defines: -1 is that of exp(+jωt), in which a path delays.
    phase_sign: Option<i32>,
    facts: Map<String, Value>,
}

/// The place of an error in a key of `[import]`.
fn place_of_key(key: &str) -> String {
    format!("[import] {key}")
}

/// A finite number as laboratory programs write it, also with Fortran's exponent.
fn parse_number(word: &str) -> Option<f64> {
    let number = word.parse().or_else(|_| word.replace(['d', 'D'], "e").parse());
    number.ok().filter(|number: &f64| number.is_finite())
}

/// The text of a file; bytes that are not UTF-8, as in the comments of older instruments, are replaced.
fn text_of(path: &Path, limit: u64) -> Result<String> {
    let reading = |error| Error::reading(path, error);
    let file = open_input(path)?;
    let length = file.metadata().map_err(reading)?.len();
    // The text, and the numbers in it.
    if length.saturating_mul(4) > limit {
        let problem =
            format!("takes {} of memory to read, and {} may be used here", gib(4 * length), gib(limit));
        return Err(Error::input(path.display(), problem + " (--memory sets another limit)"));
    }
    let mut bytes = Vec::new();
    file.take(length).read_to_end(&mut bytes).map_err(reading)?;
    Ok(String::from_utf8(bytes)
        .unwrap_or_else(|error| String::from_utf8_lossy(error.as_bytes()).into_owned()))
}

impl Positions {
    /// Those of formulas or of `[array]`.
    fn typed(options: &ImportOptions) -> Result<Self> {
        if let Some(formulas) = &options.formulas {
            let array = formulas.microphones(&place_of_key("positions"), options.limit())?;
            let [n_x, n_y] = formulas.count;
            return Ok(Self { array, rows: Some([n_y, n_x]), from: "formulas" });
        }
        let array = options.array.clone().ok_or_else(|| {
            let problem = "is missing: nothing says where the microphones were; give its count and its pitch or extent, a \
                           file of positions (layout = \"file\"), or `positions` in [import]";
            Error::input("[array]", problem)
        })?;
        let rows = array.lattice().map(|lattice| [lattice.y.count, lattice.x.count]);
        Ok(Self { array, rows, from: "[array]" })
    }

    /// Those of an array of numbers, `[n, 3]`, `[n_y, n_x, 3]`, or with two numbers each.
    fn of(place: &str, shape: &[usize], numbers: &[f64]) -> Result<Self> {
        let (Some(each @ (2 | 3)), true) = (shape.last().copied(), (2..=3).contains(&shape.len())) else {
            let problem =
                format!("has the shape {shape:?}; [n, 3], [n_y, n_x, 3] or the same with 2 was expected");
            return Err(Error::input(place, problem));
        };
        let points =
            numbers.chunks_exact(each).map(|p| DVec3::new(p[0], p[1], p.get(2).copied().unwrap_or(0.0)));
        let points: Vec<DVec3> = points.collect();
        let (array, rows) = match *shape {
            [n_y, n_x, _] => (MicArray::from_rows([n_y, n_x], points), Some([n_y, n_x])),
            _ => (MicArray::from_positions(points), None),
        };
        Ok(Self { array: array.map_err(|error| error.at(place))?, rows, from: "`positions`" })
    }

    fn described(&self) -> String {
        match self.rows {
            Some([n_y, n_x]) => format!("{n_x} x {n_y} microphones"),
            None => format!("{} microphones", self.array.len()),
        }
    }
}

/// The frequencies of the key `frequencies`, Hz: of an array in the samples' own npz, or of another file.
fn typed_frequencies(options: &ImportOptions, numpy: Option<&mut NumpyFiles>) -> Result<Option<Vec<f64>>> {
    let Some(typed) = &options.frequencies else { return Ok(None) };
    let unit = options.frequency_unit.hertz();
    let array = match extension(typed).as_str() {
        "npy" => NumpyFiles::open(std::slice::from_ref(typed), options.limit()).and_then(|mut f| f.only())?,
        "csv" | "txt" => {
            return table::first_column(typed, &text_of(typed, options.limit())?, unit).map(Some);
        }
        _ => named(typed, "frequencies", numpy)?,
    };
    if array.shape.iter().filter(|n| **n != 1).count() > 1 {
        let problem = format!("has the shape {:?}; one axis was expected", array.shape);
        return Err(Error::input(place_of_key("frequencies"), problem));
    }
    Ok(Some(array.data.into_iter().map(|f| f * unit).collect()))
}

/// An array of the samples' own npz.
fn named(name: &Path, key: &str, numpy: Option<&mut NumpyFiles>) -> Result<Array<f64>> {
    let text = name.to_string_lossy();
    numpy.and_then(|numpy| numpy.named(&text)).unwrap_or_else(|| {
        let problem = "names an array, and the samples are in no .npz; give a file, .npy or .csv";
        Err(Error::input(place_of_key(key), problem))
    })
}

/// The sweep: `frequencies`, or those of the files, or `[sweep]`.
fn sweep_of(
    options: &ImportOptions,
    typed: Option<Vec<f64>>,
    found: Option<Vec<f64>>,
    place: &str,
) -> Result<(Sweep, &'static str)> {
    let (list, from, place) = match (typed, found) {
        (Some(list), _) => (list, "`frequencies`", place_of_key("frequencies")),
        (None, Some(list)) => (list, "the files", place.to_owned()),
        (None, None) => {
            let problem = "is missing: nothing says what the frequencies were; give its start, stop and step, or \
                           `frequencies` in [import]";
            let sweep = options.sweep.clone().ok_or_else(|| Error::input("[sweep]", problem))?;
            return Ok((sweep, "[sweep]"));
        }
    };
    Ok((Sweep::from_frequencies(list).map_err(|error| error.at(place))?, from))
}

/// The positions of the key `positions`, or of `[array]`.
fn positions_of(options: &ImportOptions, numpy: Option<&mut NumpyFiles>) -> Result<Positions> {
    let Some(typed) = &options.positions else { return Positions::typed(options) };
    let array = match extension(typed).as_str() {
        "npy" => NumpyFiles::open(std::slice::from_ref(typed), options.limit()).and_then(|mut f| f.only())?,
        "csv" | "xml" => {
            let problem = "is a list of positions; give it as `file` in [array], with layout = \"file\"";
            return Err(Error::input(place_of_key("positions"), problem));
        }
        _ => named(typed, "positions", numpy)?,
    };
    Positions::of(&place_of_key("positions"), &array.shape, &array.data)
}

/// NumPy files that hold all positions, and all of so many transmissions.
fn read_arrays(options: &ImportOptions, n_tx: usize, guesses: &mut Vec<String>) -> Result<FileSamples> {
    let mut files = NumpyFiles::open(&options.samples, options.limit())?;
    let sweep = typed_frequencies(options, Some(&mut files))?;
    let sweep = sweep_of(options, sweep, None, "")?;
    let positions = positions_of(options, Some(&mut files))?;
    let raw = files.samples(options, guesses)?;
    let counts = [n_tx, sweep.0.len()];
    let layout = SampleOrder::new(&options.axes, &raw.shape, counts, &positions, raw.may_have_planes());
    let layout = layout.map_err(|problem| Error::input(&raw.place, problem))?;
    if options.axes.is_empty() && raw.shape.len() > 1 {
        guesses.push(format!("axes = {}: the only ones of these lengths", words(&layout.axes)));
    }
    let (samples, offset) = raw.samples(&layout, options.offset)?;
    let mut facts = Map::new();
    facts.insert("arrays".into(), json!(raw.names));
    facts.insert("shape".into(), json!(raw.shape));
    facts.insert("axes".into(), json!(layout.axes));
    let real = raw.is_real(&layout);
    if let Some(offset) = offset {
        let both = json!(offset);
        facts.insert("offset".into(), if real { both[0].clone() } else { both });
    }
    Ok(FileSamples { samples, real, sweep, positions, place: raw.place, phase_sign: None, facts })
}

/// The samples of one loudspeaker, or of `n_tx` in an array of theirs.
fn read(
    options: &ImportOptions,
    n_tx: usize,
    guesses: &mut Vec<String>,
    warnings: &mut Vec<String>,
) -> Result<FileSamples> {
    let all_are =
        |endings: &[&str]| options.samples.iter().all(|path| endings.contains(&extension(path).as_str()));
    let is_pattern = options.samples.first().is_some_and(|first| names::is_pattern(first));
    if all_are(&["npy", "npz"]) && !is_pattern {
        read_arrays(options, n_tx, guesses)
    } else if all_are(&["wav"]) {
        read_recordings(options, guesses, warnings)
    } else {
        read_traces(options, guesses)
    }
}

/// Reads a measurement from a laboratory's files.
///
/// Takes the memory of the samples in double precision and of the cube.
///
/// # Errors
/// Missing, malformed or contradicting files; what nobody said and no file tells: frequencies, positions, an order of axes
/// that is not the only one, the zero of unsigned numbers, the places of loudspeakers; as many files as loudspeakers do
/// not have.
pub fn import(options: &ImportOptions) -> Result<Imported> {
    let (mut guesses, mut warnings) = (Vec::new(), Vec::new());
    let Some(first) = options.samples.first() else {
        let problem = "is missing: name the files, or the pattern of their names";
        return Err(Error::input(place_of_key("samples"), problem));
    };
    if first.is_dir() {
        return Err(names::refuse_folder(first));
    }
    let sources = loudspeakers(options)?;
    let of_pairs = sources::are_of_pairs(options);
    let mut found = if of_pairs {
        read(options, 1, &mut guesses, &mut warnings)?
    } else if sources::are_in_files(options, sources.len()) {
        read_each(options, &sources, &mut guesses, &mut warnings)?
    } else {
        read(options, sources.len().max(1), &mut guesses, &mut warnings)?
    };
    let detection = match (options.detection, found.real) {
        (Some(Detection::Quadrature), true) => {
            let problem =
                "is \"quadrature\", and the samples are real; name both I and Q in `arrays` or `axes`";
            return Err(Error::input("[detection] kind", problem));
        }
        (Some(Detection::InPhase), false) => {
            let problem = "is \"in-phase\", and the samples are complex; leave it out";
            return Err(Error::input("[detection] kind", problem));
        }
        (_, true) => Detection::InPhase,
        (_, false) => Detection::Quadrature,
    };
    let phase_sign = options.phase_sign.or(found.phase_sign).unwrap_or(1);
    if detection == Detection::Quadrature {
        match (options.phase_sign, found.phase_sign) {
            (Some(_), _) | (None, Some(1)) => {}
            (None, Some(_)) => guesses.push("phase_sign = -1: that of S-parameters, exp(+jωt)".to_owned()),
            (None, None) => guesses.push(
                "phase_sign = 1: phases grow with the path; -1 if they fall, as those of an FFT and of network analysers"
                    .to_owned(),
            ),
        }
        if phase_sign < 0 {
            found.samples.iter_mut().for_each(|m| *m = m.conj());
        }
    }
    let sound_speed = options.sound_speed.unwrap_or_else(|| {
        guesses.push(format!("sound_speed = {DEFAULT_SOUND_SPEED}: air at 20 °C; radar has 299792458 m/s"));
        DEFAULT_SOUND_SPEED
    });
    if options.geometry.is_none() && sources.is_empty() {
        guesses.push("geometry: one speaker at the origin".to_owned());
    }
    let (sweep, frequencies_from) = found.sweep;
    let mut instrument = Instrument::new(sweep, found.positions.array)
        .with_geometry(options.geometry.unwrap_or(Geometry::ORIGIN))
        .with_detection(detection)
        .with_sound_speed(sound_speed)
        .with_interface(options.interface);
    if of_pairs && !sources.is_empty() {
        instrument = instrument.with_pairs(&sources).map_err(|error| error.at(place_of_key("sources")))?;
    } else if !sources.is_empty() {
        instrument = instrument.with_sources(&sources)?;
    }
    instrument.check()?;
    let mut facts = Map::new();
    facts.insert(
        "files".into(),
        json!(options.samples.iter().map(|path| path.display().to_string()).collect::<Vec<_>>()),
    );
    facts.append(&mut found.facts);
    facts.insert("frequencies_from".into(), json!(frequencies_from));
    facts.insert("positions_from".into(), json!(found.positions.from));
    facts.insert("phase_sign".into(), json!(phase_sign));
    facts.insert("guesses".into(), json!(guesses));
    let mut cube = DataCube::new(instrument, found.samples).map_err(|error| error.at(&found.place))?;
    cube.provenance = json!({ "import": facts });
    Ok(Imported { cube, guesses, warnings })
}
