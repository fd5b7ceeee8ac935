//! Microphones that are left out.

use crate::acquisition::{DataCube, Health};
use crate::choice::choice;
use crate::error::{Error, Result};
use crate::progress::Observer;
use serde::{Deserialize, Serialize};

choice! {
    /// The word for a mask that is found.
    pub enum AutoWord: "mask" {
        /// By the levels of the channels.
        Auto = "auto",
    }
}

/// Which microphones are silenced; an empty list is none.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(untagged, expecting = "expected \"auto\" or a list of microphones, counted from 0")]
pub enum ChannelMask {
    /// Those that are dead (40 dB below the median), loud (20 dB above it), or have samples that are not finite.
    Found(AutoWord),
    /// These, by their index in the cube, counted from 0.
    Listed(Vec<usize>),
}

impl Default for ChannelMask {
    fn default() -> Self {
        Self::Listed(Vec::new())
    }
}

/// How many masked microphones are named.
const NAMED: usize = 8;

impl ChannelMask {
    /// Whether each microphone is masked, and words on it.
    pub(super) fn find(&self, cube: &DataCube, observer: &dyn Observer) -> Result<(Vec<bool>, Vec<String>)> {
        let n_mic = cube.instrument.array.len();
        let mut masked = vec![false; n_mic];
        match self {
            Self::Listed(list) => {
                if let Some(beyond) = list.iter().find(|i| **i >= n_mic) {
                    let problem = format!("names microphone {beyond}; the cube has 0 to {}", n_mic - 1);
                    return Err(Error::input("[calibration] mask", problem));
                }
                for i in list {
                    masked[*i] = true;
                }
            }
            Self::Found(AutoWord::Auto) => {
                let levels = Health::of(&mut &*cube, u64::MAX, observer)?.microphones;
                for (i, masked) in masked.iter_mut().enumerate() {
                    let finite = cube.samples[i..].iter().step_by(n_mic).all(|m| m.is_finite());
                    *masked = !finite || !levels.is_usual(i);
                }
            }
        }
        let list: Vec<usize> = (0..n_mic).filter(|i| masked[*i]).collect();
        if list.len() == n_mic {
            let problem = "leaves no microphone; see `holosonar info CUBE --health`";
            return Err(Error::input("[calibration] mask", problem));
        }
        let words = match (list.len(), self) {
            (0, Self::Listed(_)) => Vec::new(),
            (0, Self::Found(_)) => vec!["no microphone is out of line, so that none is masked".to_owned()],
            (n, _) => {
                let named: Vec<String> = list.iter().take(NAMED).map(usize::to_string).collect();
                let more = if n > NAMED { ", ..." } else { "" };
                vec![format!("{n} of {n_mic} microphones masked: {}{more}", named.join(", "))]
            }
        };
        Ok((masked, words))
    }
}
