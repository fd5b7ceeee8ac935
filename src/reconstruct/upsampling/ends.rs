//! Nodes that two processes need: those about a boundary between the depths of one and of the other.
//!
//! Half of an interpolator reaches beyond a process's depths at either end, which for a short run of depths is as much work
//! as its own nodes. Whichever process comes first to a boundary stores these nodes for the other: at its first depths it
//! does so at once, and at its last it looks once more before it computes them. One of few depths, for which they are more
//! than its own result, only reads them: a file system that many processes share would carry more of them than of the volume.

use crate::alloc::try_zeroed;
use crate::blocks::NodeStore;
use crate::error::{Error, Result};
use crate::reconstruct::numerics::AxisWeights;
use num_complex::Complex32;
use std::ops::Range;
use std::sync::OnceLock;

/// The boundaries at which a process's depths begin and end, where others have the depths beyond.
pub(super) struct Ends<'a> {
    store: &'a dyn NodeStore,
    /// Samples of a plane of nodes.
    plane_len: usize,
    first: Option<End>,
    last: Option<End>,
}

/// One boundary.
pub(super) struct End {
    /// The depth of voxels before which it is.
    boundary: usize,
    /// The depths of nodes that are needed on both sides.
    pub(super) nodes: Range<usize>,
    /// Whether another process may still need them, and they are no more than this one's depths.
    stores: bool,
    /// Whether another process has stored them; looked for when they are needed.
    stored: OnceLock<bool>,
}

impl<'a> Ends<'a> {
    /// Of a run of depths, which are made of nodes by these weights along z; planes of nodes and of voxels have so many samples.
    pub(super) fn new(
        store: &'a dyn NodeStore,
        weights: &AxisWeights,
        depths: Range<usize>,
        [plane_len, voxels]: [usize; 2],
    ) -> Self {
        let most = depths.len().saturating_mul(voxels);
        let end = |boundary: usize, beyond: usize| {
            let (last, taps) = weights.of(boundary - 1);
            let nodes = weights.of(boundary).0..last + taps.len();
            let stores = nodes.len().saturating_mul(plane_len) <= most && store.is_needed(beyond);
            (!nodes.is_empty()).then(|| End { boundary, nodes, stores, stored: OnceLock::new() })
        };
        let is_empty = depths.is_empty();
        let first = if is_empty || depths.start == 0 { None } else { end(depths.start, depths.start - 1) };
        let last = if is_empty || depths.end == weights.len() { None } else { end(depths.end, depths.end) };
        Self { store, plane_len, first, last }
    }

    /// The nodes before the first depth that another process has stored.
    pub(super) fn stored_first(&self) -> Option<&End> {
        self.first.as_ref().filter(|end| self.is_stored(end))
    }

    /// Those behind the last, looked for once one of `nodes` is of them.
    pub(super) fn stored_last(&self, nodes: &Range<usize>) -> Option<&End> {
        self.last.as_ref().filter(|end| nodes.end > end.nodes.start && self.is_stored(end))
    }

    /// Whether they are all stored, and intact. One that asks for a stop computes them, and is stopped there.
    fn is_stored(&self, end: &End) -> bool {
        let found = || self.store.has(end.boundary, end.nodes.len(), self.plane_len).unwrap_or(false);
        *end.stored.get_or_init(found)
    }

    /// Stores what another process may need of planes from `first` on.
    pub(super) fn save(&self, first: usize, planes: &[Complex32]) {
        for end in [&self.first, &self.last].into_iter().flatten() {
            let reached = first + planes.len() / self.plane_len > end.nodes.start;
            if !end.stores || !reached || self.is_stored(end) {
                continue;
            }
            for (node, plane) in (first..).zip(planes.chunks_exact(self.plane_len)) {
                if end.nodes.contains(&node) {
                    let is_last = node + 1 == end.nodes.end;
                    self.store.save(end.boundary, node - end.nodes.start, plane, is_last);
                }
            }
        }
    }

    /// Room for so many planes.
    ///
    /// # Errors
    /// [`Error::OutOfMemory`].
    pub(super) fn room(&self, planes: usize) -> Result<Vec<Complex32>> {
        let no_room =
            || Error::out_of_memory("stored nodes do not fit in memory; use a smaller grid".to_owned());
        try_zeroed((planes * self.plane_len) as u64).ok_or_else(no_room)
    }

    /// Reads stored planes of these nodes, in the order of `room`, and gives them.
    ///
    /// # Errors
    /// They are not there any more; [`Error::Interrupted`].
    pub(super) fn load<'b>(
        &self,
        end: &End,
        nodes: Range<usize>,
        room: &'b mut [Complex32],
    ) -> Result<&'b [Complex32]> {
        let planes = &mut room[..nodes.len() * self.plane_len];
        for (node, plane) in nodes.zip(planes.chunks_exact_mut(self.plane_len)) {
            if !self.store.load(end.boundary, node - end.nodes.start, plane)? {
                let problem = "stored nodes were deleted or damaged while the job ran; run it again";
                return Err(Error::io("checkpoint", problem));
            }
        }
        Ok(planes)
    }
}
