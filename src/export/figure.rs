//! PNG figures: maps as crisp blocks in a box with axes in metres and a colour bar.
//!
//! A [`Panel`] is one map; [`write_figure`] draws one or several. Pixels of the map are never blended, because the mean of
//! two depths may be a depth where there is no surface.
//!
//! The crate `plotters` 0.3 has neither colour bars nor equal scales on both axes, so the layout would still be computed
//! here; `charming` 0.6 draws in a browser or needs V8.

mod array;
mod ascan;
mod bar;
mod canvas;
mod chart;
mod focus;
mod health;
mod layout;
mod lettering;
mod results;
mod spread;
mod style;
mod ticks;

pub(crate) use array::write_array_figure;
pub(crate) use ascan::write_ascan_figure;
pub(crate) use chart::{Chart, ChartAxis, Scatter, write_charts, write_scatters};
pub(crate) use focus::write_focus_figure;
pub(crate) use health::write_health_figure;
pub use results::{
    DepthKind, depth_range, write_amplitude_figure, write_depth_figure, write_error_figure,
    write_preview_figure,
};
pub use spread::write_spread_figure;

use crate::error::Result;
use crate::grid::Axis;
use std::borrow::Cow;
use std::path::Path;

/// Number of colours of a scale; the rest of a palette of 256 is for the text.
const COLOURS: usize = 200;

/// A colour map.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum ColourMap {
    /// Blue to yellow, with evenly rising brightness: depths.
    Viridis,
    /// Black to yellow: amplitudes.
    Inferno,
    /// Black to white.
    Grey,
}

/// The mapping of values to colours. A range that is not finite means that there are no values.
#[derive(Debug, Clone, PartialEq)]
pub enum Scale {
    /// From the first to the second number of `range`, in the unit of the values; values beyond have the end colours.
    Sequential {
        /// The colours.
        map: ColourMap,
        /// Values of the first and of the last colour.
        range: [f64; 2],
        /// Label of the colour bar: quantity / unit.
        label: String,
    },
    /// Blue from `−limit`, white at 0, red to `+limit`.
    Diverging {
        /// Value of the last colour, positive.
        limit: f64,
        /// Label of the colour bar: quantity / unit.
        label: String,
    },
}

/// One map of a figure.
#[derive(Debug, Clone, PartialEq)]
pub struct Panel<'a> {
    /// The title above the map.
    pub title: String,
    /// A second, smaller line above the map; may be empty.
    pub note: String,
    /// The map, `[y, x]`; NaN where there is nothing.
    pub values: Cow<'a, [f32]>,
    /// Columns.
    pub x: Axis,
    /// Rows.
    pub y: Axis,
    /// Quantity / unit of the columns.
    pub x_label: String,
    /// Quantity / unit of the rows.
    pub y_label: String,
    /// Whether the first row is drawn at the bottom, as in a top view; images have it at the top.
    pub upward: bool,
    /// Whether the map is drawn square, whatever its extents; otherwise both axes have the same scale.
    pub stretched: bool,
    /// The mapping of values to colours.
    pub scale: Scale,
    /// The meaning of the grey of NaN: "no return".
    pub nothing: String,
    /// Lower and upper corner of a frame drawn over the map, in its axes.
    pub frame: Option<[[f64; 2]; 2]>,
}

impl<'a> Panel<'a> {
    /// A map over x and y in m, with rows downwards.
    pub fn new(title: &str, values: impl Into<Cow<'a, [f32]>>, x: Axis, y: Axis, scale: Scale) -> Self {
        Self {
            title: title.into(),
            note: String::new(),
            values: values.into(),
            x,
            y,
            x_label: "x / m".into(),
            y_label: "y / m".into(),
            upward: false,
            stretched: false,
            scale,
            nothing: "no return".into(),
            frame: None,
        }
    }
}

impl Scale {
    /// Levels from `−range_db` to 0 dB.
    fn levels(range_db: f64) -> Self {
        Self::Sequential { map: ColourMap::Inferno, range: [-range_db, 0.0], label: "level / dB".into() }
    }

    fn label(&self) -> &str {
        match self {
            Self::Sequential { label, .. } | Self::Diverging { label, .. } => label,
        }
    }

    /// Values of the first and last colour, or `None` if there are no values. A range of zero length is widened, so that
    /// a constant map has the middle colour.
    fn range(&self) -> Option<[f64; 2]> {
        let [low, high] = match self {
            Self::Sequential { range, .. } => *range,
            Self::Diverging { limit, .. } => [-limit, *limit],
        };
        let middle = f64::midpoint(low, high);
        let least = 1e-4 * middle.abs().max(1e-2);
        if !(high - low).is_finite() {
            None
        } else if high - low < least {
            Some([middle - least / 2.0, middle + least / 2.0])
        } else {
            Some([low, high])
        }
    }

    /// The colour at a position between 0 (first) and 1 (last), one of [`COLOURS`].
    fn colour(&self, place: f64) -> canvas::Colour {
        let steps = (COLOURS - 1) as f64;
        let place = (place.clamp(0.0, 1.0) * steps).round() / steps;
        let colour = match self {
            Self::Sequential { map: ColourMap::Viridis, .. } => colorous::VIRIDIS.eval_continuous(place),
            Self::Sequential { map: ColourMap::Inferno, .. } => colorous::INFERNO.eval_continuous(place),
            Self::Sequential { map: ColourMap::Grey, .. } => colorous::GREYS.eval_continuous(1.0 - place),
            Self::Diverging { .. } => colorous::RED_BLUE.eval_continuous(1.0 - place),
        };
        colour.as_array()
    }
}

/// Draws panels, in rows of `columns`, into a PNG.
///
/// Panels of one row with the same scale share the colour bar at its end; the bar has a pointed end if there are values
/// beyond its colours. The resolution in the file is 300 dots per inch: one column of panels is as wide as a journal
/// column (about 1050 px, 88 mm), two are 1700 to 2000 px wide, and more at most 4000 px.
///
/// # Errors
/// As `crate::files::write_atomically`.
///
/// # Panics
/// Without panels or columns, or if a panel does not have one value per pixel.
pub fn write_figure(path: &Path, panels: &[Panel<'_>], columns: usize) -> Result<()> {
    assert!(!panels.is_empty() && columns > 0, "a figure has at least one panel and one column");
    for panel in panels {
        assert_eq!(
            panel.values.len() as u128,
            panel.x.count as u128 * panel.y.count as u128,
            "panel `{}`: one value per pixel",
            panel.title
        );
    }
    layout::draw(panels, columns.min(panels.len())).write_png(path)
}

#[cfg(test)]
mod tests;
