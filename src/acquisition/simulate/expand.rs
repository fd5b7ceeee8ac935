//! The simulation by virtual tones: tiles summed at the tones, and their sums expanded into the cube.

use super::columns::Columns;
use super::cost;
use super::echoes::{GroupSums, Summation};
use super::stored::PlanNumbers;
use super::terms::{LossModel, LossTerms};
use super::virtual_tones::{EquispacedTones, TONE_DESIGNS, ToneDesign};
use super::{SimulateOptions, SimulationJob, no_room, record};
use crate::acquisition::{Instrument, Tile, tiles};
use crate::error::Result;
use crate::linalg::product_f32;
use crate::progress::{Observer, advance};
use crate::reflectors::Reflectors;
use crate::wave::offsets::rotate_and_add;
use crate::wave::simd::phasors;
use num_complex::Complex32;
use rayon::prelude::*;
use std::ops::Range;

/// Frequencies that one thread expands at a time.
const ROWS: usize = 32;

/// Tiles per thread that are summed between two opportunities to save: enough to keep every thread busy.
pub(super) const TILES_PER_THREAD: usize = 8;

/// Tiles, tones and terms of a simulation.
#[derive(Debug)]
pub(super) struct SimulationPlan {
    design: ToneDesign,
    pub(super) tiles: Vec<Tile>,
    pub(super) tones: EquispacedTones,
    /// Losses, if there are any.
    pub(super) terms: Option<LossTerms>,
    /// Weights of the expansion, `[n_f][K Q]`.
    weights: Vec<f32>,
    /// Microphones whose sums are in memory at a time; at least one tile.
    held: usize,
}

impl SimulationPlan {
    /// The plan of a candidate; `None` if its tones or terms do not meet the tolerance.
    pub(super) fn of(
        candidate: &cost::CandidatePlan,
        reflectors: &Reflectors,
        instrument: &Instrument,
        options: &SimulateOptions,
    ) -> Option<Self> {
        let cut = || tiles(instrument.array.positions(), candidate.microphones, candidate.radius);
        Self::with((candidate.design, candidate.held), cut, reflectors, instrument, options)
    }

    /// The plan with a design, tiles, and microphones in memory at a time.
    fn with(
        (design, held): (ToneDesign, usize),
        tiles: impl FnOnce() -> Vec<Tile>,
        reflectors: &Reflectors,
        instrument: &Instrument,
        options: &SimulateOptions,
    ) -> Option<Self> {
        let Instrument { sweep, sound_speed, .. } = instrument;
        let model = LossModel::new(reflectors, instrument, options);
        let half = 0.5 * design.time_bandwidth / sweep.bandwidth() * sound_speed;
        // Tones and terms share the tolerance; the interpolation of the terms amplifies the tones' error.
        let share = if options.losses.vary() { 0.5 } else { 1.0 };
        let nodes = model.chebyshev_nodes(half, share * options.tolerance)?;
        let tolerance = share * options.tolerance / nodes.lebesgue_constant;
        let mut tones = EquispacedTones::find(sweep, design, tolerance)?;
        let mut terms = None;
        let mut weights = std::mem::take(&mut tones.weights);
        if options.losses.any() {
            let losses = LossTerms::new(&nodes, &model, half, reflectors, instrument, options)?;
            weights = losses.weights(&weights);
            terms = Some(losses);
        }
        Some(Self { design, tiles: tiles(), tones, terms, weights, held })
    }

    /// The numbers by which another process finds it.
    pub(super) fn numbers(&self) -> PlanNumbers {
        let design = TONE_DESIGNS.iter().position(|design| *design == self.design).unwrap_or_default();
        let order =
            self.tiles.iter().flat_map(|tile| tile.microphones.iter().map(|&mic| mic as u32)).collect();
        let ends = self.tiles.iter().scan(0, |first, tile| {
            let end = *first + tile.microphones.len();
            Some(std::mem::replace(first, end)..end)
        });
        PlanNumbers { chosen: [design as u32, self.held as u32, 0], order, parts: ends.collect() }
    }

    /// The plan of such numbers; `None` if they are none of this job.
    pub(super) fn of_numbers(
        PlanNumbers { chosen: [design, held, _], order, parts }: &PlanNumbers,
        reflectors: &Reflectors,
        instrument: &Instrument,
        options: &SimulateOptions,
    ) -> Option<Self> {
        let (positions, design) = (instrument.array.positions(), *TONE_DESIGNS.get(*design as usize)?);
        let radius = cost::widest_tile(design, instrument);
        let tile = |part: &Range<usize>| {
            let tile = Tile::of(positions, order[part.clone()].iter().map(|&mic| mic as usize).collect());
            let few = tile.microphones.len() <= cost::MOST_OF_TILE && tile.radius <= radius;
            (tile.microphones.is_sorted() && (few || tile.microphones.len() == 1)).then_some(tile)
        };
        if order.len() != positions.len() {
            return None;
        }
        let tiles: Vec<Tile> = parts.iter().map(tile).collect::<Option<_>>()?;
        Self::with((design, *held as usize), || tiles, reflectors, instrument, options)
    }
}

/// Fills the samples, `[n_f, n_mic]`, with the plan's tiles and tones.
pub(super) fn fast(
    job: &SimulationJob<'_>,
    plan: &SimulationPlan,
    columns: &mut Columns,
    observer: &dyn Observer,
) -> Result<()> {
    let SimulationJob { reflectors, instrument, options, .. } = *job;
    let summation = Summation::new(reflectors, instrument, options, &plan.tones, plan.terms.as_ref());
    let summation = summation.ok_or_else(no_room)?;
    let mut missing = Vec::new();
    for (k, tile) in plan.tiles.iter().enumerate() {
        if columns.load(k, &tile.microphones)? {
            advance(observer, tile.microphones.len() as u64)?;
        } else {
            missing.push((k, tile));
        }
    }
    let most = TILES_PER_THREAD * rayon::current_num_threads();
    let mut rest = &missing[..];
    while !rest.is_empty() {
        // As many tiles as the plan's limit on microphones allows; the grouping does not affect the sums.
        let mut held = 0;
        let fitting = rest.iter().take(most).take_while(|(_, tile)| {
            held += tile.microphones.len();
            held <= plan.held
        });
        let (tiles, later) = rest.split_at(fitting.count().max(1));
        rest = later;
        let sums: Vec<Vec<GroupSums>> = tiles
            .par_iter()
            .map(|(_, tile)| {
                let sums = summation.groups(tile).ok_or_else(no_room)?;
                advance(observer, tile.microphones.len() as u64).map(|()| sums)
            })
            .collect::<Result<_>>()?;
        Expansion::new(&plan.weights, plan.terms.as_ref()).record(job, tiles, &sums, columns)?;
        columns.save_if_due()?;
    }
    Ok(())
}

/// How sums at tones become samples of all frequencies.
#[derive(Debug, Clone, Copy)]
pub(super) struct Expansion<'a> {
    /// `[n_f][K Q]`.
    weights: &'a [f32],
    /// α(f_n), Np/m; empty without absorption.
    absorption: &'a [f64],
}

impl<'a> Expansion<'a> {
    /// By these weights, `[n_f][K Q]`, and the losses, if there are any.
    pub(super) fn new(weights: &'a [f32], terms: Option<&'a LossTerms>) -> Self {
        Self { weights, absorption: terms.map_or(&[][..], |terms| &terms.absorption) }
    }

    /// Fills the columns of tiles, each with its number, from their sums.
    pub(super) fn record(
        &self,
        job: &SimulationJob<'_>,
        tiles: &[(usize, &Tile)],
        sums: &[Vec<GroupSums>],
        columns: &mut Columns,
    ) -> Result<()> {
        let SimulationJob { instrument, responses, .. } = *job;
        let microphones: Vec<_> = tiles.iter().map(|(k, tile)| (*k, &tile.microphones[..])).collect();
        columns.fill(&microphones, |samples, n_columns, columns| {
            samples.par_chunks_mut(ROWS * n_columns).enumerate().for_each(|(chunk, rows)| {
                let mut buffers = ExpansionBuffers::default();
                for (((_, tile), sums), columns) in tiles.iter().zip(sums).zip(columns) {
                    buffers.expand(chunk * ROWS, tile, sums, instrument, self);
                    let width = 2 * tile.microphones.len();
                    for (row, totals) in
                        rows.chunks_exact_mut(n_columns).zip(buffers.totals.chunks_exact(width))
                    {
                        let (re, im) = totals.split_at(width / 2);
                        let places = tile.microphones.iter().zip(columns);
                        for (((&mic, &column), re), im) in places.zip(re).zip(im) {
                            let m = Complex32::new(*re, *im);
                            row[column] = record(instrument.detection, responses.get(mic), m);
                        }
                    }
                }
            });
        })
    }
}

/// Buffers for one tile's expansion at some frequencies.
#[derive(Debug, Default)]
struct ExpansionBuffers {
    product: Vec<f32>,
    /// `[frequency][2 × microphones]`: all real parts, then all imaginary ones.
    totals: Vec<f32>,
    phasors: Vec<Complex32>,
}

impl ExpansionBuffers {
    /// `totals[n] = Σ_groups e^{i2πf_n·middle/c − α(f_n)·middle} Σ_q W[n, q] sums[q]` for [`ROWS`] frequencies from `first`.
    fn expand(
        &mut self,
        first: usize,
        tile: &Tile,
        groups: &[GroupSums],
        instrument: &Instrument,
        expansion: &Expansion<'_>,
    ) {
        let sweep = &instrument.sweep;
        let frequencies = &sweep.frequencies()[first..(first + ROWS).min(sweep.len())];
        let (rows, width, count) =
            (frequencies.len(), 2 * tile.microphones.len(), expansion.weights.len() / sweep.len());
        self.totals.clear();
        self.totals.resize(rows * width, 0.0);
        self.product.resize(rows * width, 0.0);
        self.phasors.resize(rows, Complex32::ZERO);
        let weights = &expansion.weights[first * count..(first + rows) * count];
        for group in groups {
            product_f32(&mut self.product, &group.sums, weights, [width, count, rows]);
            phasors(group.middle / instrument.sound_speed, frequencies, &mut self.phasors);
            for (phasor, absorption) in self.phasors.iter_mut().zip(expansion.absorption.iter().skip(first)) {
                *phasor *= (-absorption * group.middle).exp() as f32;
            }
            rotate_and_add(&self.phasors, &self.product, &mut self.totals);
        }
    }
}
