//! A simulated cube that is put together from its tiles only if somebody reads it.

use crate::acquisition::{CubeSource, DataCube, Instrument, Visit};
use crate::error::Result;

/// Puts the cube together.
pub(super) type MakeCube<'a> = dyn Fn() -> Result<DataCube> + Sync + 'a;

/// A cube whose depths may be summed from tones that another process has compressed it to.
pub(super) struct SimulatedCube<'a> {
    instrument: &'a Instrument,
    make: &'a MakeCube<'a>,
    made: Option<DataCube>,
}

impl<'a> SimulatedCube<'a> {
    pub(super) const fn new(instrument: &'a Instrument, make: &'a MakeCube<'a>) -> Self {
        Self { instrument, make, made: None }
    }

    /// Puts it together before it is read.
    ///
    /// # Errors
    /// Those of a simulation.
    pub(super) fn make(&mut self) -> Result<&DataCube> {
        match &mut self.made {
            Some(made) => Ok(made),
            none => Ok(none.insert((self.make)()?)),
        }
    }
}

impl CubeSource for SimulatedCube<'_> {
    fn instrument(&self) -> &Instrument {
        self.instrument
    }

    fn held_bytes(&self) -> u64 {
        self.instrument.cube_bytes()
    }

    fn visit_transmission(&mut self, transmission: usize, block: usize, visit: &mut Visit) -> Result<()> {
        (&mut self.make()?).visit_transmission(transmission, block, visit)
    }
}
