//! The choice between the literal sum and virtual tones, and of tiles and tones.
//!
//! It depends on counted operations, not on measured times, so the same input always takes the same path.

use super::echoes::{CentrePath, Intervals};
use super::expand::TILES_PER_THREAD;
use super::literal::COLUMNS;
use super::paths::{outward_length, path_length};
use super::terms::{LossModel, MOST_TERMS};
use super::virtual_tones::{MORE, TONE_DESIGNS, ToneDesign};
use super::{PropagationModel, SimulateOptions, cells};
use crate::acquisition::{Instrument, Tile, tiles};
use crate::reflectors::Reflectors;
use crate::scene::FARTHEST;
use glam::DVec3;
use num_complex::Complex32;

/// A possible plan for virtual tones.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct CandidatePlan {
    /// Maximum number of microphones of a tile.
    pub(super) microphones: usize,
    /// Maximum radius of a tile, m.
    pub(super) radius: f64,
    pub(super) design: ToneDesign,
    /// Microphones whose sums are in memory at a time.
    pub(super) held: usize,
}

/// Tile sizes that are considered. Larger ones would be no faster, and leave fewer tiles to share among threads.
const TILES: [usize; 4] = [1, 4, 16, MOST_OF_TILE];
pub(super) const MOST_OF_TILE: usize = 64;

/// Maximum share of a duration that the paths to one tile may take, so that an interval remains.
pub(super) const TILE_SHARE: f64 = 0.75;

/// Offsets of more wavelengths than this have a rounding error above 10⁻⁶ cycles in f32.
pub(super) const MOST_CYCLES: f64 = 8.0;

/// Maximum number of intervals that fits into a sorting key.
pub(super) const MOST_INTERVALS: f64 = 1e8;

/// Maximum number of sums in memory, 8 bytes each, and of microphones at a time.
pub(super) const HELD_SUMS: f64 = 16_777_216.0;
const HELD_MICROPHONES: f64 = 4096.0;

/// Reflectors and tiles that are sampled for the estimate.
const SAMPLED_REFLECTORS: usize = 512;
const SAMPLED_TILES: usize = 3;

// Operations, in f32 lanes, as measured on AVX-512 relative to the 8 of the literal recurrence.
const LITERAL_TERM: f64 = 8.0;
const UNEVEN_TERM: f64 = 60.0;
const LITERAL_PAIR: f64 = 250.0;
/// A term with a factor that depends on the frequency.
const LOSSY_TERM: f64 = 400.0;
/// Losses of a reflector at a microphone, and the factor of one term.
pub(super) const LEGS: f64 = 40.0;
pub(super) const FACTOR: f64 = 60.0;
pub(super) const PAIR: f64 = 85.0;
pub(super) const TONE: f64 = 7.0;
/// Sorting a reflector for a tile and copying it into a batch.
pub(super) const SORTING: f64 = 3000.0;
/// Expansion, per group, microphone and frequency: the phase, and a multiplication per tone.
pub(super) const PHASE: f64 = 40.0;
pub(super) const PRODUCT: f64 = 4.0;
/// Summing the lanes of a group, per microphone and tone, and the lanes that its reflectors do not fill.
pub(super) const ACROSS: f64 = 60.0;
pub(super) const PADDING: f64 = 8.0;
/// Solving for W, per frequency and tone.
pub(super) const SOLVE: f64 = 5000.0;

/// The maximum radius of a tile for a duration, m.
pub(super) fn widest_tile(design: ToneDesign, instrument: &Instrument) -> f64 {
    let Instrument { sweep, geometry, sound_speed, .. } = instrument;
    let length = design.time_bandwidth / sweep.bandwidth() * sound_speed;
    let cycles = MOST_CYCLES * sound_speed / sweep.stop();
    (0.5 * TILE_SHARE * length).min(cycles) / geometry.return_legs()
}

/// Operations of a path that bends at an interface; a straight one takes next to none.
const REFRACTED: f64 = 1000.0;

/// Those of one reflector at one microphone.
fn refracted(instrument: &Instrument) -> f64 {
    if instrument.interface.is_some() { REFRACTED } else { 0.0 }
}

/// Operations of the literal sum.
pub(super) fn literal(reflectors: f64, instrument: &Instrument, options: &SimulateOptions) -> f64 {
    let Instrument { sweep, array, .. } = instrument;
    let microphones = array.len() as f64;
    let term = match sweep.step() {
        _ if options.losses.vary() => LOSSY_TERM,
        Some(_) => LITERAL_TERM,
        None => UNEVEN_TERM,
    };
    reflectors * microphones * (LITERAL_PAIR + refracted(instrument) + term * sweep.len() as f64)
}

/// The plans that take fewer operations than the literal sum, and how many, cheapest first.
pub(super) fn candidates(
    reflectors: &Reflectors,
    instrument: &Instrument,
    options: &SimulateOptions,
) -> Vec<(f64, CandidatePlan)> {
    let Instrument { sweep, array, sound_speed, .. } = instrument;
    let (n_p, n_mic, n_f) = (reflectors.len() as f64, array.len() as f64, sweep.len() as f64);
    let most = literal(n_p, instrument, options);
    let terms = terms(reflectors, instrument, options);
    let lossy = f64::from(u8::from(options.losses.any()));
    let bent = refracted(instrument);
    let centre = array.centre();
    let paths = (0..reflectors.len()).map(|j| path_length(reflectors, j, centre, instrument, options));
    let (shortest, longest) =
        paths.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), path| (path.min(low), path.max(high)));
    let spread = longest - shortest + array.extent().length();
    // Farther away the squares overflow f32, and no phase is accurate; NaN is rejected, too.
    let is_near = longest.abs() <= 10.0 * FARTHEST;
    if !is_near {
        return Vec::new();
    }
    let mut found: Vec<(f64, CandidatePlan)> = Vec::new();
    // From the largest to the smallest, so that they are only cut further.
    let mut tiles = tiles(array.positions(), array.len(), f64::INFINITY);
    for &count in TILES.iter().rev() {
        // A lower bound for every design, because cutting a large array into small tiles takes time, too.
        let echo = PAIR + TONE * (2 * TONE_DESIGNS[0].pairs + 1) as f64;
        let least = n_p * n_mic * (echo + SORTING / count as f64) + SOLVE * n_f;
        if least >= found.iter().map(|(cost, _)| *cost).fold(most, f64::min) {
            continue;
        }
        tiles = Tile::cut_further(&tiles, array.positions(), count, f64::INFINITY);
        let mut radii: Vec<f64> = tiles.iter().map(|tile| tile.radius).collect();
        radii.sort_unstable_by(f64::total_cmp);
        for (design, terms) in TONE_DESIGNS.into_iter().zip(&terms) {
            let Some(terms) = *terms else { continue };
            let length = design.time_bandwidth / sweep.bandwidth() * sound_speed;
            let radius = widest_tile(design, instrument);
            // A tile leaves at least this width of an interval, and empty intervals are not stored.
            let most_groups = (spread / ((1.0 - TILE_SHARE) * length) + 1.0).min(n_p);
            let tones = (2 * design.pairs + 1) as f64;
            let held = (HELD_SUMS / (most_groups * terms * (tones + MORE as f64))).min(HELD_MICROPHONES);
            // If most tiles would have to be cut further, a smaller size estimates that cost.
            let possible = spread / length < MOST_INTERVALS && held >= count as f64;
            if !possible || radii[radii.len() / 2] > radius {
                continue;
            }
            let groups = groups(reflectors, &tiles, (instrument, options.model), length, radius);
            let echo = lossy * LEGS + terms * (PAIR + bent + lossy * FACTOR + TONE * tones);
            let cost = n_p * n_mic * echo
                + n_p * tiles.len() as f64 * SORTING
                + n_mic
                    * groups
                    * (n_f * (PHASE + PRODUCT * terms * tones) + PADDING * echo + ACROSS * terms * tones)
                + SOLVE * n_f * tones;
            if cost < most {
                found.push((cost, CandidatePlan { microphones: count, radius, design, held: held as usize }));
            }
        }
    }
    found.sort_by(|a, b| a.0.total_cmp(&b.0));
    found
}

/// Number of terms of the losses for each design; `None` where too many would be needed.
fn terms(reflectors: &Reflectors, instrument: &Instrument, options: &SimulateOptions) -> Vec<Option<f64>> {
    let model = LossModel::new(reflectors, instrument, options);
    let count = |design: ToneDesign| {
        let half = 0.5 * design.time_bandwidth / instrument.sweep.bandwidth() * instrument.sound_speed;
        model.chebyshev_nodes(half, 0.5 * options.tolerance).map(|terms| terms.nodes.len() as f64)
    };
    TONE_DESIGNS.into_iter().map(count).collect()
}

/// Estimated number of groups of a tile, from a sample of tiles and reflectors.
fn groups(
    reflectors: &Reflectors,
    tiles: &[Tile],
    (instrument, model): (&Instrument, PropagationModel),
    length: f64,
    radius: f64,
) -> f64 {
    let narrow: Vec<&Tile> = tiles.iter().filter(|tile| tile.radius <= radius).collect();
    let some = narrow.iter().step_by(narrow.len().div_ceil(SAMPLED_TILES).max(1));
    let every = reflectors.len().div_ceil(SAMPLED_REFLECTORS).max(1);
    let (mut all, mut count) = (0, 0);
    for tile in some {
        let path = |j: usize| {
            let (p, outward) = (reflectors.positions()[j], outward_length(reflectors, j, instrument));
            CentrePath::new(p, outward, tile, instrument, model)
        };
        let paths: Vec<CentrePath> = (0..reflectors.len()).step_by(every).map(path).collect();
        all += Intervals::new(&paths, length).occupied(&paths);
        count += 1;
    }
    all as f64 / f64::from(count.max(1))
}

/// Estimated bytes that [`simulate`](super::simulate) takes in addition to the cube with `threads` threads, for reflectors
/// of which the `scene` has about so many within a box, m: the sums of the microphones in progress, and weights, for either
/// method; what each thread holds of every reflector; and the tiles.
///
/// The number of reflectors decides between the designs, but is only an estimate before they are sampled. The sums per metre of
/// path differ by less than a factor of two from those of the middle design.
pub(crate) fn bytes(
    instrument: &Instrument,
    scene: (Option<(DVec3, DVec3)>, u64),
    options: &SimulateOptions,
    threads: usize,
) -> u64 {
    let (bounds, reflectors) = scene;
    let each_thread = if options.losses.vary() { LOSSY_REFLECTOR } else { REFLECTOR };
    let directed = if options.losses.speaker_radius > 0.0 { 4 * MOST_TERMS as u64 } else { 0 };
    let of_reflectors = reflectors.saturating_mul(8 + directed + each_thread * threads.max(1) as u64);
    let of_microphones = TILED_MICROPHONE.saturating_mul(instrument.array.len() as u64);
    sums_bytes(instrument, (bounds, reflectors), options, threads)
        .saturating_add(of_reflectors)
        .saturating_add(of_microphones)
}

/// Bytes of a reflector on each thread: its path and its key, or, for the literal sum, its path and its losses.
const REFLECTOR: u64 = 32;
const LOSSY_REFLECTOR: u64 = 64;

/// Bytes of a microphone while the array is cut into tiles, where each is a tile of its own.
const TILED_MICROPHONE: u64 = (size_of::<Tile>() + 6 * size_of::<usize>()) as u64;

/// The sums of the microphones in progress, and weights.
fn sums_bytes(
    instrument: &Instrument,
    (bounds, reflectors): (Option<(DVec3, DVec3)>, u64),
    options: &SimulateOptions,
    threads: usize,
) -> u64 {
    let Instrument { sweep, array, sound_speed, .. } = instrument;
    let literal = (COLUMNS.min(array.len()) * size_of::<[f64; 2]>() * sweep.len()) as u64;
    let Some((low, high)) = bounds.filter(|_| sweep.bandwidth() > 0.0) else { return literal };
    let design = TONE_DESIGNS[TONE_DESIGNS.len() / 2];
    let length = design.time_bandwidth / sweep.bandwidth() * sound_speed;
    let [shortest, longest] = instrument.path_bounds_of((low, high));
    // On average, the paths to a tile take half of their maximum share.
    let groups = (longest - shortest) / ((1.0 - 0.5 * TILE_SHARE) * length) + 1.0;
    let ends = Reflectors::new(vec![low, high], vec![Complex32::ONE; 2]).unwrap_or_default();
    let terms =
        LossModel::new(&ends, instrument, options).chebyshev_nodes(0.5 * length, 0.5 * options.tolerance);
    let terms = terms.map_or(MOST_TERMS, |terms| terms.nodes.len());
    let columns = (2 * design.pairs + 1) * terms;
    let most = (TILES_PER_THREAD * threads.max(1) * MOST_OF_TILE).min(array.len());
    let sums = (HELD_MICROPHONES.min(most as f64) * groups * columns as f64).min(HELD_SUMS);
    let weights = (size_of::<f32>() * columns * sweep.len()) as u64;
    // Of the longest intervals, of which cells take up to a half.
    let longest_interval =
        TONE_DESIGNS[TONE_DESIGNS.len() - 1].time_bandwidth / sweep.bandwidth() * sound_speed;
    let cell_groups = (longest - shortest) / (0.5 * (1.0 - 0.5 * TILE_SHARE) * longest_interval) + 1.0;
    let of_cells = if options.model == PropagationModel::Exact {
        cells::bytes(reflectors, array.len(), cell_groups, terms)
    } else {
        0
    };
    literal.max(size_of::<Complex32>() as u64 * sums as u64 + weights).max(of_cells + weights)
}
