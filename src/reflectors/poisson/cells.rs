//! The cells by which samples are found that may be too close.

use super::{Candidate, NONE};
use crate::alloc::{try_filled, try_with_capacity};
use crate::reflectors::Sample;
use glam::{DVec3, I64Vec3};
use rayon::prelude::*;
use rustc_hash::FxHashMap;

/// Two samples are neighbours on one surface when their normals agree within 60°: the two sides of a thin plate, or
/// walls that meet in an edge, are sampled independently.
pub(super) const SAME_SURFACE: f64 = 0.5;

/// Accepted samples in cubic cells one spacing wide, of which only those with candidates exist.
#[derive(Debug)]
pub(super) struct Cells {
    spacing: f64,
    pub(super) samples: Vec<Sample>,
    /// The latest sample of each cell, and for each sample the previous one of its cell.
    last: Vec<u32>,
    before: Vec<u32>,
    /// The cell itself, then the 26 around it; [`NONE`] for those without candidates.
    neighbours: Vec<[u32; 27]>,
    /// Position of the cell, in spacings.
    places: Vec<I64Vec3>,
}

/// Steps to a cell's neighbours: itself, then those that share a face, an edge, a corner.
fn steps() -> [I64Vec3; 27] {
    let mut steps: [I64Vec3; 27] =
        std::array::from_fn(|i| I64Vec3::new(i as i64 % 3 - 1, i as i64 / 3 % 3 - 1, i as i64 / 9 - 1));
    steps.sort_by_key(|step| step.length_squared());
    steps
}

impl Cells {
    /// Makes the cells of the candidates and assigns each candidate its own; `None` when they do not fit in memory.
    pub(super) fn new(candidates: &mut [Candidate], spacing: f64) -> Option<Self> {
        let mut known: FxHashMap<I64Vec3, u32> = FxHashMap::default();
        let mut places = Vec::new();
        let mut latest = None;
        for c in &mut *candidates {
            let place = (c.position / spacing).floor().as_i64vec3();
            c.cell = match latest {
                // Candidates come triangle by triangle, often several to a cell.
                Some((before, cell)) if before == place => cell,
                _ => {
                    known.try_reserve(1).ok()?;
                    places.try_reserve(1).ok()?;
                    *known.entry(place).or_insert_with(|| {
                        places.push(place);
                        places.len() as u32 - 1
                    })
                }
            };
            latest = Some((place, c.cell));
        }
        // Side by side in memory where they are so in space.
        let mut sorted: Vec<u32> = try_with_capacity(places.len() as u64)?;
        sorted.extend(0..places.len() as u32);
        sorted.par_sort_unstable_by_key(|cell| places[*cell as usize].to_array());
        let mut number = try_filled(NONE, places.len() as u64)?;
        (0..).zip(&sorted).for_each(|(new, cell)| number[*cell as usize] = new);
        candidates.par_iter_mut().for_each(|c| c.cell = number[c.cell as usize]);
        let mut in_order: Vec<I64Vec3> = try_with_capacity(places.len() as u64)?;
        in_order.par_extend(sorted.par_iter().map(|cell| places[*cell as usize]));
        let places = in_order;
        let steps = steps();
        let around = |place: &I64Vec3| {
            // Beyond the range of i64 there are no cells.
            steps.map(|step| {
                let beside = place.checked_add(step).and_then(|beside| known.get(&beside));
                beside.map_or(NONE, |cell| number[*cell as usize])
            })
        };
        let mut neighbours = try_with_capacity(places.len() as u64)?;
        neighbours.par_extend(places.par_iter().map(around));
        let last = try_filled(NONE, places.len() as u64)?;
        Some(Self { spacing, samples: Vec::new(), last, before: Vec::new(), neighbours, places })
    }

    /// Makes a candidate a sample; `None` when it does not fit in memory.
    pub(super) fn take(&mut self, c: &Candidate) -> Option<()> {
        self.samples.try_reserve(1).ok()?;
        self.before.try_reserve(1).ok()?;
        let index = self.samples.len() as u32;
        self.before.push(std::mem::replace(&mut self.last[c.cell as usize], index));
        self.samples.push(Sample { position: c.position, triangle: c.triangle, area: 0.0 });
        Some(())
    }

    /// The samples of a cell.
    fn members(&self, cell: u32) -> impl Iterator<Item = u32> {
        let known = |index: u32| (index != NONE).then_some(index);
        let last = known(cell).and_then(|cell| known(self.last[cell as usize]));
        std::iter::successors(last, move |index| known(self.before[*index as usize]))
    }

    /// Whether a sample of the candidate's surface is closer than the spacing.
    pub(super) fn is_taken(&self, c: &Candidate, normals: &[DVec3]) -> bool {
        let normal = normals[c.triangle as usize];
        self.neighbours[c.cell as usize].iter().any(|&cell| {
            self.members(cell).any(|index| {
                let other = &self.samples[index as usize];
                other.position.distance_squared(c.position) < self.spacing * self.spacing
                    && normals[other.triangle as usize].dot(normal) > SAME_SURFACE
            })
        })
    }

    /// The nearest sample of the candidate's surface that is closer than the spacing; there must be one.
    pub(super) fn nearest(&self, c: &Candidate, normals: &[DVec3]) -> u32 {
        let normal = normals[c.triangle as usize];
        let (mut least, mut nearest) = (self.spacing * self.spacing, NONE);
        for &cell in &self.neighbours[c.cell as usize] {
            if cell == NONE || self.distance_squared(cell, c.position) > least {
                continue;
            }
            for index in self.members(cell) {
                let other = &self.samples[index as usize];
                let distance = other.position.distance_squared(c.position);
                if distance < least && normals[other.triangle as usize].dot(normal) > SAME_SURFACE {
                    (least, nearest) = (distance, index);
                }
            }
        }
        nearest
    }

    /// A little less than the squared distance from `p` to a cell, so that rounding leaves none out.
    fn distance_squared(&self, cell: u32, p: DVec3) -> f64 {
        let low = self.places[cell as usize].as_dvec3() * self.spacing;
        let gap = (low - p).max(p - low - self.spacing).max(DVec3::ZERO);
        gap.length_squared() * (1.0 - 1e-6)
    }
}
