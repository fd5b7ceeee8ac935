//! Directivity of a loudspeaker or microphone: a circular piston in a baffle, in the far field.

use libm::j1;

/// Up to this x the function is 1 to the last bit, and J₁ of the smallest numbers loses precision.
const TINY: f64 = 1e-8;

/// `2 J₁(x)/x`, the amplitude of a piston relative to its axis, for `x = 2πf/c · radius · sin θ`; 1 at 0, even in x, 0 at infinity.
///
/// A piston is a superposition of delays within `± radius · sin θ / c`: `(2/π) ∫₀^π cos(x cos t) sin² t dt`. The error is
/// below 10⁻¹⁵. Cost: two quotients of polynomials, and beyond x = 2 also a sine and a cosine.
pub(crate) fn piston(x: f64) -> f64 {
    if x.abs() < TINY { 1.0 } else { 2.0 * j1(x) / x }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_is_the_published_bessel_function() {
        // J₁ from Abramowitz and Stegun, table 9.1.
        for (x, j1) in [
            (0.1, 0.049_937_526),
            (1.0, 0.440_050_585_7),
            (2.0, 0.576_724_807_8),
            (5.0, -0.327_579_137_6),
            (10.0, 0.043_472_746_2),
            (15.0, 0.205_104_038_6),
        ] {
            assert!((0.5 * x * piston(x) - j1).abs() < 1e-10, "{x}: {}", piston(x));
        }
        assert_eq!(piston(0.0), 1.0);
        assert_eq!(piston(-3.0), piston(3.0));
    }

    #[test]
    fn the_first_zero_and_the_half_power_angle() {
        assert!(piston(3.831_705_970_2).abs() < 1e-10);
        assert!((piston(1.616_340_0) - 0.5f64.sqrt()).abs() < 1e-6);
    }

    #[test]
    fn it_solves_bessels_equation() {
        for x in [0.5, 1.9999, 2.0001, 7.9999, 8.0001, 30.0, 400.0] {
            // For y = 2 J₁(x)/x: x y'' + 3 y' + x y = 0.
            let h = 1e-4;
            let (less, here, more) = (piston(x - h), piston(x), piston(x + h));
            let (slope, bend) = ((more - less) / (2.0 * h), (more - 2.0 * here + less) / (h * h));
            assert!((x * bend + 3.0 * slope + x * here).abs() < 1e-6 * x, "{x}");
        }
    }

    #[test]
    fn it_falls_off_as_1_minus_x2_over_8_from_exactly_1() {
        for x in [0.0, 5e-324, 1e-300, 1e-9, TINY, 2.0 * TINY, 1e-5, 1e-3] {
            assert!((piston(x) - (1.0 - x * x / 8.0)).abs() < 1e-14, "{x:e}: {:e}", piston(x) - 1.0);
        }
    }

    #[test]
    fn huge_arguments_stay_below_the_amplitude_on_the_axis() {
        for x in [1e7, f64::INFINITY, f64::MAX] {
            assert!(piston(x).abs() < 1.0, "{x}");
        }
    }
}
