//! What one process of a job finds for all of them: the reflectors of a scene, and the tiles and plans of its simulations.
//!
//! Placing a million reflectors takes longer than simulating them, and planning the simulation a tenth as long. Blocks of
//! reflectors are their positions, amplitudes, velocities if something moves, and the warnings that came up, which whoever
//! reads them repeats; then what is known of the detours of bounced echoes and edges.

use super::{JobOptions, identity};
use crate::alloc::try_zeroed;
use crate::blocks::BlockStore;
use crate::checkpoint::{Checkpoint, Identity, ListedTiles, SharedBlocks, Stage};
use crate::error::{Error, Result};
use crate::progress::{Event, Observer};
use crate::reflectors::{Detours, Reflectors, SurfaceOptions, sample_surface_with};
use crate::scene::Scene;
use bytemuck::{Pod, Zeroable, cast_slice, cast_slice_mut, pod_collect_to_vec};
use num_complex::Complex32;
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

/// More reflectors are not sampled, with some to spare.
const MOST: u64 = 100_000_000;

/// Where the processes of a job share its reflectors.
#[derive(Debug, Clone, Copy)]
pub(in crate::pipeline) struct SharedReflectors<'a> {
    pub(super) checkpoint: &'a Checkpoint,
    /// Whether those that are placed are stored for others.
    pub(super) stores: bool,
}

impl SharedReflectors<'_> {
    /// The reflectors of a scene, as another process has placed them, or placed now.
    pub(super) fn reflectors(
        self,
        scene: &Scene,
        options: &SurfaceOptions,
        observer: &dyn Observer,
    ) -> Result<Reflectors> {
        if self.checkpoint.is_off() {
            return sample_surface_with(scene, options, observer);
        }
        let mut identity = Identity::of("reflectors").storing(Stage::Reflectors, 8, 24 * MOST);
        identity.bytes(&identity::of_surfaces(scene));
        identity.text(&format!("{options:?}"));
        if let Some(shared) = self.load(&identity, observer)? {
            return Ok(shared);
        }
        if !self.stores {
            return sample_surface_with(scene, options, observer);
        }
        let heard = Heard { observer, warnings: Mutex::new(String::new()) };
        let sampled = sample_surface_with(scene, options, &heard)?;
        let warnings = heard.warnings.into_inner().unwrap_or_else(PoisonError::into_inner);
        let warnings = padded(warnings.into_bytes(), b'\n');
        let Detours { transmit, origins, kind, rest } = sampled.detours().unwrap_or_default();
        let (kind, rest) = (padded(kind, 0), padded(rest, b' '));
        let blocks = [
            cast_slice(sampled.positions()),
            sampled.amplitudes(),
            cast_slice(sampled.velocities()),
            &warnings,
            cast_slice(&transmit),
            cast_slice(&origins),
            &kind,
            &rest,
        ];
        share(self.checkpoint, &identity, (Stage::Reflectors, &blocks), observer)?;
        Ok(sampled)
    }

    fn load(self, identity: &Identity, observer: &dyn Observer) -> Result<Option<Reflectors>> {
        let Some(shared) = self.checkpoint.shared(identity, Stage::Reflectors, observer)? else {
            return Ok(None);
        };
        let mut stored = Stored::new(shared, observer);
        let (positions, amplitudes, velocities) = (stored.next()?, stored.next()?, stored.next()?);
        let warnings: Vec<Complex32> = stored.next()?;
        let (transmit, origins, kind) = (stored.next()?, stored.next()?, stored.next()?);
        let rest: Vec<Complex32> = stored.next()?;
        if stored.is_damaged {
            return Ok(None);
        }
        if amplitudes.len() != positions.len() || ![0, positions.len()].contains(&velocities.len()) {
            return Ok(None);
        }
        let straight = Reflectors::new(positions, amplitudes)?.with_velocities(velocities)?;
        let detours = Detours { transmit, origins, kind, rest: pod_collect_to_vec(&rest) };
        let reflectors =
            if detours.rest.is_empty() { Some(straight) } else { straight.with_detours(detours) };
        if reflectors.is_some() {
            String::from_utf8_lossy(cast_slice(&warnings))
                .lines()
                .filter(|line| !line.is_empty())
                .for_each(|warning| observer.warn(warning));
            observer.note("reflectors that another process has placed");
        }
        Ok(reflectors)
    }
}

/// Values as what blocks are made of, with more of `with` at their end.
pub(super) fn padded<T: Pod>(mut values: Vec<T>, with: T) -> Vec<Complex32> {
    values.resize(values.len().next_multiple_of(size_of::<Complex32>() / size_of::<T>()), with);
    pod_collect_to_vec(&values)
}

/// The plans of a scene's simulations: those that another process has found, or this one.
pub(super) struct SimulationPlans<'a> {
    /// Their blocks in the store of a simulation.
    blocks: Vec<u64>,
    /// Of this process, if they are not stored.
    found: Vec<Vec<Complex32>>,
    stored: Option<Stored<'a>>,
}

impl BlockStore for SimulationPlans<'_> {
    fn load(&mut self, k: u64, samples: &mut [Complex32]) -> Result<bool> {
        let Some(index) = self.blocks.iter().position(|block| *block == k) else { return Ok(false) };
        if let Some(Stored { blocks, observer, .. }) = &mut self.stored {
            let k = PLANS + index as u64;
            return Ok(blocks.samples(k) == samples.len() as u64 && blocks.read(k, samples, *observer)?);
        }
        // Nobody asks for one twice.
        let found = std::mem::take(&mut self.found[index]);
        let is_there = found.len() == samples.len();
        if is_there {
            samples.copy_from_slice(&found);
        }
        Ok(is_there)
    }
}

/// The block from which on plans are shared, after the numbers of the tiles and those of the plans' own blocks.
const PLANS: u64 = 2;

/// The numbers of the tiles of a scene's simulation and its plans, as another process has found them, or `find` finds them now.
/// The identity is that of the simulation, of so many tiles at most and plans of so many bytes.
pub(super) fn tiles<'a>(
    (identity, most, plan): (Identity, u64, u64),
    job: &JobOptions<'a>,
    find: impl FnOnce() -> Result<ListedTiles>,
) -> Result<(Vec<u64>, SimulationPlans<'a>)> {
    let bytes = (size_of::<u64>() as u64 * most).max(plan);
    let identity = identity.storing(Stage::Tiles, PLANS + most, bytes);
    if let Some(shared) = job.checkpoint.shared(&identity, Stage::Tiles, job.observer)? {
        let mut stored = Stored::new(shared, job.observer);
        let (known, blocks) = (stored.next()?, stored.next()?);
        if !stored.is_damaged {
            return Ok((known, SimulationPlans { blocks, found: Vec::new(), stored: Some(stored) }));
        }
    }
    let ListedTiles { tiles, plans } = find()?;
    let (blocks, found): (Vec<u64>, Vec<Vec<Complex32>>) = plans.into_iter().unzip();
    let mut shared: Vec<&[Complex32]> = vec![cast_slice(&tiles), cast_slice(&blocks)];
    shared.extend(found.iter().map(Vec::as_slice));
    share(job.checkpoint, &identity, (Stage::Tiles, &shared), job.observer)?;
    Ok((tiles, SimulationPlans { blocks, found, stored: None }))
}

/// Shares blocks; where they cannot be written, others find them, too.
fn share(
    checkpoint: &Checkpoint,
    identity: &Identity,
    blocks: (Stage, &[&[Complex32]]),
    observer: &dyn Observer,
) -> Result<()> {
    match checkpoint.share(identity, blocks, observer) {
        Err(Error::Interrupted) => Err(Error::Interrupted),
        Err(problem) => {
            observer.tell(&format!("other processes find the same again: {problem}"));
            Ok(())
        }
        Ok(()) => Ok(()),
    }
}

/// Blocks that are read one after another.
struct Stored<'a> {
    blocks: SharedBlocks,
    observer: &'a dyn Observer,
    next: u64,
    /// Whether one of those that were read is damaged, or does not fit in memory.
    is_damaged: bool,
}

impl<'a> Stored<'a> {
    fn new(blocks: SharedBlocks, observer: &'a dyn Observer) -> Self {
        Self { blocks, observer, next: 0, is_damaged: false }
    }

    /// The values of the next block.
    fn next<T: Pod + Zeroable>(&mut self) -> Result<Vec<T>> {
        let bytes = self.blocks.samples(self.next) * size_of::<Complex32>() as u64;
        let mut values = try_zeroed::<T>(bytes / size_of::<T>() as u64);
        self.is_damaged |= match &mut values {
            Some(values) => !self.blocks.read(self.next, cast_slice_mut(values), self.observer)?,
            None => true,
        };
        self.next += 1;
        Ok(values.unwrap_or_default())
    }
}

/// An observer that remembers the warnings, each in a line.
struct Heard<'a> {
    observer: &'a dyn Observer,
    warnings: Mutex<String>,
}

impl Observer for Heard<'_> {
    fn event(&self, event: Event<'_>) {
        self.observer.event(event);
    }

    fn warn(&self, message: &str) {
        let mut warnings = self.warnings.lock().unwrap_or_else(PoisonError::into_inner);
        warnings.push_str(message);
        warnings.push('\n');
        drop(warnings);
        self.observer.warn(message);
    }

    fn note(&self, message: &str) {
        self.observer.note(message);
    }

    fn tell(&self, message: &str) {
        self.observer.tell(message);
    }

    fn should_stop(&self) -> bool {
        self.observer.should_stop()
    }

    fn grace_period(&self, longest: Duration) {
        self.observer.grace_period(longest);
    }
}
