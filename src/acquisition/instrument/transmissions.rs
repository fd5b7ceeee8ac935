//! Several loudspeakers that sound one after another: the transmissions of a measurement, and the array that they make.
//!
//! The instrument's `geometry` holds the first loudspeaker, `further_sources` the others. What works on one transmission is
//! given [`Instrument::transmission`], which has one loudspeaker; what asks how sharply all of them see together is given
//! [`Instrument::equivalent`].

use super::Instrument;
use crate::acquisition::MicArray;
use crate::error::{Error, Result};
use crate::wave::{Geometry, bounding_box};
use glam::DVec3;
use std::borrow::Cow;
use std::ops::Range;
use std::sync::Arc;

/// More loudspeakers than this are not imaged one after another.
pub(crate) const MOST_SOURCES: usize = 1 << 16;

/// Virtual microphones beyond this number are not looked at; the plan is then that of the microphones themselves.
const MOST_VIRTUAL: usize = 1 << 20;

/// Rows of virtual microphones are so much apart, m; what is nearer differs by rounding.
const SAME_ROW: f64 = 1e-6;

impl Instrument {
    /// The same with loudspeakers at `sources`, m, which sound one after another: every microphone records each of them.
    ///
    /// # Errors
    /// No loudspeaker, or more than 65536.
    ///
    /// ```
    /// use holosonar::glam::DVec3;
    /// use holosonar::acquisition::{Instrument, MicArray, Sweep};
    ///
    /// let sweep = Sweep::stepped(10e3, 20e3, 100.0)?;
    /// let array = MicArray::rectangular([8, 8], [0.02, 0.02], DVec3::ZERO)?;
    /// let both = Instrument::new(sweep, array).with_sources(&[DVec3::ZERO, DVec3::X])?;
    /// assert_eq!((both.transmissions(), both.sources()), (2, vec![DVec3::ZERO, DVec3::X]));
    /// # Ok::<(), holosonar::error::Error>(())
    /// ```
    pub fn with_sources(self, sources: &[DVec3]) -> Result<Self> {
        let (Some((&source, further)), true) = (sources.split_first(), sources.len() <= MOST_SOURCES) else {
            let problem =
                format!("there are {} loudspeakers; 1 to {MOST_SOURCES} are possible", sources.len());
            return Err(Error::input("sources", problem));
        };
        Ok(Self {
            geometry: Geometry::FixedSource { source },
            further_sources: Arc::new(further.to_vec()),
            pair_sources: Arc::default(),
            ..self
        })
    }

    /// The loudspeakers in the order in which they sound, m; none for a scan, whose loudspeaker moves.
    pub fn sources(&self) -> Vec<DVec3> {
        match self.geometry {
            Geometry::FixedSource { source } => {
                std::iter::once(source).chain(self.further_sources.iter().copied()).collect()
            }
            Geometry::Monostatic | Geometry::Pair { .. } => Vec::new(),
        }
    }

    /// How often all frequencies are recorded at all microphones: once for each loudspeaker, or for a scan.
    pub fn transmissions(&self) -> usize {
        1 + self.further_sources.len()
    }

    /// The instrument of one transmission, which has one loudspeaker.
    ///
    /// # Panics
    /// If there are not so many.
    #[must_use]
    pub fn transmission(&self, index: usize) -> Self {
        self.some_transmissions(index..index + 1)
    }

    /// The instrument of neighbouring transmissions.
    ///
    /// # Panics
    /// If there are not so many, or none.
    pub(crate) fn some_transmissions(&self, which: Range<usize>) -> Self {
        let mut some = self.geometries().skip(which.start).take(which.len());
        let geometry = some.next().expect("there are so many");
        let further: Vec<DVec3> = some.map(|geometry| geometry.source_of(DVec3::ZERO)).collect();
        assert_eq!(1 + further.len(), which.len(), "there are so many");
        Self { geometry, further_sources: Arc::new(further), ..self.clone() }
    }

    /// The geometry of every transmission.
    pub(crate) fn geometries(&self) -> impl Iterator<Item = Geometry> + '_ {
        let further = self.further_sources.iter().map(|&source| Geometry::FixedSource { source });
        std::iter::once(self.geometry).chain(further)
    }

    /// Lower and upper corner of the box of the loudspeakers; `None` for a scan.
    pub(crate) fn source_bounds(&self) -> Option<(DVec3, DVec3)> {
        bounding_box(self.sources().into_iter())
    }

    /// From where a reflector is lit, m: the middle of the loudspeakers, or where that of a scan is in its middle.
    pub fn viewpoint(&self) -> DVec3 {
        let scanned = || self.geometry.viewpoint(self.array.centre());
        self.source_bounds().map_or_else(scanned, |(low, high)| low.midpoint(high))
    }

    /// Refuses several loudspeakers, which `place` cannot take together.
    pub(crate) fn need_one_source(&self, place: &str) -> Result<()> {
        if self.transmissions() == 1 {
            return Ok(());
        }
        let problem = format!(
            "takes the samples of one loudspeaker, and these are of {}, one after another; give a cube of each",
            self.transmissions()
        );
        Err(Error::input(place, problem))
    }

    /// Whether [`Instrument::equivalent`] is another instrument.
    pub(crate) fn has_virtual_array(&self) -> bool {
        self.transmissions() > 1 || matches!(self.geometry, Geometry::Pair { .. })
    }

    /// An instrument of one loudspeaker, or a monostatic scan, that sees far away what this one does: its microphones are
    /// all sums r + s of a microphone and a loudspeaker's offset from the middle of them, or the middles of a pair.
    ///
    /// The sum over loudspeakers and microphones of `e^{−ik(r + s)·p̂}` is the product of two sums, and one over all of those
    /// places, as multiple-input radar has it (Bliss & Forsythe 2003). Beyond 2²⁰ of them it is the microphones alone.
    /// Cost: that of sorting them.
    pub(crate) fn equivalent(&self) -> Cow<'_, Self> {
        if let Geometry::Pair { .. } = self.geometry {
            let half_way = |(i, r): (usize, &DVec3)| match self.pair_sources.get(i) {
                Some(source) => r.midpoint(*source),
                None => self.geometry.moving_middle(*r),
            };
            let moved = self.array.positions().iter().enumerate().map(half_way).collect();
            let array = match self.array.shape()[..] {
                [n_y, n_x] => MicArray::from_rows([n_y, n_x], moved),
                _ => MicArray::from_positions(moved),
            };
            let Ok(array) = array else { return Cow::Borrowed(self) };
            let pair_sources = Arc::default();
            return Cow::Owned(Self { geometry: Geometry::Monostatic, array, pair_sources, ..self.clone() });
        }
        if self.transmissions() == 1 {
            return Cow::Borrowed(self);
        }
        let source = self.viewpoint();
        let alone = Self {
            geometry: Geometry::FixedSource { source },
            further_sources: Arc::default(),
            ..self.clone()
        };
        if self.array.len().saturating_mul(self.transmissions()) > MOST_VIRTUAL {
            return Cow::Owned(alone);
        }
        let places = self
            .sources()
            .into_iter()
            .flat_map(|s| self.array.positions().iter().map(move |r| *r + (s - source)).collect::<Vec<_>>());
        match in_rows(places.collect()) {
            Ok(array) => Cow::Owned(Self { array, ..alone }),
            Err(_) => Cow::Owned(alone),
        }
    }
}

/// An array of these microphones, sorted by rows, so that a lattice is recognised.
fn in_rows(mut places: Vec<DVec3>) -> Result<MicArray> {
    places.sort_by(|a, b| a.y.total_cmp(&b.y));
    let mut rows: Vec<Vec<DVec3>> = Vec::new();
    for place in places {
        match rows.last_mut() {
            Some(row) if place.y - row[row.len() - 1].y < SAME_ROW => row.push(place),
            _ => rows.push(vec![place]),
        }
    }
    for row in &mut rows {
        row.sort_by(|a, b| a.x.total_cmp(&b.x));
    }
    let shape = [rows.len(), rows[0].len()];
    let even = rows.iter().all(|row| row.len() == shape[1]);
    let places = rows.concat();
    if even { MicArray::from_rows(shape, places) } else { MicArray::from_positions(places) }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;
    use crate::acquisition::Sweep;

    fn instrument(array: MicArray) -> Instrument {
        Instrument::new(Sweep::stepped(10e3, 12e3, 100.0).unwrap(), array)
    }

    #[test]
    fn sources_a_whole_array_apart_make_a_larger_lattice() {
        let (pitch, side) = (0.01, 0.08);
        let array = MicArray::rectangular([8, 8], [pitch; 2], DVec3::ZERO).unwrap();
        let sources: Vec<DVec3> =
            (0..16).map(|i| DVec3::new(f64::from(i % 4), f64::from(i / 4), 0.0) * side).collect();
        let several = instrument(array).with_sources(&sources).unwrap();
        let equivalent = several.equivalent();
        let lattice = equivalent.array.lattice().unwrap();
        assert_eq!((lattice.x.count, lattice.y.count, equivalent.transmissions()), (32, 32, 1));
        assert!((lattice.x.pitch - pitch).abs() < 1e-9);
        assert!((several.aperture().extent - equivalent.array.extent()).length() < 1e-9);
        // Half an array apart, places coincide, and there is no lattice.
        let close: Vec<DVec3> = sources.iter().map(|s| *s * 0.5).collect();
        assert!(several.with_sources(&close).unwrap().equivalent().array.lattice().is_none());
    }

    #[test]
    fn a_transmission_has_one_source_and_all_of_them_the_longest_paths() {
        let array = MicArray::from_positions(vec![DVec3::ZERO, DVec3::X]).unwrap();
        let sources = [DVec3::ZERO, DVec3::new(0.0, 2.0, 0.0)];
        let both = instrument(array).with_sources(&sources).unwrap();
        let box_of = (DVec3::new(-0.1, -0.1, 1.0), DVec3::new(0.1, 0.1, 1.2));
        let bounds = |i: usize| both.transmission(i).path_bounds_of(box_of);
        let all = both.path_bounds_of(box_of);
        assert_eq!(all, [bounds(0)[0].min(bounds(1)[0]), bounds(0)[1].max(bounds(1)[1])]);
        assert_eq!(both.transmission(1).sources(), [sources[1]]);
        assert_eq!(both.cube_bytes(), 2 * both.transmission(0).cube_bytes());
        assert!(both.with_sources(&[]).is_err());
    }

    #[test]
    fn a_pair_sees_like_a_scan_of_its_middle() {
        let array = MicArray::rectangular([5, 4], [0.02; 2], DVec3::ZERO).unwrap();
        let pair = instrument(array).with_geometry(Geometry::Pair { offset: DVec3::X * 0.1 });
        let scan = pair.equivalent();
        assert_eq!(scan.geometry, Geometry::Monostatic);
        assert!(scan.array.centre().distance(DVec3::X * 0.05) < 1e-12);
        assert_eq!(scan.array.lattice().unwrap().x.count, 5);
        assert!(pair.sources().is_empty());
    }
}
