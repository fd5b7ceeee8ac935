//! How the tolerance is divided among the steps that err: spreading, two compressions, series, interpolation.
//!
//! One place for all shares, read by the executors and by the cost model alike. Errors of steps add up, and an error made
//! before another step is amplified by it, so a later step is given what earlier ones left: [`ErrorBudget::after`] and
//! [`ErrorBudget::before`] are the only methods from one budget to the next.

/// An error bound, relative to `Σ|w m| / Σw`, that several steps have to keep together.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct ErrorBudget(f64);

impl ErrorBudget {
    /// All that may be erred.
    pub(super) fn new(tolerance: f64) -> Self {
        Self(tolerance)
    }

    /// All of it, for a single step.
    pub(super) fn all(self) -> f64 {
        self.0
    }

    /// What is left after a step that erred by `error`.
    pub(super) fn after(self, error: f64) -> Self {
        Self(self.0 - error)
    }

    /// What may be erred before a step that amplifies errors by `growth`.
    pub(super) fn before(self, growth: f64) -> Self {
        Self(self.0 / growth)
    }

    /// For spreading along one of two axes: each may use half of a half. The error measured is far less as a rule, and what
    /// it leaves is the compressions'.
    pub(super) fn spreading(self) -> f64 {
        0.25 * self.0
    }

    /// For interpolation of voxels from a coarser grid along all three axes, as measured on terms.
    pub(super) fn upsampling(self) -> f64 {
        0.3 * self.0
    }

    /// The same along one axis, for a plane wave: the three add up, some of them amplified.
    pub(super) fn upsampling_axis(self) -> f64 {
        0.05 * self.0
    }

    /// The same as measured on terms, of which none is steeper; with less, where the sum of the three is too much, all weights
    /// amplifying as much as they may.
    pub(super) fn upsampling_axis_measured(self) -> [f64; 2] {
        [0.06 * self.0, 0.035 * self.0]
    }

    /// The same of nodes within the voxels, at whose ends weights amplify more.
    pub(super) fn upsampling_axis_within(self) -> f64 {
        0.015 * self.0
    }

    /// For the first of two compressions, of the sweep to the volume's virtual tones. The second, to a slab's skeleton,
    /// costs a tone more for every third of what it is given, and runs at every depth, so it is given the rest.
    pub(super) fn virtual_tones(self) -> f64 {
        0.3 * self.0
    }

    /// For cutting off the series of range profiles; the rest is for their tones.
    pub(super) fn series(self) -> f64 {
        0.6 * self.0
    }

    /// For interpolation from nodes along all three axes together, as measured on terms.
    pub(super) fn interpolation(self) -> f64 {
        0.6 * self.0
    }

    /// For everything before that interpolation, where it amplifies errors by `growth`.
    pub(super) fn before_interpolation(self, growth: f64) -> Self {
        Self((1.0 - 0.6) * self.0 / growth)
    }

    /// For interpolation along one axis, for a plane wave. Levels and axes are seldom at their worst for the same term: what
    /// all of them err by together is measured.
    pub(super) fn interpolation_axis(self) -> f64 {
        0.2 * self.0
    }

    /// The same measured on few terms, which may miss the worst.
    pub(super) fn interpolation_axis_of_few(self) -> f64 {
        0.6 * self.interpolation_axis()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shares_of_one_budget_add_up_to_it() {
        let budget = ErrorBudget::new(1e-4);
        // Convolution: two axes of spreading, as large as they may be, then both compressions.
        let left = budget.after(2.0 * budget.spreading());
        let skeletons = left.after(left.virtual_tones());
        let sum = 2.0 * budget.spreading() + left.virtual_tones() + skeletons.all();
        assert!((sum - 1e-4).abs() < 1e-18, "{sum:e}");
        // Back-projection: interpolation, and the series and tones that it amplifies.
        let growth = 2.5;
        let nodes = budget.before_interpolation(growth);
        let tones = nodes.after(nodes.series());
        let sum = budget.interpolation() + growth * (nodes.series() + tones.all());
        assert!((sum - 1e-4).abs() < 1e-18, "{sum:e}");
        assert!(budget.interpolation_axis_of_few() < budget.interpolation_axis());
    }

    #[test]
    fn what_is_left_is_before_an_amplification_divided() {
        assert_eq!(ErrorBudget::new(0.5).after(0.25).before(2.0).all(), 0.125);
    }
}
