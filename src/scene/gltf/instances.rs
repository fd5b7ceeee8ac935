//! Many copies of a node's mesh: the extension EXT_mesh_gpu_instancing.

use ::gltf::json;
use glam::{DAffine3, DQuat, DVec3};

use super::accessor::{self, Accessor};
use super::container::Document;
use crate::error::{Error, Result};
use crate::text::quoted;

pub(super) const NAME: &str = "EXT_mesh_gpu_instancing";

/// The copies of a node's mesh, each with its own transform in the node's frame.
pub(super) struct Instances<'a> {
    count: usize,
    translation: Option<Accessor<'a>>,
    rotation: Option<Accessor<'a>>,
    scale: Option<Accessor<'a>>,
}

impl<'a> Instances<'a> {
    /// The copies that a node declares; `None` when it does not use the extension.
    pub(super) fn of(
        document: &'a Document<'_>,
        node: &json::Node,
        place: &impl Fn() -> String,
    ) -> Result<Option<Self>> {
        let Some(extension) = node.extensions.as_ref().and_then(|e| e.others.get(NAME)) else {
            return Ok(None);
        };
        let refused = |problem: String| Error::input(place(), format!("{NAME}: {problem}"));
        let attributes = extension.get("attributes").and_then(serde_json::Value::as_object);
        let Some(attributes) = attributes.filter(|attributes| !attributes.is_empty()) else {
            return Err(refused("has no attributes; TRANSLATION, ROTATION or SCALE was expected".to_owned()));
        };
        let mut count = None;
        let mut instances = Self { count: 0, translation: None, rotation: None, scale: None };
        for (name, index) in attributes {
            let index = index.as_u64().and_then(|index| usize::try_from(index).ok());
            let index = index
                .ok_or_else(|| refused(format!("`{}` must be the index of an accessor", quoted(name))))?;
            let accessor = accessor::find(document, index)?;
            if accessor.buffer_view.is_none() {
                // This also keeps a small file from requesting millions of copies.
                return Err(refused(format!(
                    "`{}` has no buffer view: all copies would be at the same place",
                    quoted(name)
                )));
            }
            let found = accessor.count.0;
            if let Some(other) = count.filter(|&other| other != found) {
                return Err(refused(format!(
                    "`{}` has {found} values, another attribute has {other}",
                    quoted(name)
                )));
            }
            count = Some(found);
            match name.as_str() {
                "TRANSLATION" => instances.translation = Some(Accessor::offsets(document, index)?),
                "ROTATION" => instances.rotation = Some(Accessor::quaternions(document, index)?),
                "SCALE" => instances.scale = Some(Accessor::offsets(document, index)?),
                _ => {}
            }
        }
        // A count beyond usize exceeds every limit anyway.
        instances.count = usize::try_from(count.unwrap_or(0)).unwrap_or(usize::MAX);
        Ok(Some(instances))
    }

    pub(super) fn len(&self) -> usize {
        self.count
    }

    /// The transform from the frame of copy `i` to the node's.
    pub(super) fn transform(&self, i: usize) -> Result<DAffine3> {
        let vector = |values: &Option<Accessor<'_>>, otherwise| {
            values.as_ref().map_or(Ok(otherwise), |values| values.vector(i))
        };
        let rotation = self.rotation.as_ref().map_or(Ok(DQuat::IDENTITY), |values| values.quaternion(i))?;
        Ok(DAffine3::from_scale_rotation_translation(
            vector(&self.scale, DVec3::ONE)?,
            super::unit_rotation(rotation),
            vector(&self.translation, DVec3::ZERO)?,
        ))
    }
}
