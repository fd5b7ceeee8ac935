//! Optional losses beyond Eq. 5: spreading, absorption, directivity.
//!
//! Each is a real factor on a reflector's echo at a microphone:
//!
//! `A · (1 m)²/(d₁ d₂) · e^{−α(f)·path} · D(f, θ₁, a₁) · D(f, θ₂, a₂)`, `D = 2J₁(x)/x`, `x = 2πf/c · a sin θ`,
//!
//! with d₁ and θ₁ from the speaker and d₂ and θ₂ from the microphone to the reflector, angles against +z, radii a.

use super::SimulateOptions;
use crate::acquisition::{Electronics, Instrument};
use crate::wave::air::{Air, DB_PER_NEPER};
use crate::wave::piston::piston;
use crate::wave::spreading;
use glam::DVec3;
use std::f64::consts::TAU;

/// Losses of a simulation; [`Losses::NONE`] is Eq. 5 as printed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Losses {
    /// Spherical spreading of both legs, `(1 m)²/(d₁ d₂)`: amplitudes are referred to 1 m; distances are at least 1 cm.
    pub spreading: bool,
    /// Absorption by air, `e^{−α(f)·path}` ([`Air::absorption`]).
    pub air: Option<Air>,
    /// Radius of the speaker, a piston facing +z, m; 0 is omnidirectional.
    pub speaker_radius: f64,
    /// Radius of the microphones, m; likewise.
    pub microphone_radius: f64,
}

impl Losses {
    /// No losses.
    pub const NONE: Self = Self { spreading: false, air: None, speaker_radius: 0.0, microphone_radius: 0.0 };

    /// Whether there are losses.
    pub(crate) fn any(&self) -> bool {
        *self != Self::NONE
    }

    /// Whether any loss depends on the frequency.
    pub(super) fn vary(&self) -> bool {
        Self { spreading: false, ..*self } != Self::NONE
    }

    /// α at a frequency in Hz, Np/m.
    pub(super) fn absorption(&self, frequency: f64) -> f64 {
        self.air.map_or(0.0, |air| air.absorption(frequency))
    }

    /// The directivity of both ends for the sines of their angles; `wave_number` is 2πf/c, 1/m.
    pub(super) fn directivity(&self, wave_number: f64, [out, back]: [f64; 2]) -> f64 {
        let one =
            |radius: f64, sine: f64| if radius > 0.0 { piston(wave_number * radius * sine) } else { 1.0 };
        one(self.speaker_radius, out) * one(self.microphone_radius, back)
    }
}

impl SimulateOptions {
    /// What is simulated beyond Eq. 5, in words, one line each; empty for Eq. 5 as printed.
    pub(crate) fn physics(&self, instrument: &Instrument) -> Vec<String> {
        let sweep = &instrument.sweep;
        let mut lines = Vec::new();
        if self.losses.spreading {
            lines.push("spherical spreading, (1 m)² / (d1 d2)".to_owned());
        }
        if let Some(air) = self.losses.air {
            let decibels = |f: f64| DB_PER_NEPER * air.absorption(f);
            lines.push(format!(
                "absorption by air of {} °C, {} % and {} Pa: {:.3} to {:.3} dB/m in the band (ISO 9613-1)",
                air.temperature,
                air.humidity,
                air.pressure,
                decibels(sweep.start()),
                decibels(sweep.stop())
            ));
        }
        for (name, radius) in [
            ("the speaker is", self.losses.speaker_radius),
            ("microphones are", self.losses.microphone_radius),
        ] {
            if radius > 0.0 {
                let size = wave_number(sweep.centre(), instrument.sound_speed) * radius;
                lines.push(format!(
                    "{name} a piston of radius {:.1} mm, ka = {size:.2} at mid-band",
                    radius * 1e3
                ));
            }
        }
        if let Some(errors) = self.errors {
            lines.push(format!(
                "microphone errors of {} dB, {} degrees and {} mm along each axis, rms",
                errors.gain_db,
                errors.phase,
                errors.position * 1e3
            ));
        }
        lines.extend(self.electronics.iter().flat_map(Electronics::physics));
        lines
    }
}

/// The parameters, except the frequency, of the losses of one reflector at one microphone.
#[derive(Debug, Clone, Copy)]
pub(super) struct Legs {
    /// `(1 m)²/(d₁ d₂)`, or 1.
    pub(super) spreading: f64,
    /// sin θ at speaker and microphone.
    sines: [f64; 2],
    path: f64,
}

/// The sine of the angle between `leg` and z.
pub(super) fn sine(leg: DVec3) -> f64 {
    let length = leg.length();
    if length > 0.0 { leg.x.hypot(leg.y) / length } else { 0.0 }
}

impl Legs {
    pub(super) fn new(p: DVec3, r: DVec3, instrument: &Instrument, options: &SimulateOptions) -> Self {
        let (out, back) = (p - instrument.geometry.source_of(r), p - r);
        let spreading = if options.losses.spreading { spreading(out.length(), back.length()) } else { 1.0 };
        Self { spreading, sines: [sine(out), sine(back)], path: options.model.path_length(instrument, p, r) }
    }

    /// The losses of an echo whose amplitude has those of its transmit length.
    pub(super) fn after(transmit: f64, p: DVec3, r: DVec3, options: &SimulateOptions) -> Self {
        let back = p - r;
        let spreading = if options.losses.spreading { spreading(1.0, back.length()) } else { 1.0 };
        Self { spreading, sines: [0.0, sine(back)], path: transmit + back.length() }
    }

    /// The whole factor at a frequency of absorption α and wave number 2πf/c.
    pub(super) fn factor(&self, losses: &Losses, absorption: f64, wave_number: f64) -> f64 {
        self.spreading * (-absorption * self.path).exp() * losses.directivity(wave_number, self.sines)
    }
}

/// 2πf/c, 1/m.
pub(super) fn wave_number(frequency: f64, sound_speed: f64) -> f64 {
    TAU * frequency / sound_speed
}
