//! Autofocus and blind calibration of a measured cube: the run file's corrections, its grid as the region, the memory.

use crate::acquisition::{Calibration, CubeFile, CubeSource, DataCube, Instrument};
use crate::config::RunFile;
use crate::error::Result;
use crate::focus::{
    AUTOFOCUS_VOLUMES, Autofocus, AutofocusOptions, ChannelError, FocusParameter, SelfCalibration, autofocus,
    self_calibrate,
};
use crate::grid::{Axis, Grid};
use crate::pipeline::JobOptions;
use crate::pipeline::memory::MemoryBudget;
use crate::plan::{JobArrays, estimate_job};
use crate::progress::Observer;
use crate::reconstruct::{Method, ReconstructOptions, Window};
use crate::wave::Motion;
use glam::DVec3;

/// Searches for the value of a parameter with which the image of `[grid]` is sharpest; voxels larger than half of the
/// resolution are made smaller, since between larger ones the brightest place of an echo is missed.
///
/// Of the options, those that follow from the run file are set here: `[calibration] delay` and `tilt`, and the memory.
///
/// # Errors
/// A run file without a grid; those of [`autofocus`]; a region that takes more memory than there is.
pub fn autofocus_cube(
    run: &RunFile,
    cube: CubeFile,
    parameter: FocusParameter,
    options: &AutofocusOptions,
    job: &JobOptions,
) -> Result<Autofocus> {
    let observer = job.observer;
    let calibration = run.calibration();
    let tilt = calibration.tilt;
    // The tilt is applied by every trial, so that another can be tried in its place.
    let cube = cube.calibrated(&Calibration { tilt: [0.0; 2], ..calibration.clone() }, observer)?;
    let instrument = cube.instrument().clone();
    let grid = fine_enough(run.voxels(&instrument, None)?, &instrument)?;
    let memory = memory_for_images(run, &instrument, &grid, AUTOFOCUS_VOLUMES, observer)?;
    let velocity = run.medium.velocity.map_or(DVec3::ZERO, DVec3::from_array);
    let motion = run.recording.dwell.map(|dwell| Motion::new(velocity, dwell));
    let options =
        options.with_delay(calibration.delay).with_tilt(tilt).with_motion(motion).with_memory(memory);
    autofocus(&cube.load()?, &grid, parameter, &options, observer)
}

/// Finds the errors of a cube's channels from the echoes in `[grid]`, after the corrections of `[calibration]`; gives what was
/// found, and the cube, corrected by `[calibration]` alone, that [`SelfCalibration::correct`] corrects.
///
/// # Errors
/// A run file without a grid; those of [`self_calibrate`]; a region that takes more memory than there is.
pub fn self_calibrate_cube(
    run: &RunFile,
    cube: CubeFile,
    kind: ChannelError,
    prior: f64,
    job: &JobOptions,
) -> Result<(SelfCalibration, DataCube)> {
    let observer = job.observer;
    let cube = cube.calibrated(&run.calibration(), observer)?;
    cube.changes().iter().for_each(|change| observer.note(change));
    let instrument = cube.instrument().clone();
    let grid = run.voxels(&instrument, None)?;
    let memory = memory_for_images(run, &instrument, &grid, 2, observer)?;
    let cube = cube.load()?;
    let found = self_calibrate(&cube, &grid, kind, prior, memory, observer)?;
    Ok((found, cube))
}

/// The memory that is left to each of many images of a region, so many volumes of which are kept at a time; says what they take.
fn memory_for_images(
    run: &RunFile,
    instrument: &Instrument,
    grid: &Grid,
    volumes: u64,
    observer: &dyn Observer,
) -> Result<Option<u64>> {
    let arrays = JobArrays {
        volume: grid.volume_bytes().saturating_mul(volumes),
        // The cube, and a changed one.
        ..JobArrays::measured(instrument, instrument.cube_bytes().saturating_mul(2))
    };
    let limit = MemoryBudget::of(run).limit;
    let memory = arrays.left_for_method(limit);
    let images = ReconstructOptions::new(Method::Auto, Window::None).with_memory(memory);
    let estimate = estimate_job(instrument, grid, &images, &arrays, rayon::current_num_threads())?;
    estimate.check_memory(instrument, grid, &arrays, limit)?;
    observer.note(&format!(
        "about {:.2} s for each image of {} voxels",
        estimate.seconds()[estimate.chosen],
        grid.voxel_count()
    ));
    Ok(memory)
}

/// The grid with voxels of half the resolution at its nearest depth, or as they are if they are smaller.
fn fine_enough(grid: Grid, instrument: &Instrument) -> Result<Grid> {
    let [x, y, z] = instrument.advised_pitch(grid.z.first.max(instrument.wavelength()));
    let axis = |axis: Axis, most: f64| {
        if axis.pitch <= most * 1.01 { Ok(axis) } else { Axis::spanning(axis.first, axis.last(), most) }
    };
    Ok(Grid { x: axis(grid.x, x)?, y: axis(grid.y, y)?, z: axis(grid.z, z)? })
}
