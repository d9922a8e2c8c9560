//! The losses of a run, kept as a table beside its checkpoint and drawn as a picture.

use std::{
    fmt::Write as _,
    path::{Path, PathBuf},
};

use plotters::prelude::{
    BLUE, ChartBuilder, Color as _, IntoDrawingArea as _, IntoLogRange as _, LineSeries, RED,
    SVGBackend, WHITE,
};

/// A loss curve: one point a step, on disk as `step,loss` lines (CSV) and as an SVG picture.
#[derive(Debug, Default)]
pub struct LossCurve {
    points: Vec<(u64, f32)>,
}

impl LossCurve {
    /// Reads the curve that [`Self::write`] left in `dir`, up to before step `until`; empty where there is none.
    ///
    /// # Errors
    /// When the file exists but cannot be read or is no such table.
    pub fn resume(dir: &Path, until: u64) -> std::io::Result<Self> {
        let text = match std::fs::read_to_string(table(dir)) {
            Ok(text) => text,
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => String::new(),
            Err(error) => return Err(error),
        };
        let point = |line: &str| {
            let (step, loss) = line.split_once(',')?;
            Some((step.parse().ok()?, loss.parse().ok()?))
        };
        let points = text
            .lines()
            .skip(1)
            .map(|line| {
                point(line).ok_or_else(|| {
                    let what = format!("{}: not `step,loss`: {line:?}", table(dir).display());
                    std::io::Error::new(std::io::ErrorKind::InvalidData, what)
                })
            })
            .filter(|point| !matches!(point, Ok((step, _)) if *step >= until))
            .collect::<Result<_, _>>()?;
        Ok(Self { points })
    }

    /// Adds the loss of `step`.
    pub fn push(&mut self, step: u64, loss: f32) {
        self.points.push((step, loss));
    }

    /// The mean of the last `n` losses; NaN where there are none.
    #[must_use]
    pub fn recent_mean(&self, n: usize) -> f32 {
        let recent = self.points.iter().rev().take(n);
        let count = recent.clone().count() as f32;
        recent.map(|(_, loss)| loss).sum::<f32>() / count
    }

    /// Writes `loss.csv` and `loss.svg` into `dir`.
    ///
    /// # Errors
    /// When a file cannot be written.
    pub fn write(&self, dir: &Path, title: &str) -> std::io::Result<()> {
        let mut text = String::from("step,loss\n");
        for (step, loss) in &self.points {
            // Writing to a string cannot fail.
            let _ = writeln!(text, "{step},{loss}");
        }
        // In one move: half a table could not be resumed from.
        let partial = table(dir).with_extension("partial");
        std::fs::write(&partial, text)?;
        std::fs::rename(&partial, table(dir))?;
        self.draw(&dir.join("loss.svg"), title)
            .map_err(|error| std::io::Error::other(format!("loss.svg: {error}")))
    }

    /// The raw losses in light red, their moving average in blue, on a logarithmic scale.
    fn draw(&self, path: &Path, title: &str) -> Result<(), Box<dyn std::error::Error>> {
        let positive: Vec<(f64, f64)> = self
            .points
            .iter()
            .filter(|(_, loss)| loss.is_finite() && *loss > 0.0)
            .map(|(step, loss)| (*step as f64, f64::from(*loss)))
            .collect();
        let mut average = positive.clone();
        let mut mean = positive.first().map_or(0.0, |(_, loss)| *loss);
        for (_, loss) in &mut average {
            mean += 0.05 * (*loss - mean);
            *loss = mean;
        }
        let low = positive
            .iter()
            .map(|(_, loss)| *loss)
            .fold(f64::INFINITY, f64::min);
        let high = positive.iter().map(|(_, loss)| *loss).fold(0.0, f64::max);
        let (low, high) = if positive.is_empty() {
            (0.1, 1.0)
        } else {
            (low, high * 1.01)
        };
        let last = positive.last().map_or(1.0, |(step, _)| step.max(1.0));

        let area = SVGBackend::new(path, (900, 500)).into_drawing_area();
        area.fill(&WHITE)?;
        let mut chart = ChartBuilder::on(&area)
            .caption(title, ("sans-serif", 22))
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
        chart.draw_series(LineSeries::new(positive, RED.mix(0.25)))?;
        chart.draw_series(LineSeries::new(average, BLUE.stroke_width(2)))?;
        area.present()?;
        Ok(())
    }
}

fn table(dir: &Path) -> PathBuf {
    dir.join("loss.csv")
}

#[cfg(test)]
mod tests {
    use super::LossCurve;

    #[test]
    fn it_is_drawn_and_resumed_without_what_is_done_again() {
        let dir = tempfile::tempdir().unwrap();
        let mut curve = LossCurve::resume(dir.path(), 0).unwrap();
        for step in 0..50 {
            curve.push(step, 1.0 / (step + 1) as f32);
        }
        curve.write(dir.path(), "a run").unwrap();
        let picture = std::fs::read_to_string(dir.path().join("loss.svg")).unwrap();
        assert!(picture.contains("<svg") && picture.contains("a run"));
        let resumed = LossCurve::resume(dir.path(), 10).unwrap();
        assert_eq!(resumed.points.len(), 10);
        assert!((resumed.recent_mean(1) - 0.1).abs() < 1e-6);
    }

    #[test]
    fn an_empty_curve_is_drawn_and_a_broken_table_is_refused() {
        let dir = tempfile::tempdir().unwrap();
        LossCurve::default()
            .write(dir.path(), "nothing yet")
            .unwrap();
        std::fs::write(dir.path().join("loss.csv"), "step,loss\nnonsense\n").unwrap();
        assert!(LossCurve::resume(dir.path(), 1).is_err());
    }
}
