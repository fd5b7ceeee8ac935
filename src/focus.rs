//! Autofocus and blind self-calibration: what a measured cube's own image says about the instrument.
//!
//! [`autofocus`] tries values of one parameter, as the speed of sound, and asks which makes the image of a region sharpest, how
//! sure that is, and whether the parameter can be known from this cube at all. It changes nothing. [`self_calibrate`] finds errors of
//! channels, and has them judged by others.
//!
//! This module images, and so is above [`reconstruct`](crate::reconstruct); it knows neither scene nor truth.

mod autofocus;
mod blind;
mod displacement;
mod jackknife;
mod measure;
mod one_of_many;
mod parameter;
#[cfg(test)]
mod tests;
mod verdict;

pub use autofocus::{Autofocus, AutofocusOptions, FocusTrial, autofocus};
pub use blind::{ChannelError, HeldOut, SelfCalibration, SelfCalibrationVerdict, self_calibrate};
pub(crate) use jackknife::VOLUMES as AUTOFOCUS_VOLUMES;
pub use measure::FocusMeasure;
pub use parameter::FocusParameter;
pub use verdict::FocusVerdict;
