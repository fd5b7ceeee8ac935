//! The tiles that some of the largest are made of, level by level, and how their nodes follow from each other.

use super::frame::Frame;
use super::held::{FilledNodes, HeldNodes, NodeColumns, PlaceColumns, TileNodes};
use super::merge::{Merge, ROWS, RowBuffers};
use super::nodes::TileLattice;
use crate::alloc::Reused;
use crate::error::Result;
use crate::reconstruct::numerics::IntervalNodes;
use crate::reconstruct::volume::Batch;
use rayon::prelude::*;

/// How the nodes of each level make those of the next, and the last the voxels.
#[derive(Debug)]
pub(crate) struct Tree<'a> {
    /// From the smallest tiles to the largest; the smallest alone have several zones.
    levels: &'a [TileLattice],
    merges: Vec<Merge<'a>>,
    buffers: Reused<RowBuffers>,
}

impl<'a> Tree<'a> {
    /// `columns` are those of the voxels along x and y; `carrier` is f_c/c, 1/m.
    pub(crate) fn new(levels: &'a [TileLattice], columns: [Vec<f64>; 2], carrier: f64) -> Self {
        let above = levels[1..].iter().map(|lattice| lattice.sideways().map(|nodes| nodes.places().to_vec()));
        let columns = above.chain([columns]);
        let merges =
            levels.iter().zip(columns).map(|(lattice, columns)| Merge::new(lattice, columns, carrier));
        Self { levels, merges: merges.collect(), buffers: Reused::new() }
    }

    /// Makes voxels of the largest tiles.
    pub(crate) fn voxels(&self) -> &Merge<'a> {
        &self.merges[self.merges.len() - 1]
    }

    /// Works with buffers of its own: rows are dealt out one run after the other, since they take long.
    pub(crate) fn with_buffers<R>(&self, work: impl FnOnce(&mut RowBuffers) -> Result<R>) -> Result<R> {
        self.buffers.with(|| Ok(RowBuffers::default()), work)
    }

    /// Rows of nodes that are made of smaller tiles', with so many tiles in each level.
    pub(crate) fn rows(&self, tiles: impl Iterator<Item = usize>) -> u64 {
        let rows = self.levels.iter().zip(tiles).skip(1);
        rows.map(|(lattice, tiles)| (tiles * lattice.sideways()[1].len()) as u64).sum()
    }

    /// What some voxels need of the smallest tiles, and of those that are made of them, level by level.
    pub(crate) fn needs(
        &self,
        frames: &[Vec<Frame>],
        voxels: &impl PlaceColumns,
    ) -> (Vec<TileNodes>, Vec<Vec<TileNodes>>) {
        let last = frames.len() - 1;
        let largest = frames[last].par_iter().flat_map_iter(|frame| self.voxels().needs(*frame, voxels));
        let mut levels = vec![largest.collect::<Vec<_>>()];
        for level in (0..last).rev() {
            let above = &levels[levels.len() - 1];
            let merged = frames[level].len() / above.len();
            let needs = |(i, frame): (usize, &Frame)| {
                let places = NodeColumns { lattice: &self.levels[level + 1], nodes: &above[i / merged] };
                self.merges[level].needs(*frame, &places)
            };
            levels.push(frames[level].par_iter().enumerate().flat_map_iter(needs).collect());
        }
        let leaves = levels.pop().unwrap_or_default();
        levels.reverse();
        (leaves, levels)
    }

    /// The largest tiles' nodes from those of the smallest, level by level of what `needed` names above them; `done` is called
    /// after some rows, with their number.
    ///
    /// # Errors
    /// Those of `done`; [`Error::OutOfMemory`](crate::error::Error::OutOfMemory).
    pub(crate) fn merged(
        &self,
        leaves: HeldNodes,
        needed: Vec<Vec<TileNodes>>,
        batch: Batch,
        done: impl Fn(u64) -> Result<()> + Sync,
    ) -> Result<HeldNodes> {
        let mut below = leaves;
        for (level, tiles) in needed.into_iter().enumerate() {
            let merged = below.tiles.len() / tiles.len();
            let merge = &self.merges[level];
            let lattice = &self.levels[level + 1];
            let [x, y] = lattice.sideways().map(IntervalNodes::len);
            let mut above = HeldNodes::zeros(tiles)?;
            let filled: Vec<FilledNodes<'_>> = below.filled().collect();
            for ((nodes, parts), below) in above.filling().zip(filled.chunks_exact(merged)) {
                let (held, places) = (nodes.held.clone(), NodeColumns { lattice, nodes });
                let each = (x * held.len()).max(1);
                let [re_rows, im_rows] =
                    parts.map(|part| part[..y * x * held.len()].par_chunks_mut(ROWS * each));
                re_rows
                    .zip(im_rows)
                    .enumerate()
                    .with_min_len(batch.least_run(y.div_ceil(ROWS)))
                    .with_max_len(1)
                    .try_for_each(|(i, (re, im))| {
                        let ys = i * ROWS..(i * ROWS + re.len() / each);
                        let first = ys.start * x;
                        let count = ys.len() as u64;
                        let store = |[column, y]: [usize; 2], column_re: &[f32], column_im: &[f32]| {
                            let column = y * x + column;
                            let needed = &places.nodes.needed[column];
                            let at = (column - first) * held.len() + (needed.start - held.start);
                            re[at..at + column_re.len()].copy_from_slice(column_re);
                            im[at..at + column_im.len()].copy_from_slice(column_im);
                        };
                        self.with_buffers(|buffers| {
                            merge.rows(below, &places, ys, buffers, store);
                            done(count)
                        })
                    })?;
            }
            below = above;
        }
        Ok(below)
    }
}
