//! Reflectors that move while the tones are played.

use super::{Reflectors, SurfaceOptions};
use crate::error::{Error, Result};
use crate::scene::Scene;
use crate::wave::FASTEST;
use glam::DVec3;

impl SurfaceOptions {
    /// The velocity of a triangle, m/s.
    pub(super) fn velocity_of(&self, triangle: usize) -> DVec3 {
        let found = self.velocities.iter().find(|(triangles, _)| triangles.contains(&triangle));
        found.map_or(DVec3::ZERO, |(_, velocity)| *velocity)
    }

    /// The velocity of all triangles, m/s, if they move.
    ///
    /// # Errors
    /// Triangles that do not move alike, between which paths change in ways of their own.
    pub(super) fn rigid_velocity(&self, scene: &Scene) -> Result<Option<DVec3>> {
        if self.velocities.is_empty() {
            return Ok(None);
        }
        let first = self.velocity_of(0);
        if (1..scene.triangles().len()).all(|triangle| self.velocity_of(triangle) == first) {
            return Ok(Some(first));
        }
        Err(Error::input("[scene] velocity", NOT_RIGID))
    }
}

/// Why some scenes have neither bounces nor edges.
const NOT_RIGID: &str = "of some surfaces alone cannot be combined with bounces or edges: mirror images, openings and shadows \
                         change between surfaces that move apart; let all move alike, by [scene] velocity";

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

    /// The same moving alike, if at all.
    pub(super) fn moving_as_one(self, velocity: Option<DVec3>) -> Result<Self> {
        let count = self.len();
        self.with_velocities(velocity.map_or(Vec::new(), |velocity| vec![velocity; count]))
    }

    /// Refuses bounced reflectors that move, but not as surfaces do that all move alike.
    pub(crate) fn check_motion(&self) -> Result<()> {
        let Some(bounced) = self.bounced.as_ref().filter(|_| !self.velocities.is_empty()) else {
            return Ok(());
        };
        let alike = self.velocities.windows(2).all(|pair| pair[0] == pair[1]);
        if alike && bounced.origins.len() == bounced.transmit.len() {
            return Ok(());
        }
        Err(Error::input("[scene] velocity", NOT_RIGID))
    }

    /// Those that do not move.
    pub(crate) fn still(&self) -> Self {
        if self.velocities.is_empty() { self.clone() } else { self.of_velocities(|v| v == DVec3::ZERO, 0.0) }
    }

    /// Those that move, where they are after so many seconds. Bounced ones all do.
    pub(crate) fn moved(&self, seconds: f64) -> Self {
        if let (Some(bounced), Some(velocity)) = (&self.bounced, self.velocities.first()) {
            let (bounced, positions) = bounced.displaced(&self.positions, *velocity * seconds);
            let amplitudes = self.amplitudes.clone();
            return Self { positions, amplitudes, bounced: Some(bounced), velocities: Vec::new() };
        }
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
