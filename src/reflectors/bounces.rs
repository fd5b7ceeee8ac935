//! Multipath: echoes that meet two surfaces or more between speaker and microphone, as further reflectors.
//!
//! A wall divides what it reflects between a mirror image and diffuse scatter ([`energy`]). Paths with at most one diffuse
//! patch are found by mirror images: of the speaker in the facets before the patch, and of the patch in those after it.
//! The patch is one of the scene's reflectors, and what its images change is the length of the way to it, t, and the place
//! q from which it is seen:
//!
//! | path | t | q |
//! |---|---|---|
//! | mirror, patch p | `∣s' − p∣` | p |
//! | patch p, mirror | `∣s − p∣` | p', the image of p |
//! | mirrors alone | 0 | s', the image of s |
//! | patch p₁, patch p₂ | `∣s − p₁∣ + ∣p₁ − p₂∣` | p₂ |
//!
//! The tree over the triangles says what hides each leg. Two diffuse patches are [pairs]. Mirrors seen by the microphones
//! are open to some of them only: which, the simulation decides for each ([`Reflectors::directivity`]).

mod chains;
mod energy;
mod pairs;
mod sample;
mod summary;
mod trace;
#[cfg(test)]
mod tests;

pub(super) use sample::TracingSample;
pub use summary::BouncePath;

use super::bounced::{BounceCounts, Bounced, PathKind};
use super::facets::{BYTES_PER_TRIANGLE, Facets, MOST_FACETS};
use super::{Reflectors, Sample, SurfaceModel, SurfaceOptions, does_not_fit};
use crate::alloc::try_with_capacity;
use crate::error::{Error, Result};
use crate::progress::{Observer, advance, stage};
use crate::scene::Scene;
use crate::with_fields::with_fields;
use chains::{chains, kinds};
use energy::Roughness;
use glam::DVec3;
use num_complex::Complex32;
use rayon::prelude::*;
use trace::{SurfacePatch, Tracer};

/// The most bounced echoes of a list; the weakest beyond it are dropped.
const MOST_BOUNCED: usize = 1 << 20;

/// The most paths with a mirror and a patch that are looked at; more mirrors are left out, the smallest first.
const MOST_TRACED: usize = 1 << 22;

/// Patches that a thread works on at a time.
const BLOCK: usize = 512;

/// Echoes of more than one surface, for [`SurfaceOptions::bounces`].
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct BounceOptions {
    /// Surfaces beyond the first: 1 for all paths of two surfaces; 2 for those of three too, of which two or all are mirrors.
    pub order: u32,
    /// Points of the array, m: what hides a leg from a mirror to the microphones is averaged over them, and their middle is
    /// where angles are taken to.
    pub sight: Vec<DVec3>,
    /// Whether amplitudes fall with distance, as the simulation must be told, too.
    pub spreading: bool,
}

with_fields! {
    BounceOptions {
        with_spreading(spreading: bool),
    }
}

impl BounceOptions {
    /// One bounce, or two, towards an array with points `sight`, m; amplitudes without spreading.
    pub fn new(order: u32, sight: Vec<DVec3>) -> Self {
        Self { order, sight, spreading: false }
    }
}

/// One bounced echo.
#[derive(Debug, Clone, Copy, PartialEq)]
struct BouncedEcho {
    place: DVec3,
    amplitude: Complex32,
    transmit: f64,
    /// The first place to which the speaker's sound comes straight, unfolded where mirrors bring it there.
    origin: DVec3,
    kind: u32,
}

/// About as many bounced echoes as a scene of so many triangles and reflectors has at most, and bytes while they are found.
pub(crate) fn most_bounced(triangles: u64, reflectors: u64, order: u32) -> [u64; 2] {
    let facets = triangles.min(MOST_FACETS as u64) as usize;
    let traced = reflectors.saturating_mul(kinds(facets, order) as u64).min(MOST_TRACED as u64);
    let most = traced.saturating_add(pairs::most(reflectors));
    let merging = triangles.saturating_mul(BYTES_PER_TRIANGLE);
    let bytes = most.saturating_mul(2 * size_of::<BouncedEcho>() as u64).saturating_add(merging);
    [most.min(MOST_BOUNCED as u64), bytes]
}

/// How rough walls are.
///
/// # Errors
/// Surfaces that are mirrors by their samples.
fn roughness(options: &SurfaceOptions) -> Result<Roughness> {
    Ok(match options.surface {
        SurfaceModel::Diffuse => Roughness::DIFFUSE,
        SurfaceModel::Rough(sigma) => Roughness::new(sigma, options.wavelength),
        SurfaceModel::Smooth => {
            let problem = "is \"smooth\", whose reflectors are a mirror by themselves; with bounces use \"rough\", whose \
                           mirror images are exact, and a small roughness";
            return Err(Error::input("reflectors.surface", problem));
        }
    })
}

/// The facets that mirror, as many as so many patches leave time for.
fn mirrors(
    scene: &Scene,
    options: &SurfaceOptions,
    bounces: &BounceOptions,
    roughness: Roughness,
    patches: usize,
) -> Facets {
    if !roughness.mirrors() {
        return Facets::default();
    }
    let mut facets = Facets::of(scene, options.wavelength);
    let affordable = |count: usize| kinds(count, bounces.order) * patches <= MOST_TRACED;
    let count = (0..=facets.mirrors.len()).rev().find(|&count| affordable(count)).unwrap_or(0);
    facets.keep(count);
    facets
}

/// The reflectors of a scene's samples, each with its random phase: those that sound reaches directly, and bounced ones.
///
/// # Errors
/// Surfaces that are mirrors by their samples, or not shaded; too little memory.
pub(super) fn reflect(
    scene: &Scene,
    options: &SurfaceOptions,
    bounces: &BounceOptions,
    samples: &[Sample],
    scatter: &[(Complex32, f64)],
    observer: &dyn Observer,
) -> Result<Reflectors> {
    let roughness = roughness(options)?;
    if !options.lambert {
        let problem = "leaves out the cosines that conserve energy, without which nothing ties mirror images to scatter; \
                       with bounces use \"lambert\"";
        return Err(Error::input("reflectors.shading", problem));
    }
    if !(1..=2).contains(&bounces.order) || bounces.sight.is_empty() {
        return Err(Error::input("scene.bounces", "must be 1 or 2, towards one point of an array at least"));
    }
    let rigid = options.rigid_velocity(scene)?;
    let facets = mirrors(scene, options, bounces, roughness, samples.len());
    let no_room = || does_not_fit(options.spacing);
    let mut patches: Vec<SurfacePatch> = try_with_capacity(samples.len() as u64).ok_or_else(no_room)?;
    let before_array = samples.iter().zip(scatter).filter(|(sample, _)| sample.position.z > 0.0);
    patches.extend(
        before_array.map(|(sample, (phase, _))| SurfacePatch::new(scene, &facets, roughness, sample, *phase)),
    );
    let tracer = Tracer::new(scene, options, bounces, &facets, roughness);
    // The first kind is the direct echo.
    let kinds = chains(facets.mirrors.len(), bounces.order);
    let work = (kinds.len() * patches.len()) as u64;
    let mut echoes =
        stage(observer, "tracing bounces", work, || traced(&tracer, &kinds, &patches, observer))?;
    let (partners, paired) = stage(observer, "tracing pairs of patches", patches.len() as u64, || {
        pairs::pairs(&tracer, &patches, (kinds.len() as u32, options.seed), observer)
    })?;
    let first = echoes.iter().take_while(|echo| echo.kind == 0).count();
    let mut bounced: Vec<BouncedEcho> = echoes.split_off(first);
    bounced.try_reserve(paired.len()).map_err(|_| no_room())?;
    bounced.extend(paired);
    let dropped_energy = keep_strongest(&mut bounced, MOST_BOUNCED);
    let counts = BounceCounts {
        mirrors: facets.mirrors.len(),
        no_mirror_area: if roughness.mirrors() { facets.left_out } else { scene.surface_area() },
        partners,
        dropped_energy,
        ..BounceCounts::default()
    };
    let all = || echoes.iter().chain(&bounced);
    let mut list =
        Reflectors::new(all().map(|echo| echo.place).collect(), all().map(|echo| echo.amplitude).collect())?;
    let paired = PathKind { patches: 2, ..PathKind::default() };
    list.bounced = Some(Bounced {
        first,
        transmit: bounced.iter().map(|echo| echo.transmit).collect(),
        origins: rigid.map_or(Vec::new(), |_| bounced.iter().map(|echo| echo.origin).collect()),
        kind: bounced.iter().map(|echo| echo.kind).collect(),
        kinds: kinds.into_iter().chain([paired]).collect(),
        materials: facets
            .mirrors
            .iter()
            .map(|facet| scene.materials()[facet.material as usize].name.clone())
            .collect(),
        facets: facets.mirrors.into(),
        counts,
        ..Bounced::none(first, options.speaker)
    });
    list.moving_as_one(rigid)
}

/// The echoes of all paths with at most one patch, kind by kind.
fn traced(
    tracer: &Tracer<'_>,
    kinds: &[PathKind],
    patches: &[SurfacePatch],
    observer: &dyn Observer,
) -> Result<Vec<BouncedEcho>> {
    let mut all = Vec::new();
    for (index, kind) in (0_u32..).zip(kinds) {
        if kind.patches == 0 {
            all.extend(tracer.mirrored(kind, index));
            advance(observer, patches.len() as u64)?;
            continue;
        }
        let of_blocks: Vec<Vec<BouncedEcho>> = patches
            .par_chunks(BLOCK)
            .map(|some| {
                advance(observer, some.len() as u64)?;
                Ok(some.iter().filter_map(|patch| tracer.scattered(kind, index, patch)).collect())
            })
            .collect::<Result<_>>()?;
        for some in of_blocks {
            all.try_reserve(some.len()).map_err(|_| does_not_fit(tracer.spacing()))?;
            all.extend(some);
        }
    }
    Ok(all)
}

/// Keeps the strongest, in their order, and returns the share of the energy of the others.
fn keep_strongest(echoes: &mut Vec<BouncedEcho>, most: usize) -> f64 {
    if echoes.len() <= most {
        return 0.0;
    }
    let energy = |echoes: &[BouncedEcho]| -> f64 {
        echoes.iter().map(|echo| f64::from(echo.amplitude.norm_sqr())).sum()
    };
    let all = energy(echoes);
    let mut order: Vec<u32> = (0..echoes.len() as u32).collect();
    let strength = |i: u32| echoes[i as usize].amplitude.norm_sqr();
    order.sort_unstable_by(|&a, &b| strength(b).total_cmp(&strength(a)).then(a.cmp(&b)));
    order.truncate(most);
    order.sort_unstable();
    let kept: Vec<BouncedEcho> = order.iter().map(|&i| echoes[i as usize]).collect();
    let dropped = 1.0 - energy(&kept) / all;
    *echoes = kept;
    dropped
}
