//! The triangles of a glTF mesh, read from its buffers without a copy.

use ::gltf::json;
use glam::DAffine3;
use json::mesh::{Mode, Primitive, Semantic};
use json::validation::Checked;

use super::super::surfaces::Surfaces;
use super::accessor::Accessor;
use super::container::{Document, unsupported_extension};
use crate::error::{Error, Result};

/// Reads a mesh; opened once however many nodes use it.
pub(super) struct MeshReader<'a> {
    /// Its primitives that have triangles. Every visit of one adds triangles, whose number is limited, so the work is
    /// bounded.
    pub(super) primitives: Vec<PrimitiveReader<'a>>,
    /// Number of primitives of points or lines.
    pub(super) without_surface: usize,
    /// Whether a primitive has morph targets.
    pub(super) morphs: bool,
}

impl<'a> MeshReader<'a> {
    pub(super) fn open(document: &'a Document<'_>, index: usize, mesh: &'a json::Mesh) -> Result<Self> {
        let mut opened = Self { primitives: Vec::new(), without_surface: 0, morphs: false };
        for (i, primitive) in mesh.primitives.iter().enumerate() {
            opened.morphs |= primitive.targets.as_ref().is_some_and(|targets| !targets.is_empty());
            let place = || format!("{}, primitive {i}", document.place("mesh", index, mesh.name.as_ref()));
            match PrimitiveReader::open(document, primitive, &place)? {
                Some(reader) if reader.triangles > 0 => opened.primitives.push(reader),
                Some(_) => {}
                None => opened.without_surface += 1,
            }
        }
        Ok(opened)
    }

    /// Number of triangles.
    pub(super) fn triangles(&self) -> usize {
        self.primitives.iter().map(|primitive| primitive.triangles).sum()
    }
}

/// Reads a primitive: triangles of one material.
pub(super) struct PrimitiveReader<'a> {
    place: String,
    pub(super) material: Option<usize>,
    mode: Mode,
    positions: Accessor<'a>,
    indices: Option<Accessor<'a>>,
    triangles: usize,
}

impl<'a> PrimitiveReader<'a> {
    /// `None` for points and lines.
    fn open(
        document: &'a Document<'_>,
        primitive: &Primitive,
        place: &impl Fn() -> String,
    ) -> Result<Option<Self>> {
        let Checked::Valid(mode) = primitive.mode else {
            return Err(Error::input(place(), "its mode must be a number from 0 to 6"));
        };
        if matches!(mode, Mode::Points | Mode::Lines | Mode::LineLoop | Mode::LineStrip) {
            return Ok(None);
        }
        let material = primitive.material.map(|material| material.value());
        if let Some(missing) = material.filter(|&m| m >= document.root.materials.len()) {
            return Err(Error::input(place(), format!("refers to material {missing}, which does not exist")));
        }
        let Some(accessor) = primitive.attributes.get(&Checked::Valid(Semantic::Positions)) else {
            return Err(Error::input(place(), "has no attribute POSITION"));
        };
        let compressed = primitive.extensions.as_ref().is_some_and(|e| {
            e.others.contains_key("KHR_draco_mesh_compression")
                && document.root.accessors.get(accessor.value()).is_some_and(|a| a.buffer_view.is_none())
        });
        if compressed {
            return Err(unsupported_extension(place(), "KHR_draco_mesh_compression"));
        }
        let positions = Accessor::positions(document, accessor.value())?;
        let indices =
            primitive.indices.map(|index| Accessor::indices(document, index.value())).transpose()?;
        let corners = indices.as_ref().unwrap_or(&positions).len();
        let triangles = match mode {
            Mode::TriangleStrip | Mode::TriangleFan => corners.saturating_sub(2),
            _ if corners.is_multiple_of(3) => corners / 3,
            _ => {
                let problem = "which is not a multiple of 3; the file may be cut short";
                return Err(Error::input(place(), format!("has {corners} corners, {problem}")));
            }
        };
        Ok(Some(Self { place: place(), material, mode, positions, indices, triangles }))
    }

    /// Adds its triangles, transformed to the scene's frame.
    pub(super) fn add_to(
        &self,
        surfaces: &mut Surfaces<'_>,
        to_scene: DAffine3,
        material: u32,
    ) -> Result<()> {
        // A mirrored node reverses the winding of its triangles.
        let mirrored = to_scene.matrix3.determinant() < 0.0;
        for triangle in 0..self.triangles {
            let mut vertices = [glam::DVec3::ZERO; 3];
            for (vertex, corner) in vertices.iter_mut().zip(self.corners_of(triangle)) {
                *vertex = to_scene.transform_point3(self.positions.vector(self.vertex(corner)?)?);
            }
            if mirrored {
                vertices.swap(1, 2);
            }
            surfaces.add(vertices, material)?;
        }
        Ok(())
    }

    /// The corners of a triangle, as positions along the primitive.
    fn corners_of(&self, triangle: usize) -> [usize; 3] {
        match self.mode {
            // Every second triangle of a strip has the opposite winding.
            Mode::TriangleStrip if triangle % 2 == 1 => [triangle, triangle + 2, triangle + 1],
            Mode::TriangleStrip => [triangle, triangle + 1, triangle + 2],
            Mode::TriangleFan => [0, triangle + 1, triangle + 2],
            _ => [3 * triangle, 3 * triangle + 1, 3 * triangle + 2],
        }
    }

    /// The vertex at a corner.
    fn vertex(&self, corner: usize) -> Result<usize> {
        let vertex = self.indices.as_ref().map_or(corner, |indices| indices.index(corner));
        let count = self.positions.len();
        if vertex >= count {
            let problem = format!("refers to vertex {vertex}, counted from 0, but there are {count}");
            return Err(Error::input(&self.place, problem));
        }
        Ok(vertex)
    }
}
