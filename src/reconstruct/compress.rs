//! Many frequencies to few: a sweep compressed to virtual tones for the whole volume, these for stretches of depths where the volume
//! is long, and either to skeleton tones for each slab of depths.

mod banded;
mod cost;
mod kept;
mod skeleton;
mod slabs;
mod stretches;
mod tones;
mod virtual_tones;

pub(super) use cost::{CompressionCost, slab_operations, slab_tones, volume_tones};
pub(super) use kept::KeptTones;
pub(crate) use kept::{BYTES_BESIDE_TONES, CONVOLVED};
pub(super) use skeleton::{candidates_for, tones_for};
pub(super) use slabs::finders;
pub(super) use stretches::{HeldTones, StretchTones};
pub(super) use tones::{SlabTones, SweepTones, Tones, VolumeTones, frequencies_at_once};
pub(super) use virtual_tones::VirtualTones;
