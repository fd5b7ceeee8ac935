//! The parameters that can be tried, and what a value of one does to instrument, samples and region.

use crate::acquisition::{Calibration, DataCube, Instrument, InstrumentChanges};
use crate::choice::choice;
use crate::error::{Error, Result};
use crate::grid::{Axis, Grid};
use crate::progress::Silent;
use crate::wave::{Geometry, Motion};
use glam::DVec3;

choice! {
    /// A parameter of the measurement that an image can tell, if it can.
    pub enum FocusParameter: "parameter" {
        /// Speed of sound, m/s.
        SoundSpeed = "sound-speed",
        /// By how much recorded paths are too long, m.
        Delay = "delay",
        /// z of the array's centre, m.
        ArrayZ = "z-offset",
        /// Angle of the array about x through its centre, degrees.
        TiltX = "tilt-x",
        /// Angle of the array about y through its centre, degrees.
        TiltY = "tilt-y",
        /// x of the loudspeaker, m.
        SourceX = "source-x",
        /// y of the loudspeaker, m.
        SourceY = "source-y",
        /// z of the loudspeaker, m.
        SourceZ = "source-z",
        /// Velocity of the scene along x while the tones are played, m/s.
        VelocityX = "velocity-x",
        /// Along y, m/s.
        VelocityY = "velocity-y",
        /// Along z, m/s.
        VelocityZ = "velocity-z",
    }
}

/// What has been corrected before: the delay in the samples, and the tilt, degrees, that is applied to the cube's positions.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(super) struct Corrected {
    pub(super) delay: f64,
    pub(super) tilt: [f64; 2],
    /// The frame that is imaged, and the times of the tones if they are known.
    pub(super) motion: Option<Motion>,
}

/// Share by which a path of the region is changed, either way, if no range is given: air between 2 and 38 °C.
const SHARE: f64 = 0.03;

/// Cycles at the ends of the band by which the velocities that are tried blur, and the share of the nearest depth by which they
/// may move the region.
const CYCLES: f64 = 4.0;
const NEARER: f64 = 0.9;

/// Angles that are tried, either way, degrees.
const ANGLE: f64 = 5.0;

impl FocusParameter {
    /// The unit, as it is printed.
    pub fn unit(self) -> &'static str {
        match self {
            Self::SoundSpeed | Self::VelocityX | Self::VelocityY | Self::VelocityZ => "m/s",
            Self::TiltX | Self::TiltY => "degrees",
            _ => "m",
        }
    }

    /// The value that a cube has.
    pub(super) fn of(self, instrument: &Instrument, corrected: Corrected) -> f64 {
        let source = match instrument.geometry {
            Geometry::FixedSource { source } => source,
            Geometry::Monostatic | Geometry::Pair { .. } => DVec3::ZERO,
        };
        match self {
            Self::SoundSpeed => instrument.sound_speed,
            Self::Delay => corrected.delay,
            Self::ArrayZ => instrument.array.centre().z,
            Self::TiltX => corrected.tilt[0],
            Self::TiltY => corrected.tilt[1],
            Self::SourceX => source.x,
            Self::SourceY => source.y,
            Self::SourceZ => source.z,
            Self::VelocityX | Self::VelocityY | Self::VelocityZ => {
                corrected.motion.map_or(0.0, |motion| motion.velocity[self.axis()])
            }
        }
    }

    /// The axis of a velocity.
    fn axis(self) -> usize {
        match self {
            Self::VelocityY => 1,
            Self::VelocityZ => 2,
            _ => 0,
        }
    }

    /// Whether it is a velocity.
    pub(super) fn is_velocity(self) -> bool {
        matches!(self, Self::VelocityX | Self::VelocityY | Self::VelocityZ)
    }

    /// The frame that is imaged with a value.
    pub(super) fn motion(self, corrected: Corrected, value: f64) -> Option<Motion> {
        let mut motion = corrected.motion?;
        if self.is_velocity() {
            motion.velocity[self.axis()] = value;
        }
        Some(motion).filter(|motion| motion.velocity != DVec3::ZERO)
    }

    /// How far a place is seen displaced by a velocity of 1 m/s, m, in an image that takes it for still, and the cycles at the ends of
    /// the band that blur it there.
    pub(super) fn of_velocity(instrument: &Instrument, motion: Motion) -> [f64; 2] {
        let sweep = &instrument.sweep;
        let spacing = sweep.bandwidth() / (sweep.len().max(2) - 1) as f64;
        if spacing <= 0.0 {
            return [0.0; 2];
        }
        // Either leg grows as the range does, at the most.
        let cycles = motion.cycles(sweep.bandwidth(), spacing, 2.0, instrument.sound_speed);
        [motion.lag([sweep.start(), sweep.stop()], spacing), cycles]
    }

    /// Refuses a parameter that the geometry does not have, and a velocity without times.
    pub(super) fn check(self, instrument: &Instrument, motion: Option<Motion>) -> Result<()> {
        if self.is_velocity() && motion.is_none() {
            let problem = "needs to know how long each tone was played; give [recording] dwell, in s";
            return Err(Error::input(self.as_str(), problem));
        }
        let of_source = matches!(self, Self::SourceX | Self::SourceY | Self::SourceZ);
        if of_source {
            instrument.need_one_source(self.as_str())?;
        }
        if !matches!(instrument.geometry, Geometry::FixedSource { .. }) && of_source {
            let problem =
                "has no meaning for a scan, monostatic or of a pair, whose speaker moves with the microphone";
            return Err(Error::input(self.as_str(), problem));
        }
        Ok(())
    }

    /// The range that is tried if none is given: ± 3 % of the speed or of the path to the middle of the region, ± 5°; velocities that
    /// blur by some cycles, as far as the region stays in front of the array.
    pub(super) fn usual_range(
        self,
        instrument: &Instrument,
        grid: &Grid,
        (own, corrected): (f64, Corrected),
    ) -> [f64; 2] {
        let (low, high) = grid.bounds();
        let path = instrument.path_length(low.midpoint(high), instrument.array.centre());
        let reach = match self {
            Self::SoundSpeed => SHARE * own,
            Self::TiltX | Self::TiltY => ANGLE,
            Self::VelocityX | Self::VelocityY | Self::VelocityZ => {
                let each = corrected.motion.map(|motion| Self::of_velocity(instrument, motion));
                let [lag, cycles] = each.unwrap_or_default().map(|each| each.max(1e-12));
                let most = if self == Self::VelocityZ { NEARER * low.z / lag } else { f64::INFINITY };
                (CYCLES / cycles).min(most)
            }
            _ => SHARE * path,
        };
        [own - reach, own + reach]
    }

    /// The instrument with a value, and with the tilt that was applied before.
    pub(super) fn instrument(self, cube: &DataCube, corrected: Corrected, value: f64) -> Result<Instrument> {
        let mut changes = InstrumentChanges::default();
        let (centre, mut tilt) = (cube.instrument.array.centre(), corrected.tilt);
        let source = |axis: usize| match cube.instrument.geometry {
            Geometry::FixedSource { mut source } => {
                source[axis] = value;
                Some(source)
            }
            Geometry::Monostatic | Geometry::Pair { .. } => None,
        };
        match self {
            Self::SoundSpeed => changes.sound_speed = Some(value),
            Self::Delay | Self::VelocityX | Self::VelocityY | Self::VelocityZ => {}
            Self::ArrayZ => changes.centre = Some(centre.with_z(value)),
            Self::TiltX => tilt[0] = value,
            Self::TiltY => tilt[1] = value,
            Self::SourceX => changes.source = source(0),
            Self::SourceY => changes.source = source(1),
            Self::SourceZ => changes.source = source(2),
        }
        let (instrument, _) = cube.instrument.changed(&changes)?;
        if tilt == [0.0; 2] {
            return Ok(instrument);
        }
        let array = instrument.array.tilted(tilt)?;
        Ok(instrument.with_moved(array))
    }

    /// The samples with a value, where they are other ones.
    pub(super) fn samples(self, cube: &mut DataCube, corrected: Corrected, value: f64) -> Result<()> {
        if self != Self::Delay || value == corrected.delay {
            return Ok(());
        }
        let delay = Calibration { delay: value - corrected.delay, ..Calibration::default() };
        delay.apply(cube, &Silent).map(|_| ())
    }

    /// The region with a value, moved as its echoes move: what was in it is in it still.
    ///
    /// With another speed of sound it is larger about the array's centre; with longer paths it is farther away; and with another
    /// velocity it is displaced.
    pub(super) fn region(
        self,
        (instrument, corrected): (&Instrument, Corrected),
        grid: &Grid,
        [own, value]: [f64; 2],
    ) -> Grid {
        if let Some(motion) = corrected.motion.filter(|_| self.is_velocity()) {
            let mut moved = *grid;
            let axis = match self.axis() {
                0 => &mut moved.x,
                1 => &mut moved.y,
                _ => &mut moved.z,
            };
            axis.first -= (value - own) * Self::of_velocity(instrument, motion)[0];
            return moved;
        }
        let centre = instrument.array.centre();
        let (scale, shift) = match self {
            Self::SoundSpeed => (value / own, 0.0),
            // Half of a path is range.
            Self::Delay => (1.0, 0.5 * (own - value)),
            Self::ArrayZ | Self::SourceZ => (1.0, 0.5 * (value - own)),
            _ => (1.0, 0.0),
        };
        let axis = |axis: Axis, centre: f64, shift: f64| Axis {
            first: centre + scale * (axis.first - centre) + shift,
            pitch: scale * axis.pitch,
            count: axis.count,
        };
        Grid {
            x: axis(grid.x, centre.x, 0.0),
            y: axis(grid.y, centre.y, 0.0),
            z: axis(grid.z, centre.z, shift),
        }
    }

    /// Voxels of a region that a resolution cell in its middle takes.
    pub(super) fn cell(instrument: &Instrument, grid: &Grid) -> f64 {
        let z = f64::midpoint(grid.z.first, grid.z.last()) - instrument.array.centre().z;
        let [x, y] = instrument.lateral_resolution(z.max(0.0));
        let sizes = [(x, grid.x), (y, grid.y), (instrument.range_resolution(), grid.z)];
        sizes.into_iter().filter_map(|(cell, axis)| cell.map(|cell| cell / axis.pitch)).product()
    }

    /// What to type after `--set` for a value.
    pub(super) fn setting(self, cube: &DataCube, corrected: Corrected, value: f64) -> Result<String> {
        let instrument = self.instrument(cube, Corrected { tilt: [0.0; 2], ..corrected }, value)?;
        let list = |numbers: &[f64]| {
            let numbers: Vec<String> = numbers.iter().map(|x| format!("{:?}", rounded(*x))).collect();
            format!("[{}]", numbers.join(","))
        };
        Ok(match (self, instrument.geometry) {
            (Self::SoundSpeed, _) => format!("medium.sound_speed={:?}", rounded(value)),
            (Self::Delay, _) => format!("calibration.delay={:?}", rounded(value)),
            (Self::ArrayZ, _) => format!("array.centre={}", list(&instrument.array.centre().to_array())),
            (Self::VelocityX | Self::VelocityY | Self::VelocityZ, _) => {
                let velocity = self.motion(corrected, value).map_or(DVec3::ZERO, |motion| motion.velocity);
                format!("medium.velocity={}", list(&velocity.to_array()))
            }
            (Self::TiltX, _) => format!("calibration.tilt={}", list(&[value, corrected.tilt[1]])),
            (Self::TiltY, _) => format!("calibration.tilt={}", list(&[corrected.tilt[0], value])),
            (_, Geometry::FixedSource { source }) => format!("array.source={}", list(&source.to_array())),
            (_, Geometry::Monostatic | Geometry::Pair { .. }) => {
                return Err(Error::input(self.as_str(), "has no speaker of its own"));
            }
        })
    }
}

/// To a hundredth of a millimetre, of a mm/s and of a millidegree, far below what can be known; without a negative zero.
fn rounded(value: f64) -> f64 {
    (value * 1e5).round() / 1e5 + 0.0
}
