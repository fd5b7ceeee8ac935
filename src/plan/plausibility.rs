//! Questions about a measurement whose numbers do not go together: the usual signs of a wrong unit.

use crate::acquisition::Instrument;
use crate::grid::Grid;
use crate::text::{prefixed, prefixed_range};

/// Microphones are hardly ever so many wavelengths apart.
const FARTHEST_APART: f64 = 300.0;

/// A range resolution of so many times the farthest depth tells no depths apart.
const COARSEST: f64 = 3.0;

/// What is hard to believe of an instrument that images this grid, and what may be wrong.
pub(super) fn questions(instrument: &Instrument, grid: &Grid) -> Vec<String> {
    let mut questions = Vec::new();
    let (sweep, array) = (&instrument.sweep, &instrument.array);
    let band = prefixed_range(sweep.start(), sweep.stop(), 2, "Hz");
    let waves = |wavelength: f64| {
        format!(
            "at {} m/s, {band} is a wavelength of {}",
            instrument.sound_speed,
            prefixed(wavelength, 1, "m")
        )
    };
    let longest = array.extent().max_element().max(grid.z.last().abs());
    let shortest_wavelength = instrument.shortest_wavelength();
    let apart = array.extent().max_element() / (array.len() as f64).sqrt();
    if shortest_wavelength > longest {
        questions.push(format!(
            "{}, more than array and grid measure; are the frequencies in Hz, and is the speed of sound in m/s?",
            waves(shortest_wavelength)
        ));
    } else if apart > FARTHEST_APART * instrument.wavelength() {
        questions.push(format!(
            "{}, and microphones are {} apart; are these waves of sound (light and radio: 2.998e8 m/s), and positions \
             in m?",
            waves(instrument.wavelength()),
            prefixed(apart, 1, "m")
        ));
    }
    let resolution = instrument.range_resolution().filter(|_| shortest_wavelength <= longest);
    if let Some(resolution) = resolution.filter(|resolution| *resolution > COARSEST * grid.z.last()) {
        questions.push(format!(
            "a bandwidth of {} resolves ranges {} apart, and the grid ends at {}; are all frequencies there?",
            prefixed(sweep.bandwidth(), 1, "Hz"),
            prefixed(resolution, 1, "m"),
            prefixed(grid.z.last(), 1, "m")
        ));
    }
    questions
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;
    use crate::acquisition::{MicArray, Sweep};
    use crate::grid::Axis;
    use crate::named::assert_names;
    use glam::DVec3;

    /// Questions about 16 x 16 microphones `pitch` apart, before a grid as wide that ends at `far`.
    fn asked([start, stop]: [f64; 2], sound_speed: f64, pitch: f64, far: f64) -> Vec<String> {
        let sweep = Sweep::stepped(start, stop, (stop - start) / 20.0).unwrap();
        let array = MicArray::rectangular([16, 16], [pitch; 2], DVec3::ZERO).unwrap();
        let instrument = Instrument::new(sweep, array).with_sound_speed(sound_speed);
        let lateral = Axis { first: -8.0 * pitch, pitch, count: 16 };
        questions(
            &instrument,
            &Grid { x: lateral, y: lateral, z: Axis { first: 0.5 * far, pitch: 0.05 * far, count: 11 } },
        )
    }

    #[test]
    fn wrong_units_are_asked_about() {
        assert!(asked([10e3, 20e3], 343.0, 0.03, 2.0).is_empty());
        assert!(asked([23e9, 25e9], 2.998e8, 0.003, 0.09).is_empty(), "a radar near by");
        assert!(asked([1e6, 5e6], 1480.0, 0.3e-3, 0.05).is_empty(), "ultrasound in water");
        assert_names(
            asked([10.0, 20.0], 343.0, 0.03, 2.0).join(""),
            &["10.00 to 20.00 Hz", "17.1 m", "in Hz"],
        );
        assert_names(asked([10e3, 20e3], 3e8, 0.03, 2.0).join(""), &["15.0 km", "300000000 m/s"]);
        assert_names(asked([23e9, 25e9], 343.0, 0.003, 0.09).join(""), &["14.3 nm", "2.8 mm", "2.998e8"]);
        assert_names(asked([10e3, 20e3], 343.0, 30.0, 2000.0).join(""), &["22.9 mm", "in m"]);
        assert_names(asked([10e3, 10.02e3], 343.0, 0.03, 2.0).join(""), &["20.0 Hz", "8.6 m", "2.0 m"]);
    }
}
