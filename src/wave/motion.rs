//! A scene that moves at a constant velocity while the tones are played one after another.
//!
//! Tone n is played at `t_n = start + n·dwell`, and what was at p is then at `p + v t_n`: the path is that of the place there, which is
//! also the path from p where speaker and microphones are displaced by `−v t_n`. Within a tone nothing moves.
//!
//! To first order the path grows as `σ t`, `σ = v·∇path`, and with even steps δf the phase is that of a place displaced by
//! `v τ`, `τ = f_c·dwell/δf + t_c` (f_c and t_c of the middle of the sweep), but for `m² δf·dwell·σ/c` cycles at the m-th tone from
//! the middle, which no place has: the image is displaced, and then blurred.

use super::corners;
use glam::DVec3;
use std::f64::consts::TAU;

/// A velocity, and the times of the tones.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Motion {
    /// v, m/s.
    pub velocity: DVec3,
    /// From one tone to the next, s.
    pub dwell: f64,
    /// When the first of the tones is played, s: until then everything is where it is said to be.
    pub start: f64,
}

/// The fastest that is a motion between tones, m/s.
pub const FASTEST: f64 = 1e4;

/// The longest time from one tone to the next, s.
pub(crate) const LONGEST_DWELL: f64 = 1e4;

impl Motion {
    /// One that begins with the first tone.
    pub fn new(velocity: DVec3, dwell: f64) -> Self {
        Self { velocity, dwell, start: 0.0 }
    }

    /// Whether velocity and times are in range.
    pub(crate) fn is_valid(&self) -> bool {
        self.velocity.is_finite()
            && self.velocity.abs().max_element() <= FASTEST
            && (0.0..=LONGEST_DWELL).contains(&self.dwell)
            && self.start.is_finite()
    }

    /// When the tone is played that is `n` after the first, s; `n` may be between two.
    pub fn time(&self, n: f64) -> f64 {
        self.start + n * self.dwell
    }

    /// How far everything has moved by then, m.
    pub fn displacement(&self, n: f64) -> DVec3 {
        self.velocity * self.time(n)
    }

    /// τ, s: an image that takes it for still shows what moves displaced by `v τ`, of evenly spaced tones in the band, Hz.
    pub fn lag(&self, [start, stop]: [f64; 2], step: f64) -> f64 {
        let last = (stop - start) / step;
        f64::midpoint(start, stop) * self.dwell / step + self.time(0.5 * last)
    }

    /// The cycles that are left at both ends of the band beside the middle, `(B/2)² dwell/δf · σ/c`, where the path grows by
    /// `rate` σ, m/s.
    pub fn cycles(&self, bandwidth: f64, step: f64, rate: f64, sound_speed: f64) -> f64 {
        0.25 * bandwidth * bandwidth * self.dwell / step * rate / sound_speed
    }
}

/// The amplitude of a point that these cycles at both ends of the band leave where it is seen, 1 without any.
pub(crate) fn blurred_amplitude(cycles: f64) -> f64 {
    // Simpson's rule over half of the band, with more places than the phase has turns.
    let count = 64 + 2 * (8.0 * cycles.abs()).min(1e6) as usize;
    let at = |i: usize| {
        let x = i as f64 / count as f64;
        let weight = match i {
            0 => 1.0,
            _ if i == count => 1.0,
            _ if i % 2 == 1 => 4.0,
            _ => 2.0,
        };
        let (sin, cos) = (TAU * cycles * x * x).sin_cos();
        [weight * cos, weight * sin]
    };
    let [re, im] = (0..=count).map(at).fold([0.0; 2], |[re, im], [c, s]| [re + c, im + s]);
    re.hypot(im) / (3.0 * count as f64)
}

/// Bounds on `v·d/|d|` for all d in a box: how fast a distance grows, m/s.
pub(crate) fn rate_bounds(velocity: DVec3, offsets: (DVec3, DVec3)) -> [f64; 2] {
    let speed = velocity.length();
    let axis = offsets.0.midpoint(offsets.1).normalize_or_zero();
    // A cone about the middle holds a convex box if it holds its corners and is no wider than a half space.
    let widest = corners(offsets).map(|d| axis.dot(d.normalize_or_zero())).into_iter().fold(1.0, f64::min);
    if widest <= 0.0 || speed == 0.0 {
        return [-speed, speed];
    }
    let (about, half) = ((velocity.dot(axis) / speed).clamp(-1.0, 1.0).acos(), widest.acos());
    let most = speed * (about - half).max(0.0).cos();
    let least = speed * (about + half).min(std::f64::consts::PI).cos();
    [least, most]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rates_are_within_their_bounds_and_those_are_narrow() {
        let fraction = |i: usize, k: f64| (i as f64 * k).fract();
        let place = |i: usize| [0.618_033_99, 0.754_877_67, 0.569_840_29].map(|k| fraction(i, k));
        let boxes = [
            (DVec3::new(-0.2, -0.1, 0.8), DVec3::new(0.3, 0.2, 1.1)),
            (DVec3::new(0.5, 0.4, 0.1), DVec3::new(0.6, 0.5, 2.0)),
            (DVec3::new(-1.0, -1.0, -0.1), DVec3::new(1.0, 1.0, 0.5)),
        ];
        for velocity in [DVec3::Z * 0.3, DVec3::new(0.2, -0.1, 0.05), DVec3::X * -2.0] {
            for (low, high) in boxes {
                let [least, most] = rate_bounds(velocity, (low, high));
                for i in 0..500 {
                    let d = low + DVec3::from(place(i)) * (high - low);
                    let rate = velocity.dot(d.normalize_or_zero());
                    assert!((least - 1e-12..=most + 1e-12).contains(&rate), "{rate} {least} {most}");
                }
            }
            let [least, most] = rate_bounds(velocity, boxes[0]);
            assert!(most - least < velocity.length());
        }
    }

    #[test]
    fn the_blurred_amplitude_is_the_mean_of_its_phasors() {
        for cycles in [0.0, 0.25, -0.7, 3.0, 40.0] {
            let count = 200_000;
            let sum = (0..count).fold([0.0, 0.0], |[re, im], i| {
                let x = 2.0 * (f64::from(i) + 0.5) / f64::from(count) - 1.0;
                let (sin, cos) = (TAU * cycles * x * x).sin_cos();
                [re + cos, im + sin]
            });
            let exact = sum[0].hypot(sum[1]) / f64::from(count);
            let found = blurred_amplitude(cycles);
            assert!((found - exact).abs() < 2e-5, "{cycles}: {found}, not {exact}");
        }
        assert_eq!(blurred_amplitude(0.0), 1.0);
    }
}
