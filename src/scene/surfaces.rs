//! Collects the triangles that a reader finds: limits their number, cuts faces, and counts and drops those without area.

use std::fmt::Display;
use std::ops::Range;

use glam::DVec3;

use super::files::MeshFile;
use super::occlusion::SurfaceTree;
use super::{Triangle, polygon};
use crate::error::{Error, Result, gib};

/// Maximum number of triangles, so that a small hostile file with many instances cannot take all memory.
pub(super) const MOST_TRIANGLES: usize = 50_000_000;

/// Bytes per triangle while the tree over them is built, when a mesh takes most memory: the triangle, and the work space
/// of `SurfaceTree::new`.
pub const BYTES_PER_TRIANGLE: u64 = size_of::<Triangle>() as u64 + SurfaceTree::BUILDING;

/// No scene has coordinates beyond this, in whatever unit.
const TOO_FAR: f64 = 1e3 * super::FARTHEST;

/// A named run of a scene's triangles.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Part {
    /// The name of its node, object, solid or file.
    pub name: String,
    /// Its triangles among those of the scene.
    pub triangles: Range<usize>,
}

/// The surfaces of a file in its own frame.
pub(super) struct Surfaces<'a> {
    file: MeshFile<'a>,
    triangles: Vec<Triangle>,
    /// The name of each part, and its first triangle.
    parts: Vec<(String, usize)>,
    /// Number of triangles without area: they count as work, but are not stored.
    flat: usize,
    /// Number of faces that may be triangulated wrongly.
    doubtful: usize,
    /// Remaining allowance of the search for ears.
    allowance: u64,
}

impl<'a> Surfaces<'a> {
    /// An empty collection; [`LoadOptions::memory`](super::LoadOptions::memory) limits the bytes of the triangles and
    /// their tree.
    pub(super) fn new(file: MeshFile<'a>) -> Self {
        Self {
            file,
            triangles: Vec::new(),
            parts: Vec::new(),
            flat: 0,
            doubtful: 0,
            allowance: polygon::ALLOWANCE,
        }
    }

    /// What follows belongs to the part of this name; without a name, to one that is named after the file.
    pub(super) fn begin_part(&mut self, name: &str) {
        if self.parts.last().is_none_or(|(last, _)| last != name) {
            self.parts.push((name.to_owned(), self.triangles.len()));
        }
    }

    /// Refuses `more` triangles if they would exceed the limit.
    pub(super) fn check_limit(&self, more: usize) -> Result<()> {
        let count = (self.triangles.len() + self.flat).saturating_add(more);
        let bytes = (count as u64).saturating_mul(BYTES_PER_TRIANGLE);
        if let Some(limit) = self.file.options.memory.filter(|limit| bytes > *limit) {
            return Err(self.file.refused(format!(
                "contains {count} triangles or more, which take about {} in memory ({BYTES_PER_TRIANGLE} bytes each), \
                 and {} may be used here (--memory sets another limit); decimate the mesh (the acoustic resolution is \
                 about 1 cm), or remove what the array does not see",
                gib(bytes),
                gib(limit)
            )));
        }
        if count > MOST_TRIANGLES { Err(too_many_triangles(self.file.path.display())) } else { Ok(()) }
    }

    /// Reserves memory for `more` triangles: exactly as much for the first of a file, which often are all.
    pub(super) fn reserve(&mut self, more: usize) -> Result<()> {
        self.check_limit(more)?;
        let made = if self.triangles.is_empty() {
            self.triangles.try_reserve_exact(more)
        } else {
            self.triangles.try_reserve(more)
        };
        made.map_err(|_| self.does_not_fit())
    }

    fn does_not_fit(&self) -> Error {
        self.file.does_not_fit("its triangles")
    }

    /// Adds one triangle.
    pub(super) fn add(&mut self, vertices: [DVec3; 3], material: u32) -> Result<()> {
        self.check_limit(1)?;
        let triangle = Triangle { vertices, material };
        // A far corner makes its triangle a needle; the scene refuses it with a better message.
        let far = vertices.iter().any(|v| v.abs().max_element() > TOO_FAR);
        if triangle.is_degenerate() && !far {
            self.flat += 1;
        } else {
            self.triangles.try_reserve(1).map_err(|_| self.does_not_fit())?;
            self.triangles.push(triangle);
        }
        Ok(())
    }

    /// Adds a face of any number of corners; fewer than three make no face.
    pub(super) fn add_face(&mut self, corners: &[DVec3], material: u32) -> Result<()> {
        if let &[a, b, c] = corners {
            return self.add([a, b, c], material);
        }
        let face = polygon::triangulate(corners, &mut self.allowance);
        self.doubtful += usize::from(face.doubtful);
        face.triangles.iter().try_for_each(|t| self.add(t.map(|i| corners[i]), material))
    }

    /// The triangles found and the parts that have some, after warnings about what was left out.
    ///
    /// # Errors
    /// Nothing was found.
    pub(super) fn finish(self) -> Result<(Vec<Triangle>, Vec<Part>)> {
        let Self { file, mut triangles, mut parts, flat, doubtful, .. } = self;
        // The tree needs the memory of the excess capacity.
        triangles.shrink_to_fit();
        if doubtful > 0 {
            file.warn(format_args!(
                "{doubtful} faces have outlines that cross themselves, are flat, or are concave with very many \
                 corners; they are triangulated as fans from their first corner, which may be wrong. \
                 Triangulate the mesh in the program that made it"
            ));
        }
        if triangles.is_empty() {
            return Err(
                file.refused("contains no triangle with an area; an image needs at least one surface")
            );
        }
        if flat > 0 {
            let all = flat + triangles.len();
            file.warn(format_args!("{flat} of {all} triangles have no area and are ignored"));
        }
        if parts.first().is_none_or(|(_, first)| *first > 0) {
            parts.insert(0, (String::new(), 0));
        }
        let stem = file.path.file_stem().unwrap_or_default().to_string_lossy();
        let ends: Vec<usize> = parts.iter().skip(1).map(|part| part.1).chain([triangles.len()]).collect();
        let parts = parts.into_iter().zip(ends).filter(|((_, first), end)| first < end);
        let named = |((name, first), end): ((String, usize), usize)| Part {
            name: if name.is_empty() { stem.clone().into_owned() } else { name },
            triangles: first..end,
        };
        Ok((triangles, parts.map(named).collect()))
    }
}

/// The error for a mesh with too many triangles.
pub(super) fn too_many_triangles(place: impl Display) -> Error {
    Error::input(
        place,
        format!(
            "contains more than {MOST_TRIANGLES} triangles; decimate the mesh (the acoustic resolution is about 1 cm)"
        ),
    )
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::super::LoadOptions;
    use super::*;
    use crate::named::{Warnings, assert_names};
    use std::path::Path;

    #[test]
    fn flat_triangles_are_counted_and_the_limit_is_kept() {
        let (warnings, options) = (Warnings::default(), LoadOptions::default());
        let file = MeshFile { path: Path::new("a.obj"), options: &options, observer: &warnings };
        let mut surfaces = Surfaces::new(file);
        surfaces.add([DVec3::ZERO, DVec3::X, DVec3::Y], 3).unwrap();
        surfaces.add([DVec3::ZERO, DVec3::X, DVec3::X], 3).unwrap();
        surfaces.add_face(&[DVec3::ZERO, DVec3::X], 3).unwrap();
        assert!(surfaces.check_limit(MOST_TRIANGLES - 2).is_ok());
        let refused = surfaces.check_limit(MOST_TRIANGLES - 1).unwrap_err().to_string();
        assert_names(refused, &["a.obj", "50000000 triangles"]);
        assert!(surfaces.check_limit(usize::MAX).is_err());
        let options = options.clone().with_memory(2 * BYTES_PER_TRIANGLE + 10);
        let mut small = Surfaces::new(MeshFile { options: &options, ..file });
        let corners = [DVec3::ZERO, DVec3::X, DVec3::Y];
        assert!(
            small.add(corners, 0).is_ok() && small.check_limit(2).is_err() && small.add(corners, 0).is_ok()
        );
        let refused = small.add(corners, 0).unwrap_err().to_string();
        assert_names(refused, &["a.obj", "3 triangles", "memory"]);
        assert_eq!(surfaces.finish().unwrap().0.len(), 1);
        assert_names(&warnings.list()[0], &["a.obj", "1", "2 triangles", "area"]);
    }
}
