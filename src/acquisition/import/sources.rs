//! Several loudspeakers that sounded one after another: where they were, and the files of each put together.

use super::array::NumpyFiles;
use super::{FileSamples, ImportAxis, ImportOptions, named, place_of_key, read};
use crate::acquisition::array::read_positions;
use crate::acquisition::cube::check_finite;
use crate::acquisition::{DataCube, MOST_SOURCES};
use crate::error::{Error, Result};
use crate::files::extension;
use crate::wave::Geometry;
use glam::DVec3;
use serde_json::{Map, Value, json};
use std::slice::from_ref;

/// The loudspeakers in the order in which they sounded, m; none if nobody named several.
///
/// # Errors
/// An axis `"tx"` without them; those of a scan, whose loudspeaker moves; a file that does not hold them.
pub(super) fn loudspeakers(options: &ImportOptions) -> Result<Vec<DVec3>> {
    let has_axis = options.axes.contains(&ImportAxis::Transmission);
    let of_pairs = are_of_pairs(options);
    let typed = options.source_file.is_some() || !options.sources.is_empty();
    let scan = matches!(options.geometry, Some(Geometry::Monostatic | Geometry::Pair { .. }));
    if has_axis && of_pairs {
        let problem = "names \"tx\", of speakers that all microphones hear, and \"pair\", of microphones with one each; keep one";
        return Err(Error::input(place_of_key("axes"), problem));
    }
    let moved = matches!(options.geometry, Some(Geometry::Pair { .. }));
    if of_pairs && !typed && !moved {
        let problem = "are of pairs, and nothing says where their speakers were; give a file of them as `sources` in [import], a \
                       row x,y,z for each microphone";
        return Err(Error::input(place_of_key("axes"), problem));
    }
    if (has_axis || typed) && scan && !of_pairs {
        let what = if typed { "`sources`" } else { "an axis \"tx\"" };
        let problem = format!(
            "is that of a scan, whose speaker moves with the microphone, and {what} is of speakers that stand still; leave one of \
             them out"
        );
        return Err(Error::input("[array] geometry", problem));
    }
    if has_axis && !typed {
        let problem = "names an axis \"tx\", and nothing says where the speakers were; give `sources` in [array], as [[0.0, 0.0, \
                       0.0], [0.1, 0.0, 0.0]], or a file of them as `sources` in [import]";
        return Err(Error::input(place_of_key("axes"), problem));
    }
    let Some(file) = &options.source_file else { return Ok(options.sources.clone()) };
    let place = place_of_key("sources");
    let found = match extension(file).as_str() {
        "csv" => read_positions(file, options.memory)?,
        ending => {
            let array = if ending == "npy" {
                NumpyFiles::open(from_ref(file), options.limit())?.only()?
            } else {
                let first = options.samples.first().filter(|first| extension(first) == "npz");
                let mut numpy =
                    first.map(|first| NumpyFiles::open(from_ref(first), options.limit())).transpose()?;
                named(file, "sources", numpy.as_mut())?
            };
            let [.., 3] = array.shape[..] else {
                let problem =
                    format!("has the shape {:?}; [n, 3] of n speakers was expected, in m", array.shape);
                return Err(Error::input(place, problem));
            };
            array.data.chunks_exact(3).map(DVec3::from_slice).collect()
        }
    };
    if !of_pairs && !(1..=MOST_SOURCES).contains(&found.len()) {
        let problem = format!(
            "{} holds {} speakers; 1 to {MOST_SOURCES} are possible, a row x,y,z each",
            file.display(),
            found.len()
        );
        return Err(Error::input(place, problem));
    }
    Ok(found)
}

/// Whether the loudspeakers are those of pairs, one for each microphone.
pub(super) fn are_of_pairs(options: &ImportOptions) -> bool {
    let moved = matches!(options.geometry, Some(Geometry::Pair { .. }));
    moved || options.axes.contains(&ImportAxis::Pair)
}

/// Whether the samples of `count` loudspeakers are in files of their own, rather than along an axis of an array.
pub(super) fn are_in_files(options: &ImportOptions, count: usize) -> bool {
    let files = options.samples.len();
    let in_arrays = options.samples.iter().all(|path| ["npy", "npz"].contains(&extension(path).as_str()));
    let has_axis = options.axes.contains(&ImportAxis::Transmission);
    count > 1 && !has_axis && (!in_arrays || (files >= count && files.is_multiple_of(count)))
}

/// As many files for each loudspeaker, one after another in their order; a pattern of names counts as one.
///
/// Takes the memory of one of them besides that of the cube.
///
/// # Errors
/// Another number of files; files that do not agree in frequencies, microphones and detection; what is wrong with one.
pub(super) fn read_each(
    options: &ImportOptions,
    sources: &[DVec3],
    guesses: &mut Vec<String>,
    warnings: &mut Vec<String>,
) -> Result<FileSamples> {
    let (files, n_tx) = (options.samples.len(), sources.len());
    if files < n_tx || !files.is_multiple_of(n_tx) {
        let problem = format!(
            "names {files} files or patterns for {n_tx} speakers; give as many for each, in the order of `sources`, or one .npy \
             with an axis \"tx\""
        );
        return Err(Error::input(place_of_key("samples"), problem));
    }
    let each = files / n_tx;
    let mut one = options.clone();
    let mut samples = Vec::new();
    let mut facts: Vec<Map<String, Value>> = Vec::new();
    let mut first: Option<FileSamples> = None;
    for (tx, (files, source)) in options.samples.chunks_exact(each).zip(sources).enumerate() {
        one.samples = files.to_vec();
        one.geometry = Some(Geometry::FixedSource { source: *source });
        let mut said = Vec::new();
        let mut found = read(&one, 1, &mut said, warnings)?;
        said.retain(|guess| !guesses.contains(guess));
        guesses.append(&mut said);
        facts.push(std::mem::take(&mut found.facts));
        let counts = [found.sweep.0.len(), found.positions.array.len()];
        check_finite(&found.place, 0, counts[1], &found.samples)?;
        if let Some(first) = &first {
            let same = first.sweep.0 == found.sweep.0
                && first.positions.array == found.positions.array
                && first.real == found.real
                && first.phase_sign == found.phase_sign;
            if !same {
                let problem = format!(
                    "has other frequencies, microphones or kinds of samples than {}; of every speaker the same ones are needed",
                    options.samples[0].display()
                );
                return Err(Error::input(files[0].display(), problem));
            }
        } else {
            samples = DataCube::allocate([n_tx, counts[0], counts[1]])?;
        }
        samples[tx * found.samples.len()..][..found.samples.len()].copy_from_slice(&found.samples);
        if first.is_none() {
            found.samples = Vec::new();
            first = Some(found);
        }
    }
    let Some(first) = first else {
        return Err(Error::input(place_of_key("sources"), "names no speakers"));
    };
    guesses.push(format!("samples: {each} of them for each speaker, in the order of `sources`"));
    Ok(FileSamples { samples, facts: together(&facts), place: place_of_key("samples"), ..first })
}

/// What files say alike, and of the rest what each says.
fn together(facts: &[Map<String, Value>]) -> Map<String, Value> {
    let Some((first, others)) = facts.split_first() else { return Map::new() };
    let of_all = |name: &String, value: &Value| {
        if others.iter().all(|other| other.get(name) == Some(value)) {
            return value.clone();
        }
        json!(facts.iter().map(|each| each.get(name)).collect::<Vec<_>>())
    };
    first.iter().map(|(name, value)| (name.clone(), of_all(name, value))).collect()
}
