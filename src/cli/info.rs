//! The facts of a file, by its kind.

pub(super) mod health;
mod recording;

use super::Overrides;
use super::inputs::{config_of, run_file_of};
use crate::acquisition::{ChannelResponse, DataCube};
use crate::error::{Error, Result};
use crate::export::amplitude::Amplitude;
use crate::export::depth_exr::read_depth_map;
use crate::export::points_ply::Ply;
use crate::export::volume_npz::read_volume_npz;
use crate::export::volume_zarr::read_amplitude_zarr;
use crate::export::{attributes_as_json, find_attribute};
use crate::files::extension;
use crate::files::npz::NpzReader;
use crate::files::zarr::ZarrStore;
use crate::grid::{Axis, Grid};
use crate::progress::Observer;
use crate::scene::{EXTENSIONS, Scene, Unit, metres};
use crate::wave::Geometry;
use glam::DVec3;
use num_complex::Complex32;
use serde_json::{Value, json};
use std::path::Path;

/// The facts of a file.
pub(super) fn of(file: &Path, overrides: &Overrides, limit: u64, observer: &dyn Observer) -> Result<Value> {
    match extension(file).as_str() {
        "npz" => npz(file, limit),
        "zarr" => zarr(file, limit),
        "exr" => exr(file, limit),
        "vti" | "nrrd" => volume(file, limit),
        "wav" => recording::facts(file),
        // Without faces it is a point cloud, as `depth` writes it.
        "ply" => mesh(file, overrides, observer).or_else(|error| points(file, limit).map_err(|_| error)),
        "toml" => {
            let run = run_file_of(file, &overrides.keys()?)?;
            Ok(json!({ "kind": "run file", "resolved": run.to_json() }))
        }
        mesh if EXTENSIONS.contains(&mesh) => self::mesh(file, overrides, observer),
        "csv" => {
            let reflectors = crate::reflectors::Reflectors::read_csv_within(file, Some(limit))?;
            let bounds = reflectors.bounds();
            Ok(json!({
                "kind": "reflectors",
                "count": reflectors.len(),
                "low_m": bounds.map(|(low, _)| low.to_array()),
                "high_m": bounds.map(|(_, high)| high.to_array()),
            }))
        }
        _ => Err(Error::input(
            file.display(),
            "is of an unknown kind; .npz, .zarr, .exr, .vti, .nrrd, .wav, .ply, .obj, .gltf, .glb, .stl, .csv or \
             .toml was expected",
        )),
    }
}

fn axis(axis: &Axis) -> Value {
    json!({ "first_m": axis.first, "last_m": axis.last(), "pitch_m": axis.pitch, "count": axis.count })
}

/// The facts of a volume on this grid, with its metadata under a key.
fn volume_facts(grid: &Grid, peak_amplitude: f32, key: &str, metadata: &Value) -> Value {
    json!({
        "kind": "volume",
        "shape_zyx": grid.shape(),
        "x": axis(&grid.x), "y": axis(&grid.y), "z": axis(&grid.z),
        "peak_amplitude": peak_amplitude,
        key: metadata,
    })
}

fn npz(file: &Path, limit: u64) -> Result<Value> {
    let reader = NpzReader::open(file, limit)?;
    if ChannelResponse::is_of(&reader) {
        return Ok(response(&ChannelResponse::read(file, limit)?));
    }
    if reader.contains("x") && !reader.contains("frequencies") {
        let (volume, meta) = read_volume_npz(file, limit)?;
        return Ok(volume_facts(&volume.grid, volume.peak(), "meta", &meta));
    }
    cube(file, limit)
}

fn zarr(file: &Path, limit: u64) -> Result<Value> {
    if ZarrStore::open(file, limit)?.contains("frequencies") {
        return cube(file, limit);
    }
    let (amplitude, meta) = read_amplitude_zarr(file, limit)?;
    Ok(volume_facts(&amplitude.grid, amplitude.peak(), "meta", &meta))
}

fn cube(file: &Path, limit: u64) -> Result<Value> {
    let cube = DataCube::read(file, limit)?;
    let instrument = &cube.instrument;
    let (sweep, array) = (&instrument.sweep, &instrument.array);
    let power: f64 =
        cube.samples.iter().map(|m| f64::from(m.norm_sqr())).sum::<f64>() / cube.samples.len() as f64;
    let sources = instrument.sources();
    let sources: Vec<[f64; 3]> = sources.iter().map(DVec3::to_array).collect();
    let pair = match instrument.geometry {
        Geometry::Pair { offset } if !instrument.has_differing_pairs() => Some(offset.to_array()),
        _ => None,
    };
    let mut facts = json!({
        "kind": "data cube",
        "speakers": instrument.transmissions(),
        "frequencies": sweep.len(),
        "start_hz": sweep.start(), "stop_hz": sweep.stop(), "step_hz": sweep.step(),
        "microphones": array.len(),
        "on_a_lattice": array.lattice().is_some(),
        "array_shape": array.shape(),
        "array_centre_m": array.centre().to_array(),
        "array_extent_m": array.extent().to_array(),
        "geometry": instrument.geometry.kind(),
        "sources_m": sources,
        "source_offset_m": pair,
        "detection": instrument.detection,
        "sound_speed_m_per_s": instrument.sound_speed,
        "range_resolution_m": instrument.range_resolution(),
        "rms_sample": power.sqrt(),
        "provenance": cube.provenance,
    });
    if instrument.has_differing_pairs() {
        let seen = instrument.equivalent();
        facts["pairs"] = json!(instrument.pair_sources.len());
        facts["midpoints_centre_m"] = json!(seen.array.centre().to_array());
        facts["midpoints_extent_m"] = json!(seen.array.extent().to_array());
    }
    if let Some(interface) = instrument.interface {
        facts["interface"] = json!(interface);
    }
    Ok(facts)
}

/// The facts of what `calibrate --reference` measured.
fn response(response: &ChannelResponse) -> Value {
    let levels = |values: &[Complex32]| {
        let level = |pick: fn(f32, f32) -> f32| {
            values.iter().map(|value| value.norm()).reduce(pick).map(|norm| 20.0 * norm.log10())
        };
        json!({ "count": values.len(), "least_db": level(f32::min), "greatest_db": level(f32::max) })
    };
    json!({
        "kind": "response",
        "frequencies": levels(&response.frequency),
        "microphones": levels(&response.microphone),
        "speakers": levels(&response.source),
        "explained": response.explained,
    })
}

fn volume(file: &Path, limit: u64) -> Result<Value> {
    let volume = Amplitude::read(file, limit)?;
    let attributes = attributes_as_json(&volume.attributes);
    Ok(volume_facts(&volume.grid, volume.peak(), "attributes", &attributes))
}

fn points(file: &Path, limit: u64) -> Result<Value> {
    let Ply { vertices, comments, .. } = Ply::read(file, limit)?;
    let ends = |name: &str, pick: fn(f64, f64) -> f64| {
        vertices.column(name).unwrap_or_default().into_iter().reduce(pick)
    };
    let corner = |pick| ["x", "y", "z"].map(|name| ends(name, pick));
    Ok(json!({
        "kind": "points",
        "count": vertices.count,
        "properties": vertices.names().collect::<Vec<_>>(),
        "low_m": corner(f64::min), "high_m": corner(f64::max),
        "comments": comments,
    }))
}

fn exr(file: &Path, limit: u64) -> Result<Value> {
    let depth = read_depth_map(file, limit)?;
    let map = &depth.map;
    let found = || map.picked.depth.iter().copied().filter(|z| !z.is_nan());
    let range = found().fold(None, |range: Option<[f32; 2]>, z| {
        Some(range.map_or([z, z], |[low, high]| [low.min(z), high.max(z)]))
    });
    // The first part of a volume has a depth at every pixel: that of the maximum amplitude.
    let kind = match find_attribute(&depth.attributes, "sonar:gridShape") {
        Some(_) => "volume, seen from the front",
        None => "depth map",
    };
    Ok(json!({
        "kind": kind,
        "pixels_yx": map.shape(),
        "x": depth.axes_known.then(|| axis(&map.x)), "y": depth.axes_known.then(|| axis(&map.y)),
        "accepted": map.accepted(),
        "depth_range_m": range,
        "returns": map.returns.len(),
        "attributes": attributes_as_json(&depth.attributes),
    }))
}

fn mesh(file: &Path, overrides: &Overrides, observer: &dyn Observer) -> Result<Value> {
    let run = config_of(None, &overrides.keys()?)?;
    // Where nobody says the unit, one unit is shown as what it is, and in every unit that it could be.
    let options = run.load_options()?.with_assumed_unit(Some(Unit::Metre));
    let scene = Scene::load_with(file, &options, observer)?;
    let (bounds, frame) = (scene.bounds(), scene.frame());
    let unit_known = frame.is_none_or(|frame| frame.metres_per_unit.is_some());
    let size = bounds.map(|(low, high)| (high - low).to_array());
    let materials: Vec<Value> = scene
        .materials()
        .iter()
        .map(|m| {
            json!({ "name": m.name, "reflectance": m.reflectance, "transmittance": m.transmittance, "from": m.source })
        })
        .collect();
    let mut facts = json!({ "kind": "mesh", "triangles": scene.triangles().len() });
    if let Some(frame) = frame {
        facts["size_in_file_units"] = json!(frame.size.to_array());
        (facts["up"], facts["up_is_default"]) = (json!(frame.up), json!(frame.up_is_default));
        if !unit_known {
            let size = |unit: &Unit| (frame.size * unit.metres() * run.scene.scale).to_array().map(metres);
            let sizes =
                Unit::ALL.iter().map(|unit| (format!("--unit {unit}"), size(unit).join(" x ").into()));
            facts["unit"] = json!("unknown");
            facts["size_by_unit"] = Value::Object(sizes.collect());
        }
    }
    if unit_known {
        facts["area_m2"] = json!(scene.surface_area());
        facts["size_m"] = json!(size);
        facts["low_m"] = json!(bounds.map(|(low, _)| low.to_array()));
        facts["high_m"] = json!(bounds.map(|(_, high)| high.to_array()));
    }
    facts["material"] = json!(materials);
    Ok(facts)
}
