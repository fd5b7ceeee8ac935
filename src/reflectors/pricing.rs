//! What tracing echoes of several surfaces and of edges will give and take, from a few of them.
//!
//! How many paths are looked at follows from counts: patches, mirrors, pieces of edges. How many of them arrive, and how long a
//! path takes here, a sample tells that is traced on one thread.

use super::bounces::TracingSample;
use super::edges::EdgeSample;
use super::{SurfaceOptions, draw_scatter, poisson};
use crate::error::Result;
use crate::progress::Silent;
use crate::scene::Scene;
use serde::Serialize;

/// Patches of the sample, about.
const PATCHES: f64 = 600.0;

/// What bounces and edges of a scene come to, about.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[non_exhaustive]
pub struct TracingForecast {
    /// Patches of surface; 0 without bounces.
    pub patches: u64,
    /// Facets that mirror.
    pub mirrors: usize,
    /// Bounced echoes: images of patches and of the speaker, and pairs of patches.
    pub bounced: u64,
    /// Pieces of edges that the speaker and the microphones see.
    pub edge_pieces: u64,
    /// How long all of them are traced, s.
    pub seconds: f64,
}

impl std::fmt::Display for TracingForecast {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { patches, mirrors, bounced, edge_pieces, seconds } = *self;
        let mut parts = Vec::new();
        if patches > 0 {
            parts.push(format!("{bounced} bounced echoes of {patches} patches and {mirrors} mirrors"));
        }
        if edge_pieces > 0 {
            parts.push(format!("{edge_pieces} pieces of edges"));
        }
        if parts.is_empty() {
            parts.push("no echoes of several surfaces or edges".to_owned());
        }
        write!(f, "about {}, traced in {seconds:.1} s", parts.join(" and "))
    }
}

/// A quantity to two digits.
fn rounded(count: f64) -> u64 {
    if count < 100.0 {
        return count.round() as u64;
    }
    let unit = 10_f64.powf(count.log10().floor() - 1.0);
    ((count / unit).round() * unit) as u64
}

impl TracingForecast {
    /// Traces a few hundred paths of each kind; `None` for a scene without bounces and edges.
    ///
    /// # Errors
    /// Those of sampling and tracing all of them.
    pub(crate) fn of(scene: &Scene, options: &SurfaceOptions, threads: usize) -> Result<Option<Self>> {
        if options.bounces.is_none() && options.edges.is_none() {
            return Ok(None);
        }
        let mut found = Self { patches: 0, mirrors: 0, bounced: 0, edge_pieces: 0, seconds: 0.0 };
        let threads = threads.max(1) as f64;
        if let Some(bounces) = &options.bounces {
            let spacing = options.spacing.max((scene.surface_area() / PATCHES).sqrt());
            let samples = poisson::poisson_disk(scene.triangles(), spacing, options.seed, &Silent)?;
            let times = (spacing / options.spacing).powi(2);
            let patches = samples.len() as f64 * times;
            let Some(scatter) = draw_scatter(samples.len(), options) else { return Ok(None) };
            let sample = TracingSample::of(scene, options, bounces, (&samples, &scatter), patches)?;
            found.patches = rounded(patches);
            found.mirrors = sample.mirrors;
            found.bounced = rounded(sample.echoes);
            found.seconds += sample.once + sample.seconds / threads;
        }
        if let Some(edges) = &options.edges {
            let sample = EdgeSample::of(scene, options, edges);
            found.edge_pieces = rounded(sample.pieces);
            found.seconds += sample.once + sample.seconds / threads;
        }
        Ok(Some(found))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reflectors::{BounceOptions, EdgeOptions, SurfaceModel, sample_surface};
    use crate::scene::Triangle;
    use crate::scene::fixtures::{material, plate};
    use glam::DVec3;

    #[test]
    fn counts_are_about_those_that_are_found() {
        let side = plate([0.5, 1.2], [-0.4, 0.4], 0.4, 0).map(|t| {
            let turned = t.vertices.map(|v| DVec3::new(v.z, v.y, v.x));
            Triangle { vertices: turned, ..t }
        });
        let triangles = [plate([-0.5, 0.4], [-0.4, 0.4], 1.2, 0), side].concat();
        let scene = Scene::new(triangles, vec![material(0.9, 0.0)]).expect("valid");
        for (spacing, surface, order) in [
            (0.015, SurfaceModel::Rough(0.002), 1),
            (0.02, SurfaceModel::Rough(0.002), 2),
            (0.02, SurfaceModel::Diffuse, 1),
            (0.3, SurfaceModel::Rough(0.002), 2),
        ] {
            let options = SurfaceOptions::new(spacing, 0.0229)
                .with_surface(surface)
                .with_speaker(DVec3::new(-0.1, 0.0, 0.0))
                .with_bounces(Some(BounceOptions::new(order, vec![DVec3::ZERO])))
                .with_edges(Some(EdgeOptions::new(0.017)));
            let expected = TracingForecast::of(&scene, &options, 2).expect("small").expect("some");
            let list = sample_surface(&scene, &options).expect("small");
            let counts = list.bounce_counts().expect("some");
            let bounced = list.len() - list.direct() - counts.edge_pieces;
            assert_eq!(expected.mirrors, counts.mirrors);
            for (name, expected, found) in [
                ("bounced", expected.bounced, bounced),
                ("pieces", expected.edge_pieces, counts.edge_pieces),
                ("patches", expected.patches, list.direct()),
            ] {
                let ratio = (expected as f64 + 3.0) / (found as f64 + 3.0);
                assert!((0.6..1.7).contains(&ratio), "{name} of {spacing} {order}: {expected} {found}");
            }
            assert!(expected.seconds > 0.0 && expected.to_string().contains("mirrors"), "{expected}");
        }
        let none = SurfaceOptions::new(0.1, 0.0229);
        assert_eq!(TracingForecast::of(&scene, &none, 2).expect("none"), None);
    }

    #[test]
    fn counts_are_said_to_two_digits() {
        assert_eq!([3.4, 99.6, 1234.0, 197_866.0].map(rounded), [3, 100, 1200, 200_000]);
    }
}
