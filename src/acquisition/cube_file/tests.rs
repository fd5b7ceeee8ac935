//! Blocks of a cube file are the whole cube, and damage is noticed at its block.
#![allow(clippy::unwrap_used)]

use super::*;
use crate::named::assert_names;

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
