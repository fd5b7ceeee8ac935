//! `calibrate`: the response of a chain of speaker and microphones, or a corrected cube.

use crate::acquisition::{ChannelResponse, ResponseAxis};
use crate::cli::Settings;
use crate::cli::inputs::{ARRAYS, check_kind, cube_of};
use crate::cli::outputs::{announce, print_json, print_written};
use crate::cli::summary;
use crate::cli::terminal::{Terminal, observed, print};
use crate::error::{Error, Result};
use crate::focus::{ChannelError, HeldOut, SelfCalibration, SelfCalibrationVerdict};
use crate::pipeline;
use crate::progress::{Observer, stage};
use clap::Args;
use glam::DVec3;
use serde_json::json;
use std::path::{Path, PathBuf};

/// Corrects a measured cube as [calibration] says, or measures a response with a target at a known place.
///
/// `image` and `reconstruct` apply [calibration] by themselves. See `holosonar help measured`.
#[derive(Debug, Args)]
pub(in crate::cli) struct CalibrateArgs {
    /// The cube to correct.
    #[arg(required_unless_present = "reference")]
    cube: Option<PathBuf>,
    /// Instead: the cube of a small target, as a ball, alone in the room or in the gate.
    #[arg(long, value_name = "CUBE.npz", conflicts_with = "cube", requires = "at")]
    reference: Option<PathBuf>,
    /// Where that target was, m.
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true, requires = "reference", value_parser = point)]
    at: Option<DVec3>,
    /// What the response is measured for.
    #[arg(long, value_name = "AXIS", default_value = "frequency", requires = "reference")]
    per: ResponseAxis,
    /// Instead of [calibration] alone: find errors of tones or microphones from the echoes in [grid] (frequency, phase, delay or
    /// position), and write the corrected cube if microphones that were kept aside are explained better.
    #[arg(long, value_name = "ERRORS", requires = "prior", conflicts_with = "reference")]
    blind: Option<ChannelError>,
    /// How large these errors are, rms: of phases in degrees, of delays and positions (along each axis) in m.
    #[arg(long, value_name = "RMS", requires = "blind")]
    prior: Option<f64>,
    /// Write the cube even if microphones that were kept aside are not explained better.
    #[arg(long, requires = "blind")]
    anyway: bool,
    /// Run file with [calibration].
    #[arg(short, long, value_name = "RUN.toml")]
    config: Option<PathBuf>,
    /// The corrected cube (.npz or .zarr), or the response (.npz), to write.
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    #[command(flatten)]
    settings: Settings,
}

/// A point in m, as typed: three numbers.
fn point(typed: &str) -> std::result::Result<DVec3, String> {
    let numbers: Option<Vec<f64>> = typed.split(',').map(|word| word.trim().parse().ok()).collect();
    match numbers.as_deref() {
        Some([x, y, z]) if [x, y, z].into_iter().all(|x| x.is_finite()) => Ok(DVec3::new(*x, *y, *z)),
        _ => Err("three numbers were expected, in m, as in 0,0.1,1.5".to_owned()),
    }
}

/// Below this share of the power a target is not the only echo, or not where it was said to be.
const EXPLAINED: f64 = 0.5;

pub(super) fn run(args: &CalibrateArgs, terminal: &Terminal) -> Result<()> {
    // A response is a file of its own kind.
    announce(&args.output, if args.reference.is_some() { &["npz"] } else { &ARRAYS })?;
    match (&args.cube, &args.reference, args.at) {
        (_, Some(reference), Some(at)) => measure(args, reference, at, terminal),
        (Some(cube), ..) if args.blind.is_some() => blind(args, cube, terminal),
        (Some(cube), ..) => correct(args, cube, terminal),
        _ => Err(Error::input("CUBE", "is missing: give a cube, or --reference and --at")),
    }
}

/// Writes the corrected cube.
fn correct(args: &CalibrateArgs, cube: &Path, terminal: &Terminal) -> Result<()> {
    check_kind(cube, "a data cube", "import")?;
    let (run, cube) = cube_of(cube, args.config.as_deref(), &args.settings.set, terminal)?;
    let calibration = run.calibration();
    if calibration.is_empty() {
        let problem = "says nothing, so that the cube would stay as it is; see `holosonar help run_file`";
        return Err(Error::input("[calibration]", problem));
    }
    let cube = cube.calibrated(&calibration, terminal)?;
    let words = cube.changes().to_vec();
    let cube = cube.load()?;
    stage(terminal, "writing", 0, || pipeline::write_cube(&args.output, &cube))?;
    if terminal.json() {
        return print_json(&json!({ "cube": args.output.display().to_string(), "corrections": words }));
    }
    show(&json!({ "corrections": words.join("; ") }), args, terminal)
}

/// Finds errors of channels from echoes, and writes the cube without them if they are to be trusted.
fn blind(args: &CalibrateArgs, cube: &Path, terminal: &Terminal) -> Result<()> {
    check_kind(cube, "a data cube", "import")?;
    let (Some(kind), Some(prior)) = (args.blind, args.prior) else {
        return Err(Error::input("--prior", "is missing: how large the errors are, rms"));
    };
    let (run, cube) = cube_of(cube, args.config.as_deref(), &args.settings.set, terminal)?;
    let (found, cube) = pipeline::self_calibrate_cube(&run, cube, kind, prior, &observed(terminal))?;
    let trusted = found.verdict == SelfCalibrationVerdict::Better;
    let written = trusted || args.anyway;
    if written {
        let corrected = found.correct(&cube)?;
        stage(terminal, "writing", 0, || pipeline::write_cube(&args.output, &corrected))?;
    }
    let cube = written.then(|| args.output.display().to_string());
    if terminal.json() {
        print_json(&json!({ "cube": cube, "found": found }))?;
    } else if !terminal.is_quiet() {
        print(&summary::facts(&blind_facts(&found)))?;
    }
    if !trusted {
        let done = if written { "written nevertheless" } else { "nothing was written (--anyway writes it)" };
        let why = match found.verdict {
            SelfCalibrationVerdict::LargerThanPrior => "the errors found are far larger than --prior says",
            _ => "the microphones kept aside are not explained better, whatever the sharpness",
        };
        return Err(Error::LimitMissed(format!("{why}; {done}")));
    }
    if terminal.json() { Ok(()) } else { print_written(std::slice::from_ref(&args.output), terminal) }
}

/// What was found, in few words.
fn blind_facts(found: &SelfCalibration) -> serde_json::Value {
    let HeldOut { count, explained_before, explained_after, significance, .. } = found.held_out;
    let percent = |share: f64| format!("{:.1} %", 100.0 * share);
    json!({
        "errors": found.kind,
        "found": format!("{:.4} {} rms; {} were expected", found.rms, found.unit, found.prior),
        "bright voxels": format!("{:.0} resolution cells in effect", found.cells),
        "sharpness": format!("{:.1} before, {:.1} after, which proves nothing", found.sharpness_before, found.sharpness_after),
        "kept aside": format!(
            "{count} of {} microphones, of whose power the others explain {} before and {} after",
            found.microphones + count, percent(explained_before), percent(explained_after)
        ),
        "significance": format!("{significance:.1} standard errors"),
        "verdict": found.verdict,
    })
}

/// Measures a response and writes it.
fn measure(args: &CalibrateArgs, reference: &Path, target: DVec3, terminal: &Terminal) -> Result<()> {
    check_kind(reference, "a data cube", "import")?;
    let (run, cube) = cube_of(reference, args.config.as_deref(), &args.settings.set, terminal)?;
    let cube = cube.calibrated(&run.calibration(), terminal)?;
    cube.changes().iter().for_each(|change| terminal.note(change));
    let cube = cube.load()?;
    let place = reference.display();
    let response =
        stage(terminal, "measuring the response", 0, || ChannelResponse::measure(&cube, target, args.per))
            .map_err(|error| error.at(place))?;
    if response.explained < EXPLAINED {
        terminal.warn(&format!(
            "a target at {target} m explains {:.0} % of the samples' power; it was elsewhere, or there are other echoes: set \
             calibration.gate around its path",
            100.0 * response.explained
        ));
    }
    stage(terminal, "writing", 0, || response.write(&args.output))?;
    let facts = json!({
        "response": args.output.display().to_string(),
        "per": args.per,
        "frequencies": response.frequency.len(),
        "microphones": response.microphone.len(),
        "speakers": response.source.len(),
        "explained": response.explained,
    });
    if terminal.json() {
        return print_json(&facts);
    }
    show(
        &json!({ "response per": args.per, "explained": format!("{:.4}", response.explained) }),
        args,
        terminal,
    )
}

/// Prints what was done, and the file.
fn show(facts: &serde_json::Value, args: &CalibrateArgs, terminal: &Terminal) -> Result<()> {
    if !terminal.is_quiet() {
        print(&summary::facts(facts))?;
    }
    print_written(std::slice::from_ref(&args.output), terminal)
}
