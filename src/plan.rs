//! What a job will resolve, alias and need, before anything runs.
//!
//! Takes the array, the sweep and the grid; gives resolutions, ambiguity, aliasing verdicts and bytes, all from
//! closed formulas; `estimate_job` adds what it takes of the machine. A broken design rule is a warning,
//! not an error, because the paper studies aliasing on purpose; only what cannot fit in memory is refused.
//!
//! # Example
//! 64 × 64 microphones 16 mm apart, 10 to 20 kHz, a metre away:
//! ```
//! use holosonar::glam::DVec3;
//! use holosonar::acquisition::{Instrument, MicArray, Sweep};
//! use holosonar::grid::{Axis, Grid};
//! use holosonar::plan::plan;
//!
//! let sweep = Sweep::stepped(10e3, 20e3, 20.0)?;
//! let array = MicArray::rectangular([64, 64], [0.016, 0.016], DVec3::ZERO)?;
//! let instrument = Instrument::new(sweep, array);
//! let lateral = Axis::spanning(-0.5, 0.5, 0.01)?;
//! let grid = Grid { x: lateral, y: lateral, z: Axis::spanning(1.0, 2.0, 0.005)? };
//! let plan = plan(&instrument, &grid);
//! assert_eq!(plan.range_resolution, Some(343.0 / 20_000.0)); // c/2B
//! assert_eq!(plan.unambiguous_path, Some(343.0 / 20.0)); // c/δf
//! assert_eq!(plan.cube_bytes, 501 * 64 * 64 * 8);
//! # Ok::<(), holosonar::error::Error>(())
//! ```

mod acquisition_time;
pub mod beam;
pub mod design;
mod estimate;
mod memory;
mod plausibility;
mod resolution;
mod smear;
mod suggest;
mod virtual_array;

pub(crate) use acquisition_time::TypedTimes;
pub use acquisition_time::{AcquisitionTime, ToneTime};
pub(crate) use beam::near_sidelobe_db;
pub use design::{Design, design};
pub(crate) use estimate::{JobArrays, JobEstimate, estimate_job, seconds_of};
pub use estimate::{JobStage, MemoryEstimate, MemoryItem};
pub(crate) use memory::{address_space, memory_limit};
pub use resolution::Profile;
pub use smear::Smear;
pub use virtual_array::VirtualArray;

use crate::acquisition::{Detection, Instrument};
use crate::grid::{Axis, Grid};
use glam::DVec3;
use serde::Serialize;

impl Instrument {
    /// Lateral resolution λ_c z/D along x and y at depth `z`, m: [`Aperture::lateral_resolution`](crate::wave::Aperture).
    pub fn lateral_resolution(&self, z: f64) -> [Option<f64>; 2] {
        self.aperture().lateral_resolution(z)
    }

    /// Largest path length that is not ambiguous, m: c/δf in quadrature (as a span), c/2δf in phase.
    ///
    /// Eq. 11 gives c/2δf for real data as a *path*; a one-way range is half of either.
    pub fn unambiguous_path(&self) -> Option<f64> {
        let halves = if self.detection == Detection::InPhase { 2.0 } else { 1.0 };
        self.sweep.step().filter(|_| self.sweep.len() > 1).map(|step| self.sound_speed / (halves * step))
    }

    /// The length that [`Instrument::unambiguous_path`] bounds, of paths between `shortest` and `longest`, m: their span in
    /// quadrature, the longest in phase.
    pub fn ambiguous_length(&self, [shortest, longest]: [f64; 2]) -> f64 {
        match self.detection {
            Detection::Quadrature => longest - shortest,
            Detection::InPhase => longest,
        }
    }

    /// Voxel pitch along x, y, z, m: at most half a resolution cell laterally and half of Δd in depth,
    /// and on the array's lattice where it has one.
    pub fn advised_pitch(&self, nearest_z: f64) -> [f64; 3] {
        let half_cell = self.lateral_resolution(nearest_z);
        let lateral = |axis: Option<&Axis>, cell: Option<f64>| {
            let most = cell.map_or(self.wavelength(), |cell| 0.5 * cell);
            match axis {
                Some(axis) if axis.count > 1 => axis.pitch / (axis.pitch / most).ceil().max(1.0),
                _ => most,
            }
        };
        let lattice = self.array.lattice();
        [
            lateral(lattice.map(|l| &l.x), half_cell[0]),
            lateral(lattice.map(|l| &l.y), half_cell[1]),
            self.range_resolution().map_or(self.wavelength(), |cell| 0.5 * cell),
        ]
    }

    /// Spacing of reflectors, m: half a centre wavelength or half the lateral resolution, whichever is less; for a
    /// mirror a quarter of the shortest wavelength.
    pub fn advised_spacing(&self, nearest_z: f64, mirror: bool) -> f64 {
        if mirror {
            return self.shortest_wavelength() / 4.0;
        }
        self.lateral_resolution(nearest_z)
            .into_iter()
            .flatten()
            .map(|cell| cell / 2.0)
            .fold(self.wavelength() / 2.0, f64::min)
    }
}

/// Fewer resolution cells than this across an object show no shape.
const FEWEST_CELLS: f64 = 4.0;

impl Instrument {
    /// Resolution cells across a box, along x and y, at the depth of its middle; `None` along an axis without an extent of
    /// the array.
    pub fn cells_across(&self, low: DVec3, high: DVec3) -> [Option<f64>; 2] {
        let cells = self.lateral_resolution(f64::midpoint(low.z, high.z).max(0.0));
        [(cells[0], high.x - low.x), (cells[1], high.y - low.y)]
            .map(|(cell, size)| cell.filter(|cell| *cell > 0.0).map(|cell| size / cell))
    }
}

/// Resolutions, ambiguity and aliasing of a job; lengths in m, memory in bytes.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Plan {
    /// Number of frequencies.
    pub frequencies: usize,
    /// Number of microphones.
    pub microphones: usize,
    /// Number of loudspeakers that sound one after another; 1 for a scan.
    pub transmissions: usize,
    /// The array that these see like, if it is another than the microphones'.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub virtual_array: Option<VirtualArray>,
    /// `[n_z, n_y, n_x]`.
    pub grid_shape: [usize; 3],
    /// λ_c, m.
    pub wavelength: f64,
    /// Δd = c/2B, m.
    pub range_resolution: Option<f64>,
    /// λ_c z/D along x and y at the nearest depth, m.
    pub lateral_resolution_near: [Option<f64>; 2],
    /// The same at the farthest depth, m.
    pub lateral_resolution_far: [Option<f64>; 2],
    /// Largest unambiguous path length, m.
    pub unambiguous_path: Option<f64>,
    /// Shortest and longest path length of the grid, m.
    pub path_bounds: [f64; 2],
    /// Largest microphone pitch without grating lobes inside this grid, m.
    pub alias_free_pitch: f64,
    /// Bytes of the cube.
    pub cube_bytes: u64,
    /// Bytes of the volume.
    pub volume_bytes: u64,
    /// Design rules that this job breaks, in one or two sentences each.
    pub warnings: Vec<String>,
}

/// Computes a plan, in microseconds; for several loudspeakers their virtual array is sorted.
pub fn plan(instrument: &Instrument, grid: &Grid) -> Plan {
    let width = (grid.x.last() - grid.x.first).max(grid.y.last() - grid.y.first);
    let near = grid.z.first.max(1e-3);
    let [shortest_path, longest_path] = instrument.path_bounds(grid);
    let seen = instrument.equivalent();
    let alias_free_pitch = alias_free_pitch(&seen, near, width);
    let mut warnings = Vec::new();
    warnings.extend(aliasing_warning(&seen, near, width, alias_free_pitch));
    warnings.extend(ambiguity_warning(instrument, shortest_path, longest_path));
    warnings.extend(plausibility::questions(instrument, grid));
    Plan {
        frequencies: instrument.sweep.len(),
        microphones: instrument.array.len(),
        transmissions: instrument.transmissions(),
        virtual_array: instrument.has_virtual_array().then(|| VirtualArray::of(&seen)),
        grid_shape: grid.shape(),
        wavelength: instrument.wavelength(),
        range_resolution: instrument.range_resolution(),
        lateral_resolution_near: instrument.lateral_resolution(grid.z.first),
        lateral_resolution_far: instrument.lateral_resolution(grid.z.last()),
        unambiguous_path: instrument.unambiguous_path(),
        path_bounds: [shortest_path, longest_path],
        alias_free_pitch,
        cube_bytes: instrument.cube_bytes(),
        volume_bytes: grid.volume_bytes(),
        warnings,
    }
}

/// A number with at most six decimals, without trailing zeros.
fn nice(value: f64) -> String {
    let text = format!("{value:.6}");
    text.trim_end_matches('0').trim_end_matches('.').to_owned()
}

/// `d ≤ λ_min/2` is free of grating lobes everywhere; `d ≤ λ_min z/X` within a scene of width X from depth z on.
fn alias_free_pitch(instrument: &Instrument, near: f64, width: f64) -> f64 {
    let shortest = instrument.shortest_wavelength() / instrument.geometry.scanned_legs();
    if width > 0.0 { (shortest * near / width).max(shortest / 2.0) } else { f64::MAX }
}

/// Grating lobes below this level are not warned of, dB: 10 dB weaker than the weakest returns that are sought.
const HARMLESS_LOBES_DB: f64 = -34.0;

fn aliasing_warning(instrument: &Instrument, near: f64, width: f64, alias_free: f64) -> Option<String> {
    let lattice = instrument.array.lattice()?;
    let axis = [lattice.x, lattice.y]
        .into_iter()
        .filter(|axis| axis.count > 1)
        .max_by(|a, b| a.pitch.total_cmp(&b.pitch))?;
    if axis.pitch <= alias_free * (1.0 + 1e-9) {
        return None;
    }
    let offset = instrument.shortest_wavelength() / instrument.geometry.scanned_legs() * near / axis.pitch;
    let smear = (axis.count - 1) as f64 * instrument.sweep.bandwidth() / instrument.sweep.centre();
    let level = -20.0 * smear.max(1.0).log10();
    (level > HARMLESS_LOBES_DB).then(|| format!(
        "microphones {:.1} mm apart alias within this {width:.2} m wide grid: bright points have grating lobes \
         at an offset of {offset:.2} m, about {level:.0} dB; a pitch of {:.1} mm or less has none",
        axis.pitch * 1e3,
        alias_free * 1e3
    ))
}

fn ambiguity_warning(instrument: &Instrument, shortest: f64, longest: f64) -> Option<String> {
    let unambiguous = instrument.unambiguous_path()?;
    let length = instrument.ambiguous_length([shortest, longest]);
    let what = match instrument.detection {
        Detection::Quadrature => "paths in this grid differ by up to",
        Detection::InPhase => "paths in this grid reach",
    };
    (length > unambiguous).then(|| {
        let step = instrument.sweep.step().unwrap_or(0.0) * unambiguous / length;
        format!(
            "{what} {length:.2} m, but the frequency step leaves only {unambiguous:.2} m unambiguous: echoes fold \
             back into the image; use a step of {step:.1} Hz or less, or a smaller grid"
        )
    })
}

/// Warnings about a scene between two corners whose size does not suit the wavelength, or the range that it and the grid take
/// together: the usual sign of a wrong unit, or, where the file is `in_metres` by its own rules, of a wrong scale.
pub(crate) fn scale_warnings(
    instrument: &Instrument,
    grid: Option<&Grid>,
    (low, high): (DVec3, DVec3),
    in_metres: bool,
) -> Vec<String> {
    let keys = if in_metres {
        "[scene] scale (the file is glTF, which is in metres: [scene] unit does not apply)"
    } else {
        "[scene] unit and scale"
    };
    let size = (high - low).max_element();
    let mut warnings = Vec::new();
    let cells = instrument.cells_across(low, high).into_iter().flatten().fold(0.0, f64::max);
    if size < instrument.wavelength() {
        warnings.push(format!(
            "the whole scene measures {:.2} mm, less than one wavelength ({:.1} mm); check {keys}, or image a model of it: \
             --scale {:.0} makes it half a metre long",
            size * 1e3,
            instrument.wavelength() * 1e3,
            0.5 / size
        ));
    } else if cells > 0.0 && cells < FEWEST_CELLS {
        warnings.push(format!(
            "the scene is only {cells:.1} resolution cells wide, too few for its shape; bring it nearer, use a wider array, \
             or image a larger model of it, as with --scale {:.0}",
            (4.0 * FEWEST_CELLS / cells).ceil()
        ));
    }
    // However far away echoes come from, in quadrature they are told apart from those of a grid that is as far away.
    let (near, far) = grid.map_or((low, high), Grid::bounds);
    let paths = instrument.path_bounds_of((low.min(near), high.max(far)));
    let ambiguous = |path: &f64| high.length() > path / 2.0 && instrument.ambiguous_length(paths) > *path;
    if let Some(path) = instrument.unambiguous_path().filter(ambiguous) {
        let range = path / 2.0;
        warnings.push(format!(
            "the scene reaches {:.2} m away, beyond the unambiguous range of {range:.2} m; check {keys} (--scale {:.1e} \
             makes it 2 m long), or use a smaller [sweep] step",
            high.length(),
            2.0 / size
        ));
    }
    warnings
}

/// Warns about a scene that no voxel of the grid can show.
pub(crate) fn outside_warning(grid: &Grid, low: DVec3, high: DVec3) -> Option<String> {
    let (near, far) = (grid.corners()[0], grid.corners()[7]);
    let apart = low.cmpgt(far).any() || high.cmplt(near).any();
    apart.then(|| {
        format!(
            "the scene, from {low:.3} to {high:.3} m, is outside the grid, from {near:.3} to {far:.3} m: the image shows only \
             sidelobes; move the [grid] or the scene"
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::acquisition::{MicArray, Sweep};
    use crate::named::assert_names;
    use crate::reconstruct::ReconstructOptions;

    /// `count` × `count` microphones over `extent` m, and 10 to 20 kHz by `step` Hz.
    pub(super) fn test_instrument(count: usize, extent: f64, step: f64, detection: Detection) -> Instrument {
        let sweep = Sweep::stepped(10_000.0, 20_000.0, step).expect("ok");
        let pitch = extent / (count - 1) as f64;
        let array = MicArray::rectangular([count; 2], [pitch; 2], DVec3::ZERO).expect("ok");
        Instrument::new(sweep, array).with_detection(detection)
    }

    fn grid(half: f64, z: [f64; 2]) -> Grid {
        let axis = Axis::spanning(-half, half, 0.02).expect("ok");
        Grid { x: axis, y: axis, z: Axis::spanning(z[0], z[1], 0.01).expect("ok") }
    }

    #[test]
    fn resolutions_follow_their_formulas() {
        let instrument = &test_instrument(31, 1.0, 40.0, Detection::Quadrature);
        let near = |a: f64, b: f64| assert!((a / b - 1.0).abs() < 1e-9, "{a} {b}");
        near(instrument.range_resolution().expect("band"), 0.01715);
        near(instrument.lateral_resolution(1.8)[0].expect("extent"), 343.0 / 15_000.0 * 1.8);
        near(instrument.unambiguous_path().expect("steps"), 343.0 / 40.0);
        let pitch = instrument.advised_pitch(1.8);
        near(instrument.lateral_resolution(0.01)[1].expect("extent"), 0.5 * 343.0 / 15_000.0);
        let half_cell = 0.5 * 343.0 / 15_000.0 * 1.8;
        assert!(pitch[0] <= half_cell && (30.0f64.recip() / pitch[0]).fract() < 1e-9, "{pitch:?}");
    }

    #[test]
    fn an_aliased_pitch_and_a_coarse_step_are_warned_about() {
        let warnings = |count, step, detection, half| {
            plan(&test_instrument(count, 1.0, step, detection), &grid(half, [1.2, 2.3])).warnings
        };
        assert_names(&warnings(31, 40.0, Detection::Quadrature, 0.66)[0], &["alias", "0.62 m"]);
        assert!(warnings(121, 40.0, Detection::Quadrature, 0.66).is_empty());
        assert_names(&warnings(121, 40.0, Detection::InPhase, 0.66)[0], &["unambiguous", "step"]);
        assert_names(&warnings(121, 200.0, Detection::Quadrature, 0.66)[0], &["unambiguous", "step", "Hz"]);
    }

    #[test]
    fn path_bounds_hold_every_path() {
        let instrument = &test_instrument(7, 0.8, 40.0, Detection::Quadrature);
        let grid = grid(0.5, [0.4, 1.0]);
        let [least, most] = instrument.path_bounds(&grid);
        for iz in [0, 30, 60] {
            for ix in 0..grid.x.count {
                for r in instrument.array.positions() {
                    let path = instrument.path_length(grid.position(ix, 50 - ix, iz), *r);
                    assert!((least..=most + 1e-12).contains(&path));
                }
            }
        }
    }

    #[test]
    fn sizes_beyond_reason_are_refused_without_overflow() {
        let instrument = &test_instrument(31, 1.0, 40.0, Detection::Quadrature);
        let mut huge = grid(0.66, [1.2, 2.3]);
        (huge.x.count, huge.y.count, huge.z.count) = (usize::MAX >> 1, 1 << 30, 1 << 30);
        assert_eq!(plan(instrument, &huge).volume_bytes, u64::MAX);
        let options = ReconstructOptions::default();
        let arrays = |grid: &Grid| JobArrays { volume: grid.volume_bytes(), ..JobArrays::default() };
        let refused = estimate_job(instrument, &huge, &options, &arrays(&huge), 2);
        assert!(refused.is_err(), "more than can be counted over");
        (huge.x.count, huge.y.count, huge.z.count) = (1 << 13, 1 << 13, 1 << 12);
        let arrays = arrays(&huge);
        let estimate = estimate_job(instrument, &huge, &options, &arrays, 2).expect("an estimate");
        let error = estimate.check_memory(instrument, &huge, &arrays, Some(1 << 40)).expect_err("too much");
        assert_names(error.to_string(), &["memory", "grid", "GiB"]);
    }

    #[test]
    fn a_scene_in_the_wrong_unit_is_noticed() {
        let instrument = &test_instrument(31, 1.0, 40.0, Detection::Quadrature);
        let small = scale_warnings(instrument, None, (DVec3::ZERO, DVec3::splat(0.002)), false).remove(0);
        assert_names(small, &["2.00 mm", "wavelength", "[scene] unit"]);
        let far = |in_metres| {
            scale_warnings(instrument, None, (DVec3::ZERO, DVec3::splat(200.0)), in_metres).remove(0)
        };
        assert_names(far(false), &["unambiguous", "[scene] unit", "scale"]);
        assert_names(far(true), &["unambiguous", "[scene] scale", "glTF"]);
        let usual = (DVec3::new(-0.5, -0.5, 1.0), DVec3::new(0.5, 0.5, 2.0));
        assert!(scale_warnings(instrument, None, usual, false).is_empty());
        // Far away, but with paths that differ little; unless the grid is elsewhere.
        let far = (DVec3::new(-1.5, -1.5, 20.0), DVec3::new(1.5, 1.5, 21.0));
        let said = |z| scale_warnings(instrument, Some(&grid(1.5, z)), far, false).concat();
        assert!(!said([19.0, 22.0]).contains("unambiguous"), "{}", said([19.0, 22.0]));
        assert_names(said([1.0, 2.0]), &["21.", "unambiguous", "[sweep] step"]);
    }
}
