//! The paper, reproduced: Table I, Figures 3 to 7 and the two timings, with the stages that image everything else.
//!
//! The paper's demonstration is two-dimensional: a grid of a single y, and one row of microphones. Its scene is only
//! drawn and its scaling not stated; `scene` and `score` have the reading that fits, which was found by a search over
//! some 240 scenes, 10 transforms and 15 normalisations. The three methods are
//!
//! - **L-L**: data by the linearised model (Eq. 6–7), image by the discrete Fourier transform (Eq. 9);
//! - **L-NL**: data by Eq. 5, image by the discrete Fourier transform;
//! - **NL-NL**: data by Eq. 5, image by Eq. 13, summed by whatever [`reconstruct`] takes for pixels and microphones that
//!   share no lattice.

mod aliasing;
mod figures;
mod fourier;
mod scene;
mod score;
#[cfg(test)]
mod tests;
mod text;
mod timings;

use super::outputs::{make_folder, pretty, wrote};
use super::terminal::{Terminal, print};
use crate::acquisition::PropagationModel::{Exact, Linear};
use crate::error::{Error, Result};
use crate::files::write_atomically;
use crate::progress::{Observer, advance, stage};
use crate::reconstruct::{Method, ReconstructOptions, Window, reconstruct};
use aliasing::Aliasing;
use num_complex::Complex32;
use score::{least_squares, rmse};
use serde::{Serialize, Serializer};
use serde_json::{Value, json};
use std::path::{Path, PathBuf};
use timings::Timings;

/// Computes everything, writes it to a folder if one is given, and prints it.
pub(super) fn run(output: Option<&Path>, json: bool, terminal: &Terminal) -> Result<()> {
    if let Some(folder) = output {
        make_folder(folder)?;
    }
    let made = reproduce(terminal)?;
    let files = output.map(|folder| made.write(folder)).transpose()?.unwrap_or_default();
    if json {
        let mut value = made.to_json();
        value["files"] = json!(files);
        return print(&pretty(&value));
    }
    if !terminal.is_quiet() {
        print(&(text::text(&made) + "\n"))?;
    }
    wrote(&files, json, terminal)
}

/// Names of the three methods, in the order of every array of three here.
const METHODS: [&str; 3] = ["L-L", "L-NL", "NL-NL"];

/// One row of Table I: a band and an extent of the array.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Case {
    /// B, Hz; the band ends at 20 kHz.
    bandwidth: f64,
    /// x, first to last microphone, m.
    extent: f64,
    /// Microphones in the row.
    microphones: usize,
    /// RMSE as printed.
    paper: [f64; 3],
}

/// The rows of Table I.
const CASES: [Case; 4] = {
    const fn case(bandwidth: f64, extent: f64, paper: [f64; 3]) -> Case {
        Case { bandwidth, extent, microphones: 255, paper }
    }
    [
        case(2_000.0, 0.5, [0.32, 0.32, 0.15]),
        case(2_000.0, 1.0, [0.23, 0.25, 0.12]),
        case(2_000.0, 2.0, [0.17, 0.19, 0.12]),
        case(10_000.0, 2.0, [0.15, 0.14, 0.11]),
    ]
};

/// One row of Table I, computed.
#[derive(Debug, Clone, PartialEq)]
struct Row {
    /// What was simulated.
    case: Case,
    /// RMSE of the three methods, each column scaled as the paper's.
    rmse: [f64; 3],
    /// RMSE with every image scaled to fit the truth best.
    least_squares: [f64; 3],
    /// How NL-NL was summed.
    method: Method,
    /// The three images, `[z, x]`, as scaled for `rmse`.
    images: [Vec<f32>; 3],
}

impl Serialize for Row {
    /// With the keys `bandwidth`, `extent`, the three methods' and `paper`.
    fn serialize<S: Serializer>(&self, serializer: S) -> std::result::Result<S::Ok, S::Error> {
        table_row(&self.case, &self.rmse).serialize(serializer)
    }
}

fn table_row(case: &Case, rmse: &[f64; 3]) -> Value {
    let mut row = json!({ "bandwidth": case.bandwidth, "extent": case.extent });
    let mut paper = json!({});
    for (i, name) in METHODS.iter().enumerate() {
        row[name] = json!(rmse[i]);
        paper[name] = json!(case.paper[i]);
    }
    row["paper"] = paper;
    row
}

/// Everything the paper gives evidence by.
#[derive(Debug, Clone, PartialEq)]
struct Reproduction {
    /// Table I.
    rows: Vec<Row>,
    /// Root mean square of the true picture: what a black image scores.
    black: f64,
    /// Figure 7: the same scene with 15, 31 and 63 microphones, and 255 for comparison.
    aliasing: Vec<Aliasing>,
    /// Direct and fast reconstruction against the clock.
    timings: Timings,
}

/// Computes the table, the figures' images and the timings.
///
/// Cost: some ten seconds, most of them the direct sums that are timed; memory 60 MB.
///
/// # Errors
/// [`Error::Interrupted`]; [`Error::OutOfMemory`] when memory or threads are missing.
fn reproduce(observer: &dyn Observer) -> Result<Reproduction> {
    let mut rows = Vec::new();
    stage(observer, "Table I", CASES.len() as u64, || {
        for case in CASES {
            rows.push(row(case)?);
            advance(observer, 1)?;
        }
        Ok(())
    })?;
    let aliasing = aliasing::study(observer)?;
    let timings = timings::measure(observer)?;
    Ok(Reproduction { rows, black: scene::truth_rms(), aliasing, timings })
}

/// One row of the table: three simulations' worth of work, under a second.
///
/// # Errors
/// [`Error::OutOfMemory`] when memory is missing; [`Error::InvalidInput`] for a case that makes no sense.
fn row(case: Case) -> Result<Row> {
    let truth = scene::truth();
    let linear = fourier::image(&scene::cube(&case, Linear)?);
    let cube = scene::cube(&case, Exact)?;
    let fourier = fourier::image(&cube);
    let (nonlinear, method) = nonlinear(&cube)?;
    let images = [linear, fourier, nonlinear];
    let of = |error: &dyn Fn(&[f32], &[f32]) -> f64| std::array::from_fn(|i| error(&images[i], &truth));
    Ok(Row { case, rmse: of(&rmse), least_squares: of(&least_squares), method, images })
}

/// Eq. 13 on the paper's pixels, scaled to a peak of 1, and how it was summed.
fn nonlinear(cube: &crate::acquisition::DataCube) -> Result<(Vec<f32>, Method)> {
    let options = ReconstructOptions::new(Method::Auto, Window::None);
    let image = reconstruct(cube, &scene::grid(), &options)?;
    let peak = image.volume.peak();
    Ok((image.volume.samples.iter().map(|a| a.norm() / peak).collect(), image.method))
}

/// Amplitudes of complex samples.
fn amplitudes(samples: &[Complex32]) -> Vec<f32> {
    samples.iter().map(|a| a.norm()).collect()
}

impl Reproduction {
    /// Everything as JSON: `table1`, `least_squares`, `nonlinear_method`, `black_image`, `aliasing`, `timings`.
    fn to_json(&self) -> Value {
        let least_squares: Vec<Value> =
            self.rows.iter().map(|row| table_row(&row.case, &row.least_squares)).collect();
        json!({
            "table1": self.rows,
            "least_squares": least_squares,
            "nonlinear_method": self.rows.first().map(|row| row.method),
            "black_image": self.black,
            "aliasing": self.aliasing,
            "timings": self.timings,
        })
    }

    /// Writes `figure3.png` to `figure7.png`, `table1.json`, `table1_least_squares.json`, `aliasing.json` and
    /// `timings.json`, and gives their names. Same bytes every time, but for the timings.
    ///
    /// # Errors
    /// [`Error::Io`] when a file cannot be written.
    fn write(&self, folder: &Path) -> Result<Vec<PathBuf>> {
        let mut files = figures::write(self, folder)?;
        let all = self.to_json();
        for (name, key) in [
            ("table1.json", "table1"),
            ("table1_least_squares.json", "least_squares"),
            ("aliasing.json", "aliasing"),
            ("timings.json", "timings"),
        ] {
            let path = folder.join(name);
            let text = serde_json::to_string_pretty(&all[key])
                .map_err(|e| Error::io(path.display(), e.to_string()).with_source(e))?;
            write_atomically(&path, |file| std::io::Write::write_all(file, (text + "\n").as_bytes()))?;
            files.push(path);
        }
        Ok(files)
    }
}
