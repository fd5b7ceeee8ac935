//! The literal way, one column at a time.

use super::*;
use crate::grid::DepthLayer;

/// A volume of 5 × 4 columns, each with Gaussian echoes (depth m, amplitude) of width 12 mm.
fn volume(echoes: impl Fn(usize) -> Vec<(f64, f64)>) -> Volume {
    let axis = |first, pitch, count| Axis { first, pitch, count };
    let grid = Grid { x: axis(-0.02, 0.01, 5), y: axis(0.0, 0.01, 4), z: axis(1.0, 0.008, 80) };
    let mut samples = vec![Complex32::ZERO; 5 * 4 * 80];
    for pixel in 0..20 {
        for (iz, z) in grid.z.positions().enumerate() {
            let a: f64 = echoes(pixel)
                .iter()
                .map(|(depth, amplitude)| amplitude * (-((z - depth) / 0.012f64).powi(2)).exp())
                .sum();
            samples[iz * 20 + pixel] = Complex32::from_polar(a as f32, z as f32 * 40.0);
        }
    }
    Volume::new(grid, samples)
}

fn column() -> DepthOptions {
    DepthOptions::new(0.017).with_refine(Refine::Column)
}

#[test]
fn a_peak_is_found_between_voxels() {
    let v = volume(|_| vec![(1.2031, 1.0)]);
    for (refine, tolerance) in [(Refine::Column, 1e-4), (Refine::Parabola, 8e-4), (Refine::None, 4e-3)] {
        let map = locate_depth(&v, &column().with_refine(refine)).expect("valid");
        assert_eq!(map.accepted(), 20);
        for z in &map.picked.depth {
            assert!((f64::from(*z) - 1.2031).abs() <= tolerance, "{refine:?}: {z}");
        }
    }
}

#[test]
fn weak_columns_are_left_out_and_lone_pixels_filtered() {
    let v = volume(|pixel| if pixel % 5 < 3 { vec![(1.2, 1.0)] } else { vec![(1.2, 0.1)] });
    let map = locate_depth(&v, &column()).expect("valid");
    for pixel in 0..20 {
        assert_eq!(map.picked.depth[pixel].is_nan(), pixel % 5 >= 3, "{pixel}");
        assert_eq!(map.confidence[pixel].is_nan(), pixel % 5 >= 3);
    }
    let lone = volume(|pixel| if pixel == 7 { vec![(1.2, 1.0)] } else { vec![] });
    assert_eq!(locate_depth(&lone, &column()).expect("valid").accepted(), 0);
    assert_eq!(locate_depth(&lone, &DepthOptions { median: 1, ..column() }).expect("valid").accepted(), 1);
}

#[test]
fn no_depth_is_between_two_surfaces() {
    // Rows of two depths in turn: a square of 2 x 3 pixels at the rim has as many of each.
    let v = volume(|pixel| vec![(if pixel / 5 % 2 == 0 { 1.2 } else { 1.4 }, 1.0)]);
    let map = locate_depth(&v, &column()).expect("valid");
    for z in map.picked.depth.iter().filter(|z| !z.is_nan()) {
        assert!((z - 1.2).abs() < 1e-3 || (z - 1.4).abs() < 1e-3, "{z}");
    }
    assert!(map.accepted() > 10);
}

#[test]
fn below_the_floor_there_is_nothing() {
    let v = volume(|pixel| vec![(1.2, if pixel % 5 < 3 { 1.0 } else { 0.5 })]);
    for options in [column(), DepthOptions::new(0.017)] {
        let accepted = |floor: f64| {
            locate_depth(&v, &DepthOptions { floor, ..options.clone() }).expect("valid").accepted()
        };
        assert_eq!((accepted(0.3), accepted(1.1)), (20, 0), "{:?}", options.refine);
    }
}

#[test]
fn the_first_peak_is_in_front_of_the_strongest() {
    let v = volume(|_| vec![(1.15, 0.5), (1.40, 1.0)]);
    for (pick, expected) in [(Pick::First, 1.15), (Pick::Strongest, 1.40)] {
        let map = locate_depth(&v, &column().with_pick(pick)).expect("valid");
        assert!((f64::from(map.picked.depth[8]) - expected).abs() < 1e-3, "{pick:?}");
    }
}

/// Depths of the returns of a pixel.
fn returns(echoes: &[(f64, f64)], options: &DepthOptions) -> Vec<DepthLayer> {
    locate_depth(&volume(|_| echoes.to_vec()), options).expect("valid").returns
}

#[test]
fn several_surfaces_come_back_in_order_with_their_strengths() {
    let surfaces = returns(&[(1.40, 1.0), (1.15, 0.5)], &column());
    for (surface, expected) in surfaces.iter().zip([1.15, 1.40]) {
        for z in &surface.depth {
            assert!((f64::from(*z) - expected).abs() < 5e-4, "{z}");
        }
    }
    let ratio = surfaces[0].strength[10] / surfaces[1].strength[10];
    assert!((ratio - 0.5).abs() < 0.01, "{ratio}");
    let levels = [0, 1].map(|k: usize| surfaces[k].confidence.as_ref().expect("of every return")[10]);
    // Half the amplitude is 6 dB less against the reference; both are as clear against the column as counts.
    assert!((levels[1] - levels[0] - 6.02).abs() < 0.3, "{levels:?}");
    let three = [(1.1, 0.6), (1.25, 1.0), (1.45, 0.5)];
    for (count, expected) in [(3, vec![1.1, 1.25, 1.45]), (2, vec![1.1, 1.25])] {
        let surfaces = returns(&three, &DepthOptions { returns: count, ..column() });
        assert_eq!(surfaces.len(), count);
        for (surface, expected) in surfaces.iter().zip(expected) {
            assert!((f64::from(surface.depth[10]) - expected).abs() < 5e-4, "{count}: {surface:?}");
        }
    }
}

#[test]
fn two_crests_of_one_slope_and_a_crest_on_a_long_pedestal_are_no_further_return() {
    let options = column();
    let plain = DepthOptions { return_contrast_db: 0.0, ..options.clone() };
    // A wall 60 mm deep in the pixel: crests at both ends, and 3 dB less between them.
    let slope = [(1.20, 1.0), (1.212, 0.7), (1.224, 0.6), (1.236, 0.6), (1.248, 0.8), (1.26, 0.9)];
    // What an alias leaves: 150 mm of power, with one crest a little higher than the rest.
    let mut pedestal: Vec<(f64, f64)> = (0..15).map(|i| (1.30 + 0.01 * f64::from(i), 0.25)).collect();
    pedestal.extend([(1.15, 1.0), (1.37, 0.2)]);
    for echoes in [&slope[..], &pedestal] {
        let second = |options| returns(echoes, options)[1].depth[10];
        assert!(second(&options).is_nan(), "{}", second(&options));
        assert!(!second(&plain).is_nan(), "without a crest to refuse, the test proves nothing");
    }
}

#[test]
fn a_weak_or_near_second_peak_is_not_a_surface() {
    for echoes in [[(1.2, 1.0), (1.4, 0.1)], [(1.2, 1.0), (1.22, 0.9)]] {
        let surfaces = returns(&echoes, &column());
        assert!(surfaces[0].depth.iter().all(|z| !z.is_nan()));
        assert!(surfaces[1].depth.iter().all(|z| z.is_nan()), "{echoes:?}");
    }
}
