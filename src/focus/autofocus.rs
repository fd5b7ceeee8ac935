//! The search: a coarse curve over the range, then its top, part by part of the band.

use super::displacement::blur;
use super::jackknife::{self, PartMeasures};
use super::measure::FocusMeasure;
use super::one_of_many::OneOfMany;
use super::parameter::{Corrected, FocusParameter};
use super::verdict::{Evidence, FocusVerdict};
use crate::acquisition::DataCube;
use crate::error::{Error, Result};
use crate::grid::Grid;
use crate::progress::{Observer, advance, stage};
use crate::reconstruct::{Method, ReconstructOptions, Window, reconstruct_with};
use crate::wave::Motion;
use crate::with_fields::with_fields;
use serde::Serialize;

/// What is tried, and how.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
#[non_exhaustive]
pub struct AutofocusOptions {
    /// What is called sharp.
    pub measure: FocusMeasure,
    /// The values that are tried, from and to; `None`: ± 3 % of the speed of sound or of the path to the region, ± 5° of tilt.
    pub range: Option<[f64; 2]>,
    /// Values of the coarse curve; `None`: as many as its top may be narrow.
    pub trials: Option<usize>,
    /// The delay, m, that has been taken from the cube's paths.
    pub delay: f64,
    /// Angles about x and y, degrees, by which the array is turned before anything is tried.
    pub tilt: [f64; 2],
    /// The frame that is imaged, and the times of the tones; velocities need them.
    pub motion: Option<Motion>,
    /// As [`ReconstructOptions::memory`].
    pub memory: Option<u64>,
}

with_fields! {
    AutofocusOptions {
        with_measure(measure: FocusMeasure),
        with_range(range: Option<[f64; 2]>),
        with_trials(trials: Option<usize>),
        with_delay(delay: f64),
        with_tilt(tilt: [f64; 2]),
        with_motion(motion: Option<Motion>),
        with_memory(memory: Option<u64>),
    }
}

/// A value and how sharp the image is with it.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[non_exhaustive]
pub struct FocusTrial {
    /// In the parameter's unit.
    pub value: f64,
    /// By the measure.
    pub measure: f64,
}

/// What a search found.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Autofocus {
    /// What was tried.
    pub parameter: FocusParameter,
    /// Its unit.
    pub unit: &'static str,
    /// What was called sharp.
    pub measure: FocusMeasure,
    /// The value that the cube has.
    pub own: f64,
    /// The range that was tried.
    pub range: [f64; 2],
    /// All trials, ascending.
    pub trials: Vec<FocusTrial>,
    /// The value of the sharpest image: the top of a parabola, or of the curve if that has none.
    pub best: f64,
    /// Standard error of `best`, by the jackknife over six parts of the band; `None` where it could not be found.
    pub standard_error: Option<f64>,
    /// Where the curve is within 2 % of its top, by that parabola: echoes that overlap and the edges of the region change as much.
    pub plateau: Option<[f64; 2]>,
    /// Where the curve is half way down from its top to its lowest place.
    pub width: [f64; 2],
    /// Share by which the curve falls from its top.
    pub contrast: f64,
    /// rms of phases that an end of the range leaves in a point, rad, wherever it moves; the larger of both.
    pub blur: f64,
    /// Whether the parameter was found.
    pub verdict: FocusVerdict,
    /// Why it was not, if so.
    pub reason: Option<String>,
    /// What to type after `--set`, if it was found.
    pub setting: Option<String>,
    /// Images that were made.
    pub images: usize,
}

/// Fewest and most trials of the coarse curve.
const TRIALS: [usize; 2] = [5, 1001];

/// Trials if none are asked for, at least and at most.
const USUAL: [usize; 2] = [15, 201];

/// The blur from one trial to the next, rad, at which no top is missed.
const STEP: f64 = 0.35;

/// Trials at the top.
const FINE: usize = 7;

/// Their reach to either side, as a share of the narrower side of the curve's width.
const REACH: f64 = 0.5;

/// A share of the top that is no difference.
const PLATEAU: f64 = 0.02;

/// How far beyond them a parabola may have its top, as a share of their reach.
const BEYOND: f64 = 1.5;

/// Finds the value of a parameter with which the image of a region is sharpest, and says whether that is one to trust.
///
/// The region moves with its echoes as the value changes; see the chapter `measured` of the guide. Nothing is changed.
///
/// Cost: an image of the region for each of the trials, then 7 of six parts of the band. Memory: 8 volumes, and the samples
/// once more. A change of the speed of sound is one of scale, so that all trials take the method that one image would.
///
/// # Errors
/// A range that is none, or outside of what the instrument may have; trials less than 5 or more than 1001; a speaker's place in
/// a monostatic scan; a velocity without times; the delay of an in-phase cube; those of [`reconstruct_with`].
pub fn autofocus(
    cube: &DataCube,
    grid: &Grid,
    parameter: FocusParameter,
    options: &AutofocusOptions,
    observer: &dyn Observer,
) -> Result<Autofocus> {
    parameter.check(&cube.instrument, options.motion)?;
    let search = Search::new(cube, grid, parameter, options)?;
    let range = search.range;
    if !(range[0] < range[1] && range.iter().all(|value| value.is_finite())) {
        let problem = format!("must be two numbers, the lesser first, not {} and {}", range[0], range[1]);
        return Err(Error::input("--range", problem));
    }
    let blurs = [0, 1].map(|end| blur(parameter, cube, search.corrected, grid, range[end]));
    let [low, high] = blurs;
    let (low, high) = (low?, high?);
    let count = match options.trials {
        Some(count) if !(TRIALS[0]..=TRIALS[1]).contains(&count) => {
            let problem = format!("must be from {} to {}, not {count}", TRIALS[0], TRIALS[1]);
            return Err(Error::input("--trials", problem));
        }
        Some(count) => count,
        // Odd, so that the middle of the range is one of them.
        None => (((low + high) / STEP).ceil() as usize | 1).clamp(USUAL[0], USUAL[1]),
    };
    observer.note(&format!(
        "{count} images of {} voxels, then {FINE} in {} parts of the band",
        grid.voxel_count(),
        jackknife::parts(cube.instrument.sweep.len()).len()
    ));
    stage(observer, "focusing", (count + FINE) as u64, || {
        let step = (range[1] - range[0]) / (count - 1) as f64;
        let values = (0..count).map(|i| range[0] + step * i as f64);
        let curve = values.map(|value| search.trial(value, observer)).collect::<Result<Vec<_>>>()?;
        search.judge(curve, low.max(high), observer)
    })
}

/// Everything that trials share.
struct Search<'a> {
    cube: &'a DataCube,
    grid: &'a Grid,
    parameter: FocusParameter,
    measure: FocusMeasure,
    corrected: Corrected,
    own: f64,
    range: [f64; 2],
    /// Voxels of a resolution cell with the cube's own value.
    cell: f64,
    images: ReconstructOptions,
}

impl<'a> Search<'a> {
    fn new(
        cube: &'a DataCube,
        grid: &'a Grid,
        parameter: FocusParameter,
        options: &AutofocusOptions,
    ) -> Result<Self> {
        let corrected = Corrected { delay: options.delay, tilt: options.tilt, motion: options.motion };
        let own = parameter.of(&cube.instrument, corrected);
        let instrument = parameter.instrument(cube, corrected, own)?;
        let range =
            options.range.unwrap_or_else(|| parameter.usual_range(&instrument, grid, (own, corrected)));
        // Without a window nothing weighs parts of the band, so that their images add up.
        let images = ReconstructOptions::new(Method::Auto, Window::None).with_memory(options.memory);
        let cell = FocusParameter::cell(&instrument, grid);
        Ok(Self { cube, grid, parameter, measure: options.measure, corrected, own, range, cell, images })
    }

    /// The cube and the region with a value.
    fn with(&self, value: f64) -> Result<(DataCube, Grid)> {
        let mut cube = self.cube.clone();
        self.parameter.samples(&mut cube, self.corrected, value)?;
        cube.instrument = self.parameter.instrument(self.cube, self.corrected, value)?;
        let region = (&self.cube.instrument, self.corrected);
        let grid = self.parameter.region(region, self.grid, [self.own, value]);
        Ok((cube, grid))
    }

    /// How the region is imaged with a value.
    fn images(&self, value: f64) -> ReconstructOptions {
        self.images.with_motion(self.parameter.motion(self.corrected, value))
    }

    /// How much larger a resolution cell is than with the cube's own value.
    fn cells(&self, cube: &DataCube, grid: &Grid) -> f64 {
        FocusParameter::cell(&cube.instrument, grid) / self.cell
    }

    fn trial(&self, value: f64, observer: &dyn Observer) -> Result<FocusTrial> {
        let (cube, grid) = self.with(value)?;
        let volume = reconstruct_with(&cube, &grid, &self.images(value), &OneOfMany(observer))?.volume;
        advance(observer, 1)?;
        let measure = self.measure.of_cells(self.measure.of(&volume), self.cells(&cube, &grid));
        Ok(FocusTrial { value, measure })
    }

    /// Looks at the top of a curve closely, unless that is in vain.
    fn judge(&self, curve: Vec<FocusTrial>, blur: f64, observer: &dyn Observer) -> Result<Autofocus> {
        let highest =
            (0..curve.len()).fold(0, |best, i| if curve[i].measure > curve[best].measure { i } else { best });
        let evidence = Evidence { curve: &curve, highest, blur };
        let (width, contrast) = (evidence.width(), evidence.contrast());
        let (mut best, mut standard_error, mut plateau) = (curve[highest].value, None, None);
        let mut fine = Vec::new();
        let mut objection = evidence.objection();
        if objection.is_none() {
            let (places, measured) = self.top_of(&curve, highest, width, observer)?;
            let values: Vec<f64> = measured.iter().map(|at| at.whole).collect();
            let trials = places.iter().zip(&values);
            fine = trials.map(|(value, measure)| FocusTrial { value: *value, measure: *measure }).collect();
            let top = jackknife::top(&places, &values, BEYOND);
            best = top.map_or(best, |[at, ..]| at);
            plateau = top.map(|[at, value, falls]| {
                let reach = (PLATEAU * value / falls).sqrt();
                [at - reach, at + reach]
            });
            standard_error = top.and_then(|_| jackknife::standard_error(&places, &measured, BEYOND));
            // Too few tones for parts are no objection, but then nothing is known of the error.
            let parts = measured[0].without.len() >= 3;
            objection = if parts || top.is_none() { evidence.of_error(standard_error) } else { None };
        }
        let found = objection.is_none();
        let (verdict, reason) =
            objection.map_or((FocusVerdict::Found, None), |(verdict, why)| (verdict, Some(why)));
        let setting = found.then(|| self.parameter.setting(self.cube, self.corrected, best)).transpose()?;
        let images = curve.len() + fine.len();
        let mut trials = [curve, fine].concat();
        trials.sort_by(|a, b| a.value.total_cmp(&b.value));
        Ok(Autofocus {
            parameter: self.parameter,
            unit: self.parameter.unit(),
            measure: self.measure,
            own: self.own,
            range: self.range,
            trials,
            best,
            standard_error,
            plateau,
            width,
            contrast,
            blur,
            verdict,
            reason,
            setting,
            images,
        })
    }

    /// Trials about the highest place of a curve, by parts of the band.
    fn top_of(
        &self,
        curve: &[FocusTrial],
        highest: usize,
        width: [f64; 2],
        observer: &dyn Observer,
    ) -> Result<(Vec<f64>, Vec<PartMeasures>)> {
        let middle = curve[highest].value;
        // A side on which the curve does not fall to its middle tells nothing of its width.
        let sides = [middle - width[0], width[1] - middle];
        let ends = [width[0] > self.range[0], width[1] < self.range[1]];
        let known = sides.iter().zip(ends).filter(|(_, falls)| *falls).map(|(side, _)| *side);
        let side = known.fold(f64::INFINITY, f64::min);
        let reach = REACH * if side.is_finite() { side } else { sides[0].max(sides[1]) };
        let places: Vec<f64> =
            (0..FINE).map(|i| middle + reach * (2.0 * i as f64 / (FINE - 1) as f64 - 1.0)).collect();
        let measured = places.iter().map(|value| {
            let (cube, grid) = self.with(*value)?;
            let measured =
                jackknife::measure(&cube, &grid, &self.images(*value), self.measure, &OneOfMany(observer))?;
            let cells = self.cells(&cube, &grid);
            advance(observer, 1)?;
            let per_cell = |measure: f64| self.measure.of_cells(measure, cells);
            let without = measured.without.into_iter().map(per_cell).collect();
            Ok(PartMeasures { whole: per_cell(measured.whole), without })
        });
        let measured = measured.collect::<Result<_>>()?;
        Ok((places, measured))
    }
}
