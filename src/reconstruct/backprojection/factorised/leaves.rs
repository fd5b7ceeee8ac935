//! The smallest tiles: their nodes summed over microphones, in slabs of ranges that share their tones.

use super::held::{HeldNodes, TileNodes};
use super::levels::TileLevels;
use super::patches::Patch;
use crate::acquisition::{Instrument, Tile};
use crate::blocks::runs;
use crate::error::Result;
use crate::progress::{Observer, advance};
use crate::reconstruct::backprojection::blocks::Group;
use crate::reconstruct::backprojection::division::MOST_SLABS;
use crate::reconstruct::backprojection::profile::Band;
use crate::reconstruct::backprojection::{SlabProfiles, share};
use crate::reconstruct::compress::{SlabTones, VolumeTones};
use crate::reconstruct::error_budget::ErrorBudget;
use crate::reconstruct::volume::Batch;
use crate::wave::interval::PathInterval;
use crate::wave::simd::{LaneTones, phasors};
use num_complex::Complex32;
use rayon::prelude::*;
use std::ops::Range;

/// What the nodes of all smallest tiles are summed from.
pub(crate) struct Leaves<'a> {
    plan: &'a TileLevels,
    instrument: &'a Instrument,
    band: Band,
    compressed: &'a VolumeTones,
    /// The first node along ρ that any tile may need.
    first: usize,
    /// Of shells: as many nodes along ρ as a block has.
    pub(crate) slabs: Vec<SlabTones>,
    /// Those of each slab.
    profiles: Vec<SlabProfiles>,
}

/// A block's image and where it belongs.
type Image = (Patch, [Vec<f32>; 2]);

impl<'a> Leaves<'a> {
    /// Finds the tones of all slabs for paths within `paths`, to both sides of which the tiles reach `radius` m.
    pub(crate) fn new(
        plan: &'a TileLevels,
        instrument: &'a Instrument,
        band: Band,
        compressed: &'a VolumeTones,
        (paths, radius): (PathInterval, f64),
        budget: ErrorBudget,
    ) -> Self {
        let (lattice, thickness) = (&plan.levels[0], plan.block[2]);
        let node = |length: f64| (length / lattice.pitch).max(0.0) as usize;
        let first = node(paths.shortest);
        let shells = (node(paths.longest) + 2 - first).div_ceil(thickness);
        let margin = instrument.geometry.return_legs() * radius + plan.half;
        let interval = |shells: Range<usize>| {
            let at = |shell: usize| lattice.pitch * (first + shell * thickness) as f64;
            PathInterval {
                shortest: at(shells.start) - margin,
                longest: at(shells.end) + margin,
                sound_speed: instrument.sound_speed,
            }
        };
        let together = shells.div_ceil(MOST_SLABS);
        let slabs = compressed.sweep.slabs(runs(shells, together), interval, share, budget);
        SlabTones::find(&slabs);
        let profiles = |slab: &SlabTones| {
            SlabProfiles::new(instrument, band, plan.half, slab.per_metre(&compressed.sweep))
        };
        let profiles = slabs.par_iter().map(profiles).collect();
        Self { plan, instrument, band, compressed, first, slabs, profiles }
    }

    /// Nodes along ρ of some shells.
    fn nodes(&self, shells: &Range<usize>) -> Range<usize> {
        let thickness = self.plan.block[2];
        self.first + shells.start * thickness..self.first + shells.end * thickness
    }

    /// The nodes of tiles, every zone of one after the other, summed over their microphones.
    ///
    /// # Errors
    /// [`Error::OutOfMemory`](crate::error::Error::OutOfMemory); [`Error::Interrupted`](crate::error::Error::Interrupted).
    pub(crate) fn summed(
        &self,
        tiles: &[Tile],
        leaves: Vec<TileNodes>,
        batch: Batch,
        observer: &dyn Observer,
    ) -> Result<HeldNodes> {
        let lattice = &self.plan.levels[0];
        let zones = lattice.zones.len();
        let mut leaves = HeldNodes::zeros(leaves)?;
        let microphones: Vec<usize> =
            tiles.iter().flat_map(|tile| tile.microphones.iter().copied()).collect();
        let width = microphones.len();
        let positions = self.instrument.array.positions();
        let positions: Vec<_> = microphones.iter().map(|r| positions[*r]).collect();
        let mut next = 0;
        let groups = tiles.iter().map(|tile| {
            let members = next..next + tile.microphones.len();
            next = members.end;
            Group::of(&positions, members.collect())
        });
        let groups: Vec<Vec<Group>> = groups.collect();
        let own = self.compressed.of_microphones(&microphones)?;
        let per_metre = self.band.carrier / self.band.sound_speed;
        for (slab, profiles) in self.slabs.iter().zip(&self.profiles) {
            let range = self.nodes(&slab.planes);
            let shells: Vec<Range<usize>> =
                slab.planes.clone().map(|shell| self.nodes(&(shell..shell + 1))).collect();
            let [block_x, block_y, _] = self.plan.block;
            let of_leaf = |leaf: (usize, &TileNodes)| -> Vec<Patch> {
                let shells = shells
                    .iter()
                    .filter(|shell| shell.end > leaf.1.held.start && shell.start < leaf.1.held.end);
                shells.flat_map(|shell| Patch::of(lattice, shell, [block_x, block_y], leaf)).collect()
            };
            let patches: Vec<Patch> = leaves.tiles.par_iter().enumerate().flat_map_iter(of_leaf).collect();
            if !patches.is_empty() {
                let tones = slab.of(&own, width)?;
                let split: Vec<Vec<(&Group, LaneTones)>> = groups
                    .iter()
                    .map(|groups| groups.iter().map(|g| (g, g.tones(&tones, width))).collect())
                    .collect();
                let image = |patch: &Patch| -> Result<Vec<Image>> {
                    advance(observer, 0)?;
                    let tile = patch.leaf / zones;
                    let (radius, of_tile) = (tiles[tile].radius, &split[tile]);
                    Ok(self.images(*patch, &leaves.tiles[patch.leaf], radius, profiles, of_tile))
                };
                let images: Vec<Vec<Image>> = patches
                    .par_iter()
                    .with_min_len(batch.least_run(patches.len()))
                    .map(image)
                    .collect::<Result<_>>()?;
                let lengths: Vec<f64> = range.clone().map(|k| lattice.pitch * k as f64).collect();
                let mut turns = vec![Complex32::ZERO; lengths.len()];
                phasors(per_metre, &lengths, &mut turns);
                let mut of_leaves: Vec<Vec<Image>> = leaves.tiles.iter().map(|_| Vec::new()).collect();
                images
                    .into_iter()
                    .flatten()
                    .for_each(|(patch, image)| of_leaves[patch.leaf].push((patch, image)));
                let filling: Vec<_> = leaves.filling().zip(of_leaves).collect();
                filling.into_par_iter().for_each(|((leaf, mut values), images)| {
                    for (patch, image) in images {
                        patch.store(lattice, &image, (range.start, &turns), (leaf, &mut values));
                    }
                });
            }
            advance(observer, tiles.len() as u64)?;
        }
        Ok(leaves)
    }

    /// The image of a patch, in parts where that is wider than expected.
    fn images(
        &self,
        patch: Patch,
        leaf: &TileNodes,
        radius: f64,
        profiles: &SlabProfiles,
        groups: &[(&Group, LaneTones)],
    ) -> Vec<Image> {
        let geometry = &self.instrument.geometry;
        let (mut waiting, mut images) = (vec![patch], Vec::new());
        while let Some(patch) = waiting.pop() {
            let Some(placed) = patch.placed(&self.plan.levels[0], geometry, leaf, radius) else { continue };
            match patch.halves() {
                Some(halves) if placed.half > self.plan.half => waiting.extend(halves),
                _ => images
                    .push((patch, profiles.image(placed.centre, &placed.points, groups, |_| placed.half))),
            }
        }
        images
    }
}
