//! When each tone sounds, and how loud it is by then.

use crate::acquisition::electronics::settled;
use crate::wave::interval::phasor_f64;
use num_complex::Complex64;

/// At a time, the tone that sounds, counted from 0, how long it has, s, and how loud it and the one before it are by now.
///
/// Nothing sounds before the first, and after the last as far as it is heard.
pub(super) struct Instant {
    tone: usize,
    since: f64,
    shares: [f64; 2],
}

/// When each of so many tones sounds.
pub(super) struct Schedule {
    pub(super) count: usize,
    /// When the first begins, and how long each sounds, s.
    pub(super) start: f64,
    pub(super) dwell: f64,
}

impl Schedule {
    /// What sounds at `time`, s, where tones follow their steps with the time constant `decay`.
    pub(super) fn at(&self, time: f64, decay: f64) -> Instant {
        let since = time - self.start;
        let tone = (since / self.dwell).floor();
        if since < 0.0 || tone > self.count as f64 {
            return Instant { tone: 0, since: 0.0, shares: [0.0; 2] };
        }
        let within = since - tone * self.dwell;
        Instant { tone: tone as usize, since: within, shares: settled(decay, within) }
    }

    /// The numbers of the tone that sounds and of the one before it, with their waves `e^{i2πft}` as loud as they are by now, for
    /// these frequencies, Hz.
    pub(super) fn waves(&self, frequencies: &[f64], instant: &Instant) -> [(usize, Complex64); 2] {
        let Instant { tone, since, shares: [rising, falling] } = *instant;
        let wave = |tone: usize, since: f64| {
            frequencies.get(tone).map_or(Complex64::ZERO, |f| phasor_f64(f * since))
        };
        let before = tone
            .checked_sub(1)
            .map_or((0, Complex64::ZERO), |before| (before, wave(before, since + self.dwell) * falling));
        [(tone, wave(tone, since) * rising), before]
    }
}
