//! Numerics without acoustics: Fourier transforms of sixteen columns at once, least-squares interpolators of
//! band-limited functions, and spreading, which moves scattered points onto a lattice with them.

mod footprints;
mod grid_places;
mod interpolator;
mod interval_nodes;
mod lane_fft;
mod memo;
mod nodes;
mod spreading;

pub(super) use footprints::Footprints;
pub(super) use grid_places::GridPlaces;
pub(super) use interpolator::Taps;
pub(super) use interval_nodes::IntervalNodes;
pub(super) use lane_fft::{LaneFft, fast_size};
pub(super) use memo::Memo;
pub(super) use nodes::{Around, AxisWeights, Nodes, known_at, padded_width, wave_error};
pub(super) use spreading::{FILLS, Interpolator, Kernels, nodes_around};
