//! Paths from one diffuse patch to another: each patch is lit by the others.
//!
//! The amplitude from patch to patch is `B₁ B₂ / √(d² + √(a₁ a₂)/π)`, with what each scatters, B, and their distance d; the term
//! with the areas keeps a patch beside another from sending on more than it received (Wallace, Elmquist and Haines
//! 1989). Where all pairs would be too many, each patch is lit by some, drawn evenly from all that the speaker
//! lights, and as many times as strong in energy.

use super::trace::{SurfacePatch, Tracer};
use super::{BLOCK, BouncedEcho};
use crate::error::Result;
use crate::progress::{Observer, advance};
use crate::reflectors::does_not_fit;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use rand_distr::{Distribution, StandardUniform};
use rayon::prelude::*;
use std::f64::consts::PI;

/// The most pairs that are looked at.
const MOST_PAIRS: usize = 1 << 18;

/// The seed's stream of the draw of partners.
const PARTNER_STREAM: u64 = 2;

/// The golden ratio's fraction, by which the draws of one patch are spread.
const GOLDEN: f64 = std::f64::consts::GOLDEN_RATIO - 1.0;

/// How many pairs so many patches have at most.
pub(super) fn most(patches: u64) -> u64 {
    patches.saturating_mul(patches).min(patches.max(MOST_PAIRS as u64))
}

/// The patches that light each patch, and of how many they are drawn; and the echoes of all pairs, of this kind.
pub(super) fn pairs(
    tracer: &Tracer<'_>,
    patches: &[SurfacePatch],
    (kind, seed): (u32, u64),
    observer: &dyn Observer,
) -> Result<([usize; 2], Vec<BouncedEcho>)> {
    let lit = LitPatches::of(tracer, patches);
    let count = partners(patches.len(), lit.patches.len());
    let weight = (lit.patches.len() as f64 / count as f64).sqrt();
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    random.set_stream(PARTNER_STREAM);
    let starts: Vec<f64> = patches.iter().map(|_| StandardUniform.sample(&mut random)).collect();
    let blocks = patches.par_chunks(BLOCK).zip(starts.par_chunks(BLOCK));
    let of_blocks: Vec<Vec<BouncedEcho>> = blocks
        .map(|(some, starts)| {
            advance(observer, some.len() as u64)?;
            let mut echoes = Vec::new();
            for (last, start) in some.iter().zip(starts) {
                let all = lit.patches.len();
                let draw = |k: usize| {
                    let within = (start + GOLDEN * k as f64).fract();
                    let drawn = ((k as f64 + within) * all as f64 / count as f64) as usize;
                    // All of them, where there are no more.
                    if count == all { k } else { drawn.min(all - 1) }
                };
                let drawn = (0..count.min(all)).map(draw);
                echoes.extend(lit.echoes(last, drawn, (kind, weight)));
            }
            Ok(echoes)
        })
        .collect::<Result<_>>()?;
    let mut all = Vec::new();
    for some in of_blocks {
        all.try_reserve(some.len()).map_err(|_| does_not_fit(tracer.spacing()))?;
        all.extend(some);
    }
    Ok(([count.min(lit.patches.len()), lit.patches.len()], all))
}

/// How many of the patches that are `lit` light each of so many.
pub(super) fn partners(patches: usize, lit: usize) -> usize {
    (MOST_PAIRS / patches.max(1)).clamp(1, lit.max(1))
}

/// The patches that the speaker lights, with the share of the amplitude that arrives.
#[derive(Debug)]
pub(super) struct LitPatches<'t, 'p> {
    tracer: &'t Tracer<'t>,
    pub(super) patches: Vec<(&'p SurfacePatch, f64)>,
}

impl<'t, 'p> LitPatches<'t, 'p> {
    pub(super) fn of(tracer: &'t Tracer<'t>, patches: &'p [SurfacePatch]) -> Self {
        let lit = patches.par_iter().filter_map(|patch| {
            let (_, arriving) = tracer.arriving(patch.position, &[]);
            (arriving > 0.0).then_some((patch, arriving))
        });
        Self { tracer, patches: lit.collect() }
    }

    /// The echoes of a patch that is lit by some of them, by their numbers.
    pub(super) fn echoes(
        &self,
        last: &SurfacePatch,
        drawn: impl Iterator<Item = usize>,
        (kind, weight): (u32, f64),
    ) -> Vec<BouncedEcho> {
        let tracer = self.tracer;
        let (_, centre, leaving) = tracer.leaving(last.position, &[]);
        if leaving == 0.0 {
            return Vec::new();
        }
        let echo = |drawn: usize| {
            let (first, arriving) = self.patches[drawn];
            let (p, q) = (first.position, last.position);
            let scattered = first.scatter(tracer.speaker(), q) * last.scatter(p, centre);
            if scattered == 0.0 {
                return None;
            }
            let (out, across) = (tracer.speaker().distance(p), p.distance(q));
            let between =
                tracer.leg(p, q) / across.mul_add(across, (first.area * last.area).sqrt() / PI).sqrt();
            let shares = arriving * leaving * tracer.spread(out) * weight;
            let amplitude = (scattered * between * shares) as f32;
            let phase = first.phase * last.phase;
            let transmit = out + across;
            (amplitude > 0.0).then(|| BouncedEcho {
                place: q,
                amplitude: phase * amplitude,
                transmit,
                origin: p,
                kind,
            })
        };
        drawn.filter_map(echo).collect()
    }
}
