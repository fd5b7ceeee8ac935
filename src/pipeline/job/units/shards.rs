//! Shards of a volume's Zarr store, which processes encode once its depths are stored, for whoever writes the store.

use super::{UnitBlocks, Units, Wanted, Worker};
use crate::checkpoint::{Checkpoint, GracefulStop, SegmentWriter, Stage};
use crate::error::Result;
use crate::files::zarr::EncodedShards;
use crate::pipeline::job::shared::padded;
use crate::progress::{Observer, advance, stage};
use bytemuck::{cast, cast_slice};
use num_complex::Complex32;

/// Those that the processes of a job have encoded.
#[derive(Clone, Copy)]
pub(in crate::pipeline) struct StoredShards<'a> {
    pub(in crate::pipeline) checkpoint: &'a Checkpoint,
    pub(in crate::pipeline) observer: &'a dyn Observer,
}

impl EncodedShards for StoredShards<'_> {
    fn shard(&self, number: u64) -> Option<Vec<u8>> {
        // Without one it is encoded, and whoever does so notices an interruption, too.
        unpacked(&self.checkpoint.stored(Stage::Shards, number, self.observer).ok()??)
    }
}

/// Bytes as a block: filled up, and their number.
fn packed(bytes: Vec<u8>) -> Vec<Complex32> {
    let count = bytes.len() as u64;
    let mut block = padded(bytes, 0);
    block.push(cast(count));
    block
}

fn unpacked(block: &[Complex32]) -> Option<Vec<u8>> {
    let (count, bytes) = block.split_last()?;
    let count: u64 = cast(*count);
    cast_slice::<_, u8>(bytes).get(..usize::try_from(count).ok()?).map(<[u8]>::to_vec)
}

impl Worker<'_> {
    /// Encodes those shards that are wanted whose depths are all stored.
    pub(super) fn encode(&mut self, wanted: &Wanted, units: &Units) -> Result<()> {
        let Some(shards) = &units.shards else { return Ok(()) };
        let mut ready = self.missing(Stage::Shards, wanted.shards(units))?;
        ready.retain(|unit| {
            let blocks = units.depths_of(unit).map(|depth| depth as u64).collect();
            self.checkpoint.lists_unit(Stage::Volume, &UnitBlocks { unit: unit.unit, blocks })
        });
        if ready.is_empty() {
            return Ok(());
        }
        let (checkpoint, observer) = (self.checkpoint, self.observer);
        let stop = GracefulStop::new(checkpoint, observer);
        let mut writer = SegmentWriter::new(checkpoint, &self.identity, (Stage::Shards, &ready), observer);
        let numbers: Vec<u64> = ready.iter().flat_map(|unit| unit.blocks.iter().copied()).collect();
        let mut damaged = Vec::new();
        stage(&stop, "encoding", numbers.len() as u64, || {
            for number in numbers {
                let load = |depth| checkpoint.stored(Stage::Volume, depth as u64, observer);
                match shards.encode(number, load)? {
                    Some(bytes) => writer.write(number, &packed(bytes))?,
                    None => damaged.push(number),
                }
                advance(&stop, 1)?;
            }
            Ok(())
        })?;
        ready.retain(|unit| !unit.blocks.iter().any(|number| damaged.contains(number)));
        self.computed(&ready)
    }
}

#[cfg(test)]
mod tests {
    use super::{packed, unpacked};

    #[test]
    fn bytes_of_any_number_come_back() {
        for count in 0..20_u8 {
            let bytes: Vec<u8> = (0..count).collect();
            let block = packed(bytes.clone());
            assert_eq!(unpacked(&block), Some(bytes));
        }
        assert_eq!(unpacked(&[]), None);
    }
}
