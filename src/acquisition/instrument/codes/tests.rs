//! Codes against their sums written out, what they are worth against noise, and what is refused.

#![allow(clippy::unwrap_used)]

use super::*;
use crate::acquisition::{MicArray, Noise, SimulateOptions, Sweep, simulate};
use crate::named::assert_names;
use crate::reflectors::Reflectors;

fn random(i: usize, k: f64) -> f64 {
    (i as f64 * k).fract() - 0.5
}

fn instrument(loudspeakers: usize) -> Instrument {
    let array = MicArray::rectangular([4, 3], [0.04; 2], DVec3::ZERO).unwrap();
    let places: Vec<DVec3> = (0..loudspeakers).map(|s| DVec3::new(0.05 * s as f64, -0.1, 0.0)).collect();
    Instrument::new(Sweep::stepped(8e3, 10e3, 200.0).unwrap(), array).with_sources(&places).unwrap()
}

fn samples(instrument: &Instrument) -> Vec<Complex32> {
    let count = instrument.transmissions() * instrument.sweep.len() * instrument.array.len();
    let m = |i: usize| [0.618_033_99, 0.754_877_67].map(|k| random(i + 1, k) as f32);
    (0..count).map(|i| Complex32::new(m(i)[0], m(i)[1])).collect()
}

fn sequences(rows: &[&[f64]], decoding: Decoding) -> SourceCode {
    let sequences = rows.iter().map(|row| row.to_vec()).collect();
    SourceCode { sequences, decoding, ..SourceCode::new(CodeKind::Sequences) }
}

fn apart(a: &[Complex32], b: &[Complex32]) -> f32 {
    a.iter().zip(b).map(|(a, b)| (a - b).norm()).fold(0.0, f32::max)
}

#[test]
fn what_is_encoded_is_the_literal_sum_and_decodes_to_what_it_was() {
    let oblique = sequences(
        &[&[1.0, 0.5, 0.2], &[0.3, -1.0, 0.4], &[0.0, 0.3, 1.0], &[1.0, 1.0, -1.0]],
        Decoding::Inverse,
    );
    for (code, n_tx) in
        [(SourceCode::new(CodeKind::Hadamard), 4), (SourceCode::new(CodeKind::Hadamard), 3), (oblique, 3)]
    {
        let instrument = instrument(n_tx);
        let m = samples(&instrument);
        let recorded = code.encode(&instrument, &m).unwrap();
        let sweeps = code.sweeps(n_tx);
        assert_eq!((sweeps, recorded.len()), (4, 4 * m.len() / n_tx));
        let sweep = m.len() / n_tx;
        for (i, y) in recorded.iter().enumerate() {
            let amplitude = |s: usize| match code.kind {
                // Rows of the matrix of order 4, written out.
                CodeKind::Hadamard => {
                    [[1, 1, 1, 1], [1, -1, 1, -1], [1, 1, -1, -1], [1, -1, -1, 1]][i / sweep][s] as f32
                }
                _ => code.sequences[i / sweep][s] as f32,
            };
            let exact: Complex32 = (0..n_tx).map(|s| m[s * sweep + i % sweep] * amplitude(s)).sum();
            assert!((y - exact).norm() < 1e-6);
        }
        assert!(apart(&code.decode(&instrument, &recorded).unwrap(), &m) < 1e-5);
        let report = code.report(&instrument).unwrap();
        assert_eq!((report.cross_talk_db, report.own_step), (None, None));
        if code.kind == CodeKind::Hadamard {
            assert!((report.snr_gain_db - 10.0 * 4_f64.log10()).abs() < 1e-9);
            assert!((report.equal_time_gain_db - 10.0 * (n_tx as f64).log10()).abs() < 1e-9);
        }
    }
}

#[test]
fn a_comb_gives_each_speaker_its_own_tones() {
    let instrument = instrument(3);
    let (m, comb) = (samples(&instrument), SourceCode::new(CodeKind::Comb));
    let recorded = comb.encode(&instrument, &m).unwrap();
    let (n_f, n_mic) = (instrument.sweep.len(), instrument.array.len());
    assert_eq!(recorded.len(), n_f * n_mic);
    for (i, y) in recorded.iter().enumerate() {
        assert_eq!(*y, m[i / n_mic % 3 * n_f * n_mic + i]);
    }
    let decoded = comb.decode(&instrument, &recorded).unwrap();
    for (i, (decoded, m)) in decoded.iter().zip(&m).enumerate() {
        let own = i / n_mic % n_f % 3 == i / (n_f * n_mic);
        assert_eq!(*decoded, if own { m * 3.0 } else { Complex32::ZERO });
    }
    let report = comb.report(&instrument).unwrap();
    assert_eq!(report.own_step, Some(600.0));
    assert!((report.sweeps - 1.0 / 3.0).abs() < 1e-12 && report.cross_talk_db.is_none());
    assert!((report.snr_gain_db + 10.0 * 3_f64.log10()).abs() < 1e-9);
    assert!((report.equal_time_gain_db - 10.0 * 3_f64.log10()).abs() < 1e-9);
}

#[test]
fn cross_talk_is_what_others_leave_and_follows_from_the_errors() {
    let instrument = instrument(4);
    let wrong = |kind| SourceCode { error: 0.05, ..SourceCode::new(kind) };
    // Independent errors, rms 0.05, of three others: over 4 sweeps they average.
    for (code, expected) in [
        (wrong(CodeKind::Hadamard), 3.0 * 0.05_f64.powi(2) / 4.0),
        (wrong(CodeKind::Comb), 3.0 * 0.05_f64.powi(2)),
        (
            sequences(
                &[&[1.0, 0.1, 0.0, 0.0], &[0.1, 1.0, 0.0, 0.0], &[0.0, 0.0, 1.0, 0.1], &[0.0, 0.0, 0.1, 1.0]],
                Decoding::Matched,
            ),
            (0.2_f64 / 1.01).powi(2),
        ),
    ] {
        let level = code.report(&instrument).unwrap().cross_talk_db.unwrap();
        assert!((level - 10.0 * expected.log10()).abs() < 2.5, "{level} {}", 10.0 * expected.log10());
        // The same by samples: all others sound, and speaker 0 does not.
        let (n_f, n_mic) = (instrument.sweep.len(), instrument.array.len());
        let heard = |alone: usize| {
            let mut m = vec![Complex32::ZERO; 4 * n_f * n_mic];
            m[alone * n_f * n_mic..][..n_f * n_mic].fill(Complex32::ONE);
            let decoded = code.decode(&instrument, &code.encode(&instrument, &m).unwrap()).unwrap();
            // Whole periods of the comb.
            let sums =
                |s: usize| decoded[s * n_f * n_mic..][..8 * n_mic].iter().sum::<Complex32>().norm_sqr();
            std::array::from_fn::<f32, 4, _>(sums)
        };
        let powers = std::array::from_fn::<[f32; 4], 4, _>(heard);
        let of = |s: usize| (0..4).filter(|o| *o != s).map(|o| powers[o][s]).sum::<f32>() / powers[s][s];
        let mean = (0..4).map(of).sum::<f32>() / 4.0;
        assert!((10.0 * f64::from(mean).log10() - level).abs() < 0.01, "{mean} {level}");
    }
}

#[test]
fn noise_falls_as_the_report_says() {
    let instrument = instrument(4);
    let nothing = |code: Option<SourceCode>| {
        let reflector = Reflectors::new(vec![DVec3::Z], vec![Complex32::ONE]).unwrap();
        let options = SimulateOptions::default().with_code(code);
        let quiet = simulate(&reflector, &instrument, &options).unwrap();
        let noisy =
            simulate(&reflector, &instrument, &options.with_noise(Noise { snr_db: 0.0, seed: 5 })).unwrap();
        let power = |a: &Complex32, b: &Complex32| f64::from((a - b).norm_sqr());
        quiet.samples.iter().zip(&noisy.samples).map(|(a, b)| power(a, b)).sum::<f64>()
    };
    let alone = nothing(None);
    for kind in [CodeKind::Hadamard, CodeKind::Comb] {
        let code = SourceCode::new(kind);
        let gain = 10.0 * (alone / nothing(Some(code.clone()))).log10();
        let expected = code.report(&instrument).unwrap().snr_gain_db;
        assert!((gain - expected).abs() < 0.6, "{kind}: {gain} {expected}");
    }
}

#[test]
fn a_measured_cube_of_sweeps_is_decoded() {
    let code = SourceCode::new(CodeKind::Hadamard);
    let several = instrument(3);
    let m = samples(&several);
    // As four transmissions, of whatever places.
    let mut cube = DataCube::new(instrument(4), code.encode(&several, &m).unwrap()).unwrap();
    let refused = code.clone().decode_cube(&mut cube, &several.sources()[..2]).unwrap_err();
    assert_names(refused.to_string(), &["calibration.decode", "2 sweeps of 2 speakers", "has 4"]);
    let words = code.decode_cube(&mut cube, &several.sources()).unwrap();
    assert_names(words, &["decoded", "3 speakers", "hadamard", "4.000 sweeps"]);
    assert!(cube.instrument == several && apart(&cube.samples, &m) < 1e-5);
}

#[test]
fn what_tells_nobody_apart_is_refused() {
    let refused = |code: SourceCode, n_tx: usize, parts: &[&str]| {
        let instrument = instrument(n_tx);
        let error = code.report(&instrument).unwrap_err();
        assert_eq!(error.exit_status(), 2);
        assert_names(error.to_string(), parts);
        assert!(code.encode(&instrument, &samples(&instrument)).is_err());
    };
    refused(SourceCode::new(CodeKind::Hadamard), 1, &["coding.kind", "there are 1"]);
    refused(SourceCode::new(CodeKind::Comb), 12, &["coding.kind", "12 speakers", "there are 11"]);
    let wrong = SourceCode { error: f64::NAN, ..SourceCode::new(CodeKind::Comb) };
    refused(wrong, 2, &["coding.error", "0 to 1"]);
    refused(sequences(&[], Decoding::Inverse), 2, &["coding.sequences", "2 amplitudes"]);
    refused(sequences(&[&[1.0]], Decoding::Inverse), 2, &["coding.sequences", "2 amplitudes"]);
    refused(sequences(&[&[1.0, 2.0], &[1.0, 0.0]], Decoding::Inverse), 2, &["coding.sequences", "-1 to 1"]);
    refused(sequences(&[&[1.0, f64::NAN], &[1.0, 0.0]], Decoding::Inverse), 2, &["-1 to 1"]);
    refused(sequences(&[&[1.0, 1.0], &[1.0, 1.0]], Decoding::Inverse), 2, &["only 1 independent"]);
    refused(sequences(&[&[1.0, 1.0]], Decoding::Inverse), 2, &["only 1 independent"]);
    refused(sequences(&[&[1.0, 0.0]], Decoding::Matched), 2, &["coding.sequences"]);
    // Matched, one sequence for both is possible, and of no use.
    let same = sequences(&[&[1.0, 1.0]], Decoding::Matched).report(&instrument(2)).unwrap();
    assert!(same.cross_talk_db.unwrap().abs() < 1e-9);
}
