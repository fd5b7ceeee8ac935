//! Fast factorised back-projection: tiles of the array are imaged on few nodes of coordinates of their own, and the voxels
//! are interpolated from the nodes of all tiles.

mod frame;
mod nodes;
mod patches;
mod terms;
mod tiled;
mod voxels;

pub(super) use nodes::TileLattice;
pub(super) use tiled::{DEPTHS, Tiled, compression, row_bytes, usual_budget};
