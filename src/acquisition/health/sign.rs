//! The sign of the phase: which of the two signs the echoes of a cube have.
//!
//! With the wrong sign an echo of path L appears at c/δf − L, and the wavefront over the array bends the wrong way: it comes
//! together behind the array instead of in front of it. So some microphones are focused, coherently and with either sign, on
//! points at the strongest ranges in every direction, and the brighter point wins. Far away wavefronts are flat, and of a
//! rough surface no point is bright; then only the place of the echoes is left: usually in the first half of the
//! unambiguous path.

use super::profile::{MeanProfile, window};
use crate::acquisition::Instrument;
use crate::acquisition::profile::{decibels, unambiguous_path};
use crate::choice::choice;
use crate::wave::Geometry;
use glam::DVec3;
use num_complex::{Complex32, Complex64};
use rayon::prelude::*;
use rustfft::FftPlanner;
use serde::Serialize;
use std::f64::consts::TAU;

/// Maximum number of microphones that are focused.
const MOST_FOCUSED: usize = 128;

/// Maximum bytes of their profiles.
const MOST_BYTES: usize = 32 << 20;

/// Maximum number of directions along x and y.
const MOST_DIRECTIONS: usize = 161;

/// The sine of the angle up to which directions are tried, and ranges that are.
const WIDEST: f64 = 0.87;
const RANGES: usize = 3;

/// A sign that focuses this much better is the likelier one, dB; and so is one with this share of the energy in the first
/// half, where both focus alike.
const FOCUS_DB: f64 = 1.0;
const SHARE: f64 = 0.8;

choice! {
    /// Which sign of the phase a cube's echoes have.
    pub enum LikelySign: "sign of the phase" {
        /// The one that the file declares.
        Declared = "as declared",
        /// The opposite one: `phase_sign` in `meta` is wrong, or the samples are conjugated.
        Opposite = "opposite",
        /// Both explain the cube alike.
        Unknown = "cannot be told",
    }
}

/// What speaks for either sign of the phase.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[non_exhaustive]
pub struct PhaseSign {
    /// The verdict: by focus, if the signs differ by 1 dB there; otherwise by place, if four fifths of the energy are in the
    /// first half with one of them.
    pub likely: LikelySign,
    /// With the sign that the file declares.
    pub declared: SignEvidence,
    /// With the opposite sign.
    pub opposite: SignEvidence,
}

/// What speaks for one sign of the phase.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[non_exhaustive]
pub struct SignEvidence {
    /// The share of the energy of echoes that is in the first half of the unambiguous path, 0 to 1; `None` without echoes.
    pub first_half: Option<f64>,
    /// Power of the brightest point in front of the array, coarsely focused, against the mean |m|², dB: 0 for a single echo.
    /// `None` for fewer than four microphones.
    pub focus_db: Option<f64>,
}

/// The evidence for either sign, and the verdict; `chosen` are the microphones of `columns`, `[chosen, n_f]`.
pub(super) fn judge(
    instrument: &Instrument,
    profile: &MeanProfile,
    chosen: &[usize],
    columns: &[Complex32],
) -> PhaseSign {
    let n_f = instrument.sweep.len();
    let count = chosen.len().min(MOST_FOCUSED).min(MOST_BYTES / (16 * n_f)).max(1);
    let some: Vec<usize> = (0..count).map(|i| i * chosen.len() / count).collect();
    let evidence = |opposite: bool| {
        let mut power = profile.power.clone();
        if opposite {
            // The conjugate's profile is the same backwards.
            power[1..].reverse();
        }
        let focus = FocusedChannels::new(instrument, &some, chosen, columns, opposite);
        SignEvidence {
            first_half: first_half(&power),
            focus_db: focus.and_then(|focus| decibels(focus.brightest(&power))),
        }
    };
    let (declared, opposite) = (evidence(false), evidence(true));
    let focus = declared.focus_db.zip(opposite.focus_db).map_or(0.0, |(a, b)| a - b);
    let share = declared.first_half.unwrap_or(0.5);
    let likely = match () {
        () if focus >= FOCUS_DB => LikelySign::Declared,
        () if focus <= -FOCUS_DB => LikelySign::Opposite,
        () if share >= SHARE => LikelySign::Declared,
        () if share <= 1.0 - SHARE => LikelySign::Opposite,
        () => LikelySign::Unknown,
    };
    PhaseSign { likely, declared, opposite }
}

/// The share of the energy above the median, which is noise, in the first half.
fn first_half(power: &[f64]) -> Option<f64> {
    let noise = super::median(power.iter().copied())?;
    let energy = |power: &[f64]| power.iter().map(|p| (p - noise).max(0.0)).sum::<f64>();
    let (first, all) = (energy(&power[..power.len() / 2]), energy(power));
    (all > 0.0).then(|| first / all)
}

/// Profiles of some microphones, focused on points.
struct FocusedChannels<'a> {
    instrument: &'a Instrument,
    microphones: Vec<usize>,
    /// `[microphone, 2 n_f]`, relative to the phase at the centre of the band, so that they turn slowly along the path.
    profiles: Vec<Complex32>,
    /// m of path from one value to the next.
    pitch: f64,
    /// Cycles per m of path at the centre of the band.
    wavenumber: f64,
    /// Mean |m|² of these microphones.
    power: f64,
}

impl<'a> FocusedChannels<'a> {
    /// `None` for too few microphones.
    fn new(
        instrument: &'a Instrument,
        some: &[usize],
        chosen: &[usize],
        columns: &[Complex32],
        opposite: bool,
    ) -> Option<Self> {
        if some.len() < 4 {
            return None;
        }
        let n_f = instrument.sweep.len();
        let window = window(n_f);
        let scale = 1.0 / window.iter().sum::<f64>();
        // Twice as long, so that a line between two values is near enough.
        let length = 2 * n_f;
        let fft = FftPlanner::new().plan_fft_forward(length);
        let middle = 0.5 * (n_f - 1) as f64;
        let (mut profiles, mut power) = (Vec::with_capacity(some.len() * length), 0.0);
        for i in some {
            let column = &columns[i * n_f..(i + 1) * n_f];
            let mut profile: Vec<Complex64> = column
                .iter()
                .zip(&window)
                .map(|(m, w)| {
                    let m = if opposite { m.conj() } else { *m };
                    let m = Complex64::new(m.re.into(), m.im.into());
                    power += m.norm_sqr();
                    m * (w * scale)
                })
                .collect();
            profile.resize(length, Complex64::ZERO);
            fft.process(&mut profile);
            profiles.extend(profile.iter().enumerate().map(|(k, value)| {
                let value = value * Complex64::cis(TAU * middle * k as f64 / length as f64);
                Complex32::new(value.re as f32, value.im as f32)
            }));
        }
        Some(Self {
            instrument,
            microphones: some.iter().map(|i| chosen[*i]).collect(),
            profiles,
            pitch: unambiguous_path(instrument) / length as f64,
            wavenumber: instrument.sweep.centre() / instrument.sound_speed,
            power: power / (some.len() * n_f) as f64,
        })
    }

    /// Power of the sum over microphones at a point, against the mean power.
    fn at(&self, point: DVec3) -> f64 {
        let n = self.profiles.len() / self.microphones.len();
        let mut sum = Complex64::ZERO;
        for (profile, r) in self.profiles.chunks_exact(n).zip(&self.microphones) {
            let path = self.instrument.path_length_at(point, *r);
            let place = path / self.pitch;
            let k = place as usize;
            if k + 1 >= n {
                continue;
            }
            let t = (place - k as f64) as f32;
            let value = profile[k] * (1.0 - t) + profile[k + 1] * t;
            let turn = self.wavenumber * path;
            sum += Complex64::new(value.re.into(), value.im.into())
                * Complex64::cis(-TAU * (turn - turn.floor()));
        }
        sum.norm_sqr() / (self.microphones.len() as f64).powi(2) / self.power
    }

    /// The point in a direction, given by its sines, to which the path by way of the array's centre is so long.
    fn point(&self, [u, v, path]: [f64; 3]) -> Option<DVec3> {
        let w = 1.0 - u * u - v * v;
        if w <= 0.0 {
            return None;
        }
        let (centre, direction) = (self.instrument.array.centre(), DVec3::new(u, v, w.sqrt()));
        let distance = match self.instrument.geometry {
            Geometry::Monostatic => 0.5 * path,
            // On an ellipse about speaker and centre.
            geometry => {
                let base = geometry.source_of(centre) - centre;
                (path * path - base.length_squared()) / (2.0 * (path - direction.dot(base)))
            }
        };
        (distance > 0.0 && distance.is_finite()).then(|| centre + direction * distance)
    }

    fn power_at(&self, place: [f64; 3]) -> f64 {
        self.point(place).map_or(0.0, |point| self.at(point))
    }

    /// The brightest point at the strongest ranges of a mean profile: by directions, and then by ever smaller steps.
    fn brightest(&self, power: &[f64]) -> f64 {
        let extent = self.instrument.array.extent();
        let lines = |extent: f64| {
            let count = (2.0 * WIDEST / 0.7 * extent * self.wavenumber).ceil().max(0.0) as usize;
            // Odd, so that straight ahead is one of them.
            if extent == 0.0 { 1 } else { (count | 1).clamp(5, MOST_DIRECTIONS) }
        };
        let [n_u, n_v] = [lines(extent.x), lines(extent.y)];
        let step = |n: usize| if n == 1 { 0.0 } else { 2.0 * WIDEST / (n - 1) as f64 };
        let sine = |i: usize, n: usize| if n == 1 { 0.0 } else { i as f64 * step(n) - WIDEST };
        let cell = 2.0 * self.pitch;
        let mut found: f64 = 0.0;
        for k in strongest(power) {
            let path = k as f64 * cell;
            let rows = (0..n_v).into_par_iter().map(|j| {
                let places = (0..n_u).map(|i| [sine(i, n_u), sine(j, n_v), path]);
                places.map(|place| (self.power_at(place), place)).max_by(|a, b| a.0.total_cmp(&b.0))
            });
            let rows: Vec<_> = rows.collect();
            let best = rows.into_iter().flatten().max_by(|a, b| a.0.total_cmp(&b.0));
            let Some((mut best, mut place)) = best else { continue };
            let mut steps = [0.5 * step(n_u), 0.5 * step(n_v), 0.5 * cell];
            for _ in 0..6 {
                let centre = place;
                for shift in 0..27_usize {
                    let there: [f64; 3] = std::array::from_fn(|axis| {
                        let shift = shift / 3_usize.pow(axis as u32) % 3;
                        centre[axis] + (shift as f64 - 1.0) * steps[axis]
                    });
                    let power = self.power_at(there);
                    if power > best {
                        (best, place) = (power, there);
                    }
                }
                steps = steps.map(|step| 0.6 * step);
            }
            found = found.max(best);
        }
        found
    }
}

/// The places of the strongest local maxima of a profile.
fn strongest(power: &[f64]) -> Vec<usize> {
    let n = power.len();
    let is_peak = |k: &usize| power[*k] > power[(k + n - 1) % n] && power[*k] >= power[(k + 1) % n];
    let mut places: Vec<usize> = (1..n).filter(is_peak).collect();
    places.sort_by(|a, b| power[*b].total_cmp(&power[*a]));
    places.truncate(RANGES);
    places
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_point_in_a_direction_has_the_path_asked_for() {
        let sweep = crate::acquisition::Sweep::stepped(10e3, 12e3, 100.0).expect("even");
        let array = crate::acquisition::MicArray::rectangular([4, 4], [0.1; 2], DVec3::X).expect("valid");
        let instrument = Instrument::new(sweep, array);
        let columns = vec![Complex32::ONE; 16 * 21];
        let all: Vec<usize> = (0..16).collect();
        let focus = FocusedChannels::new(&instrument, &all, &all, &columns, false).expect("enough");
        let point = focus.point([0.3, -0.5, 4.0]).expect("in front");
        let path = instrument.path_length(point, DVec3::X);
        assert!((path - 4.0).abs() < 1e-12, "{path}");
        assert!(focus.point([0.0, 0.0, 0.5]).is_none(), "shorter than from the speaker to the centre");
        assert!(focus.point([0.8, 0.8, 4.0]).is_none(), "no direction");
    }
}
