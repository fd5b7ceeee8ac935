//! Instruction sets: the kernels give bit-identical results with each, and the libraries of other processors stay within
//! the bound of the README.

use crate::binary::{Outcome, command, run_command, shipped};
use crate::named::assert_names;
use crate::support::relative_difference;
use holosonar::acquisition::DataCube;
use holosonar::export::volume_npz::read_volume_npz;
use holosonar::wave::simd::Level;
use num_complex::Complex32;
use std::fs;
use std::path::Path;

/// Maximum difference between two kinds of processor, over the maximum amplitude.
const STATED: f64 = 2e-6;

/// Jobs by what is typed; each of them takes some tenths of a second.
const SIMULATE: &str = "simulate job.toml -o cube.npz -q";
const METHODS: [&str; 4] = ["convolution", "direct", "backprojection", "linear"];

/// A corner, 12 x 12 microphones off the lattice of 15 x 15 x 20 voxels.
fn workplace() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    fs::copy(shipped("meshes/corner.obj"), folder.path().join("corner.obj")).unwrap();
    let scene = "[scene]\nmesh = \"corner.obj\"\nunit = \"m\"\nup = \"none\"\n[sweep]\nstart = 6000.0\nstop = 10000.0\nstep = 50.0\n\
                 [array]\ncount = [12, 12]\nextent = [0.4, 0.5]\n[reflectors]\nspacing = 0.02\n\
                 [grid]\nx = [-0.35, 0.35]\ny = [-0.35, 0.35]\nz = [1.2, 2.0]\npitch = [0.05, 0.05, 0.04]\n";
    fs::write(folder.path().join("job.toml"), scene).unwrap();
    folder
}

/// Runs the program with something in its environment; it must succeed.
fn run(folder: &Path, words: &str, environment: (&str, &str)) -> Outcome {
    run_command(words, command(folder, words.split_whitespace()).env(environment.0, environment.1))
}

/// The bytes of a cube, and of its volume by every method; the volumes are of the existing cube, if there is one.
fn made(folder: &Path, environment: (&str, &str)) -> Vec<(&'static str, Vec<u8>, Vec<Complex32>)> {
    let done = |words: &str| {
        let ran = run(folder, words, environment);
        assert_eq!(ran.status, 0, "{words}: {}", ran.stderr);
    };
    let (cube, volume) = (folder.join("cube.npz"), folder.join("volume.npz"));
    // Reconstructed is always the first cube, so that differences do not add up.
    let first = fs::read(&cube).ok();
    done(SIMULATE);
    let samples = DataCube::read(&cube, u64::MAX).unwrap().samples;
    let mut all = vec![("cube", fs::read(&cube).unwrap(), samples)];
    if let Some(first) = first {
        fs::write(&cube, first).unwrap();
    }
    for method in METHODS {
        done(&format!("reconstruct cube.npz -c job.toml -q -o volume.npz --set reconstruct.method={method}"));
        let samples = read_volume_npz(&volume, u64::MAX).unwrap().0.samples;
        all.push((method, fs::read(&volume).unwrap(), samples));
    }
    all
}

#[test]
fn every_level_gives_the_same_bytes() {
    let folder = workplace();
    let expected = made(folder.path(), ("HOLOSONAR_SIMD", ""));
    let had = Level::ALL.iter().copied().filter(|level| *level <= Level::of_processor());
    // The processor's own level comes last: a second run at the default level.
    for level in had {
        let found = made(folder.path(), ("HOLOSONAR_SIMD", level.as_str()));
        for ((what, found, samples), (_, expected, those)) in found.iter().zip(&expected) {
            let by = relative_difference(samples, those);
            assert!(found == expected, "{what} at {}: differs by {by} of the peak", level.as_str());
        }
        println!("{}: same bytes", level.as_str());
    }
}

/// Without AVX2 and FMA, the C library takes other sines and exponentials.
#[test]
#[cfg(all(target_os = "linux", target_env = "gnu", target_arch = "x86_64"))]
fn the_sines_of_another_processor_change_little() {
    let folder = workplace();
    let expected = made(folder.path(), ("HOLOSONAR_SIMD", ""));
    let found =
        made(folder.path(), ("GLIBC_TUNABLES", "glibc.cpu.hwcaps=-AVX2,-FMA,-FMA4,-AVX512F,-AVX2_Usable"));
    for ((what, _, found), (_, _, expected)) in found.iter().zip(&expected) {
        let by = relative_difference(found, expected);
        println!("{what}: {by:.1e} of the peak");
        assert!(by <= STATED, "{what}: {by} of the peak");
    }
}

#[test]
fn the_level_is_reported_and_must_be_supported() {
    let folder = workplace();
    let ran = run(folder.path(), "info job.toml -v", ("HOLOSONAR_SIMD", "baseline"));
    assert_eq!(ran.status, 0, "{}", ran.stderr);
    assert_names(ran.stderr, &["baseline"]);
    for unknown in ["sse", "AVX2", "avx512 "] {
        let ran = run(folder.path(), "info job.toml", ("HOLOSONAR_SIMD", unknown));
        assert_eq!((ran.status, ran.stdout.as_str()), (2, ""), "{}", ran.stderr);
        assert!(ran.stderr.starts_with("error: "), "{}", ran.stderr);
        assert_names(ran.stderr, &["HOLOSONAR_SIMD", &format!("`{unknown}`"), "baseline"]);
    }
}
