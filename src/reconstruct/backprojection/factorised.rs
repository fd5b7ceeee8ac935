//! Fast factorised back-projection: tiles of the array are imaged on few nodes of coordinates of their own, the nodes of
//! larger tiles are interpolated from those of the smaller that they are made of, and the voxels from the largest.

mod frame;
mod held;
mod leaves;
mod levels;
mod merge;
mod nodes;
mod patches;
mod search;
mod sequence;
mod terms;
mod tiled;
mod tree;
mod trial;
mod zones;

pub(super) use levels::TileLevels;
pub(super) use search::TileSearch;
pub(super) use tiled::{Tiled, compression, usual_budget};
