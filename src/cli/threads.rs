//! The threads of the program: how many, how large their stacks are, and their vector instructions.

use crate::error::{Error, Result};
use crate::progress::Observer;
use crate::wave::simd::{self, Level};
use std::num::NonZeroUsize;
use std::thread;

/// Bytes of the stack of a worker thread, as the standard library's default.
const STACK: usize = 2 << 20;

/// Bytes of the main thread's stack below which commands run on a thread of their own; 128 KiB are not always enough.
#[cfg(unix)]
const SMALL: u64 = 1 << 20;

/// More threads than this many per core only take memory and time.
const PER_CORE: usize = 4;

/// As many threads are always allowed, so that results can be compared anywhere.
const ALWAYS: usize = 16;

/// Limits the vector instructions of the program's own loops, if the environment requests it.
pub(super) fn limit_simd() -> Result<()> {
    const NAME: &str = "HOLOSONAR_SIMD";
    if let Some(value) = std::env::var_os(NAME).filter(|value| !value.is_empty()) {
        simd::limit(Level::named(NAME, &value.to_string_lossy(), Level::of_processor())?);
    }
    Ok(())
}

/// Runs `work` on this thread, or where `ulimit -s` leaves too little stack, on one that has enough.
pub(super) fn with_stack<T: Send>(work: impl Fn() -> T + Sync) -> T {
    #[cfg(unix)]
    if rustix::process::getrlimit(rustix::process::Resource::Stack).current.is_some_and(|bytes| bytes < SMALL)
    {
        let on_thread = thread::scope(|scope| {
            let builder = thread::Builder::new().name("main".to_owned()).stack_size(4 * STACK);
            let spawned = builder.spawn_scoped(scope, &work).ok()?;
            Some(spawned.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic)))
        });
        if let Some(result) = on_thread {
            return result;
        }
    }
    work()
}

/// Refuses an environment that gives libraries' threads stacks on which they cannot run.
fn check_stacks() -> Result<()> {
    const NAME: &str = "RUST_MIN_STACK";
    let bytes = std::env::var(NAME).ok().and_then(|bytes| bytes.parse::<usize>().ok());
    match bytes.filter(|bytes| *bytes < STACK / 4) {
        None => Ok(()),
        Some(bytes) => {
            let problem = format!(
                "{bytes} bytes are too few for the stack of a thread; unset it, or set it to {} or more",
                STACK / 4
            );
            Err(Error::input(NAME, problem))
        }
    }
}

/// Starts the worker threads before their first use.
///
/// # Errors
/// No threads at all; an environment that leaves no room for their stacks; the system's refusal of a thread.
pub(super) fn start(requested: Option<u16>, observer: &dyn Observer) -> Result<()> {
    if requested == Some(0) {
        return Err(Error::input("--threads", "0 threads cannot do any work; give 1 or more"));
    }
    check_stacks()?;
    let cores = thread::available_parallelism().map_or(1, NonZeroUsize::get);
    let requested = requested.map(usize::from);
    let count = requested.map_or(0, |count| count.min(most(cores)));
    if let Some(requested) = requested.filter(|requested| *requested > count) {
        observer.warn(&format!(
            "--threads {requested}: {count} are used, since more only take time and memory on {cores} cores; the results \
             are the same"
        ));
    }
    // Not left to the first use, which panics if no thread can be started.
    rayon::ThreadPoolBuilder::new().num_threads(count).stack_size(STACK).build_global().map_err(|e| {
        let problem = format!("the worker threads cannot be started: {e}; -j sets a smaller number of them");
        Error::io("threads", problem)
    })?;
    // The C library reserves 64 MiB of addresses for every thread that allocates: before those left are counted.
    rayon::broadcast(|_| std::hint::black_box(vec![0_u8; 64]).len());
    Ok(())
}

/// The maximum number of worker threads.
fn most(cores: usize) -> usize {
    cores.saturating_mul(PER_CORE).max(ALWAYS)
}

#[cfg(test)]
mod tests {
    use super::most;

    #[test]
    fn a_few_threads_per_core_are_enough() {
        assert_eq!([1, 2, 4, 5, 64].map(most), [16, 16, 16, 20, 256]);
    }
}
