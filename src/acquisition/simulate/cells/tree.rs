//! Reflectors cut into cells: boxes of neighbours, small enough for a few tones.

use crate::alloc::try_with_capacity;
use crate::wave::bounding_box;
use glam::DVec3;
use rayon::prelude::*;
use std::ops::Range;

/// Neighbouring reflectors.
#[derive(Debug, Clone)]
pub(super) struct ReflectorCell {
    /// Where they are in the order of the cells.
    pub(super) members: Range<usize>,
    /// Middle of their box, m.
    pub(super) centre: DVec3,
    /// Half the box, m.
    pub(super) half: DVec3,
    /// Upper bound of their distance from the centre, m.
    pub(super) radius: f64,
}

/// Reflectors in an order in which those of a cell follow each other.
#[derive(Debug)]
pub(super) struct CellTree<'a> {
    positions: &'a [DVec3],
    pub(super) order: Vec<u32>,
    pub(super) cells: Vec<ReflectorCell>,
}

/// Cells of more reflectors than this are cut on two threads.
const SHARED: usize = 8192;

impl<'a> CellTree<'a> {
    /// One cell of all reflectors; `None` if they do not fit in memory.
    pub(super) fn new(positions: &'a [DVec3]) -> Option<Self> {
        let mut order = try_with_capacity(positions.len() as u64)?;
        order.extend(0..u32::try_from(positions.len()).ok()?);
        let cells = vec![ReflectorCell::around(positions, &order, 0)];
        Some(Self { positions, order, cells })
    }

    /// Cuts every cell of a larger radius, in m, until none is left.
    ///
    /// The cuts halve the number of reflectors along the longest side, and depend on nothing but positions. Cells of an
    /// earlier, larger radius remain valid: the order changes only within them. Cost: `n log n`.
    pub(super) fn cut(&mut self, radius: f64) {
        let (mut parts, mut rest) = (Vec::with_capacity(self.cells.len()), &mut self.order[..]);
        for cell in self.cells.drain(..) {
            let (members, later) = rest.split_at_mut(cell.members.len());
            parts.push((cell, members));
            rest = later;
        }
        let positions = self.positions;
        let cut = parts.into_par_iter().map(|(cell, members)| cell.cut(positions, members, radius));
        self.cells = cut.flatten_iter().collect();
    }
}

impl ReflectorCell {
    fn around(positions: &[DVec3], members: &[u32], first: usize) -> Self {
        let (low, high) = bounding_box(members.iter().map(|&j| positions[j as usize])).unwrap_or_default();
        let half = 0.5 * (high - low);
        Self {
            members: first..first + members.len(),
            centre: low.midpoint(high),
            half,
            radius: half.length(),
        }
    }

    fn cut(self, positions: &[DVec3], members: &mut [u32], radius: f64) -> Vec<Self> {
        if self.radius <= radius || members.len() < 2 {
            return vec![self];
        }
        let (middle, axis) = (members.len() / 2, self.half.max_position());
        members.select_nth_unstable_by(middle, |&a, &b| {
            let [p, q] = [a, b].map(|j| positions[j as usize][axis]);
            p.total_cmp(&q).then(a.cmp(&b))
        });
        let is_shared = members.len() > SHARED;
        let (before, after) = members.split_at_mut(middle);
        let first = self.members.start;
        let cut = |members: &mut [u32], first| {
            Self::around(positions, members, first).cut(positions, members, radius)
        };
        let (mut cells, others) = if is_shared {
            rayon::join(|| cut(before, first), || cut(after, first + middle))
        } else {
            (cut(before, first), cut(after, first + middle))
        };
        cells.extend(others);
        cells
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_reflector_is_in_one_cell_that_is_small_enough() {
        let t = |i: usize, k: f64| (i as f64 * k).fract();
        let positions: Vec<DVec3> = (0..20_000)
            .map(|i| DVec3::new(t(i, 0.618_034), 0.4 * t(i, 0.754_878), 0.1 * t(i, 0.569_84)))
            .chain([DVec3::new(90.0, 0.0, 3.0), DVec3::ZERO, DVec3::ZERO])
            .collect();
        let mut tree = CellTree::new(&positions).expect("memory");
        let mut larger = tree.cells.clone();
        for radius in [0.3, 0.1, 0.04, 0.0] {
            tree.cut(radius);
            let mut seen = tree.order.clone();
            seen.sort_unstable();
            assert!(seen.into_iter().eq(0..positions.len() as u32));
            let mut next = 0;
            for cell in &tree.cells {
                assert_eq!(cell.members.start, next);
                next = cell.members.end;
                assert!(cell.radius <= radius && !cell.members.is_empty());
            }
            assert_eq!(next, positions.len());
            // Those of the radius before are still cells.
            for cell in larger.iter().chain(&tree.cells) {
                for &j in &tree.order[cell.members.clone()] {
                    assert!(positions[j as usize].distance(cell.centre) <= cell.radius + 1e-12);
                }
            }
            assert!(tree.cells.len() > larger.len());
            larger.clone_from(&tree.cells);
        }
    }
}
