//! The loudspeakers of a cube file: the one of `meta`, several in an array `sources`, or one for each microphone, moved with it or
//! not, in `source_positions`.

use super::refused;
use crate::acquisition::{Instrument, MOST_SOURCES};
use crate::error::Result;
use crate::files::arrays::{ArrayFile, place_of};
use crate::wave::{Geometry, GeometryKind};
use glam::DVec3;
use std::path::Path;

/// The instrument with the loudspeakers that the file names; `source` is that of `meta`.
pub(super) fn placed(
    path: &Path,
    arrays: &mut ArrayFile,
    instrument: Instrument,
    (kind, source): (GeometryKind, Option<[f64; 3]>),
) -> Result<Instrument> {
    for (array, of) in [("sources", GeometryKind::FixedSource), ("source_positions", GeometryKind::Pair)] {
        if arrays.contains(array) && kind != of {
            let problem = format!("belongs to the geometry \"{of}\", and `meta` says \"{kind}\"");
            return refused(path, array, problem);
        }
    }
    match kind {
        GeometryKind::Monostatic => Ok(instrument.with_geometry(Geometry::Monostatic)),
        GeometryKind::FixedSource if arrays.contains("sources") => several(path, arrays, instrument, source),
        GeometryKind::FixedSource => {
            let source = source.map_or(DVec3::ZERO, DVec3::from_array);
            Ok(instrument.with_geometry(Geometry::FixedSource { source }))
        }
        GeometryKind::Pair => pairs(path, arrays, instrument),
    }
}

fn several(
    path: &Path,
    arrays: &mut ArrayFile,
    instrument: Instrument,
    source: Option<[f64; 3]>,
) -> Result<Instrument> {
    let shape = arrays.shape("sources")?;
    let [1..=MOST_SOURCES, 3] = shape[..] else {
        let problem = format!("must be [n_tx, 3], of 1 to {MOST_SOURCES} loudspeakers, not {shape:?}");
        return refused(path, "sources", problem);
    };
    if source.is_some() {
        let problem = "gives the loudspeakers, and so does `source`; leave that out";
        return refused(path, "sources", problem);
    }
    let sources = arrays.f64("sources")?;
    let points: Vec<DVec3> = sources.data.chunks_exact(3).map(DVec3::from_slice).collect();
    let instrument = instrument.with_sources(&points)?;
    instrument.check().map_err(|error| error.at(place_of(path, "sources")))?;
    Ok(instrument)
}

/// A loudspeaker for each microphone.
fn pairs(path: &Path, arrays: &mut ArrayFile, instrument: Instrument) -> Result<Instrument> {
    const ARRAY: &str = "source_positions";
    if !arrays.contains(ARRAY) {
        let problem = "is missing: the geometry \"pair\" has a loudspeaker beside each microphone";
        return refused(path, ARRAY, problem);
    }
    let (shape, expected) = (arrays.shape(ARRAY)?, arrays.shape("mic_positions")?);
    if shape != expected {
        return refused(
            path,
            ARRAY,
            format!("must have the shape of `mic_positions`, {expected:?}, not {shape:?}"),
        );
    }
    let sources = arrays.f64(ARRAY)?;
    let sources: Vec<DVec3> = sources.data.chunks_exact(3).map(DVec3::from_slice).collect();
    let pairs = instrument.with_pairs(&sources).map_err(|error| error.at(place_of(path, ARRAY)))?;
    pairs.check().map_err(|error| error.at(place_of(path, ARRAY)))?;
    Ok(pairs)
}
