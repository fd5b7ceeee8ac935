//! The data cube `m(f, r)` and its file, `.npz` (DESIGN section 3).

use super::{CubeFile, Detection, MicArray, Setup, Sweep};
use crate::alloc::try_zeroed;
use crate::error::{Error, Result};
use crate::files::npz::write_npz;
use crate::wave::{DEFAULT_SOUND_SPEED, Geometry};
use glam::DVec3;
use num_complex::Complex32;
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

pub(super) const FORMAT: &str = "holosonar-cube";
pub(super) const VERSION: u32 = 1;

impl DataCube {
    /// A cube of given samples, `[n_f, n_mic]`; quadrature, speaker at the origin, c = 343 m/s.
    ///
    /// # Errors
    /// As many samples as frequencies × microphones were expected, all finite.
    pub fn new(sweep: Sweep, array: MicArray, samples: Vec<Complex32>) -> Result<Self> {
        let expected = sweep.len() as u64 * array.len() as u64;
        if samples.len() as u64 != expected {
            return Err(Error::input(
                "samples",
                format!(
                    "hold {} values; {} frequencies x {} microphones need {expected}",
                    samples.len(),
                    sweep.len(),
                    array.len()
                ),
            ));
        }
        check_finite("samples", 0, array.len(), &samples)?;
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

    /// The measurement without its samples.
    pub fn setup(&self) -> Setup<'_> {
        Setup {
            sweep: &self.sweep,
            array: &self.array,
            geometry: self.geometry,
            detection: self.detection,
            sound_speed: self.sound_speed,
        }
    }

    /// Range resolution c/2B, m (Eq. 10); `None` for a single tone.
    pub fn range_resolution(&self) -> Option<f64> {
        self.sweep.range_resolution(self.sound_speed)
    }

    /// Room for a cube, filled with zeros.
    pub(super) fn allocate(n_f: usize, n_mic: usize) -> Result<Vec<Complex32>> {
        (n_f as u64).checked_mul(n_mic as u64).and_then(try_zeroed).ok_or_else(|| {
            Error::out_of_memory(format!(
                "a cube of {n_f} frequencies x {n_mic} microphones does not fit; use fewer of either"
            ))
        })
    }

    /// Writes the cube: `samples`, `frequencies`, `mic_positions`, `meta`. Same cube, same bytes.
    ///
    /// # Errors
    /// [`Error::Io`] when the file cannot be written; an old file is then left as it was.
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
            "geometry": self.geometry.kind(),
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
    /// As [`CubeFile::open`] and [`CubeFile::load`].
    pub fn read(path: &Path, limit: u64) -> Result<Self> {
        CubeFile::open(path, limit)?.load()
    }
}

/// The finiteness of samples from frequency `first` on, `[f, n_mic]`.
pub(super) fn check_finite(place: &str, first: usize, n_mic: usize, samples: &[Complex32]) -> Result<()> {
    if let Some(bad) = samples.iter().position(|m| !m.is_finite()) {
        return Err(Error::input(
            place,
            format!(
                "are not finite at frequency {} (counted from 0), microphone {}; mend or drop it",
                first + bad / n_mic,
                bad % n_mic
            ),
        ));
    }
    Ok(())
}
