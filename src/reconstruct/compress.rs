//! Many frequencies to few: a sweep compressed to virtual tones for the whole volume, and these to skeleton tones for each
//! slab of depths.

mod banded;
mod skeleton;
mod slabs;
mod tones;
mod virtual_tones;

pub(super) use skeleton::{DENSER, candidates_for, tones_for, witnesses_for};
pub(super) use slabs::{finders, slabs_of};
pub(super) use tones::{SlabTones, Tones, VolumeTones, frequencies_at_once};
pub(super) use virtual_tones::count as virtual_tone_count;
