//! What axes, colour bars and charts have in common: ink, letters and ticks.

use super::canvas::Colour;
use super::lettering::Style;

pub(super) const INK: Colour = [38, 38, 38];
// A line is 1.164 times as high as its letters' nominal size.
pub(super) const LABEL: Style = Style { size: 39.0, colour: INK };
pub(super) const NUMBER: Style = Style { size: 34.0, colour: INK };
/// Length of a tick, px.
pub(super) const TICK: usize = 9;
/// From a tick to its number, px.
pub(super) const TICK_GAP: usize = 8;
