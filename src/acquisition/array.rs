//! The microphones: a rectangular lattice or scattered positions.

mod formulas;
mod position_file;
mod scattered;
mod tiles;

pub use formulas::PositionFormulas;
pub(crate) use formulas::check_formula;
pub(super) use position_file::read_positions;
pub(crate) use scattered::RANDOM_BYTES;
pub(crate) use tiles::{Tile, halvings, tiles};

use crate::error::{Error, Result};
use crate::grid::Axis;
use crate::scene::FARTHEST;
use crate::wave::bounding_box;
use glam::{DMat3, DVec3};
use std::sync::Arc;

/// A rectangular lattice of microphones in a plane of constant z.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Lattice {
    /// Columns.
    pub x: Axis,
    /// Rows.
    pub y: Axis,
    /// Height of the plane, m.
    pub z: f64,
}

/// Microphone positions r, in m. Clones share their list.
#[derive(Debug, Clone, PartialEq)]
pub struct MicArray {
    positions: Arc<Vec<DVec3>>,
    lattice: Option<Lattice>,
    /// Minimum and maximum coordinates, m.
    bounds: (DVec3, DVec3),
}

/// Maximum number of microphones.
const MOST_MICROPHONES: usize = 1 << 24;

/// An invalid array; its place is "array" unless the caller names another.
fn invalid(problem: impl Into<String>) -> Error {
    Error::input("array", problem)
}

fn refused<T>(problem: impl Into<String>) -> Result<T> {
    Err(invalid(problem))
}

impl MicArray {
    fn new(positions: Vec<DVec3>, lattice: Option<Lattice>) -> Self {
        let bounds = bounding_box(positions.iter().copied()).unwrap_or_default();
        Self { positions: Arc::new(positions), lattice, bounds }
    }

    /// `count` = [columns, rows] microphones at the given pitch about `centre`, parallel to z = 0.
    ///
    /// # Errors
    /// No microphones or more than 2²⁴, a pitch that is not positive, a centre that is not finite, or microphones beyond
    /// [`FARTHEST`]. The error's place is "array"; [`Error::at`] replaces it with a file or key.
    ///
    /// ```
    /// use holosonar::glam::DVec3;
    /// use holosonar::acquisition::MicArray;
    ///
    /// let array = MicArray::rectangular([31, 21], [0.03, 0.05], DVec3::ZERO)?;
    /// assert_eq!((array.len(), array.shape()), (651, vec![21, 31]));
    /// assert!((array.extent() - DVec3::new(0.9, 1.0, 0.0)).length() < 1e-12);
    /// # Ok::<(), holosonar::error::Error>(())
    /// ```
    pub fn rectangular(count: [usize; 2], pitch: [f64; 2], centre: DVec3) -> Result<Self> {
        check_count(count[0].saturating_mul(count[1]))?;
        if !(centre.is_finite() && pitch.iter().all(|p| p.is_finite() && *p > 0.0)) {
            return refused("the pitch must be positive and the centre finite, in metres");
        }
        let axis = |n: usize, pitch: f64, centre: f64| Axis {
            first: centre - 0.5 * (n - 1) as f64 * pitch,
            pitch,
            count: n,
        };
        let lattice = Lattice {
            x: axis(count[0], pitch[0], centre.x),
            y: axis(count[1], pitch[1], centre.y),
            z: centre.z,
        };
        if lattice.x.first.abs().max(lattice.y.first.abs()).max(lattice.z.abs()) > FARTHEST {
            return too_far("the first microphone", DVec3::new(lattice.x.first, lattice.y.first, lattice.z));
        }
        let positions = (0..count[1])
            .flat_map(|iy| {
                (0..count[0])
                    .map(move |ix| DVec3::new(lattice.x.position(ix), lattice.y.position(iy), lattice.z))
            })
            .collect();
        Ok(Self::new(positions, Some(lattice)))
    }

    /// Microphones anywhere, in any order.
    ///
    /// # Errors
    /// No positions or more than 2²⁴, positions that are not finite or beyond [`FARTHEST`]; the error's place is "array".
    ///
    /// ```
    /// use holosonar::glam::DVec3;
    /// use holosonar::acquisition::MicArray;
    ///
    /// let ring = |i: u32| DVec3::from((glam::DVec2::from_angle(f64::from(i) * 0.1) * 0.5, 0.0));
    /// let array = MicArray::from_positions((0..63).map(ring).collect())?;
    /// assert!(array.lattice().is_none());
    /// # Ok::<(), holosonar::error::Error>(())
    /// ```
    pub fn from_positions(positions: Vec<DVec3>) -> Result<Self> {
        check_positions(&positions)?;
        Ok(Self::new(positions, None))
    }

    /// Rows of microphones, `[n_y, n_x]` positions, row by row. If they form a regular rectangular lattice, it is
    /// recognised, so that methods which need one can be used.
    ///
    /// # Errors
    /// As [`MicArray::from_positions`]; a shape that the positions do not fill.
    pub fn from_rows(shape: [usize; 2], positions: Vec<DVec3>) -> Result<Self> {
        let [n_y, n_x] = shape;
        if n_y.checked_mul(n_x) != Some(positions.len()) {
            return refused(format!("{} positions do not fill the shape {shape:?}", positions.len()));
        }
        check_positions(&positions)?;
        let lattice = recognise(n_x, n_y, &positions);
        Ok(Self::new(positions, lattice))
    }

    /// All positions, a lattice's row by row, m.
    pub fn positions(&self) -> &[DVec3] {
        &self.positions
    }

    /// Number of microphones.
    pub fn len(&self) -> usize {
        self.positions.len()
    }

    /// Always false: an array has at least one microphone.
    pub fn is_empty(&self) -> bool {
        self.positions.is_empty()
    }

    /// The lattice that the microphones form, if any.
    pub fn lattice(&self) -> Option<&Lattice> {
        self.lattice.as_ref()
    }

    /// `[n_y, n_x]` for a lattice, `[n_mic]` otherwise: the shape of one frequency's samples.
    pub fn shape(&self) -> Vec<usize> {
        self.lattice.map_or_else(|| vec![self.len()], |lattice| vec![lattice.y.count, lattice.x.count])
    }

    /// Minimum and maximum coordinates, m.
    pub fn bounds(&self) -> (DVec3, DVec3) {
        self.bounds
    }

    /// First to last microphone along x, y, z, m.
    pub fn extent(&self) -> DVec3 {
        let (low, high) = self.bounds();
        high - low
    }

    /// Middle of the bounding box, m.
    pub fn centre(&self) -> DVec3 {
        let (low, high) = self.bounds();
        low.midpoint(high)
    }

    /// Number of the microphone that is nearest to a point of its plane, the first of several; m.
    pub fn nearest(&self, [x, y]: [f64; 2]) -> usize {
        let distance = |r: &DVec3| (r.x - x).hypot(r.y - y);
        let nearer = |a: usize, b: usize| distance(&self.positions[b]) < distance(&self.positions[a]);
        (1..self.len()).fold(0, |best, r| if nearer(best, r) { r } else { best })
    }

    /// The microphones turned about their centre by angles in degrees, about x and then about y, axes that stay.
    ///
    /// # Errors
    /// As [`MicArray::from_positions`].
    pub fn tilted(&self, degrees: [f64; 2]) -> Result<Self> {
        let [about_x, about_y] = degrees.map(f64::to_radians);
        let (turn, centre) =
            (DMat3::from_rotation_y(about_y) * DMat3::from_rotation_x(about_x), self.centre());
        self.with_positions(self.positions.iter().map(|r| centre + turn * (*r - centre)).collect())
    }

    /// As many microphones at other places, m; a lattice that they form row by row is recognised.
    ///
    /// # Errors
    /// As [`MicArray::from_rows`].
    pub(crate) fn with_positions(&self, positions: Vec<DVec3>) -> Result<Self> {
        match self.shape()[..] {
            [n_y, n_x] => Self::from_rows([n_y, n_x], positions),
            _ => Self::from_positions(positions),
        }
    }

    /// 3 × 3 points spread evenly over the array, from which the visibility of a reflector is tested.
    pub(crate) fn sight_points(&self) -> [DVec3; 9] {
        let (low, high) = self.bounds();
        std::array::from_fn(|i| {
            // The middle of each third represents an equal share of the aperture.
            let t = |k: usize| (2 * k + 1) as f64 / 6.0;
            DVec3::new(
                low.x + t(i % 3) * (high.x - low.x),
                low.y + t(i / 3) * (high.y - low.y),
                f64::midpoint(low.z, high.z),
            )
        })
    }
}

/// Rejects an array without microphones or with too many.
fn check_count(count: usize) -> Result<()> {
    if (1..=MOST_MICROPHONES).contains(&count) {
        return Ok(());
    }
    refused(format!("{count} microphones are not possible; 1 to {MOST_MICROPHONES} are"))
}

/// Rejects positions that do not make an array.
fn check_positions(positions: &[DVec3]) -> Result<()> {
    check_count(positions.len())?;
    if let Some(bad) = positions.iter().position(|r| !r.is_finite()) {
        return refused(format!("position {bad} is not finite: {:?}", positions[bad]));
    }
    if let Some(bad) = positions.iter().position(|r| r.abs().max_element() > FARTHEST) {
        return too_far(&format!("position {bad}"), positions[bad]);
    }
    Ok(())
}

/// The error for a microphone that is too far away.
fn too_far<T>(which: &str, r: DVec3) -> Result<T> {
    refused(format!("{which}, at {r} m, is beyond {FARTHEST:e} m; lengths are in metres"))
}

/// The lattice that `positions` form to within 10⁻⁶ of its pitch, if there is one.
fn recognise(n_x: usize, n_y: usize, positions: &[DVec3]) -> Option<Lattice> {
    let first = positions[0];
    let axis = |n: usize, first: f64, last: f64| -> Option<Axis> {
        // A single column or row has no pitch; any positive number will do.
        let pitch = if n == 1 { 1.0 } else { (last - first) / (n - 1) as f64 };
        (pitch > 0.0).then_some(Axis { first, pitch, count: n })
    };
    let lattice = Lattice {
        x: axis(n_x, first.x, positions[n_x - 1].x)?,
        y: axis(n_y, first.y, positions[positions.len() - n_x].y)?,
        z: first.z,
    };
    let near = |a: f64, b: f64, pitch: f64| (a - b).abs() <= 1e-6 * pitch.min(0.1);
    let regular = positions.iter().enumerate().all(|(i, r)| {
        near(r.x, lattice.x.position(i % n_x), lattice.x.pitch)
            && near(r.y, lattice.y.position(i / n_x), lattice.y.pitch)
            && near(r.z, lattice.z, lattice.x.pitch)
    });
    regular.then_some(lattice)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_rectangular_array_is_recognised_from_its_positions() {
        let made = MicArray::rectangular([13, 11], [0.008, 0.01], DVec3::new(0.1, -0.2, 0.0)).expect("ok");
        let read = MicArray::from_rows([11, 13], made.positions().to_vec()).expect("ok");
        let (a, b) = (made.lattice().expect("lattice"), read.lattice().expect("lattice"));
        assert_eq!((a.x.count, a.y.count), (b.x.count, b.y.count));
        assert!((a.x.pitch - b.x.pitch).abs() < 1e-12 && (a.y.first - b.y.first).abs() < 1e-12);
        assert!((made.centre() - DVec3::new(0.1, -0.2, 0.0)).length() < 1e-12);
        assert!((made.extent() - DVec3::new(0.096, 0.1, 0.0)).length() < 1e-12);
    }

    #[test]
    fn a_jittered_array_is_not_a_lattice() {
        let mut positions =
            MicArray::rectangular([5, 4], [0.01, 0.01], DVec3::ZERO).expect("ok").positions().to_vec();
        positions[7].x += 1e-5;
        let array = MicArray::from_rows([4, 5], positions).expect("ok");
        assert!(array.lattice().is_none());
        assert_eq!(array.shape(), [20]);
    }

    #[test]
    fn absurd_arrays_are_refused() {
        assert!(MicArray::rectangular([0, 4], [0.01, 0.01], DVec3::ZERO).is_err());
        assert!(MicArray::rectangular([usize::MAX, 4], [0.01, 0.01], DVec3::ZERO).is_err());
        assert!(MicArray::rectangular([4, 4], [0.0, 0.01], DVec3::ZERO).is_err());
        assert!(MicArray::from_positions(vec![DVec3::ZERO, DVec3::NAN]).is_err());
        assert!(MicArray::from_positions(vec![]).is_err());
        for shape in [[1, 3], [0, 0], [usize::MAX, 2]] {
            assert!(MicArray::from_rows(shape, vec![DVec3::ZERO]).is_err());
        }
    }
}
