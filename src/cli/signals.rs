//! Ctrl-C and SIGTERM: the first asks the running job to end its block and keep what is done; the second ends the process.
//! And the abort of an allocation that nobody could foresee: the exit status of any other lack of memory.

use std::io::{self, IsTerminal, Write};
use std::sync::Arc;
#[cfg(unix)]
use std::sync::atomic::AtomicBool;
use std::sync::atomic::{AtomicU8, Ordering};

/// Lets an allocation that fails within a library, or that is too small to be asked for, end the process with status 1.
///
/// The standard library has said `memory allocation of N bytes failed` by then, and offers no other way to be told.
#[cfg(unix)]
pub(super) fn expect_aborts() {
    let always = Arc::new(AtomicBool::new(true));
    let _ = signal_hook::flag::register_conditional_shutdown(signal_hook::consts::SIGABRT, 1, always);
}

#[cfg(not(unix))]
pub(super) fn expect_aborts() {}

/// Listens from now on; gives where the exit status of a signal is noted, 128 and its number. If no handler can be had,
/// signals end the process as they do any other.
pub(super) fn listen() -> Arc<AtomicU8> {
    let heard = Arc::new(AtomicU8::new(0));
    let noted = Arc::clone(&heard);
    let hear = move |status: u8| {
        if noted.swap(status, Ordering::SeqCst) == 0 {
            return;
        }
        // Locked until the end, so that no thread draws another bar.
        let _terminal = io::stderr().is_terminal().then(|| {
            let mut terminal = io::stderr().lock();
            // No half of a progress bar is left, and the cursor is to be seen.
            let _ = write!(terminal, "\r\u{1b}[2K\u{1b}[?25h");
            terminal
        });
        #[allow(clippy::exit)]
        std::process::exit(status.into());
    };
    spawn(hear);
    heard
}

#[cfg(unix)]
fn spawn(hear: impl Fn(u8) + Send + 'static) {
    use signal_hook::consts::{SIGINT, SIGTERM};
    let Ok(mut signals) = signal_hook::iterator::Signals::new([SIGINT, SIGTERM]) else { return };
    let heard = move || signals.forever().for_each(|signal| hear(128 + signal as u8));
    // A hang-up is left alone, so that `nohup` works; what it kills can be continued.
    let _ = std::thread::Builder::new().name("signals".to_owned()).stack_size(1 << 17).spawn(heard);
}

#[cfg(not(unix))]
fn spawn(hear: impl Fn(u8) + Send + 'static) {
    let _ = ctrlc::set_handler(move || hear(130));
}
