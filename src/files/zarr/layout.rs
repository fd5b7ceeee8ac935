//! How an array is divided into shards and chunks: by its shape alone, so that its bytes depend on nothing else.

use crate::blocks::runs;
use std::ops::Range;

/// The longest side of a chunk along the last two axes of three and more.
const SIDE: usize = 64;

/// The most elements of a chunk along the last axis of two.
const LINE: usize = SIDE * SIDE;

/// The most rows of a shard along the axis before, and the most bytes of a shard if it has several rows.
const ROWS: usize = 32;
const SHARD_BYTES: u64 = 64 << 20;

/// The division of an array. A shard is a whole slab: some rows of the axis before the last two (or before the last, of two
/// axes), and everything along the last; chunks divide it along those.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct ShardLayout {
    pub(super) shape: Vec<usize>,
    /// Of a chunk; along every axis the sizes are as even as can be.
    pub(super) chunk: Vec<usize>,
    /// The axis of the rows.
    pub(super) slow: usize,
}

impl ShardLayout {
    /// The division of an array of this shape and bytes of an element.
    ///
    /// # Panics
    /// When there are fewer than two axes, or one without elements.
    pub(crate) fn new(shape: &[usize], element: usize) -> Self {
        assert!(shape.len() >= 2 && shape.iter().all(|&n| n > 0), "a shape {shape:?}");
        let slow = shape.len().saturating_sub(3);
        let row = shape[slow + 1..].iter().fold(element as u64, |bytes, &n| bytes.saturating_mul(n as u64));
        let rows = (SHARD_BYTES / row).clamp(1, ROWS as u64) as usize;
        let side = if shape.len() == 2 { LINE } else { SIDE };
        let chunk = shape.iter().enumerate().map(|(axis, &n)| match axis {
            axis if axis < slow => 1,
            axis if axis == slow => even(n, rows),
            _ => even(n, side),
        });
        Self { chunk: chunk.collect(), shape: shape.to_vec(), slow }
    }

    /// Chunks of a shard along each axis.
    pub(super) fn chunks(&self) -> Vec<usize> {
        let of = |axis: usize| {
            if axis <= self.slow { 1 } else { self.shape[axis].div_ceil(self.chunk[axis]) }
        };
        (0..self.shape.len()).map(of).collect()
    }

    /// The shape of a shard, which consists of whole chunks and so may exceed the array.
    pub(super) fn shard(&self) -> Vec<usize> {
        self.chunks().iter().zip(&self.chunk).map(|(count, size)| count * size).collect()
    }

    /// The rows of each shard.
    ///
    /// # Panics
    /// When there are axes before that of the rows.
    pub(crate) fn slabs(&self) -> impl Iterator<Item = Range<usize>> + use<> {
        assert_eq!(self.slow, 0, "rows of the first axis");
        runs(self.shape[0], self.chunk[0])
    }

    /// Elements of a row: everything along the last axes.
    pub(super) fn row(&self) -> usize {
        self.shape[self.slow + 1..].iter().product()
    }

    /// Bytes that a shard of such elements takes in memory while it is filled and compressed.
    pub(crate) fn writing_bytes(&self, element: usize) -> u64 {
        2 * self.rows_bytes(element)
    }

    /// Bytes of all rows of a shard.
    pub(crate) fn rows_bytes(&self, element: usize) -> u64 {
        (self.chunk[self.slow] * self.row() * element) as u64
    }
}

/// The size of equal parts of `n`, of at most `most`.
fn even(n: usize, most: usize) -> usize {
    n.div_ceil(n.div_ceil(most))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shards_are_slabs_of_even_chunks() {
        let layout = ShardLayout::new(&[126, 161, 145], 8);
        assert_eq!((layout.chunk.clone(), layout.chunks()), (vec![32, 54, 49], vec![1, 3, 3]));
        assert_eq!(layout.shard(), [32, 162, 147]);
        assert_eq!(ShardLayout::new(&[2, 501, 63, 63], 8).shard(), [1, 32, 63, 63]);
        assert_eq!(ShardLayout::new(&[501, 5000], 8).chunk, [32, 2500]);
        assert_eq!(layout.slabs().collect::<Vec<_>>(), [0..32, 32..64, 64..96, 96..126]);
        // Large planes, one at a time.
        assert_eq!(ShardLayout::new(&[10, 8000, 8000], 8).chunk, [1, 64, 64]);
        assert_eq!(ShardLayout::new(&[1, 1, 1], 4).shard(), [1, 1, 1]);
    }
}
