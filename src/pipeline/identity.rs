//! What the jobs of the pipeline are told apart by: the run file with every default, and what it was given to work on.

use super::echoes::Echoes;
use crate::acquisition::{CubeFile, CubeSource, Instrument};
use crate::checkpoint::Identity;
use crate::config::RunFile;
use crate::error::Result;
use crate::grid::Grid;
use glam::DVec3;

/// The identity of a job that begins with a scene: by its reflectors, which say all that any file of it does.
pub(super) fn of_scene(job: &str, run: &RunFile, echoes: &Echoes) -> Identity {
    let mut identity = of_instrument(job, run, echoes.instrument(), &echoes.grid);
    let reflectors = &echoes.reflectors;
    identity.numbers(coordinates(reflectors.positions()).into_iter());
    identity.bytes(bytemuck::cast_slice(reflectors.amplitudes()));
    identity
}

/// The identity of a job that begins with a cube.
pub(super) fn of_cube(job: &str, run: &RunFile, cube: &mut CubeFile, grid: &Grid) -> Result<Identity> {
    let content = cube.fingerprint()?;
    let mut identity = of_instrument(job, run, cube.instrument(), grid);
    identity.text(&content);
    Ok(identity)
}

fn of_instrument(job: &str, run: &RunFile, instrument: &Instrument, grid: &Grid) -> Identity {
    let mut identity = Identity::of(job);
    identity.text(&run.to_json().to_string());
    identity.text(&format!("{:?} {:?} {grid:?}", instrument.geometry, instrument.detection));
    identity.numbers(instrument.sweep.frequencies().iter().copied());
    identity.numbers(coordinates(instrument.array.positions()).into_iter());
    identity.numbers([instrument.sound_speed].into_iter());
    identity
}

fn coordinates(points: &[DVec3]) -> Vec<f64> {
    points.iter().flat_map(DVec3::to_array).collect()
}
