//! A run that resumes gives the depths that are left bit-identical to those of a whole run, by every method.

#![allow(clippy::unwrap_used)]

use super::*;
use crate::acquisition::{Instrument, MicArray, Sweep};
use crate::grid::Axis;
use crate::progress::Silent;
use crate::reconstruct::volume::ResumedVolume;
use crate::wave::{Geometry, phasor};
use glam::DVec3;

#[test]
fn resumed_depths_are_bit_identical_by_every_method() {
    let axis = |first, pitch, count| Axis { first, pitch, count };
    let grid = Grid { x: axis(-0.15, 0.03, 11), y: axis(-0.1, 0.03, 9), z: axis(0.6, 0.01, 70) };
    let array = MicArray::rectangular([6, 5], [0.03; 2], DVec3::ZERO).unwrap();
    let sweep = Sweep::stepped(8_000.0, 14_000.0, 200.0).unwrap();
    let point = grid.position(3, 5, 40);
    let path = |r: &DVec3| Geometry::ORIGIN.path_length(point, *r);
    let echo = |f: &f64| array.positions().iter().map(|r| phasor(f / 343.0 * path(r))).collect::<Vec<_>>();
    let samples = sweep.frequencies().iter().flat_map(echo).collect();
    let cube = DataCube::new(Instrument::new(sweep.clone(), array.clone()), samples).unwrap();
    for (method, tolerance) in [
        (Method::Direct, 1e-4),
        (Method::Linear, 1e-4),
        (Method::Convolution, 0.0),
        (Method::Convolution, 1e-4),
        (Method::Backprojection, 1e-4),
    ] {
        let options = ReconstructOptions {
            tolerance,
            compensate: true,
            ..ReconstructOptions::new(method, Window::Hann)
        };
        let whole = reconstruct(&cube, &grid, &options).unwrap();
        assert!(whole.volume.peak() > 0.5, "{method:?} shows the point");
        for done in [0, 1, 31, 32, 50, 69, 70] {
            let mut rest = ResumedVolume { volume: Volume { grid, samples: Vec::new() }, done };
            let info = reconstruct_into(&mut &cube, &grid, &options, &mut rest, &Silent).unwrap();
            assert_eq!(info, whole.info());
            let from = done * grid.plane_len();
            let same = rest.volume.samples.get(from..).unwrap_or_default() == &whole.volume.samples[from..];
            assert!(same, "{method:?} to within {tolerance:e}, from depth {done}");
        }
    }
}
