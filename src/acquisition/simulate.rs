//! Reflectors to data cube: Eq. 5, summed term by term.

use super::{DataCube, Detection, MicArray, Sweep};
use crate::error::{Error, Result};
use crate::progress::{Observer, advance, stage};
use crate::reflectors::Reflectors;
use crate::wave::simd::{Amplitudes, Steps, sum_over_sweep};
use crate::wave::{DEFAULT_SOUND_SPEED, Geometry};
use num_complex::Complex32;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use rand_distr::{Distribution, StandardNormal};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// Which path lengths a simulated sound follows.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum PropagationModel {
    /// Eq. 5: the true path.
    Exact,
    /// Eq. 6–7: the far-field approximation.
    Linear,
}

/// Noise added to a simulated cube.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Noise {
    /// Mean `|m|²` over the cube against `E|n|²`, dB; n is complex in quadrature and real in phase.
    pub snr_db: f64,
    /// Seed of the noise alone.
    pub seed: u64,
}

/// Parameters of [`simulate`].
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct SimulateOptions {
    /// c, m/s.
    pub sound_speed: f64,
    /// Fixed speaker or monostatic scan.
    pub geometry: Geometry,
    /// Quadrature or in-phase.
    pub detection: Detection,
    /// Exact or linear paths.
    pub model: PropagationModel,
    /// Noise, if any.
    pub noise: Option<Noise>,
}

impl Default for SimulateOptions {
    fn default() -> Self {
        Self {
            sound_speed: DEFAULT_SOUND_SPEED,
            geometry: Geometry::ORIGIN,
            detection: Detection::Quadrature,
            model: PropagationModel::Exact,
            noise: None,
        }
    }
}

/// Microphones whose columns are held between the sum and the cube's own order.
const COLUMNS: usize = 64;

/// The data cube that the array would record from `reflectors`.
///
/// `m(f, r) = Σ_j A_j e^{+i2πf·path_j(r)/c}` — Eq. 5 in quadrature; its real part in phase.
///
/// - Shapes: `samples` is `[n_f, n_mic]`, in the microphones' order.
/// - Cost: `reflectors × microphones × frequencies` terms of 8 operations (20 for an uneven sweep).
/// - The bytes do not depend on the number of threads.
///
/// # Errors
/// [`Error::Environment`] when the cube does not fit in memory, [`Error::Interrupted`].
pub fn simulate(
    reflectors: &Reflectors,
    sweep: &Sweep,
    array: &MicArray,
    options: &SimulateOptions,
    observer: &dyn Observer,
) -> Result<DataCube> {
    let (n_f, n_mic) = (sweep.len(), array.len());
    let mut samples = DataCube::allocate(n_f, n_mic)?;
    let amplitudes = Amplitudes::new(reflectors.amplitudes().iter().copied());
    stage(observer, "simulating", n_mic as u64, || {
        for (chunk, mics) in array.positions().chunks(COLUMNS).enumerate() {
            let columns: Vec<Vec<[f64; 2]>> = mics
                .par_iter()
                .map(|&r| {
                    let mut lengths: Vec<f64> = reflectors
                        .positions()
                        .iter()
                        .map(|&p| match options.model {
                            PropagationModel::Exact => options.geometry.path_length(p, r),
                            PropagationModel::Linear => options.geometry.linear_path_length(p, r),
                        })
                        .collect();
                    lengths.resize(amplitudes.padded_len(), 0.0);
                    sweep_sums(&amplitudes, &lengths, sweep, options.sound_speed)
                })
                .collect();
            for (column, sums) in columns.iter().enumerate() {
                let mic = chunk * COLUMNS + column;
                for (f, [re, im]) in sums.iter().enumerate() {
                    let im = match options.detection {
                        Detection::Quadrature => *im as f32,
                        Detection::InPhase => 0.0,
                    };
                    samples[f * n_mic + mic] = Complex32::new(*re as f32, im);
                }
            }
            advance(observer, mics.len() as u64)?;
        }
        Ok(())
    })?;
    if let Some(noise) = options.noise {
        add_noise(&mut samples, n_mic, noise, options.detection)?;
    }
    Ok(DataCube {
        sweep: sweep.clone(),
        array: array.clone(),
        geometry: options.geometry,
        detection: options.detection,
        sound_speed: options.sound_speed,
        samples,
        provenance: serde_json::Value::Null,
    })
}

/// One microphone's sums over all frequencies: by recurrence where the steps are even, else one by one.
fn sweep_sums(amplitudes: &Amplitudes, lengths: &[f64], sweep: &Sweep, sound_speed: f64) -> Vec<[f64; 2]> {
    let mut sums = vec![[0.0; 2]; sweep.len()];
    if let Some(step) = sweep.step() {
        let steps = Steps { start: sweep.start() / sound_speed, step: step / sound_speed, count: sums.len() };
        sum_over_sweep(amplitudes, lengths, steps, &mut sums);
    } else {
        for (f, sum) in sweep.frequencies().iter().zip(&mut sums) {
            let steps = Steps { start: f / sound_speed, step: 0.0, count: 1 };
            sum_over_sweep(amplitudes, lengths, steps, std::slice::from_mut(sum));
        }
    }
    sums
}

/// Adds white Gaussian noise; every frequency has its own stream, so threads cannot change the bytes.
fn add_noise(samples: &mut [Complex32], n_mic: usize, noise: Noise, detection: Detection) -> Result<()> {
    if !noise.snr_db.is_finite() {
        return Err(Error::input("detection.snr_db", "must be a finite number of dB"));
    }
    let power: f64 = samples.iter().map(|m| f64::from(m.norm_sqr())).sum::<f64>() / samples.len() as f64;
    let variance = power / 10f64.powf(noise.snr_db / 10.0);
    samples.par_chunks_mut(n_mic).enumerate().for_each(|(f, row)| {
        let mut random = ChaCha8Rng::seed_from_u64(noise.seed);
        random.set_stream(f as u64);
        let mut gauss = |variance: f64| {
            let g: f64 = StandardNormal.sample(&mut random);
            (g * variance.sqrt()) as f32
        };
        for m in row {
            *m += match detection {
                Detection::Quadrature => Complex32::new(gauss(variance / 2.0), gauss(variance / 2.0)),
                Detection::InPhase => Complex32::new(gauss(variance), 0.0),
            };
        }
    });
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::progress::Silent;
    use crate::wave::phasor;
    use glam::DVec3;

    fn scene() -> (Reflectors, MicArray) {
        let positions = (0..37)
            .map(|i| {
                let t = |k: f64| (f64::from(i) * k).fract() - 0.5;
                DVec3::new(t(0.618), t(0.755), 1.5 + t(0.57))
            })
            .collect::<Vec<_>>();
        let amplitudes = (0..37).map(|i| phasor(f64::from(i) * 0.37) * (1.0 + i as f32 / 37.0)).collect();
        let reflectors = Reflectors::new(positions, amplitudes).expect("finite");
        let array =
            MicArray::rectangular("array", [4, 3], [0.05, 0.04], DVec3::new(0.1, 0.0, 0.0)).expect("ok");
        (reflectors, array)
    }

    /// Eq. 5 as it is printed, in f64.
    fn literal(reflectors: &Reflectors, r: DVec3, f: f64, options: &SimulateOptions) -> Complex32 {
        reflectors
            .positions()
            .iter()
            .zip(reflectors.amplitudes())
            .map(|(&p, a)| a * phasor(f * options.geometry.path_length(p, r) / options.sound_speed))
            .sum()
    }

    #[test]
    fn the_cube_is_the_literal_sum_for_even_and_uneven_sweeps() {
        let (reflectors, array) = scene();
        let even = Sweep::stepped("sweep", 10_000.0, 20_000.0, 100.0).expect("ok");
        let uneven = Sweep::from_frequencies("f", vec![9_000.0, 9_500.5, 12_000.0, 20_100.25]).expect("ok");
        for geometry in [Geometry::ORIGIN, Geometry::Monostatic] {
            for sweep in [&even, &uneven] {
                let options = SimulateOptions { geometry, ..SimulateOptions::default() };
                let cube = simulate(&reflectors, sweep, &array, &options, &Silent).expect("small");
                for (f, frequency) in sweep.frequencies().iter().enumerate() {
                    for (mic, &r) in array.positions().iter().enumerate() {
                        let exact = literal(&reflectors, r, *frequency, &options);
                        let error = (cube.samples[f * array.len() + mic] - exact).norm();
                        assert!(error < 2e-4, "{f} {mic}: {error}");
                    }
                }
            }
        }
    }

    #[test]
    fn in_phase_is_the_real_part_of_quadrature() {
        let (reflectors, array) = scene();
        let sweep = Sweep::stepped("sweep", 10_000.0, 11_000.0, 100.0).expect("ok");
        let quadrature =
            simulate(&reflectors, &sweep, &array, &SimulateOptions::default(), &Silent).expect("ok");
        let options = SimulateOptions { detection: Detection::InPhase, ..SimulateOptions::default() };
        let in_phase = simulate(&reflectors, &sweep, &array, &options, &Silent).expect("ok");
        for (q, i) in quadrature.samples.iter().zip(&in_phase.samples) {
            assert_eq!((q.re, 0.0), (i.re, i.im));
        }
    }

    #[test]
    fn noise_has_the_asked_power_and_follows_its_seed() {
        let (reflectors, array) = scene();
        let sweep = Sweep::stepped("sweep", 10_000.0, 20_000.0, 10.0).expect("ok");
        for detection in [Detection::Quadrature, Detection::InPhase] {
            let run = |noise| {
                let options = SimulateOptions { detection, noise, ..SimulateOptions::default() };
                simulate(&reflectors, &sweep, &array, &options, &Silent).expect("ok").samples
            };
            let (clean, noisy) = (run(None), run(Some(Noise { snr_db: 6.0, seed: 4 })));
            let power =
                |m: &mut dyn Iterator<Item = Complex32>| m.map(|m| f64::from(m.norm_sqr())).sum::<f64>();
            let snr =
                power(&mut clean.iter().copied()) / power(&mut clean.iter().zip(&noisy).map(|(a, b)| b - a));
            assert!((10.0 * snr.log10() - 6.0).abs() < 0.2, "{snr}");
            assert_eq!(noisy, run(Some(Noise { snr_db: 6.0, seed: 4 })));
            assert_ne!(noisy, run(Some(Noise { snr_db: 6.0, seed: 5 })));
        }
    }

    #[test]
    fn threads_do_not_change_the_bytes() {
        let (reflectors, array) = scene();
        let sweep = Sweep::stepped("sweep", 10_000.0, 20_000.0, 50.0).expect("ok");
        let options =
            SimulateOptions { noise: Some(Noise { snr_db: 0.0, seed: 1 }), ..SimulateOptions::default() };
        let run = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool");
            pool.install(|| simulate(&reflectors, &sweep, &array, &options, &Silent).expect("ok").samples)
        };
        assert_eq!(run(1), run(7));
    }
}
