//! glTF 2.0 and GLB: the default scene's node tree, with instances, materials and the sensor's camera.
//!
//! The crate's typed JSON is used without its validation and accessor readers: both panic on some malformed
//! files, and the readers end silently where a buffer is too short. Every index is looked up and every range
//! checked here, so that a damaged file gives an error that names the element.

mod accessor;
mod acoustics;
mod container;

use std::path::Path;

use ::gltf::json;
use glam::{DAffine3, DMat3, DMat4, DQuat, DVec3};
use json::mesh::{Mode, Primitive, Semantic};
use json::validation::Checked;

use super::material::Palette;
use super::{CameraView, LoadOptions, Mesh, Sensor, Triangle, Up, too_many_triangles};
use crate::error::{Error, Result};
use crate::progress::Observer;
use container::Document;

/// Reads a glTF or GLB file. See [`Scene::load`](super::Scene::load).
pub(super) fn load(
    path: &Path,
    options: &LoadOptions,
    palette: &mut Palette<'_>,
    observer: &dyn Observer,
) -> Result<Mesh> {
    if options.unit.is_some_and(|unit| unit != super::Unit::Metre) {
        return Err(Error::input(
            "unit",
            format!("{} is glTF, which is in m; remove `unit`, and use `scale` to resize", path.display()),
        ));
    }
    let document = Document::open(path)?;
    let mut declared = Vec::new();
    for (i, material) in document.root.materials.iter().enumerate() {
        declared.push(palette.declare(acoustics::material(&document, i, material, observer)?));
    }
    let mut walk = Walk {
        document: &document,
        declared,
        palette,
        wanted: options.sensor.as_ref(),
        triangles: Vec::new(),
        sensors: Vec::new(),
        candidates: Vec::new(),
        ignored_primitives: 0,
        deformed: 0,
    };
    walk.run(observer)?;
    if walk.ignored_primitives > 0 {
        observer.warn(&format!(
            "{}: {} sets of points or lines have no surface and are left out",
            path.display(),
            walk.ignored_primitives
        ));
    }
    if walk.deformed > 0 {
        observer.warn(&format!(
            "{}: {} meshes are deformed by a skin or morph targets; they are taken in their rest shape",
            path.display(),
            walk.deformed
        ));
    }
    if document.root.extensions_used.iter().any(|e| e == "EXT_mesh_gpu_instancing") {
        observer.warn(&format!(
            "{}: EXT_mesh_gpu_instancing is not read, one instance of each is taken; `gltf-transform \
             uninstance in.glb out.glb` writes them out",
            path.display()
        ));
    }
    let sensor = walk.sensor(observer)?;
    Ok(Mesh {
        triangles: walk.triangles,
        metres_per_unit: 1.0,
        up: Up::Y,
        sensor: sensor.map(|(frame, _)| frame),
        camera: sensor.and_then(|(_, camera)| camera),
    })
}

/// A primitive's positions, and three places among them for each of its triangles.
struct Surface {
    positions: Vec<DVec3>,
    corners: Vec<[u32; 3]>,
}

struct Walk<'a, 'p> {
    document: &'a Document,
    declared: Vec<usize>,
    palette: &'a mut Palette<'p>,
    wanted: Option<&'a Sensor>,
    triangles: Vec<Triangle>,
    /// Nodes that the sensor asked for may mean, and the camera there.
    sensors: Vec<(usize, DAffine3, Option<CameraView>)>,
    /// Names that a sensor of the kind asked for could have had.
    candidates: Vec<String>,
    ignored_primitives: usize,
    deformed: usize,
}

impl Walk<'_, '_> {
    /// Visits every node of the scene once. A stack instead of recursion, and a mark on each node, bound depth
    /// and cycles.
    fn run(&mut self, observer: &dyn Observer) -> Result<()> {
        let root = &self.document.root;
        let mut visited = vec![false; root.nodes.len()];
        let mut stack: Vec<_> =
            self.roots(observer)?.into_iter().rev().map(|n| (n, DAffine3::IDENTITY)).collect();
        while let Some((index, parent)) = stack.pop() {
            let Some(node) = root.nodes.get(index) else {
                return Err(Error::input(
                    self.document.name(),
                    format!("names node {index}, which is missing"),
                ));
            };
            let place = || self.document.place("node", index, node.name.as_ref());
            if std::mem::replace(&mut visited[index], true) {
                return Err(Error::input(
                    place(),
                    "is reached twice; the nodes of glTF form a tree, without cycles or shared children",
                ));
            }
            let to_scene = parent * local_transform(node);
            if !to_scene.is_finite() {
                return Err(Error::input(place(), "has a transform that is not finite"));
            }
            self.note_sensor(index, node, to_scene);
            if let Some(mesh) = node.mesh {
                self.add_mesh(index, node, mesh.value(), to_scene)?;
            }
            let children = node.children.iter().flatten().rev();
            stack.extend(children.map(|child| (child.value(), to_scene)));
        }
        Ok(())
    }

    /// The nodes at the top of the default scene; without scenes, those that are nobody's child.
    fn roots(&self, observer: &dyn Observer) -> Result<Vec<usize>> {
        let root = &self.document.root;
        if root.scenes.is_empty() {
            let mut top = vec![true; root.nodes.len()];
            for child in root.nodes.iter().flat_map(|node| node.children.iter().flatten()) {
                if let Some(flag) = top.get_mut(child.value()) {
                    *flag = false;
                }
            }
            return Ok((0..top.len()).filter(|&i| top[i]).collect());
        }
        let index = root.scene.map_or(0, |scene| scene.value());
        let Some(scene) = root.scenes.get(index) else {
            return Err(Error::input(
                self.document.name(),
                format!("its default scene is {index}, of which there are {}", root.scenes.len()),
            ));
        };
        if root.scenes.len() > 1 {
            observer.warn(&format!(
                "{}: holds {} scenes; scene {index}{} is taken",
                self.document.name(),
                root.scenes.len(),
                scene.name.as_ref().map(|n| format!(" (`{n}`)")).unwrap_or_default()
            ));
        }
        Ok(scene.nodes.iter().map(json::Index::value).collect())
    }

    fn note_sensor(&mut self, index: usize, node: &json::Node, to_scene: DAffine3) {
        let camera = node.camera.and_then(|i| self.document.root.cameras.get(i.value()));
        let names = match self.wanted {
            None => return,
            Some(Sensor::Camera(_)) if camera.is_none() => return,
            Some(Sensor::Camera(_)) => [camera.and_then(|c| c.name.as_ref()), node.name.as_ref()],
            Some(Sensor::Node(_)) => [node.name.as_ref(), None],
        };
        let Some(Sensor::Camera(wanted) | Sensor::Node(wanted)) = self.wanted else { return };
        if names.into_iter().flatten().any(|name| name == wanted) {
            let view = camera.and_then(|c| c.perspective.as_ref()).map(|p| CameraView {
                vertical_field_of_view: f64::from(p.yfov).to_degrees(),
                aspect_ratio: p.aspect_ratio.map(f64::from),
            });
            self.sensors.push((index, to_scene, view));
        }
        self.candidates.extend(names.into_iter().flatten().map(|name| format!("`{name}`")));
    }

    /// The map from the scene to the sensor's frame (x right, y down, z ahead) and its camera, when one is asked
    /// for.
    fn sensor(&self, observer: &dyn Observer) -> Result<Option<(DAffine3, Option<CameraView>)>> {
        let Some(wanted) = self.wanted else { return Ok(None) };
        let (kind, name) = match wanted {
            Sensor::Camera(name) => ("camera", name),
            Sensor::Node(name) => ("node", name),
        };
        let Some(&(index, to_scene, view)) = self.sensors.first() else {
            let there =
                if self.candidates.is_empty() { "none".to_owned() } else { self.candidates.join(", ") };
            return Err(Error::input(
                self.document.name(),
                format!("its scene has no {kind} named `{name}`; there is {there}"),
            ));
        };
        if self.sensors.len() > 1 {
            observer.warn(&format!(
                "{}: {} nodes fit the sensor {kind}:{name}; the first is taken",
                self.document.name(),
                self.sensors.len()
            ));
        }
        // A camera has a place and axes but no size: scale and shear of its node do not apply.
        let [x, y, z] = [DVec3::X, DVec3::Y, DVec3::Z].map(|axis| to_scene.transform_vector3(axis));
        let (back, right) = (z.normalize_or_zero(), y.cross(z).normalize_or_zero());
        if back == DVec3::ZERO || right == DVec3::ZERO || x == DVec3::ZERO {
            let node = self.document.root.nodes.get(index).and_then(|n| n.name.as_ref());
            return Err(Error::input(
                self.document.place("node", index, node),
                "has a scale of 0 and looks nowhere",
            ));
        }
        let up = back.cross(right);
        // Rows are the array's axes: x right, y down, z ahead.
        let rotation = DMat3::from_cols(right, -up, -back).transpose();
        let frame = DAffine3::from_mat3(rotation) * DAffine3::from_translation(-to_scene.translation);
        Ok(Some((frame, view)))
    }

    fn add_mesh(
        &mut self,
        node_index: usize,
        node: &json::Node,
        mesh_index: usize,
        to_scene: DAffine3,
    ) -> Result<()> {
        let document = self.document;
        let node_place = || document.place("node", node_index, node.name.as_ref());
        let Some(mesh) = document.root.meshes.get(mesh_index) else {
            return Err(Error::input(node_place(), format!("shows mesh {mesh_index}, which is missing")));
        };
        let mut deformed = node.skin.is_some();
        // A mirrored node turns its triangles round.
        let mirrored = to_scene.matrix3.determinant() < 0.0;
        for (i, primitive) in mesh.primitives.iter().enumerate() {
            deformed |= primitive.targets.as_ref().is_some_and(|targets| !targets.is_empty());
            let place =
                || format!("{}, primitive {i}", document.place("mesh", mesh_index, mesh.name.as_ref()));
            let Some(Surface { positions, corners }) = self.surface(primitive, &place)? else {
                self.ignored_primitives += 1;
                continue;
            };
            let declared =
                match primitive.material.map(|m| m.value()) {
                    Some(m) => Some(*self.declared.get(m).ok_or_else(|| {
                        Error::input(place(), format!("has material {m}, which is missing"))
                    })?),
                    None => None,
                };
            let owner = node.name.as_deref().unwrap_or_default();
            let material = self.palette.assign(declared, owner);
            if self.triangles.len() + corners.len() > super::MOST_TRIANGLES {
                return Err(too_many_triangles(document.name()));
            }
            self.triangles.extend(corners.into_iter().map(|[a, b, c]| {
                let corners = if mirrored { [a, c, b] } else { [a, b, c] };
                let vertices = corners.map(|k| to_scene.transform_point3(positions[k as usize]));
                Triangle { vertices, material }
            }));
        }
        self.deformed += usize::from(deformed);
        Ok(())
    }

    /// Positions and triangles of a primitive; `None` for points and lines.
    fn surface(&self, primitive: &Primitive, place: &impl Fn() -> String) -> Result<Option<Surface>> {
        let mode = match primitive.mode {
            Checked::Valid(mode) => mode,
            Checked::Invalid => return Err(Error::input(place(), "its mode should be a number from 0 to 6")),
        };
        if matches!(mode, Mode::Points | Mode::Lines | Mode::LineLoop | Mode::LineStrip) {
            return Ok(None);
        }
        let Some(accessor) = primitive.attributes.get(&Checked::Valid(Semantic::Positions)) else {
            return Err(Error::input(place(), "has no POSITION"));
        };
        let document = self.document;
        let compressed = primitive.extensions.as_ref().is_some_and(|e| {
            e.others.contains_key("KHR_draco_mesh_compression")
                && document.root.accessors.get(accessor.value()).is_some_and(|a| a.buffer_view.is_none())
        });
        if compressed {
            return Err(container::unsupported_extension(&place(), "KHR_draco_mesh_compression"));
        }
        let positions = accessor::positions(document, accessor.value())?;
        let indices = match primitive.indices {
            Some(index) => accessor::indices(document, index.value())?,
            None => (0..positions.len() as u32).collect(),
        };
        if let Some(bad) = indices.iter().find(|&&i| i as usize >= positions.len()) {
            return Err(Error::input(
                place(),
                format!("has vertex {bad}, of which there are {}", positions.len()),
            ));
        }
        let corners = triangles_of(mode, &indices, place)?;
        Ok(Some(Surface { positions, corners }))
    }
}

fn triangles_of(mode: Mode, indices: &[u32], place: &impl Fn() -> String) -> Result<Vec<[u32; 3]>> {
    match mode {
        Mode::TriangleStrip => {
            // Every second triangle of a strip runs the other way round.
            let turned =
                |(i, w): (usize, &[u32])| if i % 2 == 0 { [w[0], w[1], w[2]] } else { [w[0], w[2], w[1]] };
            Ok(indices.windows(3).enumerate().map(turned).collect())
        }
        Mode::TriangleFan => {
            Ok(indices.get(1..).unwrap_or_default().windows(2).map(|w| [indices[0], w[0], w[1]]).collect())
        }
        _ if indices.len().is_multiple_of(3) => {
            Ok(indices.chunks_exact(3).map(|c| [c[0], c[1], c[2]]).collect())
        }
        _ => Err(Error::input(
            place(),
            format!("has {} corners, which is no multiple of 3; the file may be cut short", indices.len()),
        )),
    }
}

/// The node's matrix, or `T · R · S`, in f64.
fn local_transform(node: &json::Node) -> DAffine3 {
    if let Some(matrix) = node.matrix {
        return DAffine3::from_mat4(DMat4::from_cols_array(&matrix.map(f64::from)));
    }
    let vector = |v: [f32; 3]| DVec3::from_array(v.map(f64::from));
    let rotation = node.rotation.map_or(DQuat::IDENTITY, |q| DQuat::from_array(q.0.map(f64::from)));
    // Files round quaternions; one that is off by more is a rotation all the same. Zero is none.
    let length = rotation.length();
    let rotation = if length > 0.0 { rotation / length } else { DQuat::IDENTITY };
    DAffine3::from_scale_rotation_translation(
        node.scale.map_or(DVec3::ONE, vector),
        rotation,
        node.translation.map_or(DVec3::ZERO, vector),
    )
}
