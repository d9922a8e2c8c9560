use wm_metrics::findings::{Better, Curve, Section, Series, Suite, TextTable};

use super::{Change, UnderChange, WindowRobustness};
use crate::{
    Settings,
    figures::{figure_of_units, mean_over_units, most_changed},
};

/// Findings of all windows, in order.
#[must_use]
pub fn summarise(windows: &[(String, WindowRobustness)], settings: &Settings) -> Section {
    let mut section = Section::new(Suite::Robustness);
    let steps = settings.robustness.steps;
    let of = |index: usize, change: Change| -> Option<&UnderChange> {
        let (_, found) = windows.get(index)?;
        found.changes.iter().find(|own| own.change == change)
    };
    let ratio = |chosen: &[usize], change: Change, k: usize| {
        let (mut error, mut held) = (0.0, 0.0);
        for found in chosen.iter().filter_map(|index| of(*index, change)) {
            if let Some((of_model, of_held)) = found.error.get(k).zip(found.persistence.get(k)) {
                error += of_model;
                held += of_held;
            }
        }
        error / held
    };
    let all: Vec<usize> = (0..windows.len()).collect();
    let mut curve = Curve {
        title: "Latent error / persistence by step, under changes".into(),
        x: "predicted step k".into(),
        y: "squared latent error / persistence".into(),
        series: Vec::new(),
    };
    let mut rows = Vec::new();
    for change in Change::ALL {
        let name = change.name();
        if !windows.is_empty() && of(0, change).is_none() {
            section.absent(
                &format!("ratio_k1_{name}"),
                "a model step is one camera frame",
            );
            continue;
        }
        let mut row = vec![change.to_string()];
        for k in [1, steps] {
            let about = format!(
                "squared latent error over that of persistence at k = {k}; {change}; above 1, persistence is the better \
                 guess"
            );
            let metric =
                figure_of_units(windows.len(), settings, Better::Lower, &about, |chosen| {
                    ratio(chosen, change, k - 1)
                });
            row.push(
                metric
                    .as_ref()
                    .map_or("-".into(), |m| format!("{:.3}", m.value)),
            );
            if let Some(metric) = metric {
                section.metric(&format!("ratio_k{k}_{name}"), metric);
            }
            // The same windows under every change.
            let moving = most_changed(windows.len(), |index| {
                let found = of(index, Change::None)?;
                found.persistence.get(k - 1).copied()
            });
            let about =
                format!("{about}, on the half of the windows that change most until k = {k}");
            let metric = figure_of_units(moving.len(), settings, Better::Lower, &about, |chosen| {
                let chosen = chosen
                    .iter()
                    .filter_map(|place| moving.get(*place).copied());
                ratio(&chosen.collect::<Vec<_>>(), change, k - 1)
            });
            if let Some(metric) = metric {
                section.metric(&format!("ratio_k{k}_{name}_moving"), metric);
            }
        }
        // PSNR itself is higher for darker pictures, whatever the prediction.
        let gains: Vec<(String, f64)> = windows
            .iter()
            .enumerate()
            .filter_map(|(index, (name, _))| {
                let found = of(index, change)?;
                let pairs = found.psnr.iter().zip(&found.held_psnr);
                let gains: Vec<f64> = pairs.map(|(own, held)| own - held).collect();
                let mean = gains.iter().sum::<f64>() / gains.len() as f64;
                (!gains.is_empty()).then(|| (name.clone(), mean))
            })
            .collect();
        let about = format!(
            "PSNR of decoded predictions minus that of the last observed frame, repeated; mean over the steps; {change}"
        );
        let metric = mean_over_units(&gains, settings, Better::Higher, &about);
        row.push(
            metric
                .as_ref()
                .map_or("-".into(), |m| format!("{:.2}", m.value)),
        );
        if let Some(metric) = metric {
            section.metric(&format!("psnr_gain_{name}"), metric.in_unit("dB"));
        }
        rows.push(row);
        let points = (0..steps).map(|k| [(k + 1) as f64, ratio(&all, change, k)]);
        curve.series.push(Series {
            name: change.to_string(),
            points: points.filter(|[_, y]| y.is_finite()).collect(),
            band: Vec::new(),
        });
    }
    section.curves.push(curve);
    section.tables.push(TextTable {
        title: "Reliability under changed inputs".into(),
        header: vec![
            "frames".into(),
            "error / persistence, k = 1".into(),
            format!("error / persistence, k = {steps}"),
            "PSNR over persistence [dB]".into(),
        ],
        rows,
    });
    section
}
