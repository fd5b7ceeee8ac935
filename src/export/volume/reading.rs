//! Reads volumes of complex samples: the arrays of an npz and of a Zarr store have the same names.

use crate::error::{Error, Result};
use crate::files::arrays::{ArrayFile, fault};
use crate::grid::{Axis, Grid, Volume};
use serde_json::Value;
use std::path::Path;

/// Maximum deviation of a voxel centre from even spacing, relative to the length of the axis.
const EVENNESS: f64 = 1e-6;

/// Reads a volume of at most `limit_bytes`, and its `meta` (an empty object if the file has none), from a Zarr store if the
/// extension is `.zarr`, else from an npz.
///
/// Axes must ascend evenly, to 10⁻⁶ of their length. The pitch of an axis of one voxel is that in `pitch`, or that of a
/// longer axis of the volume, or 1 m.
///
/// # Errors
/// A missing or damaged file, inconsistent array sizes, an uneven axis, or a `meta` that is not a JSON object; the error
/// names the array.
pub fn read_volume(path: &Path, limit_bytes: u64) -> Result<(Volume, Value)> {
    read_arrays(path, &mut ArrayFile::open(path, limit_bytes)?)
}

/// The same of an open file.
pub(super) fn read_arrays(path: &Path, arrays: &mut ArrayFile) -> Result<(Volume, Value)> {
    if arrays.contains("z") && arrays.contains("amplitude") && !arrays.contains("samples") {
        return Err(Error::input(
            path.display(),
            "holds amplitudes alone, and complex samples were expected: write it with `--set output.components=complex`",
        ));
    }
    let grid = read_grid(path, arrays, "samples")?;
    let samples = arrays.complex("samples")?.data;
    Ok((Volume::new(grid, samples), read_meta(path, arrays)?))
}

/// The positions of the voxels of an array.
pub(in crate::export) fn read_grid(path: &Path, arrays: &mut ArrayFile, of: &str) -> Result<Grid> {
    if arrays.contains("frequencies") && !arrays.contains("z") {
        return Err(Error::input(
            path.display(),
            "is a data cube; a volume was expected (`holosonar reconstruct` computes it)",
        ));
    }
    let shape = arrays.shape(of)?;
    let &[n_z, n_y, n_x] = shape.as_slice() else {
        return Err(fault(path, of, format!("has the shape {shape:?}; three axes [z, y, x] were expected")));
    };
    let given = if arrays.contains("pitch") { arrays.f64("pitch")?.data } else { Vec::new() };
    let mut axes = Vec::new();
    for (place, (name, count)) in [("x", n_x), ("y", n_y), ("z", n_z)].into_iter().enumerate() {
        let positions = arrays.f64(name)?;
        if positions.shape != [count] {
            let found = positions.shape;
            let problem = format!("has the shape {found:?}; [{count}], as of `{of}`, was expected");
            return Err(fault(path, name, problem));
        }
        axes.push(
            axis(&positions.data, given.get(place).copied()).map_err(|problem| fault(path, name, problem))?,
        );
    }
    let longer = axes.iter().find(|axis| axis.count > 1).map_or(1.0, |axis| axis.pitch);
    for axis in &mut axes {
        if axis.pitch == 0.0 {
            axis.pitch = longer;
        }
    }
    Ok(Grid { x: axes[0], y: axes[1], z: axes[2] })
}

/// The metadata.
pub(in crate::export) fn read_meta(path: &Path, arrays: &mut ArrayFile) -> Result<Value> {
    if !arrays.contains("meta") {
        return Ok(Value::Object(serde_json::Map::new()));
    }
    let meta = serde_json::from_str(&arrays.text("meta")?).ok().filter(Value::is_object);
    meta.ok_or_else(|| fault(path, "meta", "is not a JSON object; `{...}` was expected"))
}

/// The axis with these voxel centres; its pitch is 0 if there is only one centre and none is `given`.
fn axis(positions: &[f64], given: Option<f64>) -> std::result::Result<Axis, String> {
    let (Some(&first), Some(&last)) = (positions.first(), positions.last()) else {
        return Err("is empty; at least one voxel was expected".into());
    };
    if !positions.iter().all(|position| position.is_finite()) {
        return Err("has a number that is not finite; positions in m were expected".into());
    }
    let given = given.filter(|pitch| pitch.is_finite() && *pitch > 0.0);
    let count = positions.len();
    if count == 1 {
        return Ok(Axis { first, pitch: given.unwrap_or(0.0), count });
    }
    let length = last - first;
    if length <= 0.0 {
        return Err(format!("runs from {first} to {last}; ascending positions were expected"));
    }
    let fits = |pitch: f64| {
        let axis = Axis { first, pitch, count };
        positions.iter().zip(axis.positions()).position(|(a, b)| (a - b).abs() > EVENNESS * length)
    };
    let mean = length / (count - 1) as f64;
    match (given.filter(|&pitch| fits(pitch).is_none()), fits(mean)) {
        (Some(pitch), _) => Ok(Axis { first, pitch, count }),
        (None, None) => Ok(Axis { first, pitch: mean, count }),
        (None, Some(at)) => Err(format!(
            "is not evenly spaced: element {at} is {}; {} was expected with a pitch of {mean} m",
            positions[at],
            first + mean * at as f64
        )),
    }
}
