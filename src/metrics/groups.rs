//! The metrics material by material, and surface by surface from the front.

use super::around::Surroundings;
use super::cloud::{CloudScores, cloud_scores};
use super::counts::{ErrorCounts, SurfaceFacts};
use super::{METRIC_NAMES, Metrics, check_pixels, depths, match_one_to_one, nearest_surface, surfaces_of};
use crate::error::{Error, Result};
use crate::grid::{DepthLayer, DepthMap};
use crate::wave::Resolution;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::fmt;

/// All metrics of a depth map.
///
/// Those of a group count its true surfaces instead of pixels. Where a pixel has one true surface, `Z` is scored; where it
/// has several, the returns, matched one to one with them (`Z` against the nearest if the result has no returns).
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[non_exhaustive]
pub struct Scores {
    /// Over all pixels.
    pub all: Metrics,
    /// Of the surfaces of each material, by name; empty if the truth has no materials.
    pub materials: BTreeMap<String, Metrics>,
    /// Of each pixel's first surface from the front, its second, and so on.
    pub surfaces: Vec<Metrics>,
}

/// Which part of [`Scores`].
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum ScoreGroup {
    /// Over all pixels.
    All,
    /// Surfaces of a material.
    Material(String),
    /// The k-th surface from the front, from 1.
    Surface(usize),
}

/// A metric of a group: `completeness`, `completeness:glass` or `completeness#2`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Measure {
    /// One of [`METRIC_NAMES`].
    pub metric: String,
    /// The group that it is measured on.
    pub group: ScoreGroup,
}

impl Measure {
    /// Reads `NAME`, `NAME:MATERIAL` (the rest of the text is the material's name) or `NAME#K`.
    ///
    /// # Errors
    /// The part that is not the name of a metric, or the text whose surface is not a number.
    pub fn parse(text: &str) -> std::result::Result<Self, String> {
        let (metric, group) = match text.find([':', '#']) {
            None => (text, ScoreGroup::All),
            Some(at) if text[at..].starts_with(':') => {
                (&text[..at], ScoreGroup::Material(text[at + 1..].to_owned()))
            }
            Some(at) => match text[at + 1..].parse() {
                Ok(k) if k > 0 => (&text[..at], ScoreGroup::Surface(k)),
                _ => return Err(text.to_owned()),
            },
        };
        if METRIC_NAMES.contains(&metric) {
            Ok(Self { metric: metric.to_owned(), group })
        } else {
            Err(metric.to_owned())
        }
    }
}

impl fmt::Display for Measure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match &self.group {
            ScoreGroup::All => write!(f, "{}", self.metric),
            ScoreGroup::Material(name) => write!(f, "{}:{name}", self.metric),
            ScoreGroup::Surface(k) => write!(f, "{}#{k}", self.metric),
        }
    }
}

impl Scores {
    /// The value of a measure, in m for lengths and otherwise a share of 1; `None` where there was nothing to measure it on.
    pub fn get(&self, measure: &Measure) -> Option<f64> {
        let metrics = match &measure.group {
            ScoreGroup::All => &self.all,
            ScoreGroup::Material(name) => self.materials.get(name)?,
            ScoreGroup::Surface(k) => self.surfaces.get(k.checked_sub(1)?)?,
        };
        metrics.get(&measure.metric)?
    }
}

/// Scores `result` against `truth` with a [`Resolution`], or a range resolution Δd alone in m: over all pixels, and each
/// material and each surface separately.
///
/// # Errors
/// Maps whose pixels do not coincide, or a resolution that is not positive.
pub fn score(result: &DepthMap, truth: &DepthMap, resolution: impl Into<Resolution>) -> Result<Scores> {
    let resolution = resolution.into();
    let range = resolution.range;
    check_pixels(result, truth)?;
    if !(range.is_finite() && range > 0.0) {
        return Err(Error::input("range resolution", format!("must be a positive length, not {range} m")));
    }
    let surfaces = surfaces_of(truth);
    let around = Surroundings::new(truth, surfaces, resolution);
    let mut all = ErrorCounts::default();
    let mut materials = vec![ErrorCounts::default(); truth.materials.len()];
    let mut orders = vec![ErrorCounts::default(); surfaces.len()];
    let several = result.returns.len() >= 2;
    for pixel in 0..truth.len() {
        let there: Vec<(usize, f64)> = depths(surfaces, pixel).collect();
        let depth: Vec<f64> = there.iter().map(|(_, z)| *z).collect();
        let found: Vec<f64> = depths(&result.returns, pixel).map(|(_, z)| z).collect();
        let z = f64::from(result.picked.depth[pixel]);
        let nearest = nearest_surface(surfaces, pixel, z);
        let facts: Vec<SurfaceFacts> = there.iter().map(|(k, _)| around.facts(*k, pixel)).collect();
        let spurious = || found.iter().any(|z| !around.explained(pixel, *z));
        if let Some((nearest, true_depth)) = nearest {
            let error = (!z.is_nan()).then(|| (z - true_depth).abs());
            let of_it = there.iter().position(|(k, _)| *k == nearest);
            all.add_surface(error, of_it.map(|at| facts[at]).unwrap_or_default(), range);
        } else if !z.is_nan() {
            all.outside += 1;
            all.on_empty += usize::from(!around.guarded(pixel));
        }
        all.add_returns(&depth, &found, several.then_some(&spurious), range);
        let errors = if there.len() > 1 && several {
            match_one_to_one(&depth, &found)
        } else {
            let nearest = nearest.map(|(k, _)| k);
            let error =
                |&(k, depth): &(usize, f64)| (!z.is_nan() && nearest == Some(k)).then(|| (z - depth).abs());
            there.iter().map(error).collect()
        };
        let both = errors.iter().all(|error| error.is_some_and(|e| e < range));
        let mut seen: Vec<usize> = Vec::new();
        for (order, (&(k, _), &error)) in there.iter().zip(&errors).enumerate() {
            orders[order].add_surface(error, facts[order], range);
            let Some(material) = material(&surfaces[k], pixel).filter(|m| *m < materials.len()) else {
                continue;
            };
            let counts = &mut materials[material];
            counts.add_surface(error, facts[order], range);
            if there.len() == 1 && several {
                counts.add_single(&found, Some(&spurious));
            }
            if there.len() == 2 && several {
                counts.of_two[order].extend(error);
                if !seen.contains(&material) {
                    seen.push(material);
                    counts.doubles += 1;
                    counts.both += usize::from(both);
                }
            }
        }
    }
    let mut by_name: BTreeMap<String, ErrorCounts> = BTreeMap::new();
    for (name, counts) in truth.materials.iter().zip(materials) {
        by_name.entry(name.clone()).or_default().join(counts);
    }
    let metrics = |counts: ErrorCounts| counts.metrics(CloudScores::default());
    Ok(Scores {
        all: all.metrics(cloud_scores(result, truth, range)),
        materials: by_name.into_iter().map(|(name, counts)| (name, metrics(counts))).collect(),
        surfaces: orders.into_iter().map(metrics).collect(),
    })
}

/// Which material a surface has at a pixel, from 0.
fn material(surface: &DepthLayer, pixel: usize) -> Option<usize> {
    (surface.material.as_ref()?[pixel] as usize).checked_sub(1)
}

#[cfg(test)]
mod tests {
    use super::*;

    const N: f32 = f32::NAN;

    fn surface(depth: &[f32], material: &[u32]) -> DepthLayer {
        DepthLayer {
            depth: depth.to_vec(),
            material: Some(material.to_vec()),
            ..DepthLayer::empty(depth.len()).expect("room")
        }
    }

    fn map(picked: &[f32], returns: Vec<DepthLayer>) -> DepthMap {
        DepthMap { returns, ..super::super::tests::map(picked, &[]) }
    }

    #[test]
    fn every_material_and_surface_is_scored_for_itself() {
        // Glass before a wall at three pixels, then the wall alone at two, then nothing.
        let front = [1.0, 1.0, 1.0, 2.0, 2.0, N];
        let mut truth = map(
            &front,
            vec![
                surface(&front, &[1, 1, 1, 2, 2, 0]),
                surface(&[2.0, 2.0, 2.0, N, N, N], &[2, 2, 2, 0, 0, 0]),
            ],
        );
        truth.materials = vec!["glass".into(), "wall".into(), "unseen".into()];
        let zero = [0; 6];
        let result = map(
            &[2.0, 2.0, 1.0, 2.005, 2.3, N],
            vec![
                surface(&[1.0, 2.001, 1.03, 2.005, 1.5, N], &zero),
                surface(&[2.002, N, 2.5, N, 2.3, N], &zero),
            ],
        );
        let scores = score(&result, &truth, 0.01).expect("same pixels");
        let get = |text: &str| scores.get(&Measure::parse(text).expect("valid"));
        // Pixel 0: both; pixel 1: the wall alone; pixel 2: neither within 1 cm.
        assert_eq!(get("completeness:glass"), Some(1.0 / 3.0));
        assert_eq!(get("completeness:wall"), Some(3.0 / 5.0));
        assert_eq!(get("completeness#1"), Some(2.0 / 5.0));
        assert_eq!(get("completeness#2"), Some(2.0 / 3.0));
        assert_eq!(get("false_returns:glass"), Some(1.0 / 2.0));
        assert_eq!(get("false_returns:wall"), Some(2.0 / 5.0));
        assert_eq!(get("two_returns:glass"), get("two_returns"));
        assert_eq!((get("two_returns:glass"), get("spurious_returns:glass")), (Some(1.0 / 3.0), None));
        assert_eq!(get("spurious_returns:wall"), Some(0.5));
        assert!((get("median_error:glass").expect("two") - 0.015).abs() < 1e-6);
        assert!((get("return2_median_error:wall").expect("three") - 0.002).abs() < 1e-6);
        assert_eq!(
            (get("completeness:unseen"), get("completeness:paper"), get("completeness#3")),
            (None, None, None)
        );
        assert_eq!(get("completeness"), scores.all.completeness);
    }

    #[test]
    fn without_returns_the_depth_alone_is_scored_against_the_nearest() {
        let truth = DepthMap {
            materials: vec!["glass".into(), "wall".into()],
            ..map(&[1.0, 1.0], vec![surface(&[1.0, 1.0], &[1, 1]), surface(&[2.0, 2.0], &[2, 2])])
        };
        let scores = score(&map(&[2.0, 1.0], Vec::new()), &truth, 0.01).expect("same pixels");
        for group in [&scores.materials["glass"], &scores.materials["wall"], &scores.surfaces[0]] {
            assert_eq!((group.completeness, group.two_returns), (Some(0.5), None));
        }
    }

    #[test]
    fn a_measure_names_a_metric_and_what_it_is_of() {
        for text in ["rmse", "completeness:glass", "completeness:a:b #1", "median_error#12", "rmse:"] {
            assert_eq!(Measure::parse(text).expect("valid").to_string(), text);
        }
        for (text, culprit) in
            [("rsme:glass", "rsme"), ("rmse#0", "rmse#0"), ("rmse#two", "rmse#two"), ("", "")]
        {
            assert_eq!(Measure::parse(text), Err(culprit.to_owned()));
        }
    }
}
