//! The units of a job: which there are, and which of them a process computes.

use crate::acquisition::Instrument;
use crate::checkpoint::UnitBlocks;
use crate::choice::choice;
use crate::config::RunFile;
use crate::error::{Error, Result};
use crate::export::volume_zarr::VolumeShards;
use crate::grid::Grid;
use crate::reconstruct::{Method, ReconstructOptions};
use serde::Serialize;
use std::ops::Range;

/// Units of a stage, as far as it has so many blocks: enough for many processes, and more where one would be large.
const UNITS: u64 = 64;

/// Bytes of a unit beyond which there are more of them, and the most that there are.
const UNIT_BYTES: u64 = 64 << 20;
const MOST_UNITS: u64 = 1024;

choice! {
    /// The stages whose work is shared.
    pub enum UnitStage: "stage" {
        /// Tiles of microphones are simulated.
        Simulate = "simulate",
        /// The sweep is compressed to few tones, from which depths are reconstructed without the cube.
        Compress = "compress",
        /// Depths are reconstructed.
        Reconstruct = "reconstruct",
        /// Depths are encoded as shards of a Zarr store.
        Encode = "encode",
    }
}

/// One unit of a job's work.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Unit {
    /// Its number in the job, from 0.
    pub unit: u64,
    /// What is computed.
    pub stage: UnitStage,
    /// Number of the first tile, depth or shard.
    pub first: u64,
    /// How many tiles, depths or shards; a sweep is one block.
    pub blocks: u64,
    /// Its share of the stage's cost.
    pub share: f64,
}

/// A unit of shards that is not stored yet.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[non_exhaustive]
pub struct ShardsLeft {
    /// Its number in the job.
    pub unit: u64,
    /// The first and the last unit of the depths from which it is encoded.
    pub depths: [u64; 2],
}

/// Which units a process computes.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Wanted {
    /// Of each stage the `part`-th of `of` parts, from 1 on.
    Part {
        /// From 1 to `of`.
        part: u64,
        /// Number of processes.
        of: u64,
    },
    /// By number.
    Numbers(Range<u64>),
}

impl Wanted {
    /// Those of a stage's units that are divided.
    pub(super) fn of<'u>(&self, units: &'u [UnitBlocks]) -> &'u [UnitBlocks] {
        let range = match self {
            Self::Part { part, of } => {
                let end = |part: u64| (u128::from(part) * units.len() as u128 / u128::from(*of)) as usize;
                end(part - 1)..end(*part)
            }
            Self::Numbers(numbers) => {
                let end = |number: u64| units.partition_point(|unit| unit.unit < number);
                end(numbers.start)..end(numbers.end)
            }
        };
        &units[range]
    }

    /// Those of the units of shards: of a part those that end in its depths.
    pub(super) fn shards<'u>(&self, units: &'u Units) -> &'u [UnitBlocks] {
        let Self::Part { .. } = self else { return self.of(&units.encode) };
        let blocks = || self.of(&units.reconstruct).iter().flat_map(|unit| &unit.blocks);
        let Some((first, last)) = blocks().min().zip(blocks().max()) else { return &[] };
        let before =
            |depth: u64| units.encode.partition_point(|unit| units.depths_of(unit).end as u64 <= depth);
        &units.encode[before(*first)..before(*last + 1)]
    }

    /// Whether one of these units is asked for by its number.
    pub(super) fn names(&self, units: &[UnitBlocks]) -> bool {
        matches!(self, Self::Numbers(numbers) if units.iter().any(|unit| numbers.contains(&unit.unit)))
    }
}

/// The units of a job, by stage.
pub(super) struct Units {
    pub(super) simulate: Vec<UnitBlocks>,
    /// One, or none where depths are not summed from tones of the whole volume.
    pub(super) compress: Vec<UnitBlocks>,
    pub(super) reconstruct: Vec<UnitBlocks>,
    /// None where no Zarr store is written.
    pub(super) encode: Vec<UnitBlocks>,
    /// The shards that are blocks of those.
    pub(super) shards: Option<VolumeShards>,
}

impl Units {
    /// Of these tiles, and of the depths of a grid, unless the volume is refined, which takes all of it; and of the shards of a
    /// `store` of them.
    pub(super) fn new(
        (tiles, cube_bytes): (&[u64], u64),
        (run, store): (&RunFile, bool),
        instrument: &Instrument,
        grid: &Grid,
    ) -> Self {
        let simulate = divided(tiles, cube_bytes, 0);
        let options = run.reconstruct_options();
        let depths: Vec<u64> =
            if options.refine.is_some() { Vec::new() } else { (0..grid.z.count as u64).collect() };
        let compress: &[u64] =
            if depths.is_empty() || !may_compress(&options, instrument) { &[] } else { &[0] };
        let compress = divided(compress, 0, simulate.len() as u64);
        let reconstruct = divided(&depths, grid.volume_bytes(), (simulate.len() + compress.len()) as u64);
        let store = store && !depths.is_empty();
        let shards = store.then(|| VolumeShards::new(grid, run.output.components, run.output.compression));
        let numbers: Vec<u64> = (0..shards.as_ref().map_or(0, VolumeShards::count)).collect();
        let first = simulate.len() + compress.len() + reconstruct.len();
        let encode = divided(&numbers, grid.volume_bytes(), first as u64);
        Self { simulate, compress, reconstruct, encode, shards }
    }

    /// Those of a simulation alone.
    pub(super) fn without_depths(self) -> Self {
        Self { compress: Vec::new(), reconstruct: Vec::new(), encode: Vec::new(), shards: None, ..self }
    }

    pub(super) fn len(&self) -> u64 {
        (self.simulate.len() + self.compress.len() + self.reconstruct.len() + self.encode.len()) as u64
    }

    /// The depths from which a unit of shards is encoded.
    pub(super) fn depths_of(&self, unit: &UnitBlocks) -> Range<usize> {
        self.shards.as_ref().map_or(0..0, |shards| shards.depths(&unit.blocks))
    }

    /// What is to be known of units of shards that are left.
    pub(super) fn shards_left(&self, left: &[u64]) -> Vec<ShardsLeft> {
        let at = |depth: usize| self.reconstruct.partition_point(|unit| unit.blocks[0] <= depth as u64) - 1;
        let of = |unit: &UnitBlocks| {
            let depths = self.depths_of(unit);
            let ends = [depths.start, depths.end - 1].map(|depth| self.reconstruct[at(depth)].unit);
            ShardsLeft { unit: unit.unit, depths: ends }
        };
        self.encode.iter().filter(|unit| left.contains(&unit.unit)).map(of).collect()
    }

    pub(super) fn listed(&self) -> Vec<Unit> {
        let of = |(stage, units): (UnitStage, &[UnitBlocks])| {
            let all = units.iter().map(|unit| unit.blocks.len()).sum::<usize>() as f64;
            let listed = |unit: &UnitBlocks| Unit {
                unit: unit.unit,
                stage,
                first: unit.blocks[0],
                blocks: unit.blocks.len() as u64,
                share: unit.blocks.len() as f64 / all,
            };
            units.iter().map(listed).collect::<Vec<_>>()
        };
        let stages = [
            (UnitStage::Simulate, &self.simulate[..]),
            (UnitStage::Compress, &self.compress),
            (UnitStage::Reconstruct, &self.reconstruct),
            (UnitStage::Encode, &self.encode),
        ];
        stages.into_iter().flat_map(of).collect()
    }
}

/// Whether depths may be summed from tones that are the same for the whole volume. A small job may be summed without any, for
/// which the unit is empty.
fn may_compress(options: &ReconstructOptions, instrument: &Instrument) -> bool {
    let sums = matches!(options.method, Method::Auto | Method::Convolution | Method::Backprojection);
    sums && options.tolerance > 0.0 && options.motion.is_none() && instrument.transmissions() == 1
}

/// Blocks of so many bytes in all, in units numbered from `first` on.
fn divided(blocks: &[u64], bytes: u64, first: u64) -> Vec<UnitBlocks> {
    let all = blocks.len() as u64;
    let count = UNITS.max(bytes.div_ceil(UNIT_BYTES)).min(MOST_UNITS).min(all);
    let end = |i: u64| (u128::from(i) * u128::from(all) / u128::from(count.max(1))) as usize;
    let unit = |i: u64| UnitBlocks { unit: first + i, blocks: blocks[end(i)..end(i + 1)].to_vec() };
    (0..count).map(unit).collect()
}

/// Refuses units that there are not.
pub(super) fn check(wanted: &Wanted, units: &Units) -> Result<()> {
    let count = units.len();
    if count == 0 {
        let problem = "works on the whole volume, which cannot be shared; use `image` or `reconstruct` alone, or method = \"none\"";
        return Err(Error::input("[refine]", problem));
    }
    match wanted {
        Wanted::Part { part, of } if *part == 0 || part > of => {
            Err(Error::input("--part", format!("{part}/{of} was expected to be from 1/{of} to {of}/{of}")))
        }
        Wanted::Numbers(numbers) if numbers.is_empty() || numbers.end > count => Err(Error::input(
            "--units",
            format!("the job has units 0-{}, and a range of these was expected", count - 1),
        )),
        _ => Ok(()),
    }
}
