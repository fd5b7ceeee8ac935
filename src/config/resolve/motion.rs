//! From `[scene] velocity`, `[medium] velocity` and `[recording] dwell` to what moves, and to the frame that is imaged.

use crate::config::RunFile;
use crate::error::Result;
use crate::reflectors::Reflectors;
use crate::scene::Part;
use crate::wave::Motion;
use glam::DVec3;
use std::ops::Range;

impl RunFile {
    /// The velocity of each of `[[scene.parts]]`, or of the one mesh, m/s; empty where nothing moves.
    pub fn scene_velocities(&self) -> Vec<DVec3> {
        let all = self.scene.velocity.map_or(DVec3::ZERO, DVec3::from_array);
        let of_parts = self.scene.parts.iter().map(|part| part.velocity.map_or(all, DVec3::from_array));
        let mut velocities: Vec<DVec3> = of_parts.collect();
        if velocities.is_empty() {
            velocities.push(all);
        }
        if velocities.iter().all(|v| *v == DVec3::ZERO) { Vec::new() } else { velocities }
    }

    /// The same for the triangles of a scene with these parts.
    pub(crate) fn triangle_velocities(&self, parts: &[Part]) -> Vec<(Range<usize>, DVec3)> {
        match &self.scene_velocities()[..] {
            [] => Vec::new(),
            [one] if self.scene.parts.is_empty() => vec![(0..usize::MAX, *one)],
            several => parts.iter().map(|part| part.triangles.clone()).zip(several.iter().copied()).collect(),
        }
    }

    /// A list of reflectors, all of which move as the scene does.
    pub(crate) fn moving(&self, list: Reflectors) -> Result<Reflectors> {
        let velocities = self.scene_velocities().first().map_or(Vec::new(), |v| vec![*v; list.len()]);
        list.with_velocities(velocities)
    }

    /// The frame that is imaged, if it moves.
    pub fn frame_motion(&self) -> Option<Motion> {
        let velocity = self.medium.velocity.map(DVec3::from_array).filter(|v| *v != DVec3::ZERO)?;
        Some(Motion::new(velocity, self.recording.dwell?))
    }
}
