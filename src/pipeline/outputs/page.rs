//! The page `report.html` of a folder of results, made when they are written, or later from the files.

use crate::error::{Error, ErrorKind, Result};
use crate::export::amplitude::Amplitude;
use crate::export::depth_exr::read_depth_map;
use crate::export::page::{Contents, Miniature, Page};
use crate::export::points_ply::{SceneMesh, ScenePoints};
use crate::files::{announce_output, open_input};
use crate::grid::DepthMap;
use serde_json::Value;
use std::io::{self, Read};
use std::path::{Path, PathBuf};

/// The page's file name.
pub(super) const PAGE: &str = "report.html";

/// The file name of the scene's mesh.
pub(super) const MESH: &str = "mesh.ply";

/// The volumes from which a page can be made, the most precise first.
const VOLUMES: [&str; 5] = ["volume.npz", "volume.zarr", "volume.nrrd", "volume.vti", "volume.exr"];

/// Makes the page of a folder that `image` wrote, from `report.json` and the other files; returns its path.
///
/// An unchanged folder gives a page that is identical with the one `image` wrote. Without a volume, a depth map or a truth
/// the page shows the rest; without `scene.ply` it draws the true surfaces instead of the reflectors.
///
/// # Errors
/// A folder without `report.json`, a damaged file, a page that cannot be written.
pub fn write_page(folder: &Path, limit_bytes: u64) -> Result<PathBuf> {
    let path = folder.join(PAGE);
    announce_output(&path)?;
    let source = folder.join("report.json");
    let mut file = open_input(&source).map_err(|error| match error.kind() {
        ErrorKind::NotFound => Error::input(
            folder.display(),
            "contains no report.json; a folder that `holosonar image ... -o` wrote was expected",
        ),
        _ => error,
    })?;
    let mut text = String::new();
    file.read_to_string(&mut text).map_err(|error| match error.kind() {
        io::ErrorKind::InvalidData => Error::input(source.display(), "is not UTF-8 text"),
        _ => Error::reading(&source, error),
    })?;
    let report: Value = serde_json::from_str(&text)
        .ok()
        .filter(|report: &Value| report.get("run").is_some_and(Value::is_object))
        .ok_or_else(|| Error::input(source.display(), "is not a report of `holosonar image`"))?;
    let files: Vec<PathBuf> = report["files"]
        .as_array()
        .into_iter()
        .flatten()
        .filter_map(Value::as_str)
        .map(PathBuf::from)
        .collect();
    let volume = VOLUMES.iter().find_map(|name| present(folder, &files, name));
    let volume = volume.map(|path| Amplitude::read(&path, limit_bytes)).transpose()?;
    let volume = volume.map(|volume| Miniature::of_amplitude(&volume));
    let scene = present(folder, &files, "scene.ply");
    let scene = scene.map(|path| ScenePoints::read(&path, limit_bytes)).transpose()?;
    let page = page_of(folder, &files, volume.as_ref(), scene.as_ref(), limit_bytes)?;
    let simulated = !report["reflectors"].is_null();
    page.write(&path, &title(Some(&report["run"]).filter(|_| simulated)), &text)?;
    Ok(path)
}

/// A page of this volume and scene, and of the maps and the mesh among the folder's `files`.
///
/// Maps and mesh are always read from the files, so that the page does not depend on when it was made.
pub(super) fn page_of(
    folder: &Path,
    files: &[PathBuf],
    volume: Option<&Miniature>,
    scene: Option<&ScenePoints>,
    limit_bytes: u64,
) -> Result<Page> {
    let map = |name: &str, limit_bytes: u64| -> Result<Option<DepthMap>> {
        let file = present(folder, files, name).map(|path| read_depth_map(&path, limit_bytes)).transpose()?;
        Ok(file.map(|file| file.map))
    };
    let depth = map("depth.exr", limit_bytes)?;
    let held = depth.as_ref().map_or(0, DepthMap::held_bytes);
    let truth = map("truth.exr", limit_bytes.saturating_sub(held))?;
    let mesh = present(folder, files, MESH).map(|path| SceneMesh::read(&path, limit_bytes)).transpose()?;
    Page::new(&Contents { volume, depth: depth.as_ref(), truth: truth.as_ref(), scene, mesh: mesh.as_ref() })
}

/// A file of the run, if it still exists; files that an earlier run left in the folder are ignored.
fn present(folder: &Path, files: &[PathBuf], name: &str) -> Option<PathBuf> {
    let listed = files.iter().any(|file| file.as_path() == Path::new(name));
    Some(folder.join(name)).filter(|path| listed && path.exists())
}

/// Names in a title.
const MOST_NAMES: usize = 3;

/// The title of a page: the name of the simulated mesh, or those of an assembly's parts.
pub(super) fn title(simulated: Option<&Value>) -> String {
    let scene = simulated.map_or(&Value::Null, |run| &run["scene"]);
    let stem = scene["mesh"].as_str().and_then(|mesh| Path::new(mesh).file_stem()?.to_str());
    let parts = scene["parts"].as_array().into_iter().flatten().filter_map(|part| part["name"].as_str());
    let mut names: Vec<&str> = stem.into_iter().chain(parts).collect();
    if names.len() > MOST_NAMES {
        names.splice(MOST_NAMES.., ["..."]);
    }
    if names.is_empty() { "measured cube".to_owned() } else { names.join(", ").replace('_', " ") }
}
