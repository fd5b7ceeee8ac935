//! The scene and its reflectors.

use crate::config::choices::{InputFile, Shading, SurfaceKind};
use crate::reflectors::OcclusionKind;
use crate::scene::{CommonMaterial, Unit, Up};
use serde::{Deserialize, Serialize};

/// `[scene]`: what is imaged, and where it is.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SceneTable {
    /// Mesh (`.obj`, `.gltf`, `.glb`, `.stl`, `.ply`) or reflectors (`.csv`).
    pub mesh: Option<InputFile>,
    /// Unit of the mesh's coordinates; left out: what the file itself says.
    pub unit: Option<Unit>,
    /// Instead of `unit` and `scale`: the longest side of the mesh's bounding box before it is rotated, m.
    pub size: Option<f64>,
    /// The mesh's upward axis; left out: `y` for glTF and OBJ, `z` for STL, `none` for PLY.
    pub up: Option<Up>,
    /// Factor applied first.
    pub scale: f64,
    /// Degrees about the array's x, then y, then z (fixed axes).
    pub rotate: [f64; 3],
    /// Translation of the mesh, m; left out: none. Excludes `fit`.
    pub translate: Option<[f64; 3]>,
    /// Where the centre of the mesh's bounding box goes, m. Excludes `translate`.
    pub fit: Option<[f64; 3]>,
    /// `camera:NAME` or `node:NAME` of a glTF file: the array is placed there and faces the same way.
    pub sensor: Option<String>,
    /// Which paths surfaces attenuate.
    pub occlusion: OcclusionKind,
    /// Surfaces that an echo may meet beyond the first: 0, 1 or 2.
    pub bounces: u32,
    /// Whether convex edges diffract.
    pub edges: bool,
    /// Of everything while the tones are played, m/s; left out: nothing moves.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub velocity: Option<[f64; 3]>,
    /// Instead of `mesh`: the files of an assembly. `size`, `scale`, `rotate`, `translate` and `fit` place all of it.
    pub parts: Vec<ScenePart>,
}

/// `[[scene.parts]]`: a mesh, and its place among the other parts, in the array's axes.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ScenePart {
    /// Mesh (`.obj`, `.gltf`, `.glb`, `.stl`, `.ply`).
    pub mesh: InputFile,
    /// Its name, for material rules and metrics; left out: that of the file, numbered where it would not be the first.
    pub name: Option<String>,
    /// What it is made of, unless a rule of `[[materials]]` says otherwise; left out: what the file says.
    pub material: Option<CommonMaterial>,
    /// As in `[scene]`.
    pub unit: Option<Unit>,
    /// As in `[scene]`.
    pub size: Option<f64>,
    /// As in `[scene]`.
    pub up: Option<Up>,
    /// As in `[scene]`.
    #[serde(default = "unchanged")]
    pub scale: f64,
    /// As in `[scene]`.
    #[serde(default)]
    pub rotate: [f64; 3],
    /// As in `[scene]`.
    pub translate: Option<[f64; 3]>,
    /// As in `[scene]`.
    pub fit: Option<[f64; 3]>,
    /// Its own velocity, m/s; left out: that of the scene.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub velocity: Option<[f64; 3]>,
}

/// The scale of a part that has none.
fn unchanged() -> f64 {
    1.0
}

impl SceneTable {
    /// The files that it names.
    pub fn files(&self) -> impl Iterator<Item = &InputFile> {
        self.mesh.iter().chain(self.parts.iter().map(|part| &part.mesh))
    }

    pub(crate) fn files_mut(&mut self) -> impl Iterator<Item = &mut InputFile> {
        self.mesh.iter_mut().chain(self.parts.iter_mut().map(|part| &mut part.mesh))
    }
}

impl Default for SceneTable {
    fn default() -> Self {
        Self {
            mesh: None,
            unit: None,
            size: None,
            up: None,
            scale: 1.0,
            rotate: [0.0; 3],
            translate: None,
            fit: None,
            sensor: None,
            occlusion: OcclusionKind::Speaker,
            bounces: 0,
            edges: false,
            velocity: None,
            parts: Vec::new(),
        }
    }
}

/// `[reflectors]`: how surfaces become point reflectors.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ReflectorsTable {
    /// Distance between reflectors, m; left out: `min(λ_c/2, half the lateral resolution)`.
    pub spacing: Option<f64>,
    /// How surfaces scatter.
    pub surface: SurfaceKind,
    /// Rms displacement of a rough surface, in wavelengths at the centre frequency.
    pub roughness: f64,
    /// How amplitude depends on the angle of incidence.
    pub shading: Shading,
    /// Seed of everything random about the reflectors.
    pub seed: u32,
}

impl Default for ReflectorsTable {
    fn default() -> Self {
        Self {
            spacing: None,
            surface: SurfaceKind::Diffuse,
            roughness: 0.125,
            shading: Shading::Lambert,
            seed: 1,
        }
    }
}
