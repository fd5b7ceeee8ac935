//! Which method a job takes, and what each would cost.

use super::convolved::{Convolution, Convolutions};
use super::estimates::{Estimate, Estimates};
use super::projected::projected;
use crate::acquisition::Instrument;
use crate::error::{Error, Result};
use crate::grid::Grid;
use crate::reconstruct::backprojection::BackprojectionPlan;
use crate::reconstruct::convolution::ConvolutionPlan;
use crate::reconstruct::direct::DirectPlan;
use crate::reconstruct::error_budget::ErrorBudget;
use crate::reconstruct::numerics::GridPlaces;
use crate::reconstruct::plan::cost::Cost;
use crate::reconstruct::refine;
use crate::reconstruct::upsampling::Upsampling;
use crate::reconstruct::volume::{estimate_of_correlation, estimates_in_motion, estimates_of_transmissions};
use crate::reconstruct::{Method, ReconstructOptions};
use std::iter;

/// Above this many terms `direct` must be selected explicitly; it would run for many minutes.
const MOST_DIRECT_TERMS: u64 = 100_000_000_000;

/// Below this number of operations of a sum on the voxels no nodes are found, which takes about as long as they may save.
const LEAST_FOR_NODES: f64 = 1e9;

/// Back-projection takes this many operations at least for each voxel and microphone.
const LEAST_FOR_TERM: f64 = 30.0;

/// Below this number of operations, a fraction of a second, convolution is compared with back-projection without tiles.
const SHORT: f64 = 8e9;

/// The terms of Eq. 13: voxels × microphones × frequencies, of every loudspeaker.
pub fn direct_terms(instrument: &Instrument, grid: &Grid) -> u64 {
    grid.voxel_count()
        .saturating_mul(instrument.array.len() as u64)
        .saturating_mul(instrument.sweep.len() as u64)
        .saturating_mul(instrument.transmissions() as u64)
}

/// The chosen method, and how it is carried out.
#[derive(Debug)]
pub(crate) enum MethodPlan {
    Direct(DirectPlan),
    Convolution(Box<Sampled<ConvolutionPlan>>),
    Backprojection(Box<Sampled<BackprojectionPlan>>),
    Linear(DirectPlan),
}

/// A method's plan for the voxels, or for nodes that they are interpolated from.
#[derive(Debug, Clone)]
pub(crate) struct Sampled<P> {
    pub(crate) upsampling: Option<Upsampling>,
    pub(crate) plan: P,
}

/// The grid that is summed on, and what may be erred there.
pub(crate) fn summed<'a>(
    upsampling: Option<&'a Upsampling>,
    grid: &'a Grid,
    budget: ErrorBudget,
) -> (&'a Grid, ErrorBudget) {
    upsampling.map_or((grid, budget), |nodes| (&nodes.coarse, nodes.error.left(budget)))
}

/// The plans of all methods for one job, and what each would take.
#[derive(Debug)]
pub(crate) struct Candidates {
    estimates: Vec<Estimate>,
    convolution: std::result::Result<Sampled<ConvolutionPlan>, String>,
    backprojection: Option<Sampled<BackprojectionPlan>>,
    direct: DirectPlan,
    /// Whether the volume is refined, which takes convolution.
    refines: bool,
}

impl Candidates {
    pub(crate) fn new(
        instrument: &Instrument,
        grid: &Grid,
        options: &ReconstructOptions,
        threads: usize,
    ) -> Result<Self> {
        Self::among(instrument, grid, options, (threads, options.known))
    }

    /// The plan of one method for one job among many alike: the others are not looked for, which takes time.
    pub(crate) fn only(
        method: Method,
        instrument: &Instrument,
        grid: &Grid,
        options: &ReconstructOptions,
    ) -> Result<Self> {
        Self::among(instrument, grid, options, (rayon::current_num_threads(), Some(method)))
    }

    /// The plans of all methods, or of one of them.
    pub(crate) fn among(
        instrument: &Instrument,
        grid: &Grid,
        options: &ReconstructOptions,
        (threads, only): (usize, Option<Method>),
    ) -> Result<Self> {
        check(grid, options)?;
        instrument.check_with("grid", grid.bounds())?;
        let budget = ErrorBudget::new(options.tolerance);
        let possible = |method, cost: Cost<'_>, upsampling: Option<&Upsampling>| {
            let cost = match upsampling {
                Some(nodes) => nodes.with(cost),
                None => cost,
            };
            let cost = match &options.refine {
                Some(by) => refine::price(cost, upsampling, by, (instrument, grid, budget)),
                None => cost,
            };
            Estimate::possible(method, &cost, upsampling, options)
        };
        let wanted = |method: Method| only.is_none_or(|only| only == method);
        let price = |sampled: &Sampled<ConvolutionPlan>| {
            let cost = sampled.plan.cost(instrument, threads);
            possible(Method::Convolution, cost, sampled.upsampling.as_ref())
        };
        let refines = options.refine.is_some();
        let convolutions = Convolutions { job: (instrument, grid, budget), refines, price };
        let on_voxels = if !wanted(Method::Convolution) {
            Err(NOT_LOOKED_FOR)
        } else if refines && budget.all() <= 0.0 {
            Err(NO_SKELETONS)
        } else {
            Ok(convolutions.on(None))
        };
        let straight = instrument.interface.is_none();
        let projects =
            options.tolerance > 0.0 && options.refine.is_none() && straight && wanted(Method::Backprojection);
        // A short sum is over before nodes, tiles or lines are found.
        let short = |found: &std::result::Result<Convolution, String>, most: f64| {
            let is_less = found.as_ref().is_ok_and(|(_, estimate)| estimate.operations < most);
            is_less && options.method != Method::Backprojection
        };
        let soon = on_voxels.as_ref().is_ok_and(|found| short(found, LEAST_FOR_NODES))
            || projects && options.method == Method::Auto && is_soon_projected(instrument, grid, budget);
        let sampled = !soon && (wanted(Method::Convolution) || projects);
        let nodes = if sampled { Upsampling::find(instrument, grid, budget) } else { Vec::new() };
        let convolution = on_voxels.map_err(str::to_owned).and_then(|found| convolutions.best(found, &nodes));
        let search = !short(&convolution, SHORT);
        let samplings: Vec<Option<&Upsampling>> = iter::once(None).chain(nodes.iter().map(Some)).collect();
        // What takes more than another method is not chosen, however it is found.
        let as_rival = |estimate: Option<&Estimate>| {
            let compared = estimate.filter(|_| options.method == Method::Auto);
            compared.map_or(f64::INFINITY, |estimate| estimate.operations)
        };
        let rival = as_rival(convolution.as_ref().ok().map(|(_, estimate)| estimate));
        let mut finding = 0.0;
        let backprojection = projects.then(|| {
            let priced = |sampled: &Sampled<BackprojectionPlan>| {
                let cost = sampled.plan.cost(instrument, threads);
                possible(Method::Backprojection, cost, sampled.upsampling.as_ref())
            };
            let (found, own) = projected((instrument, grid, budget), &samplings, (search, rival), priced);
            finding = own;
            let estimate = priced(&found);
            (found, estimate)
        });
        let rival = as_rival(backprojection.as_ref().map(|(_, estimate)| estimate));
        let convolution = convolution.map(|best| convolutions.with_fewer_depths(best, rival));
        let direct = DirectPlan::new(grid);
        let of_convolution = match &convolution {
            Ok((_, estimate)) => estimate.clone(),
            Err(obstacle) => Estimate::impossible(Method::Convolution, obstacle.clone()),
        };
        let of_backprojection = match &backprojection {
            Some((_, estimate)) => estimate.clone(),
            None => Estimate::impossible(Method::Backprojection, why_not_projected(options, straight)),
        };
        let sums = [Method::Direct, Method::Linear].map(|method| match options.refine {
            Some(_) => Estimate::impossible(method, NO_ADJOINT.to_owned()),
            None if !straight && method == Method::Linear => Estimate::impossible(method, BENT.to_owned()),
            None => possible(method, direct.cost(instrument, threads), None),
        });
        let mut estimates: Vec<_> = [of_convolution, of_backprojection].into_iter().chain(sums).collect();
        // A search is paid for whatever is chosen.
        for estimate in &mut estimates {
            estimate.operations += finding;
        }
        let convolution = convolution.map(|(plan, _)| plan);
        let backprojection = backprojection.map(|(plan, _)| plan);
        Ok(Self { estimates, convolution, backprojection, direct, refines })
    }

    /// The selected method, or of the possible ones that of fewest operations.
    pub(crate) fn chosen(&self, asked: Method) -> &Estimate {
        let asked = if self.refines && asked == Method::Auto { Method::Convolution } else { asked };
        &self.estimates[chosen_among(&self.estimates, asked)]
    }

    /// What each method would take.
    pub(crate) fn estimates(&self) -> &[Estimate] {
        &self.estimates
    }

    /// The same, and which one is chosen.
    pub(crate) fn into_estimates(self, asked: Method) -> Estimates {
        let method = self.chosen(asked).method;
        let chosen = chosen_among(&self.estimates, method);
        Estimates { methods: self.estimates, chosen }
    }

    /// The plan of the method that the options select, and a warning if `auto` had to take a slow one.
    pub(crate) fn choose(
        self,
        instrument: &Instrument,
        grid: &Grid,
        asked: Method,
    ) -> Result<(MethodPlan, Option<String>)> {
        let chosen = self.chosen(asked);
        if let Some(obstacle) = &chosen.obstacle {
            let (name, straight) = (chosen.method, instrument.interface.is_none());
            let others = match name {
                _ if self.refines => "\"auto\", or [refine] method = \"none\"",
                Method::Convolution if straight => "\"backprojection\" or \"direct\"",
                Method::Backprojection | Method::Linear if !straight => "\"convolution\" or \"direct\"",
                _ => "\"direct\"",
            };
            return Err(Error::input(
                "reconstruct.method",
                format!("\"{name}\" is not possible here: {obstacle}; fix that, or use method = {others}"),
            ));
        }
        match (chosen.method, self.convolution, self.backprojection) {
            (Method::Linear, ..) => Ok((MethodPlan::Linear(self.direct), None)),
            (Method::Convolution, Ok(plan), _) => Ok((MethodPlan::Convolution(Box::new(plan)), None)),
            (Method::Backprojection, _, Some(plan)) => Ok((MethodPlan::Backprojection(Box::new(plan)), None)),
            (_, Err(misfit), None) if asked == Method::Auto => {
                refuse_long_sum(instrument, grid, &misfit)?;
                let slower = "summing Eq. 13 directly instead, which is slower (a tolerance would help)";
                Ok((MethodPlan::Direct(self.direct), Some(format!("{misfit}; {slower}"))))
            }
            _ => Ok((MethodPlan::Direct(self.direct), None)),
        }
    }
}

/// The place of the selected method, or of the possible ones that of fewest operations.
pub(crate) fn chosen_among(estimates: &[Estimate], asked: Method) -> usize {
    estimates.iter().position(|e| e.method == asked).unwrap_or_else(|| {
        // `linear` is another formula, not another method for this one.
        let possible = |e: &Estimate| e.obstacle.is_none() && e.method != Method::Linear;
        let possible = estimates.iter().enumerate().filter(|(_, e)| possible(e));
        let least = possible.min_by(|(_, a), (_, b)| a.operations.total_cmp(&b.operations));
        least.expect("the direct sum always is").0
    })
}

/// Whether back-projection on the voxels, microphone by microphone, is over before nodes are found.
fn is_soon_projected(instrument: &Instrument, grid: &Grid, budget: ErrorBudget) -> bool {
    let terms = grid.voxel_count() as f64 * instrument.array.len() as f64;
    let plan = || BackprojectionPlan::new(instrument, GridPlaces::even(grid), budget, 0.0);
    LEAST_FOR_TERM * terms < LEAST_FOR_NODES && plan().cost(instrument, 1).operations < LEAST_FOR_NODES
}

/// Why there is no back-projection.
fn why_not_projected(options: &ReconstructOptions, straight: bool) -> String {
    let why = match options.refine {
        Some(_) => NO_ADJOINT,
        None if !straight => BENT,
        None => "a tolerance of 0 allows no interpolation; use a tolerance above 0 (1e-6, say)",
    };
    why.to_owned()
}

/// Another method is asked for.
const NOT_LOOKED_FOR: &str = "another method is asked for";

/// Why only convolution refines.
const NO_ADJOINT: &str = "a refinement takes the adjoint of the sum, too, which only convolution has";

/// Why an interface leaves convolution and the direct sum.
const BENT: &str = "it has straight paths only, and they bend at [medium] interface";

/// What else it wants.
const NO_SKELETONS: &str =
    "a refinement takes skeleton tones, which a tolerance of 0 does not allow; use 1e-4, say";

/// The plan of fewest operations.
pub(super) fn least<P>(priced: impl Iterator<Item = (P, Estimate)>) -> (P, Estimate) {
    priced.min_by(|(_, a), (_, b)| a.operations.total_cmp(&b.operations)).expect("one was found at least")
}

/// Refuses a direct sum of many minutes that was not selected explicitly.
fn refuse_long_sum(instrument: &Instrument, grid: &Grid, misfit: &str) -> Result<()> {
    let terms = direct_terms(instrument, grid);
    if terms <= MOST_DIRECT_TERMS {
        return Ok(());
    }
    Err(Error::input(
        "reconstruct.method",
        format!(
            "{misfit}. That leaves the direct sum of Eq. 13, {:.1e} terms here: many minutes. Make the grid \
             smaller or its pitch larger, allow a tolerance, or select it explicitly with [reconstruct] method = \"direct\"",
            terms as f64
        ),
    ))
}

/// The most voxels, in all and along an axis: far beyond what any computer images, and few enough to be counted over.
const MOST_VOXELS: u64 = 1 << 38;
const MOST_ALONG: usize = 1 << 17;

/// The least tolerance other than 0, far below the rounding of single precision: no series or fit is more exact.
pub const LEAST_TOLERANCE: f64 = 1e-9;

/// Refuses grids, tolerances and refinements that make no sense.
fn check(grid: &Grid, options: &ReconstructOptions) -> Result<()> {
    let [n_z, n_y, n_x] = grid.shape();
    if grid.voxel_count() > MOST_VOXELS || n_x.max(n_y).max(n_z) > MOST_ALONG {
        return Err(Error::input(
            "grid",
            format!(
                "{n_x} x {n_y} x {n_z} voxels exceed any memory ({:.1e} GiB); use a larger pitch or a smaller grid",
                grid.voxel_count() as f64 * 8.0 / f64::from(1 << 30)
            ),
        ));
    }
    if grid.z.first < 0.0 {
        return Err(Error::input(
            "grid.z",
            format!("begins at {} m, behind the array; depths start at z >= 0", grid.z.first),
        ));
    }
    let tolerance = options.tolerance;
    if tolerance != 0.0 && !(LEAST_TOLERANCE..1.0).contains(&tolerance) {
        return Err(Error::input(
            "reconstruct.tolerance",
            format!(
                "{tolerance} is not a relative error from {LEAST_TOLERANCE:e} to 1; 1e-4 is usual, 0 sums every frequency"
            ),
        ));
    }
    options.refine.map_or(Ok(()), |refine| refine.check())
}

/// What each method would cost for a job with this many threads, and the one that
/// [`reconstruct`](crate::reconstruct::reconstruct()) would take, which no number of threads changes. Takes some
/// tenths of a second.
///
/// ```
/// use holosonar::acquisition::{Instrument, MicArray, SimulateOptions, Sweep, simulate};
/// # use holosonar::glam::DVec3;
/// # use holosonar::grid::{Axis, Grid};
/// use holosonar::reconstruct::{Method, ReconstructOptions, estimate};
/// # use holosonar::reflectors::Reflectors;
/// # let sweep = Sweep::stepped(10e3, 20e3, 20.0)?;
/// # let array = MicArray::rectangular([16, 16], [0.01, 0.01], DVec3::ZERO)?;
/// # let instrument = Instrument::new(sweep, array);
/// # let nothing = Reflectors::new(vec![], vec![])?;
/// # let cube = simulate(&nothing, &instrument, &SimulateOptions::default())?;
/// # let lateral = Axis { first: -0.32, pitch: 0.01, count: 64 };
/// # let grid = Grid { x: lateral, y: lateral, z: Axis { first: 1.0, pitch: 0.01, count: 64 } };
/// let estimates = estimate(&cube.instrument, &grid, &ReconstructOptions::default(), 1)?;
/// let direct = estimates.of(Method::Direct).expect("always possible");
/// assert_eq!(estimates.chosen().method, Method::Convolution);
/// assert!(estimates.chosen().operations < direct.operations / 100.0);
/// # Ok::<(), holosonar::error::Error>(())
/// ```
///
/// # Errors
/// A grid with voxels behind the array or beyond 10⁹ m; a tolerance that is not 0 or in [`LEAST_TOLERANCE`]..1; a speed of
/// sound outside [`SOUND_SPEEDS`](crate::wave::SOUND_SPEEDS); paths of more than 10¹¹ wavelengths.
pub fn estimate(
    instrument: &Instrument,
    grid: &Grid,
    options: &ReconstructOptions,
    threads: usize,
) -> Result<Estimates> {
    if let Some(motion) = options.motion.filter(|_| options.method != Method::Correlation) {
        return estimates_in_motion(instrument, grid, (options, motion), threads);
    }
    if options.method == Method::Correlation {
        return estimate_of_correlation(instrument, grid, options, threads);
    }
    if instrument.transmissions() > 1 {
        return estimates_of_transmissions(instrument, grid, options, threads);
    }
    Ok(Candidates::new(instrument, grid, options, threads)?.into_estimates(options.method))
}
