//! The tree against the crate's own, and scenes in which boxes coincide or nest.
#![allow(clippy::unwrap_used)]

use super::*;
use crate::progress::Silent;
use obvhs::Boundable;
use obvhs::ploc::PlocBuilder;
use std::sync::atomic::{AtomicUsize, Ordering};

const FRAME: TreeFrame = TreeFrame { centre: DVec3::ZERO, unit: 1.0 };
const CORNERS: [DVec3; 2] = [DVec3::NEG_ONE, DVec3::ONE];

fn triangle(vertices: [DVec3; 3]) -> Triangle {
    Triangle { vertices, material: 0 }
}

/// A fan of slivers about the centre, as on the caps of cylinders.
fn disc(count: usize) -> Vec<Triangle> {
    let rim = |i: usize| {
        let (sine, cosine) = (i as f64 / count as f64 * std::f64::consts::TAU).sin_cos();
        DVec3::new(cosine, sine, 0.5)
    };
    (0..count).map(|i| triangle([DVec3::ZERO, rim(i), rim(i + 1)])).collect()
}

/// A fan from a corner of its outline, whose boxes contain one another.
fn corner_fan(count: usize) -> Vec<Triangle> {
    let rim = |i: usize| {
        let angle = i as f64 / count as f64 * std::f64::consts::FRAC_PI_2;
        DVec3::new(1.0 - angle.cos(), angle.sin(), 0.0)
    };
    (1..count).map(|i| triangle([DVec3::ZERO, rim(i), rim(i + 1)])).collect()
}

fn leaves(triangles: &[Triangle]) -> Vec<Bvh2Node> {
    let (low, high) = crate::scene::triangle::bounds(triangles).unwrap();
    let all = padded(FRAME.to_tree(low), FRAME.to_tree(high));
    let keys = sorted(triangles, &FRAME, &all).unwrap();
    let leaf = |key: &Key| Bvh2Node::new(boxed(&triangles[key.index as usize], &FRAME), 1, key.index);
    keys.iter().map(leaf).collect()
}

/// Triangles at places of their own, each with a box of its own: there is one order along the curve.
fn scattered(count: usize) -> Vec<Triangle> {
    let part = |i: usize, step: f64| (i as f64 * step).fract();
    let one = |i: usize| {
        let place = DVec3::new(part(i, 0.819_172_5), part(i, 0.671_043_6), part(i, 0.549_700_5));
        let corner = 1.8 * place - DVec3::splat(0.9);
        triangle([corner, corner + 0.05 * place, corner + DVec3::new(0.03, -0.05 * place.x, 0.02)])
    };
    (0..count).map(one).collect()
}

#[test]
fn usual_scenes_get_the_tree_of_the_crate() {
    struct Boxed(Aabb);
    impl Boundable for Boxed {
        fn aabb(&self) -> Aabb {
            self.0
        }
    }
    let triangles = scattered(7200);
    let ours = merge(leaves(&triangles), &Silent).unwrap().unwrap();
    assert!(!ours.by_force);
    let boxes: Vec<_> = triangles.iter().map(|t| Boxed(boxed(t, &FRAME))).collect();
    let parameters = BvhBuildParams::slow_build();
    let theirs = PlocBuilder::with_capacity(boxes.len()).build(
        parameters.ploc_search_distance,
        &boxes,
        (0..boxes.len() as u32).collect(),
        parameters.sort_precision,
        parameters.search_depth_threshold,
    );
    let fields = |nodes: &[Bvh2Node]| -> Vec<_> {
        nodes.iter().map(|n| (n.min.to_array(), n.max.to_array(), n.prim_count, n.first_index)).collect()
    };
    assert!(fields(&ours.nodes) == fields(&theirs.nodes), "the trees differ");
}

#[test]
fn boxes_that_coincide_or_nest_take_few_passes() {
    let corners = [DVec3::ZERO, DVec3::X, DVec3::Y];
    let turned = |i: usize| triangle(std::array::from_fn(|k| corners[(i + k) % 3]));
    // Not equal, but with equal boxes.
    let alike: Vec<_> = (0..4000).map(|i| Triangle { material: i as u32, ..turned(i) }).collect();
    for triangles in [alike, disc(4000), corner_fan(4000)] {
        let merged = merge(leaves(&triangles), &Silent).unwrap().unwrap();
        assert!(merged.passes < 80, "{} passes", merged.passes);
        let mut found = vec![0; triangles.len()];
        let mut open = vec![0];
        while let Some(at) = open.pop() {
            let node = &merged.nodes[at];
            if node.is_leaf() {
                found[node.first_index as usize] += 1;
            } else {
                for child in [node.first_index as usize, node.first_index as usize + 1] {
                    let (inner, outer) = (merged.nodes[child].aabb(), node.aabb());
                    assert!(inner.min.cmpge(outer.min).all() && inner.max.cmple(outer.max).all());
                    open.push(child);
                }
            }
        }
        assert!(found.iter().all(|count| *count == 1), "every triangle is in one leaf");
    }
}

#[test]
fn of_equal_triangles_only_the_first_is_in_the_tree() {
    let one = triangle([DVec3::ZERO, DVec3::X, DVec3::Y]);
    let other = Triangle { material: 1, ..one };
    let triangles = [vec![one; 3000], vec![other; 2], scattered(7200), vec![one; 3000]].concat();
    let bvh = build(&triangles, &FRAME, CORNERS, &Silent).unwrap();
    let mut indices = bvh.primitive_indices.clone();
    indices.sort_unstable();
    let expected: Vec<u32> = [0, 3000].into_iter().chain(3002..3002 + 7200).collect();
    assert_eq!(indices, expected);
}

#[test]
fn building_can_be_stopped_at_any_pass() {
    struct After(AtomicUsize);
    impl Observer for After {
        fn should_stop(&self) -> bool {
            self.0.fetch_sub(1, Ordering::Relaxed) == 0
        }
    }
    let triangles = scattered(7200);
    for after in [0, 1, 5, 20, 40] {
        let stopped = build(&triangles, &FRAME, CORNERS, &After(after.into()));
        assert_eq!(stopped.err(), Some(Error::Interrupted), "{after}");
    }
}
