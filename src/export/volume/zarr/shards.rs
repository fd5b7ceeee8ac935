//! The shards of a store's samples and amplitude, each of which can be encoded by itself, before the store is written and by
//! somebody else. Smaller levels are a seventh of the amplitude, and made of all depths by whoever writes the store.

use crate::alloc::try_with_capacity;
use crate::error::{Error, Result};
use crate::export::{Components, Compression};
use crate::files::zarr::{ShardEncoder, ZarrNumber};
use crate::grid::{Grid, no_room_for};
use num_complex::Complex32;
use std::ops::Range;

/// The arrays of a store's first level.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum LevelArray {
    Samples,
    Amplitude,
}

/// All shards of both arrays, in the order in which their depths end, numbered from 0.
#[derive(Debug)]
pub(crate) struct VolumeShards {
    grid: Grid,
    samples: ShardEncoder,
    amplitude: ShardEncoder,
    shards: Vec<(LevelArray, Range<usize>)>,
}

impl VolumeShards {
    /// Of the store of a volume of this grid.
    pub(crate) fn new(grid: &Grid, components: Components, compression: Compression) -> Self {
        let (shape, zip) = (grid.shape(), compression == Compression::Zip);
        let samples = ShardEncoder::new::<Complex32>(&shape, zip);
        let amplitude = ShardEncoder::new::<f32>(&shape, zip);
        let mut shards: Vec<_> =
            amplitude.layout().slabs().map(|slab| (LevelArray::Amplitude, slab)).collect();
        if components == Components::Complex {
            shards.extend(samples.layout().slabs().map(|slab| (LevelArray::Samples, slab)));
        }
        shards.sort_by_key(|(_, depths)| depths.end);
        Self { grid: *grid, samples, amplitude, shards }
    }

    /// Number of shards.
    pub(crate) fn count(&self) -> u64 {
        self.shards.len() as u64
    }

    /// The depths from which shards of these numbers are encoded, all together.
    ///
    /// # Panics
    /// When there is no shard of one of these numbers.
    pub(crate) fn depths(&self, numbers: &[u64]) -> Range<usize> {
        let depths = || numbers.iter().map(|number| &self.shards[*number as usize].1);
        let first = depths().map(|depths| depths.start).min().unwrap_or(0);
        first..depths().map(|depths| depths.end).max().unwrap_or(first)
    }

    /// The numbers of an array's shards, along z.
    pub(super) fn of(&self, array: LevelArray) -> Vec<u64> {
        (0..).zip(&self.shards).filter(|(_, shard)| shard.0 == array).map(|(number, _)| number).collect()
    }

    /// More bytes than a shard ever has, compressed or not.
    pub(crate) fn most_bytes(&self) -> u64 {
        let of = |encoder: &ShardEncoder, element| {
            // Chunks at the edges are filled up, by less than as much again along each axis; gzip and the index add little.
            encoder.layout().rows_bytes(element).saturating_mul(5).saturating_add(1 << 16)
        };
        of(&self.samples, size_of::<Complex32>()).max(of(&self.amplitude, size_of::<f32>()))
    }

    /// The bytes of a shard, from the planes that `load` returns; `None` where one is missing.
    ///
    /// # Errors
    /// Those of `load`; not enough memory.
    ///
    /// # Panics
    /// When there is no shard of this number.
    pub(crate) fn encode(
        &self,
        number: u64,
        mut load: impl FnMut(usize) -> Result<Option<Vec<Complex32>>>,
    ) -> Result<Option<Vec<u8>>> {
        let (array, depths) = &self.shards[number as usize];
        let (encoder, size) = match array {
            LevelArray::Samples => (&self.samples, size_of::<Complex32>()),
            LevelArray::Amplitude => (&self.amplitude, size_of::<f32>()),
        };
        let bytes = depths.len() as u64 * self.grid.plane_len() as u64 * size as u64;
        let mut rows: Vec<u8> = try_with_capacity(bytes).ok_or_else(|| no_room_for(&self.grid))?;
        for depth in depths.clone() {
            let Some(plane) = load(depth)?.filter(|plane| plane.len() == self.grid.plane_len()) else {
                return Ok(None);
            };
            match array {
                LevelArray::Samples => rows.extend_from_slice(&Complex32::bytes(&plane)),
                LevelArray::Amplitude => rows.extend_from_slice(&f32::bytes(&amplitude(&plane))),
            }
        }
        let encoded = encoder.encode(&rows).map_err(|error| Error::io("a shard", error.to_string()))?;
        Ok(Some(encoded.concat()))
    }
}

/// The amplitude of a plane.
pub(super) fn amplitude(plane: &[Complex32]) -> Vec<f32> {
    plane.iter().map(|sample| sample.norm()).collect()
}
