//! Ctrl-C and SIGTERM: the first requests the job to finish and store its block; the second, or a second without an end,
//! ends the process. And what else the system ends a process with, which becomes an error with an exit status: the abort of
//! a failed allocation, and a file larger than `ulimit -f`.

use crate::error::Error;
use crate::files::unfinished;
use std::io::{self, IsTerminal, Write};
use std::sync::Arc;
#[cfg(unix)]
use std::sync::atomic::AtomicBool;
use std::sync::atomic::{AtomicU8, AtomicU64, Ordering};
use std::time::{Duration, Instant};

/// How long a command may take to end after a signal, except where it stores a block: long calls of libraries, and waiting
/// for a pipe, ask nobody whether to stop.
const PATIENCE: Duration = Duration::from_millis(800);

/// How often a command that should end is looked at.
const PAUSE: Duration = Duration::from_millis(20);

/// A request to stop by a signal, and what is known about the time that takes.
#[derive(Debug, Default)]
pub(super) struct StopRequest {
    /// The exit status of the signal, 128 plus its number; 0 before any.
    status: AtomicU8,
    /// Milliseconds that the work may take to store its block.
    grace: AtomicU64,
}

impl StopRequest {
    /// The exit status of the signal that was received; `None` before any.
    pub(super) fn status(&self) -> Option<u8> {
        Some(self.status.load(Ordering::SeqCst)).filter(|status| *status != 0)
    }

    /// Sets how long the work may take to store its block.
    pub(super) fn set_grace_period(&self, longest: Duration) {
        self.grace.store(longest.as_millis() as u64, Ordering::SeqCst);
    }

    /// When to end a process that was asked to stop at `asked`, seen from `now`: after [`PATIENCE`], which begins when no
    /// block is waited for any more. `until` is what was returned before.
    fn deadline(&self, asked: Instant, now: Instant, until: Option<Instant>) -> Instant {
        let grace = Duration::from_millis(self.grace.load(Ordering::SeqCst));
        let waits = now - asked < grace;
        until.filter(|_| !waits).unwrap_or(now + PATIENCE)
    }

    /// Takes a signal; returns whether it is the first.
    fn receive(&self, status: u8) -> bool {
        self.status.swap(status, Ordering::SeqCst) == 0
    }

    /// Waits for the end of the process, and ends it when it is overdue or `again` says that there was another signal.
    fn enforce(&self, mut again: impl FnMut() -> Option<u8>) {
        let asked = Instant::now();
        let mut until = None;
        loop {
            if let Some(status) = again() {
                leave(status, None);
            }
            let now = Instant::now();
            let deadline = self.deadline(asked, now, until);
            if now >= deadline {
                leave(self.status.load(Ordering::SeqCst), Some(&Error::Interrupted));
            }
            until = Some(deadline);
            std::thread::sleep(PAUSE);
        }
    }
}

/// Ends the process at once, without unfinished files.
fn leave(status: u8, why: Option<&Error>) {
    let _listed = unfinished::remove_all();
    let mut terminal = io::stderr().is_terminal().then(|| {
        // Locked until the process ends, so that no thread draws another bar.
        let mut terminal = io::stderr().lock();
        // The progress bar is erased, and the cursor is visible again.
        let _ = write!(terminal, "\r\u{1b}[2K\u{1b}[?25h");
        terminal
    });
    if let Some(why) = why {
        let line = format!("error: {why}\n");
        let _ = match &mut terminal {
            Some(terminal) => terminal.write_all(line.as_bytes()),
            None => io::stderr().write_all(line.as_bytes()),
        };
    }
    #[allow(clippy::exit)]
    std::process::exit(status.into());
}

/// Makes a failed allocation in a library, or one too small to be checked, end the process with status 1; and writing a file
/// that is too large fail as on a full disk.
///
/// For an allocation the standard library has then printed `memory allocation of N bytes failed`, or the C library that it
/// failed to register a thread's destructor, and they provide no other notification.
#[cfg(unix)]
pub(super) fn expect_aborts() {
    use signal_hook::consts::{SIGABRT, SIGXFSZ};
    let always = Arc::new(AtomicBool::new(true));
    let _ = signal_hook::flag::register_conditional_shutdown(SIGABRT, 1, always);
    // With any handler, the write returns an error.
    let _ = signal_hook::flag::register(SIGXFSZ, Arc::default());
}

#[cfg(not(unix))]
pub(super) fn expect_aborts() {}

/// Handles signals from now on. If no handler can be installed, signals end the process as usual.
pub(super) fn listen() -> Arc<StopRequest> {
    let request = Arc::new(StopRequest::default());
    spawn(Arc::clone(&request));
    request
}

#[cfg(unix)]
fn spawn(request: Arc<StopRequest>) {
    use signal_hook::consts::{SIGINT, SIGTERM};
    let Ok(mut signals) = signal_hook::iterator::Signals::new([SIGINT, SIGTERM]) else { return };
    let wait = move || {
        let status = |signal: i32| 128 + signal as u8;
        if let Some(signal) = signals.forever().next() {
            request.receive(status(signal));
            request.enforce(|| signals.pending().next().map(status));
        }
    };
    // SIGHUP is not handled, so that `nohup` works; a job that it kills can be resumed.
    let _ = std::thread::Builder::new().name("signals".to_owned()).stack_size(1 << 17).spawn(wait);
}

#[cfg(not(unix))]
fn spawn(request: Arc<StopRequest>) {
    let again = Arc::new(AtomicU8::new(0));
    let _ = ctrlc::set_handler(move || {
        if !request.receive(130) {
            again.store(130, Ordering::SeqCst);
            return;
        }
        let (request, again) = (Arc::clone(&request), Arc::clone(&again));
        let again = move || Some(again.load(Ordering::SeqCst)).filter(|status| *status != 0);
        let _ = std::thread::Builder::new().spawn(move || request.enforce(again));
    });
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn patience_begins_when_no_block_is_waited_for() {
        let request = StopRequest::default();
        assert_eq!(request.status(), None);
        assert!(request.receive(130) && !request.receive(143));
        assert_eq!(request.status(), Some(143));
        let asked = Instant::now();
        let at = |ms: u64| asked + Duration::from_millis(ms);
        let first = request.deadline(asked, at(0), None);
        assert_eq!(first, asked + PATIENCE);
        assert_eq!(request.deadline(asked, at(700), Some(first)), first);
        request.set_grace_period(Duration::from_secs(5));
        let later = request.deadline(asked, at(3000), Some(first));
        assert_eq!(later, at(3000) + PATIENCE);
        // The block is stored, or has taken too long.
        assert_eq!(request.deadline(asked, at(5001), Some(later)), later);
        request.set_grace_period(Duration::ZERO);
        assert_eq!(request.deadline(asked, at(3001), Some(later)), later);
    }
}
