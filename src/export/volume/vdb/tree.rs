//! The tree of a grid: a root, nodes of 32³ nodes, each of 16³ leaves, each of 8³ voxels.
//!
//! In all of them the index along the third axis is the fastest. A leaf without active voxels does not exist, nor a node
//! without leaves, and no value is stored above the leaves.

use crate::alloc::try_with_capacity;
use crate::export::Compression;
use flate2::{Compress, FlushCompress, Status};
use std::io::{self, Write};

/// Voxels along a side of a leaf.
const LEAF: i32 = 8;

/// Of a node of leaves.
const LOWER: i32 = 16 * LEAF;

/// Of a node of such nodes.
const UPPER: i32 = 32 * LOWER;

/// Values along a side, log2: leaves in a lower node, lower nodes in an upper one.
const LOWER_LOG: u32 = 4;
const UPPER_LOG: u32 = 5;

/// Says of a block of values that only those of active voxels follow, and all others are the background, 0.
const ACTIVE_ONLY: u8 = 0;

/// A leaf that has active voxels.
pub(super) struct Leaf {
    /// The index of its first voxel.
    origin: [i32; 3],
    /// Which of its voxels are active.
    active: [u64; 8],
}

impl Leaf {
    /// The mask of its active voxels as it is stored.
    pub(super) fn mask(&self) -> [u8; 64] {
        let mut mask = [0; 64];
        for (bytes, word) in mask.chunks_exact_mut(8).zip(self.active) {
            bytes.copy_from_slice(&word.to_le_bytes());
        }
        mask
    }

    /// The indices of its active voxels, in the order in which their values are stored.
    pub(super) fn indices(&self) -> impl Iterator<Item = [i32; 3]> {
        (0..512).filter(|i| self.active[i >> 6] >> (i & 63) & 1 == 1).map(|i| index(self.origin, i))
    }

    /// The index of the first voxel of the node of this side that contains it.
    fn node(&self, side: i32) -> [i32; 3] {
        self.origin.map(|o| o - o % side)
    }

    /// The number, in its node of this side, of the child of side `step` that contains it.
    fn child(&self, side: i32, step: i32) -> usize {
        let [x, y, z] = self.origin.map(|o| o % side / step);
        let along = side / step;
        ((x * along + y) * along + z) as usize
    }
}

/// The index of voxel `i` of a leaf.
fn index([x, y, z]: [i32; 3], i: usize) -> [i32; 3] {
    let i = i as i32;
    [x + (i >> 6), y + (i >> 3 & 7), z + (i & 7)]
}

/// The most leaves that a grid of so many voxels along its axes has.
fn most_leaves(count: [i32; 3]) -> u64 {
    count
        .iter()
        .fold(1, |leaves: u64, n| leaves.saturating_mul(n.unsigned_abs().div_ceil(LEAF as u32).into()))
}

/// The most bytes of a list of leaves.
pub(super) fn bytes(count: [i32; 3]) -> u64 {
    most_leaves(count).saturating_mul(size_of::<Leaf>() as u64)
}

/// The leaves of a grid in the order of the file, of which `is_active` may be asked for indices beyond `count`; `None` if
/// the list does not fit in memory.
pub(super) fn leaves(count: [i32; 3], is_active: impl Fn([i32; 3]) -> bool) -> Option<Vec<Leaf>> {
    let mut leaves = try_with_capacity(most_leaves(count))?;
    for upper in blocks([0; 3], i32::MAX, UPPER, count) {
        for lower in blocks(upper, UPPER, LOWER, count) {
            for origin in blocks(lower, LOWER, LEAF, count) {
                let mut active = [0; 8];
                for i in (0..512).filter(|&i| is_active(index(origin, i))) {
                    active[i >> 6] |= 1 << (i & 63);
                }
                if active != [0; 8] {
                    leaves.push(Leaf { origin, active });
                }
            }
        }
    }
    Some(leaves)
}

/// The first indices of the blocks of side `step` in the cube of this side at `from`, within `count`.
fn blocks(from: [i32; 3], side: i32, step: i32, count: [i32; 3]) -> impl Iterator<Item = [i32; 3]> {
    let along = move |axis: usize| {
        (from[axis]..from[axis].saturating_add(side).min(count[axis])).step_by(step as usize)
    };
    along(0).flat_map(move |x| along(1).flat_map(move |y| along(2).map(move |z| [x, y, z])))
}

/// Writes everything of the tree but the values of its leaves.
pub(super) fn write_topology(out: &mut impl Write, leaves: &[Leaf], values: &mut Values) -> io::Result<()> {
    let uppers = || leaves.chunk_by(|a, b| a.node(UPPER) == b.node(UPPER));
    // One buffer of values; the background; no tiles in the root.
    out.write_all(&1_u32.to_le_bytes())?;
    out.write_all(&0_f32.to_le_bytes())?;
    out.write_all(&0_u32.to_le_bytes())?;
    out.write_all(&(uppers().count() as u32).to_le_bytes())?;
    for upper in uppers() {
        let lowers = || upper.chunk_by(|a, b| a.node(LOWER) == b.node(LOWER));
        out.write_all(&upper[0].node(UPPER).map(i32::to_le_bytes).concat())?;
        write_node(out, UPPER_LOG, lowers().map(|lower| lower[0].child(UPPER, LOWER)), values)?;
        for lower in lowers() {
            write_node(out, LOWER_LOG, lower.iter().map(|leaf| leaf.child(LOWER, LEAF)), values)?;
            for leaf in lower {
                out.write_all(&leaf.mask())?;
            }
        }
    }
    Ok(())
}

/// Writes a node: which of its children exist, and that it has no values of its own.
fn write_node(
    out: &mut impl Write,
    log: u32,
    children: impl Iterator<Item = usize>,
    values: &mut Values,
) -> io::Result<()> {
    let mut mask = vec![0_u8; 1 << (3 * log - 3)];
    for child in children {
        mask[child >> 3] |= 1 << (child & 7);
    }
    out.write_all(&mask)?;
    mask.fill(0);
    out.write_all(&mask)?;
    values.write(out, std::iter::empty()).map(|_| ())
}

/// The encoder of blocks of values.
pub(super) struct Values {
    zip: Option<Compress>,
    bytes: Vec<u8>,
    zipped: Vec<u8>,
}

impl Values {
    pub(super) fn new(compression: Compression) -> Self {
        let zip = match compression {
            Compression::Zip => Some(Compress::new(flate2::Compression::default(), true)),
            Compression::None => None,
        };
        Self { zip, bytes: Vec::new(), zipped: Vec::with_capacity(size_of::<f32>() * 512) }
    }

    /// Writes the values of the active voxels of a node; returns them as bytes, not compressed.
    pub(super) fn write(
        &mut self,
        out: &mut impl Write,
        active: impl Iterator<Item = f32>,
    ) -> io::Result<&[u8]> {
        let Self { zip, bytes, zipped } = self;
        bytes.clear();
        bytes.extend(active.flat_map(f32::to_le_bytes));
        out.write_all(&[ACTIVE_ONLY])?;
        if let Some(zip) = zip {
            zip.reset();
            zipped.clear();
            let status = zip.compress_vec(bytes, zipped, FlushCompress::Finish)?;
            if status == Status::StreamEnd && zipped.len() < bytes.len() {
                out.write_all(&(zipped.len() as i64).to_le_bytes())?;
                out.write_all(zipped)?;
                return Ok(bytes);
            }
            // Not shorter for being deflated: as they are, after their length as a negative number.
            out.write_all(&(-(bytes.len() as i64)).to_le_bytes())?;
        }
        out.write_all(bytes)?;
        Ok(bytes)
    }
}
