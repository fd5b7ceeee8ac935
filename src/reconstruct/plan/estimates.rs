//! What each method would take for a job.

use crate::grid::Grid;
use crate::reconstruct::plan::cost::Cost;
use crate::reconstruct::upsampling::Upsampling;
use crate::reconstruct::volume::Batch;
use crate::reconstruct::{Method, ReconstructOptions};
use serde::Serialize;

/// Operations of finding a plan, about.
const BEGINNING: f64 = 3e8;

/// What one method would take for a job.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Estimate {
    /// The method; never [`Method::Auto`].
    pub method: Method,
    /// Why it cannot be used here, if so.
    pub obstacle: Option<String>,
    /// The grid that it is summed on, where the voxels are interpolated from that; nodes at its ends may stand closer together
    /// than its pitch.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub nodes: Option<Grid>,
    /// Floating-point operations, those of finding the plan included. Times follow from them to within 30 % as a rule, for very
    /// short jobs to within a factor of two.
    pub operations: f64,
    /// Bytes at the peak, without the samples that the source stores and the volume: within
    /// [`ReconstructOptions::memory`], or where as little as possible is worked on at a time.
    pub bytes: u64,
    /// What `bytes` are of.
    #[serde(skip)]
    pub(crate) batch: Batch,
}

/// The cost of every method for a job, and which one is chosen.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Estimates {
    /// One estimate for each method but [`Method::Auto`].
    pub methods: Vec<Estimate>,
    /// The place in `methods` of the one that [`reconstruct`](crate::reconstruct::reconstruct()) takes.
    pub chosen: usize,
}

impl Estimates {
    /// The estimate of the method that [`reconstruct`](crate::reconstruct::reconstruct()) takes.
    pub fn chosen(&self) -> &Estimate {
        &self.methods[self.chosen]
    }

    /// The estimate of a method; `None` for [`Method::Auto`].
    pub fn of(&self, method: Method) -> Option<&Estimate> {
        self.methods.iter().find(|estimate| estimate.method == method)
    }
}

impl Estimate {
    /// Of a method that can be used, in batches within the memory that the options allow.
    pub(super) fn possible(
        method: Method,
        cost: &Cost<'_>,
        upsampling: Option<&Upsampling>,
        options: &ReconstructOptions,
    ) -> Self {
        let batch = cost.usual.within(options.memory, &cost.bytes);
        let (operations, bytes) = (cost.operations + BEGINNING, (cost.bytes)(batch));
        let nodes = upsampling.map(|nodes| nodes.coarse);
        Self { method, obstacle: None, nodes, operations, bytes, batch }
    }

    /// Of a method that cannot be used.
    pub(super) fn impossible(method: Method, obstacle: String) -> Self {
        let (obstacle, operations) = (Some(obstacle), f64::INFINITY);
        Self { method, obstacle, nodes: None, operations, bytes: 0, batch: Batch::LEAST }
    }
}
