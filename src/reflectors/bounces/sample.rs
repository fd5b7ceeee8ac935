//! A few paths of every kind, traced to know how many there will be and how long they take.

use super::energy::Roughness;
use super::pairs::{LitPatches, partners};
use super::trace::{SurfacePatch, Tracer};
use super::{BounceOptions, MOST_BOUNCED, chains, mirrors, roughness};
use crate::error::Result;
use crate::reflectors::{Sample, SurfaceOptions};
use crate::scene::Scene;
use num_complex::Complex32;
use std::time::Instant;

/// Paths by mirrors and a patch, and pairs of patches, at most.
const MIRRORED: usize = 1 << 15;
const PAIRS: usize = 1 << 12;

/// What is expected of all paths.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(in crate::reflectors) struct TracingSample {
    pub(in crate::reflectors) mirrors: usize,
    pub(in crate::reflectors) echoes: f64,
    /// s on one thread, and what no other thread can share.
    pub(in crate::reflectors) seconds: f64,
    pub(in crate::reflectors) once: f64,
}

impl TracingSample {
    /// From some samples of a scene's surfaces, of which there will be so many `patches`.
    ///
    /// # Errors
    /// Surfaces that are mirrors by their samples.
    pub(in crate::reflectors) fn of(
        scene: &Scene,
        options: &SurfaceOptions,
        bounces: &BounceOptions,
        (samples, scatter): (&[Sample], &[(Complex32, f64)]),
        patches: f64,
    ) -> Result<Self> {
        let roughness: Roughness = roughness(options)?;
        let begun = Instant::now();
        let facets = mirrors(scene, options, bounces, roughness, patches as usize);
        let once = begun.elapsed().as_secs_f64();
        let of = |(sample, (phase, _)): (&Sample, &(Complex32, f64))| {
            SurfacePatch::new(scene, &facets, roughness, sample, *phase)
        };
        let before_array = samples.iter().zip(scatter).filter(|(sample, _)| sample.position.z > 0.0);
        let some: Vec<SurfacePatch> = before_array.map(of).collect();
        let mut found = Self { mirrors: facets.mirrors.len(), echoes: 0.0, seconds: 0.0, once };
        if some.is_empty() {
            return Ok(found);
        }
        let tracer = Tracer::new(scene, options, bounces, &facets, roughness);
        let kinds = chains(facets.mirrors.len(), bounces.order);
        let patches = patches * some.len() as f64 / samples.len() as f64;
        // The first kind is the direct echo, which is no bounced one and takes its time.
        let every = (kinds.len() * some.len()).div_ceil(MIRRORED);
        let (mut once_each, mut of_patches, mut looked_at) = (0, 0, 0);
        let begun = Instant::now();
        for (index, kind) in (0_u32..).zip(&kinds) {
            if kind.patches == 0 {
                once_each += usize::from(tracer.mirrored(kind, index).is_some());
                continue;
            }
            let traced =
                some.iter().step_by(every).filter(|patch| tracer.scattered(kind, index, patch).is_some());
            let count = traced.count();
            looked_at = some.len().div_ceil(every);
            of_patches += if index == 0 { 0 } else { count };
        }
        let times = patches / looked_at.max(1) as f64;
        found.seconds += begun.elapsed().as_secs_f64() * times;
        found.echoes += once_each as f64 + of_patches as f64 * times;
        let begun = Instant::now();
        let lit = LitPatches::of(&tracer, &some);
        let share = lit.patches.len() as f64 / some.len() as f64;
        // Of the patches that light each, a few.
        let few = (PAIRS / some.len()).clamp(1, lit.patches.len().max(1)).min(lit.patches.len());
        let arrived: usize = some
            .iter()
            .map(|last| lit.echoes(last, (0..few).map(|k| k * lit.patches.len() / few), (0, 1.0)).len())
            .sum();
        let all = partners(patches as usize, (share * patches) as usize).min((share * patches) as usize);
        let times = patches * all as f64 / (some.len() * few).max(1) as f64;
        found.seconds += begun.elapsed().as_secs_f64() * times;
        found.echoes = (found.echoes + arrived as f64 * times).min(MOST_BOUNCED as f64);
        Ok(found)
    }
}
