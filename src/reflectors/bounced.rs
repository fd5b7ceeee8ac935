//! Reflectors that sound reaches by a detour: how far it has come to them, and the mirrors through which they are seen.
//!
//! The echo of such a reflector is `A e^{i2πf (t + |q − r|)/c}` at the microphones at r from which it is seen, with a transmit
//! length t of its own instead of `|q − s|`, at a place q that may be an image behind mirrors. It is seen where the straight
//! line from r to q passes through the last mirror, and on, folded, through those before it.

use super::Reflectors;
use super::facets::Facet;
use glam::DVec3;
use serde::Serialize;
use std::sync::Arc;

/// The surfaces that a path meets, in the order of the sound.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub(crate) struct PathKind {
    /// Mirrors before the first patch.
    pub(super) before: Vec<u32>,
    /// Patches that scatter: 0, 1 or 2.
    pub(super) patches: u8,
    /// Mirrors after the last patch; all of them for a path of mirrors alone.
    pub(super) after: Vec<u32>,
}

/// What was found and what was left out.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
pub struct BounceCounts {
    /// Facets that mirror.
    pub mirrors: usize,
    /// Area of the surfaces that are no mirror, because they are small or curved, m².
    pub no_mirror_area: f64,
    /// Patches from which each patch is lit, of all that light it.
    pub partners: [usize; 2],
    /// Share of the energy of bounced echoes that was dropped, the weakest of them first, to limit their number.
    pub dropped_energy: f64,
}

/// The reflectors of a list that are reached by a detour, which are its last ones.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Bounced {
    /// How many reflectors come before them.
    pub(super) first: usize,
    /// The length of the path up to the place from which they seem to shine, m.
    pub(super) transmit: Vec<f64>,
    /// The kind of each path.
    pub(super) kind: Vec<u32>,
    pub(super) kinds: Vec<PathKind>,
    pub(super) facets: Arc<[Facet]>,
    /// What each facet is made of.
    pub(super) materials: Vec<String>,
    pub(super) counts: BounceCounts,
}

impl Bounced {
    /// The mirrors that a path meets after its last patch, from the microphone backwards.
    fn mirrors(&self, kind: u32) -> impl Iterator<Item = &Facet> + Clone {
        self.kinds[kind as usize].after.iter().rev().map(|&facet| &self.facets[facet as usize])
    }

    /// Whether bounced reflector `i`, counted from the first of them, is seen through mirrors, and not from everywhere.
    pub(super) fn has_window(&self, i: usize) -> bool {
        !self.kinds[self.kind[i] as usize].after.is_empty()
    }

    /// Whether bounced reflector `i`, which is at `q`, is seen from `r`.
    pub(super) fn sees(&self, i: usize, q: DVec3, r: DVec3) -> bool {
        passes(self.mirrors(self.kind[i]), r, q)
    }
}

/// Whether the line from `from` towards the image `image` passes through all of the mirrors that made the image, last first.
pub(super) fn passes<'f>(mirrors: impl Iterator<Item = &'f Facet>, from: DVec3, image: DVec3) -> bool {
    let (mut from, mut image) = (from, image);
    for facet in mirrors {
        let Some(x) = facet.passage(from, image) else { return false };
        (from, image) = (x, facet.mirror(image));
    }
    true
}

impl Reflectors {
    /// How many sound reaches straight from the speaker; they come first, and bounced ones after them.
    pub fn direct(&self) -> usize {
        self.bounced.as_ref().map_or(self.len(), |bounced| bounced.first)
    }

    /// Those that sound reaches straight from the speaker.
    #[must_use]
    pub fn without_bounced(mut self) -> Self {
        let direct = self.direct();
        self.positions.truncate(direct);
        self.amplitudes.truncate(direct);
        Self { bounced: None, ..self }
    }

    /// What was found and left out of bounced echoes; `None` without any.
    pub fn bounce_counts(&self) -> Option<BounceCounts> {
        self.bounced.as_ref().map(|bounced| bounced.counts)
    }

    /// The transmit lengths of bounced reflectors, m.
    pub(crate) fn transmit_lengths(&self) -> &[f64] {
        self.bounced.as_ref().map_or(&[], |bounced| &bounced.transmit)
    }

    /// The transmit length of reflector `j`, m; `None` for one that sound reaches straight from the speaker.
    #[inline]
    pub(crate) fn transmit(&self, j: usize) -> Option<f64> {
        let bounced = self.bounced.as_ref()?;
        j.checked_sub(bounced.first).map(|i| bounced.transmit[i])
    }

    /// Whether reflector `j` is seen through mirrors, and so not from everywhere.
    pub(crate) fn has_window(&self, j: usize) -> bool {
        let own = self.bounced.as_ref().and_then(|b| Some((b, j.checked_sub(b.first)?)));
        own.is_some_and(|(bounced, i)| bounced.has_window(i))
    }

    /// Whether reflector `j` is seen from `r`.
    pub(crate) fn sees(&self, j: usize, r: DVec3) -> bool {
        let own = self.bounced.as_ref().and_then(|b| Some((b, j.checked_sub(b.first)?)));
        own.is_none_or(|(bounced, i)| bounced.sees(i, self.positions[j], r))
    }
}
