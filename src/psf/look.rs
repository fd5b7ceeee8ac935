//! The image of one point: lines, planes and boxes of voxels, and what is measured on them.

use super::{Lobe, MeasuredGratingLobe, PlaneCut, Width};
use crate::acquisition::{DataCube, Instrument};
use crate::error::Result;
use crate::grid::{Axis, Grid, Volume};
use crate::plan::beam::Beam;
use crate::reconstruct::{Method, ReconstructOptions, estimate, reconstruct};
use glam::{DVec2, DVec3};

/// Voxels of a line to either side of the peak per predicted half width, and half widths that it reaches.
const FINENESS: f64 = 16.0;
const LINE_REACH: f64 = 4.0;

/// Pixels of a cut to either side of the peak, and −3 dB widths that it reaches.
const CUT_REACH: usize = 64;
const CUT_WIDTHS: f64 = 5.0;

/// Range cells before and behind a point's own range in which sidelobes are searched for.
const RANGE_CELLS: f64 = 8.0;

/// Most voxels in which sidelobes are searched for; a larger box has coarser ones.
const MOST_VOXELS: f64 = 4e6;

/// A point, its data, and what is needed to image it.
pub(super) struct Look<'a> {
    /// The array as which the instrument sees.
    pub(super) seen: &'a Instrument,
    pub(super) options: &'a ReconstructOptions,
    pub(super) cube: DataCube,
    pub(super) p: DVec3,
    pub(super) amplitude: f64,
    pub(super) beam: Beam,
    /// Predicted −3 dB widths, and substitutes where there are none, m.
    pub(super) scale: DVec3,
}

/// Voxels about a point, `reach` of them to either side.
pub(super) fn cube_grid(p: DVec3, pitch: DVec3, reach: [usize; 3]) -> Grid {
    let axis = |i: usize| {
        // Nothing behind the array can be imaged.
        let before = if i == 2 { reach[2].min((p.z / pitch.z - 1e-6).max(0.0) as usize) } else { reach[i] };
        Axis { first: p[i] - pitch[i] * before as f64, pitch: pitch[i], count: before + reach[i] + 1 }
    };
    Grid { x: axis(0), y: axis(1), z: axis(2) }
}

impl Look<'_> {
    /// The volume on a grid, by whichever method is least work: on a fine plane, unlike in a large box, that may be
    /// back-projection even where convolution is possible.
    pub(super) fn image(&self, grid: &Grid) -> Result<Volume> {
        let mut options = *self.options;
        if options.method == Method::Auto && options.tolerance > 0.0 {
            let tried = ReconstructOptions { method: Method::Backprojection, ..options };
            let estimates = estimate(&self.cube.instrument, grid, &tried, 1)?;
            let exact =
                estimates.methods.iter().filter(|e| e.obstacle.is_none() && e.method != Method::Linear);
            let least = exact.min_by(|a, b| a.operations.total_cmp(&b.operations));
            options.method = least.map_or(Method::Auto, |e| e.method);
        }
        Ok(reconstruct(&self.cube, grid, &options)?.volume)
    }

    /// Amplitude in dB against that at the point.
    fn decibels(&self, amplitude: f32) -> f64 {
        20.0 * (f64::from(amplitude) / self.amplitude).max(1e-10).log10()
    }

    /// Widths along an axis, on a fine line through the point.
    pub(super) fn line(&self, axis: usize, predicted: &[[Option<f64>; 3]; 2]) -> Result<Width> {
        let mut width = Width {
            at_3_db: None,
            predicted_at_3_db: predicted[0][axis],
            at_6_db: None,
            predicted_at_6_db: predicted[1][axis],
        };
        if predicted[0][axis].is_none() {
            return Ok(width);
        }
        let pitch = 0.5 * self.scale[axis] / FINENESS;
        let mut reach = [0; 3];
        reach[axis] = (FINENESS * LINE_REACH) as usize;
        let grid = cube_grid(self.p, DVec3::splat(pitch), reach);
        let line: Vec<f32> = self.image(&grid)?.samples.iter().map(|a| a.norm()).collect();
        (width.at_3_db, width.at_6_db) = (full_width(&line, pitch, 3.0), full_width(&line, pitch, 6.0));
        Ok(width)
    }

    /// The plane of two axes through the point.
    pub(super) fn cut(&self, name: &'static str, across: usize, down: usize) -> Result<PlaneCut> {
        let pitch = self.scale * (CUT_WIDTHS / CUT_REACH as f64);
        let mut reach = [0; 3];
        (reach[across], reach[down]) = (CUT_REACH, CUT_REACH);
        let grid = cube_grid(self.p, pitch, reach);
        let volume = self.image(&grid)?;
        let axes = [grid.x, grid.y, grid.z];
        let decibels = volume.samples.iter().map(|a| self.decibels(a.norm()) as f32).collect();
        Ok(PlaneCut { name, columns: axes[across], rows: axes[down], decibels })
    }

    /// Direction sines at the array's centre, and the range that a path through it has, halved.
    fn polar(&self, q: DVec3) -> (DVec2, f64) {
        let centre = self.seen.array.centre();
        let direction = (q - centre).normalize_or_zero();
        (direction.truncate(), 0.5 * self.seen.path_length(q, centre))
    }

    /// The point at other direction sines and the same range; `None` where no such direction exists.
    fn at_sines(&self, sines: DVec2) -> Option<DVec3> {
        let centre = self.seen.array.centre();
        let across = sines.length_squared();
        if across > 0.98 {
            return None;
        }
        let direction = sines.extend((1.0 - across).sqrt());
        let wanted = self.polar(self.p).1;
        // The path grows with the distance: halve the interval.
        let (mut near, mut far) = (0.0, 4.0 * wanted + 1.0);
        for _ in 0..60 {
            let middle = f64::midpoint(near, far);
            if self.polar(centre + middle * direction).1 < wanted { near = middle } else { far = middle }
        }
        Some(centre + near * direction)
    }

    /// Where a grating lobe of the far field's offset lies as near as the point is: there its paths differ from the point's by the
    /// same slope along the array, in the mean over the weighted microphones instead of at their centre.
    fn grating_lobe_at(&self, u: DVec2, offset: DVec2) -> Option<DVec3> {
        let Instrument { array, geometry, .. } = self.seen;
        let weights = self.options.window.over_array(array);
        let axis = offset.normalize_or_zero().extend(0.0);
        let places: Vec<f64> = array.positions().iter().map(|r| axis.dot(*r - array.centre())).collect();
        let spread: f64 = places.iter().zip(&weights).map(|(x, w)| w * x * x).sum();
        let mut sines = u + offset;
        for _ in 0..6 {
            let q = self.at_sines(sines)?;
            let path = |r: &DVec3| geometry.path_length(q, *r) - geometry.path_length(self.p, *r);
            let slope = array.positions().iter().zip(&weights).zip(&places);
            let slope: f64 = slope.map(|((r, w), x)| w * x * path(r)).sum::<f64>() / spread;
            let missing = offset.length() + slope / geometry.scanned_legs();
            sines += missing * axis.truncate();
        }
        self.at_sines(sines)
    }

    /// How far the grid reaches from the point's direction sines, at the point's range.
    pub(super) fn reach(&self, scene: &Grid) -> [f64; 2] {
        let centre = self.seen.array.centre();
        let distance = self.p.distance(centre);
        let sines = (self.p - centre) / distance;
        let reach = |axis: &Axis, centre: f64, sine: f64| {
            let ends =
                [axis.first, axis.last()].map(|end| ((end - centre) / distance).clamp(-1.0, 1.0) - sine);
            ends[0].abs().max(ends[1].abs())
        };
        [reach(&scene.x, centre.x, sines.x), reach(&scene.y, centre.y, sines.y)]
    }

    /// Half the main lobe's depth in range, m.
    fn range_lobe(&self) -> f64 {
        let outwards = (self.p - self.seen.array.centre()).normalize_or_zero();
        let profile = self.seen.profile(self.p, outwards, self.options.window);
        profile.and_then(|profile| profile.main_lobe()).map_or(f64::INFINITY, |lobe| 1.15 * lobe)
    }

    /// The strongest sidelobe in range alone, dB.
    pub(super) fn range_sidelobe_db(&self) -> Option<f64> {
        let outwards = (self.p - self.seen.array.centre()).normalize_or_zero();
        let profile = self.seen.profile(self.p, outwards, self.options.window)?;
        let lobe = profile.main_lobe()?;
        let strongest =
            (0..200).map(|i| profile.amplitude(lobe * (1.0 + f64::from(i) * 0.02))).fold(0.0, f64::max);
        Some(20.0 * strongest.max(1e-10).log10())
    }

    /// The strongest place outside the main lobe, the mean power there, and the box from the front.
    pub(super) fn sidelobes(&self, scene: &Grid) -> Result<(Option<Lobe>, Option<f64>, PlaneCut)> {
        let instrument = self.seen;
        let cell = instrument.range_resolution().unwrap_or(self.scale.z);
        let shell = self.polar(self.p).1;
        let depths = scene.corners().map(|q| self.shell_depth(q.truncate(), shell)).into_iter().flatten();
        let (near, far) =
            depths.chain([self.p.z]).fold((f64::INFINITY, 0.0_f64), |(n, f), z| (n.min(z), f.max(z)));
        let advised = instrument.advised_pitch(near.max(0.1 * self.p.z));
        let finest = self.seen.array.extent().max_element().max(instrument.wavelength());
        let mut pitch = [advised[0].min(finest), advised[1].min(finest), 0.5 * cell];
        let ends = [
            [scene.x.first.min(self.p.x), scene.x.last().max(self.p.x)],
            [scene.y.first.min(self.p.y), scene.y.last().max(self.p.y)],
            [(near - RANGE_CELLS * cell).max(0.25 * near), far + RANGE_CELLS * cell],
        ];
        let count =
            |pitch: [f64; 3]| -> f64 { (0..3).map(|i| (ends[i][1] - ends[i][0]) / pitch[i] + 1.0).product() };
        let coarser = (count(pitch) / MOST_VOXELS).cbrt().max(1.0);
        pitch = pitch.map(|pitch| pitch * coarser);
        let axis =
            |i: usize| Axis::spanning(ends[i][0], ends[i][1], pitch[i]).map_err(|error| error.at("psf"));
        let grid = Grid { x: axis(0)?, y: axis(1)?, z: axis(2)? };
        let volume = self.image(&grid)?;
        let (u, _) = self.polar(self.p);
        let lobe = self.range_lobe();
        let mut front = vec![0.0_f32; grid.plane_len()];
        let (mut best, mut at, mut power, mut outside) = (0.0_f32, DVec3::ZERO, 0.0, 0_u64);
        for iz in 0..grid.z.count {
            for (i, sample) in volume.plane(iz).iter().enumerate() {
                let amplitude = sample.norm();
                front[i] = front[i].max(amplitude);
                let q = grid.position(i % grid.x.count, i / grid.x.count, iz);
                let (v, range) = self.polar(q);
                if self.beam.is_main_lobe(v - u) && (range - shell).abs() < lobe {
                    continue;
                }
                (power, outside) = (power + f64::from(amplitude).powi(2), outside + 1);
                // Of those that symmetry makes equal the first, however they are rounded.
                if amplitude > best * 1.0001 {
                    (best, at) = (amplitude, q);
                }
            }
        }
        let decibels = front.iter().map(|a| self.decibels(*a) as f32).collect();
        let front = PlaneCut { name: "front", columns: grid.x, rows: grid.y, decibels };
        if outside == 0 {
            return Ok((None, None, front));
        }
        let mean = 10.0 * (power / outside as f64 / self.amplitude.powi(2)).max(1e-20).log10();
        let peak = Lobe { level_db: self.decibels(best), position: at.to_array() };
        Ok((Some(peak), Some(mean), front))
    }

    /// The depth at which a column crosses the point's shell of equal range, m.
    fn shell_depth(&self, column: DVec2, shell: f64) -> Option<f64> {
        let (mut near, mut far) = (0.0, 2.0 * shell + 1.0);
        if self.polar(column.extend(near)).1 > shell {
            return None;
        }
        for _ in 0..50 {
            let middle = f64::midpoint(near, far);
            if self.polar(column.extend(middle)).1 < shell { near = middle } else { far = middle }
        }
        Some(near)
    }

    /// Every grating lobe in front of the array, predicted and measured.
    pub(super) fn grating_lobes(&self, scene: &Grid) -> Result<Vec<MeasuredGratingLobe>> {
        let (u, _) = self.polar(self.p);
        let mut found = Vec::new();
        for grating_lobe in self.beam.grating_lobes([2.0; 2]) {
            for side in [1.0, -1.0] {
                let Some(place) = self.grating_lobe_at(u, side * DVec2::from(grating_lobe.offset)) else {
                    continue;
                };
                let predicted = Lobe { level_db: grating_lobe.level_db, position: place.to_array() };
                let measured = self.strongest_near(place, grating_lobe.axis)?;
                let lateral = |lobe: &Lobe| (DVec3::from(lobe.position) - self.p).truncate().length();
                let corners = scene.corners();
                found.push(MeasuredGratingLobe {
                    axis: grating_lobe.axis,
                    order: side as i32 * grating_lobe.order,
                    offset: [lateral(&predicted), lateral(&measured)],
                    in_grid: place.cmpge(corners[0]).all() && place.cmple(corners[7]).all(),
                    predicted,
                    measured,
                });
            }
        }
        Ok(found)
    }

    /// The largest amplitude near a predicted grating lobe: within an eighth of its offset along the axis, and as far in depth as
    /// the curvature of the waves may shift it.
    fn strongest_near(&self, place: DVec3, axis: usize) -> Result<Lobe> {
        let cell = self.seen.range_resolution().unwrap_or(self.scale.z);
        let offset = (place - self.p).truncate().length();
        let mut reach =
            DVec3::new(self.scale.x, self.scale.y, (3.0 * cell).max(0.05 * place.z).min(0.3 * place.z));
        reach[axis] = (0.125 * offset).max(self.scale[axis]);
        let pitch = DVec3::new(0.3 * self.scale.x, 0.3 * self.scale.y, 0.25 * cell);
        let mut best = (0.0, place);
        for (centre, reach, pitch) in [(None, reach, pitch), (Some(()), pitch, 0.2 * pitch)] {
            let centre = centre.map_or(place, |()| best.1);
            let counts = (reach / pitch).ceil().min(DVec3::new(60.0, 60.0, 200.0));
            let grid =
                cube_grid(centre, reach / counts, [counts.x as usize, counts.y as usize, counts.z as usize]);
            let volume = self.image(&grid)?;
            for (i, sample) in volume.samples.iter().enumerate() {
                if sample.norm() > best.0 {
                    let (row, ix) = (i / grid.x.count, i % grid.x.count);
                    best = (sample.norm(), grid.position(ix, row % grid.y.count, row / grid.y.count));
                }
            }
        }
        Ok(Lobe { level_db: self.decibels(best.0), position: best.1.to_array() })
    }
}

/// Full width `below_db` dB below the largest of a line of samples, interpolated linearly, m; `None` where the line ends
/// before it falls so far.
fn full_width(line: &[f32], pitch: f64, below_db: f64) -> Option<f64> {
    let peak = (0..line.len()).max_by(|a, b| line[*a].total_cmp(&line[*b]))?;
    let level = line[peak] * 10_f32.powf(-below_db as f32 / 20.0);
    let crossing = |samples: &mut dyn Iterator<Item = f32>| {
        let mut before = line[peak];
        for (i, sample) in samples.enumerate() {
            if sample < level {
                return Some(i as f64 + f64::from((before - level) / (before - sample)));
            }
            before = sample;
        }
        None
    };
    let right = crossing(&mut line[peak + 1..].iter().copied())?;
    let left = crossing(&mut line[..peak].iter().rev().copied())?;
    Some((left + right) * pitch)
}
