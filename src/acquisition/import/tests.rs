#![allow(clippy::unwrap_used)]

use super::*;
use crate::named::assert_names;
use std::fmt::Write;
use std::fs;
use std::path::PathBuf;

/// 5 frequencies at 4 × 3 microphones.
fn cube() -> DataCube {
    let sweep = Sweep::stepped(10e3, 10.4e3, 100.0).unwrap();
    let array = MicArray::rectangular([4, 3], [0.02, 0.03], DVec3::ZERO).unwrap();
    let samples =
        (0..60).map(|i| crate::wave::phasor(f64::from(i) * 0.377) * (1.0 + i as f32 / 60.0)).collect();
    DataCube::new(Instrument::new(sweep, array), samples).unwrap()
}

/// Options that know the measurement of [`cube`].
fn told(samples: &[PathBuf]) -> ImportOptions {
    let cube = cube();
    let mut options = ImportOptions::new(samples.to_vec());
    (options.sweep, options.array) = (Some(cube.instrument.sweep), Some(cube.instrument.array));
    options
}

fn npy(kind: &str, shape: &[usize], fortran: bool, data: &[u8]) -> Vec<u8> {
    let sizes = shape.iter().map(|n| format!("{n}, ")).collect::<Vec<_>>().concat();
    let order = if fortran { "True" } else { "False" };
    let text = format!("{{'descr': '{kind}', 'fortran_order': {order}, 'shape': ({sizes}), }}\n");
    [b"\x93NUMPY\x01\x00".as_slice(), &(text.len() as u16).to_le_bytes(), text.as_bytes(), data].concat()
}

/// The samples of a cube with axes in another order: for each place of an array of this shape, `[f, y, x]` of `of`.
fn arranged<T>(
    shape: [usize; 3],
    of: fn([usize; 3]) -> [usize; 3],
    mut put: impl FnMut(Complex32) -> T,
) -> Vec<T> {
    let cube = cube();
    let mut all = Vec::new();
    for a in 0..shape[0] {
        for b in 0..shape[1] {
            for c in 0..shape[2] {
                let [f, y, x] = of([a, b, c]);
                all.push(put(cube.samples[(f * 3 + y) * 4 + x]));
            }
        }
    }
    all
}

fn place(folder: &tempfile::TempDir, name: &str, bytes: &[u8]) -> PathBuf {
    let path = folder.path().join(name);
    fs::write(&path, bytes).unwrap();
    path
}

fn refused(options: &ImportOptions, parts: &[&str]) {
    let error = import(options).unwrap_err();
    assert_eq!(error.exit_status(), 2);
    assert_names(error.to_string(), parts);
}

#[test]
fn arrays_of_any_order_and_type_give_the_same_cube() {
    let folder = tempfile::tempdir().unwrap();
    let f64s = |m: Complex32, big: bool| {
        [m.re, m.im]
            .map(|v| if big { f64::from(v).to_be_bytes() } else { f64::from(v).to_le_bytes() })
            .concat()
    };
    // [x, y, f], complex, big-endian: the lengths leave one order.
    let xyf = arranged([4, 3, 5], |[x, y, f]| [f, y, x], |m| f64s(m, true)).concat();
    let path = place(&folder, "xyf.npy", &npy(">c16", &[4, 3, 5], false, &xyf));
    let imported = import(&told(&[path])).unwrap();
    assert_eq!(imported.cube.samples, cube().samples);
    assert_eq!(imported.cube.instrument, cube().instrument);
    assert_eq!(imported.cube.provenance["import"]["axes"], json!(["x", "y", "f"]));
    assert_names(imported.guesses.join("; "), &["axes", "phase_sign = 1", "343", "speaker"]);
    // [y, x, f, iq], of which the two parts are one axis of one array.
    let yxf = arranged([3, 4, 5], |[y, x, f]| [f, y, x], |m| f64s(m, false)).concat();
    let path = place(&folder, "iq.npy", &npy("<f8", &[3, 4, 5, 2], false, &yxf));
    assert_eq!(import(&told(&[path])).unwrap().cube.samples, cube().samples);
    // Fortran's [x, y, f] is memory as [f, y, x].
    let fyx = arranged([5, 3, 4], |fyx| fyx, |m| f64s(m, false)).concat();
    let path = place(&folder, "fortran.npy", &npy("<c16", &[4, 3, 5], true, &fyx));
    assert_eq!(import(&told(&[path])).unwrap().cube.samples, cube().samples);
    // [f, mic], the sign of an FFT.
    let path = place(&folder, "mic.npy", &npy("<c16", &[5, 12], false, &fyx));
    let mut options = told(&[path]);
    options.phase_sign = Some(-1);
    assert!(import(&options).unwrap().cube.samples.iter().zip(cube().samples).all(|(a, b)| *a == b.conj()));
}

#[test]
fn raw_numbers_lose_their_offset() {
    let folder = tempfile::tempdir().unwrap();
    let plane = |part: fn(Complex32) -> f32, zero: f32| {
        let raw = |m| ((part(m) * 500.0 + zero).round() as u16).to_le_bytes();
        npy("<u2", &[4, 3, 5], false, &arranged([4, 3, 5], |[x, y, f]| [f, y, x], raw).concat())
    };
    let both = [plane(|m| m.re, 2048.0), plane(|m| m.im, 2000.0)].concat();
    let path = place(&folder, "adc.npy", &both);
    let mut options = told(std::slice::from_ref(&path));
    refused(&options, &["adc.npy", "unsigned", "offset", "2048", "mean"]);
    options.offset = Some(RawOffset::Planes([2048.0, 2000.0]));
    let imported = import(&options).unwrap();
    for (found, expected) in imported.cube.samples.iter().zip(cube().samples) {
        assert!((found / 500.0 - expected).norm() < 2e-3, "{found} {expected}");
    }
    assert_names(imported.guesses.join("; "), &["array 0 is I", "array 1 is Q"]);
    options.offset = Some(RawOffset::Mean(MeanWord::Mean));
    let mean = import(&options).unwrap().cube;
    assert!(mean.samples.iter().sum::<Complex32>().norm() < 1e-2);
    // One plane alone is in phase.
    options.arrays = vec![ArrayName::Number(1)];
    options.offset = Some(RawOffset::Both(2000.0));
    let real = import(&options).unwrap().cube;
    assert_eq!(real.instrument.detection, Detection::InPhase);
    assert!(real.samples.iter().all(|m| m.im == 0.0));
}

#[test]
fn what_nobody_said_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let zeros = |shape: &[usize]| npy("<c8", shape, false, &vec![0; 8 * shape.iter().product::<usize>()]);
    let path = place(&folder, "a.npy", &zeros(&[5, 3, 4]));
    let mut options = told(&[path]);
    options.sweep = None;
    refused(&options, &["[sweep]", "start, stop and step"]);
    let mut options = told(&options.samples);
    options.array = None;
    refused(&options, &["[array]", "pitch", "positions"]);
    let mut options = told(&options.samples);
    options.axes = vec![ImportAxis::X, ImportAxis::Y, ImportAxis::Frequency];
    refused(&options, &["a.npy", "[5, 3, 4]", "\"f\"", "5"]);
    options.axes = vec![ImportAxis::Frequency, ImportAxis::X, ImportAxis::Y];
    refused(&options, &["3 x 4", "4 x 3"]);
    let path = place(&folder, "b.npy", &zeros(&[5, 5, 5]));
    let mut options = told(&[path]);
    refused(&options, &["[5, 5, 5]", "4 x 3 microphones", "axes ="]);
    options.array = Some(MicArray::rectangular([5, 5], [0.02; 2], DVec3::ZERO).unwrap());
    refused(&options, &["6 ways", "axes = [\"f\", \"y\", \"x\"]"]);
    options.axes = vec![ImportAxis::Y, ImportAxis::X, ImportAxis::Frequency];
    assert!(import(&options).is_ok());
    refused(&ImportOptions::new(vec![folder.path().to_owned()]), &["folder", "{x}", "a.npy"]);
    refused(&ImportOptions::new(vec![folder.path().join("a.wav")]), &["[array]"]);
    refused(&ImportOptions::new(Vec::new()), &["samples"]);
}

/// A Touchstone file of two ports, whose S21 is this.
fn touchstone(options: &str, rows: impl Iterator<Item = (f64, [f64; 2])>) -> String {
    rows.fold(format!("! lab\n{options}\n"), |mut text, (f, [a, b])| {
        writeln!(text, "{f} 9 9 {a} {b} 8 8 7 7 ! row").unwrap();
        text
    })
}

#[test]
fn touchstone_files_of_each_format_and_csv_files_give_the_same_cube() {
    let cube = cube();
    let sweep = cube.instrument.sweep.frequencies();
    let trace = |mic: usize| (0..5).map(move |f| (f, mic));
    for (options, ending) in [
        ("# kHz S RI R 50", "s2p"),
        ("# kHz S MA R 50", "s2p"),
        ("# kHz S DB R 50", "s2p"),
        ("f,re,im", "csv"),
    ] {
        let folder = tempfile::tempdir().unwrap();
        for mic in 0..12 {
            let pair = |at: (usize, usize)| {
                // A path delays: the phase of a network analyser falls.
                let m = cube.samples[at.0 * 12 + at.1].conj();
                let (r, angle) = (f64::from(m.norm()), f64::from(m.arg()).to_degrees());
                match &options[6..] {
                    "S MA R 50" => [r, angle],
                    "S DB R 50" => [20.0 * r.log10(), angle],
                    _ => [m.re.into(), m.im.into()],
                }
            };
            let rows = trace(mic).map(|at| (sweep[at.0] / 1e3, pair(at)));
            let text = if ending == "csv" {
                rows.fold("f,re,im\n".to_owned(), |text, (f, [a, b])| text + &format!("{f},{a},{b}\n"))
            } else {
                touchstone(options, rows)
            };
            let name = format!("x{}_y{}.{ending}", (mic % 4) * 20, (mic / 4) as f64 * 30.0 - 10.0);
            place(&folder, &name, text.as_bytes());
        }
        place(&folder, "notes.txt", b"");
        let mut told = ImportOptions::new(vec![folder.path().join(format!("x{{x}}_y{{y}}.{ending}"))]);
        refused(&told, &["name_unit", "mm"]);
        told.name_unit = Some(crate::scene::Unit::Millimetre);
        told.centre = Some(DVec3::ZERO);
        told.frequency_unit = FrequencyUnit::Kilohertz;
        if ending == "csv" {
            told.phase_sign = Some(-1);
        }
        let imported = import(&told).unwrap();
        assert_eq!(imported.cube.provenance["import"]["phase_sign"], -1);
        let lattice = imported.cube.instrument.array.lattice().unwrap();
        assert_eq!((lattice.x.count, lattice.y.count), (4, 3));
        assert!((lattice.x.pitch - 0.02).abs() + (lattice.y.first + 0.03).abs() < 1e-12);
        for (found, expected) in imported.cube.samples.iter().zip(&cube.samples) {
            assert!((found - expected).norm() < 1e-6, "{options}: {found} {expected}");
        }
        // The last file is gone: the others are no lattice, but microphones.
        fs::remove_file(folder.path().join(format!("x60_y50.{ending}"))).unwrap();
        assert!(import(&told).unwrap().cube.instrument.array.lattice().is_none());
        place(&folder, &format!("x60_y50.{ending}"), b"f,re,im\n1,2,3\n");
        let fault = if ending == "csv" { "other frequencies" } else { "`f,re,im`" };
        refused(&told, &["x60_y50", fault]);
    }
}

#[test]
fn indices_in_names_are_those_of_the_array() {
    let folder = tempfile::tempdir().unwrap();
    for mic in 0..12 {
        let text = format!("{mic}\n").repeat(5);
        place(&folder, &format!("m_{}_{:02}.csv", mic / 4 + 1, mic % 4 + 1), text.as_bytes());
    }
    let mut options = told(&[folder.path().join("m_{iy}_{ix}.csv")]);
    options.columns = vec![TraceColumn::Real];
    let imported = import(&options).unwrap();
    assert!(imported.cube.samples.iter().enumerate().all(|(i, m)| m.re == (i % 12) as f32));
    assert_names(imported.guesses.join("; "), &["counted from 1"]);
    fs::remove_file(folder.path().join("m_1_02.csv")).unwrap();
    refused(&options, &["11 files", "12 microphones", "x 1, y 0"]);
    options.samples = vec![folder.path().join("n_{ix}_{iy}.csv")];
    refused(&options, &["fits no file", "m_1_01.csv"]);
}
