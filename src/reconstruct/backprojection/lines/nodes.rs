//! Nodes on which a line's image is summed, for sixteen neighbouring columns of voxels: along the distance ρ from the line,
//! and along the path by way of a carrier's microphone.

use super::kernels::{Places, places};
use super::view::LineView;
use crate::grid::Axis;
use crate::wave::simd::{LANES, ROWS};
use std::ops::Range;

/// Nodes along one coordinate.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Ruler {
    /// Where the first node is, m.
    pub(crate) first: f64,
    pub(crate) pitch: f64,
    /// How many nodes a place is made of.
    pub(crate) taps: usize,
}

impl Ruler {
    /// Nodes from as far before `lowest` as its place is made of any.
    pub(crate) fn before(lowest: f64, pitch: f64, taps: usize) -> Self {
        Self { first: lowest - pitch * before(taps), pitch, taps }
    }

    /// Where node `i` is, m.
    pub(crate) fn position(&self, i: usize) -> f64 {
        self.first + self.pitch * i as f64
    }

    /// The place whose nodes begin with the first, m.
    pub(crate) fn origin(&self) -> f64 {
        self.first + self.pitch * before(self.taps)
    }

    /// How far a place is from its nodes at most, m; a single one is the place itself.
    pub(crate) fn reach(&self) -> f64 {
        if self.taps > 1 { self.pitch * (before(self.taps) + 1.0) } else { 0.0 }
    }
}

/// Nodes that are before a place's own.
fn before(taps: usize) -> f64 {
    (taps / 2).saturating_sub(1) as f64
}

/// Nodes of neighbouring columns of voxels, one in every lane.
#[derive(Debug, Clone)]
pub(crate) struct BlockNodes {
    /// The columns; the last lanes may have none.
    pub(crate) columns: Range<usize>,
    /// Where their middle is along the lines, m.
    pub(crate) middle: f64,
    /// How far the carrier's microphone is aside of it, m.
    pub(crate) aside: f64,
    /// Along ρ.
    pub(crate) rho: Ruler,
    /// Along the path by way of the loudspeaker, the voxel and the carrier's microphone; a scan has one node.
    pub(crate) path: Ruler,
}

/// Which nodes of one line are needed: for every node along ρ those along the path, a multiple of [`ROWS`].
pub(crate) type Needed = Vec<Range<usize>>;

impl BlockNodes {
    /// Where the columns are, beyond the last of them too.
    pub(crate) fn lanes(&self, columns: &Axis) -> [f64; LANES] {
        std::array::from_fn(|l| columns.first + columns.pitch * (self.columns.start + l) as f64)
    }

    /// The carrier's path back from ρ, m.
    pub(crate) fn back(&self, rho: f64) -> f64 {
        rho.hypot(self.aside)
    }

    /// The square of how far the middle is from the loudspeaker along the lines, m²; none for a scan.
    pub(crate) fn to_source(&self, view: &LineView) -> f64 {
        view.source.map_or(0.0, |[x, ..]| (self.middle - x).powi(2))
    }

    /// The squares of outward lengths in all lanes where that in the middle has this square, m²; none for a scan.
    pub(crate) fn squares(&self, view: &LineView, middle: f64) -> [f64; LANES] {
        let Some([source, ..]) = view.source else { return [0.0; LANES] };
        let to_source = self.to_source(view);
        self.lanes(&view.columns).map(|x| middle + ((x - source).powi(2) - to_source))
    }

    /// The outward lengths of a node in all lanes, m; none for a scan.
    pub(crate) fn outward(&self, view: &LineView, rho: f64, path: f64) -> [f64; LANES] {
        self.squares(view, (path - self.back(rho)).powi(2)).map(|square| square.max(0.0).sqrt())
    }

    /// Finds where a line's voxels of one depth lie among the nodes.
    pub(crate) fn place(&self, view: &LineView, line: usize, depth: usize, found: &mut Places) {
        let z = view.depths.position(depth);
        let scale = |ruler: &Ruler| [ruler.origin(), 1.0 / ruler.pitch];
        let line = view.lines.position(line);
        let [source, over_source] = view.source.map_or([0.0; 2], |[_, y, height]| [y, (z - height).powi(2)]);
        found.resize(view.rows.count);
        places(
            [view.rows.first, view.rows.pitch],
            [line, (z - view.height).powi(2), self.aside * self.aside],
            [source, over_source + self.to_source(view)],
            [scale(&self.rho), scale(&self.path)],
            found,
        );
        if view.source.is_none() {
            found.path.fill(0.0);
        }
    }

    /// The nodes that one line's voxels of these depths are made of.
    pub(crate) fn needed(&self, view: &LineView, line: usize, depths: Range<usize>) -> Needed {
        // The first and the last place of any.
        const NONE: [u32; 2] = [u32::MAX, 0];
        let mut first: Vec<[u32; 2]> = Vec::new();
        let mut found = Places::default();
        for depth in depths {
            self.place(view, line, depth, &mut found);
            for (rho, path) in found.rho.iter().zip(&found.path) {
                let (i, j) = (*rho as usize, *path as u32);
                if i >= first.len() {
                    first.resize(i + 1, NONE);
                }
                first[i] = [first[i][0].min(j), first[i][1].max(j)];
            }
        }
        let mut needed = vec![NONE; first.len() + self.rho.taps - 1];
        for (i, [low, high]) in first.into_iter().enumerate().filter(|(_, [low, high])| low <= high) {
            for [start, last] in &mut needed[i..i + self.rho.taps] {
                (*start, *last) = ((*start).min(low), (*last).max(high));
            }
        }
        let whole = |[start, last]: &[u32; 2]| match last.checked_sub(*start) {
            Some(more) => {
                let count = (more as usize + self.path.taps).next_multiple_of(ROWS);
                *start as usize..*start as usize + count
            }
            None => 0..0,
        };
        needed.iter().map(whole).collect()
    }
}
