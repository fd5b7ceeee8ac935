//! Reflectors cut into cells: boxes of neighbours, small enough for a few tones.
//!
//! Those that sound reaches by a detour have cells of their own, in which their transmit lengths differ by no more than their
//! places; and those that are not the same from everywhere, whose field is no smooth function of the microphone, have
//! others again.

use crate::acquisition::Instrument;
use crate::alloc::try_with_capacity;
use crate::reflectors::Reflectors;
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
    /// The middle of their transmit lengths, and half of what these differ by, m; `None` where sound comes straight to them.
    pub(super) transmit: Option<[f64; 2]>,
    /// Whether some are not the same from everywhere.
    pub(super) directive: bool,
}

/// Reflectors in an order in which those of a cell follow each other.
#[derive(Debug)]
pub(super) struct CellTree<'a> {
    reflectors: &'a Reflectors,
    pub(super) order: Vec<u32>,
    pub(super) cells: Vec<ReflectorCell>,
}

/// Cells of more reflectors than this are cut on two threads.
const SHARED: usize = 8192;

impl<'a> CellTree<'a> {
    /// One cell of all reflectors of a kind; `None` if they do not fit in memory.
    pub(super) fn new(reflectors: &'a Reflectors) -> Option<Self> {
        let count = u32::try_from(reflectors.len()).ok()?;
        let mut order: Vec<u32> = try_with_capacity(count.into())?;
        order.extend(0..count);
        let kind =
            |j: &u32| (reflectors.transmit(*j as usize).is_some(), reflectors.has_directivity(*j as usize));
        if !reflectors.transmit_lengths().is_empty() {
            // The sort is stable.
            order.sort_by_key(kind);
        }
        let mut cells: Vec<ReflectorCell> = Vec::new();
        for members in order.chunk_by(|a, b| kind(a) == kind(b)) {
            let first = cells.last().map_or(0, |cell| cell.members.end);
            cells.push(ReflectorCell::around(reflectors, members, first));
        }
        Some(Self { reflectors, order, cells })
    }

    /// Cells of all reflectors in an order, of which these are the members.
    pub(super) fn in_order(reflectors: &'a Reflectors, order: Vec<u32>, members: Vec<Range<usize>>) -> Self {
        let around =
            |members: Range<usize>| ReflectorCell::around(reflectors, &order[members.clone()], members.start);
        let cells = members.into_par_iter().map(around).collect();
        Self { reflectors, order, cells }
    }

    /// Cuts every cell of a larger radius, in m, until none is left.
    ///
    /// The cuts halve the number of reflectors along the longest side, and depend on nothing but places and transmit lengths. Cells of an
    /// earlier, larger radius remain valid: the order changes only within them. Cost: `n log n`.
    pub(super) fn cut(&mut self, radius: f64) {
        let (mut parts, mut rest) = (Vec::with_capacity(self.cells.len()), &mut self.order[..]);
        for cell in self.cells.drain(..) {
            let (members, later) = rest.split_at_mut(cell.members.len());
            parts.push((cell, members));
            rest = later;
        }
        let reflectors = self.reflectors;
        let cut = parts.into_par_iter().map(|(cell, members)| cell.cut(reflectors, members, radius));
        self.cells = cut.flatten_iter().collect();
    }
}

impl ReflectorCell {
    /// The cell of some reflectors of one kind.
    fn around(reflectors: &Reflectors, members: &[u32], first: usize) -> Self {
        let positions = reflectors.positions();
        let (low, high) = bounding_box(members.iter().map(|&j| positions[j as usize])).unwrap_or_default();
        let half = 0.5 * (high - low);
        let lengths = members.iter().filter_map(|&j| reflectors.transmit(j as usize));
        let ends = lengths.fold(None, |ends: Option<[f64; 2]>, length| {
            Some(ends.map_or([length; 2], |[least, most]| [least.min(length), most.max(length)]))
        });
        Self {
            members: first..first + members.len(),
            centre: low.midpoint(high),
            half,
            radius: half.length(),
            transmit: ends.map(|[least, most]| [f64::midpoint(least, most), 0.5 * (most - least)]),
            directive: members.first().is_some_and(|&j| reflectors.has_directivity(j as usize)),
        }
    }

    /// Whether cells are of one kind.
    pub(super) fn is_like(&self, other: &Self) -> bool {
        self.transmit.is_some() == other.transmit.is_some() && self.directive == other.directive
    }

    /// The length of the way of sound to its middle, m.
    pub(super) fn outward_length(&self, instrument: &Instrument) -> f64 {
        self.transmit.map_or_else(|| instrument.geometry.outward_length(self.centre), |[middle, _]| middle)
    }

    fn cut(self, reflectors: &Reflectors, members: &mut [u32], radius: f64) -> Vec<Self> {
        // Of straight paths the ways there differ by no more than the places.
        let spread = self.transmit.map_or(0.0, |[_, half]| half);
        if self.radius.max(spread) <= radius || members.len() < 2 {
            return vec![self];
        }
        let (middle, axis) = (members.len() / 2, self.half.max_position());
        let along = |j: u32| match reflectors.transmit(j as usize) {
            Some(length) if spread > self.half[axis] => length,
            _ => reflectors.positions()[j as usize][axis],
        };
        members.select_nth_unstable_by(middle, |&a, &b| along(a).total_cmp(&along(b)).then(a.cmp(&b)));
        let is_shared = members.len() > SHARED;
        let (before, after) = members.split_at_mut(middle);
        let first = self.members.start;
        let cut = |members: &mut [u32], first| {
            Self::around(reflectors, members, first).cut(reflectors, members, radius)
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
        let amplitudes = vec![num_complex::Complex32::ONE; positions.len()];
        let reflectors = Reflectors::new(positions.clone(), amplitudes).expect("finite");
        let mut tree = CellTree::new(&reflectors).expect("memory");
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
