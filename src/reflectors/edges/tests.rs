//! Edges: the closed form of a half plane, jumps at the borders of shadow and reflection, and which edges a scene has.

use super::*;
use crate::scene::{Material, Triangle};
use num_complex::Complex64;
use std::f64::consts::{FRAC_PI_2, TAU};

const K: f64 = TAU / 0.0245;

/// A point before a half plane whose edge is the z axis, by its angle from the plane.
fn at(radius: f64, angle: f64, z: f64) -> DVec3 {
    DVec3::new(radius * angle.cos(), radius * angle.sin(), z)
}

/// The face of a wedge at an angle.
fn face(angle: f64) -> DVec3 {
    at(1.0, angle, 0.0)
}

fn wave(distance: f64) -> Complex64 {
    Complex64::from_polar(1.0 / distance, K * distance)
}

/// The sum over pieces, of an edge whose far ends fade away.
fn summed(wedge: &Wedge, source: DVec3, r: DVec3, step: f64) -> Complex64 {
    let count = (12.0 / step) as usize;
    let piece = |k: usize| {
        let z = [k as f64, (k + 1) as f64].map(|k| k * step);
        let place = DVec3::Z * (f64::midpoint(z[0], z[1]) - 6.0);
        let fade = ((6.0 - place.z.abs()) / 3.0).clamp(0.0, 1.0);
        let fade = fade * fade * (3.0 - 2.0 * fade);
        let (m, l) = (place.distance(source), place.distance(r));
        Complex64::from_polar(fade * wedge.directivity(z, r) * step / (m * l), K * (m + l))
    };
    (0..count).map(piece).sum()
}

fn wedge_of(faces: [f64; 2], source: DVec3) -> Wedge {
    Wedge::new(-6.0 * DVec3::Z, DVec3::Z, faces.map(face), source).expect("outside")
}

/// The Hankel function of order 1 of the first kind, of a large argument.
fn hankel(z: Complex64) -> Complex64 {
    let terms = [1.0, 3.0 / 8.0, -15.0 / 128.0, 315.0 / 3072.0];
    let i_by_z = Complex64::I / z;
    let series: Complex64 = terms.iter().rev().fold(Complex64::ZERO, |sum, a| sum * i_by_z + a);
    (2.0 / (PI * z)).sqrt() * (Complex64::I * (z - 0.75 * PI)).exp() * series
}

/// Macdonald's half plane: what it diffracts, of the direct wave or of its mirror image. That and all of the wave on its lit
/// side is ik/2 ∫ H₁(kR cosh t) dt from −t₀, cosh t₀ the path by the edge over R.
fn diffracted(straight: f64, by_edge: f64, lit: bool) -> Complex64 {
    let from = (by_edge / straight).max(1.0).acosh();
    // Along a line on which the integrand falls off.
    let (steps, end) = (20_000, 6.0);
    let at = |s: f64| {
        let t = Complex64::new(from + s, FRAC_PI_2 * s.tanh());
        hankel(K * straight * t.cosh()) * Complex64::new(1.0, FRAC_PI_2 / s.cosh().powi(2))
    };
    let h = end / f64::from(steps);
    let simpson = |n: i32| if n == 0 || n == steps { 1.0 } else { 2.0 + 2.0 * f64::from(n % 2) };
    let sum: Complex64 = (0..=steps).map(|n| at(f64::from(n) * h) * simpson(n)).sum();
    Complex64::I * (0.5 * K * h / 3.0) * sum * if lit { -1.0 } else { 1.0 }
}

#[test]
fn a_half_plane_diffracts_as_in_closed_form() {
    for (n, [a, b]) in [
        [0.7, 1.9],
        [1.2, 0.4],
        [0.9, 5.5],
        [2.6, 3.4],
        // Near the border of the shadow and of the reflection, and on them.
        [1.0, 1.0 + PI + 1e-3],
        [1.0, 1.0 + PI - 1e-6],
        [0.8, PI - 0.8 + 1e-4],
        [0.8, PI - 0.8 - 1e-9],
    ]
    .into_iter()
    .enumerate()
    {
        let (height, radii) = (0.1 * n as f64, [1.2, 0.9]);
        let (source, r) = (at(radii[0], a, 0.2), at(radii[1], b, height));
        let by_edge = (radii[0] + radii[1]).hypot(height - 0.2);
        let image = at(radii[0], -a, 0.2);
        let expected = diffracted(r.distance(source), by_edge, (0.5 * (b - a)).cos() > 0.0)
            + diffracted(r.distance(image), by_edge, (0.5 * (b + a)).cos() > 0.0);
        let wedge = wedge_of([0.0, 0.0], source);
        let error = [PIECES, 4.0 * PIECES]
            .map(|pieces| (summed(&wedge, source, r, 0.0245 / pieces) - expected).norm() / expected.norm());
        assert!(error[0] < 2e-2 && error[1] < 2e-3, "{a} {b}: {error:?} of {expected}");
    }
}

#[test]
fn what_bends_closes_the_borders_of_shadow_and_reflection() {
    // A corner of a wall, 270 degrees around the outside, and a sharper one.
    for angle in [1.5 * PI, 1.8 * PI] {
        let source = at(1.0, 0.9, 0.0);
        let wedge = wedge_of([0.0, angle], source);
        let jump = |border: f64| {
            let [lit, dark] =
                [-1e-7, 1e-7].map(|off| summed(&wedge, source, at(0.8, border + off, 0.3), 0.004));
            lit - dark
        };
        for (image, border) in [(source, 0.9 + PI), (at(1.0, -0.9, 0.0), PI - 0.9)] {
            let expected = -wave(image.distance(at(0.8, border, 0.3)));
            let error = (jump(border) - expected).norm() / expected.norm();
            assert!(error < 5e-3, "{angle} {border}: {error}");
        }
        // Speaker and microphone may change places.
        let r = at(0.8, 2.4, 0.3);
        let there = summed(&wedge, source, r, 0.004);
        let back = summed(&wedge_of([0.0, angle], r), r, source, 0.004);
        assert!((there - back).norm() < 1e-9 * there.norm(), "{there} {back}");
        assert!(
            Wedge::new(DVec3::ZERO, DVec3::Z, [0.0, angle].map(face), at(1.0, angle + 0.1, 0.0)).is_none()
        );
        assert_eq!(wedge.directivity([6.0, 6.1], at(1.0, angle + 0.1, 0.0)), 0.0);
    }
    // A flat wall has no edge.
    let flat = wedge_of([0.0, PI + 1e-7], at(1.0, 0.9, 0.0));
    assert!(summed(&flat, at(1.0, 0.9, 0.0), at(0.8, 2.0, 0.3), 0.01).norm() < 1e-6);
}

fn scene(triangles: Vec<[DVec3; 3]>) -> Scene {
    let wall = Material { name: "wall".into(), reflectance: 0.8, transmittance: 0.0, source: "here".into() };
    let triangles = triangles.into_iter().map(|vertices| Triangle { vertices, material: 0 });
    Scene::new(triangles.collect(), vec![wall]).expect("valid")
}

/// The two triangles of a parallelogram.
fn plate(corner: DVec3, [u, v]: [DVec3; 2]) -> [[DVec3; 3]; 2] {
    [[corner, corner + u, corner + u + v], [corner, corner + u + v, corner + v]]
}

fn cube(low: DVec3, side: f64) -> Vec<[DVec3; 3]> {
    let [x, y, z] = DVec3::AXES.map(|axis| axis * side);
    let faces = [(low, [x, y]), (low, [y, z]), (low, [z, x])];
    let far = faces.map(|(corner, [u, v])| (corner + x + y + z - u - v, [u, v]));
    faces.into_iter().chain(far).flat_map(|(corner, sides)| plate(corner, sides)).collect()
}

fn options() -> SurfaceOptions {
    SurfaceOptions::new(0.02, 0.0286)
}

/// The edges' echoes of a scene, and their length, m.
fn echoes(scene: &Scene) -> (Reflectors, f64) {
    let none = Reflectors::default();
    let list =
        append(none, scene, &options(), &EdgeOptions::new(0.0245), &crate::progress::Silent).expect("small");
    let length = list.bounce_counts().expect("edges").edge_length;
    (list, length)
}

#[test]
fn convex_edges_and_rims_are_found_once() {
    let side = 0.25;
    let front = cube(DVec3::new(-0.1, -0.1, 1.0), side);
    assert_eq!(edges_of(&scene(front.clone())).len(), 12, "the diagonals of its faces are no edges");
    // In the middle, the speaker sees the four of the front face.
    let (list, length) = echoes(&scene(front));
    assert!((length - 4.0 * side).abs() < 1e-9, "{length}");
    assert!(list.positions().iter().all(|p| (p.z - 1.0).abs() < 1e-12));
    // A hollow corner has rims alone, and a doubled plate those of a single one.
    let [x, y, z] = DVec3::AXES.map(|axis| axis * 0.5);
    let far = DVec3::new(-0.25, -0.25, 1.5);
    let hollow = [plate(far, [x, y]), plate(far, [x, -z]), plate(far, [y, -z])].concat();
    let hollow = scene(hollow);
    assert_eq!(edges_of(&hollow).iter().filter(|edge| edge.is_rim()).count(), 6);
    assert!((echoes(&hollow).1 - 3.0).abs() < 1e-9);
    let once = plate(far, [x, y]);
    let back = once.map(|[a, b, c]| [a, c, b]);
    for doubled in [once.to_vec(), [once, back].concat()] {
        let (list, length) = echoes(&scene(doubled));
        assert!((length - 2.0).abs() < 1e-9, "{length}");
        assert!(list.amplitudes().iter().all(|a| a.re > 0.0 && a.im == 0.0));
    }
    // Plates that meet without common corners have no rim between them.
    let halves = [plate(far, [x, 0.5 * y]), plate(far + 0.5 * y, [0.5 * x, 0.5 * y])];
    let third = plate(far + 0.5 * y + 0.5 * x, [0.5 * x, 0.5 * y]);
    let (_, length) = echoes(&scene([&halves.concat()[..], &third].concat()));
    assert!((length - 2.0).abs() < 1e-9, "{length}");
}

#[test]
fn a_bent_surface_has_no_edges_and_what_is_hidden_none_either() {
    let corner = |k: i32, y: f64| {
        let angle = f64::from(k) * 0.2;
        DVec3::new(angle.sin(), y, 2.0 - angle.cos())
    };
    let strip = |k: i32| plate(corner(k, -0.5), [corner(k + 1, -0.5) - corner(k, -0.5), DVec3::Y]);
    let bent = scene((-2..2).flat_map(strip).collect());
    let (list, _) = echoes(&bent);
    let inside = |p: &DVec3| p.x.abs() < 0.38 && p.y.abs() < 0.49;
    assert!(!list.positions().iter().any(inside), "11 degrees are no edge");
    let before = plate(DVec3::new(-1.0, -1.0, 0.5), [2.0 * DVec3::X, 2.0 * DVec3::Y]);
    let hidden = scene([cube(DVec3::new(-0.1, -0.1, 1.0), 0.2), before.to_vec()].concat());
    let (list, length) = echoes(&hidden);
    assert!(list.positions().iter().all(|p| p.z == 0.5) && (length - 8.0).abs() < 1e-9);
}
