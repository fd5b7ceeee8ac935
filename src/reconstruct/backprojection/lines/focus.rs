//! The sums over the microphones of all lines, block by block of voxels.

use super::kernels::{Places, Ring, add_line, add_tone, turn};
use super::nodes::{BlockNodes, Needed};
use super::plan::LinesPlan;
use super::view::LineView;
use crate::alloc::{try_filled, try_with_capacity};
use crate::error::Result;
use crate::grid::{Grid, no_room_for};
use crate::progress::{Observer, advance};
use crate::reconstruct::backprojection::share;
use crate::reconstruct::compress::{SlabTones, Tones, VolumeTones};
use crate::reconstruct::job::Job;
use crate::reconstruct::volume::SlabDriver;
use crate::reconstruct::{Method, ReconstructionInfo};
use crate::wave::interval::PathInterval;
use crate::wave::phasor;
use crate::wave::simd::{LANES, Lanes, ROWS, lane_phasors, phasors};
use num_complex::Complex32;
use rayon::prelude::*;
use std::borrow::Cow;
use std::ops::Range;

/// Lines whose nodes about a depth stay in the second-level cache while depths are gone through.
const LINES: usize = 4;

/// Parts of the depths that each thread takes: the fewer, the fewer nodes are read twice.
const PARTS: usize = 4;

/// Rings that a thread takes at a time: left to itself, rayon hands out quarters, and a thread waits for the other's last.
const RINGS: usize = 4;

/// What the images of all lines are summed from.
struct Focus<'a> {
    plan: &'a LinesPlan,
    /// Of every shell, samples by lines.
    tones: Vec<Tones>,
    /// f_c/c with the sign of the inverse, −1/m.
    carrier: f64,
    observer: &'a dyn Observer,
}

/// Nodes of a block, by rings and lines; their room is the next block's.
#[derive(Default)]
struct BlockSums {
    nodes: Vec<Lanes>,
    /// For every line and ring, where in `nodes` the first node along the path would be.
    origins: Vec<Vec<isize>>,
}

/// What a thread needs for one ring.
#[derive(Default)]
struct RingBuffers {
    /// Lengths from the microphones, and their phasors.
    back: Vec<[f64; LANES]>,
    kernels: Vec<Lanes>,
    /// Lengths from the loudspeaker, and their phasors.
    outward: Vec<[f64; LANES]>,
    turns: Vec<Lanes>,
}

/// The nodes that each line of a block needs.
fn needed(view: &LineView, block: &BlockNodes, depths: &Range<usize>) -> Vec<Needed> {
    (0..view.lines.count).into_par_iter().map(|line| block.needed(view, line, depths.clone())).collect()
}

/// The path lengths of the nodes of every shell, and the nodes of every block where all depths are summed at a time.
fn intervals(plan: &LinesPlan, sound_speed: f64) -> (Vec<PathInterval>, Option<Vec<Vec<Needed>>>) {
    let mut found = vec![[f64::INFINITY, f64::NEG_INFINITY]; plan.shells.count];
    let view = &plan.view;
    let all = 0..view.depths.count;
    let mut kept = (plan.at_once >= all.len()).then(Vec::new);
    for block in &plan.blocks {
        let lines = needed(view, block, &all);
        let (lanes, count) = (block.lanes(&view.columns), block.columns.len());
        let asides = lanes[..count].iter().map(|x| view.aside(*x));
        let (nearest, farthest) =
            asides.fold((f64::INFINITY, 0.0f64), |(near, far), [a, b]| (near.min(a), far.max(b)));
        for i in 0..lines.iter().map(Vec::len).max().unwrap_or(0) {
            let Some(paths) = Ring::of(&lines, i).all() else { continue };
            let rho = block.rho.position(i);
            let outward = |j: usize| block.outward(view, rho, block.path.position(j));
            let least = outward(paths.start)[..count].iter().copied().fold(f64::INFINITY, f64::min);
            let most = outward(paths.end - 1)[..count].iter().copied().fold(0.0, f64::max);
            let [shortest, longest] = &mut found[plan.shells.of(rho)];
            *shortest = shortest.min(least + view.legs * rho.hypot(nearest));
            *longest = longest.max(most + view.legs * rho.hypot(farthest));
        }
        if let Some(kept) = &mut kept {
            kept.push(lines);
        }
    }
    let interval = |[shortest, longest]: [f64; 2]| {
        let [shortest, longest] = if shortest <= longest { [shortest, longest] } else { [0.0; 2] };
        PathInterval { shortest, longest, sound_speed }
    };
    (found.into_iter().map(interval).collect(), kept)
}

/// Gives the volume to the job's sink.
pub(crate) fn image(plan: &LinesPlan, job: Job<'_>) -> Result<ReconstructionInfo> {
    let Job { source, mut kept, weights, grid, budget, interpolation, sink, observer, .. } = job;
    let (whole, budget) = plan.compression(source.instrument(), grid, budget);
    let compressed = VolumeTones::compress((source, weights), &mut kept, (whole, budget), observer)?;
    let instrument = source.instrument();
    let (intervals, kept) = intervals(plan, instrument.sound_speed);
    let each = (0..plan.shells.count).map(|shell| shell..shell + 1);
    let shells = compressed.sweep.slabs(each, |shell| intervals[shell.start], share, budget);
    let error = plan.error + plan.growth * SlabTones::error(&shells);
    let error_bound = interpolation.with(error) * compressed.modulus;
    let tones = shells.par_iter().map(|shell| {
        let tones = shell.of(&compressed, instrument.array.len())?;
        let rows = tones.samples.chunks_exact(instrument.array.len());
        let samples = rows.flat_map(|row| plan.view.by_lines(row)).collect();
        Ok(Tones { samples, ..tones })
    });
    let carrier = -instrument.sweep.centre() / instrument.sound_speed;
    let focus = Focus { plan, tones: tones.collect::<Result<_>>()?, carrier, observer };
    drop(compressed);
    let driver = SlabDriver::even(grid, plan.at_once, |depths| (plan.blocks.len() * depths) as u64, observer);
    let info = ReconstructionInfo::plain(Method::Backprojection, error_bound);
    let mut image =
        try_with_capacity((plan.at_once * plan.view.rows.count) as u64).ok_or_else(|| no_room_for(grid))?;
    let mut nodes = BlockSums::default();
    driver.run(info, sink, |_, depths, planes| {
        for (i, block) in plan.blocks.iter().enumerate() {
            // Depths that are not all, after an interruption, have nodes of their own.
            let kept = kept.as_ref().filter(|_| depths.len() == plan.view.depths.count);
            let needed = match kept {
                Some(kept) => Cow::Borrowed(&kept[i]),
                None => Cow::Owned(needed(&plan.view, block, &depths)),
            };
            focus.nodes(block, &needed, grid, &mut nodes)?;
            focus.block(block, depths.clone(), &nodes, &mut image)?;
            planes
                .par_chunks_mut(grid.plane_len())
                .zip(image.par_chunks(plan.view.rows.count))
                .for_each(|(plane, image)| focus.place(block, image, plane));
        }
        Ok(())
    })
}

impl Focus<'_> {
    /// The image of sixteen columns at some depths, `[depth, row]`.
    fn block(
        &self,
        block: &BlockNodes,
        depths: Range<usize>,
        nodes: &BlockSums,
        image: &mut Vec<Lanes>,
    ) -> Result<()> {
        let (plan, view) = (self.plan, &self.plan.view);
        let (rows, per_metre) = (view.rows.count, view.legs * self.carrier);
        image.clear();
        image.resize(depths.len() * rows, Lanes::ZERO);
        let part = depths.len().div_ceil(PARTS * rayon::current_num_threads());
        let sum = |(places, turns): &mut (Places, Vec<Complex32>), (chunk, image): (usize, &mut [Lanes])| {
            turns.resize(rows, Complex32::ZERO);
            let first = depths.start + chunk * part;
            for (group, lines) in nodes.origins.chunks(LINES).enumerate() {
                for (depth, image) in image.chunks_exact_mut(rows).enumerate() {
                    for (line, origins) in lines.iter().enumerate() {
                        block.place(view, group * LINES + line, first + depth, places);
                        phasors(per_metre, &places.back, turns);
                        add_line((&nodes.nodes, origins), places, &plan.tables, turns, image);
                    }
                }
                advance(self.observer, 0)?;
            }
            if view.source.is_some() {
                self.turn_outward(block, first, image);
            }
            let depths = image.len() / rows;
            advance(self.observer, depths as u64)
        };
        let parts = image.par_chunks_mut(part * rows).enumerate();
        parts.with_max_len(1).try_for_each_init(Default::default, sum)
    }

    /// Gives voxels the carrier's phase of the path out.
    fn turn_outward(&self, block: &BlockNodes, first: usize, image: &mut [Lanes]) {
        let view = &self.plan.view;
        let (rows, to_source) = (view.rows.count, block.to_source(view));
        let mut lengths = vec![[0.0; LANES]; rows.next_multiple_of(ROWS)];
        let mut turns = vec![Lanes::ZERO; lengths.len()];
        for (depth, image) in image.chunks_exact_mut(rows).enumerate() {
            let z = view.depths.position(first + depth);
            for (row, lengths) in view.rows.positions().zip(&mut lengths) {
                let squares = block.squares(view, view.over_source(row, z) + to_source);
                *lengths = squares.map(|square| square.max(0.0).sqrt());
            }
            lane_phasors(&[self.carrier; LANES], &lengths, &mut turns);
            turn(&turns, image);
        }
    }

    /// Sums the nodes of all lines.
    fn nodes(
        &self,
        block: &BlockNodes,
        needed: &[Needed],
        grid: &Grid,
        BlockSums { nodes, origins }: &mut BlockSums,
    ) -> Result<()> {
        let count = needed.iter().map(Vec::len).max().unwrap_or(0);
        let rings: Vec<Ring> = (0..count).map(|i| Ring::of(needed, i)).collect();
        *origins = vec![Vec::with_capacity(count); needed.len()];
        let mut from = 0;
        for paths in rings.iter().map(|ring| &ring.paths) {
            for (line, paths) in origins.iter_mut().zip(paths) {
                line.push(from as isize - paths.start as isize);
                from += paths.len();
            }
        }
        if nodes.len() < from {
            // What they are is not needed any more; a vector of aligned numbers would be copied into one beside it.
            *nodes = Vec::new();
            *nodes = try_filled(Lanes::ZERO, from as u64).ok_or_else(|| no_room_for(grid))?;
        }
        let (mut left, mut parts) = (&mut nodes[..], Vec::new());
        for (i, ring) in rings.iter().enumerate() {
            let (own, rest) = left.split_at_mut(ring.len());
            left = rest;
            parts.push((i, ring, own));
        }
        let fill = |buffers: &mut RingBuffers, (i, ring, nodes): (usize, &Ring, &mut [Lanes])| {
            self.fill(block, i, ring, buffers, nodes);
            advance(self.observer, 0)
        };
        parts.into_par_iter().with_max_len(RINGS).try_for_each_init(RingBuffers::default, fill)
    }

    /// Sums one ring's nodes of all lines.
    fn fill(
        &self,
        block: &BlockNodes,
        i: usize,
        ring: &Ring,
        buffers: &mut RingBuffers,
        nodes: &mut [Lanes],
    ) {
        let (plan, view) = (self.plan, &self.plan.view);
        let Some(paths) = ring.all() else { return };
        nodes.fill(Lanes::ZERO);
        let lanes = block.lanes(&view.columns);
        let RingBuffers { back, kernels, outward, turns } = buffers;
        let rho = block.rho.position(i);
        let padded = |count: usize| count.next_multiple_of(ROWS);
        back.clear();
        let of_microphone = |microphone: f64| lanes.map(|x| view.leg(rho, microphone - x));
        back.extend(view.microphones.positions().map(of_microphone));
        back.resize(padded(back.len()), [0.0; LANES]);
        kernels.resize(back.len(), Lanes::ZERO);
        outward.clear();
        outward.extend(paths.clone().map(|j| block.outward(view, rho, block.path.position(j))));
        outward.resize(padded(outward.len()), [0.0; LANES]);
        turns.resize(outward.len(), Lanes::ZERO);
        let tones = &self.tones[plan.shells.of(rho)];
        let carrier = phasor(-view.legs * self.carrier * block.back(rho));
        let count = view.microphones.count;
        let samples = tones.samples.chunks_exact(padded(view.lines.count) * count);
        for (k, samples) in tones.per_metre.iter().zip(samples) {
            lane_phasors(&[view.legs * k; LANES], back, kernels);
            lane_phasors(&[k - self.carrier; LANES], outward, turns);
            add_tone(&kernels[..count], (turns, paths.start), samples, carrier, (ring, &mut *nodes));
        }
    }

    /// Puts a block's rows of one depth into the plane.
    fn place(&self, block: &BlockNodes, image: &[Lanes], plane: &mut [Complex32]) {
        let view = &self.plan.view;
        let width = if view.along == 0 { view.columns.count } else { view.rows.count };
        for (row, lanes) in image.iter().take(view.rows.count).enumerate() {
            for (lane, column) in block.columns.clone().enumerate() {
                let at = if view.along == 0 { row * width + column } else { column * width + row };
                plane[at] = lanes.at(lane);
            }
        }
    }
}
