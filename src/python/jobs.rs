//! Jobs: the work is done on a thread of its own while the calling thread, without holding the interpreter, waits and looks
//! twenty times per second for Ctrl-C and for what there is to report.
//!
//! Callbacks and warnings are therefore always called on the thread that called the function, as bars in a notebook need
//! it, and never while the work waits for them. A callback that raises stops the job.

use crate::error::{Error, Result};
use crate::progress::{Event, Observer};
use pyo3::prelude::*;
use std::collections::VecDeque;
use std::panic::resume_unwind;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{RecvTimeoutError, channel};
use std::sync::{Mutex, PoisonError};
use std::thread;
use std::time::Duration;

/// From one look at signals and reports to the next.
const PAUSE: Duration = Duration::from_millis(50);

/// Bytes of the stack of the thread that works; parsers recurse.
const STACK: usize = 8 << 20;

/// What a job has reported and Python has not seen yet.
enum JobReport {
    Started(String, u64),
    Advanced(u64),
    Finished,
    Note(String),
    Warning(String),
}

/// Collects the reports of a job, and asks it to stop.
#[derive(Default)]
struct JobReports {
    queue: Mutex<VecDeque<JobReport>>,
    stop: AtomicBool,
}

impl JobReports {
    fn push(&self, report: JobReport) {
        let mut queue = self.queue.lock().unwrap_or_else(PoisonError::into_inner);
        match (queue.back_mut(), &report) {
            // There are many of them, and only their sum is reported.
            (Some(JobReport::Advanced(done)), JobReport::Advanced(more)) => *done += more,
            _ => queue.push_back(report),
        }
    }

    fn take(&self) -> VecDeque<JobReport> {
        std::mem::take(&mut *self.queue.lock().unwrap_or_else(PoisonError::into_inner))
    }
}

impl Observer for JobReports {
    fn event(&self, event: Event<'_>) {
        self.push(match event {
            Event::Started { stage, total } => JobReport::Started(stage.to_owned(), total),
            Event::Advanced { amount } => JobReport::Advanced(amount),
            Event::Finished => JobReport::Finished,
        });
    }

    fn note(&self, message: &str) {
        self.push(JobReport::Note(message.to_owned()));
    }

    fn warn(&self, message: &str) {
        self.push(JobReport::Warning(message.to_owned()));
    }

    fn tell(&self, message: &str) {
        self.push(JobReport::Note(message.to_owned()));
    }

    fn should_stop(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }
}

/// A running stage.
struct RunningStage {
    name: String,
    done: u64,
    total: u64,
}

/// Passes reports on to Python.
struct ProgressListener<'a> {
    /// Called with the name of the stage, the units of work done, and all of them (0 if not known).
    progress: Option<&'a Py<PyAny>>,
    running: Vec<RunningStage>,
}

impl ProgressListener<'_> {
    fn deliver(&mut self, py: Python<'_>, reports: VecDeque<JobReport>) -> PyResult<()> {
        for report in reports {
            match report {
                JobReport::Started(name, total) => {
                    self.running.push(RunningStage { name, done: 0, total });
                    self.call(py)?;
                }
                JobReport::Advanced(amount) => {
                    if let Some(stage) = self.running.last_mut() {
                        stage.done += amount;
                    }
                    self.call(py)?;
                }
                JobReport::Finished => {
                    if let Some(stage) = self.running.last_mut() {
                        stage.total = stage.total.max(1);
                        stage.done = stage.total;
                    }
                    self.call(py)?;
                    self.running.pop();
                }
                JobReport::Note(message) => {
                    py.import("holosonar._progress")?.call_method1("note", (message,))?;
                }
                JobReport::Warning(message) => {
                    py.import("holosonar._progress")?.call_method1("warn", (message,))?;
                }
            }
        }
        Ok(())
    }

    fn call(&self, py: Python<'_>) -> PyResult<()> {
        let (Some(progress), Some(stage)) = (self.progress, self.running.last()) else { return Ok(()) };
        let RunningStage { name, done, total } = stage;
        progress.call1(py, (name, done, total)).map(drop)
    }
}

/// Does `work` without holding the interpreter; reports to `progress`, and stops on Ctrl-C.
///
/// # Errors
/// Those of `work`; `KeyboardInterrupt`; what a callback or a warning raised, which stops the work.
pub(super) fn run<T: Send>(
    py: Python<'_>,
    progress: Option<&Py<PyAny>>,
    work: impl FnOnce(&dyn Observer) -> Result<T> + Send,
) -> PyResult<T> {
    let reports = JobReports::default();
    let mut listener = ProgressListener { progress, running: Vec::new() };
    let (result, failure) = py.detach(|| wait(&reports, &mut listener, work))?;
    if let Some(failure) = failure {
        return Err(failure);
    }
    listener.deliver(py, reports.take())?;
    Ok(result?)
}

/// Waits for the work; returns its result, and what was raised meanwhile.
fn wait<T: Send>(
    reports: &JobReports,
    listener: &mut ProgressListener<'_>,
    work: impl FnOnce(&dyn Observer) -> Result<T> + Send,
) -> Result<(Result<T>, Option<PyErr>)> {
    thread::scope(|scope| {
        let (done, ended) = channel();
        let job = move || {
            let result = work(reports);
            // Nobody waits any more if the waiting thread panicked.
            let _ = done.send(());
            result
        };
        let builder = thread::Builder::new().name("holosonar".to_owned()).stack_size(STACK);
        let worker = builder.spawn_scoped(scope, job).map_err(|error| {
            Error::io("threads", format!("no thread can be started: {error}")).with_source(error)
        })?;
        let mut failure = None;
        while let Err(RecvTimeoutError::Timeout) = ended.recv_timeout(PAUSE) {
            if failure.is_some() {
                continue;
            }
            let looked = Python::attach(|py| {
                py.check_signals()?;
                listener.deliver(py, reports.take())
            });
            if let Err(raised) = looked {
                failure = Some(raised);
                reports.stop.store(true, Ordering::Relaxed);
            }
        }
        let result = worker.join().unwrap_or_else(|panic| resume_unwind(panic));
        Ok((result, failure))
    })
}
