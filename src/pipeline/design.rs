//! Tools for the design of arrays: a forecast of every combination of swept keys, and point-spread functions.

mod budget;

pub(super) use budget::instrument_budget;
pub use budget::{BudgetRow, InstrumentBudget};

use super::BareMesh;
use super::forecast::forecast;
use super::job::JobOptions;
use super::memory::{MemoryBudget, SceneSize};
use super::prepared_scene::Measurement;
use crate::config::{self, RunFile};
use crate::error::{Error, Result};
use crate::files::check_inputs;
use crate::grid::{Axis, Grid};
use crate::plan::design::Verdict;
use crate::progress::{Observer, advance, stage};
use crate::psf::{PointSpread, point_spread_with};
use crate::text::quoted;
use glam::DVec3;
use serde::Serialize;

/// Maximum number of combinations of a sweep: each takes a fraction of a second.
const MAX_COMBINATIONS: usize = 2000;

/// A key of the run file and its values in a sweep.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SweptKey {
    /// `table.key`.
    pub key: String,
    /// Values as they would be typed after `--set table.key=`.
    pub values: Vec<String>,
}

/// The prediction for one combination; lengths in m.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct DesignRow {
    /// Number of microphones.
    pub microphones: usize,
    /// Number of frequencies.
    pub tones: usize,
    /// Δd = c/2B.
    pub range_resolution: Option<f64>,
    /// Full widths at −3 dB along x of a point in front of the array's centre, at the nearest, middle and farthest depth.
    pub widths: [Option<f64>; 3],
    /// Whether there are grating lobes, by the pitch of a lattice.
    pub verdict: Verdict,
    /// Distance of the nearest grating lobe from a point at the nearest depth, if there are any in the grid, m.
    #[serde(rename = "ghost_offset")]
    pub grating_lobe_offset: Option<f64>,
    /// Strongest grating lobe or sidelobe within the grid, with the window, dB.
    pub peak_sidelobe_db: Option<f64>,
    /// Mean power of the sidelobes of one frequency, dB.
    pub mean_sidelobe_db: Option<f64>,
    /// Peak memory, bytes.
    pub peak_bytes: u64,
    /// Seconds of the reconstruction, from a short measurement of this computer's speed.
    pub seconds: f64,
}

/// One combination of a sweep.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Combination {
    /// One value per key.
    pub values: Vec<String>,
    /// The prediction, if the combination is valid.
    pub design: Option<DesignRow>,
    /// Why the combination was refused, if it was.
    pub refused: Option<String>,
}

/// A sweep of run-file keys.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct DesignSweep {
    /// The keys.
    pub keys: Vec<String>,
    /// Every combination, the last key fastest.
    pub combinations: Vec<Combination>,
}

impl SweptKey {
    /// Reads `KEY=FROM:TO:STEP`, both ends included, or `KEY=a,b,c`; commas within brackets belong to a value.
    ///
    /// # Errors
    /// Text of neither form; a range that never ends, or that has more than 2000 values.
    pub fn parse(typed: &str) -> Result<Self> {
        let wrong = |problem: &str| {
            Error::input(
                format!("--sweep {}", quoted(typed)),
                format!("{problem}; expected KEY=FROM:TO:STEP, as in array.extent=0.5:2:0.25, or KEY=a,b,c"),
            )
        };
        let (key, values) = typed.split_once('=').ok_or_else(|| wrong("has no `=`"))?;
        let (key, values) = (key.trim().to_owned(), values.trim());
        if key.is_empty() || values.is_empty() {
            return Err(wrong("lacks its key or its values"));
        }
        let numbers: Option<Vec<f64>> = values.split(':').map(|part| part.trim().parse().ok()).collect();
        if let Some([from, to, step]) = numbers.as_deref() {
            let intervals = ((to - from) / step + 1e-6).floor();
            if !(intervals >= 0.0 && intervals < MAX_COMBINATIONS as f64) {
                return Err(wrong("is a range that never ends, or that has more than 2000 values"));
            }
            // Rounded, so that 0.1 + 0.2 is 0.3 as typed.
            let value = |i: usize| ((from + i as f64 * step) * 1e9).round() / 1e9;
            let values = (0..=intervals as usize).map(|i| value(i).to_string()).collect();
            return Ok(Self { key, values });
        }
        let mut list = vec![String::new()];
        let mut depth = 0_i32;
        for c in values.chars() {
            match c {
                '[' | '{' => depth += 1,
                ']' | '}' => depth -= 1,
                _ => {}
            }
            match list.last_mut() {
                Some(last) if c != ',' || depth > 0 => last.push(c),
                _ => list.push(String::new()),
            }
        }
        let values: Vec<String> = list.iter().map(|value| value.trim().to_owned()).collect();
        if values.iter().any(String::is_empty) {
            return Err(wrong("has an empty value"));
        }
        Ok(Self { key, values })
    }
}

/// Returns the run file of an input with further overrides.
pub type RunWith<'a> = dyn Fn(&[String]) -> Result<RunFile> + 'a;

/// Predicts every combination of swept keys.
///
/// Invalid combinations are listed with the reason for their refusal.
///
/// # Errors
/// More than 2000 combinations; a scene that cannot be read; no valid combination.
pub fn sweep_designs(keys: &[SweptKey], run_with: &RunWith, job: &JobOptions) -> Result<DesignSweep> {
    let observer = job.observer;
    let total = keys.iter().fold(1_usize, |total, key| total.saturating_mul(key.values.len()));
    if total > MAX_COMBINATIONS {
        return Err(Error::input(
            "--sweep",
            format!("{total} combinations are too many; the maximum is {MAX_COMBINATIONS}"),
        ));
    }
    let mut scenes = LastScene::default();
    let mut first_refusal = None;
    let mut combinations = Vec::with_capacity(total);
    stage(observer, "planning", total as u64, || {
        for values in products(keys) {
            let set: Vec<String> =
                keys.iter().zip(&values).map(|(key, value)| format!("{}={value}", key.key)).collect();
            let row = run_with(&set).and_then(|run| row(&run, job.bare_mesh, &mut scenes, observer));
            let (design, refused) = match row {
                Ok(design) => (Some(design), None),
                Err(error @ Error::Interrupted) => return Err(error),
                Err(error) => {
                    // What would be overwritten is not a matter of this combination.
                    check_inputs()?;
                    let refused = Some(error.to_string());
                    first_refusal.get_or_insert(error);
                    (None, refused)
                }
            };
            combinations.push(Combination { values, design, refused });
            advance(observer, 1)?;
        }
        Ok(())
    })?;
    if let (Some(error), true) = (first_refusal, combinations.iter().all(|c| c.design.is_none())) {
        return Err(error);
    }
    Ok(DesignSweep { keys: keys.iter().map(|key| key.key.clone()).collect(), combinations })
}

/// Every combination of the keys' values, the last key fastest.
fn products(keys: &[SweptKey]) -> Vec<Vec<String>> {
    keys.iter().fold(vec![Vec::new()], |products, key| {
        let extended = |product: &[String], value: &String| [product, std::slice::from_ref(value)].concat();
        products.iter().flat_map(|product| key.values.iter().map(move |v| extended(product, v))).collect()
    })
}

/// The size of the scene that was read last, so that a mesh is not read for every combination.
#[derive(Default)]
struct LastScene(Option<(config::SceneTable, SceneSize)>);

impl LastScene {
    /// The size of the run file's scene; zero if there is no scene and the grid is complete.
    fn of(&mut self, run: &RunFile, bare: Option<&BareMesh>, observer: &dyn Observer) -> Result<SceneSize> {
        let grid = &run.grid;
        if run.scene.files().next().is_none() && grid.x.is_some() && grid.y.is_some() && grid.z.is_some() {
            return Ok(SceneSize::default());
        }
        if let Some((scene, size)) = &self.0
            && *scene == run.scene
        {
            return Ok(*size);
        }
        let size = SceneSize::of(run, bare, observer)?;
        self.0 = Some((run.scene.clone(), size));
        Ok(size)
    }
}

fn row(
    run: &RunFile,
    bare: Option<&BareMesh>,
    scenes: &mut LastScene,
    observer: &dyn Observer,
) -> Result<DesignRow> {
    let measurement = Measurement::of(run)?;
    let instrument = &measurement.instrument;
    let budget = MemoryBudget::of(run);
    let size = scenes.of(run, bare, observer)?;
    let grid = run.voxels(instrument, size.bounds)?;
    let forecast = forecast(&budget, instrument, &grid, &measurement.imaging(&budget, &grid, &size), true)?;
    let design = forecast.design;
    Ok(DesignRow {
        microphones: forecast.plan.microphones,
        tones: forecast.plan.frequencies,
        range_resolution: forecast.plan.range_resolution,
        widths: design.depths.map(|at| at.widths[0]),
        verdict: design.aliasing.verdict,
        grating_lobe_offset: design.depths[0]
            .grating_lobe_offset
            .filter(|_| design.aliasing.verdict == Verdict::GratingLobes),
        peak_sidelobe_db: design.aliasing.sidelobes.peak_db,
        mean_sidelobe_db: design.aliasing.sidelobes.mean_db,
        peak_bytes: forecast.memory[0].bytes,
        seconds: forecast.seconds[forecast.chosen],
    })
}

/// Point-spread functions of a run file's instrument at the given points, or, without any, at the middle of the grid's
/// nearest, middle and farthest depth. Only the size of the scene is used.
///
/// # Errors
/// The errors of the run file, of the simulation of one reflector and of its reconstruction.
pub fn point_spreads(run: &RunFile, points: &[DVec3], job: &JobOptions) -> Result<(Grid, Vec<PointSpread>)> {
    let JobOptions { bare_mesh: bare, observer, .. } = *job;
    let measurement = Measurement::of(run)?;
    let instrument = &measurement.instrument;
    let bounds = LastScene::default().of(run, bare, observer)?.bounds;
    let grid = run.voxels(instrument, bounds)?;
    // One point is simulated instead of the scene.
    measurement.check_simulation(&MemoryBudget::of(run), &grid, &SceneSize::within(bounds))?;
    // Adding 0 turns a negative zero into a positive one.
    let middle = |axis: &Axis| (f64::midpoint(axis.first, axis.last()) * 1e9).round() / 1e9 + 0.0;
    let near = grid.z.first.max(instrument.wavelength());
    let depths = [near, f64::midpoint(near, grid.z.last()), grid.z.last().max(near)];
    let chosen = depths.map(|z| DVec3::new(middle(&grid.x), middle(&grid.y), z));
    let points = if points.is_empty() { &chosen[..] } else { points };
    // That of Eq. 13: of a refined volume it would be of this one point only.
    let options = run.reconstruct_options().with_refine(None);
    let spreads = points.iter().map(|p| point_spread_with(instrument, &options, &grid, *p, observer));
    Ok((grid, spreads.collect::<Result<_>>()?))
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::SweptKey;
    use crate::named::assert_names;

    #[test]
    fn swept_keys_are_ranges_or_lists() {
        let values = |typed: &str| SweptKey::parse(typed).unwrap().values;
        assert_eq!(values("array.extent=0.5:2:0.5"), ["0.5", "1", "1.5", "2"]);
        assert_eq!(values("sweep.step=0.1:0.3:0.1"), ["0.1", "0.2", "0.3"]);
        assert_eq!(values("a.b=3:1:-1"), ["3", "2", "1"]);
        assert_eq!(values("array.layout=grid, spiral"), ["grid", "spiral"]);
        assert_eq!(values("array.count=[15,15],[31,31]"), ["[15,15]", "[31,31]"]);
        for (typed, part) in [
            ("array.count", "`=`"),
            ("=1,2", "key"),
            ("a.b=", "values"),
            ("a.b=1,,2", "empty"),
            ("a.b=0:1:0", "2000"),
            ("a.b=0:1:-1", "2000"),
            ("a.b=0:1:1e-9", "2000"),
            ("a.b=nan:1:1", "2000"),
        ] {
            assert_names(SweptKey::parse(typed).unwrap_err().to_string(), &["--sweep", typed, part]);
        }
    }
}
