//! `ascan`: the range profile of a microphone, as a table, and as pictures and CSV.

use crate::acquisition::{AScan, AScanOptions, ScannedMicrophone};
use crate::cli::Overrides;
use crate::cli::design::columns;
use crate::cli::inputs::{JobInput, has_extension, job_of};
use crate::cli::outputs::{announce, print_json};
use crate::cli::summary::{self, millimetres};
use crate::cli::terminal::{Terminal, observed, print};
use crate::error::{Error, Result};
use crate::export::figure::write_ascan_figure;
use crate::files::write_atomically;
use crate::pipeline;
use clap::Args;
use serde_json::{Map, Value, json};
use std::fmt::Write as _;
use std::io::Write;
use std::path::{Path, PathBuf};

/// Shows the range profile of one microphone: its echoes, resolution and unambiguous length.
///
/// INPUT is a cube (.npz or .zarr), a run file (.toml), a bare mesh or a list of reflectors (.csv), of which the cube is
/// simulated as `simulate` does it. The window is that of [reconstruct]; a cube is corrected by [calibration].
#[derive(Debug, Args)]
pub(in crate::cli) struct AscanArgs {
    /// Cube, run file, mesh or reflector list.
    input: PathBuf,
    /// The microphone: its number, counted from 0; "centre"; x,y for the nearest, in m; or "mean", the power of all.
    #[arg(long, value_name = "MICROPHONE", default_value = "centre", allow_hyphen_values = true)]
    mic: String,
    /// The loudspeaker, if there are several, counted from 0.
    #[arg(long, value_name = "N", default_value_t = 0)]
    speaker: usize,
    /// Maximum number of peaks.
    #[arg(long, value_name = "N", default_value_t = 10)]
    peaks: usize,
    /// Draw over the whole path instead of the range, which is half of it.
    #[arg(long)]
    path: bool,
    /// Picture (.png) or table (.csv) of the profile to write (repeatable).
    #[arg(short, long, value_name = "PROFILE")]
    output: Vec<PathBuf>,
    /// Run file for a cube, of which [reconstruct] window and [calibration] are used.
    #[arg(short, long, value_name = "RUN.toml")]
    config: Option<PathBuf>,
    #[command(flatten)]
    overrides: Overrides,
}

pub(super) fn run(args: &AscanArgs, terminal: &Terminal) -> Result<()> {
    args.output.iter().try_for_each(|path| announce(path, &["png", "csv"]))?;
    let microphone: ScannedMicrophone = args.mic.parse().map_err(|error: Error| error.at("--mic"))?;
    let options = AScanOptions::default()
        .with_microphone(microphone)
        .with_transmission(args.speaker)
        .with_peaks(args.peaks);
    let job = observed(terminal);
    let scan = match job_of(&args.input, args.config.as_deref(), &args.overrides, terminal)? {
        JobInput::Cube(cube) => {
            let (run, cube) = *cube;
            pipeline::ascan_cube(&run, cube, &options, &job)
        }
        JobInput::Scene(scene) => {
            pipeline::ascan_scene(&scene.run, &options, &job.with_bare_mesh(scene.bare.as_ref()))
        }
    }?;
    for file in &args.output {
        if has_extension(file, &["csv"]) {
            write_csv(file, &scan)?;
        } else {
            write_ascan_figure(file, &scan, args.path)?;
        }
    }
    if terminal.json() {
        return print_json(&scan);
    }
    let mut text = summary::facts(&facts(&scan)) + &peaks(&scan);
    for file in &args.output {
        let _ = writeln!(text, "wrote {}", file.display());
    }
    print(&text)
}

/// The values of a profile, a line each.
fn write_csv(file: &Path, scan: &AScan) -> Result<()> {
    write_atomically(file, |file| {
        writeln!(file, "path_m,range_m,amplitude,level_db")?;
        for (k, amplitude) in scan.amplitude.iter().enumerate() {
            let path = k as f64 * scan.path_pitch;
            let level = 20.0 * amplitude.log10();
            writeln!(file, "{path:.6},{:.6},{amplitude:.6e},{level:.3}", path / 2.0)?;
        }
        Ok(())
    })
}

fn facts(scan: &AScan) -> Value {
    let mut facts = Map::new();
    let mut row = |name: &str, value: String| facts.insert(name.to_owned(), json!(value));
    let place = |[x, y, z]: [f64; 3]| format!("{:.3} {:.3} {:.3} m", x + 0.0, y + 0.0, z + 0.0);
    match scan.microphone {
        Some(microphone) => row("microphone", format!("no. {microphone} at {}", place(scan.position_m))),
        None => row("microphone", format!("mean power of {}", scan.microphones)),
    };
    row("speaker", format!("at {}", place(scan.source_m)));
    let frequencies = &scan.frequencies;
    let (first, last) = (frequencies[0], frequencies[frequencies.len() - 1]);
    row("frequencies", format!("{} from {first} to {last} Hz, {}", frequencies.len(), scan.detection));
    let mm = |length: f64| millimetres(Some(length));
    row(
        "range resolution",
        format!(
            "c/2B = {} mm; with the window a peak is {} mm wide at -3 dB",
            mm(scan.range_resolution),
            mm(scan.peak_width)
        ),
    );
    let uneven = if scan.even { "" } else { ", by the mean step; uneven frequencies repeat nothing exactly" };
    row(
        "unambiguous",
        format!(
            "{:.3} m of path, {:.3} m of range{uneven}",
            scan.unambiguous_path,
            scan.unambiguous_path / 2.0
        ),
    );
    row("median level", scan.median_db.map_or("none".to_owned(), |db| format!("{db:.1} dB")));
    Value::Object(facts)
}

/// The peaks, a line each.
fn peaks(scan: &AScan) -> String {
    let mut rows = vec![["peak", "range m", "path m", "level dB", "amplitude"].map(str::to_owned).to_vec()];
    for (i, peak) in scan.peaks.iter().enumerate() {
        let amplitude = 10_f64.powf(peak.level_db / 20.0);
        let cells = [
            format!("{}", i + 1),
            format!("{:.4}", peak.range),
            format!("{:.4}", 2.0 * peak.range),
            format!("{:.2}", peak.level_db),
            format!("{amplitude:.4}"),
        ];
        rows.push(cells.to_vec());
    }
    if scan.peaks.is_empty() { "no echo stands out\n".to_owned() } else { columns(&rows) }
}
