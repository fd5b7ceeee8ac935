//! The figure of an array: its microphones and loudspeakers, and the array that several loudspeakers or a pair are seen as.

use super::{ColourMap, Panel, Scale, write_figure};
use crate::acquisition::Instrument;
use crate::error::Result;
use crate::grid::Axis;
use crate::wave::bounding_box;
use glam::DVec3;
use std::collections::BTreeMap;
use std::path::Path;

/// Pixels along the longer side.
const PIXELS: f64 = 480.0;

/// Empty pixels around the outermost places, as a share of the longer side.
const MARGIN: f64 = 0.06;

/// A place is drawn this many pixels to every side.
const REACH: usize = 2;

/// Places nearer than this are one, m.
const SAME_PLACE: f64 = 1e-6;

/// Pixels over places.
struct PlaceMap {
    x: Axis,
    y: Axis,
}

impl PlaceMap {
    fn over(places: impl Iterator<Item = DVec3>) -> Self {
        let (low, high) = bounding_box(places).unwrap_or_default();
        let longer = (high - low).truncate().max_element().max(SAME_PLACE);
        let pitch = longer * (1.0 + 2.0 * MARGIN) / PIXELS;
        let along = |low: f64, high: f64| {
            let count = ((high - low + 2.0 * MARGIN * longer) / pitch).round().max(1.0);
            Axis {
                first: f64::midpoint(low, high) - 0.5 * (count - 1.0) * pitch,
                pitch,
                count: count as usize,
            }
        };
        Self { x: along(low.x, high.x), y: along(low.y, high.y) }
    }

    /// Marks places on a map, where larger values cover smaller ones.
    fn mark(&self, map: &mut [f32], places: impl Iterator<Item = (DVec3, f32)>) {
        for (place, value) in places {
            let pixel = |axis: &Axis, at: f64| ((at - axis.first) / axis.pitch).round().max(0.0) as usize;
            let around =
                |centre: usize, count: usize| centre.saturating_sub(REACH)..(centre + REACH + 1).min(count);
            let (column, row) = (pixel(&self.x, place.x), pixel(&self.y, place.y));
            for iy in around(row, self.y.count) {
                for ix in around(column, self.x.count) {
                    let at = &mut map[iy * self.x.count + ix];
                    *at = if at.is_nan() { value } else { at.max(value) };
                }
            }
        }
    }

    fn empty(&self) -> Vec<f32> {
        vec![f32::NAN; self.x.count * self.y.count]
    }
}

/// Draws the microphones and the loudspeakers, and beside them the virtual array, if it is another.
///
/// # Errors
/// As [`write_figure`].
pub(crate) fn write_array_figure(path: &Path, instrument: &Instrument) -> Result<()> {
    let microphones = instrument.array.positions();
    let speakers: Vec<DVec3> = match instrument.sources() {
        none if none.is_empty() => {
            let each = microphones.iter().enumerate();
            each.map(|(i, r)| instrument.geometry_of(i).source_of(*r)).collect()
        }
        sources => sources,
    };
    let seen = instrument.equivalent();
    let places = microphones.iter().chain(&speakers).chain(seen.array.positions());
    let raster = PlaceMap::over(places.copied());
    let mut map = raster.empty();
    raster.mark(&mut map, microphones.iter().map(|r| (*r, -1.0)));
    raster.mark(&mut map, speakers.iter().map(|s| (*s, 1.0)));
    let both = Scale::Diverging { limit: 1.0, label: "microphones -1, speakers +1".into() };
    let panel = |title: &str, note: String, map: Vec<f32>, scale: Scale| Panel {
        note,
        nothing: "none".into(),
        ..Panel::new(title, map, raster.x, raster.y, scale)
    };
    let counted = format!("{} microphones, {} transmissions", microphones.len(), instrument.transmissions());
    let mut panels = vec![panel("the array", counted, map, both)];
    if instrument.has_virtual_array() {
        let mut counts: BTreeMap<[i64; 2], (DVec3, u32)> = BTreeMap::new();
        for place in seen.array.positions() {
            let key = [place.x, place.y].map(|at| (at / SAME_PLACE).round() as i64);
            counts.entry(key).or_insert((*place, 0)).1 += 1;
        }
        let most = counts.values().map(|(_, count)| *count).max().unwrap_or(1);
        let mut map = raster.empty();
        raster.mark(&mut map, counts.values().map(|(place, count)| (*place, *count as f32)));
        let range = [0.0, f64::from(most)];
        let scale =
            Scale::Sequential { map: ColourMap::Viridis, range, label: "microphones at a place".into() };
        panels.push(panel("seen as", format!("{} places", counts.len()), map, scale));
    }
    write_figure(path, &panels, 2)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn places_are_where_they_are() {
        let places = [DVec3::ZERO, DVec3::new(1.0, 0.5, 0.0)];
        let raster = PlaceMap::over(places.into_iter());
        assert_eq!(raster.x.count, PIXELS as usize);
        let mut map = raster.empty();
        raster.mark(&mut map, places.into_iter().zip([2.0, -1.0]));
        let marked = |value: f32| {
            let at: Vec<usize> = (0..map.len()).filter(|i| map[*i] == value).collect();
            assert_eq!(at.len(), (2 * REACH + 1).pow(2));
            let middle = at[at.len() / 2];
            [raster.x.position(middle % raster.x.count), raster.y.position(middle / raster.x.count)]
        };
        let near = |at: [f64; 2], p: DVec3| (at[0] - p.x).abs().max((at[1] - p.y).abs()) <= raster.x.pitch;
        assert!(near(marked(2.0), places[0]) && near(marked(-1.0), places[1]));
        // A single place is in the middle of a square.
        let alone = PlaceMap::over([DVec3::X].into_iter());
        assert!(alone.x.count > 0 && alone.y.count > 0);
        let mut map = alone.empty();
        alone.mark(&mut map, [(DVec3::X, 1.0)].into_iter());
        assert_eq!(map.iter().filter(|value| **value == 1.0).count(), (2 * REACH + 1).pow(2));
    }
}
