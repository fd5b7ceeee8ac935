//! What motion does to an image that takes it for still, predicted without any data.

use crate::acquisition::Instrument;
use crate::grid::Grid;
use crate::wave::{Motion, blurred_amplitude};
use serde::Serialize;
use std::fmt;

/// The image of what moves, in a frame that does not move with it.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Smear {
    /// Its velocity in that frame, m/s.
    pub velocity: [f64; 3],
    /// How long the tones of all loudspeakers take, s.
    pub duration: f64,
    /// How far it moves meanwhile, m.
    pub travel: f64,
    /// By how much it is seen displaced from where it was at first, m: stepped tones turn a velocity into a range.
    pub displacement: [f64; 3],
    /// Cycles of phase that no displacement explains, at both ends of the band.
    pub cycles: f64,
    /// The amplitude that a point has left for it, of 1.
    pub amplitude: f64,
}

impl Smear {
    /// That of a motion relative to the frame, in the middle of a grid; uneven tones are taken for as many even ones.
    pub fn of(instrument: &Instrument, grid: &Grid, motion: Motion) -> Self {
        let (sweep, c) = (&instrument.sweep, instrument.sound_speed);
        let (low, high) = grid.bounds();
        let middle = low.midpoint(high);
        let own = instrument.transmission(0);
        let path = |seconds: f64| own.path_length(middle + motion.velocity * seconds, own.array.centre());
        let step = 1e-3 * instrument.shortest_wavelength() / motion.velocity.length().max(1e-12);
        let rate = (path(step) - path(-step)) / (2.0 * step);
        let spacing = sweep.bandwidth() / (sweep.len().max(2) - 1) as f64;
        let (lag, cycles) = if spacing > 0.0 {
            let band = [sweep.start(), sweep.stop()];
            (motion.lag(band, spacing), motion.cycles(sweep.bandwidth(), spacing, rate, c))
        } else {
            (0.0, 0.0)
        };
        let duration = (instrument.transmissions() * sweep.len()) as f64 * motion.dwell;
        Self {
            velocity: motion.velocity.to_array(),
            duration,
            travel: motion.velocity.length() * duration,
            displacement: (motion.velocity * lag).to_array(),
            cycles,
            amplitude: blurred_amplitude(cycles),
        }
    }
}

/// In a line.
impl fmt::Display for Smear {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [x, y, z] = self.velocity;
        let [dx, dy, dz] = self.displacement.map(|length| 1e3 * length);
        write!(
            f,
            "what moves at ({x}, {y}, {z}) m/s beside the frame that is imaged moves {:.1} mm in the {:.2} s of the tones: seen \
             displaced by ({dx:.0}, {dy:.0}, {dz:.0}) mm, at {:.2} of its amplitude",
            1e3 * self.travel,
            self.duration,
            self.amplitude
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::acquisition::{MicArray, Sweep};
    use crate::grid::Axis;
    use glam::DVec3;

    #[test]
    fn a_smear_follows_its_formulas() {
        let array = MicArray::rectangular([5, 5], [0.02; 2], DVec3::ZERO).expect("valid");
        let instrument = Instrument::new(Sweep::stepped(10e3, 20e3, 100.0).expect("valid"), array);
        let one = |first: f64| Axis { first, pitch: 0.1, count: 1 };
        let grid = Grid { x: one(0.0), y: one(0.0), z: one(2.0) };
        let smear = Smear::of(&instrument, &grid, Motion::new(DVec3::Z * 0.1, 0.01));
        // τ = f_c dwell/δf + t_c = 15e3 · 0.01/100 + 0.5; the path grows by 0.2 m/s.
        assert!((smear.displacement[2] - 0.1 * 2.0).abs() < 1e-9 && (smear.duration - 1.01).abs() < 1e-9);
        let cycles = 0.25 * 1e8 * 0.01 / 100.0 * 0.2 / 343.0;
        assert!((smear.cycles - cycles).abs() < 1e-6 * cycles, "{} {cycles}", smear.cycles);
        assert!((0.3..0.4).contains(&smear.amplitude), "{}", smear.amplitude);
        assert!(smear.to_string().contains("(0, 0, 200) mm"), "{smear}");
        let still = Smear::of(&instrument, &grid, Motion::new(DVec3::ZERO, 0.01));
        assert_eq!((still.amplitude, still.travel), (1.0, 0.0));
    }
}
