//! `plan --sweep`: every combination of swept keys as a table, charts, and with --simulate what each is worth.

use super::{charts, columns, decibels};
use crate::cli::Overrides;
use crate::cli::inputs::{bare_mesh, run_file_of};
use crate::cli::outputs::{open_folder, print_json, write_json};
use crate::cli::summary::{duration, millimetres};
use crate::cli::terminal::{Terminal, observed, print};
use crate::error::{Error, Result, gib};
use crate::files::OutputFolder;
use crate::metrics::Measure;
use crate::pipeline::{
    self, BareMesh, Combination, DesignRow, DesignSweep, JobOptions, RunWith, SweepSimulation, SweptKey,
};
use crate::progress::Observer;
use std::fmt::Write;
use std::path::{Path, PathBuf};

/// The folder, in that of the results, of finished combinations.
const FINISHED: &str = "combinations";

/// The files of a sweep, of which the last is only written when it was simulated.
const FILES: [&str; 4] = ["sweep.csv", "sweep.json", "sweep.png", "pareto.png"];

/// Rows that are printed; of more those on a front, and all of them are in `sweep.csv`.
const PRINTED: usize = 200;

/// A sweep as typed.
pub(in crate::cli) struct SweepCommand<'a> {
    pub(in crate::cli) input: &'a Path,
    pub(in crate::cli) keys: &'a [String],
    pub(in crate::cli) folder: Option<&'a Path>,
    pub(in crate::cli) overrides: &'a Overrides,
}

impl SweepCommand<'_> {
    /// Calls `work` with the keys, the run file of each combination and the options of their jobs.
    fn with_runs<T>(
        &self,
        terminal: &Terminal,
        work: impl FnOnce(&[SweptKey], &RunWith, &JobOptions) -> Result<T>,
    ) -> Result<T> {
        let keys: Vec<SweptKey> =
            self.keys.iter().map(|typed| SweptKey::parse(typed)).collect::<Result<_>>()?;
        let typed = self.overrides.keys()?;
        // Of a mesh the place stays as it is before the array that suits it, whatever array is planned.
        let bare: Option<BareMesh> = bare_mesh(self.input, &typed, terminal)?;
        let run_with = |set: &[String]| {
            let typed = [&typed[..], set].concat();
            match &bare {
                Some(bare) => bare.run_with(&typed),
                None => run_file_of(self.input, &typed),
            }
        };
        work(&keys, &run_with, &observed(terminal).with_bare_mesh(bare.as_ref()))
    }

    /// Predicts the combinations: a table on standard output, and files in the folder, if there is one.
    pub(in crate::cli) fn predict(&self, terminal: &Terminal) -> Result<()> {
        let folder = self.folder.map(|folder| open_folder(folder, &FILES[..3])).transpose()?;
        let sweep = self.with_runs(terminal, pipeline::sweep_designs)?;
        conclude(&sweep, folder.as_ref(), terminal)
    }

    /// Simulates those that are not finished: a table on standard output, and files in the folder, if there is one.
    pub(in crate::cli) fn simulate(
        &self,
        seeds: &[u32],
        measure: &Measure,
        terminal: &Terminal,
    ) -> Result<()> {
        let (folder, finished) = self.folder.map(open_results).transpose()?.unzip();
        let simulation = SweepSimulation { seeds, measure, folder: finished.as_deref() };
        let sweep = self.with_runs(terminal, |keys, run_with, job| {
            pipeline::simulate_designs(keys, run_with, &simulation, job)
        });
        let sweep = sweep.inspect_err(|error| advise(error, finished.as_deref(), terminal))?;
        conclude(&sweep, folder.as_ref(), terminal)
    }

    /// Simulates a part of them into the folder.
    pub(in crate::cli) fn work(
        &self,
        seeds: &[u32],
        measure: &Measure,
        part: (u64, u64),
        terminal: &Terminal,
    ) -> Result<()> {
        let folder = self.folder.unwrap_or(Path::new("."));
        let _shared = OutputFolder::shared(folder)?;
        let finished = folder.join(FINISHED);
        let simulation = SweepSimulation { seeds, measure, folder: Some(&finished) };
        let done = self.with_runs(terminal, |keys, run_with, job| {
            pipeline::work_on_designs(keys, run_with, &simulation, part, job)
        });
        let done = done.inspect_err(|error| advise(error, Some(&finished), terminal))?;
        if terminal.json() {
            return print_json(&done);
        }
        if terminal.is_quiet() {
            return Ok(());
        }
        print(&format!(
            "computed {} of {} combinations, {} of this part were there, {} are refused; the same command without --part makes \
             the table of all {}\n",
            done.computed, done.part, done.found, done.refused, done.combinations
        ))
    }
}

/// Tells after an interruption how to go on.
fn advise(error: &Error, finished: Option<&Path>, terminal: &Terminal) {
    if let (Error::Interrupted, Some(folder)) = (error, finished.filter(|folder| folder.is_dir())) {
        terminal.advise(Some(format!(
            "finished combinations are stored in {}; the same command resumes from there",
            folder.display()
        )));
    }
}

/// Opens the folder of a simulated sweep; returns it with the files to be written there, and the folder of what is finished.
pub(crate) fn open_results(folder: &Path) -> Result<((OutputFolder, Vec<PathBuf>), PathBuf)> {
    Ok((open_folder(folder, FILES)?, folder.join(FINISHED)))
}

/// Writes the files of a sweep, as many as there are paths for.
pub(crate) fn write_files(files: &[PathBuf], sweep: &DesignSweep) -> Result<()> {
    sweep.write_csv(&files[0])?;
    write_json(&files[1], sweep)?;
    charts::write_sweep(&files[2], sweep)?;
    files.get(3).map_or(Ok(()), |pareto| charts::write_pareto(pareto, sweep))
}

/// Warns of refusals, writes the files and prints the table.
fn conclude(
    sweep: &DesignSweep,
    folder: Option<&(OutputFolder, Vec<PathBuf>)>,
    terminal: &Terminal,
) -> Result<()> {
    warn_of_refusals(sweep, terminal);
    if let Some((_, files)) = folder {
        write_files(files, sweep)?;
    }
    if terminal.json() {
        return print_json(sweep);
    }
    print(&if sweep.measure.is_some() { simulated_table(sweep) } else { predicted_table(sweep) })
}

fn warn_of_refusals(sweep: &DesignSweep, observer: &dyn Observer) {
    let refused = || sweep.combinations.iter().filter(|combination| combination.refused.is_some());
    for combination in refused().take(PRINTED) {
        let why = combination.refused.as_deref().unwrap_or_default();
        observer.warn(&format!("{}: {why}", combination.values.join(" ")));
    }
    if refused().count() > PRINTED {
        observer.warn(&format!("and {} more are refused", refused().count() - PRINTED));
    }
}

/// Which combinations are printed, and a line about the others.
fn printed(sweep: &DesignSweep) -> (Vec<&Combination>, String) {
    let all = &sweep.combinations;
    if all.len() <= PRINTED {
        return (all.iter().collect(), String::new());
    }
    let on_front = |combination: &&Combination| {
        combination.simulated.as_ref().is_some_and(|simulated| simulated.front.all)
    };
    let shown: Vec<&Combination> = match &sweep.measure {
        Some(_) => all.iter().filter(on_front).take(PRINTED).collect(),
        None => all.iter().take(PRINTED).collect(),
    };
    let line =
        format!("{} of {} combinations; -o DIR writes all of them into sweep.csv\n", shown.len(), all.len());
    (shown, line)
}

/// The rows of a table: the values of each combination and its cells, or dashes.
fn table(
    sweep: &DesignSweep,
    header: &[&str],
    cells: impl Fn(&Combination) -> Option<Vec<String>>,
) -> String {
    let header: Vec<String> = header.iter().map(|&name| name.to_owned()).collect();
    let mut rows = vec![[&sweep.keys[..], &header].concat()];
    let (shown, line) = printed(sweep);
    for combination in shown {
        let dashes = || header.iter().map(|_| "-".to_owned()).collect();
        rows.push([&combination.values[..], &cells(combination).unwrap_or_else(dashes)].concat());
    }
    columns(&rows) + &line
}

fn predicted_table(sweep: &DesignSweep) -> String {
    let header = [
        "mics",
        "frequencies",
        "measured in",
        "range mm",
        "near mm",
        "middle mm",
        "far mm",
        "aliasing",
        "lobe m",
        "peak dB",
        "mean dB",
        "memory",
        "time",
    ];
    table(sweep, &header, |combination| combination.design.as_ref().map(predicted_cells))
        + "measured in: time of the measurement; near, middle, far: lateral -3 dB width, with the window; lobe: distance of the \
           nearest grating lobe from a point at the nearest depth; peak, mean: sidelobes within the grid by the array factor\n"
}

fn predicted_cells(design: &DesignRow) -> Vec<String> {
    let [near, middle, far] = design.widths.map(millimetres);
    let cost = design.cost.map(|cost| (gib(cost.peak_bytes), duration(cost.seconds)));
    let (memory, time) = cost.unwrap_or_else(|| ("-".to_owned(), "-".to_owned()));
    vec![
        design.microphones.to_string(),
        design.tones.to_string(),
        duration(design.acquisition.seconds),
        millimetres(design.range_resolution),
        near,
        middle,
        far,
        design.verdict.word().to_owned(),
        design.grating_lobe_offset.map_or("-".to_owned(), |m| format!("{m:.2}")),
        decibels(design.peak_sidelobe_db),
        decibels(design.mean_sidelobe_db),
        memory,
        time,
    ]
}

fn simulated_table(sweep: &DesignSweep) -> String {
    let header = [
        "mics",
        "measured in",
        "complete",
        "false",
        "median mm",
        "rmse mm",
        "f1",
        "error",
        "expect",
        "front",
    ];
    let measure = sweep.measure.as_deref().unwrap_or_default();
    let mut text = table(sweep, &header, |combination| simulated_cells(combination, measure));
    let seeds =
        sweep.combinations.iter().find_map(|combination| Some(combination.simulated.as_ref()?.seeds.len()));
    let _ = writeln!(
        text,
        "means of {} seeds; error: by {measure}; front: nothing is better in error, time of the measurement and microphones (*), in \
         error and time (t), or in error and microphones (m)",
        seeds.unwrap_or(0)
    );
    text
}

fn simulated_cells(combination: &Combination, measure: &str) -> Option<Vec<String>> {
    let (design, simulated) = (combination.design.as_ref()?, combination.simulated.as_ref()?);
    let mean = &simulated.mean;
    let share = |value: Option<f64>| value.map_or("-".to_owned(), |value| format!("{value:.3}"));
    let error = simulated.error.map_or("-".to_owned(), |error| charts::error_text(measure, error));
    let front = simulated.front;
    let marks = [(front.all, '*'), (front.time, 't'), (front.microphones, 'm')];
    Some(vec![
        design.microphones.to_string(),
        duration(design.acquisition.seconds),
        share(mean.completeness),
        share(mean.false_returns),
        millimetres(mean.median_error),
        millimetres(mean.rmse),
        share(mean.f1),
        error,
        simulated.expected.map_or("-", |kept| if kept { "met" } else { "missed" }).to_owned(),
        marks.into_iter().filter(|(on_it, _)| *on_it).map(|(_, mark)| mark).collect(),
    ])
}
