//! What hides a reflector from the speaker and from the microphones.

use crate::choice::choice;
use crate::scene::Scene;
use glam::DVec3;

/// What hides a reflector.
#[derive(Debug, Clone, PartialEq)]
pub enum Occlusion {
    /// Nothing: every surface reflects, even the far side.
    None,
    /// The surfaces between speaker and reflector, crossed there and back.
    Speaker,
    /// The surfaces on the path from the speaker, and those on the path back, averaged over these points of the array.
    Aperture(Vec<DVec3>),
}

choice! {
    /// The run file's word for an [`Occlusion`].
    pub enum OcclusionKind: "occlusion" {
        /// [`Occlusion::None`].
        None = "none",
        /// [`Occlusion::Speaker`].
        Speaker = "speaker",
        /// [`Occlusion::Aperture`].
        Aperture = "aperture",
    }
}

impl Occlusion {
    /// The share of the amplitude that is left of an echo at `p` after what it crosses, there and back.
    pub(super) fn there_and_back(&self, scene: &Scene, speaker: DVec3, p: DVec3) -> f64 {
        if *self == Self::None {
            return 1.0;
        }
        let there = scene.transmittance(speaker, p);
        if there > 0.0 { there * self.back(scene, speaker, p) } else { 0.0 }
    }

    /// The same of the way back alone.
    pub(super) fn back(&self, scene: &Scene, speaker: DVec3, p: DVec3) -> f64 {
        match self {
            Self::None => 1.0,
            Self::Speaker => scene.transmittance(speaker, p),
            Self::Aperture(points) => {
                points.iter().map(|&r| scene.transmittance(p, r)).sum::<f64>() / points.len().max(1) as f64
            }
        }
    }
}
