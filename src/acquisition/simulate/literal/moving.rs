//! Reflectors that move: each tone is played when they are somewhere else.
//!
//! What is still is simulated as ever, and what moves tone by tone where it is then, term by term.

use crate::acquisition::simulate::{SimulateOptions, simulate_echoes};
use crate::acquisition::{Instrument, Sweep};
use crate::blocks::{BlockStore, NoStore};
use crate::error::{Error, Result};
use crate::progress::{Observer, OfPart, advance, stage};
use crate::reflectors::Reflectors;
use crate::wave::{LONGEST_DWELL, Motion};
use glam::DVec3;
use num_complex::Complex32;

/// The echoes of lists of reflectors, some of which may move.
///
/// # Errors
/// Those of an echo; no time between tones, or one that is none; bounced reflectors that do not move as one.
pub(in crate::acquisition) fn simulate_moving(
    reflectors: &[Reflectors],
    (number, instrument): (usize, &Instrument),
    options: &SimulateOptions,
    store: &mut dyn BlockStore,
    observer: &dyn Observer,
) -> Result<Vec<Complex32>> {
    if reflectors.iter().all(|list| list.velocities().is_empty()) {
        return simulate_echoes(reflectors, (number, instrument), options, store, observer);
    }
    let Some(dwell) = options.dwell.filter(|dwell| (0.0..=LONGEST_DWELL).contains(dwell)) else {
        let problem =
            "needs to know how long each tone is played while something moves: give [recording] dwell, in s";
        return Err(Error::input("[scene] velocity", problem));
    };
    reflectors.iter().try_for_each(Reflectors::check_motion)?;
    let still: Vec<Reflectors> = reflectors.iter().map(Reflectors::still).collect();
    let mut samples = simulate_echoes(&still, (number, instrument), options, store, observer)?;
    let (n_f, n_mic) = (instrument.sweep.len(), instrument.array.len());
    let times = Motion::new(DVec3::ZERO, dwell);
    stage(observer, "simulating what moves", (samples.len() / n_mic) as u64, || {
        for (played, row) in samples.chunks_exact_mut(n_mic).enumerate() {
            let (transmission, tone) = (played / n_f, played % n_f);
            let list = &reflectors[transmission.min(reflectors.len() - 1)];
            let moved = [list.moved(times.time(played as f64))];
            let sweep = Sweep::from_frequencies(vec![instrument.sweep.frequencies()[tone]])?;
            let heard = instrument.transmission(transmission).with_sweep(sweep);
            let echoes = simulate_echoes(&moved, (0, &heard), options, &mut NoStore, &OfPart(observer))?;
            row.iter_mut().zip(echoes).for_each(|(m, echo)| *m += echo);
            advance(observer, 1)?;
        }
        Ok(())
    })?;
    Ok(samples)
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;
    use crate::acquisition::{Detection, MicArray, SimulateOptions, simulate, simulate_tiles};
    use crate::named::assert_names;
    use crate::progress::Silent;
    use num_complex::Complex64;
    use std::f64::consts::TAU;

    const DWELL: f64 = 0.02;

    fn reflectors() -> (Vec<DVec3>, Vec<Complex32>, Vec<DVec3>) {
        let places = vec![DVec3::new(0.1, 0.0, 0.9), DVec3::new(-0.2, 0.1, 1.1), DVec3::new(0.0, 0.2, 0.8)];
        let velocities = vec![DVec3::new(0.1, -0.05, 0.3), DVec3::ZERO, DVec3::new(-0.2, 0.0, 0.1)];
        (places, vec![Complex32::new(0.6, 0.8), Complex32::from(0.5), Complex32::new(0.0, -0.7)], velocities)
    }

    #[test]
    fn every_tone_is_the_sum_over_the_places_of_its_time() {
        let (places, amplitudes, velocities) = reflectors();
        let moving = Reflectors::new(places.clone(), amplitudes.clone()).unwrap();
        let moving = moving.with_velocities(velocities.clone()).unwrap();
        let array = MicArray::rectangular([3, 2], [0.05; 2], DVec3::ZERO).unwrap();
        let one = Instrument::new(Sweep::stepped(8e3, 10e3, 250.0).unwrap(), array);
        let several = one.with_sources(&[DVec3::ZERO, DVec3::new(0.1, 0.2, 0.0)]).unwrap();
        let one = Instrument::new(several.sweep.clone(), several.array.clone());
        for instrument in [one.clone(), several, one.with_detection(Detection::InPhase)] {
            let options = SimulateOptions::default().with_dwell(DWELL);
            let cube = simulate(&moving, &instrument, &options).unwrap();
            let (n_f, n_mic) = (instrument.sweep.len(), instrument.array.len());
            for (i, m) in cube.samples.iter().enumerate() {
                let (played, f) = (i / n_mic, instrument.sweep.frequencies()[i / n_mic % n_f]);
                let own = instrument.transmission(i / (n_f * n_mic));
                let echo = |j: usize| {
                    let p = places[j] + velocities[j] * (played as f64 * DWELL);
                    let path = own.path_length(p, own.array.positions()[i % n_mic]);
                    let a = Complex64::new(amplitudes[j].re.into(), amplitudes[j].im.into());
                    a * Complex64::cis(TAU * f * path / own.sound_speed)
                };
                let mut exact: Complex64 = (0..places.len()).map(echo).sum();
                if own.detection == Detection::InPhase {
                    exact.im = 0.0;
                }
                assert!((Complex64::new(m.re.into(), m.im.into()) - exact).norm() < 2e-5, "{i}: {m} {exact}");
            }
        }
    }

    #[test]
    fn without_times_and_in_parts_nothing_moves() {
        let (places, amplitudes, velocities) = reflectors();
        let still = Reflectors::new(places, amplitudes).unwrap();
        let moving = still.clone().with_velocities(velocities).unwrap();
        let array = MicArray::rectangular([3, 2], [0.05; 2], DVec3::ZERO).unwrap();
        let instrument = Instrument::new(Sweep::stepped(8e3, 10e3, 250.0).unwrap(), array);
        let options = SimulateOptions::default();
        let refused = simulate(&moving, &instrument, &options).unwrap_err().to_string();
        assert_names(refused, &["[scene] velocity", "[recording] dwell"]);
        let timed = options.clone().with_dwell(DWELL);
        let lists = std::slice::from_ref(&moving);
        let refused = simulate_tiles(lists, &instrument, &timed, &mut NoStore, &Silent).unwrap_err();
        assert_names(refused.to_string(), &["[scene] velocity", "simulate"]);
        // What is still has the bytes that it has without times.
        let bytes = |options| simulate(&still, &instrument, options).unwrap();
        assert_eq!(bytes(&timed), bytes(&options));
    }
}
