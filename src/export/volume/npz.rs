//! Volumes as `NumPy` archives: complex samples, axes and metadata.

use super::reading::read_arrays;
use super::{VolumeFile, VolumeStream};
use crate::error::Result;
use crate::files::arrays::ArrayFile;
use crate::files::npz::{NpzReader, NpzWriter};
use crate::grid::{Grid, Volume};
use num_complex::Complex32;
use serde_json::Value;
use std::fs::File;
use std::io::{self, BufWriter};
use std::path::Path;

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
pub(crate) fn stream_volume_npz(path: &Path, grid: Grid, meta: &Value) -> Result<VolumeFile<'static>> {
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

/// Reads a volume of at most `limit_bytes`, and its `meta` (an empty object if the file has none), from an npz.
///
/// # Errors
/// As [`read_volume`](crate::export::read_volume).
pub fn read_volume_npz(path: &Path, limit_bytes: u64) -> Result<(Volume, Value)> {
    read_arrays(path, &mut ArrayFile::Npz(Box::new(NpzReader::open(path, limit_bytes)?)))
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::super::tests::volume;
    use super::*;
    use crate::files::npz::write_npz;
    use crate::grid::Axis;
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
