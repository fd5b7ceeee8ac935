//! Voxels between nodes against the literal terms of Eq. 13.

use super::*;
use crate::acquisition::{Detection, MicArray, Sweep};
use crate::grid::Axis;
use crate::wave::phasor;

fn fraction(i: usize, k: f64) -> f64 {
    (i as f64 * k).fract() - 0.5
}

fn setup<'a>(sweep: &'a Sweep, array: &'a MicArray, geometry: Geometry) -> Setup<'a> {
    Setup { sweep, array, geometry, detection: Detection::Quadrature, sound_speed: 343.0 }
}

/// Any term at any voxel errs by no more than the measured error, f32 rounding aside.
#[test]
fn voxels_between_nodes_are_the_literal_terms() {
    let place = |i: usize| {
        DVec3::new(0.4 * fraction(i, 0.618_034), 0.3 * fraction(i, 0.754_878), 0.05 * fraction(i, 0.569_84))
    };
    let array = MicArray::from_positions("array", &[50], (0..50).map(place).collect()).expect("valid");
    let sweep = Sweep::stepped("f", 8_000.0, 16_000.0, 100.0).expect("valid");
    let axis = |first: f64, pitch: f64, count: usize| Axis { first, pitch, count };
    let grid = Grid { x: axis(-0.2, 0.004, 70), y: axis(-0.1, 0.005, 61), z: axis(0.5, 0.03, 2) };
    for geometry in [Geometry::ORIGIN, Geometry::Monostatic] {
        let setup = setup(&sweep, &array, geometry);
        for tolerance in [1e-2, 1e-4] {
            let lattice = Lattice::find(&setup, &grid, tolerance).expect("fine voxels");
            let nodes = lattice.grid(&grid);
            assert!(nodes.plane_len() < grid.plane_len());
            let interpolation = lattice.interpolation(&grid, tolerance).expect("within its share");
            for (i, r) in array.positions().iter().enumerate().step_by(3) {
                let f = [8_000.0, 16_000.0, 12_345.0][i % 3];
                let z = grid.z.position(i % 2);
                let plane = |grid: &Grid| -> Vec<Complex32> {
                    let point = |k: usize| {
                        let (x, y) = (grid.x.position(k % grid.x.count), grid.y.position(k / grid.x.count));
                        DVec3::new(x, y, z)
                    };
                    let term = |k| phasor(-f / 343.0 * geometry.path_length(point(k), *r));
                    (0..grid.plane_len()).map(term).collect()
                };
                let (expected, mut got) = (plane(&grid), vec![Complex32::ZERO; grid.plane_len()]);
                interpolation.plane(&mut plane(&nodes), &grid, z, &mut got);
                for (got, expected) in got.iter().zip(&expected) {
                    let error = f64::from((got - expected).norm());
                    assert!(error <= interpolation.error + 5e-6, "{error:e} above {:e}", interpolation.error);
                }
            }
        }
    }
}

#[test]
fn coarse_voxels_and_those_on_microphones_stay_as_they_are() {
    let array = MicArray::rectangular("array", [8, 8], [0.03; 2], DVec3::ZERO).expect("valid");
    let sweep = Sweep::stepped("f", 8_000.0, 16_000.0, 100.0).expect("valid");
    let setup = setup(&sweep, &array, Geometry::ORIGIN);
    let grid = |pitch: f64, z: f64| {
        let axis = Axis { first: -0.2, pitch, count: 64 };
        Grid { x: axis, y: axis, z: Axis { first: z, pitch: 0.01, count: 4 } }
    };
    assert!(Lattice::find(&setup, &grid(0.004, 0.5), 1e-4).is_some());
    assert!(Lattice::find(&setup, &grid(0.05, 0.5), 1e-4).is_none());
    assert!(Lattice::find(&setup, &grid(0.004, 0.0), 1e-4).is_none());
}
