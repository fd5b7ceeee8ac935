//! Mirrors told from diffuse surfaces.

use super::*;
use crate::depth::gate::flatten;
use crate::depth::power::Power;

/// The depth map of a volume, and whether it is taken for that of mirrors.
fn looks(volume: &Volume, options: &DepthOptions) -> (DepthMap, bool) {
    let (map, looks) = locate_depth_beside(volume.into(), options, &mut || Ok(0.0), &Silent).expect("valid");
    (map, looks.mirrors)
}

#[test]
fn a_mirror_is_told_from_speckle_by_its_phase() {
    let plate = surface(&mut Random::new(1), [0.2, 0.2], |_, _| 1.3, 1.0);
    let mirror = image_in_phase(grid(), &plate, || 1.0);
    assert!(looks(&mirror, &options()).1);
    let camera = Raster::camera(14.0, [30, 30]).expect("valid");
    assert!(looks(&mirror, &options().with_raster(camera)).1);
    for seed in 0..8 {
        let mut random = Random::new(seed);
        for half in [[0.2, 0.2], [0.06, 0.06], [0.01, 0.2]] {
            let points = surface(&mut random, half, |x, _| 1.3 + 0.4 * x, 1.0);
            let volume = image(grid(), &points, &mut random);
            let (map, mirrors) = looks(&volume, &options());
            assert!(!mirrors && map.accepted() > 0, "seed {seed}, {half:?}");
        }
    }
    // Without phases, which a gate needs as well.
    assert!(!looks(&mirror, &options().with_gate(false)).1);
    // A single phase, and an array that resolves nothing along y, tell nothing.
    let point = image(grid(), &[(DVec3::new(0.0, 0.0, 1.3), 1.0)], &mut Random::new(2));
    assert!(!looks(&point, &options()).1);
    let line = Aperture { extent: DVec3::new(1.0, 0.0, 0.0), ..aperture() };
    assert!(!looks(&mirror, &DepthOptions::new(line)).1);
}

#[test]
fn a_glint_is_as_wide_as_what_is_seen_of_it() {
    let axis = |pitch: f64, count| Axis { first: -pitch * (count / 2) as f64, pitch, count };
    let grid = Grid { x: axis(0.005, 61), y: axis(0.01, 41), ..grid() };
    let bar = surface(&mut Random::new(13), [0.004, 0.15], |_, _| 1.3, 1.0);
    // Of 29 rows along the bar.
    let rows = |volume: &Volume| {
        let (map, mirrors) = looks(volume, &options());
        let within = |half: f64| errors(&map, [half, 0.145], |_, _| 1.3).len();
        (mirrors, within(0.0025), within(1.0) as f64 / 29.0)
    };
    let (mirrors, middle, wide) = rows(&image_in_phase(grid, &bar, || 0.0));
    assert!(mirrors && middle >= 22, "{mirrors}, {middle} in the middle");
    let (speckle, _, blurred) = rows(&image(grid, &bar, &mut Random::new(14)));
    assert!(!speckle && wide < 0.9 * blurred, "{speckle}, {wide} pixels wide, {blurred} in speckle");
}

#[test]
fn the_band_is_filled_unevenly_where_columns_differ_in_it_and_not_where_all_lack_a_part() {
    let (grid, aperture) = (grid(), aperture());
    let evenness = |band: &dyn Fn(usize) -> [f64; 2]| {
        let mut samples = vec![Complex32::ZERO; grid.voxel_count() as usize];
        for (i, sample) in samples.iter_mut().enumerate() {
            let (pixel, z) = (i % grid.plane_len(), grid.z.position(i / grid.plane_len()) - 1.3);
            let [low, high] = band(pixel / grid.x.count);
            let turn = TAU * aperture.path_gradient(DVec3::new(0.0, 0.0, 1.3)) * z / aperture.sound_speed;
            let tones = (0..40).map(|k| low + (high - low) * (f64::from(k) + 0.5) / 40.0);
            *sample = tones.map(|f| Complex32::from_polar(0.025, (-turn * f) as f32)).sum();
        }
        let volume = Volume::new(grid, samples);
        let mut power = Power::of(volume.view()).expect("fits");
        flatten(&mut power, volume.view(), &aperture, &options()).expect("fits")
    };
    let whole = evenness(&|_| [10e3, 20e3]);
    let upper = evenness(&|_| [14e3, 20e3]);
    let mixed = evenness(&|row| if row < 12 { [10e3, 13e3] } else { [17e3, 20e3] });
    assert!(whole > 0.8 && upper > 0.6 && mixed < 0.2, "{whole} {upper} {mixed}");
}
