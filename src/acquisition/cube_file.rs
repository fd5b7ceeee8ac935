//! Reading a cube file: everything but the samples when it is opened, the samples in blocks or all at once.

mod sources;
#[cfg(test)]
mod tests;
mod unchecked;

pub use unchecked::UncheckedSamples;

use super::cube::{FORMAT, VERSION, check_all_finite, check_finite};
use super::source::{CubeSource, Visit, visit_samples};
use super::{Calibration, DataCube, Detection, Instrument, InstrumentChanges, MicArray, Sweep};
use crate::error::{Error, Result, gib};
use crate::files::arrays::{ArrayFile, fault, place_of};
use crate::progress::Observer;
use crate::scene::FARTHEST;
use crate::text::{nearest, quoted};
use crate::wave::{DEFAULT_SOUND_SPEED, GeometryKind, Interface, SOUND_SPEEDS, is_sound_speed};
use glam::DVec3;
use num_complex::Complex32;
use serde::Deserialize;
use serde_json::Value;
use std::path::{Path, PathBuf};

/// An open cube file, whose samples are still on the disk.
#[derive(Debug)]
pub struct CubeFile {
    path: PathBuf,
    arrays: ArrayFile,
    instrument: Instrument,
    conjugated: bool,
    provenance: Value,
    changes: Vec<String>,
    /// The samples as a calibration left them, `[n_tx, n_f, n_mic]`, with phase sign +1.
    corrected: Option<Vec<Complex32>>,
    /// Those of several transmissions as they are in the file, once they are read.
    read: Option<Vec<Complex32>>,
}

/// The `meta` array of a file; every key may be missing.
#[derive(Debug, Deserialize)]
#[serde(default)]
struct Meta {
    format: String,
    version: u32,
    sound_speed: f64,
    geometry: String,
    detection: Option<Detection>,
    phase_sign: i32,
    source: Option<[f64; 3]>,
    interface: Option<Interface>,
    provenance: Value,
}

impl Default for Meta {
    fn default() -> Self {
        Self {
            format: FORMAT.to_owned(),
            version: VERSION,
            sound_speed: DEFAULT_SOUND_SPEED,
            geometry: GeometryKind::FixedSource.to_string(),
            detection: None,
            phase_sign: 1,
            source: None,
            interface: None,
            provenance: Value::Null,
        }
    }
}

/// The arrays of a cube file.
const ARRAYS: [&str; 6] = ["samples", "frequencies", "mic_positions", "meta", "sources", "source_positions"];

/// The keys of `meta`.
const META: [&str; 9] = [
    "format",
    "version",
    "sound_speed",
    "geometry",
    "detection",
    "phase_sign",
    "source",
    "interface",
    "provenance",
];

/// A name that no cube file has: it was meant to say something, and would say nothing.
fn unknown_name(what: &str, name: &str, known: &[&str]) -> Error {
    let meant = nearest(name, known).map_or(String::new(), |near| format!("; did you mean `{near}`?"));
    let known = known.join(", ");
    let problem = format!("has the unknown {what} `{}`{meant} (A cube has {known}.)", quoted(name));
    Error::input("cube", problem)
}

impl Meta {
    fn read(text: &str) -> Result<Self> {
        let wrong = |e| Error::input("meta", format!("is not the expected JSON: {e}"));
        let values: serde_json::Map<String, Value> = serde_json::from_str(text).map_err(wrong)?;
        if let Some(unknown) = values.keys().find(|key| !META.contains(&key.as_str())) {
            return Err(unknown_name("key", unknown, &META));
        }
        serde_json::from_value(Value::Object(values)).map_err(wrong)
    }

    /// Checks every value and gives the kind of geometry.
    fn check(&self, place: &str) -> Result<GeometryKind> {
        let refuse = |problem: String| Err(Error::input(place, problem));
        if self.format != FORMAT {
            return refuse(format!("`format` is \"{}\"; {FORMAT:?} was expected", quoted(&self.format)));
        }
        if self.version != VERSION {
            return refuse(format!("`version` is {}; this program reads version {VERSION}", self.version));
        }
        if !is_sound_speed(self.sound_speed) {
            let ([least, most], found) = (SOUND_SPEEDS, self.sound_speed);
            return refuse(format!("`sound_speed` must be from {least} to {most:e} m/s, not {found}"));
        }
        if self.phase_sign.abs() != 1 {
            return refuse(format!("`phase_sign` must be 1 or -1, not {}", self.phase_sign));
        }
        let source = self.source();
        if source.is_nan() || source.abs().max_element() > FARTHEST {
            return refuse(format!("`source` must be three numbers within {FARTHEST:e}, in m, not {source}"));
        }
        self.geometry.parse().map_err(|error: Error| error.at(format!("{place}, `geometry`")))
    }

    fn source(&self) -> DVec3 {
        self.source.map_or(DVec3::ZERO, DVec3::from_array)
    }
}

/// An invalid array of a file.
fn refused<T>(path: &Path, array: &str, problem: impl Into<String>) -> Result<T> {
    Err(fault(path, array, problem))
}

/// The microphones of `mic_positions`, and their shape.
fn microphones(path: &Path, arrays: &mut ArrayFile, limit: u64) -> Result<(MicArray, Vec<usize>)> {
    // A few bytes may declare any number of zeros; they are in memory as numbers and as points.
    let numbers =
        arrays.shape("mic_positions")?.iter().fold(1_u64, |product, n| product.saturating_mul(*n as u64));
    let bytes = numbers.saturating_mul(2 * size_of::<f64>() as u64);
    if bytes > limit {
        let problem = format!(
            "takes {} of memory to read, and {} may be used here (--memory sets another limit)",
            gib(bytes),
            gib(limit)
        );
        return refused(path, "mic_positions", problem);
    }
    let positions = arrays.f64("mic_positions")?;
    let points = positions.data.chunks_exact(3).map(DVec3::from_slice).collect();
    let array = match *positions.shape {
        [n_y, n_x, 3] => MicArray::from_rows([n_y, n_x], points),
        [_, 3] => MicArray::from_positions(points),
        ref shape => {
            let problem = format!("must be [n_y, n_x, 3] or [n_mic, 3], not {shape:?}");
            return refused(path, "mic_positions", problem);
        }
    };
    let axes = positions.shape[..positions.shape.len() - 1].to_vec();
    Ok((array.map_err(|error| error.at(place_of(path, "mic_positions")))?, axes))
}

/// The detection according to `meta` and the samples' type, which must agree.
fn detection_of(path: &Path, said: Option<Detection>, is_complex: bool) -> Result<Detection> {
    let problem = match (said, is_complex) {
        (Some(Detection::Quadrature), false) => {
            "are real, but `meta` says \"quadrature\"; give complex samples or detection \"in-phase\""
        }
        (Some(Detection::InPhase), true) => {
            "are complex, but `meta` says \"in-phase\"; give real samples or detection \"quadrature\""
        }
        (_, true) => return Ok(Detection::Quadrature),
        (_, false) => return Ok(Detection::InPhase),
    };
    refused(path, "samples", problem)
}

/// Changes the sign of the phase.
fn conjugate(samples: &mut [Complex32]) {
    for m in samples {
        *m = m.conj();
    }
}

impl CubeFile {
    /// Opens a cube file, measured or simulated, and reads all but the samples; `limit` bounds the bytes of any one
    /// array in memory.
    ///
    /// # Errors
    /// A missing or malformed file; arrays that are missing, of wrong shape, or inconsistent with each other. The
    /// message names the array.
    pub fn open(path: &Path, limit: u64) -> Result<Self> {
        let mut arrays = ArrayFile::open(path, limit)?;
        let of_voxels = ["samples", "amplitude"].iter().any(|name| arrays.contains(name));
        if !arrays.contains("frequencies") && of_voxels && arrays.contains("z") {
            return Err(Error::input(
                path.display(),
                "is a volume; a data cube was expected (`holosonar depth` reads a volume)",
            ));
        }
        let meta = if arrays.contains("meta") { arrays.text("meta")? } else { "{}".to_owned() };
        let meta = Meta::read(&meta).map_err(|error| error.at(place_of(path, "meta")))?;
        if let Some(unknown) = arrays.names().into_iter().find(|name| !ARRAYS.contains(name)) {
            return Err(unknown_name("array", unknown, &ARRAYS).at(path.display()));
        }
        let kind = meta.check(&place_of(path, "meta"))?;
        let frequencies = arrays.f64("frequencies")?;
        if frequencies.shape.len() != 1 {
            let problem = format!("must have one axis, [n_f], not {:?}", frequencies.shape);
            return refused(path, "frequencies", problem);
        }
        let sweep = Sweep::from_frequencies(frequencies.data)
            .map_err(|error| error.at(place_of(path, "frequencies")))?;
        let (array, axes) = microphones(path, &mut arrays, limit)?;
        let detection = detection_of(path, meta.detection, arrays.dtype_is_complex("samples")?)?;
        let shape = arrays.shape("samples")?;
        let instrument = Instrument::new(sweep, array)
            .with_detection(detection)
            .with_sound_speed(meta.sound_speed)
            .with_interface(meta.interface);
        let instrument = sources::placed(path, &mut arrays, instrument, (kind, meta.source))?;
        let of_sources = arrays.contains("sources").then(|| instrument.transmissions());
        let expected: Vec<usize> =
            of_sources.into_iter().chain([instrument.sweep.len()]).chain(axes).collect();
        if shape != expected {
            let others = if of_sources.is_some() { ", `sources`" } else { "" };
            return Err(Error::input(
                place_of(path, "samples"),
                format!(
                    "have the shape {shape:?}; `frequencies`, `mic_positions`{others} require {expected:?}"
                ),
            ));
        }
        instrument.check().map_err(|error| error.at(place_of(path, "meta")))?;
        Ok(Self {
            path: path.to_owned(),
            arrays,
            instrument,
            conjugated: meta.phase_sign < 0,
            provenance: meta.provenance,
            changes: Vec::new(),
            corrected: None,
            read: None,
        })
    }

    /// The cube of another instrument than its file says.
    ///
    /// # Errors
    /// As [`Instrument::changed`].
    pub fn changed(mut self, changes: &InstrumentChanges) -> Result<Self> {
        let (instrument, words) = self.instrument.changed(changes)?;
        self.instrument = instrument;
        self.changes.extend(words);
        Ok(self)
    }

    /// What is hard to believe of the file, known before its samples are read.
    pub fn questions(&self) -> Vec<String> {
        let unsigned = self.arrays.dtype_is_unsigned("samples").unwrap_or(false);
        let question = || {
            format!(
                "the samples of {} are unsigned integers, which no in-phase data are: echoes have a mean of 0; subtract the \
                 converter's offset",
                self.path.display()
            )
        };
        unsigned.then(question).into_iter().collect()
    }

    /// The samples after these corrections, which are then in memory; no corrections leave the file as it is.
    ///
    /// # Errors
    /// As [`Calibration::apply`].
    pub fn calibrated(mut self, calibration: &Calibration, observer: &dyn Observer) -> Result<Self> {
        if calibration.is_empty() {
            return Ok(self);
        }
        let place = place_of(&self.path, "samples");
        let samples = self.samples()?;
        let mut cube = DataCube { instrument: self.instrument, samples, provenance: self.provenance };
        let words = calibration.apply(&mut cube, observer).map_err(|error| match error.place() {
            Some("samples") => error.at(&place),
            _ => error,
        })?;
        let DataCube { instrument, samples, provenance } = cube;
        self.changes.extend(words);
        Ok(Self { instrument, provenance, corrected: Some(samples), ..self })
    }

    /// The samples after [`CubeFile::calibrated`], `[n_f, n_mic]`, or `[n_tx, n_f, n_mic]` of several loudspeakers.
    pub(crate) fn corrected(&self) -> Option<&[Complex32]> {
        self.corrected.as_deref()
    }

    /// What [`CubeFile::changed`] and [`CubeFile::calibrated`] changed, in words.
    pub fn changes(&self) -> &[String] {
        &self.changes
    }

    /// Reads the samples into a cube.
    ///
    /// # Errors
    /// Samples that are damaged, not finite, or larger than the limit.
    pub fn load(self) -> Result<DataCube> {
        if let Some(samples) = self.corrected {
            return Ok(DataCube { instrument: self.instrument, samples, provenance: self.provenance });
        }
        let place = place_of(&self.path, "samples");
        let cube = self.load_unchecked()?;
        check_all_finite(&place, &cube.instrument, &cube.samples)?;
        Ok(cube)
    }

    /// Reads the samples into a cube, also those that are not finite.
    ///
    /// # Errors
    /// Samples that are damaged, or larger than the limit.
    pub(super) fn load_unchecked(mut self) -> Result<DataCube> {
        let samples = self.samples()?;
        Ok(DataCube { instrument: self.instrument, samples, provenance: self.provenance })
    }

    /// All samples, with phase sign +1.
    fn samples(&mut self) -> Result<Vec<Complex32>> {
        let mut samples = self.arrays.complex("samples")?.data;
        if self.conjugated {
            conjugate(&mut samples);
        }
        Ok(samples)
    }

    /// The file's arrays by name, size and checksum; reading them verifies the checksums.
    ///
    /// # Errors
    /// A damaged file.
    pub(crate) fn fingerprint(&mut self) -> Result<String> {
        self.arrays.fingerprint()
    }

    /// The samples as they are, to find those that are not finite, at which any other visit stops.
    pub fn unchecked(&mut self) -> UncheckedSamples<'_> {
        UncheckedSamples::new(self)
    }

    /// The origin of the cube; null for a measurement.
    pub fn provenance(&self) -> &Value {
        &self.provenance
    }
}

impl CubeSource for CubeFile {
    fn instrument(&self) -> &Instrument {
        &self.instrument
    }

    fn held_bytes(&self) -> u64 {
        if self.corrected.is_some() {
            return self.instrument.cube_bytes();
        }
        // Every transmission is visited again for each slab of depths, so that several are read once.
        if self.instrument.transmissions() > 1 {
            return self.instrument.cube_bytes().saturating_mul(2);
        }
        self.arrays.bytes_beside_block("samples")
    }

    fn visit_transmission(&mut self, transmission: usize, block: usize, visit: &mut Visit) -> Result<()> {
        let (n_mic, place) = (self.instrument.array.len(), place_of(&self.path, "samples"));
        if self.instrument.transmissions() > 1 && self.corrected.is_none() && self.read.is_none() {
            let samples = self.samples()?;
            check_all_finite(&place, &self.instrument, &samples)?;
            self.read = Some(samples);
        }
        if let Some(samples) = self.corrected.as_ref().or(self.read.as_ref()) {
            return visit_samples(&self.instrument, (transmission, samples), block, visit);
        }
        self.unchecked().visit(block, &mut |range, samples| {
            check_finite(&place, range.start, n_mic, samples)?;
            visit(range, samples)
        })
    }
}
