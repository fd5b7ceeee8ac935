//! Reflectors that sound reaches by a detour: how far it has come to them, and the mirrors through which they are seen; and
//! those whose echo is not the same in all directions, pieces of edges.
//!
//! The echo of such a reflector is `A e^{i2πf (t + |q − r|)/c}` at the microphones at r from which it is seen, with a transmit
//! length t of its own instead of `|q − s|`, at a place q that may be an image behind mirrors. It is seen where the straight
//! line from r to q passes through the last mirror, and on, folded, through those before it.

use super::Reflectors;
use super::edges::{EdgePiece, Wedge};
use super::facets::Facet;
use glam::DVec3;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// The surfaces that a path meets, in the order of the sound.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
pub(crate) struct PathKind {
    /// Mirrors before the first patch.
    pub(super) before: Vec<u32>,
    /// Patches that scatter: 0, 1 or 2.
    pub(super) patches: u8,
    /// Mirrors after the last patch; all of them for a path of mirrors alone.
    pub(super) after: Vec<u32>,
    /// Whether it bends around an edge, and meets nothing else.
    pub(super) edge: bool,
}

impl PathKind {
    pub(super) const EDGE: Self = Self { before: Vec::new(), patches: 0, after: Vec::new(), edge: true };
}

/// What was found and what was left out.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct BounceCounts {
    /// Facets that mirror.
    pub mirrors: usize,
    /// Area of the surfaces that are no mirror, because they are small or curved, m².
    pub no_mirror_area: f64,
    /// Patches from which each patch is lit, of all that light it.
    pub partners: [usize; 2],
    /// Share of the energy of bounced echoes that was dropped, the weakest of them first, to limit their number.
    pub dropped_energy: f64,
    /// Length of the edges that diffract, m.
    pub edge_length: f64,
    /// Their pieces.
    pub edge_pieces: usize,
    /// Edges that were left out to limit the number of pieces, the shortest first, m.
    pub edge_length_left_out: f64,
}

/// The reflectors of a list that are reached by a detour, which are its last ones.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct Bounced {
    /// How many reflectors come before them.
    pub(super) first: usize,
    /// The length of the path up to the place from which they seem to shine, m.
    #[serde(skip)]
    pub(super) transmit: Vec<f64>,
    /// Of a scene that moves: the first place to which the speaker's sound comes straight, unfolded where mirrors bring it there,
    /// m. Nothing for mirrors alone, whose image moves with the speaker's.
    #[serde(skip)]
    pub(super) origins: Vec<DVec3>,
    pub(super) speaker: DVec3,
    /// The kind of each path.
    #[serde(skip)]
    pub(super) kind: Vec<u32>,
    pub(super) kinds: Vec<PathKind>,
    pub(super) facets: Arc<[Facet]>,
    /// What each facet is made of.
    pub(super) materials: Vec<String>,
    /// The last of them are pieces of edges.
    pub(super) pieces: Vec<EdgePiece>,
    pub(super) wedges: Vec<Wedge>,
    pub(super) counts: BounceCounts,
}

impl Bounced {
    /// None, after `first` reflectors, of sound from `speaker`.
    pub(super) fn none(first: usize, speaker: DVec3) -> Self {
        Self {
            first,
            transmit: Vec::new(),
            origins: Vec::new(),
            speaker,
            kind: Vec::new(),
            kinds: Vec::new(),
            facets: Arc::default(),
            materials: Vec::new(),
            pieces: Vec::new(),
            wedges: Vec::new(),
            counts: BounceCounts::default(),
        }
    }

    /// The same where all surfaces are displaced by `by` m, and the places of the reflectors, which were at `places`.
    ///
    /// Mirrors move with them: an image of a patch is displaced as all else, and one of the speaker is that in the mirrors where
    /// they are now. Amplitudes, and what is hidden, stay as they were.
    pub(super) fn displaced(&self, places: &[DVec3], by: DVec3) -> (Self, Vec<DVec3>) {
        let facets: Arc<[Facet]> = self.facets.iter().map(|facet| facet.displaced(by)).collect();
        let mut moved = places.iter().map(|place| *place + by).collect::<Vec<_>>();
        let mut transmit = self.transmit.clone();
        let of_each =
            moved[self.first..].iter_mut().zip(&mut transmit).zip(self.kind.iter().zip(&self.origins));
        for ((place, transmit), (kind, origin)) in of_each {
            let PathKind { patches, after, edge, .. } = &self.kinds[*kind as usize];
            if *patches > 0 || *edge {
                *transmit += self.speaker.distance(*origin + by) - self.speaker.distance(*origin);
            } else {
                let image = |p: DVec3, facet: &u32| facets[*facet as usize].mirror(p);
                *place = after.iter().fold(self.speaker, image);
            }
        }
        let wedges = self.wedges.iter().map(|wedge| wedge.displaced(by, self.speaker)).collect();
        (Self { transmit, facets, wedges, ..self.clone() }, moved)
    }

    /// The mirrors that a path meets after its last patch, from the microphone backwards.
    fn mirrors(&self, kind: u32) -> impl Iterator<Item = &Facet> + Clone {
        self.kinds[kind as usize].after.iter().rev().map(|&facet| &self.facets[facet as usize])
    }

    /// Whether bounced reflector `i`, counted from the first of them, is not the same from everywhere.
    fn has_directivity(&self, i: usize) -> bool {
        let kind = &self.kinds[self.kind[i] as usize];
        kind.edge || !kind.after.is_empty()
    }

    /// The factor of the amplitude of bounced reflector `i`, which is at `q`, as it is heard at `r`.
    fn directivity(&self, i: usize, q: DVec3, r: DVec3) -> f32 {
        let piece = i.checked_sub(self.transmit.len() - self.pieces.len()).map(|piece| self.pieces[piece]);
        match piece {
            Some(EdgePiece { wedge, heights }) => self.wedges[wedge as usize].directivity(heights, r) as f32,
            None => f32::from(u8::from(passes(self.mirrors(self.kind[i]), r, q))),
        }
    }
}

/// What is known of the reflectors that are reached by a detour, besides their places and amplitudes.
#[derive(Debug, Default)]
pub(crate) struct Detours {
    /// As in [`Bounced`].
    pub(crate) transmit: Vec<f64>,
    pub(crate) origins: Vec<DVec3>,
    /// Of each; what follows them is padding.
    pub(crate) kind: Vec<u32>,
    /// What does not grow with the reflectors, as JSON.
    pub(crate) rest: Vec<u8>,
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
        self.velocities.truncate(direct);
        Self { bounced: None, ..self }
    }

    /// What was found and left out of bounced echoes; `None` without any.
    pub fn bounce_counts(&self) -> Option<BounceCounts> {
        self.bounced.as_ref().map(|bounced| bounced.counts)
    }

    /// The detours, for another process; `None` without any.
    pub(crate) fn detours(&self) -> Option<Detours> {
        let bounced = self.bounced.as_ref()?;
        Some(Detours {
            transmit: bounced.transmit.clone(),
            origins: bounced.origins.clone(),
            kind: bounced.kind.clone(),
            rest: serde_json::to_vec(bounced).ok()?,
        })
    }

    /// The same places, of which the last are reached by these detours; `None` where they do not fit together.
    pub(crate) fn with_detours(self, detours: Detours) -> Option<Self> {
        let Detours { transmit, origins, mut kind, rest } = detours;
        let count = transmit.len();
        kind.truncate(count);
        let bounced = Bounced { transmit, origins, kind, ..serde_json::from_slice(&rest).ok()? };
        let fits = bounced.first.checked_add(count) == Some(self.len())
            && [0, count].contains(&bounced.origins.len())
            && bounced.kind.len() == count
            && bounced.kind.iter().all(|kind| (*kind as usize) < bounced.kinds.len())
            && bounced.pieces.len() <= count;
        fits.then_some(Self { bounced: Some(bounced), ..self })
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

    /// Whether reflector `j` is not the same from everywhere: it is seen through mirrors, or a piece of an edge.
    pub(crate) fn has_directivity(&self, j: usize) -> bool {
        let own = self.bounced.as_ref().and_then(|b| Some((b, j.checked_sub(b.first)?)));
        own.is_some_and(|(bounced, i)| bounced.has_directivity(i))
    }

    /// The factor of the amplitude of reflector `j` as it is heard at `r`: 0 where it is not seen.
    pub(crate) fn directivity(&self, j: usize, r: DVec3) -> f32 {
        let own = self.bounced.as_ref().and_then(|b| Some((b, j.checked_sub(b.first)?)));
        own.map_or(1.0, |(bounced, i)| bounced.directivity(i, self.positions[j], r))
    }
}
