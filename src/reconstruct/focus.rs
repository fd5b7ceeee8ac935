//! One thread's work on the depths of a volume, in two dimensions or in one.

use super::layout::Layout;
use super::line::Line;
use super::plane::Plane;
use crate::error::Result;
use crate::grid::no_room_for;
use crate::wave::simd::Lanes;
use num_complex::Complex32;
use std::sync::{Mutex, MutexGuard, PoisonError};

/// Geometry of one depth, and buffers that are used again and again.
#[derive(Debug)]
pub(super) enum Focus<'a> {
    Plane(Plane<'a>),
    Line(Line<'a>),
}

/// Buffers of all threads, kept from one slab to the next: what is given back and asked for again has to be cleared, and
/// a large one mapped again.
#[derive(Debug)]
pub(super) struct Focuses<'a> {
    layout: &'a Layout<'a>,
    idle: Mutex<Vec<Focus<'a>>>,
}

/// One of them, while a thread has it.
#[derive(Debug)]
pub(super) struct Lent<'p, 'a> {
    from: &'p Focuses<'a>,
    focus: Option<Focus<'a>>,
}

impl<'a> Focuses<'a> {
    /// None yet.
    pub(super) fn new(layout: &'a Layout<'a>) -> Self {
        Self { layout, idle: Mutex::new(Vec::new()) }
    }

    /// An idle one, or another.
    ///
    /// # Errors
    /// It does not fit in memory.
    pub(super) fn lend(&self) -> Result<Lent<'_, 'a>> {
        let idle = self.idle().pop();
        let focus = idle.map_or_else(|| Focus::new(self.layout), Ok)?;
        Ok(Lent { from: self, focus: Some(focus) })
    }

    fn idle(&self) -> MutexGuard<'_, Vec<Focus<'a>>> {
        self.idle.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl<'a> Lent<'_, 'a> {
    pub(super) fn focus(&mut self) -> &mut Focus<'a> {
        self.focus.as_mut().expect("it is given back at the end alone")
    }
}

impl Drop for Lent<'_, '_> {
    fn drop(&mut self) {
        self.from.idle().extend(self.focus.take());
    }
}

impl<'a> Focus<'a> {
    /// Buffers for one thread.
    ///
    /// # Errors
    /// They do not fit in memory.
    fn new(layout: &'a Layout<'a>) -> Result<Self> {
        let focus = match layout.line {
            Some(axis) => Line::new(layout, axis).map(Self::Line),
            None => Plane::new(layout).map(Self::Plane),
        };
        focus.ok_or_else(|| no_room_for(&layout.grid))
    }

    /// Adds tones to the voxels of depth `iz`, `[y, x]`; `spectra` are those of [`Layout::spectra`].
    pub(super) fn add(&mut self, iz: usize, per_metre: &[f64], spectra: &[Lanes], voxels: &mut [Complex32]) {
        let (Self::Plane(Plane { layout, .. }) | Self::Line(Line { layout, .. })) = self;
        for part in 0..layout.voxel_parts.len() {
            match self {
                Self::Plane(plane) => plane.add(iz, part, per_metre, spectra, voxels),
                Self::Line(line) => line.add(iz, part, per_metre, spectra, voxels),
            }
        }
    }
}
