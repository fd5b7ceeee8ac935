//! The nodes of tiles of one size that are held at a time: which each tile needs, their values, and the columns in which they
//! stand, as the voxels do.

use super::frame::Frame;
use super::nodes::TileLattice;
use crate::alloc::try_returned;
use crate::error::{Error, Result};
use crate::wave::simd::LANES;
use crate::wave::simd::rows::{WIDE, aligned, aligned_mut};
use std::ops::Range;

/// How many more numbers than a tile's nodes there must be, since whole vectors are read beyond the last.
const BEYOND: usize = LANES + 2 * WIDE;

/// Which nodes of one zone of one tile are needed.
#[derive(Debug, Clone)]
pub(crate) struct TileNodes {
    pub(crate) frame: Frame,
    /// Of which zone they are.
    pub(crate) zone: usize,
    /// Nodes along ρ that are held, as multiples of the pitch; whole vectors of them, from a multiple of their length on.
    pub(crate) held: Range<usize>,
    /// Those that each column of nodes needs, `[y, x]`; what the others hold is not used.
    pub(crate) needed: Vec<Range<usize>>,
}

/// The values of these nodes, `[y, x, ρ]`: real and imaginary parts.
#[derive(Debug, Clone, Copy)]
pub(crate) struct FilledNodes<'a> {
    pub(crate) nodes: &'a TileNodes,
    pub(crate) values: [&'a [f32]; 2],
}

/// The nodes of several tiles of one size: of every tile those of one zone after the other.
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

/// Places in columns, each from near to far.
pub(crate) trait PlaceColumns: Sync {
    /// Depths of the first and the last place in a column, m; `None` where it has none.
    fn ends(&self, x: usize, y: usize) -> Option<[f64; 2]>;

    /// Depths of all places in a column, m, and what their own ranges are, if they have any.
    fn fill(&self, x: usize, y: usize, depths: &mut Vec<f64>, ranges: &mut Vec<f64>);
}

/// The same depths in every column.
pub(crate) struct DepthColumns(pub(crate) Vec<f64>);

impl PlaceColumns for DepthColumns {
    fn ends(&self, _: usize, _: usize) -> Option<[f64; 2]> {
        Some([*self.0.first()?, *self.0.last()?])
    }

    fn fill(&self, _: usize, _: usize, depths: &mut Vec<f64>, ranges: &mut Vec<f64>) {
        depths.clone_from(&self.0);
        ranges.clear();
    }
}

/// The nodes that are needed of a tile with one zone.
pub(crate) struct NodeColumns<'a> {
    pub(crate) lattice: &'a TileLattice,
    pub(crate) nodes: &'a TileNodes,
}

impl NodeColumns<'_> {
    fn at(&self, x: usize, y: usize) -> ([f64; 2], Range<usize>) {
        let [nodes_x, nodes_y] = self.lattice.sideways();
        ([nodes_x.places()[x], nodes_y.places()[y]], self.nodes.needed[y * nodes_x.len() + x].clone())
    }
}

impl PlaceColumns for NodeColumns<'_> {
    fn ends(&self, x: usize, y: usize) -> Option<[f64; 2]> {
        let (at, needed) = self.at(x, y);
        (!needed.is_empty()).then(|| {
            let mut ends = [0.0; 2];
            let ranges = [needed.start, needed.end - 1].map(|k| self.lattice.pitch * k as f64);
            self.nodes.frame.depths(at, &ranges, &mut ends);
            ends
        })
    }

    fn fill(&self, x: usize, y: usize, depths: &mut Vec<f64>, ranges: &mut Vec<f64>) {
        let (at, needed) = self.at(x, y);
        ranges.clear();
        ranges.extend(needed.map(|k| self.lattice.pitch * k as f64));
        depths.resize(ranges.len(), 0.0);
        self.nodes.frame.depths(at, ranges, depths);
    }
}

/// What two ranges have in common.
pub(crate) fn common(a: Range<usize>, b: &Range<usize>) -> Range<usize> {
    a.start.max(b.start)..a.end.min(b.end)
}

/// The node that the vector with this one begins with.
pub(crate) fn whole_vector(node: usize) -> usize {
    node - node % LANES
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

/// The least ranges that hold all that was added to each of several columns.
pub(crate) struct Hulls {
    starts: Vec<usize>,
    ends: Vec<usize>,
}

impl Hulls {
    /// With nothing added yet.
    pub(crate) fn none(columns: usize) -> Self {
        Self { starts: vec![usize::MAX; columns], ends: vec![0; columns] }
    }

    /// Adds a range to some columns.
    pub(crate) fn widen(&mut self, columns: Range<usize>, range: &Range<usize>) {
        if !range.is_empty() {
            self.starts[columns.clone()].iter_mut().for_each(|start| *start = range.start.min(*start));
            self.ends[columns].iter_mut().for_each(|end| *end = range.end.max(*end));
        }
    }

    /// Adds to columns from `first` on what was added to others.
    pub(crate) fn widen_each(&mut self, first: usize, others: &Self) {
        let starts = self.starts[first..].iter_mut().zip(&others.starts);
        starts.for_each(|(start, other)| *start = *other.min(start));
        let ends = self.ends[first..].iter_mut().zip(&others.ends);
        ends.for_each(|(end, other)| *end = *other.max(end));
    }

    pub(crate) fn ranges(&self) -> Vec<Range<usize>> {
        self.starts.iter().zip(&self.ends).map(|(start, end)| (*start).min(*end)..*end).collect()
    }
}
