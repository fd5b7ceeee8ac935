//! Recordings by electronics that are not ideal, read again, against what the same electronics read behind a mixer.

use super::{instrument, told};
use crate::acquisition::{
    DataCube, Electronics, HeardTones, Instrument, Latency, OutputFilter, RecorderOptions, RecordingOptions,
    Reference, SimulateOptions, WavFormat, import, simulate, simulate_heard, write_heard,
};
use crate::blocks::NoStore;
use crate::files::wav::WavFile;
use crate::progress::Silent;
use crate::reflectors::Reflectors;
use glam::DVec3;
use num_complex::{Complex32, Complex64};
use std::f64::consts::TAU;

/// 8 ms are whole periods of all tones, and of their harmonics.
const DWELL: f64 = 0.016;
const SETTLING: f64 = 0.008;
const RATE: u32 = 96_000;

fn reflectors() -> Reflectors {
    let places = vec![DVec3::new(0.1, 0.0, 0.5), DVec3::new(-0.2, 0.1, 0.7)];
    Reflectors::new(places, vec![Complex32::new(0.6, 0.3), Complex32::from(-0.4)]).unwrap()
}

fn electronics() -> Electronics {
    Electronics::default()
        .with_filter(OutputFilter::Integration)
        .with_dwell(Some(DWELL))
        .with_settling(SETTLING)
}

fn options(electronics: &Electronics) -> SimulateOptions {
    SimulateOptions::default().with_tolerance(0.0).with_electronics(Some(electronics.clone()))
}

fn tones() -> RecordingOptions {
    RecordingOptions::tones(DWELL).with_settling(Some(SETTLING)).with_start(0.004)
}

fn heard(electronics: &Electronics, instrument: &Instrument) -> HeardTones<'static> {
    let limit = 0.5 * f64::from(RATE);
    let list = [reflectors()];
    simulate_heard(&list, instrument, (&options(electronics), limit), &mut NoStore, &Silent).unwrap()
}

/// What a recording's samples become, with a reference or without, and its frames, as amplitudes of the cube.
fn recorded(electronics: &Electronics, recording: &RecordingOptions) -> (Vec<Complex32>, Vec<f64>, usize) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.wav");
    let instrument = instrument();
    let recorder = RecorderOptions::default()
        .with_sample_rate(RATE)
        .with_format(WavFormat::Float32)
        .with_decay(0.0)
        .with_electronics(Some(electronics.clone()));
    let heard = heard(electronics, &instrument);
    let gain_db = write_heard(&path, &heard, recording, &recorder, &Silent).unwrap();
    // Half of full scale is an amplitude of 1.
    let level = if recording.reference.is_some() { 0.0 } else { -20.0 * 2_f64.log10() };
    let told = told(std::slice::from_ref(&path), recording.clone().with_gain_db(gain_db + level));
    let samples = import(&told).unwrap().cube.samples;
    let mut file = WavFile::open(&path).unwrap();
    let gain = 0.5 * 10_f64.powf(gain_db / 20.0);
    let frames = file.read(0, file.frames()).unwrap();
    (samples, frames.iter().map(|value| f64::from(*value) / gain).collect(), file.channels())
}

fn read(electronics: &Electronics) -> DataCube {
    simulate(&reflectors(), &instrument(), &options(electronics)).unwrap()
}

/// The largest difference, relative to the largest of the others.
fn error(found: &[Complex32], expected: &[Complex32]) -> f64 {
    let peak = expected.iter().map(|m| m.norm()).fold(0.0, f32::max);
    let worst = found.iter().zip(expected).map(|(a, b)| (a - b).norm()).fold(0.0, f32::max);
    f64::from(worst / peak)
}

#[test]
fn a_recording_is_read_as_a_mixer_reads_it() {
    let ideal = electronics();
    let with_reference = tones().with_reference(Some(Reference::Channel(2)));
    let bands =
        ideal.clone().with_amplifier_band(Some([300.0, 15e3])).with_microphone_band(Some([80.0, 18e3]));
    let distorting = bands.clone().with_harmonics_db(vec![-15.0, -20.0, -12.0]);
    let settling = ideal.clone().with_decay(0.003);
    let clock = ideal.clone().with_clock_error(300.0).with_clock_drift(200.0);
    let all = distorting.clone().with_decay(0.003).with_clock_error(50.0);
    // Integrals and sums of samples differ by half a sample of what has not settled, and tones beside those that are fitted
    // leave a part of their conjugate.
    for (name, electronics, matters, allowed) in [
        ("ideal", &ideal, false, 1e-6),
        ("bands", &bands, true, 1e-6),
        ("distorting", &distorting, true, 2e-6),
        ("settling", &settling, true, 5e-4),
        ("clock", &clock, true, 1e-3),
        ("all", &all, true, 1e-3),
    ] {
        let expected = read(electronics).samples;
        let (found, ..) = recorded(electronics, &with_reference);
        let (change, error) = (error(&expected, &read(&ideal).samples), error(&found, &expected));
        assert!(error < allowed, "{name}: {error:.1e}");
        assert_eq!(change > 0.02, matters, "{name}: {change}");
    }
}

#[test]
fn harmonics_are_in_the_waveform_up_to_half_the_sample_rate() {
    let electronics = electronics().with_harmonics_db(vec![-20.0, -26.0, -30.0]);
    let instrument = instrument();
    let (_, frames, channels) = recorded(&electronics, &tones());
    assert_eq!(
        heard(&electronics, &instrument).harmonics.len(),
        3,
        "of 40 kHz a converter at 96 kHz hears nothing"
    );
    let (tone, mic) = (4, 1);
    let f = instrument.sweep.frequencies()[tone];
    let first = 0.004 + tone as f64 * DWELL;
    let window = ((first + SETTLING) * f64::from(RATE)).round() as usize
        ..((first + DWELL) * f64::from(RATE)).round() as usize;
    for (harmonic, level) in [(1.0, 1.0), (2.0, 0.1), (3.0, 10_f64.powf(-1.3)), (4.0, 0.0)] {
        let wave = |k: usize| Complex64::cis(-TAU * harmonic * f * (k as f64 / f64::from(RATE) - first));
        let sum: Complex64 = window.clone().map(|k| frames[k * channels + mic] * wave(k)).sum();
        let found = (sum * 2.0 / window.len() as f64).norm();
        let r = instrument.array.positions()[mic];
        let list = reflectors();
        let echoes = list.positions().iter().zip(list.amplitudes()).map(|(p, a)| {
            let path = instrument.path_length(*p, r);
            Complex64::new(a.re.into(), a.im.into())
                * Complex64::cis(TAU * harmonic * f * path / instrument.sound_speed)
        });
        let expected = level * echoes.sum::<Complex64>().norm();
        assert!((found - expected).abs() < 1e-5, "{harmonic}: {found} {expected}");
    }
}

#[test]
fn a_converter_rounds_cuts_off_and_is_late() {
    let (bits, full) = (9, 1.4);
    let step = 2.0 * full / f64::from(1 << bits);
    let rounding = electronics().with_adc_bits(Some(bits)).with_adc_full_scale(Some(full));
    let (found, frames, _) = recorded(&rounding, &tones());
    assert!(
        frames
            .iter()
            .all(|value| (value / step - (value / step).round()).abs() < 1e-3 && value.abs() <= full)
    );
    assert!(frames.iter().any(|value| value.abs() > 0.3), "something is heard");
    let ideal = recorded(&electronics(), &tones());
    // Each sample is off by half a step at the most, and an amplitude, twice their mean, by a step.
    let peak = ideal.0.iter().map(|m| m.norm()).fold(0.0, f32::max);
    let rounded = error(&found, &ideal.0) * f64::from(peak);
    assert!(rounded < step && rounded > 1e-5, "{rounded} {step}");
    let cut = recorded(&electronics().with_adc_full_scale(Some(0.25)), &tones()).1;
    let most = cut.iter().fold(0.0, |most: f64, value| most.max(value.abs()));
    assert!((most - 0.25).abs() < 1e-6, "{most}");
    // Without a full scale it is that of the file, twice an amplitude of 1.
    let coarse = recorded(&electronics().with_adc_bits(Some(6)), &tones()).1;
    assert!(coarse.iter().all(|value| (value * 16.0 - (value * 16.0).round()).abs() < 1e-3));
    // What is late at random is weaker on average, by the characteristic function; beside a reference that is as late, it is not.
    let jitter = 6e-6;
    let late = electronics().with_jitter(jitter);
    let mean = |found: &[Complex32]| {
        let shares = found.iter().zip(&ideal.0).map(|(a, b)| f64::from((a * b.conj()).re));
        shares.sum::<f64>() / ideal.0.iter().map(|m| f64::from(m.norm_sqr())).sum::<f64>()
    };
    let kept = mean(&recorded(&late, &tones()).0);
    let expected = (-0.5 * (TAU * 11e3 * jitter).powi(2)).exp();
    assert!((kept - expected).abs() < 0.02 && expected < 0.93, "{kept} {expected}");
    let beside = mean(&recorded(&late, &tones().with_reference(Some(Reference::Channel(0)))).0);
    assert!((beside - 1.0).abs() < 0.02, "{beside}");
}

#[test]
fn what_a_recording_does_not_have_is_refused() {
    use crate::acquisition::{Mixer, QuadratureBy};
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.wav");
    let instrument = instrument();
    let heard = heard(&electronics(), &instrument);
    for (electronics, named) in [
        (electronics().with_mixer(Mixer::Switch), "mixer"),
        (electronics().with_filter(OutputFilter::LowPass), "filter"),
        (electronics().with_quadrature_error(1.0), "quadrature_error"),
        (electronics().with_quadrature(QuadratureBy::Passes), "quadrature"),
        (electronics().with_clock_error(4e6), "sample_rate"),
        (electronics().with_jitter(-1.0), "jitter"),
    ] {
        let recorder = RecorderOptions::default().with_electronics(Some(electronics));
        let recording = tones().with_latency(Latency::Seconds(0.0));
        let error = write_heard(&path, &heard, &recording, &recorder, &Silent).unwrap_err().to_string();
        assert!(error.contains(named), "{named}: {error}");
        assert!(!path.exists());
    }
}
