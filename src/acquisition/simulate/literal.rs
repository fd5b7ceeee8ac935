//! Eq. 5 summed term by term: the oracle, and the way where virtual tones do not pay.

use super::kept::KeptSamples;
use super::{SimulateOptions, record};
use crate::acquisition::{MicArray, Sweep};
use crate::error::Result;
use crate::progress::{Observer, advance};
use crate::reflectors::Reflectors;
use crate::wave::simd::{Amplitudes, Steps, sum_over_sweep};
use rayon::prelude::*;

/// Microphones whose columns are held between the sum and the cube's own order.
const COLUMNS: usize = 64;

/// Fills the samples, `[n_f, n_mic]`, with the literal sum.
pub(super) fn literal(
    reflectors: &Reflectors,
    sweep: &Sweep,
    array: &MicArray,
    options: &SimulateOptions,
    kept: &mut KeptSamples,
    observer: &dyn Observer,
) -> Result<()> {
    let n_mic = array.len();
    let amplitudes = Amplitudes::new(reflectors.amplitudes().iter().copied());
    for (chunk, mics) in array.positions().chunks(COLUMNS).enumerate() {
        let members: Vec<usize> = (chunk * COLUMNS..).take(mics.len()).collect();
        if kept.recall(chunk, &members)? {
            advance(observer, mics.len() as u64)?;
            continue;
        }
        let columns: Vec<Vec<[f64; 2]>> = mics
            .par_iter()
            .map(|&r| {
                let mut lengths: Vec<f64> =
                    reflectors.positions().iter().map(|&p| options.path_length(p, r)).collect();
                lengths.resize(amplitudes.padded_len(), 0.0);
                sweep_sums(&amplitudes, &lengths, sweep, options.sound_speed)
            })
            .collect();
        for (column, sums) in columns.iter().enumerate() {
            let mic = chunk * COLUMNS + column;
            for (f, [re, im]) in sums.iter().enumerate() {
                kept.samples[f * n_mic + mic] = record(options.detection, *re as f32, *im as f32);
            }
        }
        kept.finish(chunk, &members);
        kept.pause()?;
        advance(observer, mics.len() as u64)?;
    }
    Ok(())
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
