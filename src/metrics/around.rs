//! What is around a pixel: silhouettes, creases, and surfaces that explain a return there.

use super::counts::SurfaceFacts;
use super::depths;
use crate::grid::{DepthLayer, DepthMap};
use crate::wave::Resolution;
use glam::DVec3;

/// Width of the ring around silhouettes, in lateral resolutions, within which a detection on an empty pixel is not scored.
const GUARD_RING: f64 = 1.5;

/// The same where the lateral resolution is not known, m.
const UNKNOWN_GUARD_RING: f64 = 0.04;

/// How many pixels to each side are asked at most.
const ASKED: usize = 8;

/// True surfaces, searched around pixels.
pub(super) struct Surroundings<'a> {
    truth: &'a DepthMap,
    surfaces: &'a [DepthLayer],
    resolution: Resolution,
    /// Depths of the nearest and of the farthest first surface, m.
    ends: [f64; 2],
    /// The least strength of a surface that is heard.
    loud: f32,
}

/// How much weaker than the strongest surface one may answer and still be heard: 20 dB.
const LOUD: f32 = 0.1;

impl<'a> Surroundings<'a> {
    pub(super) fn new(truth: &'a DepthMap, surfaces: &'a [DepthLayer], resolution: Resolution) -> Self {
        let mut ends = [f64::INFINITY, 0.0f64];
        for z in surfaces[0].depth.iter().filter(|z| !z.is_nan()) {
            ends = [ends[0].min(f64::from(*z)), ends[1].max(f64::from(*z))];
        }
        let strengths = surfaces.iter().flat_map(|surface| &surface.strength);
        let loud = LOUD * strengths.copied().fold(0.0, f32::max);
        Self { truth, surfaces, resolution, ends, loud }
    }

    /// Half-axes of the ellipse around a point at depth `z` that is `cells` lateral resolutions wide, m.
    fn half_axes(&self, cells: f64, unknown: f64, z: f64) -> [f64; 2] {
        self.resolution.lateral(z).map(|cell| cell.map_or(unknown, |cell| cells * cell))
    }

    /// Whether `holds` for a pixel whose centre, at depth `z`, is within an ellipse around that of `pixel`; its eight
    /// neighbours too if `adjoining`. Of pixels far finer than that ellipse only some are asked, eight to each side.
    fn any(
        &self,
        pixel: usize,
        half_axes: impl Fn(f64) -> [f64; 2],
        z: f64,
        adjoining: bool,
        holds: impl Fn(usize, &dyn Fn(f64) -> bool) -> bool,
    ) -> bool {
        let (n_x, n_y) = (self.truth.x.count, self.truth.y.count);
        let (x, y) = (pixel % n_x, pixel / n_x);
        let pitches = [self.truth.x.pitch, self.truth.y.pitch];
        let axes = half_axes(z);
        let reach: [usize; 2] = std::array::from_fn(|k| {
            let pixels = (axes[k] / (pitches[k] * self.truth.view.metres_per_unit(z)) + 1e-6).floor();
            (pixels.max(f64::from(u8::from(adjoining))) as usize).min(n_x.max(n_y))
        });
        let around = |at: usize, reach: usize, count: usize| {
            (at.saturating_sub(reach)..(at + reach + 1).min(count)).step_by(reach.div_ceil(ASKED).max(1))
        };
        around(y, reach[1], n_y).any(|j| {
            around(x, reach[0], n_x).any(|i| {
                let steps = [i.abs_diff(x), j.abs_diff(y)];
                let near = |z: f64| {
                    let (axes, metres) = (half_axes(z), self.truth.view.metres_per_unit(z));
                    let part = |k: usize| (steps[k] as f64 * pitches[k] * metres / axes[k]).powi(2);
                    (adjoining && steps[0].max(steps[1]) <= 1)
                        || steps == [0, 0]
                        || part(0) + part(1) <= 1.0 + 1e-9
                };
                holds(j * n_x + i, &near)
            })
        })
    }

    /// Whether the guard ring of a silhouette holds a pixel: as wide as the image of an edge.
    pub(super) fn guarded(&self, pixel: usize) -> bool {
        let axes = |z: f64| self.half_axes(GUARD_RING, UNKNOWN_GUARD_RING, z);
        // The nearest surface takes the most pixels of a camera, the farthest those of parallel rays.
        self.ends.into_iter().any(|z| {
            self.any(pixel, axes, z, false, |other, near| {
                depths(self.surfaces, other).next().is_some_and(|(_, z)| near(z))
            })
        })
    }

    /// Whether a true surface within one lateral resolution, and within Δd of `z`, explains a return there.
    pub(super) fn explained(&self, pixel: usize, z: f64) -> bool {
        let axes = |z: f64| self.half_axes(1.0, 0.0, z);
        self.any(pixel, axes, z, false, |other, near| {
            depths(self.surfaces, other)
                .any(|(_, depth)| (depth - z).abs() < self.resolution.range && near(z))
        })
    }

    /// What is known of surface `k` of a pixel.
    pub(super) fn facts(&self, k: usize, pixel: usize) -> SurfaceFacts {
        let surface = &self.surfaces[k];
        SurfaceFacts {
            facing: surface.facing.as_ref().map(|facing| f64::from(facing[pixel])),
            interior: self.interior(k, pixel),
            loud: surface.strength[pixel] >= self.loud,
        }
    }

    /// Whether surface `k` of a pixel continues as a plane, to within Δd, at every pixel within one lateral resolution, its
    /// eight neighbours at least; `None` where its normal is not known.
    fn interior(&self, k: usize, pixel: usize) -> Option<bool> {
        let normal = DVec3::from(self.surfaces[k].normal.as_ref()?[pixel].map(f64::from));
        let raster = self.truth.raster();
        let depth = f64::from(self.surfaces[k].depth[pixel]);
        let here = raster.point(pixel, depth);
        let axes = |z: f64| self.half_axes(1.0, 0.0, z);
        Some(!self.any(pixel, axes, depth, true, |other, near| {
            let continues = depths(self.surfaces, other).any(|(_, z)| {
                let off = normal.dot(raster.point(other, z) - here) / normal.z;
                off.abs() < self.resolution.range
            });
            near(depth) && !continues
        }))
    }
}
