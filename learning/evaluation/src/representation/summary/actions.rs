//! What the inverse dynamics models tell.

use wm_metrics::findings::{Better, Section, TextTable};

use super::super::{Told, ToldActions};
use crate::{Settings, action_correlation::correlation, figures::figure_of_units};

/// Rows of actions, as told from some latents.
pub(super) type Rows = fn(&Told) -> &Vec<Vec<f32>>;

/// Mean of Pearson's r over the dimensions that are no gripper and vary.
fn mean_r(windows: &[&ToldActions], chosen: &[usize], model: usize, of: Rows) -> f64 {
    let rs = rs(windows, chosen, model, of);
    rs.iter().map(|(_, r)| r).sum::<f64>() / rs.len() as f64
}

fn rs(windows: &[&ToldActions], chosen: &[usize], model: usize, of: Rows) -> Vec<(String, f64)> {
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
        let r = correlation(&values(of), &values(|told| &told.truth))?;
        Some((name.clone(), r))
    });
    each.collect()
}

/// Adds the correlations of one model.
pub(super) fn of_model(
    section: &mut Section,
    windows: &[&ToldActions],
    settings: &Settings,
    model: usize,
) {
    let Some(told) = windows.first().and_then(|found| found.models.get(model)) else {
        return;
    };
    let Told { name, k, space, .. } = told;
    let sources: [(&str, &str, Rows); 2] = [
        ("real", "the latents of the frames", |told| &told.real),
        ("predicted", "predicted latents", |told| &told.predicted),
    ];
    let mut by_dimension = Vec::new();
    for (source, about, of) in sources {
        let about = format!(
            "Pearson's r of actions told from {about} with the true ones, mean over the dimensions; inverse dynamics \
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
    let about = "real minus predicted: action information that the prediction erases";
    let drop = figure_of_units(windows.len(), settings, Better::Lower, about, |chosen| {
        mean_r(windows, chosen, model, |told| &told.real)
            - mean_r(windows, chosen, model, |told| &told.predicted)
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
