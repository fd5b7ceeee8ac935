//! The figure of point-spread functions: planes through each point, and the box from the front.

use super::{Panel, Scale, write_figure};
use crate::error::Result;
use crate::psf::PointSpread;
use std::path::Path;

/// How far below the peak the amplitude is shown, dB.
const DYNAMIC_RANGE_DB: f64 = 40.0;

/// Draws one row per point: the maximum along z of the whole grid, and the planes x y, x z and y z through the point.
///
/// # Errors
/// As [`write_figure`].
///
/// # Panics
/// Without points.
pub fn write_spread_figure(path: &Path, spreads: &[PointSpread]) -> Result<()> {
    let scale = Scale::levels(DYNAMIC_RANGE_DB);
    let panels: Vec<Panel> = spreads
        .iter()
        .flat_map(|spread| {
            let [x, y, z] = spread.point;
            let scale = &scale;
            spread.cuts.iter().map(move |cut| {
                let (title, axes) = match cut.name {
                    "front" => ("from the front, maximum along z".to_owned(), ["x", "y"]),
                    "x y" => (format!("z = {z:.3} m"), ["x", "y"]),
                    "x z" => (format!("y = {y:.3} m"), ["x", "z"]),
                    _ => (format!("x = {x:.3} m"), ["y", "z"]),
                };
                Panel {
                    note: format!("point {x:.3}, {y:.3}, {z:.3} m"),
                    x_label: format!("{} / m", axes[0]),
                    y_label: format!("{} / m", axes[1]),
                    upward: axes[1] == "z",
                    ..Panel::new(&title, &cut.decibels[..], cut.columns, cut.rows, scale.clone())
                }
            })
        })
        .collect();
    write_figure(path, &panels, 4)
}
