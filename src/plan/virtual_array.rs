//! The array as which several loudspeakers, or a moved pair, see: what a plan says of it.

use crate::acquisition::Instrument;
use serde::Serialize;
use std::fmt;

/// An array whose microphones hear one loudspeaker, or scan, and see far away what several loudspeakers or a pair do.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[non_exhaustive]
pub struct VirtualArray {
    /// Its microphones; those at one place count each.
    pub microphones: usize,
    /// Columns and rows, if it is a lattice.
    pub lattice: Option<[usize; 2]>,
    /// First to last microphone along x and y, m.
    pub extent: [f64; 2],
    /// Between neighbours of a lattice along x and y, m.
    pub pitch: Option<[f64; 2]>,
}

impl VirtualArray {
    /// That of an instrument's [equivalent](Instrument::equivalent).
    pub(super) fn of(equivalent: &Instrument) -> Self {
        let (array, lattice) = (&equivalent.array, equivalent.array.lattice());
        Self {
            microphones: array.len(),
            lattice: lattice.map(|l| [l.x.count, l.y.count]),
            extent: array.extent().truncate().to_array(),
            pitch: lattice.map(|l| [l.x.pitch, l.y.pitch]),
        }
    }
}

/// As in `32 x 32 microphones 10.0 x 10.0 mm apart on 0.310 x 0.310 m`.
impl fmt::Display for VirtualArray {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match (self.lattice, self.pitch) {
            (Some([columns, rows]), Some([x, y])) => {
                write!(f, "{columns} x {rows} microphones {:.1} x {:.1} mm apart", x * 1e3, y * 1e3)?;
            }
            _ => write!(f, "{} microphones", self.microphones)?,
        }
        let [x, y] = self.extent;
        write!(f, " on {x:.3} x {y:.3} m")
    }
}
