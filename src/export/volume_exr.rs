//! Volumes as `OpenEXR`: a picture, and one part per depth.
//!
//! Part 0, `mip`, is what any viewer shows: the greatest amplitude along z and the depth where it was. Then
//! come the depths, `z0000`, `z0001`, ... Parts cost time in every reader, so a deep volume becomes several files.

use super::amplitude::{Amplitude, declared_grid, vector};
use super::exr_file::{
    Part, Parts, WORLD_TO_CAMERA, append_floats, attributes_of, part, read_parts, write_parts,
};
use super::{Attribute, Attributes, Components, Encoding};
use crate::alloc::try_with_capacity;
use crate::error::{Error, Result};
use crate::grid::{Grid, Volume, no_room_for, pixel_values};
use num_complex::Complex32;
use std::path::{Path, PathBuf};

/// Most depths in one file.
pub(crate) const DEPTHS_PER_FILE: usize = 512;

/// The files that [`write_volume_exr`] makes for `depths` depths: `path` itself, then `NAME.0512.exr` and so on,
/// by the index of the file's first depth.
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

/// Writes a volume and returns the files written; see `volume_exr_files`.
///
/// - Part `mip`, the same in every file: `R`, `G`, `B` = `max_z |Â|`, `Z` = where it was in m, `A` = 1; it
///   carries `attributes`.
/// - Part `z0000`, ... : `Y` = `|Â|`, on request `re` and `im`, and the depth in m as `sonar:depth`.
/// - Every part: `sonar:gridOrigin` (first voxel, m), `sonar:gridPitch` (m), `sonar:gridShape`, each along x, y, z.
///
/// # Errors
/// As `crate::files::write_atomically`; more pixels in a plane than an EXR image can have.
///
/// # Panics
/// When an attribute's name does not start with `sonar:`.
pub fn write_volume_exr(
    path: &Path,
    volume: &Volume,
    components: Components,
    attributes: &[(String, Attribute)],
    encoding: Encoding,
) -> Result<Vec<PathBuf>> {
    let grid = &volume.grid;
    let files = volume_exr_files(path, grid.z.count);
    let mip = mip_part(volume, attributes, encoding)?;
    for (file, first) in files.iter().zip((0..).step_by(DEPTHS_PER_FILE)) {
        let last = (first + DEPTHS_PER_FILE).min(grid.z.count);
        let mut parts = vec![mip.clone()];
        for iz in first..last {
            parts
                .push(depth_part(volume, iz, components, encoding).map_err(|_| no_room(file, last - first))?);
        }
        write_parts(file, parts)?;
    }
    Ok(files)
}

fn mip_part(volume: &Volume, attributes: &[(String, Attribute)], encoding: Encoding) -> Result<Part> {
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
    // In place.
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
    let mut part = part(Some("mip"), [grid.x.count, grid.y.count], channels, &attributes, encoding)?;
    part.attributes.world_to_camera = Some(WORLD_TO_CAMERA);
    Ok(part)
}

/// The refusal of a file whose depths, all of which its writer wants at once, do not fit.
fn no_room(path: &Path, depths: usize) -> Error {
    let problem = format!(
        "{depths} depths do not fit at once for {}; the formats npz, vti and nrrd are written depth by depth",
        path.display()
    );
    Error::out_of_memory(problem)
}

/// # Errors
/// When it does not fit in memory.
fn depth_part(volume: &Volume, iz: usize, components: Components, encoding: Encoding) -> Result<Part> {
    let grid = &volume.grid;
    let plane = volume.plane(iz);
    let channel = |value: fn(&Complex32) -> f32| {
        let mut channel = pixel_values(0.0, plane.len())?;
        channel.iter_mut().zip(plane).for_each(|(channel, sample)| *channel = value(sample));
        Ok(channel)
    };
    let mut channels = vec![("Y".into(), channel(|sample| sample.norm())?)];
    if components == Components::Complex {
        channels.push(("re".into(), channel(|sample| sample.re)?));
        channels.push(("im".into(), channel(|sample| sample.im)?));
    }
    let mut attributes = grid_attributes(grid);
    attributes.push(("sonar:depth".into(), Attribute::Number(grid.z.position(iz))));
    part(Some(&format!("z{iz:04}")), [grid.x.count, grid.y.count], channels, &attributes, encoding)
}

fn grid_attributes(grid: &Grid) -> Attributes {
    let axes = [grid.x, grid.y, grid.z];
    vec![
        ("sonar:gridOrigin".into(), Attribute::Vector(axes.map(|axis| axis.first))),
        ("sonar:gridPitch".into(), Attribute::Vector(axes.map(|axis| axis.pitch))),
        ("sonar:gridShape".into(), Attribute::Vector(axes.map(|axis| axis.count as f64))),
    ]
}

/// Reads the amplitude of a volume of ours from `path` and the files that continue it.
///
/// # Errors
/// A missing or damaged file, one that holds no volume, more pixels than `limit_bytes` hold.
pub fn read_volume_exr(path: &Path, limit_bytes: u64) -> Result<Amplitude> {
    let fault = |path: &Path| {
        Error::input(
            path.display(),
            "is no volume of this program: a part `mip` and one part per depth were expected",
        )
    };
    let mut parts = read_parts(path, limit_bytes)?;
    let first = parts.layer_data.first().ok_or_else(|| fault(path))?;
    let attributes = attributes_of(&first.attributes);
    let [origin, pitch, shape] =
        ["Origin", "Pitch", "Shape"].map(|what| vector(&attributes, &format!("sonar:grid{what}")));
    let (Some(origin), Some(pitch), Some(shape)) = (origin, pitch, shape) else { return Err(fault(path)) };
    let grid = declared_grid(path, origin, pitch, shape.map(|n| n as usize), 4, limit_bytes)?;
    let mut values = try_with_capacity(grid.voxel_count()).ok_or_else(|| no_room_for(&grid))?;
    for (i, file) in volume_exr_files(path, grid.z.count).iter().enumerate() {
        if i > 0 {
            parts = read_parts(file, limit_bytes)?;
        }
        append_depths(&parts, grid.plane_len(), &mut values).ok_or_else(|| fault(file))?;
    }
    if values.len() as u64 == grid.voxel_count() {
        Ok(Amplitude { grid, values, attributes })
    } else {
        Err(fault(path))
    }
}

/// The channel `Y` of every depth in a file; `None` if one has another number of pixels.
fn append_depths(parts: &Parts, pixels: usize, values: &mut Vec<f32>) -> Option<()> {
    for part in parts.layer_data.iter().skip(1) {
        let channel = part.channel_data.list.iter().find(|channel| channel.name.eq("Y"))?;
        // There is room for all that the grid declares, and no more is taken.
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
    use super::*;
    use crate::grid::Axis;
    use exr::prelude::FlatSamples;
    use num_complex::Complex32;

    fn volume(depths: usize) -> Volume {
        let grid = Grid {
            x: Axis { first: -0.1, pitch: 0.1, count: 3 },
            y: Axis { first: 0.0, pitch: 0.2, count: 2 },
            z: Axis { first: 1.0, pitch: 0.01, count: depths },
        };
        let samples = (0..6 * depths).map(|i| Complex32::new(i as f32, -(i as f32))).collect();
        Volume::new(grid, samples)
    }

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
        let parts = read_parts(&path, 1 << 20).unwrap().layer_data;
        let names: Vec<_> =
            parts.iter().map(|p| p.attributes.layer_name.as_ref().unwrap().to_string()).collect();
        assert_eq!(names, ["mip", "z0000", "z0001", "z0002", "z0003"]);
        assert!(attributes_of(&parts[0].attributes).contains(&attributes[0]));
        let depth = ("sonar:depth".to_owned(), Attribute::Number(volume.grid.z.position(2)));
        assert!(attributes_of(&parts[3].attributes).contains(&depth));
        let samples = |part: usize, name: &str| -> Vec<f32> {
            let channel = parts[part].channel_data.list.iter().find(|c| c.name.eq(name)).unwrap();
            let FlatSamples::F32(samples) = &channel.sample_data else { panic!("32-bit floats") };
            samples.clone()
        };
        for (i, sample) in volume.plane(2).iter().enumerate() {
            assert_eq!(samples(3, "Y")[i], sample.norm());
            assert_eq!((samples(3, "re")[i], samples(3, "im")[i]), (sample.re, sample.im));
        }
        assert_eq!(samples(0, "Z"), [volume.grid.z.last() as f32; 6], "the samples grow with depth");
        assert_eq!(samples(0, "A"), [1.0; 6]);
        write_volume_exr(&path, &volume, Components::Complex, &attributes, Encoding::default()).unwrap();
        assert!(first_bytes == std::fs::read(&path).unwrap(), "same input, same bytes");
    }

    #[test]
    fn a_deep_volume_takes_several_files() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("volume.exr");
        let files =
            write_volume_exr(&path, &volume(514), Components::Amplitude, &[], Encoding::default()).unwrap();
        assert_eq!(files, [path.clone(), folder.path().join("volume.0512.exr")]);
        let parts = read_parts(&files[1], 1 << 20).unwrap().layer_data;
        assert_eq!(parts.len(), 3);
        assert_eq!(parts[2].attributes.layer_name.as_ref().unwrap().to_string(), "z0513");
    }
}
