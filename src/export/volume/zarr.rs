//! Volumes as Zarr stores, version 3: complex samples, amplitude, axes and metadata, and a pyramid of amplitudes for viewers.
//!
//! The arrays are those of the npz, each in shards that are whole slabs of depths, so that a store is written depth by depth.
//! The group also follows OME-NGFF 0.5 (ngff.openmicroscopy.org/0.5): its image is `amplitude`, and each further level
//! holds the maxima of two by two by two voxels of the one before, so that no echo fades from afar.

mod shards;

pub(crate) use shards::VolumeShards;

use super::reading::{read_arrays, read_grid, read_meta};
use super::{VolumeFile, VolumeStream};
use crate::alloc::try_with_capacity;
use crate::error::Result;
use crate::export::amplitude::Amplitude;
use crate::export::{Attributes, Components, Compression};
use crate::files::arrays::{ArrayFile, fault};
use crate::files::zarr::{
    ArraySpec, EncodedShards, MARK, META, ShardLayout, ZarrWriter, write_group, write_small,
};
use crate::grid::{Axis, Grid, VolumeView, no_room_for};
use num_complex::Complex32;
use serde_json::{Value, json};
use shards::{LevelArray, amplitude};
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
    let mut file = stream_volume_zarr(path, &volume.grid, components, meta, compression, None)?;
    file.take(volume.samples)?;
    file.finish()
}

/// The same depth by depth; what shards there are of `encoded`, by the numbers of [`VolumeShards`], are not encoded again.
///
/// # Errors
/// As [`write_volume_zarr`].
pub(crate) fn stream_volume_zarr<'a>(
    path: &Path,
    grid: &Grid,
    components: Components,
    meta: &Value,
    compression: Compression,
    encoded: Option<&'a dyn EncodedShards>,
) -> Result<VolumeFile<'a>> {
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
        let shards = VolumeShards::new(grid, components, compression);
        let encoded = |array| encoded.map(|encoded| (encoded, shards.of(array)));
        let mut samples = None;
        if components == Components::Complex {
            let spec = spec("complex amplitude", zip);
            let mut array = ZarrWriter::create::<Complex32>(&folder.join("samples"), &grid.shape(), &spec)?;
            array.take_from(encoded(LevelArray::Samples));
            samples = Some(array);
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
        let mut levels = levels.collect::<io::Result<Vec<_>>>()?;
        levels[0].array.take_from(encoded(LevelArray::Amplitude));
        Ok(ZarrVolume { samples, levels })
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
struct Level<'a> {
    array: ZarrWriter<'a>,
    /// Voxels of a plane along y and x, and whether this level's planes, rows and columns are halved in the next.
    plane: [usize; 2],
    halves: [bool; 3],
    /// Half of the next level's plane, until the other half comes.
    waiting: Option<Vec<f32>>,
    /// Planes that are still to come.
    left: usize,
}

impl Level<'_> {
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
struct ZarrVolume<'a> {
    samples: Option<ZarrWriter<'a>>,
    levels: Vec<Level<'a>>,
}

impl VolumeStream for ZarrVolume<'_> {
    fn planes(&mut self, planes: &[Complex32]) -> io::Result<()> {
        if let Some(samples) = &mut self.samples {
            samples.append(planes)?;
        }
        let [rows, columns] = self.levels[0].plane;
        for plane in planes.chunks_exact(rows * columns) {
            let mut plane = amplitude(plane);
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
mod tests;
