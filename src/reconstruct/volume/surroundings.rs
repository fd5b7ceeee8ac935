//! The strongest echo from outside a grid: where it is far above what a grid shows, the grid shows its sidelobes.

mod listeners;

use crate::acquisition::{CubeSource, Instrument};
use crate::error::Result;
use crate::grid::{Axis, Grid, VolumeView};
use crate::progress::{Observer, stage};
use crate::reconstruct::{Method, ReconstructOptions};
use crate::wave::Aperture;
use glam::DVec3;
use listeners::{FINER, Listeners};
use num_complex::Complex32;
use rayon::prelude::*;
use std::f64::consts::GOLDEN_RATIO;

/// Microphones that listen: their sidelobes are −24 dB on average. Of many loudspeakers that sound one after the other, fewer.
const MICROPHONES: usize = 256;
const FEWEST: usize = 16;

/// Arrays of fewer microphones have sidelobes that look like surfaces in any band, so that they always listen.
const SPARSE: usize = 1024;

/// Directions along x and along y, as their sines; and distances, 2 Δd apart since hardly an object is thinner, or this many.
const DIRECTIONS: usize = 41;
const CELLS: f64 = 2.0;
const DISTANCES: f64 = 128.0;

/// By how much the directions of one distance are shifted against those of the one before, in their distances: evenly spread over all
/// (Roberts' sequence), so that what is missed at one distance is met at the next.
const SHIFTS: [f64; 2] = [0.754_877_666, 0.569_840_291];

/// The strongest places, which are looked at more closely, and at how many around each: across, up and in depth.
const CLOSER: usize = 32;
const AROUND: [usize; 2] = [7, 5];

/// Of the power of all samples, what a volume shows at least if it is of what is in it: 1.3 and more without noise, but grating
/// lobes count as well.
const SHOWN: f64 = 0.5;

/// Whoever has paths as long as those of a grid: only such echoes reach into it, however far aside they are.
///
/// They are heard by Eq. 13 at a few points, by some of the microphones, with the window and the compensation of the grid's own
/// image, so that amplitudes compare.
#[derive(Debug, Clone)]
pub(crate) struct GridSurroundings {
    instrument: Instrument,
    aperture: Aperture,
    /// Half-way between array and loudspeakers, m.
    middle: DVec3,
    grid: Grid,
    options: ReconstructOptions,
    microphones: Vec<usize>,
}

impl GridSurroundings {
    /// Those of a grid; `None` where its image is not of Eq. 13, or directions or distances cannot be told apart.
    pub(crate) fn of(instrument: &Instrument, grid: &Grid, options: &ReconstructOptions) -> Option<Self> {
        let is_sum =
            options.refine.is_none() && ![Method::Correlation, Method::Linear].contains(&options.method);
        let aperture = instrument.aperture();
        if !is_sum || aperture.range_resolution().is_none() || aperture.extent.truncate().max_element() <= 0.0
        {
            return None;
        }
        // Profiles of uneven frequencies do not repeat, and paths may be longer than one of them.
        instrument.sweep.step()?;
        let count = (MICROPHONES / instrument.transmissions()).max(FEWEST);
        let microphones = scattered(count, instrument.array.len());
        let middle = aperture.centre.midpoint(instrument.viewpoint());
        let (instrument, grid, options) = (instrument.clone(), *grid, *options);
        Some(Self { instrument, aperture, middle, grid, options, microphones })
    }

    /// Bytes that listening takes beside the cube: samples and profiles of some microphones, and what is known of each place.
    pub(crate) fn bytes(&self) -> u64 {
        let Instrument { sweep, .. } = &self.instrument;
        let profiles = self.instrument.transmissions() * FINER + 1;
        let values = sweep.len() * self.microphones.len() * profiles * size_of::<Complex32>();
        let places = DIRECTIONS * DIRECTIONS * (DISTANCES as usize + 1);
        let each = size_of::<Bearing>() + size_of::<DVec3>() + size_of::<f32>() + size_of::<usize>();
        (values + places * each) as u64
    }

    /// Whether an image with this incoherent level may show sidelobes of what is outside: of an array with strong ones, or one that
    /// shows far less power than the samples have; what else they heard is outside, or noise.
    pub(crate) fn may_show(&self, volume: VolumeView<'_>, level: f64) -> bool {
        if self.instrument.array.len() < SPARSE {
            return true;
        }
        let aperture = &self.aperture;
        let Some(range) = aperture.range_resolution() else { return false };
        let Grid { x, y, z } = volume.grid;
        // Along an axis without extent all voxels show the same.
        let cells =
            |axis: Axis, cell: Option<f64>| cell.map_or(1.0 / axis.count as f64, |cell| axis.pitch / cell);
        let power = |(iz, plane): (usize, &[Complex32])| {
            let [across, up] = aperture.lateral_resolution(z.position(iz));
            let power: f64 = plane.iter().map(|sample| f64::from(sample.norm_sqr())).sum();
            power * cells(x, across) * cells(y, up) * z.pitch / range
        };
        let planes = volume.samples.par_chunks_exact(volume.grid.plane_len()).enumerate();
        // Added up in the same order by any number of threads.
        let shown: f64 = planes.map(power).collect::<Vec<_>>().iter().sum();
        let Instrument { sweep, array, .. } = &self.instrument;
        // A reflector of amplitude a has a² in every sample, and fills a cell.
        let samples = sweep.len() * array.len() * self.instrument.transmissions();
        shown < SHOWN * level * level * samples as f64
    }

    /// The amplitude of the strongest echo outside the grid.
    ///
    /// - Cost: a visit of the samples, and some 20 operations per point, microphone and transmission: 10⁸ to 10⁹ in all.
    ///
    /// # Errors
    /// Those of reading the cube; [`Error::OutOfMemory`]; [`Error::Interrupted`].
    pub(crate) fn loudest(&self, source: &mut dyn CubeSource, observer: &dyn Observer) -> Result<f64> {
        let heard = Listeners::by(&self.microphones, source, &self.grid, &self.options, observer)?;
        let hemispheres = self.hemispheres();
        let powers = |places: &[Bearing]| -> Result<Vec<f32>> {
            let points: Vec<DVec3> = places.iter().map(|place| self.point(place)).collect();
            stage(observer, "listening around the grid", 0, || heard.powers(&points))
        };
        let places = hemispheres.places().filter(|place| self.is_outside(place)).collect::<Vec<_>>();
        let first = powers(&places)?;
        let mut order: Vec<usize> = (0..places.len()).collect();
        order.sort_unstable_by(|a, b| first[*b].total_cmp(&first[*a]).then(a.cmp(b)));
        let best = order.iter().take(CLOSER).flat_map(|i| hemispheres.around(places[*i]));
        let closer = powers(&best.filter(|place| self.is_outside(place)).collect::<Vec<_>>())?;
        Ok(f64::from(first.into_iter().chain(closer).fold(0.0, f32::max)).sqrt())
    }

    /// All over the half-space before the array, as far as paths are as long as those of the grid: to the nearest and farthest
    /// microphone they differ by up to the array's extent. Along an axis along which the array has no extent directions cannot be told
    /// apart.
    fn hemispheres(&self) -> Hemispheres {
        let Self { instrument, aperture, grid, .. } = self;
        let extent = aperture.extent;
        let margin = 0.25 * extent.length();
        let [near, far] = instrument.path_bounds(grid).map(|path| 0.5 * path);
        let cell = aperture.range_resolution().unwrap_or(far);
        let near = (near - margin).max(cell);
        let far = (far + margin).max(near);
        let count = ((far - near) / (CELLS * cell)).ceil().min(DISTANCES) as usize + 1;
        let distances = Axis { first: near, pitch: (far - near) / (count - 1).max(1) as f64, count };
        Hemispheres {
            distances,
            directions: [extent.x, extent.y].map(|d| if d > 0.0 { DIRECTIONS } else { 1 }),
        }
    }

    /// Where a place is, m; along an axis along which the array has no extent, in the middle of the grid.
    fn point(&self, &Bearing { u, v, distance }: &Bearing) -> DVec3 {
        let Self { aperture: Aperture { extent, .. }, middle, grid, .. } = self;
        let mut p = *middle + distance * DVec3::new(u, v, (1.0 - u * u - v * v).max(0.0).sqrt());
        let (low, high) = grid.bounds();
        for axis in (0..2).filter(|axis| extent[*axis] <= 0.0) {
            p[axis] = low[axis].midpoint(high[axis]);
        }
        p
    }

    /// Whether a place is before the array, and not in the grid.
    fn is_outside(&self, place: &Bearing) -> bool {
        let (p, grid) = (self.point(place), &self.grid);
        let inside = [(grid.x, p.x), (grid.y, p.y), (grid.z, p.z)];
        place.u * place.u + place.v * place.v < 1.0
            && !inside.iter().all(|(axis, at)| axis.index_of(*at).is_some())
    }
}

/// A place as the array sees it: sines of its direction along x and y, and its distance, m.
#[derive(Debug, Clone, Copy)]
struct Bearing {
    u: f64,
    v: f64,
    distance: f64,
}

/// Directions, for each of some distances.
struct Hemispheres {
    distances: Axis,
    /// How many sines along x and y.
    directions: [usize; 2],
}

impl Hemispheres {
    fn places(&self) -> impl Iterator<Item = Bearing> + '_ {
        let sines = |count: usize, shift: f64| {
            // The only one is straight ahead.
            let shift = if count > 1 { shift.fract() } else { 0.5 };
            (0..count).map(move |i| 2.0 * (i as f64 + shift) / count as f64 - 1.0)
        };
        self.distances.positions().enumerate().flat_map(move |(i, distance)| {
            let [across, up] = SHIFTS.map(|shift| shift * i as f64);
            let [columns, rows] = self.directions;
            sines(rows, up).flat_map(move |v| sines(columns, across).map(move |u| Bearing { u, v, distance }))
        })
    }

    /// Places around one, up to half-way to the next ones.
    fn around(&self, Bearing { u, v, distance }: Bearing) -> impl Iterator<Item = Bearing> + use<> {
        let spread = |count: usize, pitch: f64| {
            let half = if pitch > 0.0 { count / 2 } else { 0 };
            (0..=2 * half).map(move |i| (i as f64 - half as f64) / count as f64 * pitch)
        };
        let [across, up] = self.directions.map(|count| if count > 1 { 2.0 / count as f64 } else { 0.0 });
        let along = self.distances.pitch;
        let [lateral, radial] = AROUND;
        spread(lateral, across).flat_map(move |du| {
            spread(lateral, up).flat_map(move |dv| {
                spread(radial, along).map(move |dr| Bearing { u: u + du, v: v + dv, distance: distance + dr })
            })
        })
    }
}

/// So many numbers below `all`, ascending, or all of them: by the golden ratio, which repeats no column of a lattice.
fn scattered(count: usize, all: usize) -> Vec<usize> {
    if all <= count {
        return (0..all).collect();
    }
    let number = |i: usize| (((i as f64 + 0.5) / GOLDEN_RATIO).fract() * all as f64) as usize;
    let mut some: Vec<usize> = (0..count).map(number).collect();
    some.sort_unstable();
    some.dedup();
    some
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;
    use crate::acquisition::{DataCube, MicArray, Sweep};
    use crate::progress::Silent;
    use crate::reconstruct::volume::fixtures::axis;
    use crate::reconstruct::{RefineOptions, Solver, Window, reconstruct};
    use crate::wave::phasor;

    fn instrument(count: [usize; 2]) -> Instrument {
        let array = MicArray::rectangular(count, [0.03; 2], DVec3::ZERO).unwrap();
        Instrument::new(Sweep::stepped(8_000.0, 16_000.0, 50.0).unwrap(), array)
    }

    /// What is heard of a patch of points of scattered phases about a place, each of amplitude 1.
    fn patch(instrument: &Instrument, place: DVec3) -> DataCube {
        let at = |i: usize| place + 0.01 * DVec3::new((i % 16) as f64, (i / 16) as f64, 0.3 * (i % 5) as f64);
        let points: Vec<DVec3> = (0..256).map(at).collect();
        let waves = instrument.sweep.frequencies().iter().map(|f| f / instrument.sound_speed);
        let sample = |(wave, r): (f64, DVec3)| -> Complex32 {
            let cycles = |(i, p): (usize, &DVec3)| {
                wave * instrument.path_length(*p, r) + (i as f64 * 0.754_877_67).sin() * 91.7
            };
            points.iter().enumerate().map(|point| phasor(cycles(point))).sum()
        };
        let each = waves.flat_map(|wave| instrument.array.positions().iter().map(move |r| (wave, *r)));
        DataCube::new(instrument.clone(), each.map(sample).collect()).unwrap()
    }

    #[test]
    fn what_is_outside_is_heard_and_what_is_inside_is_not() {
        let grid = Grid { x: axis(-0.3, 0.015, 41), y: axis(-0.3, 0.015, 41), z: axis(1.0, 0.01, 41) };
        let options = ReconstructOptions::new(Method::Auto, Window::None);
        for count in [[24, 24], [40, 1]] {
            let instrument = instrument(count);
            let around = GridSurroundings::of(&instrument, &grid, &options).unwrap();
            // An array without height hears all that is as far from its line as if it were before it.
            let inside = DVec3::new(0.05, -0.02, 1.2);
            let all =
                [inside, DVec3::new(0.7, 0.0, 1.0), DVec3::new(-0.5, 0.0, 1.3), DVec3::new(0.05, 0.0, 0.8)];
            let levels = all.map(|place| around.loudest(&mut &patch(&instrument, place), &Silent).unwrap());
            // What is heard of each against a fine image of where it is, by all microphones.
            for (place, level) in all.into_iter().zip(levels) {
                let around = |at: f64, pitch: f64| axis(at - 0.05, pitch, (0.25 / pitch) as usize);
                let fine =
                    Grid { x: around(place.x, 0.01), y: around(place.y, 0.01), z: around(place.z, 0.005) };
                let peak = reconstruct(&patch(&instrument, place), &fine, &options).unwrap().volume.peak();
                let share = level / f64::from(peak);
                let expected = if place == inside { 0.0..0.3 } else { 0.6..1.3 };
                assert!(expected.contains(&share), "{count:?} {place} {level} {share}");
            }
            // And their power is nowhere in the grid.
            for (place, expected) in all.into_iter().zip([false, true, true, true]) {
                let image = reconstruct(&patch(&instrument, place), &grid, &options).unwrap();
                let level = image.incoherent_level.unwrap();
                let shown = around.may_show(image.volume.view(), level);
                assert_eq!(shown, expected || instrument.array.len() < SPARSE, "{count:?} {place}");
            }
        }
    }

    #[test]
    fn what_is_not_of_eq_13_or_without_directions_and_distances_has_no_surroundings() {
        let grid = Grid { x: axis(-0.3, 0.1, 7), y: axis(-0.3, 0.1, 7), z: axis(1.0, 0.1, 4) };
        let options = ReconstructOptions::new(Method::Auto, Window::None);
        let (array, single) = (instrument([8, 8]), instrument([1, 1]));
        let uneven = array.clone().with_sweep(Sweep::from_frequencies(vec![9e3, 9.1e3, 9.5e3]).unwrap());
        let tone = array.clone().with_sweep(Sweep::from_frequencies(vec![9e3]).unwrap());
        assert!(GridSurroundings::of(&array, &grid, &options).is_some());
        for none in [&single, &tone, &uneven] {
            assert!(GridSurroundings::of(none, &grid, &options).is_none());
        }
        let refined = options.with_refine(Some(RefineOptions::new(Solver::Cgls)));
        for none in [refined, options.with_method(Method::Linear), options.with_method(Method::Correlation)] {
            assert!(GridSurroundings::of(&array, &grid, &none).is_none());
        }
    }

    #[test]
    fn the_listening_microphones_are_spread_over_the_array() {
        assert_eq!(scattered(256, 9), (0..9).collect::<Vec<_>>());
        for side in [20, 63, 64, 256] {
            let some = scattered(256, side * side);
            assert!(some.windows(2).all(|pair| pair[0] < pair[1]) && some.len() > 220, "{side}");
            for quarter in 0..4 {
                let rows = some.iter().filter(|r| *r / side * 4 / side == quarter).count();
                let columns = some.iter().filter(|r| *r % side * 4 / side == quarter).count();
                assert!(rows > 45 && columns > 40, "{side} {quarter} {rows} {columns}");
            }
        }
    }
}
