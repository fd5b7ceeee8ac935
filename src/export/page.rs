//! `report.html`: one self-contained page that shows the complete result.
//!
//! Takes the volume, the maps, the points of the scene and the text of `report.json`; writes a page that loads nothing
//! and can be opened as a local file. Its sources are in the folder `page`: `template.html`, `style.css`, the shaders, and
//! the scripts, which are joined in the order of `SCRIPTS`. The same inputs give the same bytes.

mod miniature;
mod payload;

pub(crate) use miniature::Miniature;

use super::points_ply::{PointKind, ScenePoints};
use crate::error::Result;
use crate::files::write_atomically;
use crate::grid::{Axis, DepthMap};
use crate::metrics::error_map;
use miniature::{RANGE_DB, code};
use payload::{pack, pack_floats};
use serde_json::{Map, Value, json};
use std::io::Write;
use std::path::Path;

/// The page, with placeholders `{{name}}`.
const TEMPLATE: &str = include_str!("page/template.html");
const STYLE: &str = include_str!("page/style.css");
/// The scripts, which share one scope.
const SCRIPTS: [&str; 5] = [
    include_str!("page/data.js"),
    include_str!("page/view.js"),
    include_str!("page/plots.js"),
    include_str!("page/numbers.js"),
    include_str!("page/main.js"),
];
/// The shaders: name in the script, and source.
const SHADERS: [(&str, &str); 4] = [
    ("rays", include_str!("page/rays.vert")),
    ("volume", include_str!("page/volume.frag")),
    ("points", include_str!("page/points.vert")),
    ("marks", include_str!("page/points.frag")),
];

/// Maximum number of pixels of a map along one axis; a larger map is subsampled, never blended.
const MAP_PIXELS: usize = 512;

/// Maximum number of points of one kind that are drawn.
const MOST_POINTS: usize = 6000;

/// The contents of a page, all of them optional.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Contents<'a> {
    /// The reduced volume.
    pub(crate) volume: Option<&'a Miniature>,
    /// The depth map.
    pub(crate) depth: Option<&'a DepthMap>,
    /// The ground truth.
    pub(crate) truth: Option<&'a DepthMap>,
    /// The points of the scene.
    pub(crate) scene: Option<&'a ScenePoints>,
}

/// The direction towards the light that shades surfaces, and how bright they are without it.
const LIGHT: [f32; 3] = [-0.45, -0.55, -0.703_56];
const AMBIENT: f32 = 0.45;

/// The compressed data of a page.
#[derive(Debug, Clone)]
pub(crate) struct Page {
    data: Value,
}

impl Page {
    /// Compresses the contents.
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
        if let Some(scene) = contents.scene {
            data.insert("points".into(), points(scene));
        }
        // Without reflectors, the true surfaces are drawn instead.
        let scene = contents.scene.filter(|scene| scene.of(PointKind::Reflector).next().is_some());
        if let (None, Some(truth)) = (scene, contents.truth) {
            data.insert("truth_points".into(), sample(&surface_points(truth)));
        }
        Ok(Self { data: Value::Object(data) })
    }

    /// Writes the page with a title and the text of `report.json`.
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

/// JSON that cannot end its script element: `<` occurs only in strings, where it can be escaped.
fn script_safe(json: &str) -> String {
    json.replace('<', "\\u003c")
}

/// The colour maps of the figures, 256 colours each.
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
        "x": thinned(&depth.x),
        "y": thinned(&depth.y),
        "view": depth.view,
        "reduced": step,
        "depth": pack_floats(&thin(&depth.picked.depth)),
        "amplitude": pack(&amplitude),
    });
    if !depth.confidence.is_empty() {
        maps["confidence"] = pack_floats(&thin(&depth.confidence)).into();
    }
    for (name, map) in [("shading", Some(depth)), ("true_shading", truth)] {
        if let Some(normals) = map.and_then(|map| map.picked.normal.as_deref()) {
            let shading: Vec<f32> = normals.iter().map(lit).collect();
            let codes: Vec<u8> = thin(&shading).into_iter().map(|lit| (255.0 * lit).round() as u8).collect();
            maps[name] = pack(&codes).into();
        }
    }
    if let Some(truth) = truth {
        maps["error"] = pack_floats(&thin(&error_map(depth, truth)?)).into();
        maps["truth"] = pack_floats(&thin(&truth.picked.depth)).into();
    }
    Ok(maps)
}

/// How bright a surface is drawn: by its unit normal, which faces the array, in light from the upper left; 1 without a normal.
fn lit(normal: &[f32; 3]) -> f32 {
    let facing: f32 = normal.iter().zip(LIGHT).map(|(n, l)| n * l).sum();
    if facing.is_nan() { 1.0 } else { AMBIENT + (1.0 - AMBIENT) * facing.max(0.0) }
}

/// The points of a map's surfaces, m.
fn surface_points(map: &DepthMap) -> Vec<[f32; 3]> {
    let found = (0..map.len()).filter(|&i| map.picked.depth[i].is_finite());
    found.map(|i| map.point(i).to_array().map(|x| x as f32)).collect()
}

fn points(scene: &ScenePoints) -> Value {
    let of = |kind| sample(&scene.of(kind).collect::<Vec<_>>());
    json!({
        "reflectors": of(PointKind::Reflector),
        "microphones": of(PointKind::Microphone),
        "speaker": scene.of(PointKind::Speaker).next(),
    })
}

/// Every n-th point, at most [`MOST_POINTS`], with the numbers of all points and of those shown.
fn sample(points: &[[f32; 3]]) -> Value {
    let step = points.len().div_ceil(MOST_POINTS).max(1);
    let shown: Vec<f32> = points.iter().step_by(step).flatten().copied().collect();
    json!({ "of": points.len(), "shown": shown.len() / 3, "data": pack_floats(&shown) })
}

#[cfg(test)]
mod tests;
