//! `info --health`: whether a measured cube is sound, as a table, and as a picture and JSON in a folder.

use crate::acquisition::{
    ChannelLevels, CubeFile, Detection, Health, LikelySign, NoiseEstimate, OddChannel, OddChannels,
    TransmissionHealth,
};
use crate::cli::inputs::{ARRAYS, has_extension, reading_limit};
use crate::cli::outputs::{open_folder, print_json, write_json};
use crate::cli::summary;
use crate::cli::terminal::{Terminal, print};
use crate::error::{Error, Result};
use crate::export::figure::write_health_figure;
use serde_json::{Map, Value, json};
use std::fmt::Write;
use std::path::Path;

/// How many odd channels the table names; the JSON has more.
const SHOWN: usize = 3;

/// How many speakers the table has.
const MOST_SPEAKERS: usize = 32;

/// Examines a cube; with a folder, draws `health.png` and writes `health.json` there.
pub(in crate::cli) fn show(file: &Path, folder: Option<&Path>, terminal: &Terminal) -> Result<()> {
    if !has_extension(file, &ARRAYS) {
        let problem = "is no data cube (.npz or .zarr); --health examines the samples of one";
        return Err(Error::input(file.display(), problem));
    }
    let limit = reading_limit();
    let mut cube = CubeFile::open(file, limit)?;
    let folder = folder.map(|folder| open_folder(folder, ["health.png", "health.json"])).transpose()?;
    let health = Health::of(&mut cube.unchecked(), limit, terminal)?;
    if let Some((_, files)) = &folder {
        write_health_figure(&files[0], &health, &cube)?;
        write_json(&files[1], &health)?;
    }
    if terminal.json() {
        return print_json(&health);
    }
    let mut text = summary::facts(&table(&health));
    for finding in findings(&health) {
        let _ = writeln!(text, "- {finding}");
    }
    for file in folder.iter().flat_map(|(_, files)| files) {
        let _ = writeln!(text, "wrote {}", file.display());
    }
    print(&text)
}

/// The facts in few words.
fn table(health: &Health) -> Value {
    let mut facts = Map::new();
    let mut row = |name: &str, value: Value| facts.insert(name.to_owned(), value);
    row("detection", json!(health.detection));
    row("on_a_lattice", json!(health.on_a_lattice));
    row("microphones", levels(&health.microphones));
    row("tones", levels(&health.tones));
    row("signal to noise", json!(health.noise.map(signal_to_noise)));
    if let Some(profile) = &health.profile {
        let peaks = profile.peaks.iter();
        let peaks: Vec<_> =
            peaks.map(|peak| format!("{:.3} m {:.1} dB", peak.range, peak.level_db)).collect();
        row("echoes", json!(if peaks.is_empty() { "none stands out".to_owned() } else { peaks.join(", ") }));
        row("unambiguous range", json!(format!("{:.3} m", profile.unambiguous_path / 2.0)));
    }
    row("no range profile", json!(health.no_profile));
    if let Some(sign) = &health.phase_sign {
        let evidence = |of: &dyn Fn(bool) -> Option<String>| {
            let [declared, opposite] = [false, true].map(|opposite| of(opposite).unwrap_or("-".to_owned()));
            format!("{declared} as declared, {opposite} with the opposite sign")
        };
        let of = |opposite: bool| if opposite { &sign.opposite } else { &sign.declared };
        let focus = |opposite: bool| of(opposite).focus_db.map(|db| format!("{db:.1} dB"));
        let half = |opposite: bool| of(opposite).first_half.map(|share| format!("{:.0} %", 100.0 * share));
        row("sign of the phase", json!(sign.likely));
        row("brightest point", json!(evidence(&focus)));
        row("energy in the first half", json!(evidence(&half)));
    } else if health.detection == Detection::InPhase {
        row("sign of the phase", json!("none: in-phase samples do not have one"));
    }
    if !health.transmissions.is_empty() {
        let each = health.transmissions.iter().take(MOST_SPEAKERS).enumerate();
        let more = health.transmissions.len() > MOST_SPEAKERS;
        let each = each.map(|(i, each)| (i.to_string(), of_speaker(each)));
        let rest = more.then(|| ("...".to_owned(), json!("--json has all")));
        facts.insert("speakers".to_owned(), Value::Object(each.chain(rest).collect()));
    }
    Value::Object(facts)
}

/// One of several speakers, in a line.
fn of_speaker(each: &TransmissionHealth) -> Value {
    let [x, y, z] = each.source_m;
    let level = each.level_db.map_or("silent".to_owned(), |db| format!("{db:+.1} dB"));
    let noise = each.noise.map(|noise| format!(", signal to noise {}", signal_to_noise(noise)));
    let sign = each.phase_sign.map(|sign| format!(", sign {}", sign.likely));
    let [noise, sign] = [noise, sign].map(Option::unwrap_or_default);
    json!(format!("at {x:.3} {y:.3} {z:.3} m: level {level}{noise}{sign}"))
}

fn levels(levels: &ChannelLevels) -> Value {
    json!({
        "count": levels.count,
        "median level, rms": levels.median,
        "spread": levels.spread_db.map(|db| format!("{db:.1} dB from the 10th to the 90th percentile")),
        "dead": listed(&levels.dead),
        "loud": listed(&levels.loud),
        "not finite": listed(&levels.not_finite),
    })
}

/// How many channels, and where the first of them are.
fn listed(odd: &OddChannels) -> String {
    if odd.count == 0 {
        return "0".to_owned();
    }
    let named: Vec<String> = odd.first.iter().take(SHOWN).map(named).collect();
    let more = if odd.count > SHOWN { ", ..." } else { "" };
    format!("{}: {}{more}", odd.count, named.join(", "))
}

fn named(odd: &OddChannel) -> String {
    let place = match (odd.position_m, odd.frequency_hz) {
        (Some([x, y, z]), _) => format!("at {x:.3} {y:.3} {z:.3} m"),
        (_, Some(frequency)) => format!("at {frequency} Hz"),
        _ => String::new(),
    };
    format!("no. {} {place}", odd.index)
}

fn signal_to_noise(noise: NoiseEstimate) -> String {
    match noise.snr_db {
        None => "no more power than noise".to_owned(),
        Some(db) if noise.at_least => format!("above {db:.0} dB (no floor of noise is seen)"),
        Some(db) => format!("{db:.1} dB"),
    }
}

/// What is wrong with the cube, and what to do about it.
fn findings(health: &Health) -> Vec<String> {
    let mut findings = Vec::new();
    if health.samples_not_finite > 0 {
        findings.push(format!(
            "samples that are not finite: {}, at {} microphones and {} tones; no image is made of such a cube: drop \
             those channels, or set the samples to 0",
            health.samples_not_finite, health.microphones.not_finite.count, health.tones.not_finite.count
        ));
    }
    if health.all_zero {
        findings.push("no finite sample differs from 0: nothing was recorded".to_owned());
        return findings;
    }
    for (what, levels) in [("microphones", &health.microphones), ("tones", &health.tones)] {
        if levels.dead.count > 0 {
            findings.push(format!("dead {what} (0, or 40 dB below the median): {}", levels.dead.count));
        }
        if levels.loud.count > 0 {
            findings.push(format!("loud {what} (20 dB above the median): {}", levels.loud.count));
        }
    }
    if health.never_negative {
        findings.push(
            "no in-phase sample is negative: an offset was not removed, or they are magnitudes".to_owned(),
        );
    }
    let of_speakers = |is: fn(&TransmissionHealth) -> bool| {
        let all = health.transmissions.iter().enumerate().filter(|(_, each)| is(each));
        all.map(|(i, _)| i.to_string()).collect::<Vec<_>>()
    };
    let opposite =
        |each: &TransmissionHealth| each.phase_sign.is_some_and(|sign| sign.likely == LikelySign::Opposite);
    for (what, found) in [
        ("silent speakers (0, or 40 dB below the median)", of_speakers(TransmissionHealth::is_dead)),
        ("loud speakers (20 dB above the median)", of_speakers(TransmissionHealth::is_loud)),
    ] {
        if !found.is_empty() {
            findings.push(format!("{what}, counted from 0: {}", found.join(", ")));
        }
    }
    let declared =
        |each: &TransmissionHealth| each.phase_sign.is_some_and(|sign| sign.likely == LikelySign::Declared);
    let turned = of_speakers(opposite);
    if !turned.is_empty() && health.transmissions.iter().any(declared) {
        findings.push(format!(
            "the sign of the phase is probably wrong of some speakers, counted from 0: {}; conjugate their samples",
            turned.join(", ")
        ));
        return findings;
    }
    if health.phase_sign.is_some_and(|sign| sign.likely == LikelySign::Opposite) {
        findings.push(
            "the sign of the phase is probably wrong: change `phase_sign` in `meta` (if both signs focus alike, only \
             the place of the echoes says so: it is right if they are beyond half of the unambiguous range)"
                .to_owned(),
        );
    }
    if findings.is_empty() {
        findings.push("nothing is wrong with the channels".to_owned());
    }
    findings
}
