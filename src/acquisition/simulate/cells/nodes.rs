//! Nodes in the box of a panel of microphones, at which the field of a cell is summed, and its values elsewhere.
//!
//! With the path of its centre taken out, the field of a cell is a smooth function of the microphone's position: a
//! product of Chebyshev points along each axis determines it. How many are needed follows from the Chebyshev coefficients of
//! the fastest such fields, those of the corners of the cell's box, along lines through the panel.

use super::tree::ReflectorCell;
use crate::acquisition::Tile;
use crate::wave::corners;
use crate::wave::interval::{chebyshev_point, phasor_f64};
use glam::DVec3;
use num_complex::Complex64;
use std::f64::consts::PI;

/// Points on a line through the panel, and so an upper bound of the nodes along an axis.
const SAMPLED: usize = 24;

/// The nearest cell, in radii of the cell from the panel's box, whose field is interpolated.
const NEAREST: f64 = 4.0;

/// How many nodes fields need.
#[derive(Debug)]
pub(super) struct NodeRule {
    /// Cycles of the return path per metre of leg, at the highest frequency.
    per_metre: f64,
    /// Maximum error along an axis.
    tolerance: f64,
    /// By how much cells are taken to be larger, m.
    wider: f64,
    /// Where the legs that move with a microphone end, from it, m.
    ends: Vec<DVec3>,
    /// `cos πj(k + ½)/n`, `[j][k]`.
    cosines: Vec<f64>,
}

/// A box of microphones: its centre and half its sides, m.
#[derive(Debug, Clone, Copy)]
pub(super) struct PanelBox {
    pub(super) centre: DVec3,
    pub(super) half: DVec3,
}

impl NodeRule {
    /// Of legs to the microphones alone; for others see [`NodeRule::with_ends`].
    pub(super) fn new(per_metre: f64, tolerance: f64, wider: f64) -> Self {
        let cosine = |i: usize| {
            let (j, k) = (i / SAMPLED, i % SAMPLED);
            (PI * j as f64 * (k as f64 + 0.5) / SAMPLED as f64).cos()
        };
        let cosines = (0..SAMPLED * SAMPLED).map(cosine).collect();
        Self { per_metre, tolerance, wider, ends: vec![DVec3::ZERO], cosines }
    }

    /// With the ends of the legs that move with a microphone, from it, m.
    pub(super) fn with_ends(self, ends: impl Iterator<Item = DVec3>) -> Self {
        Self { ends: ends.collect(), ..self }
    }

    /// Numbers of nodes along x, y and z for a cell at a panel; `None` where it is too close or too large to be interpolated, or
    /// its field is not smooth.
    pub(super) fn counts(&self, cell: &ReflectorCell, panel: &PanelBox) -> Option<[usize; 3]> {
        if cell.directive {
            return None;
        }
        // The microphones whose ends are nearest.
        let [low, high] = [panel.centre - panel.half, panel.centre + panel.half];
        let nearest: Vec<DVec3> = self.ends.iter().map(|end| (cell.centre - *end).clamp(low, high)).collect();
        let too_close = |(end, r): (&DVec3, &DVec3)| cell.centre.distance(*r + *end) <= NEAREST * cell.radius;
        if self.ends.iter().zip(&nearest).any(too_close) {
            return None;
        }
        let mut counts = [1; 3];
        for (axis, count) in counts.iter_mut().enumerate() {
            if panel.half[axis] > 0.0 {
                *count = self.along(axis, cell, panel, &nearest)?;
            }
        }
        Some(counts)
    }

    /// The same; `None` also where the panel has no more microphones than it would have nodes.
    pub(super) fn counts_for(
        &self,
        cell: &ReflectorCell,
        panel: &PanelBox,
        microphones: usize,
    ) -> Option<[usize; 3]> {
        self.counts(cell, panel).filter(|counts| counts.iter().product::<usize>() < microphones)
    }

    fn along(&self, axis: usize, cell: &ReflectorCell, panel: &PanelBox, nearest: &[DVec3]) -> Option<usize> {
        let mut largest = [0.0f64; SAMPLED];
        // The fields of opposite corners are conjugate to first order.
        let half = cell.half + self.wider;
        let corners = corners((cell.centre - half, cell.centre + half));
        let legs = |p: DVec3, r: DVec3| self.ends.iter().map(|end| p.distance(r + *end)).sum::<f64>();
        let ends = [panel.centre - panel.half, panel.centre + panel.half];
        for beside in ends.iter().chain(nearest) {
            let mut fields = [[Complex64::ZERO; SAMPLED]; 4];
            for k in 0..SAMPLED {
                let mut r = *beside;
                r[axis] = panel.centre[axis] + panel.half[axis] * chebyshev_point(k, SAMPLED);
                let middle = legs(cell.centre, r);
                for (field, p) in fields.iter_mut().zip(&corners) {
                    field[k] = phasor_f64(self.per_metre * (legs(*p, r) - middle));
                }
            }
            for field in &fields {
                for (largest, cosines) in largest.iter_mut().zip(self.cosines.chunks_exact(SAMPLED)) {
                    let sum: Complex64 = field.iter().zip(cosines).map(|(z, cos)| z * cos).sum();
                    *largest = largest.max(2.0 / SAMPLED as f64 * sum.norm());
                }
            }
        }
        // What is beyond the last node is lost, and once more mistaken for what is before it.
        let mut error = 0.0;
        let beyond = |j: &usize| {
            error += 2.0 * largest[*j];
            error <= self.tolerance
        };
        let lost = (0..SAMPLED).rev().take_while(beyond).count();
        // The sampled lines would not show what is beyond them.
        (lost > 1).then(|| (SAMPLED - lost).max(1))
    }
}

impl PanelBox {
    /// That of a panel's microphones.
    pub(super) const fn of(panel: &Tile) -> Self {
        Self { centre: panel.centre, half: panel.half }
    }

    /// The places of nodes, x fastest.
    pub(super) fn nodes(&self, counts: [usize; 3]) -> Vec<DVec3> {
        let place =
            |axis: usize, k: usize| self.centre[axis] + self.half[axis] * chebyshev_point(k, counts[axis]);
        let [nx, ny, nz] = counts;
        let all = (0..nz).flat_map(|z| (0..ny).flat_map(move |y| (0..nx).map(move |x| [x, y, z])));
        all.map(|[x, y, z]| DVec3::new(place(0, x), place(1, y), place(2, z))).collect()
    }

    /// The weights of `count` nodes along an axis for a place of the box.
    pub(super) fn weights(&self, axis: usize, count: usize, position: f64) -> Vec<f64> {
        if count == 1 {
            return vec![1.0];
        }
        let place = (position - self.centre[axis]) / self.half[axis];
        let away = |k: usize| place - chebyshev_point(k, count);
        if let Some(hit) = (0..count).find(|&k| away(k).abs() < 1e-14) {
            return (0..count).map(|k| if k == hit { 1.0 } else { 0.0 }).collect();
        }
        // The barycentric formula of Chebyshev points.
        let share = |k: usize| {
            let sine = (PI * (k as f64 + 0.5) / count as f64).sin();
            (if k.is_multiple_of(2) { sine } else { -sine }) / away(k)
        };
        let shares: Vec<f64> = (0..count).map(share).collect();
        let sum: f64 = shares.iter().sum();
        shares.iter().map(|share| share / sum).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fields_of_cells_are_interpolated_to_within_the_tolerance() {
        let panel = PanelBox { centre: DVec3::new(0.1, 0.0, 0.0), half: DVec3::new(0.5, 0.3, 0.01) };
        let mut found = Vec::new();
        for (place, size, tolerance) in [
            (DVec3::new(0.0, 0.1, 1.5), 0.02, 1e-6),
            (DVec3::new(0.9, -0.4, 0.8), 0.01, 1e-7),
            (DVec3::new(0.3, 0.2, 4.0), 0.1, 1e-4),
        ] {
            let half = DVec3::new(size, 0.7 * size, 0.5 * size);
            let cell = ReflectorCell {
                members: 0..1,
                centre: place,
                half,
                radius: half.length(),
                transmit: None,
                directive: false,
            };
            let counts = NodeRule::new(58.0, tolerance, 0.0).counts(&cell, &panel).expect("far enough");
            found.push(counts);
            // Of the legs to both ends of a pair, too.
            for ends in [vec![DVec3::ZERO], vec![DVec3::ZERO, DVec3::new(0.2, -0.05, 0.01)]] {
                let rule = NodeRule::new(58.0, tolerance, 0.0).with_ends(ends.clone().into_iter());
                let counts = rule.counts(&cell, &panel).expect("far enough");
                let nodes = panel.nodes(counts);
                let legs = |p: DVec3, r: DVec3| ends.iter().map(|end| p.distance(r + *end)).sum::<f64>();
                let field = |p: DVec3, r: DVec3| phasor_f64(58.0 * (legs(p, r) - legs(place, r)));
                let t = |i: usize, k: f64| 2.0 * (i as f64 * k).fract() - 1.0;
                let mut worst = 0.0f64;
                for i in 0..300 {
                    let at = |k: f64| DVec3::new(t(i, k), t(i, k + 0.21), t(i, k + 0.37));
                    let (r, p) = (panel.centre + panel.half * at(0.618), place + half * at(0.755));
                    let weights = [0, 1, 2].map(|axis| panel.weights(axis, counts[axis], r[axis]));
                    let sum: Complex64 = nodes
                        .iter()
                        .enumerate()
                        .map(|(n, node)| {
                            let (x, y, z) =
                                (n % counts[0], n / counts[0] % counts[1], n / counts[0] / counts[1]);
                            field(p, *node) * weights[0][x] * weights[1][y] * weights[2][z]
                        })
                        .sum();
                    worst = worst.max((sum - field(p, r)).norm());
                }
                assert!(worst <= 2.0 * tolerance, "{counts:?} for {tolerance:e}: {worst:e}");
                assert!(worst >= 1e-3 * tolerance, "{counts:?} are too many for {tolerance:e}: {worst:e}");
            }
        }
        assert!(found.iter().all(|[x, y, z]| x >= y && y > z && *z >= 2), "{found:?}");
    }

    #[test]
    fn what_touches_a_panel_is_not_interpolated() {
        let panel = PanelBox { centre: DVec3::ZERO, half: DVec3::new(0.5, 0.5, 0.0) };
        let rule = NodeRule::new(58.0, 1e-6, 0.0);
        let cell = |z: f64, size: f64| {
            let half = DVec3::splat(size);
            ReflectorCell {
                members: 0..1,
                centre: DVec3::new(0.1, 0.2, z),
                half,
                radius: half.length(),
                transmit: None,
                directive: false,
            }
        };
        assert!(rule.counts(&cell(0.05, 0.01), &panel).is_none());
        assert!(rule.counts(&cell(1.5, 0.3), &panel).is_none());
        let counts = rule.counts(&cell(1.5, 0.01), &panel).expect("far enough");
        assert!(counts[0] > 6 && counts[2] == 1, "{counts:?}");
    }
}
