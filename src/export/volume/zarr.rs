//! Volumes as Zarr stores, version 3: complex samples, amplitude, axes and metadata, and a pyramid of amplitudes for viewers.
//!
//! The arrays are those of the npz, each in shards that are whole slabs of depths, so that a store is written depth by depth.
//! The group also follows OME-NGFF 0.5 (ngff.openmicroscopy.org/0.5): its image is `amplitude`, and each further level
//! holds the maxima of two by two by two voxels of the one before, so that no echo fades from afar.

use super::reading::{read_arrays, read_grid, read_meta};
use super::{VolumeFile, VolumeStream};
use crate::alloc::try_with_capacity;
use crate::error::Result;
use crate::export::amplitude::Amplitude;
use crate::export::{Attributes, Components, Compression};
use crate::files::arrays::{ArrayFile, fault};
use crate::files::zarr::{ArraySpec, MARK, META, ShardLayout, ZarrWriter, write_group, write_small};
use crate::grid::{Axis, Grid, VolumeView, no_room_for};
use num_complex::Complex32;
use serde_json::{Value, json};
use std::io;
use std::path::Path;

/// The axes of every array of voxels.
const AXES: [&str; 3] = ["z", "y", "x"];

/// Voxels along each axis of a level after which there is no further one.
const SMALLEST: usize = 64;

/// Writes `amplitude` float32 and, if they are asked for, `samples` complex64, `[z, y, x]`; `x`, `y`, `z` in m; `pitch` `[3]`,
/// in m along x, y, z; `meta` as an attribute; and from `levels/1` on smaller amplitudes. The same volume gives the same
/// bytes, for any number of threads.
///
/// # Errors
/// [`Error::InvalidInput`](crate::error::Error::InvalidInput) if there is something at `path` other than a store of this
/// program; [`Error::Io`](crate::error::Error::Io) if it cannot be written; an existing store is then unchanged.
pub fn write_volume_zarr<'v>(
    path: &Path,
    volume: impl Into<VolumeView<'v>>,
    components: Components,
    meta: &Value,
    compression: Compression,
) -> Result<()> {
    let volume = volume.into();
    let mut file = stream_volume_zarr(path, &volume.grid, components, meta, compression)?;
    file.take(volume.samples)?;
    file.finish()
}

/// The same depth by depth.
///
/// # Errors
/// As [`write_volume_zarr`].
pub(crate) fn stream_volume_zarr(
    path: &Path,
    grid: &Grid,
    components: Components,
    meta: &Value,
    compression: Compression,
) -> Result<VolumeFile> {
    VolumeFile::create_store(path, |folder| {
        let zip = compression == Compression::Zip;
        let levels = levels(grid);
        write_group(
            folder,
            &json!({ MARK: { "store": "volume", "version": 1 }, "ome": ome(&levels), META: meta }),
        )?;
        if levels.len() > 1 {
            write_group(&folder.join("levels"), &json!({}))?;
        }
        let mut samples = None;
        if components == Components::Complex {
            let spec = spec("complex amplitude", zip);
            samples = Some(ZarrWriter::create::<Complex32>(&folder.join("samples"), &grid.shape(), &spec)?);
        }
        let pitch = [grid.x.pitch, grid.y.pitch, grid.z.pitch];
        let attributes = json!({ "units": "m", "long_name": "pitch of the voxels" });
        write_small(
            &folder.join("pitch"),
            &[3],
            &pitch,
            &ArraySpec { dimensions: &["xyz"], attributes, zip: false },
        )?;
        let levels = levels.iter().enumerate().map(|(k, grid)| Level::create(folder, k, grid, zip));
        Ok(ZarrVolume { samples, levels: levels.collect::<io::Result<_>>()? })
    })
}

/// Bytes that writing a volume of this grid takes besides the volume itself.
pub(crate) fn writing_bytes(grid: &Grid, components: Components) -> u64 {
    let samples = if components == Components::Complex {
        ShardLayout::new(&grid.shape(), 8).writing_bytes(8)
    } else {
        0
    };
    let of_level =
        |grid: &Grid| ShardLayout::new(&grid.shape(), 4).writing_bytes(4) + 8 * grid.plane_len() as u64;
    samples + levels(grid).iter().map(of_level).sum::<u64>()
}

/// Reads the amplitude of a store, of at most `limit_bytes`, and its `meta`: `amplitude`, or that of `samples` if there is none.
///
/// # Errors
/// As [`read_volume`](crate::export::read_volume).
pub(crate) fn read_amplitude_zarr(path: &Path, limit_bytes: u64) -> Result<(Amplitude, Value)> {
    const ARRAY: &str = "amplitude";
    let mut arrays = ArrayFile::open(path, limit_bytes)?;
    if !arrays.contains(ARRAY) || arrays.contains("frequencies") {
        let (volume, meta) = read_arrays(path, &mut arrays)?;
        return Ok((Amplitude::of(&volume)?, meta));
    }
    let grid = read_grid(path, &mut arrays, ARRAY)?;
    let count = grid.voxel_count();
    if count.saturating_mul(4) > limit_bytes {
        let problem = format!("has {count} voxels of 4 bytes, more than the limit of {limit_bytes} bytes");
        return Err(fault(path, ARRAY, problem));
    }
    let mut values = try_with_capacity(count).ok_or_else(|| no_room_for(&grid))?;
    arrays.complex_blocks(ARRAY, 1 << 16, |block| {
        values.extend(block.iter().map(|value| value.re));
        Ok(())
    })?;
    Ok((Amplitude { grid, values, attributes: Attributes::new() }, read_meta(path, &mut arrays)?))
}

fn spec(name: &str, zip: bool) -> ArraySpec<'static> {
    ArraySpec { dimensions: &AXES, attributes: json!({ "long_name": name, "units": "1" }), zip }
}

/// The grids of the levels, the whole one first.
fn levels(grid: &Grid) -> Vec<Grid> {
    let mut levels = vec![*grid];
    while let Some(next) = levels.last().filter(|grid| grid.shape().iter().any(|&n| n > SMALLEST)).map(halved)
    {
        levels.push(next);
    }
    levels
}

/// The grid whose voxels are two by two by two of another, each in their middle; the last of an odd number is as large as the
/// others, and half empty.
fn halved(grid: &Grid) -> Grid {
    let half = |axis: Axis| match axis.count {
        1 => axis,
        count => {
            Axis { first: axis.first + axis.pitch / 2.0, pitch: axis.pitch * 2.0, count: count.div_ceil(2) }
        }
    };
    Grid { x: half(grid.x), y: half(grid.y), z: half(grid.z) }
}

/// The folder of a level below that of the store, and its array.
fn path_of(level: usize) -> String {
    if level == 0 { "amplitude".to_owned() } else { format!("levels/{level}/amplitude") }
}

/// What OME-NGFF asks of a group that is an image.
fn ome(levels: &[Grid]) -> Value {
    let axis = |name: &str| json!({ "name": name, "type": "space", "unit": "meter" });
    let dataset = |(k, Grid { x, y, z }): (usize, &Grid)| {
        json!({
            "path": path_of(k),
            "coordinateTransformations": [
                { "type": "scale", "scale": [z.pitch, y.pitch, x.pitch] },
                { "type": "translation", "translation": [z.first, y.first, x.first] },
            ],
        })
    };
    json!({
        "version": "0.5",
        "multiscales": [{
            "name": "amplitude",
            "axes": AXES.map(axis),
            "datasets": levels.iter().enumerate().map(dataset).collect::<Vec<_>>(),
            "type": "maximum",
        }],
    })
}

/// A level of the pyramid that is being written.
struct Level {
    array: ZarrWriter,
    /// Voxels of a plane along y and x, and whether this level's planes, rows and columns are halved in the next.
    plane: [usize; 2],
    halves: [bool; 3],
    /// Half of the next level's plane, until the other half comes.
    waiting: Option<Vec<f32>>,
    /// Planes that are still to come.
    left: usize,
}

impl Level {
    fn create(store: &Path, level: usize, grid: &Grid, zip: bool) -> io::Result<Self> {
        let array = store.join(path_of(level));
        let folder = array.parent().unwrap_or(store);
        if level > 0 {
            write_group(folder, &json!({}))?;
        }
        for (name, axis) in AXES.into_iter().zip([grid.z, grid.y, grid.x]) {
            let positions: Vec<f64> = axis.positions().collect();
            let attributes = json!({ "units": "m", "axis": name.to_uppercase() });
            let spec = ArraySpec { dimensions: &[name], attributes, zip: false };
            write_small(&folder.join(name), &[axis.count], &positions, &spec)?;
        }
        let shape = grid.shape();
        let array = ZarrWriter::create::<f32>(&array, &shape, &spec("amplitude", zip))?;
        let [depths, rows, columns] = shape;
        Ok(Self { array, plane: [rows, columns], halves: shape.map(|n| n > 1), waiting: None, left: depths })
    }

    /// Writes a plane; returns one of the next level when it is complete.
    fn take(&mut self, plane: &[f32]) -> io::Result<Option<Vec<f32>>> {
        self.array.append(plane)?;
        self.left -= 1;
        let mut maxima = maxima(plane, self.plane, [self.halves[1], self.halves[2]]);
        if let Some(before) = self.waiting.take() {
            maxima.iter_mut().zip(before).for_each(|(now, before)| *now = now.max(before));
        } else if self.halves[0] && self.left > 0 {
            self.waiting = Some(maxima);
            return Ok(None);
        }
        Ok(Some(maxima))
    }
}

/// The maxima of two by two pixels, or of two where a direction is not halved.
fn maxima(plane: &[f32], [rows, columns]: [usize; 2], [down, across]: [bool; 2]) -> Vec<f32> {
    let [tall, wide] = [down, across].map(|halved| if halved { 2 } else { 1 });
    let mut out = Vec::with_capacity(rows.div_ceil(tall) * columns.div_ceil(wide));
    for pair in plane.chunks(tall * columns) {
        let mut row = pair[..columns].to_vec();
        if let Some(second) = pair.get(columns..).filter(|second| !second.is_empty()) {
            row.iter_mut().zip(second).for_each(|(a, b)| *a = a.max(*b));
        }
        out.extend(row.chunks(wide).map(|two| two.iter().copied().fold(two[0], f32::max)));
    }
    out
}

/// A volume that is being written.
struct ZarrVolume {
    samples: Option<ZarrWriter>,
    levels: Vec<Level>,
}

impl VolumeStream for ZarrVolume {
    fn planes(&mut self, planes: &[Complex32]) -> io::Result<()> {
        if let Some(samples) = &mut self.samples {
            samples.append(planes)?;
        }
        let [rows, columns] = self.levels[0].plane;
        for plane in planes.chunks_exact(rows * columns) {
            let mut plane: Vec<f32> = plane.iter().map(|sample| sample.norm()).collect();
            for level in &mut self.levels {
                let Some(next) = level.take(&plane)? else { break };
                plane = next;
            }
        }
        Ok(())
    }

    fn finish(self: Box<Self>) -> io::Result<()> {
        self.samples.into_iter().for_each(ZarrWriter::finish);
        self.levels.into_iter().for_each(|level| level.array.finish());
        Ok(())
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;
    use crate::export::read_volume;
    use crate::grid::Volume;
    use std::collections::BTreeMap;
    use std::fs;

    /// A volume of several shards and levels, with no two voxels alike.
    fn volume() -> Volume {
        let axis = |first, count| Axis { first, pitch: 0.01, count };
        let grid = Grid { x: axis(-0.3, 131), y: axis(0.1, 5), z: axis(1.0, 67) };
        let value = |i: usize| Complex32::from_polar(((i * 7919) % 104_729) as f32, i as f32);
        Volume::new(grid, (0..131 * 5 * 67).map(value).collect())
    }

    fn written(path: &Path, volume: &Volume, components: Components, compression: Compression) {
        let meta = json!({ "sound_speed": 343.25, "note": "ü" });
        write_volume_zarr(path, volume, components, &meta, compression).unwrap();
    }

    /// All files of a store.
    fn files(folder: &Path) -> BTreeMap<String, Vec<u8>> {
        let mut all = BTreeMap::new();
        let mut folders = vec![folder.to_owned()];
        while let Some(next) = folders.pop() {
            for entry in fs::read_dir(next).unwrap() {
                let path = entry.unwrap().path();
                if path.is_dir() {
                    folders.push(path);
                } else {
                    let name = path.strip_prefix(folder).unwrap().display().to_string();
                    all.insert(name, fs::read(&path).unwrap());
                }
            }
        }
        all
    }

    #[test]
    fn a_volume_is_read_as_it_was_written() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("volume.zarr");
        let volume = volume();
        for compression in [Compression::Zip, Compression::None] {
            written(&path, &volume, Components::Complex, compression);
            let (found, meta) = read_volume(&path, 1 << 24).unwrap();
            assert!(found == volume && meta == json!({ "sound_speed": 343.25, "note": "ü" }));
            assert!(Amplitude::read(&path, 1 << 24).unwrap() == Amplitude::of(&volume).unwrap());
        }
        written(&path, &volume, Components::Amplitude, Compression::Zip);
        assert!(Amplitude::read(&path, 1 << 24).unwrap() == Amplitude::of(&volume).unwrap());
        let error = read_volume(&path, 1 << 24).unwrap_err().to_string();
        assert!(error.contains("output.components=complex"), "{error}");
        let error = Amplitude::read(&path, 1000).unwrap_err();
        assert_eq!(error.exit_status(), 2, "{error}");
    }

    #[test]
    fn bytes_depend_neither_on_threads_nor_on_how_planes_come() {
        let folder = tempfile::tempdir().unwrap();
        let volume = volume();
        let write = |name: &str, threads: usize, planes: usize| {
            let path = folder.path().join(name);
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| {
                let meta = json!({});
                let mut file =
                    stream_volume_zarr(&path, &volume.grid, Components::Complex, &meta, Compression::Zip)
                        .unwrap();
                volume.samples.chunks(planes * volume.grid.plane_len()).for_each(|p| file.take(p).unwrap());
                file.finish().unwrap();
            });
            files(&path)
        };
        let all = write("a.zarr", 1, 67);
        assert_eq!(all.keys().filter(|name| name.starts_with("samples/c/")).count(), 3, "{:?}", all.keys());
        assert!(all == write("b.zarr", 4, 1));
        assert!(all == write("c.zarr", 2, 10));
    }

    #[test]
    fn each_level_holds_the_maxima_of_the_one_before() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("volume.zarr");
        let volume = volume();
        written(&path, &volume, Components::Amplitude, Compression::None);
        let mut before = Amplitude::of(&volume).unwrap();
        let expected = levels(&volume.grid);
        assert_eq!(
            expected.iter().map(Grid::shape).collect::<Vec<_>>(),
            [[67, 5, 131], [34, 3, 66], [17, 2, 33]]
        );
        for (k, grid) in expected.iter().enumerate().skip(1) {
            // A level is a group that is opened by itself.
            let level = Amplitude::read(&rename(&path, k), 1 << 24).unwrap();
            let close = |a: &Axis, b: &Axis| a.count == b.count && (a.first - b.first).abs() < 1e-12;
            assert!(close(&level.grid.x, &grid.x) && close(&level.grid.z, &grid.z));
            // The literal definition.
            let shape = before.grid.shape();
            let mut maxima = vec![0.0_f32; grid.voxel_count() as usize];
            for (i, value) in before.values.iter().enumerate() {
                let [z, y, x] = [i / (shape[1] * shape[2]), i / shape[2] % shape[1], i % shape[2]];
                let at = (z / 2 * grid.y.count + y / 2) * grid.x.count + x / 2;
                maxima[at] = maxima[at].max(*value);
            }
            assert!(level.values == maxima, "level {k}");
            before = level;
        }
    }

    /// A level under a name by which it is recognised.
    fn rename(store: &Path, level: usize) -> std::path::PathBuf {
        let path = store.with_file_name(format!("level{level}.zarr"));
        fs::rename(store.join(format!("levels/{level}")), &path).unwrap();
        path
    }

    #[test]
    fn an_axis_of_one_voxel_is_never_halved() {
        let axis = |count| Axis { first: 0.0, pitch: 0.5, count };
        let grid = Grid { x: axis(200), y: axis(1), z: axis(2) };
        let all = levels(&grid);
        assert_eq!(all.iter().map(Grid::shape).collect::<Vec<_>>(), [[2, 1, 200], [1, 1, 100], [1, 1, 50]]);
        assert_eq!(all[2].y, axis(1));
        assert_eq!((all[2].z.first, all[2].x.first, all[2].x.pitch), (0.25, 0.75, 2.0));
        let ome = ome(&all);
        assert_eq!(ome["multiscales"][0]["datasets"][2]["path"], "levels/2/amplitude");
        assert_eq!(
            ome["multiscales"][0]["datasets"][1]["coordinateTransformations"][0]["scale"],
            json!([1.0, 0.5, 1.0])
        );
    }
}
