//! Changes of an instrument: what is known better than a cube's file says.

use super::Instrument;
use crate::error::{Error, Result};
use crate::wave::{Geometry, Interface};
use glam::DVec3;

/// Values that replace those of an instrument; `None` leaves them.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct InstrumentChanges {
    /// c, m/s.
    pub sound_speed: Option<f64>,
    /// A plane beyond which sound has another speed.
    pub interface: Option<Interface>,
    /// The loudspeaker, m.
    pub source: Option<DVec3>,
    /// Middle of the microphones' bounding box, m; all of them move with it.
    pub centre: Option<DVec3>,
}

impl Instrument {
    /// The instrument with these changes, and in words what differs now. Cost: that of the array's positions.
    ///
    /// # Errors
    /// A loudspeaker for a monostatic scan, which has none of its own; values outside their range.
    pub fn changed(&self, changes: &InstrumentChanges) -> Result<(Self, Vec<String>)> {
        let InstrumentChanges { sound_speed, interface, source, centre } = *changes;
        let (mut changed, mut words) = (self.clone(), Vec::new());
        if let Some(c) = sound_speed.filter(|c| *c != self.sound_speed) {
            changed.sound_speed = c;
            let [new, own] = [c, self.sound_speed].map(|c| rounded(c, 1e3));
            words.push(format!("sound speed {new} m/s instead of {own} m/s"));
        }
        if let Some(interface) = interface.filter(|interface| self.interface != Some(*interface)) {
            changed.interface = Some(interface);
            let of = |Interface { depth, sound_speed }| format!("{sound_speed} m/s beyond z = {depth} m");
            let own = self.interface.map_or("one medium".to_owned(), of);
            words.push(format!("{} instead of {own}", of(interface)));
        }
        match (source, self.geometry) {
            (Some(_), _) if self.transmissions() > 1 => {
                let problem = format!(
                    "replaces one loudspeaker, and this cube has {}, one after another",
                    self.transmissions()
                );
                return Err(Error::input("array.source", problem));
            }
            (Some(source), Geometry::FixedSource { source: own }) if source != own => {
                changed.geometry = Geometry::FixedSource { source };
                words.push(format!("speaker at {} m instead of {} m", point(source), point(own)));
            }
            (Some(_), Geometry::Monostatic | Geometry::Pair { .. }) => {
                let problem = "has no meaning for a scan, whose speaker moves with the microphone";
                return Err(Error::input("array.source", problem));
            }
            _ => {}
        }
        let own = self.array.centre();
        if let Some(centre) = centre.filter(|centre| centre.distance(own) > SAME_PLACE) {
            let moved = self.array.positions().iter().map(|r| *r + (centre - own)).collect();
            let array = self.array.with_positions(moved)?;
            changed = changed.with_moved(array);
            words.push(format!("centre of the array at {} m instead of {} m", point(centre), point(own)));
        }
        changed.check()?;
        Ok((changed, words))
    }
}

/// Distance at which two centres are the same, m: they are means of positions, which round.
const SAME_PLACE: f64 = 1e-9;

/// A point to a tenth of a millimetre, so that a mean of positions does not show how it rounds.
fn point(p: DVec3) -> String {
    let [x, y, z] = p.to_array().map(|x| rounded(x, 1e4));
    format!("({x}, {y}, {z})")
}

/// A number to so many parts, without a negative zero.
fn rounded(value: f64, parts: f64) -> f64 {
    (value * parts).round() / parts + 0.0
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;
    use crate::acquisition::{MicArray, Sweep};
    use crate::named::assert_names;

    fn instrument() -> Instrument {
        let array = MicArray::rectangular([5, 4], [0.1, 0.2], DVec3::new(0.3, 0.0, 0.0)).unwrap();
        Instrument::new(Sweep::stepped(10e3, 12e3, 100.0).unwrap(), array)
    }

    #[test]
    fn what_is_typed_replaces_what_the_file_says_and_is_said() {
        let changes = InstrumentChanges {
            sound_speed: Some(340.0),
            interface: Some(Interface { depth: 0.5, sound_speed: 1500.0 }),
            source: Some(DVec3::new(0.0, 0.1, 0.0)),
            centre: Some(DVec3::new(0.0, 0.0, -0.05)),
        };
        let (changed, words) = instrument().changed(&changes).unwrap();
        assert_names(
            words.join("; "),
            &[
                "340 m/s",
                "343 m/s",
                "1500 m/s beyond z = 0.5 m",
                "one medium",
                "(0, 0.1, 0)",
                "(0, 0, -0.05)",
                "(0.3, 0, 0)",
            ],
        );
        assert_eq!(changed.sound_speed, 340.0);
        assert_eq!(changed.geometry, Geometry::FixedSource { source: DVec3::new(0.0, 0.1, 0.0) });
        assert!(changed.array.centre().distance(DVec3::new(0.0, 0.0, -0.05)) < 1e-12);
        assert_eq!(changed.array.lattice().unwrap().x.count, 5, "a moved lattice is one still");
        // Changes to what it is anyway are none.
        assert_eq!(changed.changed(&changes).unwrap(), (changed, Vec::new()));
    }

    #[test]
    fn impossible_changes_are_refused() {
        let speaker = InstrumentChanges { source: Some(DVec3::X), ..InstrumentChanges::default() };
        let monostatic = instrument().with_geometry(Geometry::Monostatic);
        assert_names(monostatic.changed(&speaker).unwrap_err().to_string(), &["array.source", "scan"]);
        let several = instrument().with_sources(&[DVec3::ZERO, DVec3::X]).unwrap();
        assert_names(several.changed(&speaker).unwrap_err().to_string(), &["array.source", "2"]);
        let speed = InstrumentChanges { sound_speed: Some(-1.0), ..InstrumentChanges::default() };
        assert_names(instrument().changed(&speed).unwrap_err().to_string(), &["speed of sound", "-1"]);
    }
}
