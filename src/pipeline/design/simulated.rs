//! Sweeps that are simulated: every combination is imaged with several seeds and its depth compared with the truth, as `check`
//! does, and what is finished is kept in a folder.
//!
//! A finished combination is a record (`checkpoint::record`) under the identity of its resolved run file, its surfaces, its seeds
//! and the program, so that the same command, another with more values, and other processes take it up. What is recorded is
//! the same on every computer; a table is made of records alone, so that its bytes do not depend on who computed what.

use super::keys::{SweptKey, count, products, settings};
use super::scores::DesignScores;
use super::workers::{spread, workers_for};
use super::{
    Combination, DesignRow, DesignSweep, RunWith, not_fatal, predicted, refusing_if_all, size_of,
    typed_memory,
};
use crate::checkpoint::{Identity, Records};
use crate::config::RunFile;
use crate::error::{Error, Result, gib};
use crate::grid::Grid;
use crate::metrics::{Measure, Scores};
use crate::pipeline::job::JobOptions;
use crate::pipeline::job::identity::of_combination;
use crate::pipeline::job::kept::{KeptScenes, KnownScene};
use crate::pipeline::limits::{bounds_of, hold, scores_of, seeds_of};
use crate::pipeline::memory::{MemoryBudget, SceneSize};
use crate::pipeline::prepared_scene::Measurement;
use crate::pipeline::{load_surfaces, need_bandwidth};
use crate::plan::{memory_limit, seconds_of};
use crate::progress::{OfPart, Silent, advance, stage};
use crate::text::duration;
use serde::{Deserialize, Serialize};
use std::path::Path;
use std::time::Duration;

/// How long an image may take to end when it is interrupted, before the process ends without it.
const GRACE: Duration = Duration::from_secs(3);

/// How the combinations of a sweep are simulated.
#[derive(Debug, Clone, Copy)]
pub struct SweepSimulation<'a> {
    /// Seeds of `[reflectors]`; without any those of `[expect]`, or else the run file's own.
    pub seeds: &'a [u32],
    /// The metric by whose error combinations are on a front.
    pub measure: &'a Measure,
    /// The folder of finished combinations; `None` if they are not kept.
    pub folder: Option<&'a Path>,
}

/// What a process has done of a sweep's part.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
#[non_exhaustive]
pub struct SweepWork {
    /// Combinations of the sweep.
    pub combinations: usize,
    /// Combinations of this part.
    pub part: usize,
    /// Those that were computed now.
    pub computed: usize,
    /// Those that were there already.
    pub found: usize,
    /// Those that are refused, which the table will list.
    pub refused: usize,
}

/// What is kept of a combination.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
struct FinishedCombination {
    /// Its settings as they were typed, for whoever reads the file.
    set: Vec<String>,
    seeds: Vec<u32>,
    design: DesignRow,
    scores: Vec<Scores>,
}

/// A combination with the judgement of its `[expect]`.
struct Judged {
    finished: FinishedCombination,
    expected: Option<bool>,
}

/// A combination that can be simulated.
struct PreparedCombination {
    run: RunFile,
    measurement: Measurement,
    size: SceneSize,
    grid: Grid,
    seeds: Vec<u32>,
    identity: Identity,
}

/// What is known of a combination before anything is simulated.
enum Known {
    Finished(Box<Judged>),
    Missing {
        /// Of the reconstruction of one seed.
        operations: f64,
        seeds: usize,
        /// Peak memory with one thread, bytes.
        bytes: u64,
    },
}

/// Simulates every combination of swept keys, except those that are finished in the folder.
///
/// Many combinations are simulated beside one another on a thread each, if they fit in memory together; few, one after another
/// by all threads. The bytes of the result are the same. Invalid combinations are listed with the reason for their refusal.
///
/// # Errors
/// As [`sweep_designs`](super::sweep_designs); scenes without surfaces; a record that cannot be written; [`Error::Interrupted`],
/// after which what is finished is in the folder.
pub fn simulate_designs(
    keys: &[SweptKey],
    run_with: &RunWith,
    simulation: &SweepSimulation<'_>,
    job: &JobOptions,
) -> Result<DesignSweep> {
    count(keys)?;
    let all = products(keys);
    let kept = KeptScenes::within(memory_limit(typed_memory(keys, run_with)));
    let runner = Runner::new(keys, run_with, simulation, (job, &kept))?;
    let (rows, _) = runner.rows(&all)?;
    let combinations: Vec<Combination> = all
        .into_iter()
        .zip(refusing_if_all(rows)?)
        .map(|(values, row)| match row {
            Err(error) => {
                Combination { values, design: None, simulated: None, refused: Some(error.to_string()) }
            }
            Ok(Judged { finished, expected }) => Combination {
                values,
                simulated: Some(DesignScores::of(
                    (&finished.seeds, &finished.scores),
                    expected,
                    simulation.measure,
                )),
                design: Some(finished.design),
                refused: None,
            },
        })
        .collect();
    let mut sweep = DesignSweep {
        keys: keys.iter().map(|key| key.key.clone()).collect(),
        measure: Some(simulation.measure.to_string()),
        combinations,
    };
    sweep.find_fronts();
    Ok(sweep)
}

/// Simulates the `part`-th of `of` parts of a sweep's combinations, as far as they are not finished, into the folder:
/// one of every `of` in turn, so that parts take about as long.
///
/// # Errors
/// As [`simulate_designs`]; no folder; a part that there is not.
pub fn work_on_designs(
    keys: &[SweptKey],
    run_with: &RunWith,
    simulation: &SweepSimulation<'_>,
    (part, of): (u64, u64),
    job: &JobOptions,
) -> Result<SweepWork> {
    let combinations = count(keys)?;
    if !(1..=of).contains(&part) {
        return Err(Error::input(
            "--part",
            format!("{part}/{of} was expected to be from 1/{of} to {of}/{of}"),
        ));
    }
    if simulation.folder.is_none() {
        return Err(Error::input(
            "--part",
            "needs a folder, in which another process finds this part; give -o DIR",
        ));
    }
    let own: Vec<_> = (1..)
        .zip(products(keys))
        .filter(|(number, _): &(u64, _)| part_with(number - 1, of) == part - 1)
        .map(|(_, values)| values)
        .collect();
    let kept = KeptScenes::within(memory_limit(typed_memory(keys, run_with)));
    let runner = Runner::new(keys, run_with, simulation, (job, &kept))?;
    let (rows, computed) = runner.rows(&own)?;
    let refused = rows.iter().filter(|row| row.is_err()).count();
    let found = own.len() - refused - computed;
    Ok(SweepWork { combinations, part: own.len(), computed, found, refused })
}

/// The part, from 0, that has a combination: each has one of every `of` in turn, and another of the next, since neighbours differ
/// in the last key and may differ in cost.
fn part_with(number: u64, of: u64) -> u64 {
    (number + number / of) % of
}

/// Everything by which a combination is simulated.
struct Runner<'a> {
    keys: &'a [SweptKey],
    run_with: &'a RunWith<'a>,
    seeds: &'a [u32],
    records: Option<Records>,
    known: KnownScene<'a>,
    job: JobOptions<'a>,
}

impl<'a> Runner<'a> {
    fn new(
        keys: &'a [SweptKey],
        run_with: &'a RunWith<'a>,
        simulation: &SweepSimulation<'a>,
        (job, kept): (&JobOptions<'a>, &'a KeptScenes),
    ) -> Result<Self> {
        let records = simulation.folder.map(Records::within).transpose()?;
        let job = JobOptions { kept: Some(kept), ..JobOptions::default().with_observer(job.observer) }
            .with_bare_mesh(job.bare_mesh);
        Ok(Self { keys, run_with, seeds: simulation.seeds, records, known: job.known(), job })
    }

    /// The rows of combinations, finished or simulated now, and how many were simulated.
    fn rows(&self, all: &[Vec<String>]) -> Result<(Vec<Result<Judged>>, usize)> {
        let observer = self.job.observer;
        let look = |values: &Vec<String>| {
            let known = self.look_up(values);
            advance(observer, 1)?;
            not_fatal(known)
        };
        let known =
            stage(observer, "preparing", all.len() as u64, || spread(all, workers_for(all.len()), look))?;
        let (mut missing, mut images, mut operations, mut largest) = (Vec::new(), 0, 0.0, 0_u64);
        for (number, known) in known.iter().enumerate() {
            if let Ok(Known::Missing { operations: each, seeds, bytes }) = known {
                missing.push(number);
                images += seeds;
                operations += each * *seeds as f64;
                largest = largest.max(*bytes);
            }
        }
        let limit = memory_limit(typed_memory(self.keys, self.run_with));
        let fit = |workers: u64| limit.is_none_or(|limit| largest.saturating_mul(workers) <= limit);
        let workers = Some(workers_for(missing.len())).filter(|workers| fit(*workers as u64)).unwrap_or(1);
        if !missing.is_empty() {
            let beside = match workers {
                1 => "one after another".to_owned(),
                workers => format!("{workers} at a time, each with up to {}", gib(largest)),
            };
            observer.tell(&format!(
                "of {} combinations {} are to be simulated: {images} images, {beside}; reconstructing them takes about {}, and \
                 simulation and depth come on top",
                all.len(),
                missing.len(),
                duration(seconds_of(operations))
            ));
        }
        // Each may take its share.
        let memory = limit.filter(|_| workers > 1).map(|limit| limit / workers as u64);
        // An image ends at its next block.
        observer.grace_period(GRACE);
        let simulated = stage(observer, "simulating", images as u64, || {
            spread(&missing, workers, |number| {
                let made = match not_fatal(self.simulate(&all[*number], memory))? {
                    Ok(made) => made,
                    Err(refusal) => return Ok(Err(refusal)),
                };
                let (identity, record, judged) = made;
                // Without its record there is no use in going on.
                self.records.as_ref().map_or(Ok(()), |records| records.save(&identity, &record))?;
                advance(observer, judged.finished.seeds.len() as u64)?;
                Ok(Ok(judged))
            })
        })?;
        observer.grace_period(Duration::ZERO);
        let computed = simulated.iter().filter(|made| made.is_ok()).count();
        let mut simulated = simulated.into_iter();
        let rows = known.into_iter().map(|known| match known {
            Err(error) => Err(error),
            Ok(Known::Finished(judged)) => Ok(*judged),
            Ok(Known::Missing { .. }) => simulated.next().expect("one of every missing combination"),
        });
        Ok((rows.collect(), computed))
    }

    /// A combination, if it is valid.
    fn prepared(&self, values: &[String]) -> Result<PreparedCombination> {
        let run = (self.run_with)(&settings(self.keys, values))?;
        need_bandwidth("[sweep]", &run.sweep()?)?;
        let measurement = Measurement::of(&run)?;
        let instrument = &measurement.instrument;
        let scene = load_surfaces(&run, self.known, &Silent)?;
        let size = size_of(&run, self.known, &Silent)?;
        let grid = run.voxels(instrument, scene.bounds())?;
        let seeds = seeds_of(&run, self.seeds);
        let identity = of_combination(&run, (&seeds, self.known.fingerprint(&scene)), instrument, &grid);
        Ok(PreparedCombination { run, measurement, size, grid, seeds, identity })
    }

    /// A combination, if it is finished, or what it takes.
    fn look_up(&self, values: &[String]) -> Result<Known> {
        let PreparedCombination { run, measurement, size, grid, seeds, identity } = self.prepared(values)?;
        let record = self.records.as_ref().and_then(|records| records.load(&identity));
        let finished = record.and_then(|record| serde_json::from_str::<FinishedCombination>(&record).ok());
        let complete =
            finished.filter(|finished| finished.seeds == seeds && finished.scores.len() == seeds.len());
        if let Some(finished) = complete {
            return Ok(Known::Finished(Box::new(judged(&run, finished)?)));
        }
        let budget = MemoryBudget { threads: 1, ..MemoryBudget::of(&run) };
        let arrays = measurement.imaging(&budget, &grid, &size);
        let estimate = budget.estimate(&measurement.instrument, &grid, &arrays)?;
        Ok(Known::Missing {
            operations: estimate.methods[estimate.chosen].operations,
            seeds: seeds.len(),
            bytes: estimate.memory.total(),
        })
    }

    /// Simulates a combination; returns what is to be recorded of it, and under which identity.
    fn simulate(&self, values: &[String], memory: Option<u64>) -> Result<(Identity, String, Judged)> {
        let PreparedCombination { mut run, seeds, identity, .. } = self.prepared(values)?;
        run.memory = memory.or(run.memory);
        let part = OfPart(self.job.observer);
        let design = predicted(&run, None, self.known, &part)?;
        let scores = scores_of(&run, &seeds, &self.job.with_observer(&part))?
            .ok_or_else(|| Error::input("[scene] mesh", "has no surfaces, and so no true depth"))?;
        let set = settings(self.keys, values);
        let unwritable = |error: serde_json::Error| Error::io("JSON", error.to_string());
        let record = serde_json::to_string(&FinishedCombination { set, seeds, design, scores });
        let record = record.map_err(unwritable)?;
        // Read again, as it will be: numbers that are not finite, say, are nothing then.
        let judged = judged(&run, serde_json::from_str(&record).map_err(unwritable)?)?;
        Ok((identity, record, judged))
    }
}

/// Judges a combination by its `[expect]`.
fn judged(run: &RunFile, finished: FinishedCombination) -> Result<Judged> {
    let verdicts = hold(&finished.scores, bounds_of(run, "run file")?);
    let expected = (!verdicts.is_empty()).then(|| verdicts.iter().all(|verdict| verdict.kept));
    Ok(Judged { finished, expected })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parts_share_all_combinations_evenly_and_each_is_in_one() {
        for of in [1, 2, 3, 7, 20] {
            for all in [0, 1, 6, 40, 41] {
                let mut sizes = vec![0_u64; of as usize];
                (0..all).for_each(|number| sizes[part_with(number, of) as usize] += 1);
                assert_eq!(sizes.iter().sum::<u64>(), all);
                assert!(sizes.iter().all(|size| [all / of, all.div_ceil(of)].contains(size)), "{sizes:?}");
            }
        }
        // Of two values of the last key each part has both.
        assert_eq!([0, 1, 2, 3].map(|number| part_with(number, 2)), [0, 1, 1, 0]);
    }
}
