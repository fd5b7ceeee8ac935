//! Eq. 13 at any points, by some of the microphones: the literal sum, by way of their range profiles.

use crate::acquisition::{CubeSource, Instrument, SweepTransform, columns};
use crate::alloc::try_zeroed;
use crate::error::{Error, Result};
use crate::grid::Grid;
use crate::progress::Observer;
use crate::reconstruct::ReconstructOptions;
use crate::reconstruct::volume::Gain;
use crate::wave::simd::phasors;
use glam::DVec3;
use num_complex::Complex32;
use rayon::prelude::*;

/// Values of a range profile for each frequency, between which it is interpolated linearly: within 8 % at the ends of the band.
pub(super) const FINER: usize = 4;

/// What some microphones heard.
pub(super) struct Listeners<'a> {
    instrument: Instrument,
    microphones: &'a [usize],
    /// Of each transmission, one per microphone.
    profiles: Vec<Vec<BandProfile>>,
    /// What spreading took, where it is given back.
    gain: Option<Gain>,
}

impl<'a> Listeners<'a> {
    /// Reads what these microphones heard.
    ///
    /// # Errors
    /// Those of reading the cube; [`Error::OutOfMemory`]; [`Error::Interrupted`].
    pub(super) fn by(
        microphones: &'a [usize],
        source: &mut dyn CubeSource,
        grid: &Grid,
        options: &ReconstructOptions,
        observer: &dyn Observer,
    ) -> Result<Self> {
        let instrument = source.instrument().clone();
        let tones = options.window.over_sweep(&instrument.sweep);
        let transform = SweepTransform::new(&instrument, &tones, FINER);
        let weights = options.window.over_array(&instrument.array);
        let weights: Vec<f64> = microphones.iter().map(|r| weights[*r]).collect();
        let all = weights.iter().sum::<f64>() * instrument.transmissions() as f64;
        let scale = instrument.detection.weight() / all;
        let profiles = (0..instrument.transmissions()).map(|transmission| {
            let columns = columns(source, transmission, microphones, observer)?;
            let columns = columns.par_chunks_exact(instrument.sweep.len()).zip(&weights);
            Ok(columns
                .map(|(column, weight)| BandProfile::new(&transform, column, weight * scale, &instrument))
                .collect())
        });
        let profiles = profiles.collect::<Result<_>>()?;
        let gain = options.compensate.then(|| Gain::new(&instrument, grid));
        Ok(Self { instrument, microphones, profiles, gain })
    }

    /// The power of Eq. 13 at every point.
    ///
    /// # Errors
    /// [`Error::OutOfMemory`] when a value for each does not fit.
    pub(super) fn powers(&self, points: &[DVec3]) -> Result<Vec<f32>> {
        let no_room = || Error::out_of_memory("points around the grid do not fit in memory");
        let mut powers = try_zeroed::<f32>(points.len() as u64).ok_or_else(no_room)?;
        let seen: Vec<Instrument> =
            (0..self.profiles.len()).map(|transmission| self.instrument.transmission(transmission)).collect();
        powers.par_iter_mut().zip(points).for_each_init(MicrophoneTerms::default, |terms, (power, p)| {
            terms.clear();
            for (instrument, profiles) in seen.iter().zip(&self.profiles) {
                for (profile, r) in profiles.iter().zip(self.microphones) {
                    terms.push(profile.at(instrument.path_length_at(*p, *r)));
                }
            }
            let gain = self.gain.map_or(1.0, |gain| gain.at(*p) as f32);
            *power = (terms.sum() * gain).norm_sqr();
        });
        Ok(powers)
    }
}

/// The terms of a sum over the microphones.
#[derive(Default)]
struct MicrophoneTerms {
    values: Vec<Complex32>,
    turns: Vec<f64>,
    phasors: Vec<Complex32>,
}

impl MicrophoneTerms {
    fn clear(&mut self) {
        self.values.clear();
        self.turns.clear();
    }

    fn push(&mut self, (value, turns): (Complex32, f64)) {
        self.values.push(value);
        self.turns.push(turns);
    }

    fn sum(&mut self) -> Complex32 {
        self.phasors.resize(self.turns.len(), Complex32::ZERO);
        phasors(-1.0, &self.turns, &mut self.phasors);
        self.values.iter().zip(&self.phasors).map(|(value, phasor)| value * phasor).sum()
    }
}

/// A range profile about the middle of its band, so that it is smooth from value to value.
struct BandProfile {
    values: Vec<Complex32>,
    /// From one value to the next, m of path.
    pitch: f64,
    /// The first frequency, and from there to the middle of the band, in cycles per m.
    waves: [f64; 2],
}

impl BandProfile {
    fn new(transform: &SweepTransform, column: &[Complex32], weight: f64, instrument: &Instrument) -> Self {
        let Instrument { sweep, sound_speed, .. } = instrument;
        let waves = [sweep.start() / sound_speed, 0.5 * sweep.bandwidth() / sound_speed];
        let pitch = transform.pitch;
        // The first one follows the last, as profiles repeat, but with another carrier.
        let paths: Vec<f64> = (0..=transform.len).map(|k| k as f64 * pitch).collect();
        let mut carrier = vec![Complex32::ZERO; paths.len()];
        phasors(waves[1], &paths, &mut carrier);
        let values = transform.of(column);
        let values = values.iter().chain(&values[..1]).zip(carrier);
        let narrow = |re: f64, im: f64| Complex32::new((re * weight) as f32, (im * weight) as f32);
        let values = values.map(|(value, carrier)| narrow(value.re, value.im) * carrier).collect();
        Self { values, pitch, waves }
    }

    /// The value at a path, m, and the cycles of its phase.
    #[inline]
    fn at(&self, path: f64) -> (Complex32, f64) {
        let place = path / self.pitch;
        let n = self.values.len() - 1;
        let within = place - (place / n as f64).floor() * n as f64;
        let first = (within as usize).min(n - 1);
        let part = (within - first as f64) as f32;
        let value = self.values[first] * (1.0 - part) + self.values[first + 1] * part;
        (value, self.waves[0] * path + self.waves[1] * within * self.pitch)
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;
    use crate::acquisition::{DataCube, Detection, MicArray};
    use crate::grid::Volume;
    use crate::progress::Silent;
    use crate::reconstruct::volume::fixtures::{axis, cube, instrument, scattered};
    use crate::reconstruct::{Method, Window, reconstruct};
    use crate::wave::Geometry;

    /// The amplitude of Eq. 13 at a voxel, term by term.
    fn literal(cube: &DataCube, grid: &Grid, options: &ReconstructOptions) -> Volume {
        reconstruct(cube, grid, &options.with_method(Method::Direct).with_tolerance(0.0)).unwrap().volume
    }

    #[test]
    fn what_is_heard_is_the_literal_sum() {
        let array = scattered(40);
        let fixed = instrument(array.clone());
        let offset = DVec3::new(0.1, 0.0, 0.0);
        let several = fixed.clone().with_sources(&[DVec3::ZERO, DVec3::new(0.3, 0.1, 0.0)]).unwrap();
        let instruments = [
            fixed.clone(),
            fixed.clone().with_detection(Detection::InPhase),
            fixed.clone().with_geometry(Geometry::Monostatic),
            fixed.with_geometry(Geometry::Pair { offset }),
            several,
        ];
        // Beyond the unambiguous path of 0.69 m, too.
        let grid = Grid { x: axis(-0.4, 0.13, 7), y: axis(-0.3, 0.17, 4), z: axis(0.4, 0.071, 6) };
        let points: Vec<DVec3> = (0..7 * 4 * 6).map(|i| grid.position(i % 7, i / 7 % 4, i / 28)).collect();
        for instrument in instruments {
            for (window, compensate) in [(Window::None, false), (Window::Taylor, true)] {
                let options = ReconstructOptions::new(Method::Auto, window).with_compensate(compensate);
                let cube = cube(instrument.clone());
                let all: Vec<usize> = (0..cube.instrument.array.len()).collect();
                let heard = Listeners::by(&all, &mut &cube, &grid, &options, &Silent).unwrap();
                let powers = heard.powers(&points).unwrap();
                let volume = literal(&cube, &grid, &options);
                let rms = |of: &mut dyn Iterator<Item = f64>| of.map(|x| x * x).sum::<f64>().sqrt();
                let exact = volume.samples.iter().map(|a| f64::from(a.norm()));
                let off = rms(&mut exact.clone().zip(&powers).map(|(a, p)| f64::from(*p).sqrt() - a));
                let share = off / rms(&mut exact.clone());
                assert!(share < 0.1, "{:?} {window} {share}", cube.instrument.geometry);
            }
        }
        // By some of them: the sum over these alone.
        let cube = cube(instrument(array));
        let some = [3, 11, 12, 30];
        let part =
            MicArray::from_positions(some.map(|r| cube.instrument.array.positions()[r]).to_vec()).unwrap();
        let samples = (0..9).flat_map(|f| some.map(|r| cube.frequency(f)[r])).collect();
        let part = DataCube::new(instrument(part), samples).unwrap();
        let options = ReconstructOptions::new(Method::Auto, Window::None);
        let heard = Listeners::by(&some, &mut &cube, &grid, &options, &Silent).unwrap();
        let powers = heard.powers(&points).unwrap();
        let volume = literal(&part, &grid, &options);
        for (power, sample) in powers.iter().zip(&volume.samples) {
            assert!((power.sqrt() - sample.norm()).abs() < 0.08, "{power} {sample}");
        }
    }
}
