//! Many small jobs at once: each on one thread, since a job of a second is not divided well among several.

use crate::error::{Error, Result};
use rayon::ThreadPoolBuilder;
use std::panic::resume_unwind;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::thread;

/// Bytes of the stack of a worker.
const STACK: usize = 8 << 20;

/// Jobs for each worker, from which on they are done beside one another rather than one after another by all threads.
const JOBS_EACH: usize = 2;

/// How many workers do so many jobs: one, which has all threads, or one for each thread, which has no other.
pub(super) fn workers_for(jobs: usize) -> usize {
    let threads = rayon::current_num_threads();
    if jobs >= JOBS_EACH * threads { threads } else { 1 }
}

/// Does every job, and returns the results in their order; the first failure ends the work.
///
/// Of several workers each takes the next job that nobody has begun, in a pool of one thread of its own, so that the stages of
/// one job never wait for those of another.
///
/// # Errors
/// Those of the jobs; threads that cannot be started.
pub(super) fn spread<T: Sync, R: Send>(
    jobs: &[T],
    workers: usize,
    work: impl Fn(&T) -> Result<R> + Sync,
) -> Result<Vec<R>> {
    if workers <= 1 {
        return jobs.iter().map(work).collect();
    }
    let next = AtomicUsize::new(0);
    let worker = || -> Result<Vec<(usize, R)>> {
        let pool = ThreadPoolBuilder::new().num_threads(1).stack_size(STACK).build();
        let pool =
            pool.map_err(|error| Error::io("threads", format!("no thread can be started: {error}")))?;
        pool.install(|| {
            let mut done = Vec::new();
            loop {
                let number = next.fetch_add(1, Ordering::Relaxed);
                let Some(job) = jobs.get(number) else { return Ok(done) };
                let result = work(job).inspect_err(|_| next.store(jobs.len(), Ordering::Relaxed))?;
                done.push((number, result));
            }
        })
    };
    let mut done: Vec<(usize, R)> = thread::scope(|scope| {
        let started: Vec<_> =
            (0..workers).map(|_| thread::Builder::new().spawn_scoped(scope, worker)).collect();
        let mut all = Vec::with_capacity(jobs.len());
        let mut failed = None;
        for handle in started {
            let ended = match handle {
                Ok(handle) => handle.join().unwrap_or_else(|panic| resume_unwind(panic)),
                Err(error) => Err(Error::io("threads", format!("no thread can be started: {error}"))),
            };
            match ended {
                Ok(done) => all.extend(done),
                Err(error) => failed = failed.or(Some(error)),
            }
        }
        failed.map_or(Ok(all), Err)
    })?;
    done.sort_by_key(|(number, _)| *number);
    Ok(done.into_iter().map(|(_, result)| result).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn results_are_in_the_order_of_the_jobs_and_a_failure_ends_the_work() {
        let jobs: Vec<usize> = (0..100).collect();
        for workers in [1, 3] {
            let squares = spread(&jobs, workers, |job| {
                assert!(workers == 1 || rayon::current_num_threads() == 1, "a worker has one thread");
                Ok(job * job)
            });
            assert_eq!(squares, Ok(jobs.iter().map(|job| job * job).collect()));
            let begun = AtomicUsize::new(0);
            let failed = spread(&jobs, workers, |job| {
                begun.fetch_add(1, Ordering::Relaxed);
                if *job == 5 { Err(Error::Interrupted) } else { Ok(()) }
            });
            assert_eq!(failed, Err(Error::Interrupted));
            // Beside one another the others may have ended by then.
            assert!(workers > 1 || begun.into_inner() == 6, "the rest is not begun");
            assert_eq!(spread(&[], workers, |(): &()| Ok(())), Ok(Vec::new()));
        }
    }
}
