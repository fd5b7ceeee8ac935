//! Progress bars, warnings, errors and results on a terminal, or quietly without one.

use super::signals;
use crate::error::Error;
use crate::pipeline::JobOptions;
use crate::progress::{Event, Observer};
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use std::io::{self, IsTerminal, Write};
use std::sync::atomic::{AtomicU8, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

/// Draws what the stages report, and hears signals.
#[derive(Debug)]
pub(super) struct Terminal {
    quiet: bool,
    /// Say of each stage what it did and how long it took.
    verbose: bool,
    colour: bool,
    bar: Mutex<Option<ProgressBar>>,
    /// Names and beginnings of the running stages, the innermost last.
    running: Mutex<Vec<(String, Instant)>>,
    /// The exit status of the signal that was heard; 0 before any.
    signalled: Arc<AtomicU8>,
    /// What to tell the user beside an error.
    advice: Mutex<Option<String>>,
}

impl Terminal {
    pub(super) fn new(quiet: bool, verbose: bool) -> Self {
        let signalled = signals::listen();
        let colour = io::stderr().is_terminal() && std::env::var_os("NO_COLOR").is_none_or(|v| v.is_empty());
        let (bar, running, advice) = (Mutex::new(None), Mutex::default(), Mutex::default());
        Self { quiet, verbose, colour, bar, running, signalled, advice }
    }

    fn bar(&self) -> std::sync::MutexGuard<'_, Option<ProgressBar>> {
        self.bar.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn running(&self) -> std::sync::MutexGuard<'_, Vec<(String, Instant)>> {
        self.running.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Whether a summary is wanted.
    pub(super) fn is_quiet(&self) -> bool {
        self.quiet
    }

    /// The exit status of the signal that asked to stop, if one did.
    pub(super) fn signalled(&self) -> Option<u8> {
        Some(self.signalled.load(Ordering::SeqCst)).filter(|status| *status != 0)
    }

    /// Keeps what to tell beside an error.
    pub(super) fn advise(&self, advice: Option<String>) {
        *self.advice.lock().unwrap_or_else(PoisonError::into_inner) = advice;
    }

    /// Prints the error that ends the program.
    pub(super) fn error(&self, error: &Error) {
        let advice = self.advice.lock().unwrap_or_else(PoisonError::into_inner).take();
        let advice = advice.map(|advice| format!("; {advice}")).unwrap_or_default();
        self.say("error", "1;31", &format!("{error}{advice}"));
    }

    fn say(&self, kind: &str, colour: &str, text: &str) {
        self.line(&if self.colour {
            format!("\u{1b}[{colour}m{kind}:\u{1b}[0m {text}")
        } else {
            format!("{kind}: {text}")
        });
    }

    /// Writes a line to standard error, above the bar if there is one.
    fn line(&self, line: &str) {
        let write = || {
            // A standard error that is gone leaves nobody to tell.
            let _ = writeln!(io::stderr(), "{line}");
        };
        match &*self.bar() {
            Some(bar) => bar.suspend(write),
            None => write(),
        }
    }
}

/// A job that is observed on the terminal.
pub(super) fn observed(terminal: &Terminal) -> JobOptions<'_> {
    JobOptions::default().with_observer(terminal)
}

/// Prints a result; a closed pipe is the reader's right and ends quietly.
pub(super) fn print(text: &str) -> Result<(), Error> {
    let mut out = io::stdout().lock();
    match out.write_all(text.as_bytes()).and_then(|()| out.flush()) {
        Err(e) if e.kind() != io::ErrorKind::BrokenPipe => {
            Err(Error::io("standard output", format!("cannot be written: {e}")).with_source(e))
        }
        _ => Ok(()),
    }
}

impl Observer for Terminal {
    fn event(&self, event: Event<'_>) {
        if self.quiet {
            return;
        }
        match event {
            Event::Started { stage, total } => {
                let bar =
                    ProgressBar::with_draw_target((total > 0).then_some(total), ProgressDrawTarget::stderr());
                let template = if total > 0 {
                    "{prefix:28} {wide_bar} {percent:>3} %  {eta:>4} left"
                } else {
                    "{prefix:28} {spinner} {elapsed}"
                };
                if let Ok(style) = ProgressStyle::with_template(template) {
                    bar.set_style(style.progress_chars("━━─"));
                }
                bar.set_prefix(stage.to_owned());
                if io::stderr().is_terminal() {
                    bar.enable_steady_tick(Duration::from_millis(100)); // a thread of its own
                }
                *self.bar() = Some(bar);
                self.running().push((stage.to_owned(), Instant::now()));
            }
            Event::Advanced { amount } => {
                if let Some(bar) = &*self.bar() {
                    bar.inc(amount);
                }
            }
            Event::Finished => {
                if let Some(bar) = self.bar().take() {
                    bar.finish_and_clear();
                }
                let ended = self.running().pop();
                if let Some((stage, begun)) = ended.filter(|_| self.verbose) {
                    self.line(&format!("{stage:28} {:8.2} s", begun.elapsed().as_secs_f64()));
                }
            }
        }
    }

    fn note(&self, message: &str) {
        if self.verbose {
            self.line(&format!("  {message}"));
        }
    }

    fn warn(&self, message: &str) {
        if !self.quiet {
            self.say("warning", "1;33", message);
        }
    }

    fn tell(&self, message: &str) {
        if !self.quiet {
            self.say("note", "1;36", message);
        }
    }

    fn should_stop(&self) -> bool {
        self.signalled.load(Ordering::Relaxed) != 0
    }
}

/// Makes a panic, which is always our mistake, say what to do about it; but for memory that a library panics for want of,
/// which is the machine's and ends the process with status 1, as an allocation of the standard library does.
pub(super) fn explain_panics() {
    let default = std::panic::take_hook();
    std::panic::set_hook(Box::new(move |panic| {
        // Readers of files catch the panics of the crates they call and report an error instead.
        if crate::error::is_guarded() {
            return;
        }
        if panic.payload_as_str().is_some_and(|said| said.contains("AllocError")) {
            // Nothing that takes memory, and no unwinding: it would end as a mistake of the thread that waits for this one.
            let _ = io::stderr().write_all(
                b"error: memory: an allocation of the linear algebra failed; give --memory SIZE to have less worked on \
                  at a time, or free some memory (or addresses, if `ulimit -v` is set)\n",
            );
            #[allow(clippy::exit)]
            std::process::exit(1);
        }
        let _ = writeln!(
            io::stderr(),
            "error: this is a mistake in holosonar, not in your input; please report it with the lines below and, \
             if you can, the input"
        );
        default(panic);
    }));
}
