//! The frequencies: a stepped sweep, or any ascending list of frequencies.

use crate::error::{Error, Result};
use std::sync::Arc;

/// The frequencies of a measurement, ascending, in Hz. Clones share their list.
#[derive(Debug, Clone, PartialEq)]
pub struct Sweep {
    frequencies: Arc<Vec<f64>>,
    /// The common step where there is one, Hz.
    step: Option<f64>,
}

/// More frequencies than any instrument uses; the bound keeps absurd requests from allocating memory.
const MOST_FREQUENCIES: f64 = 10_000_000.0;

/// An invalid sweep; its place is "sweep" unless the caller names another.
fn refused<T>(problem: impl Into<String>) -> Result<T> {
    Err(Error::input("sweep", problem))
}

impl Sweep {
    /// `f_n = start + n·step`, n = 0 … round((stop − start)/step), both ends included.
    ///
    /// # Errors
    /// Frequencies that are not positive and finite, a band that is not a multiple of the step, or more than 10⁷ frequencies.
    /// The error's place is "sweep"; [`Error::at`] replaces it with a file or key.
    ///
    /// ```
    /// use holosonar::acquisition::Sweep;
    ///
    /// let sweep = Sweep::stepped(10e3, 20e3, 20.0)?;
    /// assert_eq!((sweep.len(), sweep.bandwidth()), (501, 10e3));
    /// # Ok::<(), holosonar::error::Error>(())
    /// ```
    pub fn stepped(start: f64, stop: f64, step: f64) -> Result<Self> {
        if !(start > 0.0 && stop >= start && stop.is_finite() && step > 0.0) {
            return refused(format!(
                "a sweep needs 0 < start <= stop and step > 0, not {start} .. {stop} Hz by {step} Hz"
            ));
        }
        let intervals = (stop - start) / step;
        if (intervals - intervals.round()).abs() > 1e-6 * intervals.max(1.0) {
            return refused(format!(
                "the band of {} Hz is not a multiple of the step of {step} Hz; stop = {} would make it one",
                stop - start,
                start + intervals.round().max(1.0) * step
            ));
        }
        if intervals >= MOST_FREQUENCIES {
            return refused(format!("{intervals:.3e} frequencies are too many; use a larger step"));
        }
        let count = intervals.round() as usize + 1;
        let frequencies = (0..count).map(|n| start + n as f64 * step).collect();
        Ok(Self { frequencies: Arc::new(frequencies), step: Some(step) })
    }

    /// Any ascending list; even spacing is recognised.
    ///
    /// # Errors
    /// An empty list, or frequencies that are not positive, finite and ascending; the error's place is "sweep".
    pub fn from_frequencies(frequencies: Vec<f64>) -> Result<Self> {
        let (Some(&first), Some(&last)) = (frequencies.first(), frequencies.last()) else {
            return refused("contains no frequencies; at least one is needed");
        };
        if !frequencies.iter().all(|f| f.is_finite() && *f > 0.0) {
            return refused("frequencies must be positive numbers, in Hz");
        }
        if !frequencies.is_sorted_by(|a, b| a < b) {
            return refused("frequencies must ascend; sort them, and the samples with them");
        }
        let intervals = frequencies.len() - 1;
        let step = if intervals == 0 { 1.0 } else { (last - first) / intervals as f64 };
        // The phase error of 10⁻⁶ of a step is far below the f32 rounding of the samples.
        let even =
            frequencies.iter().enumerate().all(|(n, f)| (f - (first + n as f64 * step)).abs() <= 1e-6 * step);
        Ok(Self { frequencies: Arc::new(frequencies), step: even.then_some(step) })
    }

    /// All frequencies, Hz.
    pub fn frequencies(&self) -> &[f64] {
        &self.frequencies
    }

    /// Number of frequencies.
    pub fn len(&self) -> usize {
        self.frequencies.len()
    }

    /// Always false: a sweep has at least one frequency.
    pub fn is_empty(&self) -> bool {
        self.frequencies.is_empty()
    }

    /// The step, Hz, if the frequencies are evenly spaced.
    pub fn step(&self) -> Option<f64> {
        self.step
    }

    /// Lowest frequency f₀, Hz.
    pub fn start(&self) -> f64 {
        self.frequencies[0]
    }

    /// Highest frequency f₀ + B, Hz.
    pub fn stop(&self) -> f64 {
        self.frequencies[self.frequencies.len() - 1]
    }

    /// Bandwidth B, Hz; 0 for a single frequency.
    pub fn bandwidth(&self) -> f64 {
        self.stop() - self.start()
    }

    /// Middle of the band, Hz.
    pub fn centre(&self) -> f64 {
        f64::midpoint(self.start(), self.stop())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_ends_are_included() {
        let sweep = Sweep::stepped(18_000.0, 20_000.0, 2.0).expect("the paper's sweep");
        assert_eq!(sweep.len(), 1001);
        assert_eq!((sweep.start(), sweep.stop(), sweep.centre()), (18_000.0, 20_000.0, 19_000.0));
    }

    #[test]
    fn a_band_that_is_no_multiple_of_the_step_is_refused() {
        let error = Sweep::stepped(10_000.0, 20_000.0, 30.0).expect_err("333.3");
        assert!(error.to_string().contains("multiple of the step"), "{error}");
        for (a, b, s) in
            [(0.0, 1.0, 1.0), (2.0, 1.0, 1.0), (1.0, 2.0, 0.0), (1.0, f64::NAN, 1.0), (1.0, 1e9, 1e-3)]
        {
            assert!(Sweep::stepped(a, b, s).is_err(), "{a} {b} {s}");
        }
    }

    #[test]
    fn even_spacing_is_recognised_and_uneven_kept() {
        let even = Sweep::from_frequencies(vec![100.0, 150.0, 200.0]).expect("ascending");
        assert_eq!(even.step(), Some(50.0));
        let uneven = Sweep::from_frequencies(vec![100.0, 151.0, 200.0]).expect("ascending");
        assert_eq!(uneven.step(), None);
        for bad in [vec![], vec![2.0, 1.0], vec![1.0, 1.0], vec![f64::NAN], vec![-1.0, 2.0]] {
            assert!(Sweep::from_frequencies(bad).is_err());
        }
    }
}
