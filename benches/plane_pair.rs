//! The cost of one plane pair of Eq. 16 (kernel phases, kernel FFT, product, inverse FFT, sum) compared with FFTW 3, and
//! the gain from skeleton frequencies: `cargo bench --bench plane_pair`. All ratios are of times within one run.
//!
//! FFTW (single precision, MEASURE, one 2-D transform forward and one backward) is loaded at run time by `python3`, and
//! skipped if it is not installed; it is never linked, because its licence differs from ours.

#![allow(missing_docs, clippy::print_stdout)]

mod job;

use holosonar::acquisition::DataCube;
use holosonar::grid::Grid;
use holosonar::progress::{Event, Observer};
use holosonar::reconstruct::{Method, ReconstructOptions, Window, reconstruct_with};
use job::job;
use std::process::Command;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Instant;

/// Times one forward and one backward transform, s; the argument is n.
const FFTW: &str = r#"
import ctypes, sys, time
fftw, n = ctypes.CDLL("libfftw3f.so.3"), int(sys.argv[1])
fftw.fftwf_malloc.restype = fftw.fftwf_plan_dft_2d.restype = ctypes.c_void_p
a, b = (ctypes.c_void_p(fftw.fftwf_malloc(ctypes.c_size_t(8 * n * n))) for _ in range(2))
forward, backward = (ctypes.c_void_p(fftw.fftwf_plan_dft_2d(n, n, x, y, s, 0)) for x, y, s in ((a, b, -1), (b, a, 1)))
ctypes.memset(a, 0, 8 * n * n)
best = 1e9
for _ in range(20):
    start = time.perf_counter()
    for _ in range(20):
        fftw.fftwf_execute(forward)
        fftw.fftwf_execute(backward)
    best = min(best, (time.perf_counter() - start) / 20)
print(best)
"#;

fn fftw(n: usize) -> Option<f64> {
    let output = Command::new("python3").args(["-c", FFTW, &n.to_string()]).output().ok()?;
    String::from_utf8(output.stdout).ok()?.trim().parse().ok()
}

/// Counts plane pairs, the unit in which the convolution reports its progress.
#[derive(Default)]
struct Pairs(AtomicU64);

impl Observer for Pairs {
    fn event(&self, event: Event<'_>) {
        if let Event::Advanced { amount } = event {
            self.0.fetch_add(amount, Ordering::Relaxed);
        }
    }
}

/// Seconds and plane pairs of the fastest of several reconstructions.
fn timed((cube, grid): &(DataCube, Grid), tolerance: f64, threads: usize, times: usize) -> (f64, u64) {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
    let mut options = ReconstructOptions::new(Method::Convolution, Window::None);
    options.tolerance = tolerance;
    let once = || {
        let (pairs, start) = (Pairs::default(), Instant::now());
        pool.install(|| reconstruct_with(cube, grid, &options, &pairs)).expect("a lattice that fits");
        (start.elapsed().as_secs_f64(), pairs.0.into_inner())
    };
    (0..times).map(|_| once()).min_by(|a, b| a.0.total_cmp(&b.0)).expect("at least once")
}

fn main() {
    // The spectra of the data are shared by the depths: a thirtieth of a pair.
    for (n, mics, voxels) in [(128, 64, 64), (192, 64, 128), (512, 256, 256)] {
        let job = job(mics, voxels, 9, 16);
        let before = fftw(n);
        let (seconds, pairs) = timed(&job, 0.0, 1, 20_000 / n);
        let pair = seconds / pairs as f64;
        let comparison = match (before, fftw(n)) {
            (Some(before), Some(after)) => {
                let fftw = before.min(after);
                format!("{:.2} x FFTW's {:.0} us", pair / fftw, fftw * 1e6)
            }
            _ => "FFTW was not found (python3 and libfftw3f.so.3)".to_owned(),
        };
        println!("pair, n = {n}: {:.0} us, {comparison}", pair * 1e6);
    }
    let job = job(64, 128, 1001, 128);
    for threads in [1, 2] {
        let (before, some) = timed(&job, 1e-4, threads, 3);
        let (plain, all) = timed(&job, 0.0, threads, 1);
        // Before and after the long run, because the machine may have other work.
        let fast = before.min(timed(&job, 1e-4, threads, 3).0);
        println!(
            "64x64 mics, 1001 f, 128^3 voxels, {threads} threads: {fast:.3} s for {some} pairs, plain Eq. 16 {plain:.2} s \
             for {all}: {:.1} x, and {:.2} x the time of as many plain pairs",
            plain / fast,
            fast / (plain / all as f64 * some as f64)
        );
    }
}
