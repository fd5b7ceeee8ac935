//! Scenes of several mesh files: each is placed as if it were alone, and then all of them together.

use std::path::PathBuf;

use super::files::MeshFile;
use super::material::{CommonMaterial, Palette};
use super::placement::{LoadOptions, Up};
use super::surfaces::{BYTES_PER_TRIANGLE, Part};
use super::{Mesh, OwnFrame, Scene, place_triangles};
use crate::error::{Error, Result};
use crate::progress::Observer;
use crate::text::quoted;

/// A mesh file that is one part of an assembly.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct PartFile {
    /// The mesh.
    pub path: PathBuf,
    /// Its name in the assembly, by which material rules and metrics find it.
    pub name: String,
    /// How it is placed among the others. `materials` and `memory` are those of the assembly.
    pub options: LoadOptions,
    /// What it is made of where no rule of the assembly says otherwise; `None` for the file's own materials.
    pub material: Option<CommonMaterial>,
}

impl Scene {
    /// Reads the parts of an assembly, each placed by its own options in the array's axes, and then places them together by
    /// `options`: scale (or `size`), rotation, and translation or `fit`. Material rules match the names of parts too.
    ///
    /// A material is named after its part: `NAME`, or `NAME/MATERIAL` where the part has several.
    ///
    /// Cost: that of [`Scene::load`] for all triangles.
    ///
    /// # Errors
    /// As [`Scene::load`]; `unit`, `up` and `sensor` in `options`, which belong to a file.
    pub fn assemble(parts: &[PartFile], options: &LoadOptions, observer: &dyn Observer) -> Result<Self> {
        options.check()?;
        let of_files = [
            ("unit", options.unit.is_some()),
            ("up", options.up.is_some()),
            ("sensor", options.sensor.is_some()),
        ];
        if let Some((name, _)) = of_files.into_iter().find(|(_, given)| *given) {
            return Err(Error::input(name, "has no meaning for several parts; give it to each of them"));
        }
        let mut palette = Palette::new(&options.materials)?;
        let (mut triangles, mut named) = (Vec::new(), Vec::new());
        for part in parts {
            let place = |error: Error| {
                let inner = error.place().map(|place| format!(", {place}")).unwrap_or_default();
                error.at(format!("part `{}`{inner}", quoted(&part.name)))
            };
            let taken = triangles.len() as u64 * BYTES_PER_TRIANGLE;
            let own = LoadOptions {
                memory: options.memory.map(|limit| limit.saturating_sub(taken)),
                ..part.options.clone()
            };
            own.check().map_err(place)?;
            palette.begin_part(&part.name, part.material);
            let file = MeshFile { path: &part.path, options: &own, observer };
            let mesh = Mesh::read(file, &mut palette).map_err(place)?;
            palette.end_part();
            let (mut found, _) = mesh.surfaces.finish().map_err(place)?;
            place_triangles(&mut found, &mesh.own, &own, &mut |_, _| Ok(None)).map_err(place)?;
            let first = triangles.len();
            triangles.try_reserve_exact(found.len()).map_err(|_| file.does_not_fit("its triangles"))?;
            triangles.append(&mut found);
            named.push(Part { name: part.name.clone(), triangles: first..triangles.len() });
        }
        let file = MeshFile { path: "assembly".as_ref(), options, observer };
        let own = OwnFrame { file, metres_per_unit: Some(1.0), up: Up::None, sensor: None };
        place_triangles(&mut triangles, &own, options, &mut |_, _| Ok(None))?;
        let materials = palette.finish("[[scene.parts]]", observer);
        let scene = Self::build(triangles, materials, observer).map_err(|error| {
            let place = format!("[[scene.parts]], {}", error.place().unwrap_or_default());
            error.at(place)
        })?;
        Ok(Self { parts: named, ..scene })
    }
}
