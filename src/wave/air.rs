//! Air: speed of sound and absorption from temperature, humidity and pressure.
//!
//! Absorption and the water content of air follow ISO 9613-1:1993; the tests compare them with its values. The speed is
//! that of an ideal gas, `√(γRT/M)`, with γ and M of moist air after D. A. Bohn, "Environmental Effects on the Speed of
//! Sound", J. Audio Eng. Soc. 36 (1988): 343.23 m/s at 20 °C in dry air.

use serde::{Deserialize, Serialize};

/// The air that sound travels through.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Air {
    /// °C.
    pub temperature: f64,
    /// Relative humidity, %.
    pub humidity: f64,
    /// Pressure, Pa.
    pub pressure: f64,
}

/// 0 °C, K.
const ZERO_CELSIUS: f64 = 273.15;

/// The reference temperature T₀ of ISO 9613-1, K, and the triple point of water T₀₁, K.
const REFERENCE_TEMPERATURE: f64 = 293.15;
const TRIPLE_POINT: f64 = 273.16;

/// The reference pressure of ISO 9613-1, Pa.
pub const REFERENCE_PRESSURE: f64 = 101_325.0;

/// Molar gas constant, J/(mol K), and molar masses of dry air and water, kg/mol.
const GAS_CONSTANT: f64 = 8.314_462_618;
const DRY_AIR: f64 = 0.028_965_2;
const WATER: f64 = 0.018_015_3;

/// Decibels per neper.
pub(crate) const DB_PER_NEPER: f64 = 8.685_889_638_065_037;

impl Air {
    fn kelvin(&self) -> f64 {
        self.temperature + ZERO_CELSIUS
    }

    /// Share of the molecules that are water, h, as a fraction (ISO 9613-1, equations B.1 to B.3).
    pub fn water(&self) -> f64 {
        let exponent = -6.8346 * (TRIPLE_POINT / self.kelvin()).powf(1.261) + 4.6151;
        let saturation = REFERENCE_PRESSURE * 10f64.powf(exponent);
        0.01 * self.humidity * saturation / self.pressure
    }

    /// Speed of sound c, m/s.
    pub fn sound_speed(&self) -> f64 {
        let h = self.water();
        let heat_ratio = (7.0 + h) / (5.0 + h);
        let molar_mass = DRY_AIR - (DRY_AIR - WATER) * h;
        (heat_ratio * GAS_CONSTANT * self.kelvin() / molar_mass).sqrt()
    }

    /// Absorption α at a frequency in Hz, Np/m: amplitude falls as `e^{−α·path}` (ISO 9613-1, equations 3 to 5).
    ///
    /// Within 10 % for -20 to 50 °C, 0.05 to 5 % of water, below 200 kPa, and f/pressure from 4·10⁻⁴ to 10 Hz/Pa,
    /// according to the standard. Cost: two exponentials.
    pub fn absorption(&self, frequency: f64) -> f64 {
        let (pressure, kelvin) = (self.pressure / REFERENCE_PRESSURE, self.kelvin());
        let (ratio, percent) = (kelvin / REFERENCE_TEMPERATURE, 100.0 * self.water());
        let oxygen = pressure * (24.0 + 4.04e4 * percent * (0.02 + percent) / (0.391 + percent));
        let nitrogen = pressure / ratio.sqrt()
            * (9.0 + 280.0 * percent * (-4.170 * (ratio.powf(-1.0 / 3.0) - 1.0)).exp());
        let square = frequency * frequency;
        let relaxation = 0.012_75 * (-2239.1 / kelvin).exp() / (oxygen + square / oxygen)
            + 0.1068 * (-3352.0 / kelvin).exp() / (nitrogen + square / nitrogen);
        square * (1.84e-11 / pressure * ratio.sqrt() + ratio.powf(-2.5) * relaxation)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn air(temperature: f64, humidity: f64) -> Air {
        Air { temperature, humidity, pressure: REFERENCE_PRESSURE }
    }

    #[test]
    fn absorption_is_that_of_the_published_table() {
        // ISO 9613-2:1996, table 2, dB/km: octave bands from 63 Hz to 8 kHz, computed by ISO 9613-1.
        let table = [
            (10.0, 70.0, [0.1, 0.4, 1.0, 1.9, 3.7, 9.7, 32.8, 117.0]),
            (20.0, 70.0, [0.1, 0.3, 1.1, 2.8, 5.0, 9.0, 22.9, 76.6]),
            (30.0, 70.0, [0.1, 0.3, 1.0, 3.1, 7.4, 12.7, 23.1, 59.3]),
            (15.0, 20.0, [0.3, 0.6, 1.2, 2.7, 8.2, 28.2, 88.8, 202.0]),
            (15.0, 50.0, [0.1, 0.5, 1.2, 2.2, 4.2, 10.8, 36.2, 129.0]),
            (15.0, 80.0, [0.1, 0.3, 1.1, 2.4, 4.1, 8.3, 23.7, 82.8]),
        ];
        for (temperature, humidity, published) in table {
            for (octave, expected) in published.into_iter().enumerate() {
                // The exact midband frequencies of the standard.
                let frequency = 1000.0 * 10f64.powf(0.3 * (octave as f64 - 4.0));
                let got = 1000.0 * DB_PER_NEPER * air(temperature, humidity).absorption(frequency);
                assert!(
                    (got - expected).abs() <= 0.051 + 0.005 * expected,
                    "{temperature} °C, {humidity} %, {frequency:.0} Hz: {got} dB/km, published {expected}"
                );
            }
        }
    }

    #[test]
    fn absorption_in_the_band_of_this_program() {
        // ISO 9613-1:1993, table 1, 20 °C and 50 %: 4.66 dB/km at 1 kHz and 159 dB/km at 10 kHz.
        let decibels = |frequency| 1000.0 * DB_PER_NEPER * air(20.0, 50.0).absorption(frequency);
        assert!((decibels(1000.0) - 4.66).abs() < 0.02, "{}", decibels(1000.0));
        assert!((decibels(10_000.0) - 159.0).abs() < 1.0, "{}", decibels(10_000.0));
        assert_eq!(decibels(0.0), 0.0);
    }

    #[test]
    fn the_speed_of_sound_is_the_published_one() {
        for (temperature, humidity, speed, within) in [
            // ISO 9613-1 has 343.2 m/s at 20 °C and a root of the temperature.
            (20.0, 0.0, 343.2, 0.05),
            (0.0, 0.0, 343.2 * (273.15f64 / 293.15).sqrt(), 0.05),
            // O. Cramer, J. Acoust. Soc. Am. 93, 2510 (1993), with 0.04 % of carbon dioxide.
            (20.0, 0.0, 343.36, 0.2),
            (20.0, 50.0, 343.99, 0.2),
            (30.0, 100.0, 352.0, 0.6),
        ] {
            let got = air(temperature, humidity).sound_speed();
            assert!(
                (got - speed).abs() < within,
                "{temperature} °C, {humidity} %: {got} m/s, published {speed}"
            );
        }
    }

    #[test]
    fn water_in_saturated_air() {
        // Saturation pressure of water at 20 °C: 2339 Pa.
        let got = air(20.0, 100.0).water() * REFERENCE_PRESSURE;
        assert!((got - 2339.0).abs() < 5.0, "{got}");
        let thin = Air { pressure: 0.5 * REFERENCE_PRESSURE, ..air(20.0, 100.0) };
        assert!((thin.water() / air(20.0, 100.0).water() - 2.0).abs() < 1e-12);
    }
}
