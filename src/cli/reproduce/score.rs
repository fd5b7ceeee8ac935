//! Root mean square errors against the true picture.
//!
//! The paper states its errors in "arbitrary units". Its numbers fit if the Fourier images have the scale of a transform
//! divided by the number of samples, and NL-NL is divided by its maximum. This favours NL-NL: L-L and NL-NL at x = 0.5 m are
//! nearly the same matched filter, and score equally with equal scaling.

/// `√mean (I − T)²`.
pub(super) fn rmse(image: &[f32], truth: &[f32]) -> f64 {
    scaled_rmse(image, truth, 1.0)
}

/// The minimum RMSE over all factors on the image, at `s = Σ I·T / Σ I²`.
pub(super) fn least_squares(image: &[f32], truth: &[f32]) -> f64 {
    let product: f64 = image.iter().zip(truth).map(|(i, t)| f64::from(*i) * f64::from(*t)).sum();
    let square: f64 = image.iter().map(|i| f64::from(*i).powi(2)).sum();
    scaled_rmse(image, truth, if square > 0.0 { product / square } else { 0.0 })
}

fn scaled_rmse(image: &[f32], truth: &[f32], scale: f64) -> f64 {
    let sum: f64 =
        image.iter().zip(truth).map(|(i, t)| (scale * f64::from(*i) - f64::from(*t)).powi(2)).sum();
    (sum / image.len() as f64).sqrt()
}
