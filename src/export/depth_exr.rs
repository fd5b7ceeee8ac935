//! Depth maps and ground truth as `OpenEXR`: `depth.exr` and `truth.exr`.
//!
//! One single-part scanline file of 32-bit floats that every viewer shows something of: the amplitude as root
//! `R`, `G`, `B`, the planar depth in m as root `Z`, whether there is a return at all as root `A`; the other
//! facts are layers. [`read_depth_map`] takes such a file, or anybody's with a channel `Z`.

use super::exr_file::{
    Part, WORLD_TO_CAMERA, attributes_of, expect_room, floats, part, read_parts, write_parts,
};
use super::{Attribute, Attributes, Encoding, Fill, find_attribute};
use crate::error::{Error, Result};
use crate::grid::{Axis, DepthMap, Raster, Surface, View};
use exr::prelude::Vec2;
use std::path::Path;

/// Depth from which on a foreign `Z` means "nothing there", m: programs write 1e10, 1e30 or the largest float.
const FOREIGN_NOTHING: f32 = 1e9;

/// A depth map read from a file.
#[derive(Debug, Clone, PartialEq)]
pub struct DepthFile {
    /// The map.
    pub map: DepthMap,
    /// What the file says about it, in order of the names.
    pub attributes: Attributes,
    /// Whether the file gave the axes in m, or in slopes for a perspective view. If not, they count pixels, with pitch
    /// 1.
    pub axes_known: bool,
}

/// Writes a depth map or a ground truth.
///
/// - Root `R`, `G`, `B`: amplitude over `sonar:amplitudeScale`, 0 where there is no return; `A`: 1 or 0; `Z`: m.
/// - Layers: `range.V` in m; `confidence.V` in dB, `facing.V` and `material.id` where the map has them; for the k-th
///   return `return{k}.Z` in m, `return{k}.V` in the unit of `R`, and where known `return{k}.confidence` in dB,
///   `return{k}.N`, its facing, and `return{k}.id`, its material. Ids are whole numbers from 1, which count the names in
///   `sonar:materials` (a JSON list). No layer has more than four channels: Blender drops those that do.
/// - `sonar:view` says what `sonar:x0`, `y0`, `pitch` and `pitchY` are: m, or the slopes x/z and y/z of a perspective
///   view, whose field of view (degrees) and standard screen window stand there too.
/// - Where there is no return, every `Z` and `range.V` hold the fill, all else holds 0.
///
/// `attributes` are written beside those of the format, whose names win.
///
/// # Errors
/// As `crate::files::write_atomically`; a map without pixels.
///
/// # Panics
/// When a field of the map has not one value per pixel, or an attribute's name does not start with `sonar:`.
pub fn write_depth_map(
    path: &Path,
    map: &DepthMap,
    fill: Fill,
    attributes: &[(String, Attribute)],
    encoding: Encoding,
) -> Result<()> {
    // Of each return five channels at the most, of the picked one ten, and one in the making.
    expect_room(11 + 5 * map.returns.len(), [map.x.count, map.y.count])?;
    let scale = amplitude_scale(map);
    let fill_value = fill.value() as f32;
    let accepted: Vec<bool> = map.picked.depth.iter().map(|z| z.is_finite()).collect();
    let mut channels: Vec<(String, Vec<f32>)> = Vec::new();
    let picture = masked(&scaled(&map.picked.strength, scale), &map.picked.depth, 0.0);
    for name in ["R", "G"] {
        channels.push((name.into(), picture.clone()));
    }
    channels.push(("B".into(), picture));
    channels.push(("A".into(), accepted.iter().map(|&is| f32::from(u8::from(is))).collect()));
    channels.push(("Z".into(), masked(&map.picked.depth, &map.picked.depth, fill_value)));
    let range: Vec<f32> = (0..map.len()).map(|i| map.range(i) as f32).collect();
    channels.push(("range.V".into(), masked(&range, &map.picked.depth, fill_value)));
    if !map.confidence.is_empty() {
        channels.push(("confidence.V".into(), masked(&map.confidence, &map.picked.depth, 0.0)));
    }
    if let Some(facing) = &map.picked.facing {
        channels.push(("facing.V".into(), masked(facing, &map.picked.depth, 0.0)));
    }
    if let Some(material) = &map.picked.material {
        channels.push(("material.id".into(), masked(&numbers(material), &map.picked.depth, 0.0)));
    }
    for (surface, k) in map.returns.iter().zip(1..) {
        channels.push((format!("return{k}.Z"), masked(&surface.depth, &surface.depth, fill_value)));
        let strength = scaled(&surface.strength, scale);
        channels.push((format!("return{k}.V"), masked(&strength, &surface.depth, 0.0)));
        if let Some(facing) = &surface.facing {
            channels.push((format!("return{k}.N"), masked(facing, &surface.depth, 0.0)));
        }
        if let Some(material) = &surface.material {
            channels.push((format!("return{k}.id"), masked(&numbers(material), &surface.depth, 0.0)));
        }
        if let Some(confidence) = &surface.confidence {
            channels.push((format!("return{k}.confidence"), masked(confidence, &surface.depth, 0.0)));
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
    let mut part = part(None, [map.x.count, map.y.count], channels, &attributes, encoding)?;
    part.attributes.world_to_camera = Some(WORLD_TO_CAMERA);
    if map.view == View::Perspective {
        // The window at distance 1, in the camera's axes, whose y points up.
        let middle = |axis: &Axis| f64::midpoint(axis.first, axis.last()) as f32;
        part.attributes.screen_window_center = Vec2(middle(&map.x), -middle(&map.y));
        part.attributes.screen_window_width = (map.x.pitch * map.x.count as f64) as f32;
    }
    write_parts(path, vec![part])
}

/// Material ids as an image holds them; 2²⁴ of them are exact.
fn numbers(ids: &[u32]) -> Vec<f32> {
    ids.iter().map(|&id| id as f32).collect()
}

/// The greatest finite amplitude of the map, or 1 where there is none.
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
    assert_eq!(values.len(), depth.len(), "every field of a depth map holds one value per pixel");
    values.iter().zip(depth).map(|(&value, z)| if z.is_finite() { value } else { nothing }).collect()
}

/// Reads a depth map whose pixels take no more than `limit_bytes`.
///
/// A file of ours comes back as it was written, amplitudes to one part in 10⁷. Of a foreign file, `Z` is taken
/// from the first part that has it (or from the only channel that ends in `.Z`), the amplitude from `R` or `Y`
/// beside it, 1 if there is neither; `A` = 0, a depth that is not finite, not positive or beyond 10⁹ m mean that
/// nothing is there.
///
/// # Errors
/// A missing or damaged file, no channel `Z`, more pixels than the limit allows.
pub fn read_depth_map(path: &Path, limit_bytes: u64) -> Result<DepthFile> {
    let image = read_parts(path, limit_bytes)?;
    let (part, prefix) = find_depth(path, &image.layer_data)?;
    let attributes = attributes_of(&part.attributes);
    let pixels = part.size.0 * part.size.1;
    // Each once as it is, and once as it is kept.
    expect_room(2 * part.channel_data.list.len(), [part.size.0, part.size.1])?;
    // Subsampled channels have fewer samples and are of no use to us.
    let channel = |name: &str| {
        let channel = part.channel_data.list.iter().find(|channel| channel.name.eq(name))?;
        let whole = channel.sampling == Vec2(1, 1) && channel.sample_data.len() == pixels;
        whole.then(|| floats(&channel.sample_data))
    };
    let number = |name: &str| match find_attribute(&attributes, &format!("sonar:{name}")) {
        Some(Attribute::Number(number)) => Some(*number),
        Some(Attribute::Integer(integer)) => Some(*integer as f64),
        _ => None,
    };
    let Some(depth) = channel(&format!("{prefix}Z")) else {
        return Err(Error::input(
            path.display(),
            format!(
                "has a channel `{prefix}Z` of fewer samples than pixels; one depth per pixel was expected"
            ),
        ));
    };
    let text = |name: &str| match find_attribute(&attributes, &format!("sonar:{name}")) {
        Some(Attribute::Text(text)) => Some(text.as_str()),
        _ => None,
    };
    let axes = ours(number("x0"), number("y0"), number("pitch"), number("pitchY"));
    let materials: Vec<String> =
        text("materials").and_then(|list| serde_json::from_str(list).ok()).unwrap_or_default();
    // An id that counts no name is as good as none.
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
            // A file of ours has A; without it the fill alone tells.
            let something = alpha.as_ref().map_or(Some(z) != fill, |alpha| alpha[i] > 0.0);
            z.is_finite() && plausible && something
        })
        .collect();
    let keep = |values: Vec<f32>, nothing: f32| -> Vec<f32> {
        values.into_iter().zip(&accepted).map(|(v, &is)| if is { v } else { nothing }).collect()
    };
    let picked = Surface {
        depth: keep(depth, f32::NAN),
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
        // A depth that happens to equal the fill still has a strength.
        let there = |z: f32, v: f32| z.is_finite() && (Some(z) != fill || v > 0.0);
        let depth: Vec<f32> =
            z.into_iter().zip(&strength).map(|(z, &v)| if there(z, v) { z } else { f32::NAN }).collect();
        let of_returns = |values: Vec<f32>| -> Vec<f32> {
            values
                .into_iter()
                .zip(&depth)
                .map(|(value, z)| if z.is_nan() { f32::NAN } else { value })
                .collect()
        };
        returns.push(Surface {
            confidence: channel(&format!("return{k}.confidence")).map(of_returns),
            material: ids(&format!("return{k}.id")),
            depth,
            strength: strength.into_iter().map(|v| v * scale).collect(),
            facing: channel(&format!("return{k}.N")),
        });
    }
    let corner = part.attributes.layer_position;
    let counting = |first: i32| (f64::from(first), 1.0);
    let [(x0, pitch_x), (y0, pitch_y)] = axes.unwrap_or([counting(corner.0), counting(corner.1)]);
    let view =
        if text("view") == Some(View::Perspective.as_str()) { View::Perspective } else { View::Orthographic };
    let raster = Raster {
        view,
        x: Axis { first: x0, pitch: pitch_x, count: part.size.0 },
        y: Axis { first: y0, pitch: pitch_y, count: part.size.1 },
    };
    let map = DepthMap { confidence, returns, materials, ..DepthMap::new(raster, picked) };
    Ok(DepthFile { map, attributes, axes_known: axes.is_some() })
}

/// The axes' first positions and pitches, m, if all of them make sense.
fn ours(
    x0: Option<f64>,
    y0: Option<f64>,
    pitch: Option<f64>,
    pitch_y: Option<f64>,
) -> Option<[(f64, f64); 2]> {
    let (x0, y0, pitch) = (x0?, y0?, pitch?);
    let pitch_y = pitch_y.unwrap_or(pitch);
    let sensible =
        x0.is_finite() && y0.is_finite() && [pitch, pitch_y].iter().all(|p| p.is_finite() && *p > 0.0);
    sensible.then_some([(x0, pitch), (y0, pitch_y)])
}

/// The part that holds the depth, and what stands before `Z` in the channel's name.
fn find_depth<'a>(path: &Path, parts: &'a [Part]) -> Result<(&'a Part, String)> {
    let names = |part: &'a Part| part.channel_data.list.iter().map(|channel| channel.name.to_string());
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
            let present: Vec<_> = parts.iter().flat_map(names).take(20).collect();
            Err(Error::input(
                path.display(),
                format!("has no channel `Z` of depths; it holds {}", present.join(", ")),
            ))
        }
        many => {
            let present: Vec<_> = many.iter().map(|(_, name)| name.as_str()).collect();
            Err(Error::input(
                path.display(),
                format!("has no root `Z` but several layers with one: {}; keep one", present.join(", ")),
            ))
        }
    }
}

#[cfg(test)]
mod tests;
