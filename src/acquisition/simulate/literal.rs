//! Eq. 5 summed term by term: the reference, and the method where virtual tones are not cheaper.

mod moving;

pub(in crate::acquisition) use moving::simulate_moving;

use super::columns::Columns;
use super::losses::{Legs, wave_number};
use super::paths::{heard, legs, path_length};
use super::{SimulateOptions, SimulationJob, no_room, record};
use crate::acquisition::{Instrument, Sweep};
use crate::alloc::{try_filled, try_with_capacity};
use crate::error::Result;
use crate::progress::{Observer, advance};
use crate::reflectors::Reflectors;
use crate::wave::simd::{Amplitudes, Steps, sum_over_sweep};
use glam::DVec3;
use num_complex::Complex32;
use rayon::prelude::*;

/// Microphones whose sums are in memory before they are copied into the cube.
pub(super) const COLUMNS: usize = 64;

/// Fills the samples, `[n_f, n_mic]`, with the literal sum.
pub(super) fn literal(job: &SimulationJob<'_>, columns: &mut Columns, observer: &dyn Observer) -> Result<()> {
    let SimulationJob { reflectors, instrument, options, responses } = *job;
    let Instrument { sweep, array, detection, sound_speed, .. } = instrument;
    let plain = Amplitudes::new(reflectors.amplitudes().iter().copied());
    for (chunk, mics) in array.positions().chunks(COLUMNS).enumerate() {
        let members: Vec<usize> = (chunk * COLUMNS..).take(mics.len()).collect();
        if columns.load(chunk, &members)? {
            advance(observer, mics.len() as u64)?;
            continue;
        }
        let sums: Vec<Vec<[f64; 2]>> = members
            .par_iter()
            .zip(mics)
            .map(|(mic, &r)| {
                let instrument = &instrument.seen_from(*mic);
                let mut lengths: Vec<f64> =
                    try_with_capacity(plain.padded_len() as u64).ok_or_else(no_room)?;
                let of = |j: usize| path_length(reflectors, j, r, instrument, options);
                lengths.extend((0..reflectors.len()).map(of));
                lengths.resize(plain.padded_len(), 0.0);
                let sums = try_filled([0.0; 2], sweep.len() as u64).ok_or_else(no_room)?;
                Ok(if options.losses.vary() {
                    lossy_sums(reflectors, r, &lengths, instrument, options, sums)
                } else if options.losses.any() || !reflectors.transmit_lengths().is_empty() {
                    let spread = |j: usize| legs(reflectors, j, r, instrument, options).spreading as f32;
                    let spread = (0..reflectors.len()).map(|j| heard(reflectors, j, r) * spread(j));
                    sweep_sums(&Amplitudes::new(spread), &lengths, sweep, *sound_speed, sums)
                } else {
                    sweep_sums(&plain, &lengths, sweep, *sound_speed, sums)
                })
            })
            .collect::<Result<_>>()?;
        columns.fill(&[(chunk, &members)], |samples, width, columns| {
            for ((mic, column), sums) in members.iter().zip(&columns[0]).zip(&sums) {
                for (f, [re, im]) in sums.iter().enumerate() {
                    let m = Complex32::new(*re as f32, *im as f32);
                    samples[f * width + column] = record(*detection, responses.get(*mic), m);
                }
            }
        })?;
        columns.save_if_due()?;
        advance(observer, mics.len() as u64)?;
    }
    Ok(())
}

/// One microphone's sums at all frequencies, starting from zeros: by recurrence for even steps, otherwise one by one.
fn sweep_sums(
    amplitudes: &Amplitudes,
    lengths: &[f64],
    sweep: &Sweep,
    sound_speed: f64,
    mut sums: Vec<[f64; 2]>,
) -> Vec<[f64; 2]> {
    if let Some(step) = sweep.step() {
        let steps = Steps { start: sweep.start() / sound_speed, step: step / sound_speed, count: sums.len() };
        sum_over_sweep(amplitudes, lengths, steps, &mut sums);
    } else {
        for (f, sum) in sweep.frequencies().iter().zip(&mut sums) {
            sum_at(*f, amplitudes, lengths, sound_speed, sum);
        }
    }
    sums
}

/// The same with losses that depend on the frequency: every term has a factor of its own.
fn lossy_sums(
    reflectors: &Reflectors,
    r: DVec3,
    lengths: &[f64],
    instrument: &Instrument,
    options: &SimulateOptions,
    mut sums: Vec<[f64; 2]>,
) -> Vec<[f64; 2]> {
    let Instrument { sweep, sound_speed: c, .. } = instrument;
    let losses = &options.losses;
    let legs: Vec<Legs> =
        (0..reflectors.len()).map(|j| legs(reflectors, j, r, instrument, options)).collect();
    let amplitudes: Vec<Complex32> = (0..reflectors.len()).map(|j| heard(reflectors, j, r)).collect();
    for (&f, sum) in sweep.frequencies().iter().zip(&mut sums) {
        let (absorption, k) = (losses.absorption(f), wave_number(f, *c));
        let weighted = amplitudes.iter().zip(&legs);
        let weighted = weighted.map(|(a, legs)| a * legs.factor(losses, absorption, k) as f32);
        sum_at(f, &Amplitudes::new(weighted), lengths, *c, sum);
    }
    sums
}

/// The sum at one frequency.
fn sum_at(f: f64, amplitudes: &Amplitudes, lengths: &[f64], sound_speed: f64, sum: &mut [f64; 2]) {
    let steps = Steps { start: f / sound_speed, step: 0.0, count: 1 };
    sum_over_sweep(amplitudes, lengths, steps, std::slice::from_mut(sum));
}
