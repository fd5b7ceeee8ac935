//! Which way to simulate: literally, or with which tiles and tones.
//!
//! Operations are counted, never seconds measured, so the same input always goes the same way.

use super::echoes::{Intervals, Sight};
use super::expand::TILES_PER_THREAD;
use super::literal::COLUMNS;
use super::terms::{MOST_TERMS, Spread};
use super::virtual_tones::{MORE, RUNGS, Rung};
use super::{PropagationModel, SimulateOptions};
use crate::acquisition::{Instrument, Sweep, Tile, tiles};
use crate::reflectors::Reflectors;
use crate::scene::FARTHEST;
use crate::wave::Geometry;
use glam::DVec3;
use num_complex::Complex32;

/// A way to simulate by virtual tones.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Choice {
    /// Most microphones of a tile.
    pub(super) microphones: usize,
    /// Greatest radius of a tile, m.
    pub(super) radius: f64,
    pub(super) rung: Rung,
    /// Microphones whose sums are held at a time.
    pub(super) held: usize,
}

/// Sizes of tiles that are weighed. Larger ones would be no faster, and leave less to share among threads.
const TILES: [usize; 4] = [1, 4, 16, 64];

/// The greatest share of a duration that the paths to one tile may take, so that an interval remains.
const TILE_SHARE: f64 = 0.75;

/// Offsets of more wavelengths than this lose more than 10⁻⁶ of a turn in f32.
const MOST_TURNS: f64 = 8.0;

/// More intervals than this do not fit a sorting key.
const MOST_INTERVALS: f64 = 1e8;

/// Sums that may be held at a time, 8 bytes each, and microphones that never need more room.
const HELD_SUMS: f64 = 16_777_216.0;
const HELD_MICROPHONES: f64 = 4096.0;

/// Reflectors and tiles that stand for all in the estimate.
const SAMPLED_REFLECTORS: usize = 512;
const SAMPLED_TILES: usize = 3;

// Operations, in f32 lanes, as measured on AVX-512 against the literal recurrence's 8.
const LITERAL_TERM: f64 = 8.0;
const UNEVEN_TERM: f64 = 60.0;
const LITERAL_PAIR: f64 = 250.0;
/// A term whose factor depends on the frequency.
const LOSSY_TERM: f64 = 400.0;
/// Losses of a reflector at a microphone, and the factor of one term.
const LEGS: f64 = 40.0;
const FACTOR: f64 = 60.0;
const PAIR: f64 = 85.0;
const TONE: f64 = 7.0;
/// Sorting a reflector for a tile and laying it out.
const SEEN: f64 = 3000.0;
/// Expansion, per group, microphone and frequency: the phase, and a multiplication per tone.
const TURN: f64 = 40.0;
const PRODUCT: f64 = 4.0;
/// Summing the lanes of a group, per microphone and tone, and what it has too few reflectors to fill.
const ACROSS: f64 = 60.0;
const PADDING: f64 = 8.0;
/// Finding W, per frequency and tone.
const SOLVE: f64 = 5000.0;

/// The greatest radius of a tile beside a duration, m.
pub(super) fn widest_tile(rung: Rung, instrument: &Instrument) -> f64 {
    let Instrument { sweep, geometry, sound_speed, .. } = instrument;
    let length = rung.spread / sweep.bandwidth() * sound_speed;
    let turns = MOST_TURNS * sound_speed / sweep.stop();
    (0.5 * TILE_SHARE * length).min(turns) / geometry.return_legs()
}

/// Operations of the literal sum.
fn literal(reflectors: f64, microphones: f64, sweep: &Sweep, options: &SimulateOptions) -> f64 {
    let term = match sweep.step() {
        _ if options.losses.vary() => LOSSY_TERM,
        Some(_) => LITERAL_TERM,
        None => UNEVEN_TERM,
    };
    reflectors * microphones * (LITERAL_PAIR + term * sweep.len() as f64)
}

/// The ways that take fewer operations than the literal sum, the cheapest first.
pub(super) fn choices(
    reflectors: &Reflectors,
    instrument: &Instrument,
    options: &SimulateOptions,
) -> Vec<Choice> {
    let Instrument { sweep, array, geometry, sound_speed, .. } = instrument;
    let (n_p, n_mic, n_f) = (reflectors.len() as f64, array.len() as f64, sweep.len() as f64);
    let most = literal(n_p, n_mic, sweep, options);
    let terms = terms(reflectors, instrument, options);
    let lossy = f64::from(u8::from(options.losses.any()));
    let centre = array.centre();
    let paths = reflectors.positions().iter().map(|&p| options.model.path_length(geometry, p, centre));
    let (shortest, longest) =
        paths.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), path| (path.min(low), path.max(high)));
    let spread = longest - shortest + array.extent().length();
    // Farther away f32 would not hold the squares, and no phase means anything.
    let within_reach = longest.abs() <= 10.0 * FARTHEST;
    if !within_reach {
        return Vec::new();
    }
    let mut found: Vec<(f64, Choice)> = Vec::new();
    for &count in TILES.iter().rev() {
        // What no rung undercuts: cutting a large array into small tiles takes its time too.
        let echo = PAIR + TONE * (2 * RUNGS[0].pairs + 1) as f64;
        let least = n_p * n_mic * (echo + SEEN / count as f64) + SOLVE * n_f;
        if least >= found.iter().map(|(cost, _)| *cost).fold(most, f64::min) {
            continue;
        }
        let tiles = tiles(array.positions(), count, f64::INFINITY);
        let mut radii: Vec<f64> = tiles.iter().map(|tile| tile.radius).collect();
        radii.sort_unstable_by(f64::total_cmp);
        for (rung, terms) in RUNGS.into_iter().zip(&terms) {
            let Some(terms) = *terms else { continue };
            let length = rung.spread / sweep.bandwidth() * sound_speed;
            let radius = widest_tile(rung, instrument);
            // No interval is narrower than what a tile leaves of it, and none is kept empty.
            let most_groups = (spread / ((1.0 - TILE_SHARE) * length) + 1.0).min(n_p);
            let tones = (2 * rung.pairs + 1) as f64;
            let held = (HELD_SUMS / (most_groups * terms * (tones + MORE as f64))).min(HELD_MICROPHONES);
            // Where most tiles would have to be cut again, a smaller size says what that costs.
            let possible = spread / length < MOST_INTERVALS && held >= count as f64;
            if !possible || radii[radii.len() / 2] > radius {
                continue;
            }
            let groups = groups(reflectors, &tiles, (geometry, options.model), length, radius);
            let echo = lossy * LEGS + terms * (PAIR + lossy * FACTOR + TONE * tones);
            let cost = n_p * n_mic * echo
                + n_p * tiles.len() as f64 * SEEN
                + n_mic
                    * groups
                    * (n_f * (TURN + PRODUCT * terms * tones) + PADDING * echo + ACROSS * terms * tones)
                + SOLVE * n_f * tones;
            if cost < most {
                found.push((cost, Choice { microphones: count, radius, rung, held: held as usize }));
            }
        }
    }
    found.sort_by(|a, b| a.0.total_cmp(&b.0));
    found.into_iter().map(|(_, choice)| choice).collect()
}

/// Terms of the losses for each standard duration; `None` where too many would be needed.
fn terms(reflectors: &Reflectors, instrument: &Instrument, options: &SimulateOptions) -> Vec<Option<f64>> {
    let spread = Spread::new(reflectors, instrument, options);
    let half = |rung: Rung| 0.5 * rung.spread / instrument.sweep.bandwidth() * instrument.sound_speed;
    let count = |rung| spread.count(half(rung), 0.5 * options.tolerance).map(|c| c.nodes.len() as f64);
    RUNGS.into_iter().map(count).collect()
}

/// About how many groups a tile has, from some tiles and reflectors.
fn groups(
    reflectors: &Reflectors,
    tiles: &[Tile],
    (geometry, model): (&Geometry, PropagationModel),
    length: f64,
    radius: f64,
) -> f64 {
    let narrow: Vec<&Tile> = tiles.iter().filter(|tile| tile.radius <= radius).collect();
    let some = narrow.iter().step_by(narrow.len().div_ceil(SAMPLED_TILES).max(1));
    let every = reflectors.len().div_ceil(SAMPLED_REFLECTORS).max(1);
    let (mut all, mut count) = (0, 0);
    for tile in some {
        let sights: Vec<Sight> = reflectors
            .positions()
            .iter()
            .step_by(every)
            .map(|&p| Sight::new(p, geometry.outward_length(p), tile, geometry, model))
            .collect();
        all += Intervals::new(&sights, length).occupied(&sights);
        count += 1;
    }
    all as f64 / f64::from(count.max(1))
}

/// About the bytes that [`simulate`](super::simulate) takes beside the cube, by so many threads: the sums of the microphones
/// that are worked on at a time, and weights, whichever way it is done, for reflectors between the corners `bounds` of a box, m.
///
/// How many reflectors there are decides between the standard durations, and is not known before they are sampled. Sums
/// per metre of path differ by less than a factor of two from those of the duration in the middle.
pub(crate) fn bytes(
    instrument: &Instrument,
    bounds: Option<(DVec3, DVec3)>,
    options: &SimulateOptions,
    threads: usize,
) -> u64 {
    let Instrument { sweep, array, geometry, sound_speed, .. } = instrument;
    let literal = (COLUMNS.min(array.len()) * size_of::<[f64; 2]>() * sweep.len()) as u64;
    let Some((low, high)) = bounds.filter(|_| sweep.bandwidth() > 0.0) else { return literal };
    let rung = RUNGS[RUNGS.len() / 2];
    let length = rung.spread / sweep.bandwidth() * sound_speed;
    let [shortest, longest] = geometry.path_bounds((low, high), array.bounds());
    // The paths to a tile take half of what they may, as like as not.
    let groups = (longest - shortest) / ((1.0 - 0.5 * TILE_SHARE) * length) + 1.0;
    let ends = Reflectors::new(vec![low, high], vec![Complex32::ONE; 2]).unwrap_or_default();
    let terms = Spread::new(&ends, instrument, options).count(0.5 * length, 0.5 * options.tolerance);
    let columns = (2 * rung.pairs + 1) * terms.map_or(MOST_TERMS, |count| count.nodes.len());
    let most = (TILES_PER_THREAD * threads.max(1) * TILES[TILES.len() - 1]).min(array.len());
    let sums = (HELD_MICROPHONES.min(most as f64) * groups * columns as f64).min(HELD_SUMS);
    literal
        .max(size_of::<Complex32>() as u64 * sums as u64 + (size_of::<f32>() * columns * sweep.len()) as u64)
}
