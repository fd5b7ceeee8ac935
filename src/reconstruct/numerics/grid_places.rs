//! Points in columns, rows and depths that need not be evenly spaced.

use crate::grid::{Axis, Grid};
use glam::DVec3;
use std::ops::Range;
use std::sync::Arc;

/// Where the points of a grid are: evenly spaced, or along some axes wherever they are said to be.
#[derive(Debug, Clone)]
pub(crate) struct GridPlaces {
    grid: Grid,
    /// Along x, y and z, m.
    uneven: [Option<Arc<[f64]>>; 3],
}

impl GridPlaces {
    /// Those of a grid.
    pub(crate) fn even(grid: &Grid) -> Self {
        Self { grid: *grid, uneven: [None, None, None] }
    }

    /// Along some axes those of a list, as many as the grid has, ascending and nowhere farther apart than its pitch.
    pub(crate) fn uneven(grid: &Grid, uneven: [Option<&[f64]>; 3]) -> Self {
        Self { grid: *grid, uneven: uneven.map(|places| places.map(Arc::from)) }
    }

    /// How many there are, and by what they are apart at most.
    pub(crate) fn grid(&self) -> &Grid {
        &self.grid
    }

    /// Whether they are those of the grid.
    pub(crate) fn are_even(&self) -> bool {
        self.uneven.iter().all(Option::is_none)
    }

    /// As many points evenly between the same ends.
    pub(crate) fn evened(&self) -> Grid {
        let along = |axis: usize| {
            let (first, count) = (self.at(axis, 0), self.axis(axis).count);
            let pitch = match self.listed(axis) {
                Some(places) if count > 1 => (places[count - 1] - first) / (count - 1) as f64,
                _ => self.axis(axis).pitch,
            };
            Axis { first, pitch, count }
        };
        Grid { x: along(0), y: along(1), z: along(2) }
    }

    /// All along an axis, m.
    pub(crate) fn along(&self, axis: usize) -> Vec<f64> {
        (0..self.axis(axis).count).map(|index| self.at(axis, index)).collect()
    }

    /// Those along an axis that are said, if they are.
    pub(crate) fn listed(&self, axis: usize) -> Option<&[f64]> {
        self.uneven[axis].as_deref()
    }

    fn axis(&self, axis: usize) -> &Axis {
        [&self.grid.x, &self.grid.y, &self.grid.z][axis]
    }

    /// A place along an axis, m.
    pub(crate) fn at(&self, axis: usize, index: usize) -> f64 {
        self.listed(axis).map_or_else(|| self.axis(axis).position(index), |places| places[index])
    }

    /// A point, m.
    pub(crate) fn position(&self, [x, y, z]: [usize; 3]) -> DVec3 {
        DVec3::new(self.at(0, x), self.at(1, y), self.at(2, z))
    }

    /// Lower and upper corner of some depths.
    pub(crate) fn bounds(&self, depths: Range<usize>) -> (DVec3, DVec3) {
        let last = [self.grid.x.count - 1, self.grid.y.count - 1, depths.end - 1];
        (self.position([0, 0, depths.start]), self.position(last))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_are_where_a_list_says_and_else_those_of_the_grid() {
        let axis = |first: f64, count: usize| Axis { first, pitch: 0.5, count };
        let grid = Grid { x: axis(-1.0, 5), y: axis(0.0, 2), z: axis(2.0, 3) };
        let even = GridPlaces::even(&grid);
        assert!(even.are_even() && even.position([4, 1, 2]) == grid.position(4, 1, 2));
        assert_eq!(even.bounds(1..3), (DVec3::new(-1.0, 0.0, 2.5), DVec3::new(1.0, 0.5, 3.0)));
        let places = GridPlaces::uneven(&grid, [None, None, Some(&[2.1, 2.2, 2.6])]);
        assert!(!places.are_even() && places.listed(0).is_none() && places.listed(2).is_some());
        assert_eq!(places.position([4, 1, 2]), grid.position(4, 1, 0).with_z(2.6));
        assert_eq!(places.bounds(0..2), (DVec3::new(-1.0, 0.0, 2.1), DVec3::new(1.0, 0.5, 2.2)));
        assert_eq!((even.evened(), places.along(2)), (grid, vec![2.1, 2.2, 2.6]));
        let evened = places.evened();
        assert!((evened.x, evened.y, evened.z.first, evened.z.count) == (grid.x, grid.y, 2.1, 3));
        assert!((evened.z.last() - 2.6).abs() < 1e-12);
    }
}
