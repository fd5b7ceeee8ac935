//! Volumes as `OpenEXR`: a maximum projection, and one part per depth.
//!
//! Part 0, `mip`, is what every viewer shows: the maximum amplitude along z and its depth. The depths follow as `z0000`,
//! `z0001`, ... Many parts make readers slow, so a deep volume is split into several files.

use super::Component;
use crate::alloc::try_with_capacity;
use crate::error::{Error, Result};
use crate::export::amplitude::{Amplitude, declared_grid, vector};
use crate::export::exr_file::{
    ExrParts, OutputPart, Pixels, WORLD_TO_CAMERA, append_floats, attributes_of, channel_of, read_parts,
    write_parts, writing_bytes as part_bytes,
};
use crate::export::{Attribute, Attributes, Components, Encoding};
use crate::grid::{Grid, VolumeView, no_room_for, pixel_values};
use exr::prelude::FlatSamples;
use std::path::{Path, PathBuf};

/// Maximum number of depths in one file.
pub(crate) const DEPTHS_PER_FILE: usize = 512;

/// The files that [`write_volume_exr`] writes for `depths` depths: `path`, then `NAME.0512.exr` and so on, named after
/// the index of the file's first depth.
pub(crate) fn volume_exr_files(path: &Path, depths: usize) -> Vec<PathBuf> {
    (0..depths.max(1))
        .step_by(DEPTHS_PER_FILE)
        .map(|first| if first == 0 { path.to_path_buf() } else { numbered(path, first) })
        .collect()
}

fn numbered(path: &Path, first: usize) -> PathBuf {
    let mut name = path.file_stem().unwrap_or_default().to_os_string();
    name.push(format!(".{first:04}"));
    if let Some(extension) = path.extension() {
        name.push(".");
        name.push(extension);
    }
    path.with_file_name(name)
}

/// Writes a volume and returns the files written: `path`, and for every further 512 depths `NAME.0512.exr` and so on.
///
/// - Part `mip`, the same in every file: `R`, `G`, `B` = `max_z |Â|`, `Z` = its depth in m, `A` = 1, and the
///   `attributes`.
/// - Part `z0000`, ... : `Y` = `|Â|`, on request `re` and `im`, and the depth in m as `sonar:depth`.
/// - Every part: `sonar:gridOrigin` (first voxel, m), `sonar:gridPitch` (m), `sonar:gridShape`, each along x, y, z.
///
/// # Errors
/// As `crate::files::write_atomically`; more pixels in a plane than an EXR image can have.
///
/// # Panics
/// If an attribute's name does not start with `sonar:`.
pub fn write_volume_exr<'v>(
    path: &Path,
    volume: impl Into<VolumeView<'v>>,
    components: Components,
    attributes: &[(String, Attribute)],
    encoding: Encoding,
) -> Result<Vec<PathBuf>> {
    let volume = volume.into();
    let grid = &volume.grid;
    let files = volume_exr_files(path, grid.z.count);
    let mut parts = vec![mip_part(volume, attributes, encoding)?];
    for (file, first) in files.iter().zip((0..).step_by(DEPTHS_PER_FILE)) {
        let last = (first + DEPTHS_PER_FILE).min(grid.z.count);
        parts.truncate(1);
        parts.extend((first..last).map(|iz| depth_part(volume, iz, components, encoding)));
        write_parts(file, &parts)?;
    }
    Ok(files)
}

/// Bytes that [`write_volume_exr`] takes in addition to the volume.
pub(crate) fn writing_bytes(grid: &Grid, components: Components) -> u64 {
    // The projection has five channels, a part of a depth has its components.
    const PROJECTION: u64 = 5 * size_of::<f32>() as u64;
    let pixel = PROJECTION.max((components.list().len() * size_of::<f32>()) as u64);
    let row = pixel.saturating_mul(grid.x.count as u64);
    let projection = PROJECTION.saturating_mul(grid.x.count as u64).saturating_mul(grid.y.count as u64);
    projection.saturating_add(part_bytes(grid.z.count.min(DEPTHS_PER_FILE) + 1, row))
}

fn mip_part(
    volume: VolumeView<'_>,
    attributes: &[(String, Attribute)],
    encoding: Encoding,
) -> Result<OutputPart<'static>> {
    let grid = &volume.grid;
    let pixels = grid.plane_len();
    let mut power = pixel_values(0.0_f32, pixels)?;
    let mut depth = pixel_values(grid.z.first as f32, pixels)?;
    for iz in 0..grid.z.count {
        let z = grid.z.position(iz) as f32;
        for ((sample, power), depth) in volume.plane(iz).iter().zip(&mut power).zip(&mut depth) {
            if sample.norm_sqr() > *power {
                (*power, *depth) = (sample.norm_sqr(), z);
            }
        }
    }
    let amplitude: Vec<f32> = power.into_iter().map(f32::sqrt).collect();
    let mut channels = vec![("Z".into(), depth), ("A".into(), pixel_values(1.0, pixels)?)];
    for name in ["R", "G"] {
        let mut copy = pixel_values(0.0, pixels)?;
        copy.copy_from_slice(&amplitude);
        channels.push((name.into(), copy));
    }
    channels.push(("B".into(), amplitude));
    let mut attributes = attributes.to_vec();
    attributes.extend(grid_attributes(grid));
    let channels = channels.into_iter().map(|(name, values)| (name, Pixels::Held(values))).collect();
    let mut part =
        OutputPart::new(Some("mip"), [grid.x.count, grid.y.count], channels, &attributes, encoding);
    part.attributes().world_to_camera = Some(WORLD_TO_CAMERA);
    Ok(part)
}

/// The part of one depth, whose pixels are made as they are written.
fn depth_part(
    volume: VolumeView<'_>,
    iz: usize,
    components: Components,
    encoding: Encoding,
) -> OutputPart<'_> {
    let (grid, plane) = (&volume.grid, volume.plane(iz));
    let channel = |(name, component): &(&str, Component)| {
        let name = if *name == "amplitude" { "Y" } else { name };
        (name.to_owned(), Pixels::Of(plane, *component))
    };
    let channels = components.list().iter().map(channel).collect();
    let mut attributes = grid_attributes(grid);
    attributes.push(("sonar:depth".into(), Attribute::Number(grid.z.position(iz))));
    OutputPart::new(Some(&format!("z{iz:04}")), [grid.x.count, grid.y.count], channels, &attributes, encoding)
}

/// First voxel, pitch and number of voxels, along x, y, z.
pub(super) fn grid_attributes(grid: &Grid) -> Attributes {
    let axes = [grid.x, grid.y, grid.z];
    vec![
        ("sonar:gridOrigin".into(), Attribute::Vector(axes.map(|axis| axis.first))),
        ("sonar:gridPitch".into(), Attribute::Vector(axes.map(|axis| axis.pitch))),
        ("sonar:gridShape".into(), Attribute::Vector(axes.map(|axis| axis.count as f64))),
    ]
}

/// Reads the amplitude of a volume written by this program from `path` and its further files.
///
/// # Errors
/// A missing or damaged file, one that is not a volume, or one that takes more memory than `limit_bytes`.
pub fn read_volume_exr(path: &Path, limit_bytes: u64) -> Result<Amplitude> {
    let fault = |path: &Path| {
        Error::input(
            path.display(),
            "is not a volume of this program: a part `mip` and one part per depth were expected",
        )
    };
    let mut parts = read_parts(path, limit_bytes, |_| 0)?;
    let first = parts.layer_data.first().ok_or_else(|| fault(path))?;
    let attributes = attributes_of(&first.attributes);
    let [origin, pitch, shape] =
        ["Origin", "Pitch", "Shape"].map(|what| vector(&attributes, &format!("sonar:grid{what}")));
    let (Some(origin), Some(pitch), Some(shape)) = (origin, pitch, shape) else { return Err(fault(path)) };
    let grid = declared_grid(path, origin, pitch, shape.map(|n| n as usize), 4, limit_bytes)?;
    // The limit is for the amplitudes and one file's parts together.
    let left = limit_bytes - 4 * grid.voxel_count();
    if bytes_of(&parts) > left {
        let needed = bytes_of(&parts) + 4 * grid.voxel_count();
        let problem = format!(
            "takes {needed} bytes of memory to read, more than the limit of {limit_bytes}; raise the limit (--memory)"
        );
        return Err(Error::input(path.display(), problem));
    }
    let mut values = try_with_capacity(grid.voxel_count()).ok_or_else(|| no_room_for(&grid))?;
    for (i, file) in volume_exr_files(path, grid.z.count).iter().enumerate() {
        if i > 0 {
            drop(parts);
            parts = read_parts(file, left, |_| 0)?;
        }
        append_depths(&parts, grid.plane_len(), &mut values).ok_or_else(|| fault(file))?;
    }
    if values.len() as u64 == grid.voxel_count() {
        Ok(Amplitude { grid, values, attributes })
    } else {
        Err(fault(path))
    }
}

/// Bytes of all samples.
fn bytes_of(parts: &ExrParts) -> u64 {
    let channels = parts.layer_data.iter().flat_map(|part| &part.channel_data.list);
    channels
        .map(|channel| match &channel.sample_data {
            FlatSamples::F16(samples) => size_of_val(samples.as_slice()) as u64,
            FlatSamples::F32(samples) => size_of_val(samples.as_slice()) as u64,
            FlatSamples::U32(samples) => size_of_val(samples.as_slice()) as u64,
        })
        .sum()
}

/// Appends the channel `Y` of every depth in a file; `None` if one has another number of pixels.
fn append_depths(parts: &ExrParts, pixels: usize, values: &mut Vec<f32>) -> Option<()> {
    for part in parts.layer_data.iter().skip(1) {
        let channel = channel_of(part, "Y")?;
        // The capacity is that of the declared grid; further depths are an error.
        if channel.sample_data.len() != pixels || values.len() + pixels > values.capacity() {
            return None;
        }
        append_floats(&channel.sample_data, values)?;
    }
    Some(())
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::super::tests::volume;
    use super::*;

    #[test]
    fn every_depth_is_a_part_with_its_depth() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("volume.exr");
        let volume = volume(4);
        let attributes = vec![("sonar:soundSpeed".to_owned(), Attribute::Number(343.0))];
        let files =
            write_volume_exr(&path, &volume, Components::Complex, &attributes, Encoding::default()).unwrap();
        assert_eq!(files, [path.as_path()]);
        let first_bytes = std::fs::read(&path).unwrap();
        let parts = read_parts(&path, 1 << 20, |_| 0).unwrap().layer_data;
        let names: Vec<_> =
            parts.iter().map(|p| p.attributes.layer_name.as_ref().unwrap().to_string()).collect();
        assert_eq!(names, ["mip", "z0000", "z0001", "z0002", "z0003"]);
        assert!(attributes_of(&parts[0].attributes).contains(&attributes[0]));
        let depth = ("sonar:depth".to_owned(), Attribute::Number(volume.grid.z.position(2)));
        assert!(attributes_of(&parts[3].attributes).contains(&depth));
        let samples = |part: usize, name: &str| -> Vec<f32> {
            let FlatSamples::F32(samples) = &channel_of(&parts[part], name).unwrap().sample_data else {
                panic!("32-bit floats")
            };
            samples.clone()
        };
        for (i, sample) in volume.plane(2).iter().enumerate() {
            assert_eq!(samples(3, "Y")[i], sample.norm());
            assert_eq!((samples(3, "re")[i], samples(3, "im")[i]), (sample.re, sample.im));
        }
        assert_eq!(samples(0, "Z"), [volume.grid.z.last() as f32; 6], "the samples grow with depth");
        assert_eq!(samples(0, "A"), [1.0; 6]);
        write_volume_exr(&path, &volume, Components::Complex, &attributes, Encoding::default()).unwrap();
        assert!(first_bytes == std::fs::read(&path).unwrap(), "results are bit-identical");
    }

    #[test]
    fn a_deep_volume_takes_several_files() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("volume.exr");
        let files =
            write_volume_exr(&path, &volume(514), Components::Amplitude, &[], Encoding::default()).unwrap();
        assert_eq!(files, [path.clone(), folder.path().join("volume.0512.exr")]);
        let parts = read_parts(&files[1], 1 << 20, |_| 0).unwrap().layer_data;
        assert_eq!(parts.len(), 3);
        assert_eq!(parts[2].attributes.layer_name.as_ref().unwrap().to_string(), "z0513");
    }
}
