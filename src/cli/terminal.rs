//! Progress bars, warnings, errors and results, on a terminal or in a pipe.

use super::Common;
use super::signals::{self, StopRequest};
use crate::error::Error;
use crate::pipeline::JobOptions;
use crate::progress::{Event, Observer};
use crate::text::escaped;
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use std::borrow::Cow;
use std::ffi::OsString;
use std::io::{self, IsTerminal, Write};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// Shows what the stages report, and receives signals.
#[derive(Debug)]
pub(super) struct Terminal {
    options: Common,
    colour: bool,
    bar: Mutex<Option<ProgressBar>>,
    /// Names and starting times of the running stages, the innermost last.
    running: Mutex<Vec<(String, Instant)>>,
    /// The signal that was received, if there was one.
    signalled: Arc<StopRequest>,
    /// Advice to the user, printed after an error.
    advice: Mutex<Option<String>>,
}

impl Terminal {
    pub(super) fn new(options: Common) -> Self {
        let signalled = signals::listen();
        let colour = io::stderr().is_terminal() && std::env::var_os("NO_COLOR").is_none_or(|v| v.is_empty());
        let (bar, running, advice) = (Mutex::new(None), Mutex::default(), Mutex::default());
        Self { options, colour, bar, running, signalled, advice }
    }

    /// Whether to print results as JSON.
    pub(super) fn json(&self) -> bool {
        self.options.json
    }

    /// Whether to print no summary.
    pub(super) fn is_quiet(&self) -> bool {
        self.options.quiet
    }

    /// The exit status for the signal that requested a stop, if there was one.
    pub(super) fn signalled(&self) -> Option<u8> {
        self.signalled.status()
    }

    /// Stores the advice to print after an error.
    pub(super) fn advise(&self, advice: Option<String>) {
        *locked(&self.advice) = advice;
    }

    /// Prints the error that ends the program.
    pub(super) fn error(&self, error: &Error) {
        let advice = locked(&self.advice).take();
        let advice = advice.map(|advice| format!("; {advice}")).unwrap_or_default();
        self.say("error", "1;31", &format!("{error}{advice}"));
    }

    fn say(&self, kind: &str, colour: &str, text: &str) {
        let text = escaped(text);
        self.line(&if self.colour {
            format!("\u{1b}[{colour}m{kind}:\u{1b}[0m {text}")
        } else {
            format!("{kind}: {text}")
        });
    }

    /// Writes a line to standard error, above the bar if there is one.
    fn line(&self, line: &str) {
        let write = || {
            // If standard error is closed, nothing can be reported.
            let _ = writeln!(io::stderr(), "{line}");
        };
        match &*locked(&self.bar) {
            Some(bar) => bar.suspend(write),
            None => write(),
        }
    }
}

/// Locks a value that a panic leaves valid.
fn locked<T>(value: &Mutex<T>) -> MutexGuard<'_, T> {
    value.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Options of a job that is observed on the terminal.
pub(super) fn observed(terminal: &Terminal) -> JobOptions<'_> {
    JobOptions::default().with_observer(terminal)
}

/// Prints a result; a closed pipe is not an error.
pub(super) fn print(text: &str) -> Result<(), Error> {
    print_as_it_is(&escaped(text))
}

/// As [`print`], for text without characters that act on a terminal.
pub(super) fn print_as_it_is(text: &str) -> Result<(), Error> {
    let mut out = io::stdout().lock();
    printed(out.write_all(text.as_bytes()).and_then(|()| out.flush()))
}

/// Prints help or a mistake in the command line as clap does, in colour if the terminal has it.
pub(super) fn print_help(message: &clap::Error, typed: &[OsString]) -> Result<(), Error> {
    // A mistake quotes what was typed, or what a pattern of the shell found; then it is without colours.
    let acts = typed.iter().any(|typed| matches!(escaped(&typed.to_string_lossy()), Cow::Owned(_)));
    printed(if acts && message.use_stderr() {
        io::stderr().write_all(escaped(&message.render().to_string()).as_bytes())
    } else {
        message.print().and_then(|()| io::stdout().flush())
    })
}

fn printed(result: io::Result<()>) -> Result<(), Error> {
    match result {
        Err(e) if e.kind() != io::ErrorKind::BrokenPipe => {
            Err(Error::io("standard output", format!("cannot be written: {e}")).with_source(e))
        }
        _ => Ok(()),
    }
}

impl Observer for Terminal {
    fn event(&self, event: Event<'_>) {
        if self.options.quiet {
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
                *locked(&self.bar) = Some(bar);
                locked(&self.running).push((stage.to_owned(), Instant::now()));
            }
            Event::Advanced { amount } => {
                if let Some(bar) = &*locked(&self.bar) {
                    bar.inc(amount);
                }
            }
            Event::Finished => {
                if let Some(bar) = locked(&self.bar).take() {
                    bar.finish_and_clear();
                }
                let ended = locked(&self.running).pop();
                if let Some((stage, start)) = ended.filter(|_| self.options.verbose) {
                    self.line(&format!("{stage:28} {:8.2} s", start.elapsed().as_secs_f64()));
                }
            }
        }
    }

    fn note(&self, message: &str) {
        if self.options.verbose {
            self.line(&format!("  {}", escaped(message)));
        }
    }

    fn warn(&self, message: &str) {
        if !self.options.quiet {
            self.say("warning", "1;33", message);
        }
    }

    fn tell(&self, message: &str) {
        if !self.options.quiet {
            self.say("note", "1;36", message);
        }
    }

    fn should_stop(&self) -> bool {
        self.signalled.status().is_some()
    }

    fn grace_period(&self, longest: Duration) {
        self.signalled.set_grace_period(longest);
    }
}

/// Makes a panic, which is always a mistake in the program, ask for a report; except that a library's panic for lack of
/// memory ends the process with status 1, as a failed allocation of the standard library does.
pub(super) fn explain_panics() {
    let default = std::panic::take_hook();
    std::panic::set_hook(Box::new(move |panic| {
        // Readers of files catch the panics of other crates and report an error instead.
        if crate::error::is_guarded() {
            return;
        }
        if panic.payload_as_str().is_some_and(|message| message.contains("AllocError")) {
            // No allocation and no unwinding, which would end as a panic of the thread that waits for this one.
            let _ = io::stderr().write_all(
                b"error: memory: an allocation of the linear algebra failed; give --memory SIZE to process less \
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
