use std::{
    fs::File,
    io::{BufRead as _, BufReader, BufWriter, ErrorKind, Write as _},
    path::{Path, PathBuf},
};

use anyhow::{Context as _, Result};
use plotters::prelude::{
    BLUE, ChartBuilder, Color as _, IntoDrawingArea as _, IntoLogRange as _, LineSeries, RED,
    SVGBackend, WHITE,
};
use serde::{Deserialize, Serialize};
use wm_evaluation::Figure;

use super::StepLoss;

/// The history of a run, on disk as `NAME.journal.jsonl`: one JSON object per step
/// (`{"step", "loss", "gradient_norm", "learning_rate", PART...}`) and per validation
/// (`{"step", "validation": {NAME: VALUE}}`).
#[derive(Debug, Default)]
pub struct Journal {
    name: String,
    entries: Vec<Entry>,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
enum Entry {
    Validation {
        step: u64,
        validation: serde_json::Map<String, serde_json::Value>,
    },
    Step {
        step: u64,
        loss: f32,
        gradient_norm: f64,
        learning_rate: f64,
        #[serde(flatten)]
        parts: serde_json::Map<String, serde_json::Value>,
    },
}

impl Entry {
    /// Steps completed by then.
    fn done(&self) -> u64 {
        match self {
            Self::Validation { step, .. } => *step,
            Self::Step { step, .. } => step + 1,
        }
    }
}

impl Journal {
    /// Reads the journal that [`Self::write`] wrote into `folder` for the training `name`, up to `done` steps; empty if
    /// missing.
    ///
    /// # Errors
    /// If the file exists but is unreadable or invalid.
    pub fn resume(folder: &Path, name: &str, done: u64) -> Result<Self> {
        let path = file(folder, name);
        let mut entries = Vec::new();
        let name = name.to_owned();
        let lines = match File::open(&path) {
            Ok(file) => BufReader::new(file).lines(),
            Err(error) if error.kind() == ErrorKind::NotFound => return Ok(Self { name, entries }),
            Err(error) => return Err(error).context(path.display().to_string()),
        };
        for (number, line) in (1..).zip(lines) {
            let line = line.with_context(|| path.display().to_string())?;
            let entry: Entry = serde_json::from_str(&line)
                .with_context(|| format!("{}, line {number}", path.display()))?;
            if entry.done() <= done {
                entries.push(entry);
            }
        }
        Ok(Self { name, entries })
    }

    /// Records a step.
    pub fn step(&mut self, step: u64, found: &StepLoss, gradient_norm: f64, learning_rate: f64) {
        let parts = found.parts.iter();
        self.entries.push(Entry::Step {
            step,
            loss: found.loss,
            gradient_norm,
            learning_rate,
            parts: parts
                .map(|(name, value)| ((*name).to_owned(), (*value).into()))
                .collect(),
        });
    }

    /// Records a validation after `step` steps.
    pub fn validated(&mut self, step: u64, figures: Vec<Figure>) {
        let figures = figures.into_iter();
        self.entries.push(Entry::Validation {
            step,
            validation: figures.map(|f| (f.name, f.value.into())).collect(),
        });
    }

    /// Mean of the last `n` losses; NaN without any.
    #[must_use]
    pub fn recent_mean(&self, n: usize) -> f32 {
        let losses = self.entries.iter().rev().filter_map(|entry| match entry {
            Entry::Step { loss, .. } => Some(*loss),
            Entry::Validation { .. } => None,
        });
        let (mut sum, mut count) = (0.0, 0.0);
        for loss in losses.take(n) {
            sum += loss;
            count += 1.0;
        }
        sum / count
    }

    /// Writes `NAME.journal.jsonl` and the loss curve `NAME.loss.svg` into `folder`.
    ///
    /// # Errors
    /// If a file cannot be written.
    pub fn write(&self, folder: &Path) -> Result<()> {
        let path = file(folder, &self.name);
        // An atomic rename: half a journal is useless.
        let partial = path.with_extension("partial");
        let write = || -> std::io::Result<()> {
            let mut out = BufWriter::new(File::create(&partial)?);
            for entry in &self.entries {
                serde_json::to_writer(&mut out, entry)?;
                out.write_all(b"\n")?;
            }
            out.flush()?;
            std::fs::rename(&partial, &path)
        };
        write().with_context(|| path.display().to_string())?;
        let picture = folder.join(format!("{}.loss.svg", self.name));
        self.draw(&picture)
            .map_err(|error| anyhow::anyhow!("{}: {error}", picture.display()))
    }

    /// Draws raw losses in light red and their moving average in blue, on a logarithmic scale.
    fn draw(&self, path: &Path) -> Result<(), Box<dyn std::error::Error>> {
        let losses = self.entries.iter().filter_map(|entry| match entry {
            Entry::Step { step, loss, .. } if loss.is_finite() && *loss > 0.0 => {
                Some((*step as f64, f64::from(*loss)))
            }
            _ => None,
        });
        let losses: Vec<(f64, f64)> = losses.collect();
        let mut average = losses.clone();
        let mut mean = losses.first().map_or(0.0, |(_, loss)| *loss);
        for (_, loss) in &mut average {
            mean += 0.05 * (*loss - mean);
            *loss = mean;
        }
        let values = || losses.iter().map(|(_, loss)| *loss);
        let (low, high) = if losses.is_empty() {
            (0.1, 1.0)
        } else {
            let high = values().fold(0.0, f64::max);
            (values().fold(f64::INFINITY, f64::min), high * 1.01)
        };
        let last = losses.last().map_or(1.0, |(step, _)| step.max(1.0));

        let area = SVGBackend::new(path, (900, 500)).into_drawing_area();
        area.fill(&WHITE)?;
        let mut chart = ChartBuilder::on(&area)
            .caption(format!("{}: loss", self.name), ("sans-serif", 22))
            .margin(12)
            .x_label_area_size(40)
            .y_label_area_size(70)
            .build_cartesian_2d(0.0..last, (low..high).log_scale())?;
        chart
            .configure_mesh()
            .x_desc("step")
            .y_desc("loss")
            .x_label_formatter(&|step| format!("{step:.0}"))
            .y_label_formatter(&|loss| format!("{loss:.4}"))
            .draw()?;
        chart.draw_series(LineSeries::new(losses, RED.mix(0.25)))?;
        chart.draw_series(LineSeries::new(average, BLUE.stroke_width(2)))?;
        area.present()?;
        Ok(())
    }
}

fn file(folder: &Path, name: &str) -> PathBuf {
    folder.join(format!("{name}.journal.jsonl"))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn loss(loss: f32) -> StepLoss {
        StepLoss {
            loss,
            parts: vec![("cosine", 0.5)],
            gradient: Vec::new(),
        }
    }

    #[test]
    fn journal_is_drawn_and_resumed_up_to_the_checkpoint() {
        let dir = tempfile::tempdir().unwrap();
        let mut journal = Journal::resume(dir.path(), "a_run", 0).unwrap();
        for step in 0..50 {
            journal.step(step, &loss(1.0 / (step + 1) as f32), 2.0, 1e-3);
            if step % 10 == 9 {
                journal.validated(step + 1, vec![Figure::new("ratio_k1", 0.4)]);
            }
        }
        journal.write(dir.path()).unwrap();
        let picture = std::fs::read_to_string(dir.path().join("a_run.loss.svg")).unwrap();
        assert!(picture.contains("<svg") && picture.contains("a_run"));
        let resumed = Journal::resume(dir.path(), "a_run", 10).unwrap();
        assert_eq!(resumed.entries, journal.entries[..11]);
        assert!((resumed.recent_mean(1) - 0.1).abs() < 1e-6);
    }

    #[test]
    fn empty_journal_is_drawn_and_broken_line_named() {
        let dir = tempfile::tempdir().unwrap();
        Journal::default().write(dir.path()).unwrap();
        std::fs::write(file(dir.path(), "a_run"), "nonsense\n").unwrap();
        let error = format!("{:#}", Journal::resume(dir.path(), "a_run", 1).unwrap_err());
        assert!(error.contains("line 1"), "{error}");
    }
}
