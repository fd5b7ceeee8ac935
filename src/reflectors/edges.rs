//! Edges: sound that bends around them, as further reflectors along them.
//!
//! The echo of an edge is the line integral
//!
//! ```text
//! p = −ν/4π ∫ β e^{ik(m + l)} / (m l) dz,     of a speaker whose sound is e^{ikd}/d at a distance d
//! ```
//!
//! over the edge of a rigid wedge, m and l from the speaker and the microphone to the piece dz: the exact first-order
//! diffraction of Biot and Tolstoy, for edges of any length by Medwin's argument, in the form of Svensson, Fred and
//! Vanderkooy (J. Acoust. Soc. Am. 106, 1999). Each piece is a reflector whose amplitude depends on where it is heard.
//!
//! Its limits: the faces are rigid and flat, as far as a wavelength from the edge at least; of another material all of it is
//! weaker by the reflectance. Sound that bends twice, or is mirrored and bends, is left out, and so are corners.

mod wedge;
#[cfg(test)]
mod tests;

pub(super) use wedge::Wedge;

use super::bounced::{Bounced, PathKind};
use super::{Reflectors, SurfaceOptions, does_not_fit};
use crate::error::Result;
use crate::progress::{Observer, advance, stage};
use crate::scene::Scene;
use crate::wave::NEAREST_LEG;
use crate::with_fields::with_fields;
use glam::DVec3;
use num_complex::Complex32;
use rayon::prelude::*;
use rustc_hash::FxHashMap;
use serde::{Deserialize, Serialize};
use std::f64::consts::PI;
use std::time::Instant;

/// Pieces per shortest wavelength. Along an edge the path changes by up to twice its length, so that the ends of the integral
/// are within a tenth and its middle far closer.
const PIECES: f64 = 8.0;

/// The most pieces of all edges; more are left out, the shortest edges first.
const MOST_PIECES: usize = 1 << 18;

/// Faces that turn by less are a bent surface, not an edge: the cosine of 20 degrees.
const FLAT: f64 = 0.94;

/// Directions whose cosine is more are the same.
const SAME: f64 = 1.0 - 1e-6;

/// How far beside an edge other surfaces are looked for, in wavelengths.
const BESIDE: f64 = 0.02;

/// Pieces that are traced to know of all, about.
const SAMPLED: f64 = 2000.0;

/// Bytes of a triangle while edges are found: its sides in a hash map, and what is beside them.
const BYTES_PER_TRIANGLE: u64 = 512;

/// Echoes of edges, for [`SurfaceOptions::edges`].
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct EdgeOptions {
    /// The shortest wavelength, m: edges are cut into eighths of it.
    pub shortest: f64,
    /// Whether amplitudes fall with distance, as the simulation must be told, too.
    pub spreading: bool,
}

with_fields! {
    EdgeOptions {
        with_spreading(spreading: bool),
    }
}

impl EdgeOptions {
    /// For sound of this shortest wavelength, m; amplitudes without spreading.
    pub fn new(shortest: f64) -> Self {
        Self { shortest, spreading: false }
    }
}

/// A piece of an edge.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub(crate) struct EdgePiece {
    /// Index into the wedges.
    pub(super) wedge: u32,
    /// Where it begins and ends, m from the start of the edge.
    pub(super) heights: [f64; 2],
}

/// A straight edge of the surfaces.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Edge {
    start: DVec3,
    /// Unit vector.
    along: DVec3,
    /// m.
    length: f64,
    /// Directions from the edge into its faces; twice the same of a rim.
    faces: [DVec3; 2],
    /// Of the faces, on average.
    reflectance: f64,
}

impl Edge {
    fn is_rim(&self) -> bool {
        self.faces[0] == self.faces[1]
    }
}

/// The sides of triangles that meet: between the same corners, whatever their direction.
type Sides = FxHashMap<[[u64; 3]; 2], Vec<(DVec3, u32)>>;

/// About as many pieces as the edges of so many triangles of this area, m², have at most, and the bytes that finding them takes.
pub(crate) fn most_pieces(triangles: u64, area: f64, wavelength: f64) -> [u64; 2] {
    // Sides of triangles twice as long as wide, none of them inside of a flat face.
    let sides = 6.0 * triangles as f64 * (area / triangles.max(1) as f64).sqrt();
    let pieces = (2.0 * PIECES * sides / wavelength) as u64 + 3 * triangles;
    [pieces.min(MOST_PIECES as u64), triangles.saturating_mul(BYTES_PER_TRIANGLE)]
}

/// The edges of a scene, in the order of its triangles; those that are not convex from anywhere are left out.
fn edges_of(scene: &Scene) -> Vec<Edge> {
    let triangles = scene.triangles();
    let bits = |p: DVec3| p.to_array().map(|x| (x + 0.0).to_bits());
    let mut sides = Sides::default();
    let mut order = Vec::new();
    for (index, triangle) in (0_u32..).zip(triangles) {
        for side in 0..3 {
            let [start, end, third] = [0, 1, 2].map(|k| triangle.vertices[(side + k) % 3]);
            let Some(along) = (end - start).try_normalize() else { continue };
            let Some(face) = (third - start).reject_from_normalized(along).try_normalize() else { continue };
            let mut ends = [bits(start), bits(end)];
            ends.sort_unstable();
            let meeting = sides.entry(ends).or_default();
            if meeting.is_empty() {
                order.push((ends, start, end));
            }
            // Of doubled faces one is enough.
            if meeting.iter().all(|(other, _)| other.dot(face) < SAME) {
                meeting.push((face, index));
            }
        }
    }
    let reflectance =
        |triangle: u32| scene.materials()[triangles[triangle as usize].material as usize].reflectance;
    let edge = |(ends, start, end): ([[u64; 3]; 2], DVec3, DVec3)| {
        let (faces, reflectance) = match sides[&ends][..] {
            [(face, triangle)] => ([face; 2], reflectance(triangle)),
            [(a, first), (b, second)] if -a.dot(b) < FLAT => {
                ([a, b], 0.5 * (reflectance(first) + reflectance(second)))
            }
            _ => return None,
        };
        let length = start.distance(end);
        Some(Edge { start, along: (end - start) / length, length, faces, reflectance })
    };
    order.into_iter().filter_map(edge).collect()
}

/// Adds the echoes of a scene's edges to its reflectors.
///
/// # Errors
/// When they do not fit in memory, or the observer asks to stop.
pub(super) fn append(
    list: Reflectors,
    scene: &Scene,
    options: &SurfaceOptions,
    edges: &EdgeOptions,
    observer: &dyn Observer,
) -> Result<Reflectors> {
    let step = edges.shortest / PIECES;
    let (found, left_out) = kept_edges(scene, step);
    let pieces = |edge: &Edge| (edge.length / step).ceil();
    let tracer = EdgeTracer { scene, options, edges };
    let echoes: Vec<Option<EdgeEchoes>> = stage(observer, "tracing edges", found.len() as u64, || {
        let of = |edge: &Edge| {
            advance(observer, 1)?;
            Ok(tracer.echoes(edge, pieces(edge) as usize))
        };
        found.par_iter().map(of).collect::<Result<_>>()
    })?;
    let echoes: Vec<EdgeEchoes> = echoes.into_iter().flatten().collect();
    let rigid = options.rigid_velocity(scene)?;
    let Reflectors { mut positions, mut amplitudes, bounced, .. } = list;
    let mut bounced = bounced.unwrap_or_else(|| Bounced::none(positions.len(), options.speaker));
    let more: usize = echoes.iter().map(|of| of.pieces.len()).sum();
    let no_room = |_| does_not_fit(options.spacing);
    positions.try_reserve(more).map_err(no_room)?;
    amplitudes.try_reserve(more).map_err(no_room)?;
    let kind = bounced.kinds.len() as u32;
    bounced.kinds.push(PathKind::EDGE);
    for (wedge, EdgeEchoes { wedge: of, pieces }) in (0_u32..).zip(echoes) {
        for EdgeEcho { place, amplitude, transmit, heights } in pieces {
            positions.push(place);
            amplitudes.push(Complex32::new(amplitude as f32, 0.0));
            bounced.transmit.push(transmit);
            bounced.origins.extend(rigid.map(|_| place));
            bounced.kind.push(kind);
            bounced.pieces.push(EdgePiece { wedge, heights });
            bounced.counts.edge_length += heights[1] - heights[0];
        }
        bounced.wedges.push(of);
    }
    bounced.counts.edge_pieces = more;
    bounced.counts.edge_length_left_out = left_out;
    Reflectors { bounced: Some(bounced), ..Reflectors::new(positions, amplitudes)? }.moving_as_one(rigid)
}

/// The edges that are cut into pieces of this length, m, and the length of those that are left out.
fn kept_edges(scene: &Scene, step: f64) -> (Vec<Edge>, f64) {
    let mut found = edges_of(scene);
    // The longest first; the sort is stable, and so deterministic.
    found.sort_by(|a, b| b.length.total_cmp(&a.length));
    let mut room = MOST_PIECES as f64;
    let kept = found.iter().take_while(|edge| {
        room -= (edge.length / step).ceil();
        room >= 0.0
    });
    let kept = kept.count();
    let left_out = found[kept..].iter().fold(0.0, |sum, edge| sum + edge.length);
    found.truncate(kept);
    (found, left_out)
}

/// What is expected of the pieces of all edges, from a few of them.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct EdgeSample {
    /// Those that are heard.
    pub(super) pieces: f64,
    /// s on one thread, and what no other thread can share.
    pub(super) seconds: f64,
    pub(super) once: f64,
}

impl EdgeSample {
    pub(super) fn of(scene: &Scene, options: &SurfaceOptions, edges: &EdgeOptions) -> Self {
        let begun = Instant::now();
        let step = edges.shortest / PIECES;
        let (found, _) = kept_edges(scene, step);
        let once = begun.elapsed().as_secs_f64();
        let tracer = EdgeTracer { scene, options, edges };
        let all: f64 = found.iter().map(|edge| (edge.length / step).ceil()).sum();
        let coarser = (all / SAMPLED).max(1.0);
        // Long edges in longer pieces, and of short ones some.
        let (mut traced, mut heard, mut due) = (0.0, 0.0, 0.0);
        let begun = Instant::now();
        for edge in &found {
            due += (edge.length / step).ceil() / coarser;
            let pieces = due.floor();
            if pieces >= 1.0 {
                due -= pieces;
                traced += pieces;
                heard += tracer.echoes(edge, pieces as usize).map_or(0.0, |of| of.pieces.len() as f64);
            }
        }
        let times = all / f64::max(traced, 1.0);
        Self { pieces: heard * times, seconds: begun.elapsed().as_secs_f64() * times, once }
    }
}

/// The echoes of one edge.
struct EdgeEchoes {
    wedge: Wedge,
    pieces: Vec<EdgeEcho>,
}

/// The echo of a piece of an edge.
struct EdgeEcho {
    place: DVec3,
    /// Without the directivity, m.
    amplitude: f64,
    transmit: f64,
    heights: [f64; 2],
}

/// What edges are traced with.
struct EdgeTracer<'a> {
    scene: &'a Scene,
    options: &'a SurfaceOptions,
    edges: &'a EdgeOptions,
}

impl EdgeTracer<'_> {
    /// The echoes of an edge in so many pieces; `None` where it is no edge from the speaker.
    fn echoes(&self, edge: &Edge, count: usize) -> Option<EdgeEchoes> {
        let speaker = self.options.speaker;
        let wedge = Wedge::new(edge.start, edge.along, edge.faces, speaker)?;
        let step = edge.length / count as f64;
        let echo = |k: usize| {
            let heights = [k as f64, (k + 1) as f64].map(|k| k * step);
            let place = edge.start + edge.along * f64::midpoint(heights[0], heights[1]);
            let beside = BESIDE * self.options.wavelength;
            if place.z <= 0.0 || edge.is_rim() && self.continues(place, edge, beside) {
                return None;
            }
            // Off the surface, which must not hide its own edge.
            let before = place + wedge.outward() * (0.05 * beside);
            let seen = self.options.occlusion.there_and_back(self.scene, speaker, before);
            let transmit = place.distance(speaker);
            let spread = if self.edges.spreading { 1.0 / transmit.max(NEAREST_LEG) } else { 1.0 };
            let amplitude = edge.reflectance * self.scale() * step * seen * spread;
            (amplitude > 0.0).then_some(EdgeEcho { place, amplitude, transmit, heights })
        };
        let pieces: Vec<EdgeEcho> = (0..count).filter_map(echo).collect();
        (!pieces.is_empty()).then_some(EdgeEchoes { wedge, pieces })
    }

    /// Whether another surface begins where a rim ends: its sides need not be between the same corners.
    fn continues(&self, place: DVec3, edge: &Edge, beside: f64) -> bool {
        let normal = edge.along.cross(edge.faces[0]);
        let next = place - edge.faces[0] * beside;
        !self.scene.crossings(next - normal * beside, next + normal * beside).is_empty()
    }

    /// Without bounces, patches have amplitudes √(a A_c) cos θ; with them, √(a/π) cos θ for sound that is scattered back.
    fn scale(&self) -> f64 {
        if self.options.bounces.is_some() { 1.0 } else { 0.5 * self.options.wavelength * PI.sqrt() }
    }
}
