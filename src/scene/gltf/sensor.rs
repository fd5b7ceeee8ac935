//! The position of the array when it is placed at a camera or a node of the file.

use ::gltf::json;
use glam::{DAffine3, DMat3, DVec3};

use super::super::files::list_names;
use super::super::{CameraView, Sensor};
use super::container::Document;
use crate::error::{Error, Result};
use crate::text::quoted;

/// Finds the requested sensor while the nodes are visited.
pub(super) struct SensorSearch<'a> {
    document: &'a Document<'a>,
    wanted: Option<&'a Sensor>,
    /// The nodes that match it, and their cameras.
    found: Vec<(usize, DAffine3, Option<CameraView>)>,
    /// Names of the file that a sensor of the requested kind can have.
    candidates: Vec<&'a String>,
}

impl<'a> SensorSearch<'a> {
    pub(super) fn new(document: &'a Document<'a>) -> Self {
        let wanted = document.file.options.sensor.as_ref();
        Self { document, wanted, found: Vec::new(), candidates: Vec::new() }
    }

    /// Checks a node.
    pub(super) fn note(&mut self, index: usize, node: &'a json::Node, to_scene: DAffine3) {
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
            self.found.push((index, to_scene, view));
        }
        self.candidates.extend(names.into_iter().flatten());
    }

    /// The transform from the scene to the sensor's frame (x right, y down, z ahead) and its camera, if a sensor is
    /// requested.
    pub(super) fn sensor(self) -> Result<Option<(DAffine3, Option<CameraView>)>> {
        let Some(wanted) = self.wanted else { return Ok(None) };
        let (kind, name) = match wanted {
            Sensor::Camera(name) => ("camera", name),
            Sensor::Node(name) => ("node", name),
        };
        let Some(&(index, to_scene, view)) = self.found.first() else {
            let names = list_names(self.candidates);
            let names = if names.is_empty() { "none" } else { &names };
            let problem = format!("its scene has no {kind} named `{}`; available: {names}", quoted(name));
            return Err(self.document.file.refused(problem));
        };
        if self.found.len() > 1 {
            let count = self.found.len();
            self.document
                .file
                .warn(format_args!("{count} nodes match the sensor {kind}:{name}; the first is used"));
        }
        // A camera has a position and axes but no size: scale and shear of its node do not apply.
        let [x, y, z] = [DVec3::X, DVec3::Y, DVec3::Z].map(|axis| to_scene.transform_vector3(axis));
        let (back, right) = (z.normalize_or_zero(), y.cross(z).normalize_or_zero());
        if back == DVec3::ZERO || right == DVec3::ZERO || x == DVec3::ZERO {
            let node = self.document.root.nodes.get(index).and_then(|n| n.name.as_ref());
            return Err(Error::input(
                self.document.place("node", index, node),
                "has a scale of 0 and so no viewing direction",
            ));
        }
        let up = back.cross(right);
        // Rows are the array's axes: x right, y down, z ahead.
        let rotation = DMat3::from_cols(right, -up, -back).transpose();
        let frame = DAffine3::from_mat3(rotation) * DAffine3::from_translation(-to_scene.translation);
        Ok(Some((frame, view)))
    }
}
