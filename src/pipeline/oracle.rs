//! What an aperture could show at best: the depth map without speckle and without grating lobes.
//!
//! Both are not in the extent of the array and the band, which limit what can be resolved, but in the scene's random phases
//! and in the distance between microphones. So the oracle has the same extent, densely filled, an ideal instrument, and the
//! mean power of images of other phases. What it does not find, no reconstruction finds from such an aperture; what it finds
//! and a run does not is left to gain.

use super::facts::{instrument_facts, sidelobes};
use super::job::kept::KnownScene;
use super::maps::truth_of;
use super::memory::MemoryBudget;
use super::prepared_scene::{Held, PreparedScene};
use super::{JobOptions, load_surfaces, reconstruct, simulate};
use crate::acquisition::Instrument;
use crate::alloc::try_zeroed;
use crate::checkpoint::Checkpoint;
use crate::config::{ArrayLayout, RefineMethod, RunFile};
use crate::depth::locate_depth_with;
use crate::error::{Error, Result};
use crate::grid::{DepthMap, Grid, Volume, no_room_for};
use crate::metrics::{Scores, score};
use crate::plan::plan;
use crate::progress::{Event, Observer};
use crate::wave::Geometry;
use num_complex::Complex32;
use serde_json::Value;

/// Images whose powers are averaged: what is left of the speckle is a quarter of it.
const IMAGES: u32 = 16;

/// More microphones along an axis are not simulated.
const MOST_ALONG: f64 = 1024.0;

/// What the aperture of a run could show at best.
#[derive(Debug)]
#[non_exhaustive]
pub struct Oracle {
    /// What it would find.
    pub depth: DepthMap,
    /// Against the truth.
    pub scores: Scores,
    /// The metadata of the run's instrument.
    pub facts: Value,
}

/// Images a scene as an ideal instrument with the aperture of a run's would, without speckle.
///
/// Cost: 16 images of an array of the same extent whose microphones are so close that nothing aliases.
///
/// # Errors
/// Those of [`image_scene`](super::image_scene); a list of reflectors, which has no truth; an extent that would take too
/// many microphones.
pub fn oracle_of_scene(run: &RunFile, job: &JobOptions) -> Result<Oracle> {
    let instrument = run.instrument()?;
    let scene = load_surfaces(run, job.known(), job.observer)?;
    let grid = run.voxels(&instrument, scene.bounds())?;
    let mut ideal = ideal(run, &instrument, &grid)?;
    let quiet = &Quiet(job.observer);
    let mut power = try_zeroed::<f32>(grid.voxel_count()).ok_or_else(|| no_room_for(&grid))?;
    for seed in 1..=IMAGES {
        ideal.reflectors.seed = seed;
        job.observer.note(&format!("image {seed} of {IMAGES} for the oracle"));
        let volume = image(&ideal, job.known(), quiet)?;
        power.iter_mut().zip(&volume.samples).for_each(|(sum, a)| *sum += a.norm_sqr());
    }
    let mean = |sum: &f32| Complex32::new((sum / IMAGES as f32).sqrt(), 0.0);
    let volume = Volume::new(grid, power.iter().map(mean).collect());
    let dense = ideal.instrument()?;
    let mut options = ideal.depth_options(dense.aperture(), sidelobes(&dense, &ideal));
    // A mean of powers has no phases.
    (options.gate, options.raster) = (false, run.raster(scene.camera())?);
    let depth = locate_depth_with(&volume, &options, quiet)?;
    let truth = truth_of((&scene, job.known()), run, (&instrument, &grid), quiet)?;
    let scores = score(&depth, &truth, instrument.aperture())?;
    let mut facts = instrument_facts(&instrument, run);
    facts["oracle"] = true.into();
    Ok(Oracle { depth, scores, facts })
}

/// The volume that a scene shows.
fn image(run: &RunFile, known: KnownScene<'_>, observer: &dyn Observer) -> Result<Volume> {
    let (budget, nowhere) = (MemoryBudget::of(run), Checkpoint::off());
    let prepared = PreparedScene::of(&budget, known, Held::Image, observer)?;
    let cube = simulate(run, &prepared, &nowhere, observer)?;
    let options = budget.options(&budget.imaging(prepared.instrument(), &prepared.grid, prepared.arrays));
    let mut volume = Volume { grid: prepared.grid, samples: Vec::new() };
    reconstruct(&mut &cube, &prepared.grid, &options, &mut volume, &nowhere, observer)?;
    Ok(volume)
}

/// The run with an array that is dense, an instrument that is ideal, and the grid as it is.
fn ideal(run: &RunFile, instrument: &Instrument, grid: &Grid) -> Result<RunFile> {
    let mut ideal = run.clone();
    let axes = [grid.x, grid.y, grid.z];
    [ideal.grid.x, ideal.grid.y, ideal.grid.z] = axes.map(|axis| Some([axis.first, axis.last()]));
    (ideal.grid.pitch, ideal.grid.count) = (Some(axes.map(|axis| axis.pitch)), None);
    let pitch = plan(instrument, grid).alias_free_pitch;
    let (extent, centre) = (instrument.array.extent(), instrument.array.centre());
    let counts = [extent.x, extent.y].map(|extent| (extent / pitch - 1e-9).ceil().max(0.0) + 1.0);
    if counts.iter().any(|count| *count > MOST_ALONG) {
        return Err(Error::input(
            "[array]",
            format!(
                "an oracle fills the array's {:.2} x {:.2} m with microphones {:.1} mm apart, which are {} x {}, too many to \
                 simulate; look at a smaller grid or array",
                extent.x,
                extent.y,
                pitch * 1e3,
                counts[0],
                counts[1]
            ),
        ));
    }
    let array = &mut ideal.array;
    array.layout = ArrayLayout::Grid;
    (array.spacing, array.seed, array.file, array.elements) = (None, None, None, None);
    if let (Geometry::Pair { offset }, Some(_)) = (instrument.geometry, array.source_file.take()) {
        // A speaker beside each of them, as far from it as those of the pairs are in the mean.
        array.source_offset = Some(offset.to_array());
    }
    array.count = Some(counts.map(|count| count as u32));
    let pitches = [(extent.x, counts[0]), (extent.y, counts[1])];
    let pitches = pitches.map(|(extent, count)| if count > 1.0 { extent / (count - 1.0) } else { pitch });
    (array.extent, array.pitch) = (None, Some(pitches));
    array.centre = centre.to_array();
    (array.gain_error_db, array.phase_error, array.position_error) = (0.0, 0.0, 0.0);
    ideal.detection.snr_db = None;
    ideal.refine.method = RefineMethod::None;
    ideal.output.formats.clear();
    Ok(ideal)
}

/// An observer of many images: what they are is said once for all.
struct Quiet<'a>(&'a dyn Observer);

impl Observer for Quiet<'_> {
    fn event(&self, event: Event<'_>) {
        self.0.event(event);
    }

    fn should_stop(&self) -> bool {
        self.0.should_stop()
    }
}
