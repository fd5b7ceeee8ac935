//! Builds the tree over the triangles' boxes: clusters of neighbours are merged, then the tree is improved.
//!
//! The merging is that of PLOC: D. Meister and J. Bittner, "Parallel Locally-Ordered Clustering for Bounding Volume
//! Hierarchy Construction" (IEEE TVCG 24, 2018). Clusters stand along a Morton curve; in each pass, those that are each
//! other's best partner within a short distance are merged. It is written out here, rather than left to obvhs, because
//! nothing bounds the number of its passes: of boxes that coincide, or that contain one another as those of a fan do,
//! everyone's best partner prefers the next one, and a pass merges a single pair. After a fixed amount of work,
//! neighbours are therefore paired as they stand. Elsewhere the tree is that of obvhs.

use super::{PADDING, TreeFrame};
use crate::alloc::{try_filled, try_with_capacity};
use crate::error::{Error, Result};
use crate::progress::Observer;
use crate::scene::files::does_not_fit;
use crate::scene::triangle::Triangle;
use glam::{DVec3, Vec3A};
use obvhs::BvhBuildParams;
use obvhs::aabb::Aabb;
use obvhs::bvh2::Bvh2;
use obvhs::bvh2::leaf_collapser::collapse;
use obvhs::bvh2::node::Bvh2Node;
use obvhs::bvh2::reinsertion::ReinsertionOptimizer;
use obvhs::ploc::morton::morton_encode_u128_unorm;
use rayon::prelude::*;
use std::mem;

/// Bytes per triangle at the peak, at most: an index, two lists of clusters, two nodes and a partner. The keys by which
/// triangles are sorted, which are freed before, take less.
pub(super) const BYTES: u64 = (4 * size_of::<Bvh2Node>() + size_of::<u32>() + size_of::<i8>()) as u64;

/// How far along the curve a partner is searched for, after the first passes.
const REACH: usize = 24;

/// The first passes, in which most pairs are found, look at the next neighbours only.
const QUICK_PASSES: usize = 2;

/// How many clusters the passes may visit, per triangle, before they have to pair neighbours. Usual scenes take 3 to 4.
const VISITS: usize = 10;

/// Nodes for which a better place is searched in one pass, at most: as many as 600 000 triangles ask for. Of more triangles
/// those with the largest boxes are moved, which most rays meet; there are not more rays for more triangles.
const MOST_MOVED: f32 = 250_000.0;

/// Clusters whose partners are searched for by one thread at a time.
const CHUNK: usize = 1024;

/// What triangles are sorted by: their place along the curve, then their content, so that equal ones are adjacent.
#[derive(Clone, Copy)]
struct Key {
    code: u128,
    content: u64,
    index: u32,
}

/// The box of a triangle, padded, in the tree's coordinates.
fn boxed(triangle: &Triangle, frame: &TreeFrame) -> Aabb {
    let [a, b, c] = triangle.vertices.map(|v| frame.to_tree(v));
    padded(a.min(b).min(c), a.max(b).max(c))
}

fn padded(low: Vec3A, high: Vec3A) -> Aabb {
    let padding = Vec3A::splat(PADDING);
    Aabb::new(low - padding, high + padding)
}

/// A fingerprint of a triangle; equal triangles have equal ones.
fn content(triangle: &Triangle) -> u64 {
    let numbers = triangle.vertices.iter().flat_map(DVec3::as_ref).map(|x| x.to_bits());
    numbers.fold(u64::from(triangle.material), |sum, bits| {
        (sum ^ bits).wrapping_mul(0x9e37_79b9_7f4a_7c15).rotate_left(29)
    })
}

fn are_equal(a: &Triangle, b: &Triangle) -> bool {
    let bits = |t: &Triangle| t.vertices.map(|v| v.to_array().map(f64::to_bits));
    a.material == b.material && bits(a) == bits(b)
}

/// The tree over triangles between the corners `low` and `high`, m.
///
/// Of equal triangles only the first is in the tree: a path that crosses one crosses all at one place, where the first
/// counts. Triangles are not split, because they would be in several leaves and be counted several times. Cost:
/// `O(n log n)` for any triangles.
///
/// # Errors
/// [`Error::OutOfMemory`] when it does not fit in memory; [`Error::Interrupted`] when the observer asks to stop.
pub(super) fn build(
    triangles: &[Triangle],
    frame: &TreeFrame,
    [low, high]: [DVec3; 2],
    observer: &dyn Observer,
) -> Result<Bvh2> {
    let no_room = || does_not_fit("scene", "the nodes of the tree over its triangles");
    // The crate aborts when memory runs out, so as much as the tree needs is allocated beforehand, and freed.
    drop(try_with_capacity::<u8>(triangles.len() as u64 * BYTES).ok_or_else(no_room)?);
    let all = padded(frame.to_tree(low), frame.to_tree(high));
    let keys = sorted(triangles, frame, &all).ok_or_else(no_room)?;
    stop(observer)?;
    let count = keys.len() as u64;
    let mut indices = try_with_capacity(count).ok_or_else(no_room)?;
    indices.extend(keys.iter().map(|key| key.index));
    drop(keys);
    let mut leaves = try_with_capacity(count).ok_or_else(no_room)?;
    let leaf =
        |(place, index): (u32, &u32)| Bvh2Node::new(boxed(&triangles[*index as usize], frame), 1, place);
    leaves.extend((0..).zip(&indices).map(leaf));
    let merged = merge(leaves, observer)?.ok_or_else(no_room)?;
    let mut bvh = Bvh2 { nodes: merged.nodes, primitive_indices: indices, ..Bvh2::default() };
    bvh.max_depth = bvh.max_depth.max(merged.passes + 1);
    bvh.children_are_ordered_after_parents = true;
    let parameters = BvhBuildParams::slow_build();
    let ratio = parameters.reinsertion_batch_ratio;
    // Where so many boxes overlap that neighbours had to be paired, there is hardly a better place for any, and the
    // search for one, which follows every box that contains another, would be quadratic.
    if !merged.by_force {
        improve(&mut bvh, ratio, observer)?;
    }
    collapse(&mut bvh, parameters.max_prims_per_leaf, parameters.collapse_traversal_cost);
    if !merged.by_force {
        improve(&mut bvh, ratio * parameters.post_collapse_reinsertion_batch_ratio_multiplier, observer)?;
    }
    // Only changes to the tree would need them.
    bvh.parents = Vec::new();
    Ok(bvh)
}

fn stop(observer: &dyn Observer) -> Result<()> {
    if observer.should_stop() { Err(Error::Interrupted) } else { Ok(()) }
}

/// The distinct triangles in the order of the curve; `None` when they do not fit in memory.
fn sorted(triangles: &[Triangle], frame: &TreeFrame, all: &Aabb) -> Option<Vec<Key>> {
    let scale = 1.0 / all.diagonal().as_dvec3();
    let offset = -all.min.as_dvec3() * scale;
    let mut keys = try_filled(Key { code: 0, content: 0, index: 0 }, triangles.len() as u64)?;
    keys.par_iter_mut().zip(triangles.par_iter().enumerate()).for_each(|(key, (index, triangle))| {
        let centre = boxed(triangle, frame).center().as_dvec3();
        let code = morton_encode_u128_unorm(centre * scale + offset);
        *key = Key { code, content: content(triangle), index: index as u32 };
    });
    keys.par_sort_unstable_by_key(|key| (key.code, key.content, key.index));
    keys.dedup_by(|next, kept| {
        let [next_one, kept_one] = [next, kept].map(|key| &triangles[key.index as usize]);
        are_equal(next_one, kept_one)
    });
    Some(keys)
}

/// A tree of clusters.
struct Merged {
    nodes: Vec<Bvh2Node>,
    passes: usize,
    /// Whether clusters had to be paired as they stood.
    by_force: bool,
}

/// Merges clusters until one is left; `None` when its nodes do not fit in memory.
fn merge(mut clusters: Vec<Bvh2Node>, observer: &dyn Observer) -> Result<Option<Merged>> {
    let leaves = clusters.len();
    let rooms = (
        try_filled(Bvh2Node::default(), (2 * leaves as u64).saturating_sub(1)),
        try_with_capacity(leaves as u64),
        try_filled(0_i8, leaves as u64),
    );
    let (Some(mut nodes), Some(mut next), Some(mut partners)) = rooms else { return Ok(None) };
    // Pairs of nodes are placed from the end on, so that parents precede their children.
    let mut free = nodes.len();
    let (mut passes, mut visits, mut by_force) = (0, 0, false);
    while clusters.len() > 1 {
        stop(observer)?;
        let partners = &mut partners[..clusters.len()];
        visits += clusters.len();
        if passes < QUICK_PASSES {
            next_partners(&clusters, partners);
        } else {
            best_partners(&clusters, partners);
        }
        if visits > VISITS * leaves + CHUNK && 8 * pairs(partners) < clusters.len() {
            by_force = true;
            // The last one of an odd number points at one that points elsewhere.
            partners.iter_mut().enumerate().for_each(|(i, partner)| *partner = 1 - 2 * (i % 2) as i8);
            if let Some(last) = partners.last_mut() {
                *last = -1;
            }
        }
        next.clear();
        for (i, cluster) in clusters.iter().enumerate() {
            let partner = partner_of(partners, i);
            if partner_of(partners, partner) != i {
                next.push(*cluster);
            } else if partner < i {
                free -= 2;
                (nodes[free], nodes[free + 1]) = (*cluster, clusters[partner]);
                next.push(Bvh2Node::new(cluster.aabb().union(clusters[partner].aabb()), 0, free as u32));
            }
        }
        mem::swap(&mut clusters, &mut next);
        passes += 1;
    }
    if let (Some(root), Some(last)) = (nodes.first_mut(), clusters.first()) {
        *root = *last;
    }
    Ok(Some(Merged { nodes, passes, by_force }))
}

fn partner_of(partners: &[i8], i: usize) -> usize {
    i.wrapping_add_signed(isize::from(partners[i]))
}

/// Pairs of clusters that are each other's partner.
fn pairs(partners: &[i8]) -> usize {
    let is_pair = |i: &usize| {
        let partner = partner_of(partners, *i);
        partner > *i && partner_of(partners, partner) == *i
    };
    (0..partners.len()).filter(is_pair).count()
}

/// Surface of two clusters together, the measure by which partners are chosen.
fn cost(a: &Bvh2Node, b: &Bvh2Node) -> f32 {
    a.aabb().union(b.aabb()).half_area()
}

/// The better of each cluster's two neighbours; of equal ones the next.
fn next_partners(clusters: &[Bvh2Node], partners: &mut [i8]) {
    let last = clusters.len() - 1;
    partners.par_chunks_mut(CHUNK).enumerate().for_each(|(chunk, partners)| {
        for (i, partner) in (chunk * CHUNK..).zip(partners) {
            let before = if i > 0 { cost(&clusters[i - 1], &clusters[i]) } else { f32::INFINITY };
            *partner = if i == last || before < cost(&clusters[i], &clusters[i + 1]) { -1 } else { 1 };
        }
    });
}

/// The best partner of each cluster within the reach; of equal ones the last.
fn best_partners(clusters: &[Bvh2Node], partners: &mut [i8]) {
    partners.par_chunks_mut(CHUNK).enumerate().for_each(|(chunk, partners)| {
        let start = chunk * CHUNK;
        // The costs of a cluster with those behind it were computed when it was their turn.
        let mut costs = [[0.0_f32; REACH]; REACH];
        for (i, partner) in (start..).zip(partners) {
            let (mut best, mut least) = (i, f32::INFINITY);
            let mut consider = |other: usize, cost: f32| {
                if cost <= least {
                    (best, least) = (other, cost);
                }
            };
            for other in i.saturating_sub(REACH)..i {
                let known = other >= start;
                let together = if known {
                    costs[other % REACH][i % REACH]
                } else {
                    cost(&clusters[other], &clusters[i])
                };
                consider(other, together);
            }
            for other in i + 1..(i + REACH + 1).min(clusters.len()) {
                let together = cost(&clusters[i], &clusters[other]);
                costs[i % REACH][other % REACH] = together;
                consider(other, together);
            }
            *partner = (best as isize - i as isize) as i8;
        }
    });
}

/// Moves nodes to better places, as obvhs does in one call, but between its passes the work may be stopped.
fn improve(bvh: &mut Bvh2, ratio: f32, observer: &dyn Observer) -> Result<()> {
    let ratio = ratio.min(MOST_MOVED / bvh.nodes.len() as f32);
    let mut optimizer = ReinsertionOptimizer::default();
    for pass in (1..32_u8).step_by(2) {
        stop(observer)?;
        optimizer.run(bvh, ratio, Some(vec![1.0 / f32::from(pass)]));
    }
    Ok(())
}

#[cfg(test)]
mod tests;
