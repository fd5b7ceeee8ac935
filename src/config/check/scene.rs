//! The scene, its materials and its reflectors.

use crate::config::range::{Check, conflict, ensure, file_name, finite, positive, within};
use crate::config::reader::{Fault, joined};
use crate::config::{ReflectorsTable, SceneTable};
use crate::scene::MaterialRule;
use crate::text::quoted;

impl SceneTable {
    pub(super) fn check(&self) -> Check {
        file_name("scene.mesh", self.mesh.as_ref())?;
        positive("scene.scale", self.scale)?;
        self.size.map_or(Ok(()), |size| positive("scene.size", size))?;
        ensure(self.size.is_none() || (self.unit.is_none() && self.scale == 1.0), || {
            conflict("scene.size", &["scene.unit", "scene.scale"], "`size` replaces `unit` and `scale`")
        })?;
        finite("scene.rotate", &self.rotate)?;
        finite("scene.translate", self.translate.as_ref().map_or(&[], |v| &v[..]))?;
        finite("scene.fit", self.fit.as_ref().map_or(&[], |v| &v[..]))?;
        ensure(self.fit.is_none() || self.translate.is_none(), || {
            conflict("scene.fit", &["scene.translate"], "`fit` and `translate` both place the mesh")
        })?;
        let Some(sensor) = &self.sensor else { return Ok(()) };
        let name = sensor.strip_prefix("camera:").or_else(|| sensor.strip_prefix("node:"));
        ensure(name.is_some_and(|name| !name.is_empty()), || {
            let expected = "expected \"camera:NAME\" or \"node:NAME\" of the glTF file";
            Fault::new("scene.sensor", format!("found \"{}\"; {expected}", quoted(sensor)))
        })?;
        ensure(self.fit.is_none(), || {
            conflict("scene.fit", &["scene.sensor"], "`fit` and `sensor` both place the mesh")
        })
    }
}

impl MaterialRule {
    pub(super) fn check(&self, path: &str) -> Check {
        ensure(!self.name.is_empty(), || {
            Fault::new(joined(path, "name"), "is empty; \"*\" matches every name")
        })?;
        for (key, share) in [("reflectance", self.reflectance), ("transmittance", self.transmittance)] {
            if let Some(share) = share {
                within(&joined(path, key), share, 0.0, 1.0, "a share of the amplitude from 0 to 1")?;
            }
        }
        Ok(())
    }
}

impl ReflectorsTable {
    pub(super) fn check(&self) -> Check {
        self.spacing.map_or(Ok(()), |spacing| positive("reflectors.spacing", spacing))?;
        within("reflectors.roughness", self.roughness, 0.0, 1e6, "from 0 to 1e6 wavelengths")
    }
}
