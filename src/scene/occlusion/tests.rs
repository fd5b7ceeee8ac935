//! The tree against the literal loop, and the paths on which ray tracers leak.
#![allow(clippy::unwrap_used)]

use glam::DVec3;
use proptest::prelude::*;
use proptest::test_runner::RngSeed;

use super::super::fixtures::{material, plate};
use super::super::{BYTES_PER_TRIANGLE, Material, Scene, Triangle};
use crate::named::assert_names;

fn scene(triangles: &[[DVec3; 3]], transmittance: f64) -> Scene {
    let triangles = triangles.iter().map(|&vertices| Triangle { vertices, material: 0 }).collect();
    Scene::new(triangles, vec![material(1.0, transmittance)]).unwrap()
}

fn v(x: f64, y: f64, z: f64) -> DVec3 {
    DVec3::new(x, y, z)
}

/// The square |x|, |y| <= half at depth z, of two triangles.
fn square(z: f64, half: f64) -> [[DVec3; 3]; 2] {
    plate([-half, half], [-half, half], z, 0).map(|triangle| triangle.vertices)
}

/// n x n cells of side 1/n over (0, 1)² at z = 1, each cut along its rising diagonal.
fn grid(n: usize) -> Vec<[DVec3; 3]> {
    let at = |i: usize, j: usize| v(i as f64 / n as f64, j as f64 / n as f64, 1.0);
    let cells = (0..n).flat_map(|i| (0..n).map(move |j| (i, j)));
    cells
        .flat_map(|(i, j)| {
            let (a, b, c, d) = (at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1));
            [[a, b, c], [a, c, d]]
        })
        .collect()
}

fn cube(half: f64) -> Vec<[DVec3; 3]> {
    let mut faces = Vec::new();
    for axis in 0..3 {
        for side in [-half, half] {
            faces.extend(square(side, half).map(|t| {
                t.map(|p| {
                    let mut q = [0.0; 3];
                    (q[axis], q[(axis + 1) % 3], q[(axis + 2) % 3]) = (p.z, p.x, p.y);
                    DVec3::from_array(q)
                })
            }));
        }
    }
    faces
}

fn point(range: f64) -> impl Strategy<Value = DVec3> {
    let c = || -range..range;
    (c(), c(), c()).prop_map(|(x, y, z)| v(x, y, z))
}

#[test]
fn a_scene_takes_half_of_what_building_it_does() {
    let bumps = |p: DVec3| v(p.x, p.y, 1.0 + 0.1 * (9.0 * p.x).sin() * (7.0 * p.y).cos());
    let wavy: Vec<_> = grid(100).into_iter().map(|t| t.map(bumps)).collect();
    for triangles in [grid(100), wavy] {
        let scene = scene(&triangles, 0.0);
        let (kept, building) = (scene.memory_bytes(), BYTES_PER_TRIANGLE * triangles.len() as u64);
        let triangles = size_of_val(scene.triangles()) as u64;
        assert!(scene.tree.bvh.parents.is_empty() && kept > triangles && 2 * kept <= building, "{kept}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 256, failure_persistence: None, rng_seed: RngSeed::Fixed(1), ..ProptestConfig::default() })]

    #[test]
    fn the_tree_finds_what_the_loop_finds(
        soup in prop::collection::vec((point(1.0), point(0.5), point(0.5)), 1..120),
        centre in point(100.0), paths in prop::collection::vec((point(3.0), point(3.0)), 20),
        clear in prop::bool::ANY,
    ) {
        let soup: Vec<_> = soup.iter().map(|&(a, b, c)| [centre + a, centre + a + b, centre + a + c]).collect();
        let transmittance = if clear { 0.6 } else { 0.0 };
        let scene = scene(&soup, transmittance);
        for (from, to) in paths {
            let (from, to) = (centre + from, centre + to);
            let (fast, literal) = (scene.crossings(from, to), scene.crossings_exhaustive(from, to));
            prop_assert_eq!(fast.len(), literal.len());
            for (a, b) in fast.iter().zip(&literal) {
                prop_assert_eq!(a.triangle, b.triangle);
                prop_assert!((a.distance - b.distance).abs() < 1e-9);
            }
            let product: f64 = literal.iter().map(|c| c.transmittance).product();
            prop_assert!((scene.transmittance(from, to) - product).abs() < 1e-12);
            // The reverse path crosses the same.
            prop_assert_eq!(scene.crossings(to, from).len(), fast.len());
        }
    }

    #[test]
    fn axis_aligned_paths_are_no_different(
        soup in prop::collection::vec((point(1.0), point(0.5), point(0.5)), 1..80),
        starts in prop::collection::vec((point(1.0), 0_usize..3), 20),
    ) {
        let soup: Vec<_> = soup.iter().map(|&(a, b, c)| [a, a + b, a + c]).collect();
        let scene = scene(&soup, 0.6);
        for (start, axis) in starts {
            let (mut from, mut to) = (start, start);
            (from[axis], to[axis]) = (-4.0, 4.0);
            for (from, to) in [(from, to), (to, from)] {
                let fast: Vec<_> = scene.crossings(from, to).iter().map(|c| c.triangle).collect();
                let literal: Vec<_> = scene.crossings_exhaustive(from, to).iter().map(|c| c.triangle).collect();
                prop_assert_eq!(fast, literal);
            }
        }
    }

    #[test]
    fn no_path_slips_through_a_closed_wall(
        target in (0.0..1.0_f64, 0.0..1.0_f64), from in point(1.5), n in 1_usize..12,
        snap in 0_u8..4,
    ) {
        // Aim at random points, at vertices, at edges and at diagonals.
        let cell = |t: f64| (t * n as f64).floor() / n as f64;
        let (x, y) = match snap {
            0 => target,
            1 => (cell(target.0), cell(target.1)),
            2 => (cell(target.0), target.1),
            _ => (target.0, cell(target.1) + target.0 - cell(target.0)),
        };
        prop_assume!(x > 0.0 && y > 0.0 && y < 1.0 && from.z < 0.9);
        let on_wall = v(x, y, 1.0);
        let scene = scene(&grid(n), 0.0);
        let beyond = on_wall + (on_wall - from);
        prop_assert_eq!(scene.transmittance(from, beyond), 0.0);
        prop_assert_eq!(scene.transmittance(beyond, from), 0.0);
        prop_assert_eq!(scene.crossings(from, beyond).len(), 1);
    }
}

#[test]
fn every_axis_aligned_path_meets_the_wall_once_from_both_sides() {
    let n = 32;
    let scene = scene(&grid(n), 0.5);
    // Vertices, edge middles and diagonal middles of the wall; the reverse path has the direction (-0, -0, -1).
    for i in 1..2 * n {
        for j in 1..2 * n {
            let (x, y) = (i as f64 / (2 * n) as f64, j as f64 / (2 * n) as f64);
            for (from, to) in [(v(x, y, 0.0), v(x, y, 2.0)), (v(x, y, 2.0), v(x, y, 0.0))] {
                assert_eq!(scene.transmittance(from, to), 0.5, "{from} {to}");
                let crossings = scene.crossings(from, to);
                assert_eq!(crossings.len(), 1);
                assert!((crossings[0].distance - 1.0).abs() < 1e-12);
            }
        }
    }
}

#[test]
fn a_negative_zero_in_the_direction_hides_nothing() {
    let scene = scene(&square(1.0, 0.5), 0.0);
    for (x, y) in [(0.0, 0.0), (0.1, 0.2), (-0.3, 0.3), (0.5, 0.5)] {
        let from = v(x, y, 0.0);
        assert_eq!(scene.transmittance(from, v(x - 0.0, y - 0.0, 3.0)), 0.0);
        assert_eq!(scene.transmittance(v(x, y, 3.0), from), 0.0);
    }
    assert_eq!(scene.transmittance(v(0.6, 0.0, 0.0), v(0.6, 0.0, 3.0)), 1.0);
}

#[test]
fn clear_surfaces_multiply_and_doubled_faces_count_once() {
    let mut stack: Vec<_> = (1..=5).flat_map(|k| square(f64::from(k), 1.0)).collect();
    let path = (v(0.1, 0.2, 0.0), v(0.3, -0.1, 10.0));
    let t = scene(&stack, 0.6).transmittance(path.0, path.1);
    assert!((t - 0.6_f64.powi(5)).abs() < 1e-15);
    stack.extend(stack.clone());
    let doubled = scene(&stack, 0.6);
    assert_eq!(doubled.transmittance(path.0, path.1), t);
    let depths: Vec<_> = doubled.crossings(path.0, path.1).iter().map(|c| c.distance).collect();
    assert_eq!(depths.len(), 5);
    assert!(depths.is_sorted());
}

#[test]
fn of_two_faces_at_one_place_the_less_clear_counts() {
    let faces = [0, 1].map(|material| plate([-1.0, 1.0], [-1.0, 1.0], 1.0, material));
    let scene = Scene::new(faces.concat(), vec![material(1.0, 0.9), material(1.0, 0.3)]).unwrap();
    let crossings = scene.crossings(v(0.1, 0.2, 0.0), v(0.1, 0.2, 2.0));
    assert_eq!(crossings.len(), 1);
    assert_eq!(
        (crossings[0].transmittance, scene.triangles()[crossings[0].triangle as usize].material),
        (0.3, 1)
    );
}

#[test]
fn a_closed_cube_is_entered_and_left() {
    let scene = scene(&cube(0.5), 0.5);
    assert_eq!(scene.transmittance(v(0.1, 0.2, -2.0), v(0.1, 0.2, 2.0)), 0.25);
    assert_eq!(scene.transmittance(v(-2.0, -2.0, -2.0), v(2.0, 2.0, 2.0)), 0.25); // corner to corner
    assert_eq!(scene.transmittance(v(0.0, 0.0, 0.0), v(0.2, 0.3, 2.0)), 0.5); // from inside
    assert_eq!(scene.surface_area(), 6.0);
    assert_eq!(scene.bounds(), Some((DVec3::splat(-0.5), DVec3::splat(0.5))));
}

#[test]
fn a_reflector_does_not_shade_itself_nor_do_its_neighbours() {
    let scene = scene(&grid(8), 0.0);
    for target in [v(0.5, 0.5, 1.0), v(0.3, 0.7, 1.0), v(0.25, 0.6, 1.0), v(0.999_999, 0.5, 1.0)] {
        assert_eq!(scene.transmittance(DVec3::ZERO, target), 1.0);
        assert_eq!(scene.transmittance(target, v(-0.4, 0.9, 0.0)), 1.0);
        assert_eq!(scene.transmittance(v(0.2, 0.2, 3.0), target), 1.0); // the back is a surface too
    }
    // Half a micrometre behind it, the surface is between.
    assert_eq!(scene.transmittance(DVec3::ZERO, v(0.3, 0.7, 1.0 + 5e-7)), 0.0);
}

#[test]
fn degenerate_triangles_and_empty_scenes_stop_nothing() {
    let p = v(0.0, 0.0, 1.0);
    let line = [v(-1.0, 0.0, 1.0), v(0.0, 0.0, 1.0), v(1.0, 0.0, 1.0)];
    let ends = (DVec3::ZERO, v(0.0, 0.0, 2.0));
    assert_eq!(scene(&[[p, p, p], line], 0.0).transmittance(ends.0, ends.1), 1.0);
    assert_eq!(scene(&[], 0.0).transmittance(ends.0, ends.1), 1.0);
    assert_eq!(scene(&[[p, p, p]], 0.0).crossings(ends.0, ends.1), []);
    assert_eq!(scene(&square(1.0, 1.0), 0.0).transmittance(ends.1, ends.1), 1.0); // a path of length 0
    let mut many = vec![[p, p, p]; 2000];
    many.extend(square(1.5, 1.0));
    assert_eq!(scene(&many, 0.0).transmittance(ends.0, ends.1), 0.0);
}

#[test]
fn far_ends_and_far_scenes_lose_no_wall() {
    let near = scene(&grid(4), 0.0);
    assert_eq!(near.transmittance(v(0.5, 0.5, -1e6), v(0.5, 0.5, 1e6)), 0.0);
    let offset = v(4e5, -3e5, 7e5);
    let far: Vec<_> = grid(4).iter().map(|t| t.map(|p| p + offset)).collect();
    let far = scene(&far, 0.0);
    for k in 1..40 {
        let on_wall = offset + v(f64::from(k) / 40.0, 0.25, 1.0);
        assert_eq!(far.transmittance(on_wall - DVec3::Z, on_wall + DVec3::Z), 0.0);
        assert_eq!(far.transmittance(DVec3::ZERO, 2.0 * on_wall), 0.0);
    }
}

#[test]
fn impossible_triangles_are_refused() {
    let refused = |p: DVec3, material| {
        let triangle = Triangle { vertices: [DVec3::ZERO, DVec3::X, p], material };
        Scene::new(vec![triangle], vec![Material::opaque("m")]).unwrap_err().to_string()
    };
    assert_names(refused(DVec3::NAN, 0), &["triangle 0", "finite"]);
    assert_names(refused(DVec3::Y * 2e9, 0), &["triangle 0", "1e9 m"]);
    assert_names(refused(DVec3::Y, 1), &["triangle 0", "material 1", "are 1"]);
    let loud = Material { reflectance: 1.1, ..Material::opaque("loud") };
    assert_names(Scene::new(vec![], vec![loud]).unwrap_err().to_string(), &["`loud`", "reflectance", "1.1"]);
}

#[test]
fn a_pile_of_equal_triangles_is_one_surface() {
    let one = square(1.0, 1.0)[0];
    let alone = scene(&[one], 0.6);
    let pile = scene(&vec![one; 200_000], 0.6);
    for (x, y) in [(0.1, -0.5), (-0.2, -0.3), (0.9, 0.9), (0.0, 0.0)] {
        let (from, to) = (v(0.0, 0.0, 0.0), v(2.0 * x, 2.0 * y, 2.0));
        assert_eq!(pile.crossings(from, to), alone.crossings(from, to));
        assert_eq!(pile.transmittance(from, to), alone.transmittance(from, to));
    }
    assert_eq!(pile.triangles().len(), 200_000);
}
