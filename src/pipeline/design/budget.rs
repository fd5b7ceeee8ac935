//! The budget of an instrument: what each element that is not ideal does to the samples and the range of a point.

use crate::acquisition::{
    AScan, AScanOptions, DataCube, Electronics, Instrument, MicArray, Noise, ScannedMicrophone,
    SimulateOptions, simulate,
};
use crate::config::RunFile;
use crate::error::Result;
use crate::grid::{Axis, Grid};
use crate::pipeline::prepared_scene::Measurement;
use crate::progress::Silent;
use crate::reflectors::Reflectors;
use glam::DVec3;
use num_complex::{Complex32, Complex64};
use serde::Serialize;

/// Points that are simulated for each element, fewer of many frequencies, so that a plan takes no longer.
const TRIALS: usize = 16;
const MOST_TONES: usize = 16 * 4096;

/// From one point to the next along the depths of the grid, in parts of it: the golden ratio, which repeats nothing.
const STRIDE: f64 = std::f64::consts::GOLDEN_RATIO - 1.0;

/// The elements of an instrument, with what each costs by itself, and what all of them do together.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct InstrumentBudget {
    /// Points that were simulated for each, before the microphone in the array's centre.
    pub points: usize,
    /// A row for each.
    pub rows: Vec<BudgetRow>,
}

/// What one element does.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct BudgetRow {
    /// The element, or "all".
    pub element: String,
    /// Power of the samples that those of an ideal instrument explain, up to a common complex factor, against the rest, dB;
    /// `None`: nothing is left.
    pub snr_db: Option<f64>,
    /// Level of the samples against the ideal ones, dB.
    pub level_db: f64,
    /// Mean error of the range of the strongest peak, m.
    pub range_bias: f64,
    /// Its rms, m.
    pub range_rms: f64,
}

/// Measures the budget of a run file's instrument; `None` where its electronics are ideal.
///
/// Cost: for each element as many range profiles of one microphone as there are points.
///
/// # Errors
/// Those of the simulation of a point.
pub(in crate::pipeline) fn instrument_budget(
    run: &RunFile,
    measurement: &Measurement,
    grid: &Grid,
) -> Result<Option<InstrumentBudget>> {
    let Some(electronics) = &measurement.options.electronics else { return Ok(None) };
    let whole = &measurement.instrument;
    let centre = whole.array.centre();
    let microphone = whole.array.positions()[whole.array.nearest([centre.x, centre.y])];
    let instrument = whole.transmission(0).with_array(MicArray::from_positions(vec![microphone])?);
    let weights = run.reconstruct.window.over_sweep(&instrument.sweep);
    let points = (MOST_TONES / instrument.sweep.len()).clamp(1, TRIALS);
    let ideal = measurement.options.clone().with_errors(None).with_noise(None).with_electronics(None);
    let setup = Setup { instrument: &instrument, weights: &weights, ideal: &ideal };
    let trials = (0..points).map(|trial| setup.trial(point(grid, trial))).collect::<Result<Vec<_>>>()?;
    let all = electronics.elements();
    let alone = all.iter().map(|element| (element.to_string(), Some(electronics.only(*element)), None));
    let noise = measurement.options.noise;
    let of_noise = noise.map(|noise| ("noise".to_owned(), None, Some(noise)));
    let together = ("all".to_owned(), Some(electronics.clone()), noise);
    let rows = alone.chain(of_noise).chain([together]);
    let rows = rows.map(|(name, electronics, noise)| setup.row(&trials, name, electronics.as_ref(), noise));
    Ok(Some(InstrumentBudget { points, rows: rows.collect::<Result<_>>()? }))
}

/// The point of a trial, on the axis of the grid.
fn point(grid: &Grid, trial: usize) -> DVec3 {
    let Grid { x, y, z } = grid;
    let middle = |axis: &Axis| f64::midpoint(axis.first, axis.last());
    let part = ((trial as f64 + 1.0) * STRIDE).fract();
    DVec3::new(middle(x), middle(y), z.first + part * (z.last() - z.first))
}

/// One microphone, and how its samples are simulated and read.
struct Setup<'a> {
    instrument: &'a Instrument,
    weights: &'a [f64],
    ideal: &'a SimulateOptions,
}

/// A point, with what an ideal instrument records of it.
struct TrialPoint {
    echo: Reflectors,
    ideal: DataCube,
    /// m.
    range: Option<f64>,
}

impl Setup<'_> {
    fn trial(&self, point: DVec3) -> Result<TrialPoint> {
        let echo = Reflectors::new(vec![point], vec![Complex32::ONE])?;
        let ideal = simulate(&echo, self.instrument, self.ideal)?;
        let range = self.range(&ideal)?;
        Ok(TrialPoint { echo, ideal, range })
    }

    /// The range of the strongest echo, m.
    fn range(&self, cube: &DataCube) -> Result<Option<f64>> {
        let options =
            AScanOptions::default().with_microphone(ScannedMicrophone::Number(0)).with_peaks(1_usize);
        let scan = AScan::of(&mut &*cube, self.weights, &options, &Silent)?;
        Ok(scan.peaks.first().map(|peak| peak.range))
    }

    /// Simulates all points with these electronics and this noise, each with random numbers of its own.
    fn row(
        &self,
        trials: &[TrialPoint],
        element: String,
        electronics: Option<&Electronics>,
        noise: Option<Noise>,
    ) -> Result<BudgetRow> {
        let (mut explained, mut rest, mut power, mut heard) = (0.0, 0.0, 0.0, 0.0);
        let mut errors = Vec::new();
        for (number, trial) in trials.iter().enumerate() {
            let later = |seed: u64| seed.wrapping_add(number as u64);
            let mut options = self.ideal.clone();
            options.electronics = electronics.cloned();
            options.noise = noise.map(|noise| Noise { seed: later(noise.seed), ..noise });
            if let Some(electronics) = &mut options.electronics {
                electronics.seed = later(electronics.seed);
            }
            let real = simulate(&trial.echo, self.instrument, &options)?;
            let wide = |m: &Complex32| Complex64::new(m.re.into(), m.im.into());
            let pairs = || trial.ideal.samples.iter().map(wide).zip(real.samples.iter().map(wide));
            let own: f64 = pairs().map(|(a, _)| a.norm_sqr()).sum();
            let factor = pairs().map(|(a, b)| a.conj() * b).sum::<Complex64>() / own;
            explained += factor.norm_sqr() * own;
            rest += pairs().map(|(a, b)| (b - factor * a).norm_sqr()).sum::<f64>();
            power += own;
            heard += pairs().map(|(_, b)| b.norm_sqr()).sum::<f64>();
            if let (Some(expected), Some(found)) = (trial.range, self.range(&real)?) {
                errors.push(found - expected);
            }
        }
        let count = errors.len().max(1) as f64;
        // What rounding to single precision leaves is nothing.
        let snr_db = (rest > 1e-12 * explained).then(|| 10.0 * (explained / rest).log10());
        Ok(BudgetRow {
            element,
            snr_db,
            level_db: 10.0 * (heard / power).log10(),
            range_bias: errors.iter().sum::<f64>() / count,
            range_rms: (errors.iter().map(|e| e * e).sum::<f64>() / count).sqrt(),
        })
    }
}
