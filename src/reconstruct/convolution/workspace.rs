//! One thread's work on the depths of a volume, in two dimensions or in one.

use super::layout::Layout;
use super::line::Line;
use super::plane::Plane;
use crate::alloc::Reused;
use crate::error::Result;
use crate::grid::no_room_for;
use crate::wave::simd::Lanes;
use num_complex::Complex32;

/// Geometry of one depth, and reused buffers.
#[derive(Debug)]
pub(crate) enum Workspace<'a> {
    Plane(Plane<'a>),
    Line(Line<'a>),
}

/// Those of all threads.
#[derive(Debug)]
pub(crate) struct Workspaces<'a> {
    layout: &'a Layout,
    /// Whether they are for the adjoint.
    adjoint: bool,
    all: Reused<Workspace<'a>>,
}

impl<'a> Workspaces<'a> {
    /// None yet.
    pub(crate) fn new(layout: &'a Layout) -> Self {
        Self { layout, adjoint: false, all: Reused::new() }
    }

    /// None yet, for [`Workspace::correlate`].
    pub(crate) fn for_adjoint(layout: &'a Layout) -> Self {
        Self { adjoint: true, ..Self::new(layout) }
    }

    /// Works with an idle one, or with another.
    ///
    /// # Errors
    /// It does not fit in memory.
    pub(crate) fn with(&self, work: impl FnOnce(&mut Workspace<'a>)) -> Result<()> {
        let another = || Workspace::new(self.layout, self.adjoint);
        self.all.with(another, |workspace| {
            work(workspace);
            Ok(())
        })
    }
}

impl<'a> Workspace<'a> {
    /// Buffers for one thread.
    ///
    /// # Errors
    /// They do not fit in memory.
    fn new(layout: &'a Layout, adjoint: bool) -> Result<Self> {
        let focus = match layout.line {
            Some(axis) => Line::new(layout, axis).map(Self::Line),
            None => Plane::new(layout, adjoint).map(Self::Plane),
        };
        focus.ok_or_else(|| no_room_for(layout.grid()))
    }

    /// Adds tones to the voxels of depth `iz`, `[y, x]`; `spectra` are those of [`Layout::transform_into`].
    pub(crate) fn add(&mut self, iz: usize, per_metre: &[f64], spectra: &[Lanes], voxels: &mut [Complex32]) {
        let (Self::Plane(Plane { layout, .. }) | Self::Line(Line { layout, .. })) = self;
        for part in 0..layout.voxel_parts.len() {
            match self {
                Self::Plane(plane) => plane.add(iz, part, per_metre, spectra, voxels),
                Self::Line(line) => line.add(iz, part, per_metre, spectra, voxels),
            }
        }
    }

    /// Adds what voxels `[y, x]` of depth `iz` are at some tones to these tones' spectra, those of [`Layout::nodes_of`].
    pub(crate) fn correlate(
        &mut self,
        iz: usize,
        per_metre: &[f64],
        voxels: &[Complex32],
        spectra: &mut [Lanes],
    ) {
        let (Self::Plane(Plane { layout, .. }) | Self::Line(Line { layout, .. })) = self;
        for part in 0..layout.voxel_parts.len() {
            match self {
                Self::Plane(plane) => plane.correlate(iz, part, per_metre, voxels, spectra),
                Self::Line(line) => line.correlate(iz, part, per_metre, voxels, spectra),
            }
        }
    }
}
