//! `report.html`: one self-contained page that shows the complete result.
//!
//! Takes the volume, the maps, the points and the mesh of the scene and the text of `report.json`; writes a page that loads
//! nothing and can be opened as a local file. Its sources are in the folder `page`: `template.html`, `style.css`, the shaders,
//! and the scripts, which are joined in the order of `SCRIPTS`. The same inputs give the same bytes.

mod maps;
mod mesh;
mod miniature;
mod payload;

pub(crate) use miniature::Miniature;

use super::points_ply::{PointKind, SceneMesh, ScenePoints};
use crate::error::Result;
use crate::files::write_atomically;
use crate::grid::DepthMap;
use miniature::RANGE_DB;
use payload::{pack, pack_floats};
use serde_json::{Map, Value, json};
use std::io::Write;
use std::path::Path;

/// The page, with placeholders `{{name}}`.
const TEMPLATE: &str = include_str!("page/template.html");
const STYLE: &str = include_str!("page/style.css");
/// The scripts, which share one scope.
const SCRIPTS: [&str; 10] = [
    include_str!("page/scripts/data.js"),
    include_str!("page/scripts/axes.js"),
    include_str!("page/scripts/view.js"),
    include_str!("page/scripts/layers.js"),
    include_str!("page/scripts/plots.js"),
    include_str!("page/scripts/slices.js"),
    include_str!("page/scripts/maps.js"),
    include_str!("page/scripts/control.js"),
    include_str!("page/scripts/numbers.js"),
    include_str!("page/scripts/main.js"),
];
/// The shaders: name in the script, and source.
const SHADERS: [(&str, &str); 4] = [
    ("rays", include_str!("page/shaders/rays.vert")),
    ("volume", include_str!("page/shaders/volume.frag")),
    ("points", include_str!("page/shaders/points.vert")),
    ("marks", include_str!("page/shaders/points.frag")),
];

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
    /// The decimated mesh of the scene.
    pub(crate) mesh: Option<&'a SceneMesh>,
}

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
            data.insert("maps".into(), maps::packed(depth, contents.truth)?);
        }
        if let Some(scene) = contents.scene {
            data.insert("points".into(), points(scene));
        }
        if let Some(mesh) = contents.mesh.filter(|mesh| !mesh.triangles.is_empty()) {
            data.insert("mesh".into(), mesh::packed(mesh));
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

/// The points of a map's surfaces, m.
fn surface_points(map: &DepthMap) -> Vec<[f32; 3]> {
    let found = (0..map.len()).filter(|&i| map.picked.depth[i].is_finite());
    found.map(|i| map.point(i).to_array().map(|x| x as f32)).collect()
}

fn points(scene: &ScenePoints) -> Value {
    let of = |kind| sample(&scene.of(kind).collect::<Vec<_>>());
    let mut points = json!({
        "reflectors": of(PointKind::Reflector),
        "microphones": of(PointKind::Microphone),
        "speaker": scene.of(PointKind::Speaker).next(),
    });
    if scene.of(PointKind::Bounce).next().is_some() {
        points["bounces"] = of(PointKind::Bounce);
    }
    points
}

/// Every n-th point, at most [`MOST_POINTS`], with the numbers of all points and of those shown.
fn sample(points: &[[f32; 3]]) -> Value {
    let step = points.len().div_ceil(MOST_POINTS).max(1);
    let shown: Vec<f32> = points.iter().step_by(step).flatten().copied().collect();
    json!({ "of": points.len(), "shown": shown.len() / 3, "data": pack_floats(&shown) })
}

#[cfg(test)]
mod tests;
