//! How a rough wall divides the sound that it reflects between a mirror image and diffuse scatter, without loss.
//!
//! The mirror image keeps the share `c = exp(−2 (kσ cos θ)²)` of the amplitude (Beckmann & Spizzichino 1963), so `R = c²` of the
//! energy. The rest is scattered by the coupled model of Shirley, Smits, Hu and Lafortune (1997),
//!
//! `f(θ_i, θ_s) = (1 − R(θ_i)) (1 − R(θ_s)) / (π (1 − R̄))`, `R̄ = 2 ∫ R(μ) μ dμ = (1 − e^{−β})/β`, `β = (2kσ)²`,
//!
//! the only product of a function of either angle that scatters all of 1 − R(θ_i). It is Lambert's 1/π for a wall without
//! a mirror image. A patch of area a scatters the amplitude `√(a cos θ_i cos θ_s f)` of what arrives, in m: at a
//! distance of d m that over d.

use std::f64::consts::PI;

/// A wall of one roughness; without a mirror image if that is infinite.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Roughness {
    /// (2kσ)².
    beta: f64,
}

impl Roughness {
    /// No mirror image.
    pub(super) const DIFFUSE: Self = Self { beta: f64::INFINITY };

    /// Of rms height `sigma` m, for a wavelength in m.
    pub(super) fn new(sigma: f64, wavelength: f64) -> Self {
        Self { beta: (4.0 * PI * sigma / wavelength).powi(2) }
    }

    /// Whether there is a mirror image.
    pub(super) fn mirrors(self) -> bool {
        self.beta.is_finite()
    }

    /// The share of the amplitude in the mirror image, for the cosine of the angle of incidence.
    pub(super) fn coherent(self, cosine: f64) -> f64 {
        if self.mirrors() { (-0.5 * self.beta * cosine * cosine).exp() } else { 0.0 }
    }

    /// `√(μ_i μ_s f)` for the cosines of incidence and scatter; 0 where either is not positive.
    pub(super) fn diffuse(self, [incident, scattered]: [f64; 2]) -> f64 {
        if incident <= 0.0 || scattered <= 0.0 || self.beta == 0.0 {
            return 0.0;
        }
        let lambert = incident * scattered / PI;
        if !self.mirrors() {
            return lambert.sqrt();
        }
        let rest = |cosine: f64| -(-self.beta * cosine * cosine).exp_m1();
        (lambert * rest(incident) * rest(scattered) / self.mean_rest()).sqrt()
    }

    /// 1 − R̄.
    fn mean_rest(self) -> f64 {
        let beta = self.beta;
        // The difference cancels for smooth walls.
        if beta < 1e-4 { beta * (0.5 - beta / 6.0) } else { 1.0 + (-beta).exp_m1() / beta }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The energy scattered into the half space, by integration over its directions.
    fn scattered(wall: Roughness, incident: f64) -> f64 {
        let n = 20_000;
        let ring = |i: i32| {
            let mu = (f64::from(i) + 0.5) / f64::from(n);
            // √(μ_i μ_s f) squared is the radiant intensity of what arrives on unit area; that is μ_i.
            wall.diffuse([incident, mu]).powi(2) / incident * 2.0 * PI / f64::from(n)
        };
        (0..n).map(ring).sum()
    }

    #[test]
    fn mirror_image_and_scatter_are_all_of_the_energy() {
        for wall in [0.25, 0.125, 0.0625, 1e-3, 1e-5].map(|sigma| Roughness::new(sigma, 1.0)) {
            for incident in [0.05, 0.3, 0.577, 0.9, 1.0] {
                let all = wall.coherent(incident).powi(2) + scattered(wall, incident);
                assert!((all - 1.0).abs() < 1e-6, "{wall:?} {incident}: {all}");
            }
        }
        assert!((scattered(Roughness::DIFFUSE, 0.4) - 1.0).abs() < 1e-6);
        assert_eq!(Roughness::DIFFUSE.coherent(0.0), 0.0);
    }

    #[test]
    fn scatter_is_reciprocal_and_one_sided() {
        for wall in [Roughness::DIFFUSE, Roughness::new(0.1, 1.0)] {
            assert_eq!(wall.diffuse([0.3, 0.8]), wall.diffuse([0.8, 0.3]));
            assert_eq!(wall.diffuse([0.3, -0.8]), 0.0);
        }
        let lambert = Roughness::DIFFUSE.diffuse([0.5, 0.25]);
        assert!((lambert - (0.125 / PI).sqrt()).abs() < 1e-15);
        // Of λ/8 and 54.7 degrees: exp(−2 (π/4 · 0.577)²).
        assert!((Roughness::new(0.125, 1.0).coherent(3.0f64.sqrt().recip()) - 0.662_83).abs() < 1e-4);
        assert_eq!(Roughness::new(0.0, 1.0).diffuse([0.5, 0.5]), 0.0);
        assert_eq!(Roughness::new(0.0, 1.0).coherent(0.5), 1.0);
    }
}
