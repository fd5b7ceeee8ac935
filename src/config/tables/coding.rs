//! `[coding]`: several loudspeakers at once.

use crate::acquisition::{CodeKind, Decoding};
use serde::{Deserialize, Serialize};

/// `[coding]`: how `[array] sources` that sound at once are told apart; they sound one after another unless typed.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct CodingTable {
    /// By what; left out: one after another.
    pub kind: Option<CodeKind>,
    /// Of `sequences`: for each sweep the amplitude of each speaker, -1 to 1.
    pub sequences: Vec<Vec<f64>>,
    /// Of `sequences`: by their inverse, or each by itself.
    pub decoding: Decoding,
    /// Of a simulation: rms of each amplitude's error.
    pub error: f64,
    /// Seed of these errors alone; left out: 1.
    pub seed: Option<u32>,
}

impl CodingTable {
    /// Whether nothing of it was typed.
    pub(in crate::config) fn is_default(&self) -> bool {
        *self == Self::default()
    }
}
