//! Back-projection by lines: the microphones of a lattice, line by line.
//!
//! What a line of microphones hears of a voxel depends on the voxel's place x along the line, on its distance ρ from it,
//! and on the outward length u: `Σ_q e^{−ik_q u} Σ_a m(q, a) e^{−ik_q √(ρ² + (x − x_a)²)}`. The inner phasors serve
//! all lines. So each microphone is summed only on nodes, rings of some dozens of ρ about its line with a few path lengths
//! each, instead of at every voxel, and each voxel is interpolated from a few nodes of every line.
//!
//! Without the phase of a carrier, the middle frequency by way of a microphone some way aside, a line's image changes
//! slowly along ρ, by how differently its microphones see a voxel, and along the path, by the bandwidth. Sixteen
//! neighbouring columns of voxels along the line share nodes, carriers and weights and differ only in their lanes.
//!
//! Scans have no outward length, and neither have pairs that are moved along their own line, which is then a line of both.
//!
//! Errors, relative to `Σ|w m| / Σw`: that of interpolation is measured on single terms; that of the tones is amplified by
//! the sum of the weights' moduli.

mod band;
mod extent;
mod focus;
mod kernels;
mod nodes;
mod plan;
mod trial;
mod view;

pub(super) use focus::image;
pub(super) use plan::LinesPlan;

#[cfg(test)]
mod tests;
