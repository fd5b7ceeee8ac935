//! The scene, its materials and its reflectors.

use crate::acquisition::PropagationModel;
use crate::config::choices::{Shading, SurfaceKind};
use crate::config::range::{Check, conflict, ensure, file_name, finite, none_typed, positive, within};
use crate::config::reader::{Fault, joined};
use crate::config::{ReflectorsTable, RunFile, SceneTable};
use crate::files::extension;
use crate::scene::{MaterialRule, Unit};
use crate::text::quoted;
use crate::wave::GeometryKind;
use std::collections::HashSet;

impl SceneTable {
    pub(super) fn check(&self) -> Check {
        file_name("scene.mesh", self.mesh.as_ref())?;
        let placing = Placing {
            table: "scene",
            partners: [&["scene.unit", "scene.scale"], &["scene.translate"]],
            size: (self.size, self.unit, self.scale),
            rotate: self.rotate,
            places: [self.translate, self.fit],
        };
        placing.check()?;
        self.check_parts()?;
        let expected = "0, 1 or 2 surfaces beyond the first";
        within("scene.bounces", self.bounces.into(), 0.0, 2.0, expected)?;
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

    /// The parts, and what the keys of the table mean for them.
    fn check_parts(&self) -> Check {
        if self.parts.is_empty() {
            return Ok(());
        }
        ensure(self.mesh.is_none(), || {
            conflict("scene.mesh", &["scene.parts"], "`mesh` and `parts` both say what is imaged")
        })?;
        let of_files = [
            ("scene.unit", self.unit.is_some()),
            ("scene.up", self.up.is_some()),
            ("scene.sensor", self.sensor.is_some()),
        ];
        none_typed(&of_files, |key| {
            Fault::new(key, "has no meaning for several parts; give it to each [[scene.parts]]")
        })?;
        let mut names = HashSet::new();
        for (index, part) in self.parts.iter().enumerate() {
            let path = format!("scene.parts[{index}]");
            file_name(&joined(&path, "mesh"), Some(&part.mesh))?;
            let name = part.name.as_deref().unwrap_or_default();
            ensure(!name.is_empty() && names.insert(name), || {
                let problem = format!("`{}` is empty or the name of an earlier part", quoted(name));
                Fault::new(joined(&path, "name"), problem)
            })?;
            let placing = Placing {
                table: &path,
                partners: [&[], &[]],
                size: (part.size, part.unit, part.scale),
                rotate: part.rotate,
                places: [part.translate, part.fit],
            };
            placing.check()?;
        }
        Ok(())
    }
}

/// The keys by which a mesh is placed, of `[scene]` or of a part.
struct Placing<'p> {
    table: &'p str,
    /// The keys that exclude `size`, and the one that excludes `fit`.
    partners: [&'static [&'static str]; 2],
    size: (Option<f64>, Option<Unit>, f64),
    rotate: [f64; 3],
    /// `translate` and `fit`.
    places: [Option<[f64; 3]>; 2],
}

impl Placing<'_> {
    fn check(&self) -> Check {
        let key = |name| joined(self.table, name);
        let (size, unit, scale) = self.size;
        positive(&key("scale"), scale)?;
        size.map_or(Ok(()), |size| positive(&key("size"), size))?;
        ensure(size.is_none() || (unit.is_none() && scale == 1.0), || {
            conflict(&key("size"), self.partners[0], "`size` replaces `unit` and `scale`")
        })?;
        finite(&key("rotate"), &self.rotate)?;
        for (name, place) in ["translate", "fit"].into_iter().zip(&self.places) {
            finite(&key(name), place.as_ref().map_or(&[], |v| &v[..]))?;
        }
        ensure(self.places.iter().flatten().count() < 2, || {
            conflict(&key("fit"), self.partners[1], "`fit` and `translate` both place the mesh")
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

impl RunFile {
    /// What bounces and edges cannot be simulated with.
    pub(super) fn check_bounces(&self) -> Check {
        let (key, what) = match (self.scene.bounces, self.scene.edges) {
            (0, false) => return Ok(()),
            (0, true) => ("scene.edges", "edges"),
            _ => ("scene.bounces", "bounces"),
        };
        let list = self.scene.mesh.as_ref().is_some_and(|mesh| extension(&mesh.path) == "csv");
        let refused: [(bool, &'static [&'static str], &str); 7] = [
            (list, &["scene.mesh"], "need surfaces, and a list of reflectors has none"),
            (
                self.reflectors.surface == SurfaceKind::Smooth,
                &["reflectors.surface"],
                "are not for the reflectors of a \"smooth\" surface, which are a mirror with edges by themselves; use \"rough\" \
                 and a small roughness, whose mirror images are exact",
            ),
            (
                self.reflectors.shading == Shading::None,
                &["reflectors.shading"],
                "have amplitudes by energy, which takes the cosines of shading = \"lambert\"",
            ),
            (
                self.array.geometry != GeometryKind::FixedSource,
                &["array.geometry"],
                "need a speaker that stays in its place; a scan has other mirror images and angles at each of its places",
            ),
            (
                self.array.speaker_radius > 0.0,
                &["array.speaker_radius"],
                "are simulated for a speaker that radiates alike in all directions",
            ),
            (
                self.detection.model == PropagationModel::Linear,
                &["detection.model"],
                "have exact paths only; images are too near for the far-field approximation",
            ),
            (self.medium.interface.is_some(), &["medium.interface"], "are simulated in one medium"),
        ];
        let found = refused.into_iter().find(|(found, _, _)| *found);
        found.map_or(Ok(()), |(_, partners, why)| Err(conflict(key, partners, &format!("{what} {why}"))))
    }
}
