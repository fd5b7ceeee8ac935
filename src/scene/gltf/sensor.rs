//! The position of the array when it is placed at a camera or a node of the file.

use ::gltf::json;
use glam::{DAffine3, DMat3, DVec3};

use super::super::{CameraView, Sensor};
use super::container::Document;
use crate::error::{Error, Result};
use crate::progress::Observer;

/// Maximum number of names in a message.
const MOST_NAMES: usize = 8;

/// Finds the requested sensor while the nodes are visited.
pub(super) struct SensorSearch<'a> {
    document: &'a Document,
    wanted: Option<&'a Sensor>,
    /// The nodes that match it, and their cameras.
    found: Vec<(usize, DAffine3, Option<CameraView>)>,
    /// Names of the file that a sensor of the requested kind can have.
    candidates: Vec<String>,
}

impl<'a> SensorSearch<'a> {
    pub(super) fn new(document: &'a Document, wanted: Option<&'a Sensor>) -> Self {
        Self { document, wanted, found: Vec::new(), candidates: Vec::new() }
    }

    /// Checks a node.
    pub(super) fn note(&mut self, index: usize, node: &json::Node, to_scene: DAffine3) {
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
        let room = (MOST_NAMES + 1).saturating_sub(self.candidates.len());
        self.candidates.extend(names.into_iter().flatten().take(room).map(|name| format!("`{name}`")));
    }

    /// The transform from the scene to the sensor's frame (x right, y down, z ahead) and its camera, if a sensor is
    /// requested.
    pub(super) fn sensor(
        mut self,
        observer: &dyn Observer,
    ) -> Result<Option<(DAffine3, Option<CameraView>)>> {
        let Some(wanted) = self.wanted else { return Ok(None) };
        let (kind, name) = match wanted {
            Sensor::Camera(name) => ("camera", name),
            Sensor::Node(name) => ("node", name),
        };
        let Some(&(index, to_scene, view)) = self.found.first() else {
            if let Some(last) = self.candidates.get_mut(MOST_NAMES) {
                "...".clone_into(last);
            }
            let there =
                if self.candidates.is_empty() { "none".to_owned() } else { self.candidates.join(", ") };
            return Err(Error::input(
                self.document.name(),
                format!("its scene has no {kind} named `{name}`; available: {there}"),
            ));
        };
        if self.found.len() > 1 {
            observer.warn(&format!(
                "{}: {} nodes match the sensor {kind}:{name}; the first is used",
                self.document.name(),
                self.found.len()
            ));
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
