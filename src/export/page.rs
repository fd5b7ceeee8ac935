//! `report.html`: one self-contained page on which a person sees the whole result.
//!
//! Takes the volume, the maps, the points of the scene and the text of `report.json`; gives a page that loads nothing
//! and works from a file. The page's own code lies beside this file and is small enough to read: `template.html` and
//! `style.css`, the shaders, and the scripts, which are joined in the order of `SCRIPTS`. Same inputs, same bytes.

mod miniature;
mod payload;

pub(crate) use miniature::Miniature;

use super::points_ply::{Kind, ScenePoints};
use crate::error::Result;
use crate::files::write_atomically;
use crate::grid::{Axis, DepthMap};
use crate::metrics::error_map;
use miniature::{RANGE_DB, code};
use payload::{pack, pack_floats};
use serde_json::{Map, Value, json};
use std::io::Write;
use std::path::Path;

/// The page, with `{{name}}` where things go.
const TEMPLATE: &str = include_str!("page/template.html");
const STYLE: &str = include_str!("page/style.css");
/// The scripts, one scope.
const SCRIPTS: [&str; 5] = [
    include_str!("page/data.js"),
    include_str!("page/view.js"),
    include_str!("page/plots.js"),
    include_str!("page/numbers.js"),
    include_str!("page/main.js"),
];
/// Name in the script, and source.
const SHADERS: [(&str, &str); 4] = [
    ("rays", include_str!("page/rays.vert")),
    ("volume", include_str!("page/volume.frag")),
    ("points", include_str!("page/points.vert")),
    ("marks", include_str!("page/points.frag")),
];

/// Most pixels of a map along one axis; a larger map is thinned, never blended.
const MAP_PIXELS: usize = 512;

/// Most points of one kind that are drawn.
const MOST_POINTS: usize = 6000;

/// What a page shows; anything may be missing.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Contents<'a> {
    /// The volume, reduced.
    pub(crate) volume: Option<&'a Miniature>,
    /// What was found.
    pub(crate) depth: Option<&'a DepthMap>,
    /// What is there.
    pub(crate) truth: Option<&'a DepthMap>,
    /// What stood where.
    pub(crate) scene: Option<&'a ScenePoints>,
}

/// A page's data, packed.
#[derive(Debug, Clone)]
pub(crate) struct Page {
    data: Value,
}

impl Page {
    /// Packs what is to be shown.
    ///
    /// # Errors
    /// A depth map and a truth whose pixels do not coincide.
    pub(crate) fn new(contents: &Contents) -> Result<Self> {
        let mut data = Map::new();
        data.insert("range_db".into(), RANGE_DB.into());
        data.insert("colours".into(), colours());
        if let Some(volume) = contents.volume {
            data.insert("volume".into(), volume.to_json());
        }
        if let Some(depth) = contents.depth {
            data.insert("maps".into(), maps(depth, contents.truth)?);
        }
        match (contents.scene, contents.truth) {
            (Some(scene), _) if scene.of(Kind::Reflector).next().is_some() => {
                data.insert("points".into(), points(scene));
            }
            (scene, truth) => {
                if let Some(scene) = scene {
                    data.insert("points".into(), points(scene));
                }
                if let Some(truth) = truth {
                    data.insert("truth_points".into(), sample(&surface_points(truth)));
                }
            }
        }
        Ok(Self { data: Value::Object(data) })
    }

    /// Writes the page under a title, with `report.json`'s own text in it.
    ///
    /// # Errors
    /// As [`write_atomically`].
    pub(crate) fn write(&self, path: &Path, title: &str, report: &str) -> Result<()> {
        let title = title.replace('&', "&amp;").replace('<', "&lt;");
        let data = script_safe(&self.data.to_string());
        let report = script_safe(report.trim_end());
        let shaders: Map<String, Value> =
            SHADERS.iter().map(|(name, source)| ((*name).to_owned(), (*source).into())).collect();
        let script = format!("const SHADERS = {};\n{}", Value::Object(shaders), SCRIPTS.join("\n"));
        write_atomically(path, |out| {
            let mut rest = TEMPLATE;
            while let Some((before, after)) = rest.split_once("{{") {
                let (name, after) = after.split_once("}}").unwrap_or(("", after));
                out.write_all(before.as_bytes())?;
                let filled = match name {
                    "title" => &title,
                    "style" => STYLE,
                    "script" => &script,
                    "data" => &data,
                    "report" => &report,
                    _ => "",
                };
                out.write_all(filled.as_bytes())?;
                rest = after;
            }
            out.write_all(rest.as_bytes())
        })
    }
}

/// JSON that cannot end the script element it stands in: `<` occurs within strings alone, where it may be escaped.
fn script_safe(json: &str) -> String {
    json.replace('<', "\\u003c")
}

/// The colours of the figures, 256 of each map.
fn colours() -> Value {
    let map = |gradient: colorous::Gradient, reversed: bool| {
        let colour = |k: usize| {
            let place = if reversed { 255 - k } else { k };
            gradient.eval_continuous(place as f64 / 255.0).as_array()
        };
        pack(&(0..256).flat_map(colour).collect::<Vec<u8>>())
    };
    json!({
        "inferno": map(colorous::INFERNO, false),
        "viridis": map(colorous::VIRIDIS, false),
        "grey": map(colorous::GREYS, true),
        "diverging": map(colorous::RED_BLUE, true),
    })
}

fn axis_json(axis: &Axis) -> Value {
    json!({ "first": axis.first, "pitch": axis.pitch, "count": axis.count })
}

/// Depth, amplitude, confidence, truth and error; every n-th pixel of maps that are too large.
fn maps(depth: &DepthMap, truth: Option<&DepthMap>) -> Result<Value> {
    let step = depth.x.count.max(depth.y.count).div_ceil(MAP_PIXELS).max(1);
    let thinned = |axis: &Axis| Axis {
        first: axis.first,
        pitch: axis.pitch * step as f64,
        count: axis.count.div_ceil(step),
    };
    let (rows, columns) = (depth.y.count, depth.x.count);
    let thin = |values: &[f32]| -> Vec<f32> {
        (0..rows)
            .step_by(step)
            .flat_map(|row| values[row * columns..(row + 1) * columns].iter().copied().step_by(step))
            .collect()
    };
    let peak = depth.picked.strength.iter().copied().filter(|v| v.is_finite()).fold(0.0, f32::max);
    let amplitude: Vec<u8> = thin(&depth.picked.strength).into_iter().map(|v| code(v, peak)).collect();
    let mut maps = json!({
        "x": axis_json(&thinned(&depth.x)),
        "y": axis_json(&thinned(&depth.y)),
        "view": depth.view,
        "reduced": step,
        "depth": pack_floats(&thin(&depth.picked.depth)),
        "amplitude": pack(&amplitude),
    });
    if !depth.confidence.is_empty() {
        maps["confidence"] = pack_floats(&thin(&depth.confidence)).into();
    }
    if let Some(truth) = truth {
        maps["error"] = pack_floats(&thin(&error_map(depth, truth)?)).into();
        maps["truth"] = pack_floats(&thin(&truth.picked.depth)).into();
    }
    Ok(maps)
}

/// Where a map's surfaces lie.
fn surface_points(map: &DepthMap) -> Vec<[f32; 3]> {
    let found = (0..map.len()).filter(|&i| map.picked.depth[i].is_finite());
    found.map(|i| map.point(i).to_array().map(|x| x as f32)).collect()
}

fn points(scene: &ScenePoints) -> Value {
    let of = |kind| sample(&scene.of(kind).collect::<Vec<_>>());
    json!({
        "reflectors": of(Kind::Reflector),
        "microphones": of(Kind::Microphone),
        "speaker": scene.of(Kind::Speaker).next(),
    })
}

/// Every n-th point, so that no more than [`MOST_POINTS`] remain; how many there are, and how many are shown.
fn sample(points: &[[f32; 3]]) -> Value {
    let step = points.len().div_ceil(MOST_POINTS).max(1);
    let shown: Vec<f32> = points.iter().step_by(step).flatten().copied().collect();
    json!({ "of": points.len(), "shown": shown.len() / 3, "data": pack_floats(&shown) })
}

#[cfg(test)]
mod tests;
