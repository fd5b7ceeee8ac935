#![allow(clippy::unwrap_used)]

use super::*;
use crate::named::assert_names;

const LIMIT: u64 = 1 << 20;

fn data(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/npz").join(name)
}

/// What the files in `tests/data/npz` hold: 0 to 23 in `[2, 3, 4]`, and half more in the imaginary part.
fn ramp() -> Vec<Complex32> {
    (0..24_u8).map(|n| Complex32::new(f32::from(n), f32::from(n) + 0.5)).collect()
}

#[test]
fn what_is_written_is_read_again() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.npz");
    let write = || {
        write_npz(&path, |npz| {
            npz.complex("samples", &[2, 3, 4], &ramp())?;
            npz.f64("x", &[3], &[0.1, f64::MIN_POSITIVE, f64::NEG_INFINITY])?;
            npz.f32("scalar", &[], &[f32::MAX])?;
            npz.f32("nothing", &[0, 2], &[])?;
            npz.text("meta", "λ = 17 mm")
        })
        .unwrap();
        std::fs::read(&path).unwrap()
    };
    assert!(write() == write(), "files of the same arrays must be bit-identical");
    let mut npz = NpzReader::open(&path, LIMIT).unwrap();
    assert_eq!(npz.names().collect::<Vec<_>>(), ["samples", "x", "scalar", "nothing", "meta"]);
    assert_eq!(npz.complex("samples").unwrap(), Array { shape: vec![2, 3, 4], data: ramp() });
    assert_eq!(npz.f64("x").unwrap().data, [0.1, f64::MIN_POSITIVE, f64::NEG_INFINITY]);
    assert_eq!(npz.f64("scalar").unwrap(), Array { shape: vec![], data: vec![f64::from(f32::MAX)] });
    assert_eq!(npz.f64("nothing").unwrap().shape, [0, 2]);
    assert_eq!(npz.text("meta").unwrap(), "λ = 17 mm");
    assert!(npz.dtype_is_complex("samples").unwrap() && !npz.dtype_is_complex("x").unwrap());
}

#[test]
fn numpys_own_files_are_read() {
    let mut npz = NpzReader::open(&data("plain.npz"), LIMIT).unwrap();
    assert_eq!(npz.complex("samples").unwrap(), Array { shape: vec![2, 3, 4], data: ramp() });
    let real = npz.complex("real").unwrap();
    assert!(real.data.iter().zip(ramp()).all(|(a, b)| a.re == b.re && a.im == 0.0));
    assert_eq!(npz.f64("scalar").unwrap(), Array { shape: vec![], data: vec![3.5] });
    assert_eq!(npz.f64("ints").unwrap().data, [-3.0, -2.0, -1.0, 0.0, 1.0, 2.0, 3.0]);
    assert_eq!(npz.text("meta").unwrap(), r#"{"version": 1}"#);
    assert_eq!(npz.text("bytes").unwrap(), "abc");
    assert_eq!(npz.f64("empty").unwrap().shape, [0, 3]);
}

#[test]
fn big_endian_fortran_order_and_deflate_change_nothing() {
    let mut npz = NpzReader::open(&data("big_fortran_deflated.npz"), LIMIT).unwrap();
    assert_eq!(npz.complex("samples").unwrap(), Array { shape: vec![2, 3, 4], data: ramp() });
    let ramp: Vec<f64> = ramp().iter().map(|c| c.re.into()).collect();
    for name in ["real", "counts", "wide"] {
        assert_eq!(npz.f64(name).unwrap().data, ramp, "{name}");
    }
    assert_eq!(npz.text("note").unwrap(), "grün");
    let mut npz = NpzReader::open(&data("versions.npz"), LIMIT).unwrap();
    for (name, version) in [("v1", 1.0), ("v2", 2.0), ("v3", 3.0)] {
        assert_eq!(npz.f64(name).unwrap().data, [1.0, 2.0, version]);
    }
}

#[test]
fn an_error_names_the_array_and_what_was_expected() {
    let mut npz = NpzReader::open(&data("plain.npz"), LIMIT).unwrap();
    for (error, words) in [
        (npz.f64("samples").unwrap_err(), &["array `samples`", "real"][..]),
        (npz.f64("speed").unwrap_err(), &["array `speed`", "`samples`", "`real`"]),
        (npz.f64("objects").unwrap_err(), &["array `objects`", "Python objects"]),
        (npz.text("real").unwrap_err(), &["array `real`", "text"]),
        (npz.f64("bytes").unwrap_err(), &["array `bytes`", "numbers"]),
    ] {
        let text = error.to_string();
        assert_names(&text, &["plain.npz"]);
        assert_names(&text, words);
        assert_eq!(error.exit_status(), 2);
    }
    let error = NpzReader::open(&data("plain.npz"), 191).unwrap().f64("real").unwrap_err();
    assert_names(error.to_string(), &["plain.npz", "array `real`", "192 bytes", "191"]);
    assert_eq!(NpzReader::open(&data("missing.npz"), LIMIT).unwrap_err().exit_status(), 2);
}

/// Opens a damaged file, reads everything in it without a panic, and returns the number of arrays that were readable.
fn exercise(path: &Path) -> usize {
    let Ok(mut npz) = NpzReader::open(path, LIMIT) else { return 0 };
    let names: Vec<String> = npz.names().map(str::to_owned).collect();
    names
        .iter()
        .filter(|name| {
            let text = npz.text(name).is_ok();
            npz.complex(name).is_ok() || npz.f64(name).is_ok() || text
        })
        .count()
}

#[test]
fn damage_is_an_error_and_never_a_panic() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("damaged.npz");
    for name in ["versions.npz", "big_fortran_deflated.npz"] {
        let whole = std::fs::read(data(name)).unwrap();
        for end in 0..whole.len() {
            std::fs::write(&path, &whole[..end]).unwrap();
            assert_eq!(exercise(&path), 0, "{name} cut at {end}");
        }
        for at in 0..whole.len() {
            let mut damaged = whole.clone();
            damaged[at] ^= 0x55;
            std::fs::write(&path, &damaged).unwrap();
            exercise(&path);
        }
    }
}

#[test]
fn a_shape_the_bytes_do_not_fill_is_refused_before_anything_is_allocated() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.npz");
    write_npz(&path, |npz| npz.f32("a", &[10], &[0.0; 10])).unwrap();
    let bytes = std::fs::read(&path).unwrap();
    let at = bytes.windows(5).position(|five| five == b"(10,)").unwrap();
    let mut lying = bytes.clone();
    lying[at..at + 5].copy_from_slice(b"(99,)");
    std::fs::write(&path, &lying).unwrap();
    let error = NpzReader::open(&path, u64::MAX).unwrap().f64("a").unwrap_err();
    assert_names(error.to_string(), &["a.npz", "array `a`", "[99]", "4-byte"]);
}
