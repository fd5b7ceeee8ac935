//! Recordings made of sounds with known delays, read again: every way of saying what was sent.

#![allow(clippy::unwrap_used)]

mod chain;

use super::*;
use crate::acquisition::{Detection, ImportOptions, Imported, MicArray, Noise, Sweep, import};
use crate::files::wav::write_wav;
use crate::named::assert_names;
use crate::progress::Silent;
use glam::DVec3;
use std::f64::consts::TAU;
use std::fs;
use std::path::Path;

const RATE: f64 = 44_100.0;

/// 2 × 3 microphones, and nine tones.
fn instrument() -> Instrument {
    let sweep = Sweep::stepped(10e3, 12e3, 250.0).unwrap();
    Instrument::new(sweep, MicArray::rectangular([2, 3], [0.1, 0.2], DVec3::ZERO).unwrap())
}

/// Two echoes of a microphone: amplitude and delay, s. The first is the direct wave of that instrument.
fn echoes(mic: usize) -> [(f64, f64); 2] {
    let direct = instrument().array.positions()[mic].length() / 343.0;
    [(0.9, direct), (0.3 - 0.02 * mic as f64, 0.002_37 + 0.000_113 * mic as f64)]
}

/// What a cube has of these, if everything is late.
fn exact(mic: usize, frequency: f64, latency: f64) -> Complex64 {
    echoes(mic).iter().map(|(a, delay)| a * Complex64::cis(TAU * frequency * (delay + latency))).sum()
}

/// The nine tones one after another, at time `t` after the first begins.
fn tones(t: f64, dwell: f64) -> f64 {
    let tone = (t / dwell).floor();
    if !(0.0..9.0).contains(&tone) {
        return 0.0;
    }
    (TAU * (10e3 + 250.0 * tone) * (t - tone * dwell)).sin()
}

/// A chirp from 9 to 13 kHz in 0.2 s.
fn chirp(t: f64) -> f64 {
    if !(0.0..0.2).contains(&t) {
        return 0.0;
    }
    let edge = (t.min(0.2 - t) / 0.01).min(1.0);
    (0.5 * TAU * edge / 4.0).sin().powi(2) * (TAU * (9e3 + 10e3 * t) * t).sin()
}

/// A signal's echoes at a microphone, 6 dB below full scale.
fn heard(mic: usize, t: f64, signal: &dyn Fn(f64) -> f64) -> f32 {
    (0.5 * echoes(mic).iter().map(|(a, delay)| a * signal(t - delay)).sum::<f64>()) as f32
}

/// Writes `seconds` of channels, each a function of its number and the time.
fn record(path: &Path, (channels, format, seconds): (u16, WavFormat, f64), sound: &dyn Fn(u16, f64) -> f32) {
    write_wav(path, (channels, RATE as u32, format), |put| {
        for k in 0..(seconds * RATE).ceil() as u64 {
            put(&(0..channels).map(|channel| sound(channel, k as f64 / RATE)).collect::<Vec<_>>())?;
        }
        Ok(())
    })
    .unwrap();
}

fn told(files: &[PathBuf], recording: RecordingOptions) -> ImportOptions {
    let instrument = instrument();
    let mut options = ImportOptions::new(files.to_vec());
    (options.sweep, options.array) = (Some(instrument.sweep), Some(instrument.array));
    options.recording = recording;
    options
}

/// The largest error against the echoes, if everything is late.
fn error(imported: &Imported, latency: f64) -> f64 {
    let cube = &imported.cube;
    let errors = cube.samples.iter().enumerate().map(|(index, m)| {
        let expected = exact(index % 6, cube.instrument.sweep.frequencies()[index / 6], latency);
        (Complex64::new(m.re.into(), m.im.into()) - expected).norm()
    });
    errors.fold(0.0, f64::max)
}

#[track_caller]
fn refused(options: &ImportOptions, parts: &[&str]) {
    let error = import(options).unwrap_err();
    assert_eq!(error.exit_status(), 2, "{error}");
    assert_names(error.to_string(), parts);
}

#[test]
fn stepped_tones_become_the_echoes_that_they_are() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.wav");
    // No whole number of periods, nor of samples.
    let (start, dwell) = (0.0101, 0.023_37);
    for (format, allowed) in [(WavFormat::Int16, 3e-5), (WavFormat::Int24, 5e-7), (WavFormat::Float32, 5e-7)]
    {
        // Channel 2 is the reference, the others are the microphones from the last to the first.
        record(&path, (7, format, 0.23), &|channel, t| match channel {
            2 => (0.25 * tones(t - start, dwell)) as f32,
            0 | 1 => heard(5 - usize::from(channel), t - start, &|t| tones(t, dwell)),
            _ => heard(6 - usize::from(channel), t - start, &|t| tones(t, dwell)),
        });
        let recording = RecordingOptions::tones(dwell)
            .with_start(start)
            .with_settling(Some(0.006))
            .with_reference(Some(Reference::Channel(2)))
            .with_microphones(vec![6, 5, 4, 3, 1, 0])
            .with_gain_db(20.0 * 2_f64.log10());
        let imported = import(&told(std::slice::from_ref(&path), recording)).unwrap();
        let error = error(&imported, 0.0);
        assert!(error < allowed, "{format}: {error:.1e}");
        assert!(imported.warnings.is_empty() && imported.cube.instrument.detection == Detection::Quadrature);
        let facts = imported.facts();
        assert!(facts["least_snr_db"].as_f64().unwrap() > 80.0, "{facts}");
        assert_eq!(facts["snr_db_of_tones"].as_array().unwrap().len(), 9);
    }
}

#[test]
fn a_file_for_each_microphone_without_a_reference_and_with_a_latency() {
    let folder = tempfile::tempdir().unwrap();
    let (dwell, latency) = (0.02, 0.051_3);
    let files: Vec<PathBuf> = (0..6).map(|mic| folder.path().join(format!("mic{mic}.wav"))).collect();
    for (mic, path) in files.iter().enumerate() {
        record(path, (1, WavFormat::Float32, 0.24), &|_, t| {
            2.0 * heard(mic, t - latency, &|t| tones(t, dwell))
        });
    }
    let recording =
        RecordingOptions::tones(dwell).with_settling(Some(0.006)).with_latency(Latency::Seconds(latency));
    let mut options = told(&[folder.path().join("mic{i}.wav")], recording);
    let imported = import(&options).unwrap();
    assert!(error(&imported, 0.0) < 5e-7, "{:.1e}", error(&imported, 0.0));
    assert_names(imported.guesses.join("; "), &["a sine of amplitude 1"]);
    // The same files by their names, in phase.
    options.samples = files;
    options.detection = Some(Detection::InPhase);
    let real = import(&options).unwrap().cube;
    assert!(real.samples.iter().zip(&imported.cube.samples).all(|(a, b)| a.re == b.re && a.im == 0.0));
    options.phase_sign = Some(-1);
    refused(&options, &["phase_sign", "known"]);
}

#[test]
fn a_chirp_becomes_the_same_echoes() {
    let folder = tempfile::tempdir().unwrap();
    let (path, sent) = (folder.path().join("a.wav"), folder.path().join("sent.wav"));
    record(&sent, (1, WavFormat::Float32, 0.21), &|_, t| (0.5 * chirp(t - 0.005)) as f32);
    record(&path, (6, WavFormat::Int24, 0.25), &|mic, t| heard(mic.into(), t - 0.015, &chirp));
    // The recording is 10 ms late against the file that was sent.
    let recording = RecordingOptions::broadband(Reference::File(sent.clone()))
        .with_latency(Latency::Seconds(0.01))
        .with_response(Some(0.012));
    let mut options = told(std::slice::from_ref(&path), recording);
    let imported = import(&options).unwrap();
    assert!(error(&imported, 0.0) < 3e-4, "{:.1e}", error(&imported, 0.0));
    assert!(imported.facts()["snr_db"].as_f64().unwrap() > 40.0, "{}", imported.facts());
    // Literally: the ratio of both spectra at each tone.
    let spectrum = |path: &Path, channel: usize, f: f64| -> Complex64 {
        let mut file = crate::files::wav::WavFile::open(path).unwrap();
        let samples = file.read(0, file.frames()).unwrap();
        let frames = samples.chunks_exact(file.channels()).enumerate();
        frames.map(|(k, frame)| f64::from(frame[channel]) * Complex64::cis(-TAU * f * k as f64 / RATE)).sum()
    };
    for (n, f) in instrument().sweep.frequencies().iter().enumerate().step_by(3) {
        let ratio = (spectrum(&path, 4, *f) / spectrum(&sent, 0, *f)).conj();
        let literal = ratio * Complex64::cis(-TAU * f * 0.01);
        let m = imported.cube.samples[n * 6 + 4];
        let error = (Complex64::new(m.re.into(), m.im.into()) - literal).norm();
        assert!(error < 3e-4, "{f}: {m} {literal}");
    }
    // Without a response's length it is that of the tones' ambiguity, 4 ms.
    options.recording.response = None;
    options.recording.latency = Latency::Found(DirectWord::Direct);
    // Without a latency it is found.
    let found = import(&options).unwrap();
    let latency = found.facts()["latency_s"].as_f64().unwrap();
    assert!((latency - 0.01).abs() < 5e-6, "{latency}");
    assert!(error(&found, 0.01 - latency) < 5e-3, "{:.1e}", error(&found, 0.01 - latency));
    options.recording.reference = None;
    refused(&options, &["[recording] reference", "broadband", "channel"]);
    options.recording.reference = Some(Reference::Channel(5));
    refused(&options, &["6 microphones", "5 channels"]);
    options.recording.reference = Some(Reference::File(path));
    refused(&options, &["a.wav", "6 channels", "one"]);
    options.recording.reference = Some(Reference::File(sent));
    options.sweep = Some(Sweep::stepped(10e3, 14e3, 250.0).unwrap());
    refused(&options, &["hardly holds", "14000 Hz"]);
}

#[test]
fn the_direct_wave_of_tones_tells_the_latency() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.wav");
    let dwell = 0.02;
    record(&path, (7, WavFormat::Int24, 0.2), &|channel, t| match channel {
        0 => (0.5 * tones(t, dwell)) as f32,
        _ => heard(usize::from(channel) - 1, t - 0.000_7, &|t| tones(t, dwell)),
    });
    let recording = RecordingOptions::tones(dwell)
        .with_settling(Some(0.006))
        .with_reference(Some(Reference::Channel(0)))
        .with_latency(Latency::Found(DirectWord::Direct));
    let imported = import(&told(&[path], recording)).unwrap();
    let facts = imported.facts();
    let latency = facts["latency_s"].as_f64().unwrap();
    // The band of 2 kHz is narrow: the echo, 10 dB lower and 2 ms later, is 4 range cells away.
    assert!((latency - 0.000_7).abs() < 5e-6, "{facts}");
    assert!(facts["direct_wave_share"].as_f64().unwrap() > 0.7, "{facts}");
    assert!(error(&imported, 0.000_7 - latency) < 1e-6);
}

/// A cube of these echoes.
fn cube() -> DataCube {
    let instrument = instrument();
    let samples = instrument.sweep.frequencies().iter().flat_map(|f| {
        (0..6).map(|mic| exact(mic, *f, 0.0)).map(|m| Complex32::new(m.re as f32, m.im as f32))
    });
    DataCube::new(instrument.clone(), samples.collect()).unwrap()
}

#[test]
fn a_simulated_recording_is_the_cube_again_with_its_noise() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.wav");
    let cube = cube();
    let recording = RecordingOptions::tones(0.05)
        .with_start(0.013)
        .with_settling(Some(0.02))
        .with_reference(Some(Reference::Channel(3)))
        .with_latency(Latency::Seconds(0.000_31));
    let mut recorder = RecorderOptions::default();
    let again = |recorder: &RecorderOptions| {
        let gain_db = write_recording(&path, &cube, &recording, recorder, &Silent).unwrap();
        import(&told(std::slice::from_ref(&path), recording.clone().with_gain_db(gain_db))).unwrap()
    };
    let imported = again(&recorder);
    // What is left of the tone before after 20 ms: e⁻¹⁰, and of the rising one.
    assert!(error(&imported, 0.0) < 1e-4, "{:.1e}", error(&imported, 0.0));
    recorder.decay = 0.0;
    let at_once = again(&recorder);
    assert!(error(&at_once, 0.0) < 1e-6, "{:.1e}", error(&at_once, 0.0));
    recorder.noise = Some(Noise { snr_db: 25.0, seed: 7 });
    let noisy = again(&recorder);
    let facts = noisy.facts();
    assert!((facts["snr_db"].as_f64().unwrap() - 25.0).abs() < 1.5, "{facts}");
    let errors = noisy.cube.samples.iter().zip(&cube.samples).map(|(a, b)| f64::from((a - b).norm_sqr()));
    let power: f64 = cube.samples.iter().map(|m| f64::from(m.norm_sqr())).sum();
    let snr_db = 10.0 * (power / errors.sum::<f64>()).log10();
    assert!((snr_db - 25.0).abs() < 1.5, "{snr_db}");
    // The same bytes on any number of threads.
    let bytes = fs::read(&path).unwrap();
    assert_eq!(
        bytes.len() as u64,
        RecordingSize::of(&cube.instrument, &recording, &recorder).unwrap().bytes + 68
    );
    for threads in [1, 3] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| write_recording(&path, &cube, &recording, &recorder, &Silent)).unwrap();
        assert!(fs::read(&path).unwrap() == bytes, "{threads} threads");
    }
}

/// The paper's chain: tone, delay, converter, mixer, low-pass filter.
#[test]
fn equation_3_holds_behind_a_converter() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.wav");
    let cube = cube();
    let recording = RecordingOptions::tones(0.02);
    let recorder = RecorderOptions::default().with_decay(0.0).with_gain_db(Some(-6.0));
    for (format, bits) in [(WavFormat::Int16, 16), (WavFormat::Int24, 24)] {
        write_recording(&path, &cube, &recording, &recorder.clone().with_format(format), &Silent).unwrap();
        let mut file = crate::files::wav::WavFile::open(&path).unwrap();
        let gain = 0.5 * 10_f64.powf(-6.0 / 20.0);
        // 768 samples are 16 ms: a whole number of half periods of each tone, of 250 Hz.
        let (count, rate) = (768_u32, 48_000.0);
        // Each sample is off by half a step at the most, and so twice their mean by a step. No less can be said of tones
        // that repeat after a few samples, and their errors with them.
        let bound = 2_f64.powi(1 - bits) + 1e-7;
        for (tone, frequency) in cube.instrument.sweep.frequencies().iter().enumerate() {
            let frames = file.read(960 * tone as u64 + 96, count.into()).unwrap();
            for mic in 0..6 {
                let heard: Vec<f32> = frames.iter().skip(mic).step_by(6).copied().collect();
                let found = mixer::homodyne(&heard, *frequency, 96.0 / rate, 1.0 / rate);
                let expected = exact(mic, *frequency, 0.0) * gain;
                assert!((found - expected).norm() < bound, "{bits}, {frequency}: {found} {expected}");
            }
        }
    }
}

#[test]
fn what_is_cut_off_is_told() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.wav");
    let recording = RecordingOptions::tones(0.02).with_reference(Some(Reference::Channel(0)));
    record(&path, (7, WavFormat::Int16, 0.2), &|channel, t| match channel {
        0 => (3.0 * tones(t, 0.02)) as f32,
        4 => 8.0 * heard(3, t, &|t| tones(t, 0.02)),
        _ => heard(usize::from(channel) - 1, t, &|t| tones(t, 0.02)),
    });
    let imported = import(&told(&[path], recording)).unwrap();
    assert_eq!(imported.warnings.len(), 1, "{:?}", imported.warnings);
    assert_names(&imported.warnings[0], &["a.wav", "reference, channel 0", "channel 4 (", "lower the gain"]);
    assert_names(imported.guesses.join(";"), &["settling = 0.01"]);
}

#[test]
fn recordings_that_cannot_be_what_they_are_said_to_be_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.wav");
    record(&path, (7, WavFormat::Int16, 0.2), &|channel, t| match channel {
        0 => (0.5 * tones(t, 0.02)) as f32,
        _ => heard(usize::from(channel) - 1, t, &|t| tones(t, 0.02)),
    });
    let with = |change: &dyn Fn(&mut ImportOptions)| {
        let recording = RecordingOptions::tones(0.02).with_reference(Some(Reference::Channel(0)));
        let mut options = told(std::slice::from_ref(&path), recording);
        change(&mut options);
        options
    };
    assert!(import(&with(&|_| {})).is_ok());
    refused(&with(&|o| o.recording.dwell = None), &["[recording] dwell", "in s"]);
    refused(&with(&|o| o.recording.dwell = Some(0.03)), &["a.wav", "0.200 s", "9 tones", "0.270 s"]);
    refused(
        &with(&|o| o.recording.dwell = Some(0.015)),
        &["a.wav", "no tone of 10750 Hz", "recording.start"],
    );
    refused(&with(&|o| o.recording.settling = Some(0.019_9)), &["settling", "4 samples"]);
    refused(&with(&|o| o.recording.dwell = Some(1e300)), &["dwell", "no file"]);
    refused(
        &with(&|o| o.recording.reference = Some(Reference::Channel(7))),
        &["reference", "channel 7", "has 7"],
    );
    refused(
        &with(&|o| o.recording.reference = None),
        &["6 microphones", "7 channels", "recording.reference"],
    );
    refused(&with(&|o| o.recording.microphones = vec![1, 2, 3]), &["3 channels", "recording.microphones"]);
    refused(&with(&|o| o.recording.microphones = vec![0, 1, 2, 3, 4, 5]), &["channel 0", "reference"]);
    refused(&with(&|o| o.recording.latency = Latency::Seconds(0.1)), &["a.wav", "0.200 s", "0.280 s"]);
    refused(&with(&|o| o.sweep = Some(Sweep::stepped(10e3, 24e3, 250.0).unwrap())), &["44100", "22050 Hz"]);
    refused(&with(&|o| o.memory = Some(10_000)), &["a.wav", "--memory"]);
    let chirped = |o: &mut ImportOptions| o.recording = RecordingOptions::broadband(Reference::Channel(0));
    refused(
        &with(&|o| (chirped(o), o.memory = Some(1_000_000)).1),
        &["a.wav", "--memory", "shorter recordings"],
    );
    let direct = |o: &mut ImportOptions| o.recording.latency = Latency::Found(DirectWord::Direct);
    refused(
        &with(&|o| (direct(o), o.sweep = Some(Sweep::stepped(10e3, 11e3, 500.0).unwrap())).1),
        &["no tone of"],
    );
}

#[test]
fn a_recorder_refuses_what_it_cannot_write() {
    let instrument = instrument();
    let tones = RecordingOptions::tones(0.05);
    let recorder = RecorderOptions::default();
    let refused = |recording: &RecordingOptions, recorder: &RecorderOptions, parts: &[&str]| {
        let error = RecordingSize::of(&instrument, recording, recorder).unwrap_err();
        assert_eq!(error.exit_status(), 2);
        assert_names(error.to_string(), parts);
    };
    let size = RecordingSize::of(&instrument, &tones, &recorder).unwrap();
    assert_eq!((size.channels, size.frames, size.bytes), (6, 21_600, 388_800));
    let slow = recorder.clone().with_sample_rate(24_000_u32);
    refused(&tones, &slow, &["sample_rate", "24000", "12000 Hz"]);
    refused(&RecordingOptions::default(), &recorder, &["dwell", "in s"]);
    refused(&RecordingOptions::tones(1e6), &recorder, &["4.0 GiB"]);
    refused(&tones.clone().with_settling(Some(0.06)), &recorder, &["settling"]);
    refused(&RecordingOptions::broadband(Reference::Channel(0)), &recorder, &["broadband", "tones"]);
    refused(&tones.clone().with_reference(Some(Reference::File("a.wav".into()))), &recorder, &["channel"]);
    refused(&tones.clone().with_reference(Some(Reference::Channel(9999))), &recorder, &["9999"]);
    refused(
        &tones.clone().with_reference(Some(Reference::Channel(usize::MAX))),
        &recorder,
        &["6 microphones"],
    );
    refused(&tones.clone().with_microphones(vec![0, 1]), &recorder, &["2 channels", "6 microphones"]);
    refused(&tones.with_latency(Latency::Found(DirectWord::Direct)), &recorder, &["direct", "in s"]);
}
