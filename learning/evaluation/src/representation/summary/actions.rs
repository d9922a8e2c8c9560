//! Findings of the inverse dynamics models.

use wm_metrics::findings::{Better, Section, TextTable};

use super::super::{IdmActions, InferredActions};
use crate::{Settings, action_correlation::correlation, figures::figure_of_units};

/// Rows of actions, inferred from some latents.
pub(super) type Rows = fn(&IdmActions) -> &Vec<Vec<f32>>;

/// Mean of Pearson's r over varying dimensions without grippers.
fn mean_r(windows: &[&InferredActions], chosen: &[usize], model: usize, of: Rows) -> f64 {
    let rs = rs(windows, chosen, model, of);
    rs.iter().map(|(_, r)| r).sum::<f64>() / rs.len() as f64
}

fn rs(
    windows: &[&InferredActions],
    chosen: &[usize],
    model: usize,
    of: Rows,
) -> Vec<(String, f64)> {
    let chosen = || {
        let chosen = chosen.iter().filter_map(|index| windows.get(*index));
        chosen.filter_map(move |found| found.models.get(model))
    };
    let Some(first) = windows.first() else {
        return Vec::new();
    };
    let dimensions = first.dimensions.iter().enumerate();
    let continuous = dimensions.filter(|(_, (_, kind))| !kind.is_gripper());
    let each = continuous.filter_map(|(column, (name, _))| {
        let values = |rows: Rows| -> Vec<f64> {
            let rows = chosen().flat_map(rows);
            rows.filter_map(|row| row.get(column).map(|v| f64::from(*v)))
                .collect()
        };
        let r = correlation(&values(of), &values(|inferred| &inferred.truth))?;
        Some((name.clone(), r))
    });
    each.collect()
}

/// Adds the correlations of one model.
pub(super) fn of_model(
    section: &mut Section,
    windows: &[&InferredActions],
    settings: &Settings,
    model: usize,
) {
    let Some(inferred) = windows.first().and_then(|found| found.models.get(model)) else {
        return;
    };
    let IdmActions { name, k, space, .. } = inferred;
    let sources: [(&str, &str, Rows); 2] = [
        ("real", "the latents of the frames", |inferred| {
            &inferred.real
        }),
        ("predicted", "predicted latents", |inferred| {
            &inferred.predicted
        }),
    ];
    let mut by_dimension = Vec::new();
    for (source, about, of) in sources {
        let about = format!(
            "Pearson's r of actions inferred from {about} with the true ones, mean over the dimensions; inverse dynamics \
             model of k = {k} in {space}"
        );
        let metric = figure_of_units(windows.len(), settings, Better::Higher, &about, |chosen| {
            mean_r(windows, chosen, model, of)
        });
        match metric {
            Some(metric) => section.metric(&format!("{name}_r_{source}"), metric),
            None => section.absent(
                &format!("{name}_r_{source}"),
                "no action varies in the data",
            ),
        }
        let all: Vec<usize> = (0..windows.len()).collect();
        by_dimension.push(rs(windows, &all, model, of));
    }
    let about = "real minus predicted: action information lost by the prediction";
    let drop = figure_of_units(windows.len(), settings, Better::Lower, about, |chosen| {
        mean_r(windows, chosen, model, |inferred| &inferred.real)
            - mean_r(windows, chosen, model, |inferred| &inferred.predicted)
    });
    if let Some(metric) = drop {
        section.metric(&format!("{name}_r_drop"), metric);
    }
    if let [real, predicted] = by_dimension.as_slice() {
        let rows = real
            .iter()
            .zip(predicted)
            .map(|((dimension, real), (_, predicted))| {
                vec![
                    dimension.clone(),
                    format!("{real:.3}"),
                    format!("{predicted:.3}"),
                ]
            });
        section.tables.push(TextTable {
            title: format!("Pearson's r of each dimension, k = {k}, {space}"),
            header: ["dimension", "real latents", "predicted latents"]
                .map(String::from)
                .into(),
            rows: rows.collect(),
        });
    }
}
