//! Reads mesh files into triangles in the array's frame, and finds what a straight path between two points crosses.
//!
//! Takes OBJ, glTF, STL or PLY and gives a [`Scene`]: triangles in m, their acoustic materials, and the tree behind
//! [`Scene::transmittance`] and [`Scene::crossings`]. Sound waves are not modelled here: a surface transmits one share
//! of the incident amplitude and reflects another, independent of frequency and angle.
//!
//! # Example
//! An angle bracket in millimetres with z up, placed 0.9 m in front of the array; its rib hides what is behind it:
//! ```
//! use holosonar::glam::DVec3;
//! use holosonar::scene::{LoadOptions, Scene, Unit, Up};
//! use std::path::Path;
//!
//! let mut options = LoadOptions::default();
//! (options.unit, options.up) = (Some(Unit::Millimetre), Some(Up::Z));
//! options.fit = Some(DVec3::new(0.0, 0.0, 0.9));
//! let scene = Scene::load(Path::new("scenes/meshes/bracket.obj"), &options)?;
//! let (low, high) = scene.bounds().expect("a mesh with triangles");
//! assert!((0.5 * (low + high) - DVec3::new(0.0, 0.0, 0.9)).length() < 1e-9);
//! assert_eq!(scene.transmittance(DVec3::ZERO, low), 1.0);
//! assert_eq!(scene.transmittance(DVec3::ZERO, DVec3::new(0.0, 0.0, 2.0)), 0.0);
//! # Ok::<(), holosonar::error::Error>(())
//! ```

mod assembly;
mod files;
mod gltf;
mod look;
mod material;
mod obj;
mod occlusion;
mod placement;
mod ply;
mod polygon;
mod stl;
mod surfaces;
mod triangle;

#[cfg(test)]
#[path = "scene/tests/assembly.rs"]
mod assembly_tests;
#[cfg(test)]
#[path = "scene/tests/fixtures.rs"]
pub(crate) mod fixtures;
#[cfg(test)]
#[path = "scene/tests/gltf_extensions.rs"]
mod gltf_extension_tests;
#[cfg(test)]
#[path = "scene/tests/gltf.rs"]
mod gltf_tests;
#[cfg(test)]
#[path = "scene/tests/shipped.rs"]
mod shipped_tests;

use std::path::Path;

use glam::DVec3;

pub use assembly::PartFile;
pub use material::{CommonMaterial, Material, MaterialRule};
pub use occlusion::Crossing;
pub(crate) use placement::metres;
pub use placement::{LoadOptions, MeshFrame, Sensor, Unit, Up};
pub use triangle::Triangle;

use crate::error::{Error, Result};
use crate::files::{check_inputs, extension};
use crate::progress::{Observer, Silent};
use files::MeshFile;
pub(crate) use files::why_no_mesh;
use material::Palette;
use occlusion::SurfaceTree;
pub use surfaces::{BYTES_PER_TRIANGLE, Part};
use surfaces::{MOST_TRIANGLES, Surfaces, too_many_triangles};

/// Maximum distance of a vertex from the origin, m. Sound does not reach so far: a larger number means a wrong unit
/// or a damaged file.
pub const FARTHEST: f64 = 1e9;

/// Extensions of the mesh files that [`Scene::load`] reads, in lower case.
pub const EXTENSIONS: [&str; 5] = ["obj", "gltf", "glb", "stl", "ply"];

/// The perspective camera at which [`Sensor::Camera`] placed the array.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CameraView {
    /// Vertical field of view, degrees.
    pub vertical_field_of_view: f64,
    /// Aspect ratio of the image, width over height, where the file gives one.
    pub aspect_ratio: Option<f64>,
}

/// Surfaces in the array's frame (x right, y down, z away from the array; m), and queries for what is between two points.
#[derive(Debug)]
pub struct Scene {
    triangles: Vec<Triangle>,
    parts: Vec<Part>,
    materials: Vec<Material>,
    tree: SurfaceTree,
    camera: Option<CameraView>,
    frame: Option<MeshFrame>,
}

/// The contents of a mesh file, in its own frame and unit.
struct Mesh<'a> {
    surfaces: Surfaces<'a>,
    own: OwnFrame<'a>,
    camera: Option<CameraView>,
}

/// What a mesh file says of its own frame.
struct OwnFrame<'a> {
    file: MeshFile<'a>,
    /// Where the file says it.
    metres_per_unit: Option<f64>,
    /// The default of the format.
    up: Up,
    /// From the file's frame to that of the requested sensor, if one was requested.
    sensor: Option<glam::DAffine3>,
}

impl<'a> Mesh<'a> {
    /// Reads a file by its extension.
    fn read(file: MeshFile<'a>, palette: &mut Palette<'_>) -> Result<Self> {
        let load = match extension(file.path).as_str() {
            "obj" => obj::load,
            "gltf" | "glb" => gltf::load,
            "stl" => stl::load,
            "ply" => ply::load,
            other => {
                let why = why_no_mesh(other).unwrap_or("has an unsupported mesh format");
                let expected = "expected a file named .obj, .gltf, .glb, .stl or .ply";
                return Err(file.refused(format!("{why}; {expected}")));
            }
        };
        let mesh = load(file, palette)?;
        // A material file may be missing, but an output may not take its place.
        check_inputs()?;
        if file.observer.should_stop() {
            return Err(Error::Interrupted);
        }
        Ok(mesh)
    }

    /// The surfaces of a file in a format with this upward axis, which may say its unit.
    fn new(file: MeshFile<'a>, surfaces: Surfaces<'a>, up: Up, metres_per_unit: Option<f64>) -> Self {
        Self { surfaces, own: OwnFrame { file, metres_per_unit, up, sensor: None }, camera: None }
    }
}

impl Scene {
    /// Reads a mesh file (`.obj`, `.gltf`, `.glb`, `.stl`, `.ply`) and places it in front of the array according to
    /// `options`.
    ///
    /// Files that the mesh refers to are read only from its own folder. Textures are not read.
    ///
    /// - Units: the result is in m.
    /// - Cost: `O(n log n)` in the number of triangles; about a second for a million.
    ///
    /// # Errors
    /// [`Error::InvalidInput`] when the file is missing, malformed, of an unsupported format, without triangles or without
    /// a unit, when it takes more memory than [`LoadOptions::memory`], or when the options contradict one another or the
    /// file; the message names the place.
    pub fn load(path: &Path, options: &LoadOptions) -> Result<Self> {
        Self::load_with(path, options, &Silent)
    }

    /// [`Scene::load`], reporting its progress to `observer`, which may stop it.
    ///
    /// # Errors
    /// As [`Scene::load`]; `Error::Interrupted` when the observer asks to stop.
    pub fn load_with(path: &Path, options: &LoadOptions, observer: &dyn Observer) -> Result<Self> {
        Self::load_placed(path, options, observer, &mut |_, _| Ok(None))
    }

    /// [`Scene::load_with`], of which the position follows from the size: `place` takes the lower and upper corner of the
    /// bounding box, turned and in m, and gives the place of the box's centre; `None` for where the options say.
    ///
    /// # Errors
    /// As [`Scene::load_with`], and those of `place`.
    pub fn load_placed(
        path: &Path,
        options: &LoadOptions,
        observer: &dyn Observer,
        place: &mut dyn FnMut(DVec3, DVec3) -> Result<Option<DVec3>>,
    ) -> Result<Self> {
        options.check()?;
        let file = MeshFile { path, options, observer };
        let mut palette = Palette::new(&options.materials)?;
        let Mesh { surfaces, own, camera } = Mesh::read(file, &mut palette)?;
        let materials = palette.finish(path.display(), observer);
        let (mut triangles, parts) = surfaces.finish()?;
        let frame = place_triangles(&mut triangles, &own, options, place)?;
        // `build` names only the triangle at fault; the file is added here.
        let scene = Self::build(triangles, materials, observer).map_err(|error| {
            let place = format!("{}, {}", path.display(), error.place().unwrap_or_default());
            error.at(place)
        })?;
        Ok(Self { parts, camera, frame: Some(frame), ..scene })
    }

    /// Makes a scene of triangles in the array's frame, m. It may be empty. Triangles without area are allowed; they
    /// are never hit.
    ///
    /// Cost: `O(n log n)`.
    ///
    /// # Errors
    /// [`Error::InvalidInput`] when a vertex is not finite or beyond [`FARTHEST`], when a triangle's material does not
    /// exist, or when a reflectance or transmittance is outside 0..1. [`Error::OutOfMemory`] when the tree does not fit
    /// in memory.
    pub fn new(triangles: Vec<Triangle>, materials: Vec<Material>) -> Result<Self> {
        Self::build(triangles, materials, &Silent)
    }

    /// [`Scene::new`], which the observer may stop.
    fn build(triangles: Vec<Triangle>, materials: Vec<Material>, observer: &dyn Observer) -> Result<Self> {
        if triangles.len() > MOST_TRIANGLES {
            return Err(too_many_triangles("scene"));
        }
        for material in &materials {
            material.check()?;
        }
        for (i, triangle) in triangles.iter().enumerate() {
            let refused = |problem| Err(Error::input(format!("triangle {i}"), problem));
            // Written so that NaN fails too.
            if !triangle.vertices.iter().all(|v| v.abs().max_element() <= FARTHEST && v.is_finite()) {
                return refused(format!(
                    "has a vertex that is not finite or is beyond {FARTHEST:e} m; check the unit and scale"
                ));
            }
            let (material, count) = (triangle.material as usize, materials.len());
            if material >= count {
                return refused(format!(
                    "refers to material {material}, counted from 0, but there are {count}"
                ));
            }
        }
        let tree = SurfaceTree::new(&triangles, observer)?;
        Ok(Self { triangles, parts: Vec::new(), materials, tree, camera: None, frame: None })
    }

    /// The triangles, in the order of the file.
    pub fn triangles(&self) -> &[Triangle] {
        &self.triangles
    }

    /// The parts by name, in the order of their triangles: the nodes, objects or solids of a file, or the files of an
    /// assembly. None for a scene that was not loaded.
    pub fn parts(&self) -> &[Part] {
        &self.parts
    }

    /// The materials, indexed by [`Triangle::material`].
    pub fn materials(&self) -> &[Material] {
        &self.materials
    }

    /// Bytes that the scene takes: its triangles and the tree over them.
    pub fn memory_bytes(&self) -> u64 {
        size_of_val(&self.triangles[..]) as u64 + self.tree.memory_bytes()
    }

    /// The perspective camera of the file at which the array was placed, if any.
    pub fn camera(&self) -> Option<CameraView> {
        self.camera
    }

    /// What the file says of its own frame; `None` for a scene that was not loaded.
    pub fn frame(&self) -> Option<MeshFrame> {
        self.frame
    }

    /// Lower and upper corner of the bounding box of all triangles, m; `None` for an empty scene.
    pub fn bounds(&self) -> Option<(DVec3, DVec3)> {
        triangle::bounds(&self.triangles)
    }

    /// Area of all triangles, one side of each, m².
    pub fn surface_area(&self) -> f64 {
        self.triangles.iter().map(Triangle::area).sum()
    }
}

/// Transforms triangles from the file's frame to the array's.
fn place_triangles(
    triangles: &mut [Triangle],
    own: &OwnFrame<'_>,
    options: &LoadOptions,
    place: placement::Place<'_>,
) -> Result<MeshFrame> {
    let (placement, frame) = placement::placement(own, triangles, options, place)?;
    for triangle in triangles {
        triangle.vertices = triangle.vertices.map(|v| placement.transform_point3(v));
    }
    Ok(frame)
}
