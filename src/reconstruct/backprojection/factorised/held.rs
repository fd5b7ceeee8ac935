//! The nodes of tiles of one size that are held at a time: which each tile needs, and their values.

use super::frame::Frame;
use crate::alloc::try_returned;
use crate::error::{Error, Result};
use crate::wave::simd::LANES;
use crate::wave::simd::rows::{WIDE, aligned, aligned_mut};
use std::ops::Range;

/// How many more numbers than a tile's nodes there must be, since whole vectors are read beyond the last.
const BEYOND: usize = LANES + 2 * WIDE;

/// Which nodes of one tile are needed.
#[derive(Debug, Clone)]
pub(crate) struct TileNodes {
    pub(crate) frame: Frame,
    /// Nodes along ρ that are held, as multiples of the pitch; whole vectors of them.
    pub(crate) held: Range<usize>,
    /// Those that each column of nodes needs, `[y, x]`; what the others hold is not used.
    pub(crate) needed: Vec<Range<usize>>,
}

/// The values of one tile's nodes, `[y, x, ρ]`: real and imaginary parts.
#[derive(Debug, Clone, Copy)]
pub(crate) struct FilledNodes<'a> {
    pub(crate) nodes: &'a TileNodes,
    pub(crate) values: [&'a [f32]; 2],
}

/// The nodes of several tiles of one size.
#[derive(Debug)]
pub(crate) struct HeldNodes {
    pub(crate) tiles: Vec<TileNodes>,
    /// Those of one tile after the other: it is a large part of a job's memory, which the next stage needs.
    values: Vec<f32>,
}

impl TileNodes {
    /// Room for one part of the values.
    fn room(&self) -> usize {
        self.needed.len() * self.held.len() + BEYOND
    }
}

impl HeldNodes {
    /// All values zero.
    ///
    /// # Errors
    /// [`Error::OutOfMemory`].
    pub(crate) fn zeros(tiles: Vec<TileNodes>) -> Result<Self> {
        let room = tiles.iter().map(|tile| 2 * tile.room()).sum::<usize>() + LANES;
        let values = try_returned(room as u64).ok_or_else(|| {
            Error::out_of_memory(format!(
                "{room} numbers for nodes of back-projection do not fit in memory; use a smaller grid"
            ))
        })?;
        Ok(Self { tiles, values })
    }

    /// Every tile with its values.
    pub(crate) fn filled(&self) -> impl Iterator<Item = FilledNodes<'_>> {
        let mut rest = aligned(&self.values);
        self.tiles.iter().map(move |nodes| {
            let values = [(); 2].map(|()| rest.split_off(..nodes.room()).unwrap_or_default());
            FilledNodes { nodes, values }
        })
    }

    /// Every tile with its values, to be filled.
    pub(crate) fn filling(&mut self) -> impl Iterator<Item = (&TileNodes, [&mut [f32]; 2])> {
        let mut rest = aligned_mut(&mut self.values);
        self.tiles.iter().map(move |nodes| {
            let values = [(); 2].map(|()| rest.split_off_mut(..nodes.room()).unwrap_or_default());
            (nodes, values)
        })
    }
}

/// The least range that holds two.
pub(crate) fn hull(a: Range<usize>, b: Range<usize>) -> Range<usize> {
    if a.is_empty() {
        b
    } else if b.is_empty() {
        a
    } else {
        a.start.min(b.start)..a.end.max(b.end)
    }
}
