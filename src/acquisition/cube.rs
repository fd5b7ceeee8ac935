//! The data cube `m(f, r)` and its file, `.npz` (DESIGN section 3).

use super::{Detection, MicArray, Sweep};
use crate::error::{Error, Result};
use crate::files::npz::{NpzReader, write_npz};
use crate::grid::zeros;
use crate::wave::{DEFAULT_SOUND_SPEED, Geometry};
use glam::DVec3;
use num_complex::Complex32;
use serde::Deserialize;
use serde_json::{Value, json};
use std::path::Path;

/// A measured or simulated cube, with all that is needed to image it.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct DataCube {
    /// The tones.
    pub sweep: Sweep,
    /// The microphones.
    pub array: MicArray,
    /// Fixed speaker or monostatic scan.
    pub geometry: Geometry,
    /// Quadrature or in-phase.
    pub detection: Detection,
    /// c, m/s.
    pub sound_speed: f64,
    /// `[n_f, n_mic]`, the phase sign already +1; in-phase samples are real.
    pub samples: Vec<Complex32>,
    /// What made the cube (`run`, `seed` of a simulation); null for a measurement.
    pub provenance: Value,
}

/// The `meta` array as files hold it; every key may be missing.
#[derive(Debug, Deserialize)]
#[serde(default)]
struct Meta {
    format: String,
    version: u32,
    sound_speed: f64,
    geometry: String,
    detection: Option<Detection>,
    phase_sign: i32,
    source: [f64; 3],
    provenance: Value,
}

impl Default for Meta {
    fn default() -> Self {
        Self {
            format: FORMAT.to_owned(),
            version: VERSION,
            sound_speed: DEFAULT_SOUND_SPEED,
            geometry: "fixed-source".to_owned(),
            detection: None,
            phase_sign: 1,
            source: [0.0; 3],
            provenance: Value::Null,
        }
    }
}

const FORMAT: &str = "holosonar-cube";
const VERSION: u32 = 1;

impl DataCube {
    /// A cube of given samples, `[n_f, n_mic]`; quadrature, speaker at the origin, c = 343 m/s.
    ///
    /// # Errors
    /// As many samples as frequencies × microphones were expected, all finite.
    pub fn new(sweep: Sweep, array: MicArray, samples: Vec<Complex32>) -> Result<Self> {
        check_samples("samples", &sweep, &array, &samples)?;
        Ok(Self {
            sweep,
            array,
            geometry: Geometry::ORIGIN,
            detection: Detection::Quadrature,
            sound_speed: DEFAULT_SOUND_SPEED,
            samples,
            provenance: Value::Null,
        })
    }

    /// The samples of frequency `f`, `[n_mic]`.
    pub fn frequency(&self, f: usize) -> &[Complex32] {
        let n = self.array.len();
        &self.samples[f * n..(f + 1) * n]
    }

    /// Range resolution c/2B, m (Eq. 10); `None` for a single tone.
    pub fn range_resolution(&self) -> Option<f64> {
        self.sweep.range_resolution(self.sound_speed)
    }

    /// Room for a cube, filled with zeros.
    pub(super) fn allocate(n_f: usize, n_mic: usize) -> Result<Vec<Complex32>> {
        (n_f as u64).checked_mul(n_mic as u64).and_then(zeros).ok_or_else(|| {
            Error::environment(
                "memory",
                format!(
                    "a cube of {n_f} frequencies x {n_mic} microphones does not fit; use fewer of either"
                ),
            )
        })
    }

    /// Writes the cube: `samples`, `frequencies`, `mic_positions`, `meta`. Same cube, same bytes.
    ///
    /// # Errors
    /// [`Error::Environment`] when the file cannot be written; an old file is then left as it was.
    pub fn write(&self, path: &Path) -> Result<()> {
        let mut shape = vec![self.sweep.len()];
        shape.extend(self.array.shape());
        let mut places = self.array.shape();
        places.push(3);
        let positions: Vec<f64> = self.array.positions().iter().flat_map(DVec3::to_array).collect();
        let source = match self.geometry {
            Geometry::FixedSource { source } => source,
            Geometry::Monostatic => DVec3::ZERO,
        };
        let mut meta = json!({
            "format": FORMAT,
            "version": VERSION,
            "sound_speed": self.sound_speed,
            "geometry": self.geometry.name(),
            "detection": self.detection,
            "phase_sign": 1,
            "source": source.to_array(),
        });
        if !self.provenance.is_null() {
            meta["provenance"] = self.provenance.clone();
        }
        write_npz(path, |npz| {
            match self.detection {
                Detection::Quadrature => npz.complex("samples", &shape, &self.samples)?,
                Detection::InPhase => {
                    let real: Vec<f32> = self.samples.iter().map(|m| m.re).collect();
                    npz.f32("samples", &shape, &real)?;
                }
            }
            npz.f64("frequencies", &[self.sweep.len()], self.sweep.frequencies())?;
            npz.f64("mic_positions", &places, &positions)?;
            npz.text("meta", &meta.to_string())
        })
    }

    /// Reads a cube file, measured or simulated; `limit` bounds the bytes of any one array.
    ///
    /// # Errors
    /// A missing or malformed file; arrays that are missing, of wrong shape, not finite, or inconsistent with each
    /// other. The message names the array.
    pub fn read(path: &Path, limit: u64) -> Result<Self> {
        let mut npz = NpzReader::open(path, limit)?;
        let place = |array: &str| format!("{}, array `{array}`", path.display());
        if !npz.contains("frequencies") && npz.contains("samples") && npz.contains("z") {
            return Err(Error::input(
                path.display(),
                "is a volume; a data cube was expected (`holosonar depth` takes a volume)",
            ));
        }
        let meta = if npz.contains("meta") { npz.text("meta")? } else { "{}".to_owned() };
        let meta: Meta = serde_json::from_str(&meta)
            .map_err(|e| Error::input(place("meta"), format!("is not the JSON that was expected: {e}")))?;
        let geometry = meta.check(&place("meta"))?;

        let frequencies = npz.f64("frequencies")?;
        if frequencies.shape.len() != 1 {
            return Err(Error::input(
                place("frequencies"),
                format!("must have one axis, [n_f], not {:?}", frequencies.shape),
            ));
        }
        let sweep = Sweep::from_frequencies(&place("frequencies"), frequencies.data)?;

        let positions = npz.f64("mic_positions")?;
        let (axes, [3]) = positions.shape.split_at(positions.shape.len().saturating_sub(1)) else {
            return Err(Error::input(
                place("mic_positions"),
                format!("must be [n_y, n_x, 3] or [n_mic, 3], not {:?}", positions.shape),
            ));
        };
        if !matches!(axes.len(), 1 | 2) {
            return Err(Error::input(
                place("mic_positions"),
                format!("must be [n_y, n_x, 3] or [n_mic, 3], not {:?}", positions.shape),
            ));
        }
        let points = positions.data.chunks_exact(3).map(DVec3::from_slice).collect();
        let array = MicArray::from_positions(&place("mic_positions"), axes, points)?;

        let is_complex = npz.dtype_is_complex("samples")?;
        let detection = match (meta.detection, is_complex) {
            (Some(Detection::Quadrature), false) => {
                return Err(Error::input(
                    place("samples"),
                    "are real, but `meta` says \"quadrature\"; give complex samples or detection \"in-phase\"",
                ));
            }
            (Some(Detection::InPhase), true) => {
                return Err(Error::input(
                    place("samples"),
                    "are complex, but `meta` says \"in-phase\"; give real samples or detection \"quadrature\"",
                ));
            }
            (_, true) => Detection::Quadrature,
            (_, false) => Detection::InPhase,
        };
        let mut samples = npz.complex("samples")?;
        let mut expected = vec![sweep.len()];
        expected.extend(axes);
        if samples.shape != expected {
            return Err(Error::input(
                place("samples"),
                format!(
                    "have shape {:?}, but `frequencies` and `mic_positions` make it {expected:?}",
                    samples.shape
                ),
            ));
        }
        check_samples(&place("samples"), &sweep, &array, &samples.data)?;
        if meta.phase_sign < 0 {
            for m in &mut samples.data {
                *m = m.conj();
            }
        }
        Ok(Self {
            sweep,
            array,
            geometry,
            detection,
            sound_speed: meta.sound_speed,
            samples: samples.data,
            provenance: meta.provenance,
        })
    }
}

impl Meta {
    /// Checks every value and gives the geometry.
    fn check(&self, place: &str) -> Result<Geometry> {
        let refuse = |problem: String| Err(Error::input(place, problem));
        if self.format != FORMAT {
            return refuse(format!("`format` is {:?}; a cube says {FORMAT:?}", self.format));
        }
        if self.version != VERSION {
            return refuse(format!("`version` is {}; this program reads version {VERSION}", self.version));
        }
        if !(self.sound_speed.is_finite() && self.sound_speed > 0.0) {
            return refuse(format!("`sound_speed` must be positive, in m/s, not {}", self.sound_speed));
        }
        if self.phase_sign.abs() != 1 {
            return refuse(format!("`phase_sign` must be 1 or -1, not {}", self.phase_sign));
        }
        let source = DVec3::from_array(self.source);
        if !source.is_finite() {
            return refuse("`source` must be three finite numbers, in m".to_owned());
        }
        match self.geometry.as_str() {
            "fixed-source" => Ok(Geometry::FixedSource { source }),
            "monostatic" => Ok(Geometry::Monostatic),
            other => {
                refuse(format!("`geometry` is {other:?}; \"fixed-source\" or \"monostatic\" was expected"))
            }
        }
    }
}

/// The number and finiteness of the samples.
fn check_samples(place: &str, sweep: &Sweep, array: &MicArray, samples: &[Complex32]) -> Result<()> {
    let expected = sweep.len() as u64 * array.len() as u64;
    if samples.len() as u64 != expected {
        return Err(Error::input(
            place,
            format!(
                "hold {} values; {} frequencies x {} microphones need {expected}",
                samples.len(),
                sweep.len(),
                array.len()
            ),
        ));
    }
    if let Some(bad) = samples.iter().position(|m| !m.is_finite()) {
        return Err(Error::input(
            place,
            format!(
                "are not finite at frequency {} (counted from 0), microphone {}; mend or drop it",
                bad / array.len(),
                bad % array.len()
            ),
        ));
    }
    Ok(())
}
