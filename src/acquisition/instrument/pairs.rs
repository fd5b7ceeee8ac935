//! Pairs of a loudspeaker and a microphone that are not all the same way apart: each microphone hears a loudspeaker of its own.
//!
//! The instrument's `geometry` is then that of a pair with the mean offset, by which such pairs are told apart from other
//! instruments and roughly planned; whatever sums over microphones asks [`Instrument::geometry_of`] for that of each.

use super::Instrument;
use crate::acquisition::MicArray;
use crate::error::{Error, Result};
use crate::scene::FARTHEST;
use crate::wave::Geometry;
use glam::DVec3;
use std::sync::Arc;

/// By how much the offsets of one moved pair may differ, m: by how positions round, and no more.
const SAME_OFFSET: f64 = 1e-6;

impl Instrument {
    /// The same with a loudspeaker for each microphone, at `sources` in the order of the microphones, m: sample `r` is that of
    /// microphone `r` while its own loudspeaker sounds. A loudspeaker or microphone of several pairs is given with each.
    ///
    /// Where all are the same way apart, it is a pair that is moved, [`Geometry::Pair`].
    ///
    /// # Errors
    /// Other than one loudspeaker for each microphone; places beyond 10⁹ m.
    ///
    /// ```
    /// use holosonar::glam::DVec3;
    /// use holosonar::acquisition::{Instrument, MicArray, Sweep};
    /// use holosonar::wave::Geometry;
    ///
    /// let sweep = Sweep::stepped(10e3, 20e3, 100.0)?;
    /// let places: Vec<DVec3> = (0..4).map(|i| DVec3::X * 0.125 * f64::from(i)).collect();
    /// let receivers = Instrument::new(sweep, MicArray::from_positions(places.clone())?);
    /// // All of them about one common midpoint:
    /// let opposite: Vec<DVec3> = places.iter().map(|r| -*r).collect();
    /// let gather = receivers.clone().with_pairs(&opposite)?;
    /// assert_eq!(gather.geometry_of(3), Geometry::Pair { offset: DVec3::X * -0.75 });
    /// // All of them the same way apart:
    /// let beside: Vec<DVec3> = places.iter().map(|r| *r + DVec3::Y * 0.05).collect();
    /// assert_eq!(receivers.with_pairs(&beside)?.geometry, Geometry::Pair { offset: DVec3::Y * 0.05 });
    /// # Ok::<(), holosonar::error::Error>(())
    /// ```
    pub fn with_pairs(self, sources: &[DVec3]) -> Result<Self> {
        let microphones = self.array.positions();
        if sources.len() != microphones.len() {
            let problem = format!(
                "there are {} loudspeakers for {} microphones; a pair has one of each, in the same order",
                sources.len(),
                microphones.len()
            );
            return Err(Error::input("source_positions", problem));
        }
        check_places(sources)?;
        let offsets: Vec<DVec3> = sources.iter().zip(microphones).map(|(s, r)| *s - *r).collect();
        let first = offsets[0];
        let moved = Self { further_sources: Arc::default(), ..self };
        if offsets.iter().all(|offset| (*offset - first).length() <= SAME_OFFSET) {
            let geometry = Geometry::Pair { offset: first };
            return Ok(Self { geometry, pair_sources: Arc::default(), ..moved });
        }
        let offset = offsets.iter().sum::<DVec3>() / offsets.len() as f64;
        Ok(Self { geometry: Geometry::Pair { offset }, pair_sources: Arc::new(sources.to_vec()), ..moved })
    }

    /// Whether each microphone has a loudspeaker of its own, some another way apart than others.
    pub fn has_differing_pairs(&self) -> bool {
        !self.pair_sources.is_empty()
    }

    /// The geometry of one microphone: that of all, or of its own pair.
    ///
    /// # Panics
    /// If there are not so many microphones.
    #[inline]
    pub fn geometry_of(&self, microphone: usize) -> Geometry {
        match self.pair_sources.get(microphone) {
            Some(source) => Geometry::Pair { offset: *source - self.array.positions()[microphone] },
            None => self.geometry,
        }
    }

    /// Length of the path speaker → `p` → microphone, by the microphone's number, m; as [`Instrument::path_length`].
    ///
    /// # Panics
    /// If there are not so many microphones.
    #[inline]
    pub fn path_length_at(&self, p: DVec3, microphone: usize) -> f64 {
        let (geometry, r) = (self.geometry_of(microphone), self.array.positions()[microphone]);
        match &self.interface {
            None => geometry.path_length(p, r),
            Some(interface) => interface.path_length(self.sound_speed, &geometry, p, r),
        }
    }

    /// The instrument as one microphone sees it, whose pair is that of all.
    pub(crate) fn seen_from(&self, microphone: usize) -> Self {
        Self { geometry: self.geometry_of(microphone), pair_sources: Arc::default(), ..self.clone() }
    }

    /// The same with microphones that were moved, each with the loudspeaker of its pair.
    pub(crate) fn with_moved(self, array: MicArray) -> Self {
        let moves = array.positions().iter().zip(self.array.positions()).map(|(to, from)| *to - *from);
        let sources = self.pair_sources.iter().zip(moves).map(|(source, by)| *source + by).collect();
        Self { pair_sources: Arc::new(sources), array, ..self }
    }

    /// Refuses pairs that are not all the same way apart, which `place` cannot take.
    pub(crate) fn need_even_pairs(&self, place: &str) -> Result<()> {
        if !self.has_differing_pairs() {
            return Ok(());
        }
        let problem = "takes pairs that are all the same way apart, or microphones that hear the same loudspeakers, and each \
                       of these microphones has a loudspeaker of its own";
        Err(Error::input(place, problem))
    }

    /// Rejects pairs without a loudspeaker, or with one nowhere.
    pub(super) fn check_pairs(&self) -> Result<()> {
        if self.pair_sources.is_empty() {
            return Ok(());
        }
        if self.pair_sources.len() != self.array.len() || !matches!(self.geometry, Geometry::Pair { .. }) {
            let problem = format!(
                "has {} loudspeakers of pairs for {} microphones; a pair has one of each, and the geometry is \"pair\"",
                self.pair_sources.len(),
                self.array.len()
            );
            return Err(Error::input("instrument", problem));
        }
        check_places(&self.pair_sources)
    }
}

fn check_places(sources: &[DVec3]) -> Result<()> {
    let far = |s: &DVec3| s.is_nan() || s.abs().max_element() > FARTHEST;
    let Some(bad) = sources.iter().position(far) else { return Ok(()) };
    let problem = format!(
        "the loudspeaker of pair {bad} (counted from 0) must be within {FARTHEST:e} m along each axis, not at {} m",
        sources[bad]
    );
    Err(Error::input("source_positions", problem))
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;
    use crate::acquisition::Sweep;
    use crate::named::assert_names;

    fn receivers() -> Instrument {
        let place = |i: u32| DVec3::new(0.1 * f64::from(i), 0.0, 0.01);
        let array = MicArray::from_positions((0..5).map(place).collect()).unwrap();
        Instrument::new(Sweep::stepped(10e3, 12e3, 100.0).unwrap(), array)
    }

    #[test]
    fn each_microphone_has_the_path_of_its_own_pair() {
        let sources: Vec<DVec3> = (0..5).map(|i| DVec3::new(0.0, 0.07 * f64::from(i * i), 0.0)).collect();
        let pairs = receivers().with_pairs(&sources).unwrap();
        pairs.check().unwrap();
        let p = DVec3::new(0.1, -0.2, 0.9);
        for (i, (s, r)) in sources.iter().zip(receivers().array.positions()).enumerate() {
            let exact = p.distance(*s) + p.distance(*r);
            assert!((pairs.path_length_at(p, i) - exact).abs() < 1e-12);
            let [low, high] = pairs.path_bounds_of((p, p));
            assert!(low - 1e-12 <= exact && exact <= high + 1e-12);
            assert_eq!(pairs.seen_from(i).path_length(p, *r), pairs.path_length_at(p, i));
        }
        let midpoints = pairs.equivalent();
        assert_eq!(midpoints.geometry, Geometry::Monostatic);
        assert!(midpoints.array.positions()[2].distance(DVec3::new(0.1, 0.14, 0.005)) < 1e-12);
        let up = pairs.array.with_positions(pairs.array.positions().iter().map(|r| *r + DVec3::Z).collect());
        assert!(
            pairs.clone().with_moved(up.unwrap()).pair_sources[3].distance(sources[3] + DVec3::Z) < 1e-12
        );
    }

    #[test]
    fn what_is_no_pair_is_refused() {
        assert_names(receivers().with_pairs(&[DVec3::ZERO]).unwrap_err().to_string(), &["1", "5", "pair"]);
        for bad in [f64::NAN, 1e12] {
            let mut sources = vec![DVec3::ZERO; 5];
            sources[3].y = bad;
            assert_names(receivers().with_pairs(&sources).unwrap_err().to_string(), &["pair 3", "1e9 m"]);
        }
        let pairs = receivers().with_pairs(&[DVec3::ZERO; 5]).unwrap();
        assert!(pairs.has_differing_pairs() && pairs.need_even_pairs("--blind").is_err());
        let fewer = pairs.with_array(MicArray::from_positions(vec![DVec3::ZERO]).unwrap());
        assert_names(fewer.check().unwrap_err().to_string(), &["5", "1", "pair"]);
    }
}
