//! One path after another: its images, what hides its legs, and the amplitude of its echo.

use super::energy::Roughness;
use super::{BounceOptions, BouncedEcho, PathKind};
use crate::reflectors::bounced::passes;
use crate::reflectors::facets::{Facet, Facets};
use crate::reflectors::{Occlusion, Sample, SurfaceOptions};
use crate::scene::Scene;
use crate::wave::NEAREST_LEG;
use glam::DVec3;
use num_complex::Complex32;

/// A piece of a surface that scatters.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct SurfacePatch {
    pub(super) position: DVec3,
    normal: DVec3,
    /// m².
    pub(super) area: f64,
    reflectance: f64,
    roughness: Roughness,
    pub(super) phase: Complex32,
}

impl SurfacePatch {
    /// The patch of a sample with a random phase. One that belongs to no mirror scatters all that it reflects.
    pub(super) fn new(
        scene: &Scene,
        facets: &Facets,
        roughness: Roughness,
        sample: &Sample,
        phase: Complex32,
    ) -> Self {
        let triangle = &scene.triangles()[sample.triangle as usize];
        Self {
            position: sample.position,
            normal: triangle.normal(),
            area: sample.area,
            reflectance: scene.materials()[triangle.material as usize].reflectance,
            roughness: if facets.mirrors(sample.triangle) { roughness } else { Roughness::DIFFUSE },
            phase,
        }
    }

    /// The amplitude that it scatters of sound from `from` towards `to`, m; 0 through it.
    pub(super) fn scatter(&self, from: DVec3, to: DVec3) -> f64 {
        let cosine = |end: DVec3| self.normal.dot((end - self.position).normalize_or_zero());
        let (incident, scattered) = (cosine(from), cosine(to));
        let cosines = if incident < 0.0 { [-incident, -scattered] } else { [incident, scattered] };
        self.reflectance * self.area.sqrt() * self.roughness.diffuse(cosines)
    }
}

/// What every path is traced with.
#[derive(Debug, Clone, Copy)]
pub(super) struct Tracer<'a> {
    scene: &'a Scene,
    options: &'a SurfaceOptions,
    bounces: &'a BounceOptions,
    facets: &'a [Facet],
    roughness: Roughness,
    /// Where angles at the microphones are taken to, m.
    centre: DVec3,
}

impl<'a> Tracer<'a> {
    pub(super) fn new(
        scene: &'a Scene,
        options: &'a SurfaceOptions,
        bounces: &'a BounceOptions,
        facets: &'a Facets,
        roughness: Roughness,
    ) -> Self {
        let sight = &bounces.sight;
        let centre = sight.iter().sum::<DVec3>() / sight.len() as f64;
        Self { scene, options, bounces, facets: &facets.mirrors, roughness, centre }
    }

    pub(super) fn spacing(&self) -> f64 {
        self.options.spacing
    }

    pub(super) fn speaker(&self) -> DVec3 {
        self.options.speaker
    }

    /// `1 m / d`, with spreading.
    pub(super) fn spread(&self, distance: f64) -> f64 {
        if self.bounces.spreading { 1.0 / distance.max(NEAREST_LEG) } else { 1.0 }
    }

    /// The share of the amplitude that a leg keeps.
    pub(super) fn leg(&self, from: DVec3, to: DVec3) -> f64 {
        if self.options.occlusion == Occlusion::None { 1.0 } else { self.scene.transmittance(from, to) }
    }

    /// The image of `p` in these mirrors, the first one first.
    fn image(&self, p: DVec3, mirrors: impl Iterator<Item = u32>) -> DVec3 {
        mirrors.fold(p, |p, facet| self.facets[facet as usize].mirror(p))
    }

    /// The share of the amplitude that mirrors send on along the straight line between images, unfolded from its one end.
    fn mirrored_share(&self, mut direction: DVec3, mirrors: impl Iterator<Item = u32>) -> f64 {
        let mut share = 1.0;
        for index in mirrors {
            let facet = &self.facets[index as usize];
            let reflectance = self.scene.materials()[facet.material as usize].reflectance;
            share *= reflectance * self.roughness.coherent(facet.cosine(direction));
            direction = facet.turn(direction);
        }
        share
    }

    /// The share that the legs keep of a path from `from` to the place whose image `image` is seen through mirrors, the last
    /// of those that made it first; `None` where it passes by one of them.
    fn legs(&self, from: DVec3, image: DVec3, mirrors: impl Iterator<Item = u32> + Clone) -> Option<f64> {
        let facets = mirrors.map(|index| &self.facets[index as usize]);
        // The openings first: they take no ray.
        if !passes(facets.clone(), from, image) {
            return None;
        }
        let (mut at, mut image, mut kept) = (from, image, 1.0);
        for facet in facets {
            let x = facet.passage(at, image)?;
            kept *= self.leg(at, x);
            (at, image) = (x, facet.mirror(image));
            if kept == 0.0 {
                return Some(0.0);
            }
        }
        Some(kept * self.leg(at, image))
    }

    /// From the speaker by mirrors to `p`: the speaker's image, and the share of the amplitude that arrives.
    pub(super) fn arriving(&self, p: DVec3, before: &[u32]) -> (DVec3, f64) {
        let image = self.image(self.speaker(), before.iter().copied());
        let mirrors = before.iter().rev().copied();
        let Some(kept) = self.legs(p, image, mirrors.clone()) else { return (image, 0.0) };
        (image, kept * self.mirrored_share(image - p, mirrors))
    }

    /// From `p` by mirrors to the microphones: the image of `p`, that of the array's centre, and the share of the amplitude.
    pub(super) fn leaving(&self, p: DVec3, after: &[u32]) -> (DVec3, DVec3, f64) {
        let seen = self.image(p, after.iter().copied());
        let mirrors = after.iter().rev().copied();
        let centre = self.image(self.centre, mirrors.clone());
        let back = || self.options.occlusion.back(self.scene, self.speaker(), p);
        let kept = if after.is_empty() { back() } else { self.back_by(seen, after) };
        (seen, centre, kept * self.mirrored_share(seen - self.centre, mirrors))
    }

    /// The share that the way back to the array by mirrors keeps, on average over the points of the array that see the image.
    fn back_by(&self, image: DVec3, after: &[u32]) -> f64 {
        let points = self.bounces.sight.iter();
        let (sum, count) = points
            .filter_map(|&r| self.legs(r, image, after.iter().rev().copied()))
            .fold((0.0, 0), |(sum, count), kept| (sum + kept, count + 1));
        sum / f64::from(count.max(1))
    }

    /// The echo of a path with one patch.
    pub(super) fn scattered(&self, kind: &PathKind, index: u32, patch: &SurfacePatch) -> Option<BouncedEcho> {
        let p = patch.position;
        let (source, arriving) = self.arriving(p, &kind.before);
        if arriving == 0.0 {
            return None;
        }
        let (place, centre, leaving) = self.leaving(p, &kind.after);
        let transmit = source.distance(p);
        let direct = kind.before.is_empty() && kind.after.is_empty();
        // The simulation spreads the way to a reflector that it knows to be direct.
        let spread = if direct { 1.0 } else { self.spread(transmit) };
        let amplitude = (arriving * leaving * patch.scatter(source, centre) * spread) as f32;
        (amplitude > 0.0).then(|| BouncedEcho {
            place,
            amplitude: patch.phase * amplitude,
            transmit,
            origin: self.image(p, kind.before.iter().rev().copied()),
            kind: index,
        })
    }

    /// The echo of mirrors alone. Without spreading it is as strong as the image of a point there would be.
    pub(super) fn mirrored(&self, kind: &PathKind, index: u32) -> Option<BouncedEcho> {
        let (place, _, leaving) = self.leaving(self.speaker(), &kind.after);
        // Echoes without spreading are what they would be with it, times the two distances: half the path each.
        let scale = if self.bounces.spreading { 1.0 } else { 0.25 * place.distance(self.centre) };
        let amplitude = (leaving * scale) as f32;
        (amplitude > 0.0).then(|| BouncedEcho {
            place,
            amplitude: Complex32::new(amplitude, 0.0),
            transmit: 0.0,
            origin: self.speaker(),
            kind: index,
        })
    }
}
