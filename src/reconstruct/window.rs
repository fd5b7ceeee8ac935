//! Window weights over the array and the band.

mod weights;

pub(super) use weights::Weights;

use crate::acquisition::{MicArray, Sweep};
use crate::choice::choice;
use std::f64::consts::PI;

choice! {
    /// Weights that trade resolution for sidelobes, per axis, at t ∈ (−½, ½) across the aperture.
    #[derive(Default)]
    pub enum Window: "window" {
        /// All weights 1.
        None = "none",
        /// `cos²(πt)`.
        Hann = "hann",
        /// Taylor's, n̄ = 4, −30 dB sidelobes.
        #[default]
        Taylor = "taylor",
    }
}

/// n̄ of the Taylor window.
const NBAR: usize = 4;
/// Its sidelobe level, dB below the peak.
const SIDELOBES_DB: f64 = 30.0;

impl Window {
    /// The weight at t: for sample n of N, `t = (n − (N−1)/2)/N`.
    pub fn weight(self, t: f64) -> f64 {
        match self {
            Self::None => 1.0,
            Self::Hann => (PI * t).cos().powi(2),
            Self::Taylor => {
                let sum: f64 = taylor_coefficients()
                    .iter()
                    .enumerate()
                    .map(|(m, f)| f * (2.0 * PI * (m + 1) as f64 * t).cos())
                    .sum();
                1.0 + 2.0 * sum
            }
        }
    }

    /// One weight per frequency; an uneven list is weighted by the place in the band.
    pub fn over_sweep(self, sweep: &Sweep) -> Vec<f64> {
        let n = sweep.len() as f64;
        let place = |f: f64| centred(f, sweep.centre(), sweep.bandwidth(), n);
        sweep.frequencies().iter().map(|&f| self.weight(place(f))).collect()
    }

    /// One weight per microphone, the product of those over x and y; scattered arrays count as `√n_mic` a side.
    pub fn over_array(self, array: &MicArray) -> Vec<f64> {
        let (centre, extent) = (array.centre(), array.extent());
        let side = (array.len() as f64).sqrt();
        let [n_x, n_y] = array.lattice().map_or([side; 2], |l| [l.x.count as f64, l.y.count as f64]);
        array
            .positions()
            .iter()
            .map(|r| {
                self.weight(centred(r.x, centre.x, extent.x, n_x))
                    * self.weight(centred(r.y, centre.y, extent.y, n_y))
            })
            .collect()
    }
}

/// `t = (x − centre)/extent · (N−1)/N`; 0, of weight 1, where there is no extent.
fn centred(x: f64, centre: f64, extent: f64, n: f64) -> f64 {
    if extent > 0.0 { (x - centre) / extent * (n - 1.0) / n } else { 0.0 }
}

/// The coefficients `F_m` of Taylor's window, m = 1 … n̄ − 1 (Carrara, Goodman & Majewski 1995; SciPy's definition).
fn taylor_coefficients() -> [f64; NBAR - 1] {
    let a = 10f64.powf(SIDELOBES_DB / 20.0).acosh() / PI;
    let s2 = (NBAR as f64).powi(2) / (a * a + (NBAR as f64 - 0.5).powi(2));
    std::array::from_fn(|i| {
        let m2 = ((i + 1) as f64).powi(2);
        let sign = if i % 2 == 0 { 1.0 } else { -1.0 };
        let numerator: f64 = (1..NBAR).map(|k| 1.0 - m2 / s2 / (a * a + (k as f64 - 0.5).powi(2))).product();
        let denominator: f64 =
            (1..NBAR).filter(|k| *k != i + 1).map(|k| 1.0 - m2 / (k as f64).powi(2)).product();
        sign * numerator / (2.0 * denominator)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;

    #[test]
    fn taylor_is_scipys() {
        // scipy.signal.windows.taylor(8, nbar=4, sll=30), which divides by the value at the centre.
        let scipy = [0.279_346_30, 0.514_959_90, 0.797_301_53, 0.975_610_72];
        let centre = Window::Taylor.weight(0.0);
        for n in 0..8 {
            let w = Window::Taylor.weight((n as f64 - 3.5) / 8.0) / centre;
            let expected = scipy[n.min(7 - n)];
            assert!((w - expected).abs() < 1e-7, "{n}: {w} against {expected}");
        }
    }

    #[test]
    fn one_sample_has_weight_one() {
        let one = Sweep::from_frequencies(vec![1000.0]).expect("one");
        assert_eq!(Window::Hann.over_sweep(&one), [1.0]);
        let mic = MicArray::rectangular([1, 1], [0.1, 0.1], DVec3::ZERO).expect("one");
        assert_eq!(Window::Hann.over_array(&mic), [1.0]);
    }

    #[test]
    fn lattice_weights_follow_their_definition() {
        let array = MicArray::rectangular([4, 3], [0.1, 0.2], DVec3::new(1.0, 2.0, 0.0)).expect("ok");
        let weights = Window::Hann.over_array(&array);
        for (i, w) in weights.iter().enumerate() {
            let t = |n: usize, count: usize| (n as f64 - (count - 1) as f64 / 2.0) / count as f64;
            let exact = (PI * t(i % 4, 4)).cos().powi(2) * (PI * t(i / 4, 3)).cos().powi(2);
            assert!((w - exact).abs() < 1e-12);
        }
    }
}
