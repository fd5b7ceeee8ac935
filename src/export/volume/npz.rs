//! Volumes as `NumPy` archives: complex samples, axes and metadata.

use super::{VolumeFile, VolumeStream};
use crate::error::{Error, Result};
use crate::files::npz::{NpzReader, NpzWriter};
use crate::grid::{Axis, Grid, Volume};
use num_complex::Complex32;
use serde_json::Value;
use std::fs::File;
use std::io::{self, BufWriter};
use std::path::Path;

/// Maximum deviation of a voxel centre from even spacing, relative to the length of the axis.
const EVENNESS: f64 = 1e-6;

/// Writes `samples` complex64 `[z, y, x]`; `x`, `y`, `z` in m; `pitch` `[3]`, in m along x, y, z; and `meta`,
/// metadata as JSON.
///
/// # Errors
/// As `crate::files::write_atomically`.
pub fn write_volume_npz(path: &Path, volume: &Volume, meta: &Value) -> Result<()> {
    stream_volume_npz(path, volume.grid, meta)?.whole(volume)
}

/// The same depth by depth.
///
/// # Errors
/// As [`write_volume_npz`].
pub(crate) fn stream_volume_npz(path: &Path, grid: Grid, meta: &Value) -> Result<VolumeFile> {
    VolumeFile::create(path, |out| {
        let mut npz = NpzWriter::new(out);
        npz.begin_complex("samples", &grid.shape())?;
        Ok(NpzVolume { npz, grid, meta: meta.to_string() })
    })
}

/// A volume that is being written.
struct NpzVolume {
    npz: NpzWriter<BufWriter<File>>,
    grid: Grid,
    meta: String,
}

impl VolumeStream for NpzVolume {
    fn planes(&mut self, planes: &[Complex32]) -> io::Result<()> {
        self.npz.append(planes)
    }

    fn finish(self: Box<Self>) -> io::Result<()> {
        let Self { mut npz, grid, meta } = *self;
        for (name, axis) in [("x", &grid.x), ("y", &grid.y), ("z", &grid.z)] {
            npz.f64(name, &[axis.count], &axis.positions().collect::<Vec<_>>())?;
        }
        npz.f64("pitch", &[3], &[grid.x.pitch, grid.y.pitch, grid.z.pitch])?;
        npz.text("meta", &meta)?;
        npz.finish()
    }
}

/// Reads a volume of at most `limit_bytes`, and its `meta` (an empty object if the file has none).
///
/// Axes must ascend evenly, to 10⁻⁶ of their length. The pitch of an axis of one voxel is that in `pitch`, or that of a
/// longer axis of the volume, or 1 m.
///
/// # Errors
/// A missing or damaged file, inconsistent array sizes, an uneven axis, or a `meta` that is not a JSON object; the error
/// names the array.
pub fn read_volume_npz(path: &Path, limit_bytes: u64) -> Result<(Volume, Value)> {
    let mut npz = NpzReader::open(path, limit_bytes)?;
    let fault =
        |name: &str, problem: String| Error::input(format!("{}, array `{name}`", path.display()), problem);
    if npz.contains("frequencies") && !npz.contains("z") {
        return Err(Error::input(
            path.display(),
            "is a data cube; a volume was expected (`holosonar reconstruct` computes it)",
        ));
    }
    let shape = npz.shape("samples")?;
    let &[n_z, n_y, n_x] = shape.as_slice() else {
        return Err(fault("samples", format!("has the shape {shape:?}; three axes [z, y, x] were expected")));
    };
    let given = if npz.contains("pitch") { npz.f64("pitch")?.data } else { Vec::new() };
    let mut axes = Vec::new();
    for (place, (name, count)) in [("x", n_x), ("y", n_y), ("z", n_z)].into_iter().enumerate() {
        let positions = npz.f64(name)?;
        if positions.shape != [count] {
            let found = positions.shape;
            let problem = format!("has the shape {found:?}; [{count}], as of `samples`, was expected");
            return Err(fault(name, problem));
        }
        axes.push(axis(&positions.data, given.get(place).copied()).map_err(|problem| fault(name, problem))?);
    }
    let longer = axes.iter().find(|axis| axis.count > 1).map_or(1.0, |axis| axis.pitch);
    for axis in &mut axes {
        if axis.pitch == 0.0 {
            axis.pitch = longer;
        }
    }
    let grid = Grid { x: axes[0], y: axes[1], z: axes[2] };
    let samples = npz.complex("samples")?.data;
    let meta = if npz.contains("meta") {
        let text = npz.text("meta")?;
        serde_json::from_str(&text)
            .ok()
            .filter(Value::is_object)
            .ok_or_else(|| fault("meta", "is not a JSON object; `{...}` was expected".into()))?
    } else {
        Value::Object(serde_json::Map::new())
    };
    Ok((Volume::new(grid, samples), meta))
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

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::super::tests::volume;
    use super::*;
    use crate::files::npz::write_npz;
    use crate::named::assert_names;
    use num_complex::Complex32;

    #[test]
    fn a_volume_is_read_as_it_was_written() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("volume.npz");
        let meta = serde_json::json!({"sound_speed": 343.0, "note": "ü"});
        for depths in [1, 5] {
            write_volume_npz(&path, &volume(depths), &meta).unwrap();
            assert_eq!(read_volume_npz(&path, 1 << 20).unwrap(), (volume(depths), meta.clone()));
        }
    }

    #[test]
    fn wrong_axes_are_named() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("volume.npz");
        for (y, z, words) in [
            (vec![0.0, 0.1, 0.21], vec![1.0], &["array `y`", "element 1"][..]),
            (vec![0.2, 0.1, 0.0], vec![1.0], &["array `y`", "0.2"]),
            (vec![0.0, 0.1], vec![1.0], &["array `y`", "[2]", "[3]"]),
            (vec![0.0, 0.1, 0.2], vec![f64::NAN], &["array `z`", "finite"]),
        ] {
            write_npz(&path, |npz| {
                npz.complex("samples", &[1, 3, 1], &[Complex32::ZERO; 3])?;
                npz.f64("x", &[1], &[0.0])?;
                npz.f64("y", &[y.len()], &y)?;
                npz.f64("z", &[1], &z)
            })
            .unwrap();
            let error = read_volume_npz(&path, 1 << 20).unwrap_err().to_string();
            assert_names(&error, &["volume.npz"]);
            assert_names(error, words);
        }
    }

    #[test]
    fn meta_may_be_missing_and_short_axes_take_the_pitch_of_a_longer_one() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("volume.npz");
        write_npz(&path, |npz| {
            npz.complex("samples", &[1, 1, 3], &[Complex32::ONE; 3])?;
            npz.f64("x", &[3], &[0.0, 0.25, 0.5])?;
            npz.f64("y", &[1], &[0.0])?;
            npz.f64("z", &[1], &[2.0])
        })
        .unwrap();
        let (volume, meta) = read_volume_npz(&path, 1 << 20).unwrap();
        assert_eq!(volume.grid.z, Axis { first: 2.0, pitch: 0.25, count: 1 });
        assert_eq!(meta, serde_json::json!({}));
    }
}
