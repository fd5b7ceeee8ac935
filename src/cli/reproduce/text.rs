//! The output of `reproduce`: the paper's numbers and the reproduced ones.

use super::aliasing::AliasingStudy;
use super::timings::Timings;
use super::{METHODS, Reproduction, Row};
use std::fmt::Write;

/// Table, aliasing and timings, each compared with the paper.
pub(super) fn text(reproduction: &Reproduction) -> String {
    [
        table(reproduction),
        least_squares(reproduction),
        aliasing(&reproduction.aliasing),
        timings(&reproduction.timings),
    ]
    .join("\n")
}

fn name_of(row: &Row) -> String {
    format!("{:2.0} kHz, {:.1} m", row.case.bandwidth / 1e3, row.case.extent)
}

fn table(reproduction: &Reproduction) -> String {
    let mut text = "Table I: RMSE ours / paper (ratio)\n".to_owned();
    let _ = writeln!(text, "B, x          {:24}{:24}{}", METHODS[0], METHODS[1], METHODS[2]);
    for row in &reproduction.rows {
        let cell = |i: usize| {
            let (ours, paper) = (row.rmse[i], row.case.paper[i]);
            format!("{ours:.4} / {paper:.2} ({:.2})", ours / paper)
        };
        let _ = writeln!(text, "{:14}{:24}{:24}{}", name_of(row), cell(0), cell(1), cell(2));
    }
    let _ = writeln!(text, "A black picture scores {:.3}.", reproduction.black);
    if let Some(row) = reproduction.rows.first() {
        let _ = writeln!(
            text,
            "NL-NL is computed by {}, which needs no common lattice of pixels (1 cm) and microphones.",
            row.method
        );
    }
    text
}

fn least_squares(reproduction: &Reproduction) -> String {
    let mut text = "The same, every image scaled for the best fit to the truth (least squares)\n".to_owned();
    for row in &reproduction.rows {
        let [a, b, c] = row.least_squares;
        let _ = writeln!(text, "{:14}{a:<24.4}{b:<24.4}{c:.4}", name_of(row));
    }
    text += "The paper's scaling favours NL-NL: it divides NL-NL by its maximum and leaves the others on the absolute\n\
             scale of the transform. With equal scaling, L-L and NL-NL at 0.5 m are the same matched filter and score\n\
             equally; NL-NL remains best in every row, but its gain over L-NL is ";
    let gains: Vec<String> = reproduction
        .rows
        .iter()
        .map(|row| format!("{:.2}", row.least_squares[1] / row.least_squares[2]))
        .collect();
    let printed: Vec<String> =
        reproduction.rows.iter().map(|row| format!("{:.2}", row.rmse[1] / row.rmse[2])).collect();
    let _ = writeln!(text, "{} and not {}.", gains.join(", "), printed.join(", "));
    text
}

fn aliasing(studies: &[AliasingStudy]) -> String {
    let mut text =
        "Aliasing (Figure 7): grating lobes of a point where the lines cross, x 2 m, B 2 kHz\n".to_owned();
    for study in studies {
        let visible = if study.shows_lobes() { "grating lobes" } else { "no grating lobes" };
        let _ = writeln!(
            text,
            "{:3} microphones: {visible} in the scene ({:+.1} dB off the lines); spacing lambda |p|/d = {:.2} m",
            study.microphones, study.off_lines_db, study.spacing
        );
        for lobe in &study.lobes {
            let _ = writeln!(
                text,
                "  x predicted {:6.2} m, measured {:6.2} m; about {:5.1} dB predicted, {:5.1} dB measured",
                lobe.predicted_x, lobe.measured_x, lobe.predicted_db, lobe.measured_db
            );
        }
    }
    text += "Grating lobes follow the classical rule x_k = |p| (sin theta - k lambda/d). The paper's (2^N-1)/x = 7.5 is the\n\
             number of microphones per metre, a sampling frequency, not a distance: there is no contradiction to theory.\n";
    text
}

fn timings(timings: &Timings) -> String {
    let mut text = format!("Reconstruction of {:.2e} terms, one thread\n", timings.terms as f64);
    for timing in &timings.methods {
        let paper = timing.paper.map_or(String::new(), |s| format!("   paper {s:.0} s"));
        let share = if timing.share < 1.0 {
            format!("   (from {:.0} % of the pixels)", 100.0 * timing.share)
        } else {
            String::new()
        };
        let _ = writeln!(text, "{:44}{:10.4} s{paper}{share}", timing.method, timing.seconds);
    }
    let _ = writeln!(
        text,
        "FFT against sine and cosine per term {:.0}x (paper {:.0}x); against recurrence {:.1}x, and {:.0}x with\n\
         skeleton frequencies.",
        timings.gain, timings.paper_gain, timings.gain_over_recurrence, timings.gain_of_skeletons
    );
    text
}
