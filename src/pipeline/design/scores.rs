//! What a simulated combination is worth: metrics over its seeds, and whether another is better for the same price.

use super::pareto::front;
use super::{Combination, DesignSweep};
use crate::metrics::{Measure, Metrics, Scores};
use crate::pipeline::limits::mean;
use serde::Serialize;

/// How well the images of a combination show the scene.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct DesignScores {
    /// The seeds.
    pub seeds: Vec<u32>,
    /// The mean of each metric over the seeds.
    pub mean: Metrics,
    /// Its standard deviation; nothing of one seed.
    pub spread: Metrics,
    /// All metrics of each seed.
    #[serde(skip)]
    pub scores: Vec<Scores>,
    /// Whether the means keep the limits of `[expect]`, if there are any.
    pub expected: Option<bool>,
    /// The error by the sweep's measure: what is a share of what was found, as 1 less it.
    pub error: Option<f64>,
    /// On which fronts it is.
    pub front: DesignFront,
}

/// Whether no other combination is better in one of these and nowhere worse.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
#[non_exhaustive]
pub struct DesignFront {
    /// In error, acquisition time and number of microphones.
    pub all: bool,
    /// In error and acquisition time.
    pub time: bool,
    /// In error and number of microphones.
    pub microphones: bool,
}

impl DesignScores {
    pub(super) fn of(
        (seeds, scores): (&[u32], &[Scores]),
        expected: Option<bool>,
        measure: &Measure,
    ) -> Self {
        let each = |name: &str| -> Vec<Option<f64>> {
            scores.iter().map(|scores| scores.all.get(name).flatten()).collect()
        };
        let measured: Vec<Option<f64>> = scores.iter().map(|scores| scores.get(measure)).collect();
        let as_error = |value: f64| if Metrics::is_error(&measure.metric) { value } else { 1.0 - value };
        Self {
            seeds: seeds.to_vec(),
            mean: Metrics::of_names(|name| mean(&each(name))),
            spread: Metrics::of_names(|name| deviation(&each(name))),
            scores: scores.to_vec(),
            expected,
            error: mean(&measured).map(as_error),
            front: DesignFront::default(),
        }
    }
}

/// The standard deviation of a sample over the seeds; that of one is not known.
fn deviation(each: &[Option<f64>]) -> Option<f64> {
    let mean = mean(each).filter(|_| each.len() > 1)?;
    let squares: f64 = each.iter().flatten().map(|value| (value - mean).powi(2)).sum();
    Some((squares / (each.len() - 1) as f64).sqrt())
}

impl DesignSweep {
    /// Finds which combinations are on the fronts.
    pub(super) fn find_fronts(&mut self) {
        let points: Vec<[f64; 3]> = self.combinations.iter().map(Combination::costs).collect();
        let all = front(&points);
        let [time, microphones] =
            [1, 2].map(|cost| front(&points.iter().map(|point| [point[0], point[cost]]).collect::<Vec<_>>()));
        for (i, combination) in self.combinations.iter_mut().enumerate() {
            if let Some(simulated) = &mut combination.simulated {
                simulated.front = DesignFront { all: all[i], time: time[i], microphones: microphones[i] };
            }
        }
    }
}

impl Combination {
    /// Error, acquisition time and number of microphones; what is not known is not a number.
    pub(crate) fn costs(&self) -> [f64; 3] {
        match (&self.design, &self.simulated) {
            (Some(design), Some(simulated)) => {
                let error = simulated.error.unwrap_or(f64::NAN);
                [error, design.acquisition.seconds, design.microphones as f64]
            }
            _ => [f64::NAN; 3],
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn means_and_deviations_need_every_seed() {
        assert_eq!(deviation(&[Some(1.0), Some(3.0)]), Some(2.0_f64.sqrt()));
        assert_eq!(deviation(&[Some(1.0)]), None);
        assert_eq!((mean(&[Some(1.0), None]), deviation(&[Some(1.0), None])), (None, None));
    }

    #[test]
    fn what_has_no_error_is_on_no_front() {
        let combination = |error: Option<f64>, seconds: f64, microphones: usize| {
            let text = format!(
                r#"{{"microphones":{microphones},"tones":3,"acquisition":{{"seconds":{seconds},"tones":3,"sweeps":1.0,"places":1,
                "tone_seconds":0.1,"tone_time":"dwell"}},"range_resolution":0.1,"widths":[0.1,null,0.3],"verdict":"ghosts",
                "ghost_offset":null,"peak_sidelobe_db":-20.0,"mean_sidelobe_db":null}}"#
            );
            let design: crate::pipeline::DesignRow = serde_json::from_str(&text).expect("a row");
            assert_eq!(design.cost, None);
            let measure = Measure::parse("rmse").expect("a metric");
            let mut simulated = DesignScores::of((&[1], &[Scores::default()]), None, &measure);
            simulated.error = error;
            let (simulated, design) = (Some(simulated), Some(design));
            Combination { values: Vec::new(), design, simulated, refused: None }
        };
        let refused =
            Combination { values: Vec::new(), design: None, simulated: None, refused: Some(String::new()) };
        let mut sweep = DesignSweep {
            keys: Vec::new(),
            measure: Some("rmse".to_owned()),
            combinations: vec![
                combination(Some(0.2), 1.0, 100),
                combination(Some(0.1), 2.0, 400),
                combination(Some(0.2), 1.0, 200),
                combination(None, 0.5, 1),
                combination(Some(0.3), 3.0, 50),
                refused,
            ],
        };
        sweep.find_fronts();
        let fronts = sweep.combinations.iter().map(|c| c.simulated.as_ref().map(|simulated| simulated.front));
        let front = |all: bool, time: bool, microphones: bool| Some(DesignFront { all, time, microphones });
        let expected = [
            front(true, true, true),
            front(true, true, true),
            front(false, true, false),
            front(false, false, false),
            front(true, false, true),
            None,
        ];
        assert!(fronts.eq(expected));
    }
}
