//! Depth maps and ground truth as `OpenEXR`: `depth.exr` and `truth.exr`.
//!
//! A single-part scanline file of 32-bit floats that every viewer can show: the amplitude as root `R`, `G`, `B`, the
//! planar depth in m as root `Z`, whether there is a return as root `A`; all else is in layers. [`read_depth_map`] reads
//! such a file, or one from another program with a channel `Z`.

use super::exr_file::{
    ExrPart, OutputPart, Pixels, WORLD_TO_CAMERA, attributes_of, channel_of, expect_room, floats, read_parts,
    write_parts,
};
use super::{Attribute, Attributes, Encoding, Fill, find_attribute};
use crate::error::{Error, Result};
use crate::grid::{Axis, DepthLayer, DepthMap, Raster, View};
use crate::text::quoted;
use exr::meta::header::Header;
use exr::prelude::Vec2;
use std::path::Path;

/// The channels of a normal in its layer `N`.
const NORMAL_AXES: [&str; 3] = ["X", "Y", "Z"];

/// Minimum depth in the `Z` of another program that means "no surface", m: programs write 1e10, 1e30 or the largest float.
const FOREIGN_NOTHING: f32 = 1e9;

/// A depth map read from a file.
#[derive(Debug, Clone, PartialEq)]
pub struct DepthFile {
    /// The map.
    pub map: DepthMap,
    /// The attributes of the file, sorted by name.
    pub attributes: Attributes,
    /// Whether the file contains the axes, in m or in slopes for a perspective view. If not, they count pixels, with
    /// pitch 1.
    pub axes_known: bool,
}

/// Writes a depth map or a ground truth.
///
/// - Root `R`, `G`, `B`: amplitude over `sonar:amplitudeScale`, 0 where there is no return; `A`: 1 or 0; `Z`: m.
/// - Layers: `range.V` in m; where the map has them `confidence.V` in dB, `error.V`, the standard error of `Z` in m,
///   `N.X`, `N.Y`, `N.Z`, the unit normal that faces the array, `facing.V` and `material.id`; for the k-th return
///   `return{k}.Z` in m, `return{k}.V` in the unit of `R`, and where known `return{k}.confidence`, `return{k}.error`,
///   `return{k}.N.X`, `.Y` and `.Z`, `return{k}.N`, its facing, and `return{k}.id`, its material. Ids are integers from 1,
///   indices into `sonar:materials` (a JSON list). No layer has more than four channels, because Blender drops such layers.
/// - `sonar:view` says whether `sonar:x0`, `y0`, `pitch` and `pitchY` are in m, or are the slopes x/z and y/z of a
///   perspective view, whose field of view (degrees) and standard screen window are written, too.
/// - Where there is no return, every `Z` and `range.V` is the fill, all other channels are 0.
///
/// `attributes` are written in addition to those of the format, which take precedence.
///
/// # Errors
/// As `crate::files::write_atomically`; a map without pixels.
///
/// # Panics
/// If a field of the map does not have one value per pixel, or an attribute's name does not start with `sonar:`.
pub fn write_depth_map(
    path: &Path,
    map: &DepthMap,
    fill: Fill,
    attributes: &[(String, Attribute)],
    encoding: Encoding,
) -> Result<()> {
    // At most nine channels of each return, fourteen of the picked one, and one in progress.
    expect_room(15 + 9 * map.returns.len(), [map.x.count, map.y.count])?;
    let scale = amplitude_scale(map);
    let fill_value = fill.value() as f32;
    let picked = &map.picked;
    let mut channels: Vec<(String, Pixels)> = Vec::new();
    let mut add = |name: &str, values: &[f32], surface: &DepthLayer, nothing: f32| {
        channels.push((name.to_owned(), Pixels::Held(masked(values, &surface.depth, nothing))));
    };
    for name in ["R", "G", "B"] {
        add(name, &scaled(&picked.strength, scale), picked, 0.0);
    }
    add("A", &vec![1.0; map.len()], picked, 0.0);
    add("Z", &picked.depth, picked, fill_value);
    add("range.V", &(0..map.len()).map(|i| map.range(i) as f32).collect::<Vec<_>>(), picked, fill_value);
    if !map.confidence.is_empty() {
        add("confidence.V", &map.confidence, picked, 0.0);
    }
    if let Some(error) = &picked.error {
        add("error.V", error, picked, 0.0);
    }
    for (name, values) in normal_channels(picked) {
        add(&name, &values, picked, 0.0);
    }
    if let Some(facing) = &picked.facing {
        add("facing.V", facing, picked, 0.0);
    }
    if let Some(material) = &picked.material {
        add("material.id", &numbers(material), picked, 0.0);
    }
    for (surface, k) in map.returns.iter().zip(1..) {
        add(&format!("return{k}.Z"), &surface.depth, surface, fill_value);
        add(&format!("return{k}.V"), &scaled(&surface.strength, scale), surface, 0.0);
        if let Some(facing) = &surface.facing {
            add(&format!("return{k}.N"), facing, surface, 0.0);
        }
        if let Some(material) = &surface.material {
            add(&format!("return{k}.id"), &numbers(material), surface, 0.0);
        }
        if let Some(confidence) = &surface.confidence {
            add(&format!("return{k}.confidence"), confidence, surface, 0.0);
        }
        if let Some(error) = &surface.error {
            add(&format!("return{k}.error"), error, surface, 0.0);
        }
        for (name, values) in normal_channels(surface) {
            add(&format!("return{k}.{name}"), &values, surface, 0.0);
        }
    }
    let mut attributes = attributes.to_vec();
    let mut add = |name: &str, value| attributes.push((format!("sonar:{name}"), value));
    add("amplitudeScale", Attribute::Number(f64::from(scale)));
    add("x0", Attribute::Number(map.x.first));
    add("y0", Attribute::Number(map.y.first));
    add("pitch", Attribute::Number(map.x.pitch));
    add("pitchY", Attribute::Number(map.y.pitch));
    add("depth", Attribute::Text("planar depth along +z".into()));
    add("unit", Attribute::Text("m".into()));
    add("noReturn", Attribute::Number(f64::from(fill_value)));
    add("view", Attribute::Text(map.view.as_str().into()));
    if !map.materials.is_empty() {
        add("materials", Attribute::Text(serde_json::json!(map.materials).to_string()));
    }
    if let Some([across, up]) = map.raster().field_of_view() {
        add("fieldOfViewX", Attribute::Number(across));
        add("fieldOfViewY", Attribute::Number(up));
    }
    let mut part = OutputPart::new(None, [map.x.count, map.y.count], channels, &attributes, encoding);
    let known = part.attributes();
    known.world_to_camera = Some(WORLD_TO_CAMERA);
    if map.view == View::Perspective {
        // The window at distance 1, in the camera's axes, where y points up.
        let middle = |axis: &Axis| f64::midpoint(axis.first, axis.last()) as f32;
        known.screen_window_center = Vec2(middle(&map.x), -middle(&map.y));
        known.screen_window_width = (map.x.pitch * map.x.count as f64) as f32;
    }
    write_parts(path, &[part])
}

/// The pixels of a part: on its axes (first, pitch), or counted.
fn raster_of(part: &ExrPart, axes: Option<[(f64, f64); 2]>, view: Option<&str>) -> Raster {
    let corner = part.attributes.layer_position;
    let counting = |first: i32| (f64::from(first), 1.0);
    let [(x0, pitch_x), (y0, pitch_y)] = axes.unwrap_or([counting(corner.0), counting(corner.1)]);
    let perspective = view == Some(View::Perspective.as_str());
    Raster {
        view: if perspective { View::Perspective } else { View::Orthographic },
        x: Axis { first: x0, pitch: pitch_x, count: part.size.0 },
        y: Axis { first: y0, pitch: pitch_y, count: part.size.1 },
    }
}

/// The components of a surface's normals, with the names of their channels.
fn normal_channels(surface: &DepthLayer) -> Vec<(String, Vec<f32>)> {
    let Some(normals) = &surface.normal else { return Vec::new() };
    let component = |axis: usize| normals.iter().map(|normal| normal[axis]).collect();
    NORMAL_AXES.iter().enumerate().map(|(axis, name)| (format!("N.{name}"), component(axis))).collect()
}

/// Material ids as floats, exact up to 2²⁴.
fn numbers(ids: &[u32]) -> Vec<f32> {
    ids.iter().map(|&id| id as f32).collect()
}

/// The maximum finite amplitude of the map, or 1 if there is none.
fn amplitude_scale(map: &DepthMap) -> f32 {
    let peak = std::iter::once(&map.picked)
        .chain(&map.returns)
        .flat_map(|surface| surface.depth.iter().zip(&surface.strength))
        .filter(|(z, v)| z.is_finite() && v.is_finite())
        .fold(0.0, |peak: f32, (_, &v)| peak.max(v));
    if peak > 0.0 { peak } else { 1.0 }
}

fn scaled(strength: &[f32], scale: f32) -> Vec<f32> {
    strength.iter().map(|v| v / scale).collect()
}

/// `values` where there is a depth, `nothing` elsewhere.
fn masked(values: &[f32], depth: &[f32], nothing: f32) -> Vec<f32> {
    assert_eq!(values.len(), depth.len(), "every field of a depth map has one value per pixel");
    values.iter().zip(depth).map(|(&value, z)| if z.is_finite() { value } else { nothing }).collect()
}

/// Reads a depth map, where that takes at most `limit_bytes`.
///
/// A file of this program is read as it was written, amplitudes to one part in 10⁷. In a file of another program, `Z` is
/// that of the first part that has one (or the only channel that ends in `.Z`), and the amplitude is `R` or `Y` of the
/// same part, or 1 without either; `A` = 0, or a depth that is not finite, not positive or beyond 10⁹ m, means that there
/// is no return.
///
/// # Errors
/// A missing or damaged file, no channel `Z`, one that takes more memory than the limit.
pub fn read_depth_map(path: &Path, limit_bytes: u64) -> Result<DepthFile> {
    let image = read_parts(path, limit_bytes, |headers| headers.iter().map(bytes_of).max().unwrap_or(0))?;
    let (part, prefix) = find_depth(path, &image.layer_data)?;
    let attributes = attributes_of(&part.attributes);
    let pixels = part.size.0 * part.size.1;
    // Subsampled channels have fewer samples and are ignored.
    let channel = |name: &str| {
        let channel = channel_of(part, name)?;
        let whole = channel.sampling == Vec2(1, 1) && channel.sample_data.len() == pixels;
        whole.then(|| floats(&channel.sample_data))
    };
    let own = |name: &str| find_attribute(&attributes, &format!("sonar:{name}"));
    let number = |name: &str| match own(name) {
        Some(Attribute::Number(number)) => Some(*number),
        Some(Attribute::Integer(integer)) => Some(*integer as f64),
        _ => None,
    };
    let Some(depth) = channel(&format!("{prefix}Z")) else {
        let problem = format!("has a subsampled channel `{prefix}Z`; one depth per pixel was expected");
        return Err(Error::input(path.display(), problem));
    };
    let text = |name: &str| match own(name) {
        Some(Attribute::Text(text)) => Some(text.as_str()),
        _ => None,
    };
    let axes = own_axes(number);
    let materials: Vec<String> =
        text("materials").and_then(|list| serde_json::from_str(list).ok()).unwrap_or_default();
    // An id without a name counts as none.
    let ids = |name: &str| -> Option<Vec<u32>> {
        let known =
            |id: &f32| if (1.0..=materials.len() as f32).contains(id) { id.round() as u32 } else { 0 };
        Some(channel(name)?.iter().map(known).collect())
    };
    let scale = number("amplitudeScale").unwrap_or(1.0) as f32;
    let fill = number("noReturn").map(|fill| fill as f32);
    let alpha = channel(&format!("{prefix}A"));
    let strength = ["R", "Y"].iter().find_map(|name| channel(&format!("{prefix}{name}")));
    let accepted: Vec<bool> = (0..pixels)
        .map(|i| {
            let z = depth[i];
            let plausible = axes.is_some() || (z > 0.0 && z < FOREIGN_NOTHING);
            // Files of this program have A; without it, the fill decides.
            let something = alpha.as_ref().map_or(Some(z) != fill, |alpha| alpha[i] > 0.0);
            z.is_finite() && plausible && something
        })
        .collect();
    let keep = |values: Vec<f32>, nothing: f32| -> Vec<f32> {
        values.into_iter().zip(&accepted).map(|(v, &is)| if is { v } else { nothing }).collect()
    };
    let normals = |prefix: &str, depth: &[f32]| -> Option<Vec<[f32; 3]>> {
        let [x, y, z] = NORMAL_AXES.map(|axis| channel(&format!("{prefix}N.{axis}")));
        let (x, y, z) = (x?, y?, z?);
        let normal = |i: usize| if depth[i].is_nan() { [f32::NAN; 3] } else { [x[i], y[i], z[i]] };
        Some((0..pixels).map(normal).collect())
    };
    let error = channel("error.V").map(|error| keep(error, f32::NAN));
    let depth = keep(depth, f32::NAN);
    let picked = DepthLayer {
        error,
        normal: normals("", &depth),
        depth,
        strength: keep(
            strength.map_or(vec![1.0; pixels], |r| r.into_iter().map(|r| r * scale).collect()),
            0.0,
        ),
        facing: channel("facing.V"),
        material: ids("material.id"),
        confidence: None,
    };
    let confidence = channel("confidence.V").map_or(Vec::new(), |db| keep(db, f32::NAN));
    let mut returns = Vec::new();
    while let Some(z) = channel(&format!("return{}.Z", returns.len() + 1)) {
        let k = returns.len() + 1;
        let strength = channel(&format!("return{k}.V")).unwrap_or_else(|| vec![0.0; pixels]);
        // A true depth may equal the fill, but then it has a strength.
        let there = |z: f32, v: f32| z.is_finite() && (Some(z) != fill || v > 0.0);
        let depth: Vec<f32> =
            z.into_iter().zip(&strength).map(|(z, &v)| if there(z, v) { z } else { f32::NAN }).collect();
        let level = |(value, z): (f32, &f32)| if z.is_nan() { f32::NAN } else { value };
        let there = |name: &str| {
            let values = channel(&format!("return{k}.{name}"));
            values.map(|values| values.into_iter().zip(&depth).map(level).collect())
        };
        returns.push(DepthLayer {
            confidence: there("confidence"),
            error: there("error"),
            normal: normals(&format!("return{k}."), &depth),
            material: ids(&format!("return{k}.id")),
            depth,
            strength: strength.into_iter().map(|v| v * scale).collect(),
            facing: channel(&format!("return{k}.N")),
        });
    }
    let raster = raster_of(part, axes, text("view"));
    let map = DepthMap { confidence, returns, materials, ..DepthMap::new(raster, picked) };
    Ok(DepthFile { map, attributes, axes_known: axes.is_some() })
}

/// Bytes of the map that is made of a part: every channel in 32 bits, strengths of returns without any, and what is computed
/// on the way.
fn bytes_of(header: &Header) -> u128 {
    let depths =
        header.channels.list.iter().filter(|channel| channel.name.to_string().ends_with('Z')).count();
    let pixels = header.layer_size.0 as u128 * header.layer_size.1 as u128;
    pixels.saturating_mul(4 * (header.channels.list.len() + depths + 6) as u128)
}

/// The axes' first positions and pitches from this program's attributes, if all of them are valid.
fn own_axes(number: impl Fn(&str) -> Option<f64>) -> Option<[(f64, f64); 2]> {
    let (x0, y0, pitch) = (number("x0")?, number("y0")?, number("pitch")?);
    let axes = [(x0, pitch), (y0, number("pitchY").unwrap_or(pitch))];
    axes.iter().all(|(first, pitch)| first.is_finite() && pitch.is_finite() && *pitch > 0.0).then_some(axes)
}

/// The part that contains the depth, and the prefix of `Z` in the channel's name.
fn find_depth<'a>(path: &Path, parts: &'a [ExrPart]) -> Result<(&'a ExrPart, String)> {
    let names = |part: &'a ExrPart| part.channel_data.list.iter().map(|channel| channel.name.to_string());
    if let Some(part) = parts.iter().find(|part| names(part).any(|name| name == "Z")) {
        return Ok((part, String::new()));
    }
    let layered: Vec<_> = parts
        .iter()
        .flat_map(|part| {
            names(part)
                .filter(|name| name.rsplit_once('.').is_some_and(|(_, last)| last == "Z"))
                .map(move |name| (part, name))
        })
        .collect();
    match layered.as_slice() {
        [(part, name)] => Ok((part, name[..name.len() - 1].to_owned())),
        [] => {
            let present: Vec<_> = parts.iter().flat_map(names).take(20).map(|name| quoted(&name)).collect();
            Err(Error::input(
                path.display(),
                format!("has no channel `Z` of depths, only {}", present.join(", ")),
            ))
        }
        many => {
            let present: Vec<_> = many.iter().take(20).map(|(_, name)| quoted(name)).collect();
            Err(Error::input(
                path.display(),
                format!(
                    "has no root `Z` but several layers with a `Z`: {}; keep only one",
                    present.join(", ")
                ),
            ))
        }
    }
}

#[cfg(test)]
mod tests;
