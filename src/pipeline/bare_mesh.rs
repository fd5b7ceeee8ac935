//! A mesh without a run file: placed before an array that suits its size, with voxels that a computer images in seconds.
//!
//! An array resolves `λ_c z/D` across, so an object is best as near as it can be seen whole, before an array of twice that
//! width. Nearer, or before a wider one, sides are seen that other microphones do not see, and less is found. Of 17 meshes,
//! from a bunny of 12 cm to a building of 15 m, 92 % of the pixels are found so in the median.

use crate::acquisition::Instrument;
use crate::config::{InputFile, MeshRun, RunFile};
use crate::error::Result;
use crate::grid::{Axis, Grid};
use crate::progress::{Observer, stage};
use crate::scene::{Scene, metres};
use glam::DVec3;
use std::path::Path;
use std::sync::Arc;

/// Microphones along each side of the array.
const MICROPHONES: u32 = 101;

/// The array is as wide as this many diagonals of the object, within these bounds, m. Microphones 2 cm apart, as those of the
/// widest one are, leave hardly a grating lobe in the picture of a building.
const WIDTH_IN_DIAGONALS: f64 = 1.8;
const WIDTHS: [f64; 2] = [0.8, 2.0];

/// The object's centre is this many diagonals away, or this many widths of the array if that is more.
const DIAGONALS: f64 = 0.9;
const ARRAY_WIDTHS: f64 = 0.5;

/// Voxels across are this much closer than half a resolution cell where there are few anyway: outlines and slopes are truer.
const CLOSER: f64 = 0.5;

/// Voxels, and reflectors, that take some seconds.
const MOST_VOXELS: f64 = 5e6;
const MOST_REFLECTORS: f64 = 3e5;

/// Narrower bands below the sweep's last frequency, Hz, each for voxels that would be farther apart across than so many
/// resolution cells at the middle depth. A large object seen from afar has thousands of range cells, and would need as many
/// planes of voxels; with fewer of them it is seen better, and sooner.
const BANDS: [(f64, f64); 8] = [
    (5e3, COARSE),
    (2.5e3, COARSE),
    (1.2e3, 1.0),
    (600.0, 1.5),
    (300.0, 1.2),
    (120.0, 1.2),
    (60.0, 1.2),
    (20.0, 1.2),
];

/// Voxels across that are farther apart than so many resolution cells at the middle depth show less than the array resolves.
const COARSE: f64 = 0.75;

/// How far away voxels may be that are imaged with a narrower band, m: the memory that sums take grows with the distance, to more
/// than 2 GiB here.
const FARTHEST: f64 = 5e3;

/// Planes of voxels that are not made fewer by a narrower band: what is wide or finely resolved rather than deep has no gain.
const FEW_PLANES: usize = 128;

/// Steps of the sweep, Hz, of which each divides all bands: the largest that leaves the paths of the grid unambiguous, without
/// more tones than this.
const STEPS: [f64; 10] = [20.0, 10.0, 5.0, 2.0, 1.0, 0.5, 0.2, 0.1, 0.05, 0.02];
const MOST_TONES: f64 = 5000.0;

/// How errors name the settings that nobody typed.
const PLACE: &str = "settings of a mesh without a run file";

/// A mesh without a run file: the run file that suits it, and the scene that it places.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct BareMesh {
    /// The run file, with the overrides.
    pub run: RunFile,
    /// The mesh, placed.
    pub scene: Arc<Scene>,
    /// What may be wrong with the placement, or was made coarser than usual.
    pub hints: Vec<String>,
    suited: MeshRun,
}

impl BareMesh {
    /// Reads a mesh and finds the settings that suit it; `overrides` are those of [`RunFile::load`], and `memory` the most
    /// bytes that a job may use.
    ///
    /// Cost: that of [`Scene::load`].
    ///
    /// # Errors
    /// The errors of [`Scene::load`] and of the overrides.
    pub fn load(
        path: &Path,
        overrides: &[String],
        memory: Option<u64>,
        observer: &dyn Observer,
    ) -> Result<Self> {
        let typed = RunFile::from_str_at("", PLACE, Path::new(""), overrides)?;
        let read = |suited: &MeshRun| with_overrides(suited, overrides, path, memory);
        let mut suited = MeshRun::new(&typed, (MICROPHONES, microphone_pitch(0.0)));
        let by_size = typed.scene.fit.or(typed.scene.translate).is_none() && typed.scene.sensor.is_none();
        let options = RunFile { memory, ..typed.clone() }.load_options()?;
        let mut place = |low: DVec3, high: DVec3| {
            let diagonal = (high - low).length();
            if !diagonal.is_finite() {
                // The scene says which triangle is so far away.
                return Ok(None);
            }
            if let Some((_, pitch)) = &mut suited.array {
                *pitch = microphone_pitch(diagonal);
            }
            if by_size {
                let array = read(&suited)?.instrument()?.array;
                let away = (DIAGONALS * diagonal).max(ARRAY_WIDTHS * array.extent().max_element());
                suited.fit = Some(array.centre() + DVec3::Z * rounded_up(away));
            }
            Ok(suited.fit)
        };
        let scene = stage(observer, "reading the scene", 0, || {
            Scene::load_placed(path, &options, observer, &mut place)
        })?;
        let (low, high) = scene.bounds().unwrap_or_default();
        (suited.size, suited.frame) = (high - low, scene.frame());
        let seen = |suited: &MeshRun| -> Result<_> {
            let run = read(suited)?;
            let instrument = run.instrument()?;
            let voxels = AffordableVoxels::of(&run, &instrument, (low, high))?;
            Ok((run, instrument, voxels))
        };
        let (mut run, mut instrument, mut voxels) = seen(&suited)?;
        let whole = suited.sweep[0];
        let is_typed = overrides.iter().any(|typed| typed.trim_start().starts_with("sweep"));
        if !is_typed && voxels.grid.z.last() < FARTHEST {
            for (band, apart) in BANDS {
                if voxels.pitch_in_cells <= apart || voxels.grid.z.count <= FEW_PLANES {
                    break;
                }
                suited.sweep[0] = suited.sweep[1] - band;
                (run, instrument, voxels) = seen(&suited)?;
            }
        }
        let longest = (high - low).max_element();
        let narrower = (suited.sweep[0] > whole).then(|| band_hint(&instrument, whole, longest));
        let grid = voxels.grid;
        (suited.grid, suited.sweep[2]) = (Some(grid), sweep_step(&instrument, &grid));
        let usual = run.surface_options(&instrument, low.z.max(grid.z.first)).spacing;
        let least = (scene.surface_area() / MOST_REFLECTORS).sqrt();
        suited.spacing = (least > usual).then(|| rounded_up(least));
        let orientation = orientation_hint(&scene, instrument.array.centre());
        let hints = narrower.into_iter().chain(voxels.coarser).chain(orientation).collect();
        Ok(Self { run: read(&suited)?, scene: Arc::new(scene), hints, suited })
    }

    /// The same run file with other overrides: the mesh keeps its place before another array.
    ///
    /// # Errors
    /// The errors of the overrides.
    pub fn run_with(&self, overrides: &[String]) -> Result<RunFile> {
        let path = self.run.scene.mesh.as_ref().map_or(Path::new(""), |mesh| &mesh.path);
        with_overrides(&self.suited, overrides, path, self.run.memory)
    }

    /// The text of the run file, which names the mesh `mesh`; of the overrides it has those of `[scene]`.
    pub fn text(&self, mesh: &str) -> String {
        self.suited.to_toml(mesh)
    }
}

/// The run file that suits a mesh, with what was typed.
fn with_overrides(
    suited: &MeshRun,
    overrides: &[String],
    path: &Path,
    memory: Option<u64>,
) -> Result<RunFile> {
    // The name is a path, which need not be text.
    let mut run = RunFile::from_str_at(&suited.to_toml("mesh"), PLACE, Path::new(""), overrides)?;
    (run.scene.mesh, run.memory) = (Some(InputFile::new(path)), memory);
    Ok(run)
}

/// The next whole millimetre, m.
fn rounded_up(length: f64) -> f64 {
    (length * 1e3 - 1e-6).ceil() / 1e3
}

/// Distance between the microphones before an object of this diagonal, m: of tenths of a millimetre.
fn microphone_pitch(diagonal: f64) -> f64 {
    let width = (WIDTH_IN_DIAGONALS * diagonal).clamp(WIDTHS[0], WIDTHS[1]);
    (width / f64::from(MICROPHONES - 1) * 1e4).round() / 1e4
}

/// The largest of the steps with which no two paths of the grid are taken for one another; what is typed wins.
fn sweep_step(instrument: &Instrument, grid: &Grid) -> f64 {
    let paths = instrument.ambiguous_length(instrument.path_bounds(grid));
    let unambiguous = |step: f64| {
        let tones = instrument.sweep.step().unwrap_or(step);
        instrument.unambiguous_path().unwrap_or(f64::INFINITY) * tones / step
    };
    let affordable = |step: &&f64| instrument.sweep.bandwidth() / **step <= MOST_TONES;
    let steps = || STEPS.iter().filter(affordable);
    let step = steps().find(|step| unambiguous(**step) >= paths).or_else(|| steps().next_back());
    step.copied().unwrap_or(STEPS[0])
}

/// What the band is, and what to type for the whole one, or for a model of an object that is so long, m.
fn band_hint(instrument: &Instrument, first: f64, longest: f64) -> String {
    let sweep = &instrument.sweep;
    let cell = metres(instrument.range_resolution().unwrap_or(0.0));
    format!(
        "an object of this size is seen better, and sooner, with a band of {} to {} Hz, which resolves {cell} in depth; for \
         the whole one, --set sweep.start={first}; a model of it of 2 m, --scale {:.1e}, shows more",
        sweep.start(),
        sweep.stop(),
        2.0 / longest
    )
}

/// Voxels around a scene: as fine as the array resolves or finer, unless those would take long.
struct AffordableVoxels {
    grid: Grid,
    /// What they are instead, if they would.
    coarser: Option<String>,
    /// The pitch across in resolution cells at the middle depth; 0 where it was typed or is as fine as it should be, or where
    /// the array resolves nothing.
    pitch_in_cells: f64,
}

impl AffordableVoxels {
    fn of(run: &RunFile, instrument: &Instrument, (low, high): (DVec3, DVec3)) -> Result<Self> {
        let typed = &run.grid;
        let [x, y, z] = run.grid_ends(instrument, Some((low, high)))?;
        let outwards = |[first, last]: [f64; 2], typed: bool| {
            if typed { [first, last] } else { [(first * 1e3).floor() / 1e3, rounded_up(last)] }
        };
        let [x, y] = [outwards(x, typed.x.is_some()), outwards(y, typed.y.is_some())];
        let z = if typed.z.is_some() { z } else { [rounded_up(z[0]), rounded_up(z[1])] };
        let axis = |[first, last]: [f64; 2], pitch| {
            Axis::spanning(first, last, pitch).map_err(|error| error.at("[grid]"))
        };
        if typed.count.is_some() || typed.pitch.is_some() {
            let grid = run.voxels(instrument, Some((low, high)))?;
            return Ok(Self { grid, coarser: None, pitch_in_cells: 0.0 });
        }
        let fine = instrument.advised_pitch(z[0].max(instrument.wavelength()));
        let cells = instrument.lateral_resolution(f64::midpoint(z[0], z[1]));
        let voxels = |pitch: [f64; 3]| -> f64 {
            [x, y, z]
                .iter()
                .zip(pitch)
                .map(|([first, last], pitch)| ((last - first) / pitch).floor() + 1.0)
                .product()
        };
        let closer = [CLOSER * fine[0], CLOSER * fine[1], fine[2]];
        let mut pitch = if voxels(closer) > MOST_VOXELS { fine } else { closer };
        while voxels(pitch) > MOST_VOXELS {
            // Across, half the resolution at the nearest depth is more than the farther ones need.
            let across = (0..2).all(|k| pitch[k] < cells[k].unwrap_or(0.0));
            let factors = if across { [1.1, 1.1, 1.0] } else { [1.1; 3] };
            pitch = std::array::from_fn(|k| pitch[k] * factors[k]);
        }
        let in_cells = cells.iter().zip(pitch).filter_map(|(cell, pitch)| cell.map(|cell| pitch / cell));
        let in_cells = in_cells.fold(0.0, f64::max);
        let is_as_advised = pitch == fine || pitch == closer;
        let coarser = (!is_as_advised && (in_cells > COARSE || pitch[2] > fine[2])).then(|| {
            let [coarse, fine] = [pitch, fine].map(|pitch| pitch.map(metres).join(" x "));
            format!(
                "voxels of {coarse} are imaged in seconds where those of {fine} would show all; for finer ones, \
                 --set grid.pitch=[..] or a part of the scene, --set grid.x=[..]"
            )
        });
        // However small the cells: finer voxels show no more.
        let pitch_in_cells = if is_as_advised { 0.0 } else { in_cells };
        let grid = Grid { x: axis(x, pitch[0])?, y: axis(y, pitch[1])?, z: axis(z, pitch[2])? };
        Ok(Self { grid, coarser, pitch_in_cells })
    }
}

/// Shares of rays that meet the object, above which a hint is given.
const MOSTLY_BACKS: f64 = 0.6;
const MOSTLY_FLAT: f64 = 0.95;

/// What to try where an object shows its back or a single flat side.
fn orientation_hint(scene: &Scene, from: DVec3) -> Option<String> {
    let look = scene.first_look(from);
    let percent = |share: f64| (100.0 * share).round();
    if look.backs > MOSTLY_BACKS {
        return Some(format!(
            "{} % of what the array sees are the backs of faces: the object is turned away, upside down or inside out; \
             try --rotate 0,180,0 or another --up",
            percent(look.backs)
        ));
    }
    (look.flat > MOSTLY_FLAT).then(|| {
        format!(
            "{} % of what the array sees is one flat side, of which a picture shows little; try --rotate 25,35,0 or \
             another --up",
            percent(look.flat)
        )
    })
}
