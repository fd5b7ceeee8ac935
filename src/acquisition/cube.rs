//! The data cube `m(f, r)` and its file, `.npz` or `.zarr`, which the chapter `files` of the guide describes.

mod writing;

use super::source::{CubeSource, Visit, visit_samples};
use super::{CubeFile, Instrument};
use crate::alloc::try_zeroed;
use crate::error::{Error, Result};
use num_complex::Complex32;
use serde_json::Value;
use std::path::Path;

/// A measured or simulated cube, with everything that imaging needs.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct DataCube {
    /// The instrument that measured it.
    pub instrument: Instrument,
    /// `[n_f, n_mic]`, or `[n_tx, n_f, n_mic]` for several loudspeakers, with phase sign +1; in-phase samples are real.
    pub samples: Vec<Complex32>,
    /// The origin of the cube (`run`, `seed` of a simulation); null for a measurement.
    pub provenance: Value,
}

pub(super) const FORMAT: &str = "holosonar-cube";
pub(super) const VERSION: u32 = 1;

impl DataCube {
    /// A cube of the given samples, `[n_f, n_mic]` or, for several loudspeakers, `[n_tx, n_f, n_mic]`, measured with `instrument`; in-phase samples have no imaginary parts.
    ///
    /// # Errors
    /// A number of samples other than transmissions × frequencies × microphones; samples that are not finite.
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
        check_all_finite("samples", &instrument, &samples)?;
        Ok(Self { instrument, samples, provenance: Value::Null })
    }

    /// The samples of a transmission, `[n_f, n_mic]`.
    ///
    /// # Panics
    /// If there are not so many [transmissions](Instrument::transmissions).
    pub fn transmission(&self, index: usize) -> &[Complex32] {
        let len = self.instrument.sweep.len() * self.instrument.array.len();
        &self.samples[index * len..][..len]
    }

    /// The samples of frequency `f`, `[n_mic]`; of several transmissions, of the first.
    pub fn frequency(&self, f: usize) -> &[Complex32] {
        let n = self.instrument.array.len();
        &self.samples[f * n..(f + 1) * n]
    }

    /// The samples of a cube of so many transmissions, frequencies and microphones, all zero.
    pub(in crate::acquisition) fn allocate(counts: [usize; 3]) -> Result<Vec<Complex32>> {
        let total = counts.iter().try_fold(1_u64, |product, n| product.checked_mul(*n as u64));
        total.and_then(try_zeroed).ok_or_else(|| {
            let [n_tx, n_f, n_mic] = counts;
            let of_sources = if n_tx > 1 { format!("{n_tx} loudspeakers x ") } else { String::new() };
            Error::out_of_memory(format!(
                "a cube of {of_sources}{n_f} frequencies x {n_mic} microphones does not fit in memory; use fewer of either"
            ))
        })
    }

    /// Writes the cube: `samples`, `frequencies`, `mic_positions`, `meta`, and `sources` if there are several, or
    /// `source_positions` of a pair: as a Zarr store if the extension is `.zarr`, else as an npz. The same cube gives the same
    /// bytes.
    ///
    /// # Errors
    /// [`Error::Io`] if the file cannot be written; an existing file is then unchanged. [`Error::InvalidInput`] for a
    /// folder at `path` that is no store of this program.
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
    /// A view of samples, `[n_f, n_mic]`, or `[n_tx, n_f, n_mic]` of several loudspeakers, with phase sign +1; in-phase samples
    /// have no imaginary parts. Those that are not finite are refused when they are visited, unless a calibration masks them
    /// before.
    ///
    /// # Errors
    /// A number of samples other than loudspeakers × frequencies × microphones.
    pub fn new(instrument: &'a Instrument, samples: &'a [Complex32]) -> Result<Self> {
        check_count(instrument, samples)?;
        Ok(Self { instrument, samples })
    }

    /// The samples, `[n_f, n_mic]`, or `[n_tx, n_f, n_mic]` of several loudspeakers.
    pub fn samples(&self) -> &'a [Complex32] {
        self.samples
    }
}

impl CubeSource for CubeView<'_> {
    fn instrument(&self) -> &Instrument {
        self.instrument
    }

    fn held_bytes(&self) -> u64 {
        0 // besides those that the caller has
    }

    fn visit_transmission(&mut self, transmission: usize, block: usize, visit: &mut Visit) -> Result<()> {
        let (instrument, samples) = (self.instrument, self.samples);
        let place = of_loudspeaker("samples", instrument, transmission);
        visit_samples(instrument, (transmission, samples), block, &mut |range, samples| {
            check_finite(&place, range.start, instrument.array.len(), samples)?;
            visit(range, samples)
        })
    }
}

/// Rejects samples that are not as many as the instrument has.
fn check_count(instrument: &Instrument, samples: &[Complex32]) -> Result<()> {
    let (n_f, n_mic, transmissions) =
        (instrument.sweep.len(), instrument.array.len(), instrument.transmissions());
    let expected = n_f as u64 * n_mic as u64 * transmissions as u64;
    if samples.len() as u64 == expected {
        return Ok(());
    }
    let of_sources =
        if transmissions > 1 { format!("{transmissions} loudspeakers x ") } else { String::new() };
    Err(Error::input(
        "samples",
        format!(
            "there are {} values; {of_sources}{n_f} frequencies x {n_mic} microphones need {expected}",
            samples.len(),
        ),
    ))
}

/// A place in a cube's samples, with the number of the loudspeaker where there are several.
fn of_loudspeaker(place: &str, instrument: &Instrument, transmission: usize) -> String {
    if instrument.transmissions() > 1 {
        format!("{place}, loudspeaker {transmission}")
    } else {
        place.to_owned()
    }
}

/// Rejects samples of any transmission, `[n_tx, n_f, n_mic]`, that are not finite.
pub(super) fn check_all_finite(place: &str, instrument: &Instrument, samples: &[Complex32]) -> Result<()> {
    let n_mic = instrument.array.len();
    samples
        .chunks(instrument.sweep.len() * n_mic)
        .enumerate()
        .try_for_each(|(tx, samples)| check_finite(&of_loudspeaker(place, instrument, tx), 0, n_mic, samples))
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
