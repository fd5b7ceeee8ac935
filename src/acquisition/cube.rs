//! The data cube `m(f, r)` and its file, `.npz`, which the chapter `files` of the guide describes.

use super::source::{CubeSource, Visit, visit_samples};
use super::{CubeFile, Detection, Instrument};
use crate::alloc::try_zeroed;
use crate::error::{Error, Result};
use crate::files::npz::write_npz;
use crate::wave::Geometry;
use glam::DVec3;
use num_complex::Complex32;
use serde_json::{Value, json};
use std::path::Path;

/// A measured or simulated cube, with everything that imaging needs.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct DataCube {
    /// The instrument that measured it.
    pub instrument: Instrument,
    /// `[n_f, n_mic]`, with phase sign +1; in-phase samples are real.
    pub samples: Vec<Complex32>,
    /// The origin of the cube (`run`, `seed` of a simulation); null for a measurement.
    pub provenance: Value,
}

pub(super) const FORMAT: &str = "holosonar-cube";
pub(super) const VERSION: u32 = 1;

impl DataCube {
    /// A cube of the given samples, `[n_f, n_mic]`, measured with `instrument`; in-phase samples have no imaginary parts.
    ///
    /// # Errors
    /// A number of samples other than frequencies × microphones; samples that are not finite.
    ///
    /// ```
    /// use holosonar::glam::DVec3;
    /// use holosonar::acquisition::{DataCube, Instrument, MicArray, Sweep};
    /// use holosonar::num_complex::Complex32;
    ///
    /// let sweep = Sweep::stepped(10e3, 12e3, 500.0)?;
    /// let array = MicArray::rectangular([4, 3], [0.05, 0.05], DVec3::ZERO)?;
    /// let cube = DataCube::new(Instrument::new(sweep, array), vec![Complex32::ONE; 5 * 12])?;
    /// assert_eq!(cube.frequency(2).len(), 12);
    /// # Ok::<(), holosonar::error::Error>(())
    /// ```
    pub fn new(instrument: Instrument, samples: Vec<Complex32>) -> Result<Self> {
        check_count(&instrument, &samples)?;
        check_finite("samples", 0, instrument.array.len(), &samples)?;
        Ok(Self { instrument, samples, provenance: Value::Null })
    }

    /// The samples of frequency `f`, `[n_mic]`.
    pub fn frequency(&self, f: usize) -> &[Complex32] {
        let n = self.instrument.array.len();
        &self.samples[f * n..(f + 1) * n]
    }

    /// The samples of a cube, all zero.
    pub(super) fn allocate(n_f: usize, n_mic: usize) -> Result<Vec<Complex32>> {
        (n_f as u64).checked_mul(n_mic as u64).and_then(try_zeroed).ok_or_else(|| {
            Error::out_of_memory(format!(
                "a cube of {n_f} frequencies x {n_mic} microphones does not fit in memory; use fewer of either"
            ))
        })
    }

    /// Writes the cube: `samples`, `frequencies`, `mic_positions`, `meta`. The same cube gives the same bytes.
    ///
    /// # Errors
    /// [`Error::Io`] if the file cannot be written; an existing file is then unchanged.
    pub fn write(&self, path: &Path) -> Result<()> {
        CubeView { instrument: &self.instrument, samples: &self.samples }.write(path, &self.provenance)
    }

    /// Reads a cube file, measured or simulated; `limit` bounds the bytes of any one array.
    ///
    /// # Errors
    /// As [`CubeFile::open`] and [`CubeFile::load`].
    pub fn read(path: &Path, limit: u64) -> Result<Self> {
        CubeFile::open(path, limit)?.load()
    }
}

/// A cube whose samples someone else owns, such as a NumPy array: it is imaged and written without a copy of them.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CubeView<'a> {
    instrument: &'a Instrument,
    samples: &'a [Complex32],
}

impl<'a> CubeView<'a> {
    /// A view of samples, `[n_f, n_mic]`, with phase sign +1; in-phase samples have no imaginary parts. Those that are not finite
    /// are refused when they are visited, unless a calibration masks them before.
    ///
    /// # Errors
    /// A number of samples other than frequencies × microphones.
    pub fn new(instrument: &'a Instrument, samples: &'a [Complex32]) -> Result<Self> {
        check_count(instrument, samples)?;
        Ok(Self { instrument, samples })
    }

    /// The samples, `[n_f, n_mic]`.
    pub fn samples(&self) -> &'a [Complex32] {
        self.samples
    }

    /// Writes the cube with its origin, as [`DataCube::write`].
    ///
    /// # Errors
    /// As [`DataCube::write`].
    pub fn write(&self, path: &Path, provenance: &Value) -> Result<()> {
        let Instrument { sweep, array, geometry, detection, sound_speed } = self.instrument;
        let shape = [vec![sweep.len()], array.shape()].concat();
        let positions_shape = [array.shape(), vec![3]].concat();
        let positions: Vec<f64> = array.positions().iter().flat_map(DVec3::to_array).collect();
        let source = match *geometry {
            Geometry::FixedSource { source } => source,
            Geometry::Monostatic => DVec3::ZERO,
        };
        let mut meta = json!({
            "format": FORMAT,
            "version": VERSION,
            "sound_speed": sound_speed,
            "geometry": geometry.kind(),
            "detection": detection,
            "phase_sign": 1,
            "source": source.to_array(),
        });
        if !provenance.is_null() {
            meta["provenance"] = provenance.clone();
        }
        write_npz(path, |npz| {
            match detection {
                Detection::Quadrature => npz.complex("samples", &shape, self.samples)?,
                Detection::InPhase => {
                    let real: Vec<f32> = self.samples.iter().map(|m| m.re).collect();
                    npz.f32("samples", &shape, &real)?;
                }
            }
            npz.f64("frequencies", &[sweep.len()], sweep.frequencies())?;
            npz.f64("mic_positions", &positions_shape, &positions)?;
            npz.text("meta", &meta.to_string())
        })
    }
}

impl CubeSource for CubeView<'_> {
    fn instrument(&self) -> &Instrument {
        self.instrument
    }

    fn held_bytes(&self) -> u64 {
        0 // besides those that the caller has
    }

    fn visit(&mut self, block: usize, visit: &mut Visit) -> Result<()> {
        let n_mic = self.instrument.array.len();
        visit_samples(self.instrument, self.samples, block, &mut |range, samples| {
            check_finite("samples", range.start, n_mic, samples)?;
            visit(range, samples)
        })
    }
}

/// Rejects samples that are not as many as the instrument has.
fn check_count(instrument: &Instrument, samples: &[Complex32]) -> Result<()> {
    let Instrument { sweep, array, .. } = instrument;
    let expected = sweep.len() as u64 * array.len() as u64;
    if samples.len() as u64 == expected {
        return Ok(());
    }
    Err(Error::input(
        "samples",
        format!(
            "there are {} values; {} frequencies x {} microphones need {expected}",
            samples.len(),
            sweep.len(),
            array.len()
        ),
    ))
}

/// Rejects samples from frequency `first` on, `[f, n_mic]`, that are not finite.
pub(super) fn check_finite(place: &str, first: usize, n_mic: usize, samples: &[Complex32]) -> Result<()> {
    if let Some(bad) = samples.iter().position(|m| !m.is_finite()) {
        return Err(Error::input(
            place,
            format!(
                "are not finite at frequency {} (counted from 0), microphone {}; fix or drop it",
                first + bad / n_mic,
                bad % n_mic
            ),
        ));
    }
    Ok(())
}
