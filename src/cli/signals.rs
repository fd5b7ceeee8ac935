//! Ctrl-C and SIGTERM: the first requests the job to finish and store its block; the second ends the process. And what else
//! the system ends a process with, which becomes an error with an exit status: the abort of a failed allocation, and a file
//! larger than `ulimit -f`.

use std::io::{self, IsTerminal, Write};
use std::sync::Arc;
#[cfg(unix)]
use std::sync::atomic::AtomicBool;
use std::sync::atomic::{AtomicU8, Ordering};

/// Makes a failed allocation in a library, or one too small to be checked, end the process with status 1; and writing a file
/// that is too large fail as on a full disk.
///
/// For an allocation the standard library has then printed `memory allocation of N bytes failed`, and provides no other
/// notification.
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

/// Handles signals from now on; returns where the exit status of a signal is stored, 128 plus its number. If no handler can
/// be installed, signals end the process as usual.
pub(super) fn listen() -> Arc<AtomicU8> {
    let received = Arc::new(AtomicU8::new(0));
    let stored = Arc::clone(&received);
    spawn(move |status: u8| {
        if stored.swap(status, Ordering::SeqCst) == 0 {
            return;
        }
        // Locked until the process ends, so that no thread draws another bar.
        let _terminal = io::stderr().is_terminal().then(|| {
            let mut terminal = io::stderr().lock();
            // The progress bar is erased, and the cursor is visible again.
            let _ = write!(terminal, "\r\u{1b}[2K\u{1b}[?25h");
            terminal
        });
        #[allow(clippy::exit)]
        std::process::exit(status.into());
    });
    received
}

#[cfg(unix)]
fn spawn(handle: impl Fn(u8) + Send + 'static) {
    use signal_hook::consts::{SIGINT, SIGTERM};
    let Ok(mut signals) = signal_hook::iterator::Signals::new([SIGINT, SIGTERM]) else { return };
    let wait = move || signals.forever().for_each(|signal| handle(128 + signal as u8));
    // SIGHUP is not handled, so that `nohup` works; a job that it kills can be resumed.
    let _ = std::thread::Builder::new().name("signals".to_owned()).stack_size(1 << 17).spawn(wait);
}

#[cfg(not(unix))]
fn spawn(handle: impl Fn(u8) + Send + 'static) {
    let _ = ctrlc::set_handler(move || handle(130));
}
