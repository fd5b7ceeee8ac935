//! The common style of axes, colour bars and charts: ink, text and ticks.

use super::canvas::Colour;
use super::lettering::TextStyle;

pub(super) const INK: Colour = [38, 38, 38];
// The height of a line is 1.164 times the nominal size of its letters.
pub(super) const LABEL: TextStyle = TextStyle { size: 39.0, colour: INK };
pub(super) const NUMBER: TextStyle = TextStyle { size: 34.0, colour: INK };
/// Length of a tick, px.
pub(super) const TICK: usize = 9;
/// From a tick to its number, px.
pub(super) const TICK_GAP: usize = 8;
