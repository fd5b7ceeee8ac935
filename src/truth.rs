//! Traces the ground truth of a scene: what a perfect depth map would show on the same pixels.
//!
//! # Example
//! The true depth map of a plate 1 m away; the column next to the plate is empty:
//! ```
//! use holosonar::glam::DVec3;
//! use holosonar::grid::{Axis, Grid};
//! use holosonar::scene::{Material, Scene, Triangle};
//! use holosonar::truth::{TruthOptions, trace_depth};
//!
//! let vertices = [[-1.0, -1.0, 1.0], [1.0, -1.0, 1.0], [0.0, 1.0, 1.0]].map(DVec3::from);
//! let wall = Material { name: "wall".into(), reflectance: 1.0, transmittance: 0.0, source: "here".into() };
//! let scene = Scene::new(vec![Triangle { vertices, material: 0 }], vec![wall])?;
//! let grid = Grid {
//!     x: Axis { first: 0.0, pitch: 2.0, count: 2 },
//!     y: Axis { first: 0.0, pitch: 0.1, count: 1 },
//!     z: Axis { first: 0.8, pitch: 0.01, count: 41 },
//! };
//! let truth = trace_depth(&scene, &grid, &TruthOptions::for_speaker(DVec3::ZERO))?;
//! assert_eq!(truth.picked.depth[0], 1.0);
//! assert!(truth.picked.depth[1].is_nan());
//! # Ok::<(), holosonar::error::Error>(())
//! ```

use crate::error::Result;
use crate::grid::{DepthLayer, DepthMap, Grid, Raster, pixel_values};
use crate::progress::{Observer, Silent, advance, stage};
use crate::scene::Scene;
use crate::with_fields::with_fields;
use glam::DVec3;
use rayon::prelude::*;

/// Parameters of [`trace_depth`].
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct TruthOptions {
    /// Where the sound comes from, m; surfaces it cannot reach are left out. `None` includes them all.
    pub speaker: Option<DVec3>,
    /// Whether the expected strength falls with the cosine at the speaker.
    pub lambert: bool,
    /// The pixels; `None` for the grid's own columns.
    pub raster: Option<Raster>,
}

with_fields! {
    TruthOptions {
        with_speaker(speaker: Option<DVec3>),
        with_lambert(lambert: bool),
        with_raster(raster: Option<Raster>),
    }
}

impl TruthOptions {
    /// The truth for a loudspeaker at `speaker`, m, with Lambert's cosine and the grid's own columns as pixels.
    pub fn for_speaker(speaker: DVec3) -> Self {
        Self { speaker: Some(speaker), lambert: true, raster: None }
    }
}

/// A true surface at one pixel.
#[derive(Debug, Clone, Copy)]
struct Hit {
    point: DVec3,
    strength: f64,
    facing: f64,
    normal: DVec3,
    material: u32,
}

/// Traces a ray through the centre of every pixel and lists the surfaces that the speaker reaches, front to back.
///
/// A ray starts in the array's plane (at the origin in the perspective view) and ends at the first opaque surface.
/// Surfaces the speaker does not reach are left out, and so are those outside the imaged box (half a voxel of margin),
/// which no reconstruction on this grid could show. The picked surface is the first. `strength` is reflectance × |cos|
/// × transmittance there and back; `facing` is the distance from the surface per error in depth; `material` is an index
/// into the scene's materials, from 1.
///
/// Cost: one ray per pixel and one per surface found.
///
/// # Errors
/// [`Error::OutOfMemory`](crate::error::Error::OutOfMemory) when the map does not fit in memory.
pub fn trace_depth(scene: &Scene, grid: &Grid, options: &TruthOptions) -> Result<DepthMap> {
    trace_depth_with(scene, grid, options, &Silent)
}

/// [`trace_depth`], reporting its progress to `observer`, which may stop it.
///
/// # Errors
/// As [`trace_depth`]; [`Error::Interrupted`](crate::error::Error::Interrupted) when the observer asks to stop.
pub fn trace_depth_with(
    scene: &Scene,
    grid: &Grid,
    options: &TruthOptions,
    observer: &dyn Observer,
) -> Result<DepthMap> {
    let raster = options.raster.unwrap_or_else(|| Raster::of_grid(grid));
    let ends =
        [grid.x, grid.y, grid.z].map(|axis| (axis.first - 0.5 * axis.pitch, axis.last() + 0.5 * axis.pitch));
    let far = scene.bounds().map_or(0.0, |(_, high)| high.z) + 1.0;
    let far = far.max(ends[2].1);
    let mut pixels: Vec<Vec<Hit>> = pixel_values(Vec::new(), raster.len())?;
    stage(observer, "tracing truth", raster.y.count as u64, || {
        let rows = pixels.par_chunks_mut(raster.x.count).enumerate();
        rows.try_for_each(|(iy, row)| {
            for (ix, found) in row.iter_mut().enumerate() {
                *found = hits(scene, &raster, iy * raster.x.count + ix, far, options);
                found.retain(|hit| {
                    let p = hit.point.to_array();
                    ends.iter().zip(p).all(|(&(low, high), p)| (low..=high).contains(&p))
                });
            }
            advance(observer, 1)
        })
    })?;
    let most = pixels.iter().map(Vec::len).max().unwrap_or(0).max(1);
    let returns: Vec<DepthLayer> = (0..most)
        .map(|k| {
            let mut surface = DepthLayer::empty(pixels.len())?;
            let mut facing = pixel_values(f32::NAN, pixels.len())?;
            let mut material = pixel_values(0, pixels.len())?;
            let mut normal = pixel_values([f32::NAN; 3], pixels.len())?;
            for (pixel, hits) in pixels.iter().enumerate() {
                if let Some(hit) = hits.get(k) {
                    surface.depth[pixel] = hit.point.z as f32;
                    surface.strength[pixel] = hit.strength as f32;
                    facing[pixel] = hit.facing as f32;
                    material[pixel] = hit.material + 1;
                    normal[pixel] = hit.normal.as_vec3().to_array();
                }
            }
            (surface.facing, surface.material) = (Some(facing), Some(material));
            surface.normal = Some(normal);
            Ok(surface)
        })
        .collect::<Result<_>>()?;
    let materials = scene.materials().iter().map(|material| material.name.clone()).collect();
    let picked = returns[0].clone();
    Ok(DepthMap { returns, materials, ..DepthMap::new(raster, picked) })
}

/// The surfaces along a pixel's ray that the speaker reaches, up to the first opaque one.
fn hits(scene: &Scene, raster: &Raster, pixel: usize, far: f64, options: &TruthOptions) -> Vec<Hit> {
    let (start, ray) = (raster.point(pixel, 0.0), raster.ray(pixel));
    let per_metre = 1.0 / ray.length();
    let mut hits = Vec::new();
    for crossing in scene.crossings(start, start + ray * far) {
        let triangle = &scene.triangles()[crossing.triangle as usize];
        let (p, normal) = (start + ray * (crossing.distance * per_metre), triangle.normal());
        let (transmittance, cosine) = options.speaker.map_or((1.0, 1.0), |speaker| {
            let towards = (speaker - p).normalize_or_zero();
            (scene.transmittance(speaker, p), if options.lambert { normal.dot(towards).abs() } else { 1.0 })
        });
        if transmittance > 0.0 {
            let reflectance = scene.materials()[triangle.material as usize].reflectance;
            hits.push(Hit {
                point: p,
                strength: reflectance * cosine * transmittance * transmittance,
                facing: normal.dot(ray).abs(),
                normal: if normal.dot(ray) > 0.0 { -normal } else { normal },
                material: triangle.material,
            });
        }
        if crossing.transmittance <= 0.0 {
            break;
        }
    }
    hits
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::grid::Axis;
    use crate::scene::Material;
    use crate::scene::fixtures::{material, plate};

    /// A plate at z = 1 over x < 0 (transmittance given) before a backdrop at z = 2.
    fn scene(transmittance: f64) -> Scene {
        let surfaces = [plate([-1.0, 0.0], [-1.0, 1.0], 1.0, 0), plate([-3.0, 3.0], [-1.0, 1.0], 2.0, 1)];
        let materials = [transmittance, 0.0].map(|transmittance| Material {
            name: format!("lets {transmittance} through"),
            ..material(1.0 - transmittance, transmittance)
        });
        Scene::new(surfaces.concat(), materials.to_vec()).expect("valid")
    }

    fn grid(z: [f64; 2]) -> Grid {
        let axis = Axis { first: -0.45, pitch: 0.1, count: 10 };
        Grid { x: axis, y: axis, z: Axis::spanning(z[0], z[1], 0.01).expect("valid") }
    }

    #[test]
    fn a_clear_plate_shows_two_surfaces_and_an_opaque_one_hides() {
        let options = TruthOptions::for_speaker(DVec3::ZERO);
        let map = trace_depth(&scene(0.6), &grid([0.5, 2.5]), &options).expect("valid");
        assert_eq!(map.returns.len(), 2);
        for pixel in 0..map.len() {
            let left = pixel % 10 < 5;
            assert_eq!(map.picked.depth[pixel], if left { 1.0 } else { 2.0 });
            assert_eq!(map.returns[1].depth[pixel].is_nan(), !left);
        }
        // The plate reflects 0.4; the backdrop behind it is crossed twice.
        let cosine = 2.0 / DVec3::new(0.45, 0.05, 2.0).length();
        assert!((f64::from(map.returns[1].strength[40]) - 0.36 * cosine).abs() < 2e-3);
        assert_eq!(map.materials, ["lets 0.6 through", "lets 0 through"]);
        let ids = |k: usize| map.returns[k].material.as_ref().expect("known")[..10].to_vec();
        assert_eq!(ids(0), [1, 1, 1, 1, 1, 2, 2, 2, 2, 2]);
        assert_eq!(ids(1), [2, 2, 2, 2, 2, 0, 0, 0, 0, 0]);
        let map = trace_depth(&scene(0.0), &grid([0.5, 2.5]), &options).expect("valid");
        assert_eq!(map.returns.len(), 1);
    }

    #[test]
    fn a_camera_at_the_origin_sees_planar_depth_and_the_nearer_plate_larger() {
        let raster = Raster::camera(90.0, [40, 40]).expect("valid");
        let options = TruthOptions { raster: Some(raster), ..TruthOptions::for_speaker(DVec3::ZERO) };
        let wide = Axis { first: -3.0, pitch: 0.1, count: 61 };
        let grid = Grid { x: wide, y: wide, ..grid([0.5, 2.5]) };
        let map = trace_depth(&scene(0.0), &grid, &options).expect("valid");
        for pixel in 0..map.len() {
            // The plate spans x -1 .. 0 and y -1 .. 1 at z = 1, the backdrop x -3 .. 3 but y -1 .. 1 only at z = 2.
            let (sx, sy) = (raster.ray(pixel).x, raster.ray(pixel).y);
            let expected = if sx < 0.0 {
                1.0
            } else if sy.abs() < 0.5 {
                2.0
            } else {
                f32::NAN
            };
            let z = map.picked.depth[pixel];
            assert!(z == expected || (z.is_nan() && expected.is_nan()), "{sx} {sy}: {z}, not {expected}");
            if !z.is_nan() {
                // Both face z, so an error in depth is one along their normals.
                assert_eq!(map.picked.facing.as_ref().expect("known")[pixel], 1.0);
                assert!((map.range(pixel) - f64::from(z) * raster.ray(pixel).length()).abs() < 1e-9);
            }
        }
    }

    #[test]
    fn what_the_speaker_cannot_reach_is_left_out() {
        // The opaque plate covers x < 0 at z = 1, so its shadow on the backdrop is x < 0 as well when the speaker
        // is at the origin; from a speaker to the left, part of the right side is in shadow.
        let seen = |x: f64| {
            let options = TruthOptions::for_speaker(DVec3::new(x, 0.0, 0.0));
            let map = trace_depth(&scene(0.0), &grid([0.5, 2.5]), &options).expect("valid");
            (0..10).filter(|ix| !map.picked.depth[40 + ix].is_nan()).count()
        };
        assert_eq!((seen(0.0), seen(-0.3)), (10, 7));
    }

    #[test]
    fn depths_outside_the_grid_are_left_out_but_still_hide() {
        let options = TruthOptions { speaker: None, lambert: false, raster: None };
        let map = trace_depth(&scene(0.0), &grid([1.5, 2.5]), &options).expect("valid");
        for pixel in 0..map.len() {
            assert_eq!(map.picked.depth[pixel].is_nan(), pixel % 10 < 5);
        }
    }
}
