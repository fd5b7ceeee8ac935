//! The guide: chapters for users of the program and for its developers.
//!
//! `holosonar help TOPIC` shows the same chapters in a terminal, and `holosonar man DIR` writes them as manual pages. Their
//! examples are run by the tests.

/// A chapter of the guide, as the command line shows it.
pub(crate) struct Chapter {
    module: &'static str,
    summary: &'static str,
    /// Its Markdown.
    pub(crate) text: &'static str,
}

impl Chapter {
    /// Its topic, such as `run-file`.
    pub(crate) fn topic(&self) -> String {
        self.module.replace('_', "-")
    }

    /// Its subject, in a few words.
    pub(crate) fn about(&self) -> String {
        let summary = self.summary.trim().trim_end_matches('.');
        summary[..1].to_lowercase() + &summary[1..]
    }
}

// References between chapters. In the files themselves they lead to other files; here, where they come first, to modules, and
// to a picture as it is.
macro_rules! chapters {
    ($(#[doc = $about:literal] $name:ident: $text:expr $(, with $picture:expr)?;)+) => {
        $(
            #[doc = $about]
            ///
            /// [run-file]: crate::guide::run_file
            /// [files]: crate::guide::files
            /// [measured]: crate::guide::measured
            /// [python]: crate::guide::python
            /// [design]: crate::guide::design
            /// [physics]: crate::guide::physics
            /// [method]: crate::guide::method
            /// [metrics]: crate::guide::metrics
            /// [paper]: crate::guide::paper
            /// [interruption]: crate::guide::interruption
            /// [security]: crate::guide::security
            /// [performance]: crate::guide::performance
            /// [limits]: crate::guide::limits
            /// [code]: crate::guide::code
            /// [annotated.toml]: #the-annotated-file
            ///
            $(#[doc = $picture])?
            #[doc = $text]
            pub mod $name {}
        )+

        /// The chapters, in reading order.
        pub(crate) const CHAPTERS: &[Chapter] =
            &[$(Chapter { module: stringify!($name), summary: $about, text: $text }),+];
    };
}

chapters! {
    /// Every key of the run file, annotated.
    run_file: concat!(
        include_str!("guide/run_file.md"),
        "\n```toml\n",
        include_str!("config/annotated.toml"),
        "```\n"
    );
    /// Every file that is read or written.
    files: include_str!("guide/files.md");
    /// From a recording to an image.
    measured: include_str!("guide/measured.md");
    /// The Python package, and the same jobs in Acoular and pyroomacoustics.
    python: include_str!("guide/python.md");
    /// Choosing array, band and grid before measuring.
    design: include_str!("guide/design.md");
    /// What is simulated, and what it does to an image.
    physics: include_str!("guide/physics.md"), with include_str!(concat!(env!("OUT_DIR"), "/multipath.md"));
    /// How the volume is computed, and how exactly.
    method: include_str!("guide/method.md");
    /// How a depth map is scored.
    metrics: include_str!("guide/metrics.md");
    /// The paper's table and figures, reproduced.
    paper: include_str!("guide/paper.md");
    /// Resuming, limits of memory, identical results.
    interruption: include_str!("guide/interruption.md");
    /// What is trusted, what is not, and what is promised.
    security: include_str!("guide/security.md");
    /// What was measured, and how to measure it.
    performance: include_str!("guide/performance.md");
    /// What is not modelled, read or possible.
    limits: include_str!("guide/limits.md");
    /// Where things are in the source, and how to add to it.
    code: include_str!("guide/code.md");
}

/// The Rust examples of the README, run as those of the chapters are.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
pub mod readme {}
