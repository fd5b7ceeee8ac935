//! glTF 2.0 and GLB: the default scene's node tree, with instances, materials and the sensor's camera.
//!
//! The crate's typed JSON is used without its validation and accessor readers: both panic on some malformed
//! files, and the readers end silently where a buffer is too short. Every index is looked up and every range
//! checked here, so that a damaged file gives an error that names the element.

mod accessor;
mod acoustics;
mod container;
mod instances;
mod mesh;
mod sensor;

use std::collections::HashMap;
use std::collections::hash_map::Entry;

use ::gltf::json;
use glam::{DAffine3, DMat4, DQuat, DVec3};

use super::files::MeshFile;
use super::material::Palette;
use super::surfaces::{Surfaces, too_many_triangles};
use super::{Mesh, Unit, Up};
use crate::error::{Error, Result};
use crate::text::quoted;
use container::Document;
use instances::Instances;
use mesh::MeshReader;
use sensor::SensorSearch;

/// Reads a glTF or GLB file. See [`Scene::load`](super::Scene::load).
pub(super) fn load<'a>(file: MeshFile<'a>, palette: &mut Palette<'_>) -> Result<Mesh<'a>> {
    if file.options.unit.is_some_and(|unit| unit != Unit::Metre) {
        let path = file.path.display();
        let problem =
            format!("{path} is glTF, whose unit is the metre; remove `unit`, and use `scale` to resize");
        return Err(Error::input("unit", problem));
    }
    let document = Document::open(file)?;
    for (i, material) in document.root.materials.iter().enumerate() {
        palette.declare(acoustics::material(&document, i, material)?);
    }
    let mut walk = Walk {
        document: &document,
        palette,
        meshes: HashMap::new(),
        surfaces: Surfaces::new(file),
        sensor_search: SensorSearch::new(&document),
        without_surface: 0,
        deformed: 0,
    };
    walk.run()?;
    if walk.without_surface > 0 {
        let count = walk.without_surface;
        file.warn(format_args!("ignored {count} primitives of points or lines, which have no surface"));
    }
    if walk.deformed > 0 {
        let count = walk.deformed;
        file.warn(format_args!(
            "{count} meshes are deformed by a skin or morph targets; their rest pose is used"
        ));
    }
    let sensor = walk.sensor_search.sensor()?;
    let mut mesh = Mesh::new(file, walk.surfaces, Up::Y, Some(1.0));
    if let Some((frame, camera)) = sensor {
        (mesh.own.sensor, mesh.camera) = (Some(frame), camera);
    }
    Ok(mesh)
}

struct Walk<'a, 'f, 'p> {
    document: &'a Document<'f>,
    palette: &'a mut Palette<'p>,
    /// The meshes used so far, by index.
    meshes: HashMap<usize, MeshReader<'a>>,
    surfaces: Surfaces<'f>,
    sensor_search: SensorSearch<'a>,
    without_surface: usize,
    deformed: usize,
}

impl Walk<'_, '_, '_> {
    /// Visits every node of the scene once. An explicit stack avoids deep recursion, and a flag for each node detects
    /// cycles.
    fn run(&mut self) -> Result<()> {
        let root = &self.document.root;
        let mut visited = vec![false; root.nodes.len()];
        let mut stack: Vec<_> = self.roots()?.into_iter().rev().map(|n| (n, DAffine3::IDENTITY)).collect();
        while let Some((index, parent)) = stack.pop() {
            let Some(node) = root.nodes.get(index) else {
                return Err(self
                    .document
                    .file
                    .refused(format!("refers to node {index}, which does not exist")));
            };
            let place = || self.document.place("node", index, node.name.as_ref());
            if std::mem::replace(&mut visited[index], true) {
                return Err(Error::input(
                    place(),
                    "is reached twice; the nodes must form a tree, without cycles or shared children",
                ));
            }
            let to_scene = parent * local_transform(node);
            if !to_scene.is_finite() {
                return Err(Error::input(place(), "has a transform that is not finite"));
            }
            self.sensor_search.note(index, node, to_scene);
            if let Some(mesh) = node.mesh {
                self.add_mesh(index, node, mesh.value(), to_scene)?;
            }
            let children = node.children.iter().flatten().rev();
            stack.extend(children.map(|child| (child.value(), to_scene)));
        }
        Ok(())
    }

    /// The root nodes of the default scene; in a file without scenes, the nodes without a parent.
    fn roots(&self) -> Result<Vec<usize>> {
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
        let (file, count) = (self.document.file, root.scenes.len());
        let Some(scene) = root.scenes.get(index) else {
            let problem = format!("its default scene is {index}, counted from 0, but there are {count}");
            return Err(file.refused(problem));
        };
        if count > 1 {
            let name = scene.name.as_ref().map(|n| format!(" (`{}`)", quoted(n))).unwrap_or_default();
            file.warn(format_args!("contains {count} scenes; scene {index}{name} is used"));
        }
        Ok(scene.nodes.iter().map(json::Index::value).collect())
    }

    fn add_mesh(
        &mut self,
        node_index: usize,
        node: &json::Node,
        mesh_index: usize,
        to_scene: DAffine3,
    ) -> Result<()> {
        let document = self.document;
        let place = || document.place("node", node_index, node.name.as_ref());
        let Some(declared) = document.root.meshes.get(mesh_index) else {
            return Err(Error::input(place(), format!("refers to mesh {mesh_index}, which does not exist")));
        };
        let mesh = match self.meshes.entry(mesh_index) {
            Entry::Occupied(opened) => opened.into_mut(),
            Entry::Vacant(place) => place.insert(MeshReader::open(document, mesh_index, declared)?),
        };
        self.without_surface += mesh.without_surface;
        self.deformed += usize::from(mesh.morphs || node.skin.is_some());
        let instances = Instances::of(document, node, &place)?;
        let copies = instances.as_ref().map_or(1, Instances::len);
        match mesh.triangles().checked_mul(copies) {
            Some(0) => return Ok(()),
            Some(triangles) => self.surfaces.reserve(triangles)?,
            None => return Err(too_many_triangles(document.file.path.display())),
        }
        let owner = node.name.as_deref().unwrap_or_default();
        self.surfaces.begin_part(owner);
        for primitive in &mesh.primitives {
            let material = self.palette.assign(primitive.material, owner);
            for copy in 0..copies {
                let to_scene = match &instances {
                    Some(instances) => to_scene * instances.transform(copy)?,
                    None => to_scene,
                };
                primitive.add_to(&mut self.surfaces, to_scene, material)?;
            }
        }
        Ok(())
    }
}

/// The node's matrix, or `T · R · S`, in f64.
fn local_transform(node: &json::Node) -> DAffine3 {
    if let Some(matrix) = node.matrix {
        return DAffine3::from_mat4(DMat4::from_cols_array(&matrix.map(f64::from)));
    }
    let vector = |v: [f32; 3]| DVec3::from_array(v.map(f64::from));
    let rotation = node.rotation.map_or(DQuat::IDENTITY, |q| DQuat::from_array(q.0.map(f64::from)));
    DAffine3::from_scale_rotation_translation(
        node.scale.map_or(DVec3::ONE, vector),
        unit_rotation(rotation),
        node.translation.map_or(DVec3::ZERO, vector),
    )
}

/// Normalises a quaternion, because files round them. Zero becomes the identity.
fn unit_rotation(rotation: DQuat) -> DQuat {
    let length = rotation.length();
    if length > 0.0 { rotation / length } else { DQuat::IDENTITY }
}
