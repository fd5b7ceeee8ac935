//! The identities of the pipeline's jobs: the run file with every default, the data on which the job works, and how much it
//! can store.

use crate::acquisition::{CubeFile, CubeSource, Instrument};
use crate::checkpoint::{Identity, Stage};
use crate::config::{ExpectTable, OutputTable, RunFile};
use crate::error::Result;
use crate::export::volume_zarr::VolumeShards;
use crate::grid::Grid;
use crate::pipeline::prepared_scene::PreparedScene;
use crate::reconstruct::{BYTES_BESIDE_TONES, most_nodes};
use crate::scene::Scene;
use glam::DVec3;

/// The identity of a job that begins with a scene, which its reflectors represent completely.
pub(in crate::pipeline) fn of_scene(job: &str, run: &RunFile, scene: &PreparedScene) -> Identity {
    let mut identity = of_instrument(job, run, scene.instrument(), &scene.grid);
    for reflectors in &scene.reflectors {
        identity.numbers(coordinates(reflectors.positions()));
        identity.bytes(bytemuck::cast_slice(reflectors.amplitudes()));
        // What they are seen through follows from the scene as their places do.
        if !reflectors.transmit_lengths().is_empty() {
            identity.numbers(reflectors.transmit_lengths().iter().copied());
        }
    }
    identity
}

/// The identity of a job that begins with a cube.
pub(in crate::pipeline) fn of_cube(
    job: &str,
    run: &RunFile,
    cube: &mut CubeFile,
    grid: &Grid,
) -> Result<Identity> {
    let content = cube.fingerprint()?;
    let mut identity = of_instrument(job, run, cube.instrument(), grid);
    identity.text(&content);
    // What a calibration's own files hold is in the samples that it left.
    if let Some(samples) = cube.corrected() {
        identity.bytes(bytemuck::cast_slice(samples));
    }
    Ok(identity)
}

/// The identity of a combination of a sweep, whose images with these seeds are scored: unlike that of an image it needs no
/// reflectors. What is written and which limits are kept is no part of it.
pub(in crate::pipeline) fn of_combination(
    run: &RunFile,
    (seeds, surfaces): (&[u32], [u8; 32]),
    instrument: &Instrument,
    grid: &Grid,
) -> Identity {
    let mut plain = run.clone();
    (plain.output, plain.expect) = (OutputTable::default(), ExpectTable::default());
    let mut identity = of_instrument("combination", &plain, instrument, grid);
    identity.bytes(&surfaces);
    identity.numbers(seeds.iter().map(|seed| f64::from(*seed)));
    identity
}

/// A hash of a scene's surfaces: what they are, and where.
pub(super) fn of_surfaces(scene: &Scene) -> [u8; 32] {
    let mut identity = Identity::of("surfaces");
    for triangle in scene.triangles() {
        identity.numbers(coordinates(&triangle.vertices));
        identity.bytes(&triangle.material.to_le_bytes());
    }
    identity.text(&format!("{:?} {:?} {:?}", scene.materials(), scene.parts(), scene.camera()));
    identity.key()
}

fn of_instrument(job: &str, run: &RunFile, instrument: &Instrument, grid: &Grid) -> Identity {
    let plane_bytes = grid.volume_bytes() / (grid.z.count as u64).max(1);
    // Tiles of every simulation that the electronics need.
    let simulations = run.simulate_options().simulations(instrument);
    let shards = VolumeShards::new(grid, run.output.components, run.output.compression);
    let [nodes, node_bytes] = most_nodes(grid);
    let identity = Identity::of(job)
        .storing(
            Stage::Cube,
            (simulations * instrument.transmissions() * instrument.array.len()) as u64,
            instrument.cube_bytes(),
        )
        .storing(Stage::Volume, grid.z.count as u64, plane_bytes)
        .storing(Stage::Shards, shards.count(), shards.most_bytes())
        .storing(Stage::Nodes, nodes, node_bytes)
        // No more tones than there are frequencies, and what compressing yields beside them; those of stretches of depths.
        .storing(
            Stage::Tones,
            nodes.max(grid.z.count as u64) + 2,
            instrument.cube_bytes().saturating_add(BYTES_BESIDE_TONES),
        );
    let mut identity = match run.refine_options() {
        Some(refine) => {
            let [blocks, bytes] = refine.blocks(instrument, grid);
            identity.storing(Stage::Refinement, blocks, bytes)
        }
        None => identity,
    };
    identity.text(&run.to_json().to_string());
    identity.text(&format!(
        "{:?} {:?} {:?} {grid:?}",
        instrument.geometry, instrument.interface, instrument.detection
    ));
    identity.numbers(instrument.sweep.frequencies().iter().copied());
    identity.numbers(coordinates(instrument.array.positions()));
    identity.numbers([instrument.sound_speed].into_iter());
    identity.numbers(coordinates(&instrument.sources()));
    if instrument.has_differing_pairs() {
        identity.numbers(coordinates(&instrument.pair_sources));
    }
    identity
}

fn coordinates(points: &[DVec3]) -> impl ExactSizeIterator<Item = f64> {
    bytemuck::cast_slice(points).iter().copied()
}
