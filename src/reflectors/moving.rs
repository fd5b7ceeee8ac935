//! Reflectors that move while the tones are played.

use super::{Reflectors, SurfaceOptions};
use crate::error::{Error, Result};
use crate::wave::FASTEST;
use glam::DVec3;

impl SurfaceOptions {
    /// The velocity of a triangle, m/s.
    pub(super) fn velocity_of(&self, triangle: usize) -> DVec3 {
        let found = self.velocities.iter().find(|(triangles, _)| triangles.contains(&triangle));
        found.map_or(DVec3::ZERO, |(_, velocity)| *velocity)
    }
}

impl Reflectors {
    /// The same with a velocity for each, m/s, or none of them moving: they are where they are said to be when the first tone is
    /// played.
    ///
    /// # Errors
    /// Velocities that are not finite or beyond 10⁴ m/s.
    ///
    /// # Panics
    /// When there are neither none nor as many velocities as reflectors.
    pub fn with_velocities(mut self, velocities: Vec<DVec3>) -> Result<Self> {
        assert!([0, self.len()].contains(&velocities.len()), "one velocity per reflector");
        let valid = |v: &DVec3| v.is_finite() && v.abs().max_element() <= FASTEST;
        if let Some(bad) = velocities.iter().position(|v| !valid(v)) {
            let problem = format!(
                "moves at {} m/s; finite numbers up to {FASTEST:e} m/s were expected",
                velocities[bad]
            );
            return Err(Error::input(format!("reflector {bad}"), problem));
        }
        let still = velocities.iter().all(|v| *v == DVec3::ZERO);
        self.velocities = if still { Vec::new() } else { velocities };
        Ok(self)
    }

    /// The velocity of each, m/s; empty where nothing moves.
    pub fn velocities(&self) -> &[DVec3] {
        &self.velocities
    }

    /// Those of some velocities, displaced by so many seconds of them.
    fn of_velocities(&self, wanted: impl Fn(DVec3) -> bool, seconds: f64) -> Self {
        let places = self.positions.iter().zip(&self.velocities).zip(&self.amplitudes);
        let found = places.filter(|((_, v), _)| wanted(**v));
        let (positions, amplitudes) = found.map(|((p, v), a)| (*p + *v * seconds, *a)).unzip();
        Self { positions, amplitudes, bounced: None, velocities: Vec::new() }
    }

    /// Those that do not move.
    pub(crate) fn still(&self) -> Self {
        if self.velocities.is_empty() { self.clone() } else { self.of_velocities(|v| v == DVec3::ZERO, 0.0) }
    }

    /// Those that move, where they are after so many seconds.
    pub(crate) fn moved(&self, seconds: f64) -> Self {
        self.of_velocities(|v| v != DVec3::ZERO, seconds)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::named::assert_names;
    use num_complex::Complex32;

    #[test]
    fn what_moves_is_told_from_what_is_still() {
        let (p, a) = (vec![DVec3::Z, DVec3::X, DVec3::Y], [1.0, 2.0, 3.0].map(Complex32::from).to_vec());
        let still = Reflectors::new(p, a).expect("finite");
        let v = DVec3::new(0.0, 0.5, -1.0);
        let moving = still.clone().with_velocities(vec![DVec3::ZERO, v, DVec3::ZERO]).expect("slow");
        assert_eq!((moving.still().len(), moving.moved(2.0).positions()), (2, &[DVec3::X + v * 2.0][..]));
        assert_eq!(moving.moved(2.0).amplitudes(), [Complex32::from(2.0)]);
        assert_eq!(still.clone().with_velocities(vec![DVec3::ZERO; 3]).expect("still"), still);
        assert_eq!((still.still(), still.moved(1.0).len()), (still.clone(), 0));
        for bad in [f64::NAN, 1.1e4, f64::INFINITY] {
            let refused = still.clone().with_velocities(vec![DVec3::X * bad; 3]).expect_err("no velocity");
            assert_names(refused.to_string(), &["reflector 0", "1e4 m/s"]);
        }
    }
}
