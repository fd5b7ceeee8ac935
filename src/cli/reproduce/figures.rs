//! Figures 3 to 7, with four panels each as in the paper: three images and the truth, the array at the bottom.

use super::scene::{grid, truth};
use super::{METHODS, Reproduction, Row};
use crate::error::Result;
use crate::export::figure::{ColourMap, Panel, Scale, write_figure};
use std::path::PathBuf;

/// The panels' titles, in the order of [`METHODS`].
const TITLES: [&str; 3] = ["linear modulation", "linear reconstruction", "nonlinear reconstruction"];

/// Writes the figures into these files: one for each row of Table I, and one of the aliasing.
pub(super) fn write(reproduction: &Reproduction, files: &[PathBuf]) -> Result<()> {
    for (path, row) in files.iter().zip(&reproduction.rows) {
        let mut panels: Vec<Panel> = (0..METHODS.len()).map(|method| panel_of(row, method)).collect();
        panels.push(true_panel());
        write_figure(path, &panels, 2)?;
    }
    let few = reproduction.aliasing.iter().take(3);
    let mut panels: Vec<Panel> = few
        .map(|aliasing| {
            let note = if aliasing.shows_lobes() { "grating lobes" } else { "no grating lobes" };
            panel(&format!("{} microphones", aliasing.microphones), note, &aliasing.image)
        })
        .collect();
    panels.push(true_panel());
    files.get(reproduction.rows.len()).map_or(Ok(()), |path| write_figure(path, &panels, 2))
}

fn panel_of(row: &Row, method: usize) -> Panel<'_> {
    let note = format!(
        "{} kHz, {} m: RMSE {:.3}, paper {:.2}",
        row.case.bandwidth / 1e3,
        row.case.extent,
        row.rmse[method],
        row.case.paper[method]
    );
    panel(&format!("{}: {}", METHODS[method], TITLES[method]), &note, &row.images[method])
}

fn true_panel() -> Panel<'static> {
    panel("true surface", "amplitude 1 on two lines", &truth())
}

/// An image from above, from black to its maximum amplitude.
fn panel(title: &str, note: &str, image: &[f32]) -> Panel<'static> {
    let peak = image.iter().copied().fold(f32::MIN_POSITIVE, f32::max);
    let values: Vec<f32> = image.iter().map(|a| a / peak).collect();
    let scale =
        Scale::Sequential { map: ColourMap::Grey, range: [0.0, 1.0], label: "amplitude / maximum".into() };
    let grid = grid();
    Panel {
        note: note.into(),
        y_label: "z / m".into(),
        upward: true,
        stretched: true,
        ..Panel::new(title, values, grid.x, grid.z, scale)
    }
}
