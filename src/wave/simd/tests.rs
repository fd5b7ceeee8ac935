//! Every kernel compared with its literal form.

use super::double::phasors_f64;
use super::*;
use crate::wave::interval::phasor_f64;
use crate::wave::phasor;

/// Pseudo-random lengths and amplitudes.
fn terms(n: usize) -> (Vec<f64>, Vec<Complex32>) {
    let fraction = |i: usize, k: f64| (i as f64 * k).fract();
    let lengths = (0..n).map(|i| 0.3 + 11.0 * fraction(i, 0.618_033_988_75)).collect();
    let amplitudes = (0..n)
        .map(|i| {
            Complex32::new(fraction(i, 0.754_877_67) as f32 - 0.5, fraction(i, 0.569_840_29) as f32 - 0.5)
        })
        .collect();
    (lengths, amplitudes)
}

#[test]
fn phasors_equal_the_literal_ones() {
    let (lengths, _) = terms(1000);
    let mut got = vec![Complex32::ZERO; 1000];
    for k in [20_000.0 / 343.0, -17_321.0 / 343.0, 0.0] {
        phasors(k, &lengths, &mut got);
        for (i, length) in lengths.iter().enumerate() {
            let exact = phasor(k * length);
            assert!((exact - got[i]).norm() < 6e-7, "{i} {exact}");
        }
    }
}

#[test]
fn phasors_in_double_precision_equal_the_literal_ones() {
    let cycles: Vec<f64> =
        (0..999).map(|i| f64::from(i - 500) * 1_234.567_89 + 0.25 * f64::from(i % 5)).collect();
    let mut got = vec![num_complex::Complex64::ZERO; cycles.len()];
    phasors_f64(&cycles, &mut got);
    for (cycles, got) in cycles.iter().zip(got) {
        let exact = phasor_f64(*cycles);
        assert!((exact - got).norm() < 1e-11, "{cycles} {exact} {got}");
    }
}

#[test]
fn lane_phasors_equal_the_literal_ones() {
    let (lengths, _) = terms(1024);
    let lengths = lengths.as_chunks().0;
    let mut got = vec![Lanes::ZERO; lengths.len()];
    // Another frequency in every lane.
    let k: [f64; LANES] = std::array::from_fn(|l| (l as f64 - 7.0) * 8.329);
    lane_phasors(&k, lengths, &mut got);
    for (i, lengths) in lengths.iter().enumerate() {
        for l in 0..LANES {
            let exact = phasor(k[l] * lengths[l]);
            assert!((exact - Complex32::new(got[i].re[l], got[i].im[l])).norm() < 6e-7, "{i} {l} {exact}");
        }
    }
}

#[test]
fn the_recurrence_equals_the_literal_sum() {
    for n in [1, 15, 16, 17, 1500] {
        let (mut lengths, amplitudes) = terms(n);
        let steps = Steps { start: 10_000.0 / 343.0, step: 20.0 / 343.0, count: 201 };
        let split = Amplitudes::new(amplitudes.iter().copied());
        let mut sums = vec![[0.0; 2]; steps.count];
        lengths.resize(split.padded_len(), 0.0);
        sum_over_sweep(&split, &lengths, steps, &mut sums);
        let scale: f32 = amplitudes.iter().map(|a| a.norm()).sum();
        for (i, sum) in sums.iter().enumerate() {
            let k = steps.start + steps.step * i as f64;
            let exact: Complex32 =
                amplitudes.iter().zip(&lengths).map(|(a, length)| a * phasor(k * length)).sum();
            let error = (exact - Complex32::new(sum[0] as f32, sum[1] as f32)).norm();
            assert!(error < 1e-5 * scale, "n {n} frequency {i}: {error} of {scale}");
        }
    }
}

/// A single echo, so that no average hides the drift.
#[test]
fn a_phasor_drifts_no_more_than_its_rounding() {
    let steps = Steps { start: 10_000.0 / 343.0, step: 50.0 / 343.0, count: 128 };
    let one = Amplitudes::new([Complex32::ONE].into_iter());
    let mut worst = 0.0f64;
    for i in 0..2000 {
        let length = 12.0 * (f64::from(i) * 0.618_034).fract();
        let mut lengths = vec![0.0; one.padded_len()];
        lengths[0] = length;
        let mut sums = vec![[0.0; 2]; steps.count];
        sum_over_sweep(&one, &lengths, steps, &mut sums);
        for (n, sum) in sums.iter().enumerate() {
            let turns = std::f64::consts::TAU * ((steps.start + steps.step * n as f64) * length).fract();
            worst = worst.max((sum[0] - turns.cos()).hypot(sum[1] - turns.sin()));
        }
    }
    assert!(worst < 5.5e-6, "{worst:e}");
}

#[test]
fn the_weighted_sum_equals_the_literal_one() {
    for n in [1, 16, 255, 256, 273] {
        let (lengths, samples) = terms(n);
        let (re, im): (Vec<f32>, Vec<f32>) = samples.iter().map(|m| (m.re, m.im)).unzip();
        let mut total = [0.0; 2];
        weighted_sum(-50.0, &lengths, [&re, &im], &mut total);
        let exact: Complex32 = samples.iter().zip(&lengths).map(|(m, l)| m * phasor(-50.0 * l)).sum();
        assert!((exact - Complex32::new(total[0] as f32, total[1] as f32)).norm() < 1e-6 * n as f32);
    }
}

#[test]
fn every_instruction_set_gives_bit_identical_results() {
    let (lengths, samples) = terms(777);
    let run = |phasors: fn(&[f64; LANES], &[[f64; LANES]], &mut [Lanes])| {
        let chunks = &lengths.as_chunks().0[..48];
        let mut got = vec![Lanes::ZERO; chunks.len()];
        phasors(&[31.4; LANES], chunks, &mut got);
        got
    };
    assert_eq!(run(lane_phasors), run(lane_phasors_body::<false>));
    let (re, im): (Vec<f32>, Vec<f32>) = samples.iter().map(|m| (m.re, m.im)).unzip();
    let (mut a, mut b) = ([0.0; 2], [0.0; 2]);
    weighted_sum(31.4, &lengths, [&re, &im], &mut a);
    weighted_sum_body::<false>(31.4, &lengths, [&re, &im], &mut b);
    assert_eq!(a, b);
}
