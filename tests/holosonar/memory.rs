//! What `plan` says of memory, beside what the program takes of it.

#![cfg(target_os = "linux")]

use crate::binary::{command, done, shipped};
use serde_json::Value;
use std::fs;
use std::path::Path;
use std::process::Stdio;
use std::time::Duration;

/// The most bytes that a run of the program ever had in memory: its resident set, with so much of its own code and
/// libraries as it touched.
fn measured(folder: &Path, words: &str) -> u64 {
    let mut command = command(folder, words.split_whitespace());
    let mut child = command.stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
    let status = format!("/proc/{}/status", child.id());
    let mut most = 0;
    loop {
        // Once it has ended there is nothing to be read any more; the mark only ever rises.
        let text = fs::read_to_string(&status).unwrap_or_default();
        if let Some(line) = text.lines().find_map(|line| line.strip_prefix("VmHWM:")) {
            most = line.trim().strip_suffix("kB").unwrap().trim().parse::<u64>().unwrap() << 10;
        }
        if let Some(status) = child.try_wait().unwrap() {
            assert!(status.success(), "{words}");
            return most;
        }
        std::thread::sleep(Duration::from_millis(1));
    }
}

/// A run file: microphones, half the width of a grid that is as wide as high at least, and its voxels.
fn write_scene(folder: &Path, name: &str, array: &str, half: [f64; 2], voxels: [usize; 3]) {
    fs::copy(shipped("meshes/corner.obj"), folder.join("corner.obj")).unwrap();
    let [x, y] = half;
    let text = format!(
        "[scene]\nmesh = \"corner.obj\"\nunit = \"m\"\n[sweep]\nstart = 10000.0\nstop = 20000.0\nstep = 10.0\n\
         [array]\n{array}\n\
         [grid]\nx = [-{x}, {x}]\ny = [-{y}, {y}]\nz = [1.0, 2.0]\ncount = {voxels:?}\n\
         [reconstruct]\ntolerance = 1e-4\n"
    );
    fs::write(folder.join(name), text).unwrap();
}

#[test]
#[ignore = "half a minute and 600 MiB"]
fn the_memory_that_is_planned_is_what_is_taken() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let scenes = [
        ("small", "count = [64, 64]\npitch = [0.008, 0.008]", [0.508, 0.508], [128, 128, 128]),
        (
            "scattered",
            "layout = \"spiral\"\nelements = 1500\nextent = [1.0, 1.0]",
            [0.6, 0.5],
            [192, 160, 200],
        ),
        ("large", "count = [255, 255]\npitch = [0.00394, 0.00394]", [0.50235, 0.50235], [256, 256, 128]),
    ];
    for (name, array, half, voxels) in scenes {
        write_scene(folder, &format!("{name}.toml"), array, half, voxels);
        // A number of threads that does not depend on the machine.
        let planned = done(folder, &format!("plan {name}.toml --json -q -j 2"));
        let planned: Value = serde_json::from_str(&planned).unwrap();
        for (job, words) in [
            ("simulate", format!("simulate {name}.toml -o cube.npz -q -j 2")),
            ("reconstruct", format!("reconstruct cube.npz -c {name}.toml -o volume.npz -q -j 2")),
            ("image", format!("image {name}.toml -o made -q -j 2")),
        ] {
            if (name, job) == ("large", "image") {
                continue;
            }
            let bytes = planned["peaks"][job].as_u64().unwrap();
            let measured = measured(folder, &words);
            let ratio = bytes as f64 / measured as f64;
            println!("{name}, {job}: {} MiB planned, {} measured, {ratio:.2}", bytes >> 20, measured >> 20);
            assert!((0.85..=1.15).contains(&ratio), "{name}, {job}: {bytes} planned, {measured} measured");
        }
    }
}
