//! What the user chooses: how to sum, with which weights, to within which error.

use super::{RefineOptions, Window};
use crate::choice::choice;
use crate::wave::Motion;
use crate::with_fields::with_fields;

choice! {
    /// How the sums of Eq. 13 are carried out.
    #[derive(Default)]
    pub enum Method: "method" {
        /// Convolution where the microphones lie in a plane, else back-projection; direct where that costs less.
        #[default]
        Auto = "auto",
        /// Eq. 16 by padded 2-D FFTs, for any planar array and any voxel pitch.
        Convolution = "convolution",
        /// Range profiles along every voxel's paths, for any array and any grid.
        Backprojection = "backprojection",
        /// Eq. 13 as written.
        Direct = "direct",
        /// The far-field Fourier transform of Eq. 9, which the paper dropped; for comparison, and never taken by `Auto`.
        Linear = "linear",
        /// Pairs of microphones: the power of Eq. 13 in sub-bands, without the phase of the loudspeaker; never taken by `Auto`.
        Correlation = "correlation",
    }
}

/// Parameters of [`reconstruct`](super::reconstruct()).
///
/// ```
/// use holosonar::reconstruct::{Method, ReconstructOptions, Window};
///
/// let options = ReconstructOptions::default().with_window(Window::Hann).with_tolerance(1e-5).with_memory(1 << 30);
/// assert_eq!((options.method, options.memory), (Method::Auto, Some(1 << 30)));
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct ReconstructOptions {
    /// How to sum.
    pub method: Method,
    /// Weights over x, y and f.
    pub window: Window,
    /// Error allowed to `Convolution` and `Backprojection`, relative to `Σ|w m| / Σw`; 0 sums every frequency on a
    /// lattice that fits.
    pub tolerance: f64,
    /// Whether to undo spherical spreading: every voxel is multiplied by `|p − s| |p − r_c| / (1 m)²`, r_c the array's
    /// centre (monostatic: `|p − r_c|²`), so that a unit reflector peaks at 1 again, and noise grows with distance.
    pub compensate: bool,
    /// Bytes that may be used beside samples and volume: less is worked on at a time, and by fewer threads, where that
    /// keeps to it. It changes no byte of the volume. `None` is no limit.
    pub memory: Option<u64>,
    /// How the volume is refined beyond Eq. 13, if it is. By convolution only.
    pub refine: Option<RefineOptions>,
    /// Of `Correlation`: the tones of a sub-band, within which the loudspeaker's phases are trusted; 1 for none.
    pub sub_band: usize,
    /// The velocity of the frame that is imaged, if it moves while tones are played: it is seen where it is at the first one.
    pub motion: Option<Motion>,
    /// What another process of the same job has found to take least: the others are not priced, which takes time.
    pub(crate) known: Option<Method>,
}

impl Default for ReconstructOptions {
    fn default() -> Self {
        Self::new(Method::Auto, Window::Taylor)
    }
}

with_fields! {
    ReconstructOptions {
        with_method(method: Method),
        with_window(window: Window),
        with_tolerance(tolerance: f64),
        with_compensate(compensate: bool),
        with_memory(memory: Option<u64>),
        with_refine(refine: Option<RefineOptions>),
        with_sub_band(sub_band: usize),
        with_motion(motion: Option<Motion>),
    }
}

impl ReconstructOptions {
    /// Options of a given method and window, with the default tolerance of 10⁻⁴ and nothing compensated.
    pub fn new(method: Method, window: Window) -> Self {
        Self {
            method,
            window,
            tolerance: 1e-4,
            compensate: false,
            memory: None,
            refine: None,
            sub_band: 1,
            motion: None,
            known: None,
        }
    }
}
