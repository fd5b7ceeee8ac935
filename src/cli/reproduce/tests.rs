use super::*;

#[test]
fn the_scene_is_two_lines_of_one_pixel_that_cross() {
    let truth = scene::truth();
    assert_eq!(truth.iter().filter(|a| **a > 0.0).count(), 197);
    assert!((scene::truth_rms() - 0.1404).abs() < 5e-5);
    let reflectors = scene::reflectors().expect("finite");
    assert!(reflectors.positions().iter().any(|p| p.distance(scene::CROSSING) < 1e-9));
}

#[test]
fn least_squares_is_the_best_of_all_scales() {
    let (image, truth) = ([0.5f32, 1.0, 0.0, 3.0], [0.0f32, 1.0, 0.0, 1.0]);
    let best = least_squares(&image, &truth);
    for i in 0..200 {
        let scaled = image.map(|a| a * i as f32 / 100.0);
        assert!(rmse(&scaled, &truth) >= best - 1e-9);
    }
    assert!(rmse(&image.map(|a| a * 4.0 / 10.25), &truth) - best < 1e-7);
}

#[test]
fn the_transform_of_one_far_echo_peaks_at_its_pixel() {
    let p = glam::DVec3::new(0.6, 0.0, 4.0);
    let point = crate::reflectors::Reflectors::new(vec![p], vec![Complex32::ONE]).expect("finite");
    let cube = scene::cube_of(&point, &CASES[0], Linear).expect("small");
    let image = fourier::image(&cube);
    let best = (0..image.len()).max_by(|a, b| image[*a].total_cmp(&image[*b])).expect("pixels");
    let found = scene::grid().position(best % scene::PIXELS, 0, best / scene::PIXELS);
    // Half of a real signal is lost to the negative frequencies; a bin is .034 in sin θ and 8.6 cm in range.
    assert!((0.3..0.51).contains(&image[best]), "{}", image[best]);
    assert!((found.length() - p.length()).abs() < 0.06, "{found}");
    assert!((found.x / found.length() - p.x / p.length()).abs() < 0.025, "{found}");
}

#[test]
fn scaling_the_angle_with_frequency_is_what_equation_9_lacks() {
    // Half an octave of band: the plain transform has its angle right in the middle of it alone.
    let (case, truth) = (CASES[3], scene::truth());
    let cube = scene::cube(&case, Linear).expect("small");
    let options = ReconstructOptions::new(Method::Linear, Window::None);
    let scaled = reconstruct(&cube, &scene::grid(), &options).expect("planar");
    let scaled = least_squares(&amplitudes(&scaled.volume.samples), &truth);
    let plain = least_squares(&fourier::image(&cube), &truth);
    assert!(scaled < 0.75 * plain, "{scaled} against {plain}");
}
