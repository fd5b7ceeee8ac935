//! What a correlation can tell apart in depth, predicted without any data.
//!
//! Near a reflector at p every path grows by `σ_r t` with a step t along z, `σ_r = ∂path/∂z`, so that a point's power there is
//! `Σ_g |Σ_r w_r D(σ_r t) e^{i2πf_g σ_r t/c}|²` with the sub-band's own transform `D(l) = sin(πKδf l/c)/(K sin(πδf l/c))`. Of single
//! tones (D = 1) only the curvature of the wave fronts is left, by which σ_r differs from microphone to microphone.

use crate::acquisition::Instrument;
use glam::DVec3;
use num_complex::Complex64;
use std::f64::consts::{FRAC_2_PI, PI, TAU};

/// The most microphones and sub-bands that stand for all.
const MICROPHONES: usize = 1024;
const SUB_BANDS: usize = 8;

/// The farthest that is looked for, m.
const WIDEST: f64 = 1e6;

/// A few of many places, evenly spread.
fn few(count: usize, most: usize) -> impl Iterator<Item = usize> {
    let taken = count.min(most);
    (0..taken).map(move |i| (2 * i + 1) * count / (2 * taken))
}

/// The full width of a point's amplitude along z at 2/π of the peak, before the array's middle at depth z, m; at most 10⁶ m.
/// Cost: a thousand microphones times some hundred steps.
pub(super) fn depth_resolution(instrument: &Instrument, z: f64, sub_band: usize) -> f64 {
    let (sweep, centre) = (&instrument.sweep, instrument.array.centre());
    let p = DVec3::new(centre.x, centre.y, z.max(centre.z + 1e-3));
    let step = 1e-4 * (p.z - centre.z);
    let first = instrument.transmission(0);
    let slope = |r: DVec3| {
        let path = |p: DVec3| first.path_length(p, r);
        (path(p + DVec3::Z * step) - path(p - DVec3::Z * step)) / (2.0 * step)
    };
    let positions = instrument.array.positions();
    let slopes: Vec<f64> =
        few(positions.len(), MICROPHONES).map(|r| slope(positions[r]) / instrument.sound_speed).collect();
    let spacing = sweep.bandwidth() / (sweep.len().max(2) - 1) as f64;
    let bands = sweep.len().div_ceil(sub_band);
    let middles: Vec<f64> = few(bands, SUB_BANDS)
        .map(|band| {
            let last = ((band + 1) * sub_band).min(sweep.len()) - 1;
            f64::midpoint(sweep.frequencies()[band * sub_band], sweep.frequencies()[last])
        })
        .collect();
    let of_band = |delay: f64| {
        let (half, count) = (PI * spacing * delay, sub_band as f64);
        if half.sin().abs() < 1e-12 { 1.0 } else { (count * half).sin() / (count * half.sin()) }
    };
    let power = |t: f64| {
        let of_tone = |f: &f64| {
            let phasor = |slope: &f64| of_band(slope * t) * Complex64::cis(TAU * f * slope * t);
            (slopes.iter().map(phasor).sum::<Complex64>() / slopes.len() as f64).norm_sqr()
        };
        middles.iter().map(of_tone).sum::<f64>() / middles.len() as f64
    };
    let level = FRAC_2_PI * FRAC_2_PI;
    let mut near = 0.0;
    let mut far = 0.05 * instrument.shortest_wavelength();
    while power(far) >= level {
        if far > WIDEST {
            return WIDEST;
        }
        (near, far) = (far, 1.15 * far);
    }
    for _ in 0..24 {
        let middle = f64::midpoint(near, far);
        if power(middle) < level { far = middle } else { near = middle }
    }
    2.0 * far
}
