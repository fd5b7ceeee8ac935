//! Blocks of a cube file are the whole cube, and damage is noticed at its block.
#![allow(clippy::unwrap_used)]

use super::*;
use crate::named::assert_names;
use crate::wave::Geometry;

/// 10 frequencies at 6 microphones.
fn cube() -> DataCube {
    let sweep = Sweep::stepped(10_000.0, 10_900.0, 100.0).unwrap();
    let array = MicArray::rectangular([3, 2], [0.02; 2], DVec3::ZERO).unwrap();
    let samples = (0..60).map(|i| crate::wave::phasor(f64::from(i) * 0.377)).collect();
    DataCube::new(Instrument::new(sweep, array), samples).unwrap()
}

#[test]
fn blocks_are_the_whole_cube_in_order() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("cube.npz");
    let cube = cube();
    cube.write(&path).unwrap();
    let collect = |source: &mut dyn CubeSource, block| {
        let mut all = Vec::new();
        source
            .visit(block, &mut |range, samples| {
                assert_eq!(range.start * 6, all.len());
                assert_eq!(range.len() * 6, samples.len());
                all.extend_from_slice(samples);
                Ok(())
            })
            .unwrap();
        all
    };
    for block in [1, 3, 10, 1000] {
        // A limit far below the cube's size: only one block is in memory.
        let mut file = CubeFile::open(&path, 6 * 8 * 10).unwrap();
        assert_eq!(file.held_bytes(), 0);
        assert_eq!(collect(&mut file, block.min(5)), cube.samples);
        assert_eq!(collect(&mut &cube, block), cube.samples);
    }
    assert!(CubeFile::open(&path, 300).unwrap().load().is_err(), "the whole cube exceeds the limit");
    // As numbers and as points, the positions take 288 bytes.
    let refused = CubeFile::open(&path, 287).unwrap_err();
    assert_eq!(refused.exit_status(), 2);
    assert_names(refused.to_string(), &["cube.npz", "`mic_positions`", "--memory"]);
}

#[test]
fn a_damaged_file_is_noticed_at_its_block() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("cube.npz");
    let mut cube = cube();
    cube.samples[31] = Complex32::new(f32::NAN, 0.0);
    cube.write(&path).unwrap();
    let mut seen = 0;
    let error = CubeFile::open(&path, 1 << 20)
        .unwrap()
        .visit(2, &mut |range, _| {
            seen = range.end;
            Ok(())
        })
        .unwrap_err()
        .to_string();
    assert_eq!(seen, 4);
    assert!(error.contains("frequency 5") && error.contains("microphone 1"), "{error}");
}

#[test]
fn several_sources_are_read_as_they_were_written() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("several.npz");
    let sources = [DVec3::new(0.1, 0.0, 0.0), DVec3::new(-0.1, 0.2, 0.03)];
    let instrument = cube().instrument.with_sources(&sources).unwrap();
    let samples: Vec<_> = (0..120).map(|i| crate::wave::phasor(f64::from(i) * 0.377)).collect();
    let written = DataCube::new(instrument.clone(), samples).unwrap();
    written.write(&path).unwrap();
    assert_eq!(DataCube::read(&path, 1 << 20).unwrap(), written);
    let mut file = CubeFile::open(&path, 1 << 20).unwrap();
    assert!(file.held_bytes() >= instrument.cube_bytes());
    for tx in [1, 0] {
        let mut seen = Vec::new();
        let mut take = |_: std::ops::Range<usize>, samples: &[Complex32]| {
            seen.extend_from_slice(samples);
            Ok(())
        };
        file.visit_transmission(tx, 4, &mut take).unwrap();
        assert_eq!(seen, written.transmission(tx));
    }
    // What is not finite is named with its loudspeaker.
    let mut damaged = written.clone();
    damaged.samples[60 + 4 * 6 + 2] = Complex32::new(f32::NAN, 0.0);
    let holed = folder.path().join("holed.npz");
    damaged.write(&holed).unwrap();
    let refused = DataCube::read(&holed, 1 << 20).unwrap_err().to_string();
    assert_names(refused, &["loudspeaker 1", "frequency 4", "microphone 2"]);
    let refused = CubeFile::open(&holed, 1 << 20).unwrap().visit_transmission(0, 4, &mut |_, _| Ok(()));
    assert_names(refused.unwrap_err().to_string(), &["loudspeaker 1", "frequency 4"]);
}

#[test]
fn a_pair_is_read_as_it_was_written() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("pair.npz");
    let pair = Geometry::Pair { offset: DVec3::new(0.05, 0.0, -0.01) };
    let mut written = cube();
    written.instrument.geometry = pair;
    written.write(&path).unwrap();
    let read = DataCube::read(&path, 1 << 20).unwrap();
    let Geometry::Pair { offset } = read.instrument.geometry else { panic!("a pair") };
    assert!(offset.distance(DVec3::new(0.05, 0.0, -0.01)) < 1e-12);
    assert_eq!(read.samples, written.samples);
}

#[test]
fn pairs_that_differ_are_read_as_they_were_written() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("pairs.npz");
    let sources: Vec<DVec3> = (0..6).map(|i| DVec3::new(0.1 * f64::from(i), 0.02, -0.03)).collect();
    let mut written = cube();
    written.instrument = written.instrument.with_pairs(&sources).unwrap();
    assert!(written.instrument.has_differing_pairs());
    written.write(&path).unwrap();
    let read = DataCube::read(&path, 1 << 20).unwrap();
    for (a, b) in read.instrument.pair_sources.iter().zip(&sources) {
        assert!(a.distance(*b) < 1e-12);
    }
    assert_eq!(read.instrument.array, written.instrument.array);
    assert_eq!(read.samples, written.samples);
}

/// An open file of a few arrays.
fn opened(meta: &str, sources: &[(&str, &[usize], &[f64])]) -> Result<CubeFile> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("cube.npz");
    let cube = cube();
    let positions: Vec<f64> = cube.instrument.array.positions().iter().flat_map(DVec3::to_array).collect();
    crate::files::npz::write_npz(&path, |npz| {
        npz.complex("samples", &[10, 2, 3], &cube.samples)?;
        npz.f64("frequencies", &[10], cube.instrument.sweep.frequencies())?;
        npz.f64("mic_positions", &[2, 3, 3], &positions)?;
        for (name, shape, values) in sources {
            npz.f64(name, shape, values)?;
        }
        npz.text("meta", meta)
    })
    .unwrap();
    CubeFile::open(&path, 1 << 20)
}

#[test]
fn loudspeakers_that_do_not_fit_are_refused_with_the_array() {
    let refused = |meta: &str, sources: &[(&str, &[usize], &[f64])], names: &[&str]| {
        let refused = opened(meta, sources).unwrap_err();
        assert_eq!(refused.exit_status(), 2);
        assert_names(refused.to_string(), names);
    };
    let two: (&str, &[usize], &[f64]) = ("sources", &[2, 3], &[0.0; 6]);
    refused("{}", &[two], &["`samples`", "[10, 2, 3]", "`sources`", "[2, 10, 2, 3]"]);
    refused("{}", &[("sources", &[6], &[0.0; 6])], &["`sources`", "[n_tx, 3]", "[6]"]);
    refused("{}", &[("sources", &[0, 3], &[])], &["`sources`", "[0, 3]"]);
    refused("{}", &[("sources", &[2, 3], &[f64::NAN; 6])], &["`sources`", "1e9 m"]);
    refused(r#"{"source": [0, 0, 0]}"#, &[two], &["`sources`", "`source`"]);
    refused(r#"{"geometry": "monostatic"}"#, &[two], &["`sources`", "monostatic", "fixed-source"]);
    refused(r#"{"geometry": "pair"}"#, &[], &["`source_positions`", "missing"]);
    let same: (&str, &[usize], &[f64]) = ("source_positions", &[2, 3, 3], &[0.0; 18]);
    let nowhere: (&str, &[usize], &[f64]) = ("source_positions", &[2, 3, 3], &[f64::NAN; 18]);
    refused(r#"{"geometry": "pair"}"#, &[nowhere], &["`source_positions`", "pair 0", "1e9 m"]);
    refused("{}", &[same], &["`source_positions`", "pair", "fixed-source"]);
    refused(
        r#"{"geometry": "pair"}"#,
        &[("source_positions", &[6, 3], &[0.0; 18])],
        &["`source_positions`", "[2, 3, 3]", "[6, 3]"],
    );
    // One loudspeaker in the array is as good as in `meta`, with an axis of its own.
    refused("{}", &[("sources", &[1, 3], &[0.0; 3])], &["`samples`", "[1, 10, 2, 3]"]);
}
