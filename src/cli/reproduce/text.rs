//! What `reproduce` prints: the paper's numbers beside ours.

use super::aliasing::Aliasing;
use super::timings::Timings;
use super::{METHODS, Reproduction, Row};
use std::fmt::Write;

/// Table, aliasing and timings, each with what it says about the paper.
pub(super) fn text(made: &Reproduction) -> String {
    [table(made), least_squares(made), aliasing(&made.aliasing), timings(&made.timings)].join("\n")
}

fn name_of(row: &Row) -> String {
    format!("{:2.0} kHz, {:.1} m", row.case.bandwidth / 1e3, row.case.extent)
}

fn table(made: &Reproduction) -> String {
    let mut text = "Table I: RMSE ours / paper (ratio)\n".to_owned();
    let _ = writeln!(text, "B, x          {:24}{:24}{}", METHODS[0], METHODS[1], METHODS[2]);
    for row in &made.rows {
        let cell = |i: usize| {
            let (ours, paper) = (row.rmse[i], row.case.paper[i]);
            format!("{ours:.4} / {paper:.2} ({:.2})", ours / paper)
        };
        let _ = writeln!(text, "{:14}{:24}{:24}{}", name_of(row), cell(0), cell(1), cell(2));
    }
    let _ = writeln!(text, "A black picture scores {:.3}.", made.black);
    if let Some(row) = made.rows.first() {
        let _ = writeln!(
            text,
            "NL-NL is summed by {}: pixels of 1 cm and the microphones' pitch share no lattice, and it needs none.",
            row.method
        );
    }
    text
}

fn least_squares(made: &Reproduction) -> String {
    let mut text = "The same, every image scaled to fit the truth best (least squares)\n".to_owned();
    for row in &made.rows {
        let [a, b, c] = row.least_squares;
        let _ = writeln!(text, "{:14}{a:<24.4}{b:<24.4}{c:.4}", name_of(row));
    }
    text += "The paper's scaling flatters NL-NL: it divides NL-NL by its maximum and leaves the others on the absolute\n\
             scale of the transform. Scaled alike, L-L and NL-NL at 0.5 m are the same matched filter and score alike;\n\
             NL-NL stays best in every row, but the gain over L-NL is ";
    let gains: Vec<String> =
        made.rows.iter().map(|row| format!("{:.2}", row.least_squares[1] / row.least_squares[2])).collect();
    let printed: Vec<String> =
        made.rows.iter().map(|row| format!("{:.2}", row.rmse[1] / row.rmse[2])).collect();
    let _ = writeln!(text, "{} and not {}.", gains.join(", "), printed.join(", "));
    text
}

fn aliasing(studies: &[Aliasing]) -> String {
    let mut text =
        "Aliasing (Figure 7): ghosts of a point where the lines cross, x 2 m, B 2 kHz\n".to_owned();
    for study in studies {
        let seen = if study.shows_ghosts() { "ghosts" } else { "no ghosts" };
        let _ = writeln!(
            text,
            "{:3} microphones: {seen} in the scene ({:+.1} dB off the lines); spacing lambda |p|/d = {:.2} m",
            study.microphones, study.off_lines_db, study.spacing
        );
        for ghost in &study.ghosts {
            let _ = writeln!(
                text,
                "  x predicted {:6.2} m, measured {:6.2} m; about {:5.1} dB predicted, {:5.1} dB measured",
                ghost.predicted_x, ghost.measured_x, ghost.predicted_db, ghost.measured_db
            );
        }
    }
    text += "Ghosts follow the classical rule x_k = |p| (sin theta - k lambda/d). The paper's (2^N-1)/x = 7.5 is the\n\
             number of microphones per metre, a sampling frequency, not a distance: nothing contradicts the theory.\n";
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
