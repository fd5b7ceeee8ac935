//! The parts of the search, each against its definition.

use super::*;
use crate::depth::gate::flatten;
use crate::depth::power::Power;

#[test]
fn smoothing_equals_the_literal_sums_at_every_voxel() {
    let axis = |pitch, count| Axis { first: 1.0, pitch, count };
    for [n_x, n_y, n_z] in [[9, 4, 11], [1, 6, 11], [7, 1, 8], [1, 1, 13], [5, 3, 1]] {
        let grid = Grid { x: axis(0.02, n_x), y: axis(0.015, n_y), z: axis(0.008, n_z) };
        let values: Vec<f32> = (0..n_x * n_y * n_z).map(|i| (i as f32 * 0.618_034).fract()).collect();
        let across = |iz: usize| [0.5 + 0.1 * iz as f64, 1.3 - 0.05 * iz as f64];
        let smoothed = Power { grid, values: values.clone() }.smoothed(across, 1.4).expect("fits").values;
        let weight = |a: usize, b: usize, sigma: f64| {
            let apart = a.abs_diff(b) as f64;
            if apart <= (4.0 * sigma).ceil() { (-0.5 * (apart / sigma).powi(2)).exp() } else { 0.0 }
        };
        for (i, got) in smoothed.iter().enumerate() {
            let at = |i: usize| [i / n_z % n_x, i / (n_z * n_x), i % n_z];
            let [x, y, z] = at(i);
            // The sums along z are of sums across, each with the weights of its own depth.
            let (mut sum, mut all) = (0.0, 0.0);
            for depth in 0..n_z {
                let sigma = across(depth);
                let (mut part, mut weights) = (0.0, 0.0);
                for (j, value) in values.iter().enumerate().filter(|(j, _)| at(*j)[2] == depth) {
                    let w = weight(x, at(j)[0], sigma[0]) * weight(y, at(j)[1], sigma[1]);
                    (part, weights) = (part + w * f64::from(*value), weights + w);
                }
                let w = weight(z, depth, 1.4);
                (sum, all) = (sum + w * part / weights, all + w);
            }
            assert!((f64::from(*got) - sum / all).abs() < 1e-5, "voxel {i}: {got}, not {}", sum / all);
        }
    }
}

/// The gate of each voxel by its definition: the least over the mean of the powers of three parts of the band.
fn literal_gate(volume: &Volume, pixel: usize, iz: usize) -> f64 {
    let (grid, aperture) = (volume.grid, aperture());
    let (plane, n_z) = (grid.plane_len(), grid.z.count as isize);
    let p = grid.position(pixel % grid.x.count, pixel / grid.x.count, iz);
    let reach = (3.0 * 0.01715 / grid.z.pitch).floor() as isize;
    let powers = [-1.0, 0.0, 1.0].map(|part: f64| {
        let frequency = 15e3 + part * 10e3 / 3.0;
        let turn = TAU * frequency * aperture.path_gradient(p) * grid.z.pitch / 343.0;
        let mut sum = num_complex::Complex64::ZERO;
        for t in -reach..=reach {
            let at = iz as isize + t;
            if (0..n_z).contains(&at) {
                let a = volume.samples[at as usize * plane + pixel];
                let w = 0.5 + 0.5 * (std::f64::consts::PI * t as f64 * grid.z.pitch / (3.0 * 0.01715)).cos();
                sum += num_complex::Complex64::new(a.re.into(), a.im.into())
                    * num_complex::Complex64::from_polar(w, turn * t as f64);
            }
        }
        sum.norm_sqr()
    });
    3.0 * powers.iter().copied().fold(f64::MAX, f64::min) / powers.iter().sum::<f64>()
}

#[test]
fn the_gate_is_the_least_part_of_the_band_over_the_mean() {
    // Columns far apart, whose parts are not averaged with those beside them, and depths a resolution cell apart.
    let axis = |pitch, count| Axis { first: -0.2, pitch, count };
    let z = Axis { first: 1.2, pitch: 0.01715, count: 40 };
    let grid = Grid { x: axis(1.0, 19), y: axis(1.0, 2), z };
    let mut random = Random::new(9);
    let samples = (0..grid.voxel_count()).map(|_| random.normal()).collect();
    let volume = Volume::new(grid, samples);
    let mut power = Power { grid, values: vec![1.0; grid.voxel_count() as usize] };
    flatten(&mut power, volume.view(), &aperture(), &options()).expect("fits");
    let mut off = Vec::new();
    for pixel in [0, 7, 20, 37] {
        let literal: Vec<f64> = (0..40).map(|iz| literal_gate(&volume, pixel, iz)).collect();
        for (got, literal) in power.column(pixel).iter().zip(literal).skip(1).take(38) {
            let got = f64::from(*got);
            off.push((got - literal).abs());
            assert!((0.0..=1.0001).contains(&got), "{got}");
        }
    }
    // The mean of neighbouring steps along z, of σ half a step, is part of the gate and not of the literal one.
    assert!(median(off.clone()) < 0.12, "{}", median(off));
}

#[test]
fn an_alias_is_gated_and_a_surface_is_not() {
    let grid = grid();
    let aperture = aperture();
    let p = DVec3::new(0.0, 0.0, 1.3);
    let plane = grid.plane_len();
    let pixel = 12 * grid.x.count + 12;
    // All frequencies of the band, or the upper fifth of it, as a grating lobe has.
    let echo = |band: [f64; 2]| {
        let mut samples = vec![Complex32::ZERO; grid.voxel_count() as usize];
        for (i, sample) in samples.iter_mut().enumerate() {
            let z = grid.z.position(i / plane) - p.z;
            let tones = (0..40).map(|k| band[0] + (band[1] - band[0]) * (f64::from(k) + 0.5) / 40.0);
            let turn = TAU * aperture.path_gradient(p) * z / aperture.sound_speed;
            *sample = tones.map(|f| Complex32::from_polar(0.025, (-turn * f) as f32)).sum();
        }
        let volume = Volume::new(grid, samples);
        let mut power = Power::of(volume.view()).expect("fits");
        let before = power.column(pixel)[25];
        flatten(&mut power, volume.view(), &aperture, &options()).expect("fits");
        power.column(pixel)[25] / before
    };
    let (surface, alias) = (echo([10e3, 20e3]), echo([18e3, 20e3]));
    assert!(surface > 0.7 && alias < 0.1, "{surface} {alias}");
}

#[test]
fn without_an_aperture_nothing_is_gated() {
    let mut random = Random::new(4);
    let volume = image(grid(), &surface(&mut random, [0.2, 0.2], |_, _| 1.3, 1.0), &mut random);
    let bare = locate_depth(&volume, &DepthOptions::new(0.01715)).expect("valid");
    let open = locate_depth(&volume, &DepthOptions::new(0.01715).with_gate(false)).expect("valid");
    // NaN, where nothing is found, equals nothing.
    let bits = |map: &DepthMap| map.picked.depth.iter().map(|z| z.to_bits()).collect::<Vec<u32>>();
    assert_eq!(bits(&bare), bits(&open));
    assert!(bare.accepted() > 300);
}
