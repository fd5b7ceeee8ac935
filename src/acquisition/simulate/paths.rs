//! The paths of reflectors that sound reaches by a detour: they have a transmit length of their own, and may be seen through
//! mirrors from some microphones only.

use super::losses::Legs;
use super::{PropagationModel, SimulateOptions};
use crate::acquisition::Instrument;
use crate::error::{Error, Result};
use crate::reflectors::Reflectors;
use crate::wave::Geometry;
use glam::DVec3;
use num_complex::Complex32;

/// Refuses what detours cannot be simulated with.
pub(super) fn check(
    reflectors: &Reflectors,
    instrument: &Instrument,
    options: &SimulateOptions,
) -> Result<()> {
    if reflectors.transmit_lengths().is_empty() {
        return Ok(());
    }
    let refused = [
        (
            !matches!(instrument.geometry, Geometry::FixedSource { .. }),
            "need a speaker that stays in its place; a scan has other mirror images at each of its places",
        ),
        (instrument.interface.is_some(), "are simulated in one medium, without [medium] interface"),
        (
            options.model == PropagationModel::Linear,
            "have exact paths only: images are too near for the far-field approximation, model = \"linear\"",
        ),
        (
            options.losses.speaker_radius > 0.0,
            "are simulated for a speaker that radiates alike in all directions, [array] speaker_radius = 0",
        ),
    ];
    refused.into_iter().find(|(found, _)| *found).map_or(Ok(()), |(_, problem)| {
        Err(Error::input("bounced reflectors ([scene] bounces or edges)", problem))
    })
}

/// The length of the way of reflector `j`'s sound to the place from which it shines, m.
pub(super) fn outward_length(reflectors: &Reflectors, j: usize, instrument: &Instrument) -> f64 {
    reflectors.transmit(j).unwrap_or_else(|| instrument.outward_length(reflectors.positions()[j]))
}

/// The length of the path of reflector `j` to the microphone at `r`, m.
#[inline]
pub(super) fn path_length(
    reflectors: &Reflectors,
    j: usize,
    r: DVec3,
    instrument: &Instrument,
    options: &SimulateOptions,
) -> f64 {
    let p = reflectors.positions()[j];
    match reflectors.transmit(j) {
        Some(transmit) => transmit + p.distance(r),
        None => options.model.path_length(instrument, p, r),
    }
}

/// The losses of the echo of reflector `j` at `r`.
pub(super) fn legs(
    reflectors: &Reflectors,
    j: usize,
    r: DVec3,
    instrument: &Instrument,
    options: &SimulateOptions,
) -> Legs {
    let p = reflectors.positions()[j];
    match reflectors.transmit(j) {
        Some(transmit) => Legs::after(transmit, p, r, options),
        None => Legs::new(p, r, instrument, options),
    }
}

/// The amplitude of reflector `j` as it is heard at `r`.
pub(super) fn heard(reflectors: &Reflectors, j: usize, r: DVec3) -> Complex32 {
    reflectors.amplitudes()[j] * reflectors.directivity(j, r)
}
