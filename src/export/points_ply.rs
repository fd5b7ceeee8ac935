//! Points and a mesh as PLY, binary little-endian, which Blender, MeshLab, CloudCompare and ParaView open.
//!
//! Two point clouds: the surfaces of a depth map, with normals; and the scene: reflectors, microphones and speaker. The mesh
//! is that of the scene's surfaces, decimated. All are in the array's axes, in m.

mod mesh;
mod normals;
mod reader;

pub use mesh::{MeshPart, SceneMesh};
pub(crate) use reader::Ply;

use super::Attribute;
use crate::acquisition::MicArray;
use crate::error::{Error, Result};
use crate::files::ply::{Element, Format, Header, Property, Scalar};
use crate::files::write_atomically;
use crate::grid::DepthMap;
use crate::reflectors::Reflectors;
use glam::DVec3;
use std::borrow::Cow;
use std::io::Write;
use std::path::Path;

/// Maximum length of a comment that is written; some readers reject longer lines.
const LONGEST_COMMENT: usize = 200;

/// Writes one vertex per accepted pixel: `x`, `y`, `z` in m, the normal `nx`, `ny`, `nz`, and `amplitude`, all float32.
///
/// The normal is the map's own where it has one, or else that of the plane through the neighbouring pixels of the same
/// surface; it points to the array's side, and is (0, 0, −1) for a pixel with too few neighbours. Short `attributes` become
/// comments.
///
/// # Errors
/// As `write_atomically`.
pub fn write_depth_points(path: &Path, map: &DepthMap, attributes: &[(String, Attribute)]) -> Result<()> {
    let normals = match &map.picked.normal {
        Some(normals) => Cow::Borrowed(normals),
        None => Cow::Owned(normals::normals(map)),
    };
    let found: Vec<usize> = (0..map.len()).filter(|&i| map.picked.depth[i].is_finite()).collect();
    let properties = ["x", "y", "z", "nx", "ny", "nz", "amplitude"].map(|name| (Scalar::F32, name));
    let header = header(found.len(), &properties, "Depth map", attributes);
    write_atomically(path, |out| {
        write!(out, "{header}")?;
        for i in found {
            let (p, [nx, ny, nz]) = (map.point(i), normals[i]);
            for value in [p.x as f32, p.y as f32, map.picked.depth[i], nx, ny, nz, map.picked.strength[i]] {
                out.write_all(&value.to_le_bytes())?;
            }
        }
        Ok(())
    })
}

/// What a point of a scene is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PointKind {
    /// A point that scatters sound.
    Reflector,
    /// A microphone.
    Microphone,
    /// The loudspeaker.
    Speaker,
    /// Where an echo of several surfaces is seen.
    Bounce,
}

impl PointKind {
    /// All kinds, in the order of their numbers in a file.
    pub const ALL: [Self; 4] = [Self::Reflector, Self::Microphone, Self::Speaker, Self::Bounce];

    fn colour(self) -> [u8; 3] {
        match self {
            Self::Reflector => [190, 190, 190],
            Self::Microphone => [70, 140, 230],
            Self::Speaker => [240, 130, 30],
            Self::Bounce => [220, 90, 170],
        }
    }
}

/// The points of a scene: reflectors, microphones and speaker.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ScenePoints {
    points: Vec<(PointKind, [f32; 3], f32)>,
}

impl ScenePoints {
    /// The reflectors (none for a measured cube), the microphones, and the speakers that stand still.
    pub fn new(reflectors: Option<&Reflectors>, array: &MicArray, speakers: &[DVec3]) -> Self {
        let mut points = Vec::new();
        let single = |p: &DVec3| p.to_array().map(|x| x as f32);
        if let Some(reflectors) = reflectors {
            let pairs = reflectors.positions().iter().zip(reflectors.amplitudes());
            points.extend(pairs.map(|(p, a)| (PointKind::Reflector, single(p), a.norm())));
        }
        points.extend(array.positions().iter().map(|p| (PointKind::Microphone, single(p), 0.0)));
        points.extend(speakers.iter().map(|p| (PointKind::Speaker, single(p), 0.0)));
        Self { points }
    }

    /// The same and the places where bounced echoes are seen, m, with their amplitudes.
    #[must_use]
    pub fn with_bounces(mut self, seen: &[(DVec3, f32)]) -> Self {
        let point = |(p, a): &(DVec3, f32)| (PointKind::Bounce, p.to_array().map(|x| x as f32), *a);
        self.points.extend(seen.iter().map(point));
        self
    }

    /// The positions of one kind, m.
    pub fn of(&self, kind: PointKind) -> impl Iterator<Item = [f32; 3]> {
        self.points.iter().filter(move |(k, ..)| *k == kind).map(|(_, position, _)| *position)
    }

    /// Writes one vertex per point: `x`, `y`, `z` in m, `amplitude` (of reflectors and bounced echoes, else 0), `kind`
    /// (0 reflector, 1 microphone, 2 speaker, 3 bounced echo) and a colour by kind.
    ///
    /// # Errors
    /// As `write_atomically`.
    pub fn write(&self, path: &Path, attributes: &[(String, Attribute)]) -> Result<()> {
        let floats = ["x", "y", "z", "amplitude"].map(|name| (Scalar::F32, name));
        let bytes = ["kind", "red", "green", "blue"].map(|name| (Scalar::U8, name));
        let properties = [floats, bytes].concat();
        let bounces =
            if self.of(PointKind::Bounce).next().is_some() { ", 3 where a bounced echo is seen" } else { "" };
        let about = &format!("Scene; kind 0 is a reflector, 1 a microphone, 2 the speaker{bounces}");
        let header = header(self.points.len(), &properties, about, attributes);
        write_atomically(path, |out| {
            write!(out, "{header}")?;
            for (kind, [x, y, z], amplitude) in &self.points {
                for value in [x, y, z, amplitude] {
                    out.write_all(&value.to_le_bytes())?;
                }
                out.write_all(&[*kind as u8])?;
                out.write_all(&kind.colour())?;
            }
            Ok(())
        })
    }

    /// Reads a file written by [`ScenePoints::write`], of at most `limit_bytes`.
    ///
    /// # Errors
    /// A missing or damaged file, or one with other points.
    pub fn read(path: &Path, limit_bytes: u64) -> Result<Self> {
        let ply = Ply::read(path, limit_bytes)?;
        let columns = ply.vertices.columns(["x", "y", "z", "amplitude", "kind"]);
        let Some(points) = columns else {
            return Err(Error::input(
                path.display(),
                "has no points of a scene; x, y, z, amplitude and kind were expected",
            ));
        };
        let point = |[x, y, z, amplitude, kind]: [f64; 5]| {
            Some((*PointKind::ALL.get(kind as usize)?, [x, y, z].map(|v| v as f32), amplitude as f32))
        };
        let points = points.into_iter().filter_map(point).collect();
        Ok(Self { points })
    }
}

fn header(
    count: usize,
    properties: &[(Scalar, &str)],
    about: &str,
    attributes: &[(String, Attribute)],
) -> Header {
    let mut comments = vec![format!("{about}; x right, y down, z from the array into the scene, m")];
    for (name, value) in attributes {
        let value = value.to_text();
        if value.len() <= LONGEST_COMMENT && !value.contains(['\n', '\r']) && value.is_ascii() {
            comments.push(format!("{name} {value}"));
        }
    }
    let property = |&(scalar, name): &(Scalar, &str)| Property { name: name.to_owned(), count: None, scalar };
    let properties = properties.iter().map(property).collect();
    let vertices = Element { name: "vertex".to_owned(), count: count as u64, properties };
    Header { format: Format::LittleEndian, comments, elements: vec![vertices] }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;
    use crate::grid::{Axis, DepthLayer, Raster, View};
    use num_complex::Complex32;

    #[test]
    fn one_vertex_per_accepted_pixel() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("depth.ply");
        let raster = Raster {
            view: View::Orthographic,
            x: Axis { first: -0.1, pitch: 0.1, count: 3 },
            y: Axis { first: 0.3, pitch: 0.07, count: 2 },
        };
        let picked = DepthLayer {
            depth: vec![1.5, f32::NAN, 2.25, f32::NAN, f32::NAN, 3.0],
            strength: vec![0.25, 0.0, 0.5, 0.0, 0.0, 0.125],
            ..DepthLayer::default()
        };
        let map = DepthMap::new(raster, picked);
        let facts = [
            ("sonar:soundSpeed".to_owned(), Attribute::Number(343.0)),
            ("sonar:run".to_owned(), Attribute::Text("x".repeat(300))),
        ];
        write_depth_points(&path, &map, &facts).unwrap();
        let ply = Ply::read(&path, 1 << 20).unwrap();
        assert_eq!(ply.vertices.count, 3);
        assert_eq!(ply.vertices.column("z").unwrap(), [1.5, 2.25, 3.0]);
        assert_eq!(ply.vertices.column("amplitude").unwrap(), [0.25, 0.5, 0.125]);
        assert_eq!(ply.vertices.column("x").unwrap()[2] as f32, 0.1);
        assert_eq!(ply.vertices.column("y").unwrap()[2] as f32, 0.37);
        assert_eq!(ply.vertices.column("nz").unwrap(), [-1.0; 3], "the normal of an isolated pixel");
        assert_eq!(ply.comments.len(), 2, "{:?}", ply.comments);
        assert!(ply.comments[1].contains("sonar:soundSpeed 343"));

        let map = DepthMap { view: View::Perspective, ..map };
        write_depth_points(&path, &map, &facts).unwrap();
        let ply = Ply::read(&path, 1 << 20).unwrap();
        let near = |name: &str, expected: f64| {
            assert!((ply.vertices.column(name).unwrap()[2] - expected).abs() < 1e-6);
        };
        near("x", 0.1 * 3.0);
        near("y", 0.37 * 3.0);
        near("z", 3.0);
    }

    #[test]
    fn a_scene_is_read_as_it_was_written() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("scene.ply");
        let reflectors =
            Reflectors::new(vec![DVec3::new(0.5, 0.25, 2.0)], vec![Complex32::new(0.0, 3.0)]).unwrap();
        let array = MicArray::rectangular([2, 2], [0.5, 0.5], DVec3::ZERO).unwrap();
        let scene = ScenePoints::new(Some(&reflectors), &array, &[DVec3::new(0.0, 0.0, 0.125)]);
        let scene = scene.with_bounces(&[(DVec3::new(0.0, 0.5, 3.0), 0.25)]);
        scene.write(&path, &[]).unwrap();
        assert_eq!(ScenePoints::read(&path, 1 << 20).unwrap(), scene);
        assert_eq!(scene.of(PointKind::Reflector).collect::<Vec<_>>(), [[0.5, 0.25, 2.0]]);
        assert_eq!(scene.of(PointKind::Microphone).count(), 4);
        assert_eq!(scene.of(PointKind::Bounce).collect::<Vec<_>>(), [[0.0, 0.5, 3.0]]);
        assert_eq!(scene.of(PointKind::Speaker).collect::<Vec<_>>(), [[0.0, 0.0, 0.125]]);
        assert_eq!(ScenePoints::new(None, &array, &[]).of(PointKind::Speaker).count(), 0);
        let whole = std::fs::read(&path).unwrap();
        for length in 0..whole.len() {
            std::fs::write(&path, &whole[..length]).unwrap();
            assert_eq!(ScenePoints::read(&path, 1 << 20).unwrap_err().exit_status(), 2, "cut at {length}");
        }
    }
}
