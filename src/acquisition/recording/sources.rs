//! The files of a recording: which of their channels are microphones, and where the reference is.

use super::options::place_of_key;
use super::{RecordingOptions, Reference};
use crate::error::{Error, Result, gib};
use crate::files::wav::WavFile;
use std::path::{Path, PathBuf};

/// A file that is open, and what its channels are.
#[derive(Debug)]
pub(super) struct RecordedFile {
    pub(super) file: WavFile,
    /// Channels of the microphones.
    pub(super) microphones: Vec<usize>,
    pub(super) reference: Sent,
}

/// Where the signal is that was sent.
#[derive(Debug)]
pub(super) enum Sent {
    /// Nowhere.
    Unrecorded,
    /// In this channel of the file itself.
    Channel(usize),
    /// In another file.
    File(WavFile),
}

impl RecordedFile {
    /// Opens a file. Its sample rate must represent frequencies up to `highest`, Hz.
    ///
    /// # Errors
    /// A file that is no WAV file; channels that it does not have; a sample rate that is too low.
    pub(super) fn open(path: &Path, highest: f64, options: &RecordingOptions) -> Result<Self> {
        let file = WavFile::open(path)?;
        let (rate, channels) = (file.sample_rate(), file.channels());
        if rate <= 2.0 * highest {
            let problem = format!(
                "has {rate} samples a second, and tones up to {highest} Hz need more than twice as many as that; record with a \
                 higher sample rate, or stop the sweep below {} Hz",
                rate / 2.0
            );
            return Err(Error::input(path.display(), problem));
        }
        let known = |key: &str, channel: usize| {
            if channel < channels {
                return Ok(channel);
            }
            let problem =
                format!("names channel {channel}, and {} has {channels}, counted from 0", path.display());
            Err(Error::input(place_of_key(key), problem))
        };
        let reference = match &options.reference {
            None => Sent::Unrecorded,
            Some(Reference::Channel(channel)) => Sent::Channel(known("reference", *channel)?),
            Some(Reference::File(sent)) => Sent::File(one_channel(sent, &file)?),
        };
        let of_reference = |channel: usize| matches!(reference, Sent::Channel(sent) if sent == channel);
        let microphones: Vec<usize> = if options.microphones.is_empty() {
            (0..channels).filter(|channel| !of_reference(*channel)).collect()
        } else {
            let all = options.microphones.iter();
            all.map(|channel| known("microphones", *channel)).collect::<Result<_>>()?
        };
        if let Some(twice) = microphones.iter().find(|channel| of_reference(**channel)) {
            let problem = format!("names channel {twice}, which is the reference");
            return Err(Error::input(place_of_key("microphones"), problem));
        }
        if microphones.is_empty() {
            let problem = "has a single channel, which is the reference, and no microphone";
            return Err(Error::input(path.display(), problem));
        }
        Ok(Self { file, microphones, reference })
    }

    /// The file that holds the reference and its channel there, if there is one.
    pub(super) fn sent(&mut self) -> Option<(&mut WavFile, usize)> {
        match &mut self.reference {
            Sent::Unrecorded => None,
            Sent::Channel(channel) => Some((&mut self.file, *channel)),
            Sent::File(file) => Some((file, 0)),
        }
    }
}

/// A reference of its own file, which must go with the recording.
fn one_channel(path: &Path, recording: &WavFile) -> Result<WavFile> {
    let file = WavFile::open(path)?;
    let problem = if file.channels() != 1 {
        format!("has {} channels; a reference has one", file.channels())
    } else if file.sample_rate() != recording.sample_rate() {
        format!(
            "has {} samples a second, and {} has {}; they must be equal",
            file.sample_rate(),
            recording.path().display(),
            recording.sample_rate()
        )
    } else {
        return Ok(file);
    };
    Err(Error::input(path.display(), problem))
}

/// Checks that the files hold as many microphones as the array; returns what the first one is, in words.
///
/// # Errors
/// As [`RecordedFile::open`]; another number of microphones.
pub(super) fn check_files(
    files: &[PathBuf],
    n_mic: usize,
    highest: f64,
    options: &RecordingOptions,
) -> Result<String> {
    let (mut found, mut described) = (0, String::new());
    for path in files {
        let source = RecordedFile::open(path, highest, options)?;
        found += source.microphones.len();
        if described.is_empty() {
            described = source.file.described();
        }
    }
    if found == n_mic {
        return Ok(described);
    }
    let hint = match options.reference {
        None if found == n_mic + files.len() => {
            "; if one of them is the signal that was sent, give its number, from 0, as recording.reference"
        }
        _ => "; give those of the microphones, in the order of the array, as recording.microphones",
    };
    let what = if files.len() == 1 { "file has" } else { "files have" };
    let problem =
        format!("{n_mic} microphones are in [array], and the {what} {found} channels for them{hint}");
    Err(Error::input("[import] samples", problem))
}

/// Refuses what does not fit in memory.
pub(super) fn check_memory(file: &WavFile, bytes: u64, limit: u64) -> Result<()> {
    if bytes <= limit {
        return Ok(());
    }
    let problem = format!(
        "takes {} of memory to read, and {} may be used here (--memory sets another limit); give fewer channels a file, or \
         shorter recordings",
        gib(bytes),
        gib(limit)
    );
    Err(Error::input(file.path().display(), problem))
}

/// How many channels that are cut off are named.
const NAMED: usize = 8;

/// Counts samples that are cut off at full scale, channel by channel.
#[derive(Debug, Default)]
pub(super) struct Clipped(Vec<u64>);

impl Clipped {
    /// Looks at frames of a file, `[frame, channel]`: what stays at full scale is cut off.
    pub(super) fn look(&mut self, file: &WavFile, frames: &[f32]) {
        let channels = file.channels();
        self.0.resize(channels, 0);
        let full = file.full_scale();
        for (index, (now, next)) in frames.iter().zip(frames.iter().skip(channels)).enumerate() {
            self.0[index % channels] += u64::from(now == next && now.abs() >= full);
        }
    }

    /// A warning, if the reference or microphones are among these channels.
    pub(super) fn warning(&self, source: &RecordedFile) -> Option<String> {
        let is_clipped = |channel: &usize| self.0.get(*channel).is_some_and(|count| *count > 0);
        let reference = match source.reference {
            Sent::Channel(channel) => Some(channel).filter(is_clipped),
            Sent::Unrecorded | Sent::File(_) => None,
        };
        let microphones: Vec<usize> = source.microphones.iter().copied().filter(is_clipped).collect();
        let mut named: Vec<String> = microphones.iter().take(NAMED).map(ToString::to_string).collect();
        if microphones.len() > NAMED {
            named.push(format!("... ({} in all)", microphones.len()));
        }
        let what = match (reference, named.is_empty()) {
            (None, true) => return None,
            (None, false) => format!("channel {}", named.join(", ")),
            (Some(reference), true) => format!("the reference, channel {reference},"),
            (Some(reference), false) => {
                format!("the reference, channel {reference}, and channel {}", named.join(", "))
            }
        };
        Some(format!(
            "{}: {what} (counted from 0) stays at full scale and is cut off there, which makes echoes that do not exist; lower \
             the gain",
            source.file.path().display()
        ))
    }
}
