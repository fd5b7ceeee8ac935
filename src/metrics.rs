//! Compares a depth map with the truth: how much was found, how much is false, and how large the errors are.
//!
//! The definitions are those of `guide::metrics`: Δd = c/2B; a pixel's error is taken against the true surface nearest
//! to the reported depth; a detection on an empty pixel is not scored within a guard ring around silhouettes, as wide as
//! the image of an edge.
//!
//! # Example
//! Two of three surfaces found within Δd = 17 mm, the third 0.1 m too near:
//! ```
//! use holosonar::grid::{Axis, DepthMap, Raster, DepthLayer, View};
//! use holosonar::metrics::evaluate;
//!
//! let row = |count| Axis { first: 0.0, pitch: 0.01, count };
//! let map = |depth: [f32; 3]| {
//!     let picked = DepthLayer { depth: depth.to_vec(), strength: vec![1.0; 3], ..DepthLayer::default() };
//!     DepthMap::new(Raster { view: View::Orthographic, x: row(3), y: row(1) }, picked)
//! };
//! let metrics = evaluate(&map([1.001, 2.0, 1.4]), &map([1.0, 2.0, 1.5]), 0.017)?;
//! assert_eq!(metrics.completeness, Some(2.0 / 3.0));
//! assert_eq!(metrics.false_returns, Some(1.0 / 3.0));
//! # Ok::<(), holosonar::error::Error>(())
//! ```

mod around;
mod cloud;
mod counts;
mod groups;

pub use groups::{Measure, ScoreGroup, Scores, score};

use crate::error::{Error, Result};
use crate::grid::{Axis, DepthLayer, DepthMap, View};
use crate::wave::Resolution;
use serde::{Deserialize, Serialize};

/// Declares the metrics, their names and the iteration over both from one list.
macro_rules! metrics {
    ($($(#[$about:meta])* $name:ident,)+) => {
        /// Every metric; `None` where there was nothing to measure it on.
        #[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
        #[non_exhaustive]
        pub struct Metrics {
            $($(#[$about])* pub $name: Option<f64>,)+
        }

        /// The names of all metrics, as run files, options and reports spell them.
        pub const METRIC_NAMES: [&str; 17] = [$(stringify!($name)),+];

        impl Metrics {
            /// Metrics whose values are those of their names.
            pub(crate) fn of_names(mut value: impl FnMut(&'static str) -> Option<f64>) -> Self {
                Self { $($name: value(stringify!($name)),)+ }
            }

            /// Names and values in the order of [`METRIC_NAMES`].
            pub fn iter(&self) -> impl Iterator<Item = (&'static str, Option<f64>)> + use<> {
                METRIC_NAMES.into_iter().zip([$(self.$name),+])
            }
        }
    };
}

metrics! {
    /// Share of pixels with a true surface whose depth is within Δd of one.
    completeness,
    /// The same among pixels around which one surface continues as a plane, with no crease and no rim.
    completeness_interior,
    /// The same among those of these pixels whose surface answers at most 20 dB below the loudest: what the aperture resolves
    /// and the speaker illuminates.
    audible_completeness,
    /// Share of scored detections that are on an empty pixel or are off by more than 2 Δd.
    false_returns,
    /// Share of all detections that are on an empty pixel, near a silhouette or not.
    outside_returns,
    /// Harmonic mean of completeness and of the share of returns that are not false.
    f1,
    /// Harmonic mean of the share of points found within Δd of a true one and of true points within Δd of one found.
    f_score,
    /// The same within 2 Δd.
    f_score_2,
    /// Mean distance from a point found to the nearest true one and from a true one to the nearest found, m.
    chamfer_distance,
    /// Median |error| of detections on pixels with a true surface, m along z.
    median_error,
    /// Median of |error| · |n_z|: the distance from the surface along its normal, m.
    median_normal_error,
    /// Root mean square error, m.
    rmse,
    /// 95th percentile of |error|, m.
    p95_error,
    /// Share of pixels with two true surfaces where both were found within Δd.
    two_returns,
    /// Share of pixels with one true surface that show a second return where there is none within the resolution.
    spurious_returns,
    /// Median |error| of the front one of two true surfaces, m.
    return1_median_error,
    /// Median |error| of the back one of two true surfaces, m.
    return2_median_error,
}

impl Metrics {
    /// The metric of that name; the outer `None` means there is no such name.
    pub fn get(&self, name: &str) -> Option<Option<f64>> {
        self.iter().find(|(n, _)| *n == name).map(|(_, value)| value)
    }

    /// Whether less of the metric of that name is better; of the other shares 1 is the best.
    pub fn is_error(name: &str) -> bool {
        Self::is_length(name) || ["false_returns", "outside_returns", "spurious_returns"].contains(&name)
    }

    /// Whether the metric of that name is a length in m, rather than a share.
    pub fn is_length(name: &str) -> bool {
        name.ends_with("error") || ["rmse", "chamfer_distance"].contains(&name)
    }
}

/// Scores `result` against `truth` with a [`Resolution`], or a range resolution Δd alone in m.
///
/// # Errors
/// Maps whose pixels do not coincide, or a resolution that is not positive.
pub fn evaluate(result: &DepthMap, truth: &DepthMap, resolution: impl Into<Resolution>) -> Result<Metrics> {
    score(result, truth, resolution).map(|scores| scores.all)
}

/// Signed error of every detection against the true surface nearest to it, m, `[y, x]`; NaN where there is none.
///
/// # Errors
/// Maps whose pixels do not coincide.
pub fn error_map(result: &DepthMap, truth: &DepthMap) -> Result<Vec<f32>> {
    check_pixels(result, truth)?;
    let surfaces = surfaces_of(truth);
    let error = |(pixel, z): (usize, &f32)| {
        let z = f64::from(*z);
        nearest_surface(surfaces, pixel, z).map_or(f32::NAN, |(_, depth)| (z - depth) as f32)
    };
    Ok(result.picked.depth.iter().enumerate().map(error).collect())
}

/// All surfaces of a map; one from another program may contain only the picked surface.
fn surfaces_of(map: &DepthMap) -> &[DepthLayer] {
    if map.returns.is_empty() { std::slice::from_ref(&map.picked) } else { &map.returns }
}

/// The true surface at a pixel that is nearest to `z`, and its depth; any one where `z` is NaN.
fn nearest_surface(surfaces: &[DepthLayer], pixel: usize, z: f64) -> Option<(usize, f64)> {
    depths(surfaces, pixel).min_by(|a, b| (a.1 - z).abs().total_cmp(&(b.1 - z).abs()))
}

/// Pairs true and found depths, nearest pair first; returns each true one's |error|, `None` where none was left for it.
fn match_one_to_one(truth: &[f64], found: &[f64]) -> Vec<Option<f64>> {
    let mut pairs: Vec<(f64, usize, usize)> = truth
        .iter()
        .enumerate()
        .flat_map(|(t, a)| found.iter().enumerate().map(move |(f, b)| ((a - b).abs(), t, f)))
        .collect();
    pairs.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut errors = vec![None; truth.len()];
    let mut taken = vec![false; found.len()];
    for (error, t, f) in pairs {
        if errors[t].is_none() && !taken[f] {
            errors[t] = Some(error);
            taken[f] = true;
        }
    }
    errors
}

/// The depths at a pixel, with the surface each comes from, front to back.
fn depths(surfaces: &[DepthLayer], pixel: usize) -> impl Iterator<Item = (usize, f64)> + '_ {
    surfaces.iter().map(move |s| f64::from(s.depth[pixel])).enumerate().filter(|(_, z)| !z.is_nan())
}

/// The harmonic mean of two shares; 0 where both are.
fn harmonic_mean(a: f64, b: f64) -> f64 {
    if a + b > 0.0 { 2.0 * a * b / (a + b) } else { 0.0 }
}

/// A percentile, interpolated linearly; sorts its argument.
fn percentile(values: &mut [f64], q: f64) -> Option<f64> {
    values.sort_by(f64::total_cmp);
    let last = values.len().checked_sub(1)?;
    let place = q * last as f64;
    let (below, above) = (values[place.floor() as usize], values[place.ceil() as usize]);
    Some(below + (above - below) * place.fract())
}

/// Refuses maps of different pixels.
fn check_pixels(result: &DepthMap, truth: &DepthMap) -> Result<()> {
    let refused = |problem: String| Err(Error::input("compare", problem));
    if result.view != truth.view {
        return refused(format!(
            "the result's view is {}, the truth's {}; make both with the same [depth] view",
            result.view, truth.view
        ));
    }
    let (found, expected) = (result.shape(), truth.shape());
    if found != expected {
        return refused(format!("the result has {found:?} pixels (rows, columns), the truth {expected:?}"));
    }
    let unit = if truth.view == View::Orthographic { " m" } else { " (slopes)" };
    let same = |a: &Axis, b: &Axis| {
        let near = |p: f64, q: f64| (p - q).abs() <= 1e-3 * a.pitch;
        near(a.first, b.first) && near(a.last(), b.last())
    };
    if same(&result.x, &truth.x) && same(&result.y, &truth.y) {
        return Ok(());
    }
    let span = |axis: &Axis| format!("{} .. {}", axis.first, axis.last());
    refused(format!(
        "the pixels do not coincide: the result spans x {}, y {}{unit}, the truth x {}, y {}{unit}",
        span(&result.x),
        span(&result.y),
        span(&truth.x),
        span(&truth.y)
    ))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::grid::Raster;
    use crate::named::assert_names;

    const N: f32 = f32::NAN;

    fn surface(depth: &[f32]) -> DepthLayer {
        let strength = depth.iter().map(|z| if z.is_nan() { 0.0 } else { 1.0 }).collect();
        DepthLayer { depth: depth.to_vec(), strength, ..DepthLayer::default() }
    }

    /// One row of pixels 3 cm apart.
    pub(super) fn map(picked: &[f32], returns: &[&[f32]]) -> DepthMap {
        let axis = |count| Axis { first: 0.0, pitch: 0.03, count };
        let raster = Raster { view: View::Orthographic, x: axis(picked.len()), y: axis(1) };
        let returns = returns.iter().map(|r| surface(r)).collect();
        DepthMap { returns, ..DepthMap::new(raster, surface(picked)) }
    }

    #[test]
    fn shares_and_errors_follow_their_definitions() {
        let mut truth = map(&[1.0, 1.0, 1.0, 1.0, N, N, N], &[]);
        truth.picked.facing = Some(vec![0.5; 7]);
        //                 hit   off    2Δd+  none  guard  false  -
        let result = map(&[1.01, 1.025, 1.10, N, 1.0, 1.0, N], &[]);
        let m = evaluate(&result, &truth, 0.017).expect("same pixels");
        assert_eq!(m.completeness, Some(0.25));
        assert_eq!(m.false_returns, Some(2.0 / 4.0));
        let near = |a: Option<f64>, b: f64| assert!((a.expect("measured") - b).abs() < 1e-6, "{a:?} {b}");
        near(m.median_error, 0.025);
        near(m.median_normal_error, 0.0125);
        near(m.rmse, ((0.01f64.powi(2) + 0.025f64.powi(2) + 0.1f64.powi(2)) / 3.0).sqrt());
        near(m.p95_error, 0.025 + 0.9 * 0.075);
        assert_eq!((m.two_returns, m.spurious_returns), (None, None));
    }

    #[test]
    fn an_error_is_against_the_nearest_surface_and_returns_match_one_to_one() {
        let truth = map(&[1.0, 1.0, 1.0, 1.5], &[&[1.0, 1.0, 1.0, 1.5], &[1.5, 1.5, 1.5, N]]);
        let result = map(&[1.5, 1.0, 1.0, 1.5], &[&[1.001, 1.0, 1.5, 1.2], &[1.502, 1.005, N, 1.5]]);
        let m = evaluate(&result, &truth, 0.017).expect("same pixels");
        assert_eq!(m.completeness, Some(1.0));
        // Pixel 1's second return is another echo of the first surface; pixel 2 has one only.
        assert_eq!(m.two_returns, Some(1.0 / 3.0));
        assert_eq!(m.spurious_returns, Some(1.0));
    }

    #[test]
    fn nothing_to_measure_is_none_not_nan() {
        let m = evaluate(&map(&[N, N], &[]), &map(&[N, N], &[]), 0.01).expect("same pixels");
        assert!(m.iter().all(|(_, value)| value.is_none()));
        assert_eq!(m.get("rmse"), Some(None));
        assert_eq!(m.get("rsme"), None);
    }

    #[test]
    fn other_pixels_are_refused() {
        assert!(evaluate(&map(&[1.0], &[]), &map(&[1.0, 1.0], &[]), 0.01).is_err());
        let mut shifted = map(&[1.0, 1.0], &[]);
        shifted.x.first = 0.01;
        assert!(evaluate(&shifted, &map(&[1.0, 1.0], &[]), 0.01).is_err());
        assert!(evaluate(&map(&[1.0], &[]), &map(&[1.0], &[]), 0.0).is_err());
        let camera = DepthMap { view: View::Perspective, ..map(&[1.0], &[]) };
        let refused = evaluate(&map(&[1.0], &[]), &camera, 0.01).expect_err("another view").to_string();
        assert_names(refused, &["orthographic", "perspective"]);
    }

    #[test]
    fn the_guard_ring_is_as_wide_in_metres_for_a_camera() {
        // One pixel is 3 cm at depth 1 m, and 6 cm at 2 m: the ring of 4 cm holds the neighbour only of the former.
        for (z, false_returns) in [(1.0, Some(0.0)), (2.0, Some(0.5))] {
            let view = View::Perspective;
            let truth = DepthMap { view, ..map(&[z, N], &[]) };
            let result = DepthMap { view, ..map(&[z, z], &[]) };
            assert_eq!(evaluate(&result, &truth, 0.01).expect("same pixels").false_returns, false_returns);
        }
    }
}
