//! WAV files: multichannel recordings, read from any frame on and written frame by frame.
//!
//! The crate hound reads the format and the samples. It is given each piece of a file as a file of its own, since it would
//! stumble over chunks of odd lengths, as recorders write them before the samples, and read everything before a frame.

#[cfg(test)]
mod tests;

use super::{AtomicFile, open_input};
use crate::alloc::try_with_capacity;
use crate::choice::choice;
use crate::error::{Error, Result, gib};
use hound::{SampleFormat, WavReader, WavSpec, WavWriter};
use std::fs::File;
use std::io::{self, BufReader, BufWriter, Cursor, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

choice! {
    /// How a WAV file stores its samples.
    pub enum WavFormat: "sample format" {
        /// 16 bits, full scale 1.
        Int16 = "int16",
        /// 24 bits, full scale 1.
        Int24 = "int24",
        /// Single precision.
        Float32 = "float32",
    }
}

impl WavFormat {
    /// Bits of an integer; `None`: floating-point numbers.
    pub(crate) fn bits(self) -> Option<u16> {
        match self {
            Self::Int16 => Some(16),
            Self::Int24 => Some(24),
            Self::Float32 => None,
        }
    }

    /// Bytes of a sample.
    pub(crate) fn bytes(self) -> u64 {
        u64::from(self.bits().unwrap_or(32)) / 8
    }
}

/// The most chunks before the samples; recorders write a handful.
const MOST_CHUNKS: usize = 1000;

/// The longest description of a format, bytes; the longest that is known has 40.
const LONGEST_FORMAT: u32 = 1024;

/// The most that a WAV file can hold, bytes: its lengths have 32 bits. Its headers take less than 128 of them.
pub(crate) const LARGEST_WAV: u64 = u32::MAX as u64 - 128;

/// A WAV file that is open for reading. A frame is one sample of each channel.
#[derive(Debug)]
pub(crate) struct WavFile {
    path: PathBuf,
    file: File,
    /// The chunk that describes the format, with its name and length.
    format: Vec<u8>,
    spec: WavSpec,
    /// Bytes of a frame.
    frame: u64,
    /// Where the samples begin.
    first: u64,
    frames: u64,
}

impl WavFile {
    /// Opens a file and reads what is before its samples.
    ///
    /// # Errors
    /// A file that is no WAV file, of integers or of floating-point numbers, or that ends before its samples do.
    pub(crate) fn open(path: &Path) -> Result<Self> {
        let refuse = |problem: String| Error::input(path.display(), problem);
        let reading = |error| Error::reading(path, error);
        let mut file = open_input(path)?;
        let length = file.metadata().map_err(reading)?.len();
        let mut head = [0; 12];
        let is_long_enough = length >= 12;
        if is_long_enough {
            file.read_exact(&mut head).map_err(reading)?;
        }
        if &head[..4] != b"RIFF" || &head[8..] != b"WAVE" {
            return Err(refuse(not_wav(&head)));
        }
        let mut format = Vec::new();
        for _ in 0..MOST_CHUNKS {
            let mut chunk = [0; 8];
            let at = file.stream_position().map_err(reading)?;
            if at.saturating_add(8) > length {
                return Err(refuse("ends before its samples; it was cut off".into()));
            }
            file.read_exact(&mut chunk).map_err(reading)?;
            let bytes = u32::from_le_bytes([chunk[4], chunk[5], chunk[6], chunk[7]]);
            let left = length - at - 8;
            match &chunk[..4] {
                b"data" if format.is_empty() => return Err(refuse("has samples, but no format".into())),
                b"data" if u64::from(bytes) > left => {
                    return Err(refuse(format!(
                        "says that {bytes} bytes of samples follow, and {left} do; it was cut off, or its recording never \
                         ended: open it in an audio editor and save it again"
                    )));
                }
                b"data" => return Self::of(path, file, format, at + 8, bytes),
                b"fmt " if u64::from(bytes) > left => {
                    return Err(refuse("ends within its format; it was cut off".into()));
                }
                b"fmt " if bytes > LONGEST_FORMAT => {
                    return Err(refuse(format!("has a format of {bytes} bytes; 16 to 40 were expected")));
                }
                b"fmt " => {
                    format = [chunk.to_vec(), vec![0; bytes as usize]].concat();
                    file.read_exact(&mut format[8..]).map_err(reading)?;
                }
                _ => {}
            }
            // Chunks begin at even places.
            let next = at + 8 + u64::from(bytes) + u64::from(bytes % 2);
            file.seek(SeekFrom::Start(next)).map_err(reading)?;
        }
        Err(refuse(format!("has more than {MOST_CHUNKS} chunks before its samples")))
    }

    /// A file whose `bytes` of samples begin at `first`.
    fn of(path: &Path, file: File, format: Vec<u8>, first: u64, bytes: u32) -> Result<Self> {
        let refuse = |problem: String| Error::input(path.display(), problem);
        let empty = header(&format, 0);
        let spec = WavReader::new(Cursor::new(empty)).map_err(|error| refuse(in_words(&error)))?.spec();
        // As hound divides it: bytes of a frame, of which each channel has as many.
        let frame = format.get(20..22).map_or(0, |align| u64::from(u16::from_le_bytes([align[0], align[1]])));
        let each = frame / u64::from(spec.channels);
        if each == 0 || frame % u64::from(spec.channels) != 0 {
            return Err(refuse(format!("has {frame} bytes for {} channels", spec.channels)));
        }
        if spec.sample_rate == 0 {
            return Err(refuse("has a sample rate of 0".into()));
        }
        let (length, frames) = (u64::from(bytes), u64::from(bytes) / frame);
        if frames == 0 {
            return Err(refuse("holds no samples; its recording may never have ended".into()));
        }
        if length % frame != 0 {
            return Err(refuse(format!("has {length} bytes of samples, no multiple of {frame}, a frame")));
        }
        Ok(Self { path: path.to_owned(), file, format, spec, frame, first, frames })
    }

    /// The path that it was opened by.
    pub(crate) fn path(&self) -> &Path {
        &self.path
    }

    /// Number of channels.
    pub(crate) fn channels(&self) -> usize {
        self.spec.channels.into()
    }

    /// Frames per second, Hz.
    pub(crate) fn sample_rate(&self) -> f64 {
        self.spec.sample_rate.into()
    }

    /// Number of frames.
    pub(crate) fn frames(&self) -> u64 {
        self.frames
    }

    /// Its duration, s.
    pub(crate) fn seconds(&self) -> f64 {
        self.frames as f64 / self.sample_rate()
    }

    /// The least amplitude that is at full scale: that of the largest integer.
    pub(crate) fn full_scale(&self) -> f32 {
        match self.spec.sample_format {
            SampleFormat::Float => 1.0,
            SampleFormat::Int => 1.0 - 2_f32.powi(1 - i32::from(self.spec.bits_per_sample)),
        }
    }

    /// How it stores samples, in words.
    pub(crate) fn described(&self) -> String {
        let WavSpec { channels, sample_rate, bits_per_sample, sample_format } = self.spec;
        let kind = if sample_format == SampleFormat::Float { "floating-point" } else { "integer" };
        let s = if channels == 1 { "" } else { "s" };
        format!("{channels} channel{s}, {sample_rate} Hz, {bits_per_sample} bits, {kind}")
    }

    /// Reads `count` frames from frame `from` on, `[frame, channel]`, full scale 1.
    ///
    /// # Errors
    /// Samples that are not finite, or that cannot be read or held.
    ///
    /// # Panics
    /// When frames are asked for that are not there.
    pub(crate) fn read(&mut self, from: u64, count: u64) -> Result<Vec<f32>> {
        assert!(from + count <= self.frames, "frames {from} + {count} of {}", self.frames);
        let reading = |error: hound::Error| match error {
            hound::Error::IoError(error) => Error::reading(&self.path, error),
            other => Error::input(self.path.display(), in_words(&other)),
        };
        let values = count * u64::from(self.spec.channels);
        let mut samples: Vec<f32> = try_with_capacity(values).ok_or_else(|| {
            Error::out_of_memory(format!("{count} frames of {} channels do not fit", self.spec.channels))
        })?;
        self.file
            .seek(SeekFrom::Start(self.first + from * self.frame))
            .map_err(|error| reading(hound::Error::IoError(error)))?;
        let bytes = count * self.frame;
        let head = Cursor::new(header(&self.format, bytes as u32));
        let piece = head.chain(BufReader::with_capacity(1 << 16, &self.file).take(bytes));
        let reader = WavReader::new(piece).map_err(reading)?;
        match self.spec.sample_format {
            SampleFormat::Float => {
                for sample in reader.into_samples::<f32>() {
                    samples.push(sample.map_err(reading)?);
                }
            }
            SampleFormat::Int => {
                let scale = 2_f64.powi(1 - i32::from(self.spec.bits_per_sample));
                for sample in reader.into_samples::<i32>() {
                    samples.push((f64::from(sample.map_err(reading)?) * scale) as f32);
                }
            }
        }
        if let Some(bad) = samples.iter().position(|sample| !sample.is_finite()) {
            let (frame, channel) = (from + (bad / self.channels()) as u64, bad % self.channels());
            let problem = format!("has a sample that is not finite, in channel {channel} at frame {frame}");
            return Err(Error::input(self.path.display(), problem));
        }
        Ok(samples)
    }
}

/// What a file is that is no WAV file, as far as it can be told.
fn not_wav(head: &[u8; 12]) -> String {
    let kind = match &head[..4] {
        b"RF64" | b"BW64" => "is an RF64 file, for recordings of more than 4 GiB",
        b"riff" => "is a W64 file",
        b"RIFX" => "is a WAV file of big-endian numbers",
        b"FORM" => "is an AIFF file",
        b"fLaC" => "is a FLAC file",
        b"OggS" => "is an Ogg file, which would have changed the phases",
        _ => "is no WAV file",
    };
    format!(
        "{kind}; save it as WAV, of integers or 32-bit floating-point numbers, in files of less than 4 GiB"
    )
}

/// What hound says of a format, for people.
fn in_words(error: &hound::Error) -> String {
    let why = match error {
        hound::Error::FormatError(why) => (*why).to_owned(),
        hound::Error::Unsupported => "its samples are compressed".to_owned(),
        other => other.to_string(),
    };
    format!(
        "is a WAV file of a kind that is not read ({why}); save it with 16 or 24 bits, or 32-bit floating point"
    )
}

/// What is before the samples of a file of this format, with `bytes` of them.
fn header(format: &[u8], bytes: u32) -> Vec<u8> {
    let length = (4 + format.len() + 8) as u32;
    [b"RIFF", &length.saturating_add(bytes).to_le_bytes()[..], b"WAVE", format, b"data", &bytes.to_le_bytes()]
        .concat()
}

/// Writes the frames that `frames` gives to its argument, `[frame, channel]`, full scale 1; integers stay below it.
///
/// # Errors
/// As [`AtomicFile::create`] and [`AtomicFile::commit`], and those of `frames`; there is no file then.
///
/// # Panics
/// When there are more samples than [`check_wav_size`] allows.
pub(crate) fn write_wav(
    path: &Path,
    (channels, sample_rate, format): (u16, u32, WavFormat),
    frames: impl FnOnce(&mut dyn FnMut(&[f32]) -> Result<()>) -> Result<()>,
) -> Result<()> {
    let sample_format = if format.bits().is_none() { SampleFormat::Float } else { SampleFormat::Int };
    let spec = WavSpec { channels, sample_rate, bits_per_sample: format.bits().unwrap_or(32), sample_format };
    let failed = |error: hound::Error| match error {
        hound::Error::IoError(error) => Error::writing(path, error),
        other => Error::writing(path, io::Error::other(other.to_string())),
    };
    let file = AtomicFile::create(path)?;
    let mut writer = WavWriter::new(BufWriter::with_capacity(1 << 16, file.file()), spec).map_err(failed)?;
    frames(&mut |samples| {
        for &sample in samples {
            let written = match format.bits() {
                None => writer.write_sample(sample),
                Some(bits) => {
                    let scale = 2_f64.powi(i32::from(bits) - 1);
                    let whole = (f64::from(sample) * scale).round().clamp(-scale, scale - 1.0);
                    writer.write_sample(whole as i32)
                }
            };
            written.map_err(failed)?;
        }
        Ok(())
    })?;
    writer.finalize().map_err(failed)?;
    file.commit()
}

/// Refuses a recording that no WAV file can hold.
///
/// # Errors
/// More channels or bytes than fit.
pub(crate) fn check_wav_size(place: &str, frames: u64, channels: u64, format: WavFormat) -> Result<u64> {
    let bytes = frames.saturating_mul(channels).saturating_mul(format.bytes());
    if bytes <= LARGEST_WAV && u16::try_from(channels).is_ok() {
        return Ok(bytes);
    }
    let problem = format!(
        "would take {} for {channels} channels of {frames} samples, and a WAV file holds {}; use fewer microphones or tones, \
         shorter tones, or a lower sample rate",
        gib(bytes),
        gib(LARGEST_WAV)
    );
    Err(Error::input(place, problem))
}
