//! A sweep as a table: one row for each combination, as comma-separated values.

use super::{Combination, DesignSweep};
use crate::error::Result;
use crate::files::write_atomically;
use crate::metrics::METRIC_NAMES;
use std::io::Write;
use std::path::Path;

/// The columns of a prediction, after the keys. What depends on the computer is not among them.
const PREDICTED: [&str; 15] = [
    "microphones",
    "tones",
    "sweeps",
    "places",
    "tone_seconds",
    "tone_time",
    "acquisition_seconds",
    "range_resolution",
    "width_near",
    "width_middle",
    "width_far",
    "aliasing",
    "grating_lobe_offset",
    "peak_sidelobe_db",
    "mean_sidelobe_db",
];

impl DesignSweep {
    /// Writes the sweep as comma-separated values, quoted where necessary, with a header: the keys; predictions; of a simulated sweep the mean
    /// of every metric, its standard deviation over the seeds as `NAME_sd`, whether `[expect]` is kept, the error of the sweep's
    /// measure and the fronts; and why a combination is refused. Lengths are in m; what is not known is empty.
    ///
    /// # Errors
    /// [`Error::Io`](crate::error::Error::Io) when the file cannot be written.
    pub fn write_csv(&self, path: &Path) -> Result<()> {
        let text = self.csv();
        write_atomically(path, |file| file.write_all(text.as_bytes()))
    }

    fn csv(&self) -> String {
        let mut header = self.keys.clone();
        header.extend(PREDICTED.map(str::to_owned));
        if self.measure.is_some() {
            header.push("seeds".to_owned());
            header.extend(METRIC_NAMES.map(str::to_owned));
            header.extend(METRIC_NAMES.map(|name| format!("{name}_sd")));
            header.extend(["expect", "error", "front", "front_time", "front_microphones"].map(str::to_owned));
        }
        header.push("refused".to_owned());
        let width = header.len();
        let rows = self.combinations.iter().map(|combination| cells(combination, width));
        std::iter::once(header).chain(rows).map(|cells| line(&cells)).collect()
    }
}

/// The row of a combination, of so many cells.
fn cells(combination: &Combination, width: usize) -> Vec<String> {
    let mut cells = combination.values.clone();
    if let Some(design) = &combination.design {
        let time = &design.acquisition;
        cells.extend([design.microphones, design.tones].map(|count| count.to_string()));
        cells.extend([time.sweeps.to_string(), time.places.to_string(), time.tone_seconds.to_string()]);
        cells.extend([time.tone_time.to_string(), time.seconds.to_string()]);
        cells.push(number(design.range_resolution));
        cells.extend(design.widths.map(number));
        cells.push(design.verdict.word().to_owned());
        cells.push(number(design.grating_lobe_offset));
        cells.extend([design.peak_sidelobe_db, design.mean_sidelobe_db].map(number));
    }
    if let Some(simulated) = &combination.simulated {
        cells.push(simulated.seeds.len().to_string());
        for metrics in [&simulated.mean, &simulated.spread] {
            cells.extend(metrics.iter().map(|(_, value)| number(value)));
        }
        let expected = simulated.expected.map_or("", |kept| if kept { "met" } else { "missed" });
        cells.extend([expected.to_owned(), number(simulated.error)]);
        let front = simulated.front;
        cells.extend([front.all, front.time, front.microphones].map(|on_it| u8::from(on_it).to_string()));
    }
    cells.resize(width - 1, String::new());
    cells.push(combination.refused.clone().unwrap_or_default());
    cells
}

/// A number with all its digits, or nothing.
fn number(value: Option<f64>) -> String {
    value.map_or(String::new(), |value| value.to_string())
}

/// A line of the table.
fn line(cells: &[String]) -> String {
    let quoted = |cell: &String| {
        if cell.contains([',', '"', '\n', '\r']) {
            format!("\"{}\"", cell.replace('"', "\"\""))
        } else {
            cell.clone()
        }
    };
    cells.iter().map(quoted).collect::<Vec<_>>().join(",") + "\n"
}

#[cfg(test)]
mod tests {
    use super::line;

    #[test]
    fn cells_with_commas_quotes_and_breaks_are_quoted() {
        let cells = ["[15,15]", "a", "say \"no\"", "two\nlines", ""].map(str::to_owned);
        assert_eq!(line(&cells), "\"[15,15]\",a,\"say \"\"no\"\"\",\"two\nlines\",\n");
    }
}
