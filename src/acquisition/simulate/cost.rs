//! Which way to simulate: literally, or with which tiles and tones.
//!
//! Operations are counted, never seconds measured, so the same input always goes the same way.

use super::super::simulate::SimulateOptions;
use super::super::{MicArray, Sweep};
use super::echoes::{Intervals, Sight};
use super::tiles::{Tile, tiles};
use super::virtual_tones::{RUNGS, Rung};
use crate::reflectors::Reflectors;

/// A way to simulate by virtual tones.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Choice {
    /// Most microphones of a tile.
    pub(super) microphones: usize,
    /// Greatest radius of a tile, m.
    pub(super) radius: f64,
    pub(super) rung: Rung,
}

/// Sizes of tiles that are weighed.
const TILES: [usize; 5] = [1, 4, 16, 64, 256];

/// The greatest share of a duration that the paths to one tile may take, so that an interval remains.
const TILE_SHARE: f64 = 0.75;

/// Offsets of more wavelengths than this lose more than 10⁻⁶ of a turn in f32.
const MOST_TURNS: f64 = 8.0;

/// More intervals than this are not counted out.
const MOST_INTERVALS: f64 = 1e9;

/// Reflectors and tiles that stand for all in the estimate.
const SAMPLED_REFLECTORS: usize = 512;
const SAMPLED_TILES: usize = 3;

// Operations, in f32 lanes, as measured on AVX-512 against the literal recurrence's 8.
const LITERAL_TERM: f64 = 8.0;
const UNEVEN_TERM: f64 = 60.0;
const LITERAL_PAIR: f64 = 250.0;
const PAIR: f64 = 80.0;
const TONE: f64 = 7.0;
/// Sorting a reflector for a tile and laying it out.
const SEEN: f64 = 1500.0;
/// Expansion: per group, microphone and frequency, beside a multiplication per tone; and the summing of a group's lanes.
const TURN: f64 = 20.0;
const PRODUCT: f64 = 1.0;
const ACROSS: f64 = 60.0;
/// Finding W, per frequency and tone.
const SOLVE: f64 = 5000.0;

/// Operations of the literal sum.
fn literal(reflectors: f64, microphones: f64, sweep: &Sweep) -> f64 {
    let term = if sweep.step().is_some() { LITERAL_TERM } else { UNEVEN_TERM };
    reflectors * microphones * (LITERAL_PAIR + term * sweep.len() as f64)
}

/// The ways that take fewer operations than the literal sum, the cheapest first.
pub(super) fn choices(
    reflectors: &Reflectors,
    sweep: &Sweep,
    array: &MicArray,
    options: &SimulateOptions,
) -> Vec<Choice> {
    let (n_p, n_mic, n_f) = (reflectors.len() as f64, array.len() as f64, sweep.len() as f64);
    let most = literal(n_p, n_mic, sweep);
    let paths = reflectors.positions().iter().map(|&p| options.path_length(p, array.centre()));
    let (shortest, longest) = paths.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), path| {
        (path.min(low), path.max(high))
    });
    let spread = longest - shortest + array.extent().length();
    let legs = options.geometry.return_legs();
    let widest = MOST_TURNS * options.sound_speed / (legs * sweep.stop());
    let mut found: Vec<(f64, Choice)> = Vec::new();
    for (i, &count) in TILES.iter().enumerate() {
        // A smaller array needs no larger tiles than the first that holds it.
        if i > 0 && TILES[i - 1] >= array.len() {
            break;
        }
        let tiles = tiles(array.positions(), count, f64::INFINITY);
        let mut radii: Vec<f64> = tiles.iter().map(Tile::radius).collect();
        radii.sort_unstable_by(f64::total_cmp);
        for rung in RUNGS {
            let length = rung.spread / sweep.bandwidth() * options.sound_speed;
            let radius = (TILE_SHARE * length / (2.0 * legs)).min(widest);
            let countable = spread / length < MOST_INTERVALS && longest.abs() < 1e12;
            // Where most tiles would have to be cut again, a smaller size says what that costs.
            if !countable || radii[radii.len() / 2] > radius {
                continue;
            }
            let groups = groups(reflectors, &tiles, options, length, radius);
            let tones = (2 * rung.pairs + 1) as f64;
            let echo = PAIR + TONE * tones;
            let cost = n_p * n_mic * echo
                + n_p * tiles.len() as f64 * SEEN
                + n_mic * groups * (n_f * (TURN + PRODUCT * tones) + 8.0 * echo + ACROSS * tones)
                + SOLVE * n_f * tones;
            if cost < most {
                found.push((cost, Choice { microphones: count, radius, rung }));
            }
        }
    }
    found.sort_by(|a, b| a.0.total_cmp(&b.0));
    found.into_iter().map(|(_, choice)| choice).collect()
}

/// About how many groups a tile has, from some tiles and reflectors.
fn groups(
    reflectors: &Reflectors,
    tiles: &[Tile],
    options: &SimulateOptions,
    length: f64,
    radius: f64,
) -> f64 {
    let narrow: Vec<&Tile> = tiles.iter().filter(|tile| tile.radius() <= radius).collect();
    let some = narrow.iter().step_by(narrow.len().div_ceil(SAMPLED_TILES).max(1));
    let every = reflectors.len().div_ceil(SAMPLED_REFLECTORS).max(1);
    let (mut all, mut count) = (0, 0);
    for tile in some {
        let sights: Vec<Sight> = reflectors
            .positions()
            .iter()
            .step_by(every)
            .map(|&p| Sight::new(p, tile, options))
            .collect();
        all += Intervals::new(&sights, length).occupied(&sights);
        count += 1;
    }
    all as f64 / f64::from(count.max(1))
}
