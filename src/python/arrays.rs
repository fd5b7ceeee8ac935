//! NumPy arrays: handed over without a copy in both directions.

use crate::alloc::try_with_capacity;
use crate::error::{Error, Result};
use crate::grid::Axis;
use num_complex::Complex32;
use numpy::{Element, PyArray1, PyArrayDyn, PyArrayMethods, PyReadonlyArrayDyn, PyUntypedArrayMethods};
use pyo3::prelude::*;
use std::borrow::Cow;

/// An array of this shape that owns the values.
pub(super) fn array<T: Element>(
    py: Python<'_>,
    values: Vec<T>,
    shape: impl AsRef<[usize]>,
) -> PyResult<Bound<'_, PyArrayDyn<T>>> {
    PyArray1::from_vec(py, values).reshape(shape.as_ref())
}

/// The values of an array that is contiguous, in C order.
pub(super) fn values<'a, T: Element>(name: &str, array: &'a PyReadonlyArrayDyn<'_, T>) -> Result<&'a [T]> {
    array.as_slice().map_err(|_| Error::input(name, "was expected to be contiguous, in C order"))
}

/// Samples of a cube or a volume as Python gives them.
#[derive(FromPyObject)]
pub(super) enum Samples<'py> {
    /// In quadrature.
    Complex(PyReadonlyArrayDyn<'py, Complex32>),
    /// In phase.
    Real(PyReadonlyArrayDyn<'py, f32>),
}

impl Samples<'_> {
    /// The samples: borrowed if they are complex, otherwise with imaginary parts of zero.
    pub(super) fn complex(&self) -> Result<Cow<'_, [Complex32]>> {
        match self {
            Self::Complex(array) => Ok(Cow::Borrowed(values("samples", array)?)),
            Self::Real(array) => {
                let real = values("samples", array)?;
                let mut samples = try_with_capacity(real.len() as u64).ok_or_else(|| {
                    Error::out_of_memory("the complex form of in-phase samples does not fit in memory")
                })?;
                samples.extend(real.iter().map(|re| Complex32::new(*re, 0.0)));
                Ok(Cow::Owned(samples))
            }
        }
    }

    /// Whether they are complex.
    pub(super) fn are_complex(&self) -> bool {
        matches!(self, Self::Complex(_))
    }

    /// Lengths of the axes.
    pub(super) fn shape(&self) -> &[usize] {
        match self {
            Self::Complex(array) => array.shape(),
            Self::Real(array) => array.shape(),
        }
    }
}

/// An axis as the package's class `Axis` holds it.
#[derive(FromPyObject)]
pub(super) struct AxisParts {
    first: f64,
    pitch: f64,
    count: usize,
}

impl AxisParts {
    /// The axis.
    ///
    /// # Errors
    /// Numbers that are not finite, a pitch that is not positive, or no voxels at all; `name` is their place.
    pub(super) fn axis(&self, name: &str) -> Result<Axis> {
        let Self { first, pitch, count } = *self;
        let last = first + pitch * count.saturating_sub(1) as f64;
        if !(first.is_finite() && pitch > 0.0 && last.is_finite()) || count == 0 || count > u32::MAX as usize
        {
            let problem = format!(
                "needs a finite first centre, a positive pitch, both in m, and 1 to {} voxels, not {first}, {pitch} and {count}",
                u32::MAX
            );
            return Err(Error::input(name, problem));
        }
        Ok(Axis { first, pitch, count })
    }
}

/// First centre, pitch and count of an axis, for Python.
pub(super) type AxisTuple = (f64, f64, usize);

/// An axis for Python.
pub(super) fn axis_tuple(axis: &Axis) -> AxisTuple {
    (axis.first, axis.pitch, axis.count)
}
