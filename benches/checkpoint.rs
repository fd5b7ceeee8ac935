//! The cost of checkpoints: `simulate` and `reconstruct` of a large job without and with them, alternating:
//! `cargo bench --bench checkpoint [-- ROUNDS]`.
//!
//! Every round runs the job once without checkpoints, once at the default interval, once every second and once after
//! every block; blocks are stored next to the output, on the disk of the `target` folder. Ratios are relative to the run
//! without checkpoints: the median over the rounds, and the ratio of the minimum times. Writing the cube's own file is not
//! included: its time depends only on the disk, and varies more than the cost of checkpoints.

#![allow(missing_docs, clippy::print_stdout)]

mod job;

use holosonar::acquisition::CubeFile;
use holosonar::checkpoint::Checkpoint;
use holosonar::config::RunFile;
use holosonar::pipeline::{JobOptions, reconstruct_cube, simulate_scene, write_cube};
use std::path::Path;
use std::time::{Duration, Instant};

/// Default number of rounds.
const ROUNDS: usize = 5;

/// Seconds of a simulation and of a reconstruction; finished blocks are stored at the interval `every`, if any.
fn run(run: &RunFile, folder: &Path, every: Option<Duration>) -> [f64; 2] {
    let (cube, volume) = (folder.join("cube.npz"), folder.join("volume.npz"));
    let checkpoint =
        |output: &Path| every.map_or_else(Checkpoint::off, |every| Checkpoint::beside(output, every));
    let begun = Instant::now();
    let blocks = checkpoint(&cube);
    let samples = simulate_scene(run, &JobOptions::default().with_checkpoint(&blocks)).expect("simulated");
    let mut simulated = begun.elapsed();
    write_cube(&cube, &samples).expect("written");
    let written = Instant::now();
    blocks.remove();
    simulated += written.elapsed();
    drop(samples);
    let begun = Instant::now();
    let blocks = checkpoint(&volume);
    let file = CubeFile::open(&cube, u64::MAX).expect("a cube");
    let options = JobOptions::default().with_checkpoint(&blocks);
    reconstruct_cube(run, file, &[volume], &options).expect("reconstructed");
    blocks.remove();
    [simulated, begun.elapsed()].map(|time| time.as_secs_f64())
}

fn median(seconds: &mut [f64]) -> f64 {
    seconds.sort_by(f64::total_cmp);
    f64::midpoint(seconds[(seconds.len() - 1) / 2], seconds[seconds.len() / 2])
}

fn main() {
    let rounds = std::env::args().skip(1).find_map(|word| word.parse().ok()).unwrap_or(ROUNDS).max(1);
    let folder = tempfile::tempdir_in(env!("CARGO_TARGET_TMPDIR")).expect("a folder");
    let large = job::large(folder.path());
    let intervals = [
        ("without", None),
        ("every 5 s, the default", Some(Duration::from_secs(5))),
        ("every second", Some(Duration::from_secs(1))),
        ("after every block", Some(Duration::ZERO)),
    ];
    let mut seconds = [const { [const { Vec::new() }; 3] }; 4];
    for round in 0..rounds {
        for (i, (name, every)) in intervals.iter().enumerate() {
            let [simulated, reconstructed] = run(&large, folder.path(), *every);
            println!("round {round}, {name}: simulate {simulated:.2} s, reconstruct {reconstructed:.2} s");
            for (all, some) in
                seconds[i].iter_mut().zip([simulated, reconstructed, simulated + reconstructed])
            {
                all.push(some);
            }
        }
    }
    println!("{rounds} rounds, {} threads", rayon::current_num_threads());
    for (step, name) in ["simulate", "reconstruct", "both"].into_iter().enumerate() {
        let minimum = |seconds: &[f64]| seconds.iter().copied().fold(f64::INFINITY, f64::min);
        let without = &seconds[0][step];
        let fastest = minimum(without);
        println!("{name}: without {:.2} s, minimum {fastest:.2} s", median(&mut without.clone()));
        for ((interval, _), seconds) in intervals.iter().zip(&seconds).skip(1) {
            let with = &seconds[step];
            let mut ratios: Vec<f64> =
                with.iter().zip(without).map(|(with, without)| with / without).collect();
            println!(
                "  {interval}: {:.2} s, ratio {:.3}; minimum {:.2} s, ratio {:.3}",
                median(&mut with.clone()),
                median(&mut ratios),
                minimum(with),
                minimum(with) / fastest
            );
        }
    }
}
