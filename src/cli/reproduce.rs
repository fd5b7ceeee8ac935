//! Reproduces the paper: Table I, Figures 3 to 7 and the two timings, with the same stages as any other image.
//!
//! The paper's demonstration is two-dimensional: a grid with a single y, and one row of microphones. The paper only draws
//! its scene and does not state its scaling; `scene` and `score` have the interpretation that fits, which was found by a
//! search over some 240 scenes, 10 transforms and 15 normalisations. The three methods are
//!
//! - **L-L**: data by the linearised model (Eq. 6–7), image by the discrete Fourier transform (Eq. 9);
//! - **L-NL**: data by Eq. 5, image by the discrete Fourier transform;
//! - **NL-NL**: data by Eq. 5, image by Eq. 13, by the method that [`reconstruct`] chooses for pixels and microphones without a
//!   common lattice.

mod aliasing;
mod figures;
mod fourier;
mod scene;
mod score;
#[cfg(test)]
mod tests;
mod text;
mod timings;

use super::outputs::{open_folder, print_json, print_written, write_json};
use super::terminal::{Terminal, print};
use crate::acquisition::PropagationModel::{Exact, Linear};
use crate::error::Result;
use crate::progress::{Observer, advance, stage};
use crate::reconstruct::{Method, ReconstructOptions, Window, reconstruct};
use aliasing::AliasingStudy;
use num_complex::Complex32;
use score::{least_squares, rmse};
use serde::{Serialize, Serializer};
use serde_json::{Value, json};
use std::path::{Path, PathBuf};
use timings::Timings;

/// Computes the results, writes them to a folder, if given, and prints them.
pub(super) fn run(output: Option<&Path>, terminal: &Terminal) -> Result<()> {
    let opened =
        output.map(|folder| open_folder(folder, FIGURES.into_iter().chain(JSON.map(|(name, _)| name))));
    let opened = opened.transpose()?;
    let reproduction = reproduce(terminal)?;
    let files = opened.as_ref().map(|(_, files)| files.as_slice()).unwrap_or_default();
    if !files.is_empty() {
        reproduction.write(files)?;
    }
    if terminal.json() {
        let mut value = reproduction.to_json();
        value["files"] = json!(files);
        return print_json(&value);
    }
    if !terminal.is_quiet() {
        print(&(text::text(&reproduction) + "\n"))?;
    }
    print_written(files, terminal)
}

/// The files with the figures of these numbers, in order.
const FIGURES: [&str; 5] = ["figure3.png", "figure4.png", "figure5.png", "figure6.png", "figure7.png"];

/// The files with numbers, each with its key in the JSON of everything.
const JSON: [(&str, &str); 4] = [
    ("table1.json", "table1"),
    ("table1_least_squares.json", "least_squares"),
    ("aliasing.json", "aliasing"),
    ("timings.json", "timings"),
];

/// Names of the three methods, in the order of all arrays of three in this module.
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
const CASES: [Case; 4] = [
    Case { bandwidth: 2_000.0, extent: 0.5, microphones: 255, paper: [0.32, 0.32, 0.15] },
    Case { bandwidth: 2_000.0, extent: 1.0, microphones: 255, paper: [0.23, 0.25, 0.12] },
    Case { bandwidth: 2_000.0, extent: 2.0, microphones: 255, paper: [0.17, 0.19, 0.12] },
    Case { bandwidth: 10_000.0, extent: 2.0, microphones: 255, paper: [0.15, 0.14, 0.11] },
];

/// One row of Table I, computed.
#[derive(Debug, Clone, PartialEq)]
struct Row {
    /// The simulated case.
    case: Case,
    /// RMSE of the three methods, each column scaled as in the paper.
    rmse: [f64; 3],
    /// RMSE with every image scaled for the best fit to the truth.
    least_squares: [f64; 3],
    /// The reconstruction method of NL-NL.
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

/// All reproduced results of the paper.
#[derive(Debug, Clone, PartialEq)]
struct Reproduction {
    /// Table I.
    rows: Vec<Row>,
    /// Root mean square of the true picture, which is the RMSE of a black image.
    black: f64,
    /// Figure 7: the same scene with 15, 31 and 63 microphones, and 255 for comparison.
    aliasing: Vec<AliasingStudy>,
    /// Running times of direct and fast reconstruction.
    timings: Timings,
}

/// Computes the table, the figures' images and the timings.
///
/// Cost: about ten seconds, mostly for the direct sums that are timed; 60 MB of memory.
///
/// # Errors
/// [`Error::Interrupted`](crate::error::Error::Interrupted); [`Error::OutOfMemory`](crate::error::Error::OutOfMemory) when memory or threads are missing.
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

/// Computes one row of the table. Cost: under a second.
///
/// # Errors
/// [`Error::OutOfMemory`](crate::error::Error::OutOfMemory) when memory is missing; [`Error::InvalidInput`](crate::error::Error::InvalidInput) for an invalid case.
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

/// Eq. 13 on the paper's pixels, scaled to a peak of 1, and the method of the sum.
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

    /// Writes the files of [`FIGURES`] and [`JSON`], in this order. All except the timings are always bit-identical.
    ///
    /// # Errors
    /// [`Error::Io`](crate::error::Error::Io) when a file cannot be written.
    fn write(&self, files: &[PathBuf]) -> Result<()> {
        let (figures, numbers) = files.split_at(FIGURES.len());
        figures::write(self, figures)?;
        let all = self.to_json();
        numbers.iter().zip(JSON).try_for_each(|(path, (_, key))| write_json(path, &all[key]))
    }
}
