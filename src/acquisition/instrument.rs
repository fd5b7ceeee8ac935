//! The instrument: the parameters of a measurement that formulas, plans and reconstructions need, without its samples.

mod changes;
mod codes;
mod pairs;
mod transmissions;

pub use changes::InstrumentChanges;
pub(crate) use codes::MOST_CODED;
pub use codes::{CodeKind, CodeReport, Decoding, SourceCode};
pub(crate) use transmissions::MOST_SOURCES;

use super::{Detection, MicArray, Sweep};
use crate::error::{Error, Result};
use crate::grid::Grid;
use crate::scene::FARTHEST;
use crate::wave::interval::PathInterval;
use crate::wave::{
    Aperture, DEFAULT_SOUND_SPEED, Geometry, Interface, MOST_WAVELENGTHS, Refraction, SOUND_SPEEDS,
    is_sound_speed,
};
use crate::with_fields::with_fields;
use glam::DVec3;
use std::ops::Range;
use std::sync::Arc;

/// How a measurement is made: frequencies, microphones, loudspeaker, detection and the speed of sound.
///
/// Clones are cheap: the lists of the sweep and of the array are shared.
///
/// # Example
/// A band of 10 kHz resolves ranges 17 mm apart:
/// ```
/// use holosonar::glam::DVec3;
/// use holosonar::acquisition::{Detection, Instrument, MicArray, Sweep};
/// use holosonar::wave::Geometry;
///
/// let sweep = Sweep::stepped(10e3, 20e3, 20.0)?;
/// let array = MicArray::rectangular([31, 31], [0.03, 0.03], DVec3::ZERO)?;
/// let instrument = Instrument::new(sweep, array);
/// assert_eq!(instrument.range_resolution(), Some(343.0 / 20e3));
///
/// // A colder room, and a loudspeaker beside the array:
/// let cold = instrument
///     .with_sound_speed(331.0)
///     .with_geometry(Geometry::FixedSource { source: DVec3::new(0.6, 0.0, 0.0) })
///     .with_detection(Detection::InPhase);
/// assert_eq!(cold.shortest_wavelength(), 331.0 / 20e3);
/// # Ok::<(), holosonar::error::Error>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Instrument {
    /// The frequencies f.
    pub sweep: Sweep,
    /// The microphones r.
    pub array: MicArray,
    /// Fixed speaker, of several the first, or a scan.
    pub geometry: Geometry,
    /// Where the loudspeaker is in the transmissions after the first, m; [`Instrument::with_sources`] sets both.
    pub further_sources: Arc<Vec<DVec3>>,
    /// Where the loudspeaker of each microphone is, m, if pairs of them are not all the same way apart; else empty.
    /// [`Instrument::with_pairs`] sets them, and the geometry.
    pub pair_sources: Arc<Vec<DVec3>>,
    /// Quadrature or in-phase.
    pub detection: Detection,
    /// c, m/s; within [`SOUND_SPEEDS`].
    pub sound_speed: f64,
    /// A plane beyond which sound has another speed, if there is one.
    pub interface: Option<Interface>,
}

with_fields! {
    Instrument {
        with_sweep(sweep: Sweep),
        with_array(array: MicArray),
        with_geometry(geometry: Geometry),
        with_detection(detection: Detection),
        with_sound_speed(sound_speed: f64),
        with_interface(interface: Option<Interface>),
    }
}

impl Instrument {
    /// Quadrature detection, the loudspeaker at the origin, and sound at [`DEFAULT_SOUND_SPEED`], 343 m/s.
    pub fn new(sweep: Sweep, array: MicArray) -> Self {
        Self {
            sweep,
            array,
            geometry: Geometry::ORIGIN,
            further_sources: Arc::default(),
            pair_sources: Arc::default(),
            detection: Detection::Quadrature,
            sound_speed: DEFAULT_SOUND_SPEED,
            interface: None,
        }
    }

    /// Rejects a speed of sound, a loudspeaker position or an interface with which no path has a phase.
    pub(crate) fn check(&self) -> Result<()> {
        self.check_pairs()?;
        self.check_interface()?;
        let c = self.sound_speed;
        if !is_sound_speed(c) {
            let [least, most] = SOUND_SPEEDS;
            let problem = format!("the speed of sound must be from {least} to {most:e} m/s, not {c}");
            return Err(Error::input("instrument", problem));
        }
        let centre = self.array.centre();
        for source in self.geometries().map(|geometry| geometry.source_of(centre)) {
            if source.is_nan() || source.abs().max_element() > FARTHEST {
                let problem = format!(
                    "the loudspeaker must be within {FARTHEST:e} m along each axis, not at {source} m"
                );
                return Err(Error::input("instrument", problem));
            }
        }
        let fixed = matches!(self.geometry, Geometry::FixedSource { .. });
        if fixed || self.further_sources.is_empty() {
            return Ok(());
        }
        Err(Error::input("instrument", "a scan moves its loudspeaker and has no further ones"))
    }

    fn check_interface(&self) -> Result<()> {
        let Some(Interface { depth, sound_speed }) = self.interface else { return Ok(()) };
        let (_, last) = self.array.bounds();
        let sources = self.geometries().map(|geometry| geometry.source_of(last).z);
        let nearest = sources.chain(self.pair_sources.iter().map(|s| s.z)).fold(last.z, f64::max);
        let problem = if !is_sound_speed(sound_speed) {
            let [least, most] = SOUND_SPEEDS;
            format!("the speed of sound beyond it must be from {least} to {most:e} m/s, not {sound_speed}")
        } else if !(depth > nearest && depth <= FARTHEST) {
            format!(
                "it is at z = {depth} m; array and loudspeaker, up to {nearest} m, must be before it, and it within \
                 {FARTHEST:e} m"
            )
        } else {
            return Ok(());
        };
        Err(Error::input("interface", problem))
    }

    /// Rejects what [`Instrument::check`] does, and a box of voxels or reflectors, m, that is too far away; `place` names
    /// it.
    pub(crate) fn check_with(&self, place: &str, (low, high): (DVec3, DVec3)) -> Result<()> {
        self.check()?;
        if low.is_nan() || high.is_nan() || low.abs().max(high.abs()).max_element() > FARTHEST {
            let problem = format!("{low} to {high} m reaches beyond {FARTHEST:e} m; lengths are in metres");
            return Err(Error::input(place, problem));
        }
        let [_, longest] = self.path_bounds_of((low, high));
        let wavelengths = longest / self.shortest_wavelength();
        if wavelengths <= MOST_WAVELENGTHS {
            return Ok(());
        }
        Err(Error::input(
            place,
            format!(
                "paths of {longest:.3e} m are {wavelengths:.1e} of the shortest wavelengths, {:.1e} m; up to \
                 {MOST_WAVELENGTHS:.0e} have an accurate phase: check the unit, the frequencies and the speed of sound",
                self.shortest_wavelength()
            ),
        ))
    }

    /// Wavelength at the centre of the band λ_c, m.
    pub fn wavelength(&self) -> f64 {
        self.aperture().wavelength()
    }

    /// Shortest wavelength λ_min, m.
    pub fn shortest_wavelength(&self) -> f64 {
        self.sound_speed / self.sweep.stop()
    }

    /// What of it decides how sharply a point is imaged. Several loudspeakers widen the array by their own extent, about
    /// the middle of them.
    pub fn aperture(&self) -> Aperture {
        if self.has_differing_pairs() {
            // Far away, that of a scan of the places half-way between.
            return self.equivalent().aperture();
        }
        let widened = self.source_bounds().map_or(DVec3::ZERO, |(low, high)| high - low);
        let geometry = match self.geometry {
            Geometry::FixedSource { .. } => Geometry::FixedSource { source: self.viewpoint() },
            scan => scan,
        };
        Aperture {
            sound_speed: self.sound_speed,
            band: [self.sweep.start(), self.sweep.stop()],
            centre: self.array.centre(),
            extent: self.array.extent() + widened,
            geometry,
            interface: self.interface,
        }
    }

    /// Length of the path speaker → `p` → microphone at `r`, m: that of a straight path of the same duration, where it
    /// crosses an interface. Where pairs are not all the same way apart, that of their mean offset: see
    /// [`Instrument::path_length_at`].
    #[inline]
    pub fn path_length(&self, p: DVec3, r: DVec3) -> f64 {
        match &self.interface {
            None => self.geometry.path_length(p, r),
            Some(interface) => interface.path_length(self.sound_speed, &self.geometry, p, r),
        }
    }

    /// The part of the path that does not depend on the microphone, likewise; 0 for a monostatic scan.
    #[inline]
    pub(crate) fn outward_length(&self, p: DVec3) -> f64 {
        match (&self.interface, self.geometry) {
            (Some(interface), Geometry::FixedSource { source }) => {
                interface.leg_length(self.sound_speed, source, p)
            }
            _ => self.geometry.outward_length(p),
        }
    }

    /// What paths do at the interface, tabulated to 10⁻⁷ of the shortest wave; `None` without one.
    pub(crate) fn refraction(&self) -> Option<Refraction> {
        let accuracy = 1e-7 * self.shortest_wavelength();
        self.interface.map(|interface| Refraction::new(&interface, self.sound_speed, accuracy))
    }

    /// Range resolution Δd = c/2B, m (Eq. 10); `None` for a single frequency.
    pub fn range_resolution(&self) -> Option<f64> {
        self.aperture().range_resolution()
    }

    /// Whether it is moved from place to place, rather than recorded by all microphones at once.
    pub fn is_scan(&self) -> bool {
        !matches!(self.geometry, Geometry::FixedSource { .. })
    }

    /// Bounds on the path lengths by way of a box of points: those of [`Geometry::path_bounds`], and with an interface the
    /// sums of the shortest and of the longest legs, over all transmissions.
    pub(crate) fn path_bounds_of(&self, points: (DVec3, DVec3)) -> [f64; 2] {
        let each = self.path_bounds_by_transmission(points).into_iter();
        each.reduce(|[low, high], [l, h]| [low.min(l), high.max(h)]).unwrap_or_default()
    }

    /// The same of every transmission by itself.
    fn path_bounds_by_transmission(&self, points: (DVec3, DVec3)) -> Vec<[f64; 2]> {
        let refraction = self.refraction();
        let bounds = |geometry: Geometry, microphones: (DVec3, DVec3)| match &refraction {
            None => geometry.path_bounds(points, microphones),
            Some(refraction) => refraction.path_bounds(&geometry, points, microphones),
        };
        if self.has_differing_pairs() {
            let pairs = self.array.positions().iter().enumerate();
            let each = pairs.map(|(i, r)| bounds(self.geometry_of(i), (*r, *r)));
            return each.reduce(|[low, high], [l, h]| [low.min(l), high.max(h)]).into_iter().collect();
        }
        self.geometries().map(|geometry| bounds(geometry, self.array.bounds())).collect()
    }

    /// Bounds on the path lengths between the voxels of a range of depths and the array: those of
    /// [`Geometry::path_bounds`].
    ///
    /// # Panics
    /// Without depths.
    pub(crate) fn path_interval(&self, grid: &Grid, depths: Range<usize>) -> PathInterval {
        self.path_interval_within(grid.box_of(depths))
    }

    /// The same of points between two corners.
    pub(crate) fn path_interval_within(&self, points: (DVec3, DVec3)) -> PathInterval {
        self.path_interval_of(self.path_bounds_of(points))
    }

    fn path_interval_of(&self, [shortest, longest]: [f64; 2]) -> PathInterval {
        PathInterval { shortest, longest, sound_speed: self.sound_speed }
    }

    /// The same of every transmission by itself.
    pub(crate) fn path_intervals(&self, points: (DVec3, DVec3)) -> Vec<PathInterval> {
        let each = self.path_bounds_by_transmission(points).into_iter();
        each.map(|bounds| self.path_interval_of(bounds)).collect()
    }

    /// Of the transmissions' intervals the longest.
    pub(crate) fn longest_path_interval(&self, points: (DVec3, DVec3)) -> PathInterval {
        let each = self.path_intervals(points).into_iter();
        let longest = each.max_by(|a, b| a.duration().total_cmp(&b.duration()));
        longest.expect("there is a transmission")
    }

    /// The same for all depths, m: minimum and maximum.
    pub fn path_bounds(&self, grid: &Grid) -> [f64; 2] {
        let all = self.path_interval(grid, 0..grid.z.count);
        [all.shortest, all.longest]
    }

    /// Bytes of all samples in memory, complex in single precision; saturates instead of overflowing.
    pub fn cube_bytes(&self) -> u64 {
        let tones = (self.sweep.len() as u64).saturating_mul(self.transmissions() as u64);
        tones.saturating_mul(self.array.len() as u64).saturating_mul(8)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::named::assert_names;

    #[test]
    fn positions_speeds_and_phases_have_bounds() {
        let array = MicArray::rectangular([3, 2], [0.02; 2], DVec3::ZERO).expect("valid");
        let good = Instrument::new(Sweep::stepped(10e3, 10.4e3, 100.0).expect("valid"), array);
        let room = (DVec3::new(-1.0, -1.0, 0.5), DVec3::splat(2.0));
        good.check_with("grid", room).expect("usual");
        for c in [5e-324, 1e-9, 0.0, -1.0, f64::NAN, 1e300] {
            let refused = good.clone().with_sound_speed(c).check_with("grid", room).expect_err("absurd");
            assert_names(refused.to_string(), &["speed of sound", "0.01"]);
        }
        for x in [1e15, f64::NAN, f64::NEG_INFINITY] {
            let source = Geometry::FixedSource { source: DVec3::new(x, 0.0, 0.0) };
            let refused = good.clone().with_geometry(source).check().expect_err("absurd");
            assert_names(refused.to_string(), &["loudspeaker", "1e9 m"]);
        }
        let far = |x: f64| good.check_with("grid", (DVec3::ZERO, DVec3::new(x, 0.0, 1.0)));
        assert_names(far(1.1e9).expect_err("far").to_string(), &["grid", "1e9 m"]);
        assert!(far(f64::NAN).is_err() && far(1e9).is_ok());
        let high = good.clone().with_sweep(Sweep::from_frequencies(vec![1e15]).expect("one"));
        assert_names(high.check_with("grid", room).expect_err("short").to_string(), &["1e11", "wavelengths"]);
    }

    #[test]
    fn clones_share_their_lists() {
        let array = MicArray::rectangular([3, 2], [0.02; 2], DVec3::ZERO).expect("valid");
        let instrument = Instrument::new(Sweep::stepped(10e3, 10.4e3, 100.0).expect("valid"), array);
        let clone = instrument.clone().with_sound_speed(340.0);
        assert!(std::ptr::eq(instrument.sweep.frequencies(), clone.sweep.frequencies()));
        assert!(std::ptr::eq(instrument.array.positions(), clone.array.positions()));
        assert_ne!(instrument, clone);
    }
}
