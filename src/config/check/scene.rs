//! The scene and its reflectors.

use crate::config::range::{Check, clash, finite, named, not_negative, positive, within};
use crate::config::reader::{Fault, joined};
use crate::config::wording::quoted;
use crate::config::{ReflectorsTable, SceneTable};
use crate::scene::MaterialRule;

impl SceneTable {
    pub(super) fn check(&self) -> Check {
        named("scene.mesh", self.mesh.as_ref())?;
        positive("scene.scale", self.scale)?;
        finite("scene.rotate", &self.rotate)?;
        finite("scene.translate", self.translate.as_ref().map_or(&[], |v| &v[..]))?;
        finite("scene.fit", self.fit.as_ref().map_or(&[], |v| &v[..]))?;
        if self.fit.is_some() && self.translate.is_some() {
            return Err(clash(
                "scene.fit",
                &["scene.translate"],
                "`fit` and `translate` both place the mesh",
            ));
        }
        let Some(sensor) = &self.sensor else { return Ok(()) };
        let name = sensor.strip_prefix("camera:").or_else(|| sensor.strip_prefix("node:"));
        if name.is_none_or(str::is_empty) {
            return Err(Fault::new(
                "scene.sensor",
                format!(
                    "found \"{}\"; expected \"camera:NAME\" or \"node:NAME\" of the glTF file",
                    quoted(sensor)
                ),
            ));
        }
        if self.fit.is_some() {
            return Err(clash(
                "scene.fit",
                &["scene.sensor"],
                "`fit` and `sensor` both say where the mesh stands",
            ));
        }
        Ok(())
    }
}

impl MaterialRule {
    pub(super) fn check(&self, path: &str) -> Check {
        if self.name.is_empty() {
            return Err(Fault::new(joined(path, "name"), "is empty; \"*\" matches every name"));
        }
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
        not_negative("reflectors.roughness", self.roughness)
    }
}
