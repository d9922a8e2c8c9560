//! Findings of the inverse dynamics models.

use wm_metrics::findings::{Better, Section, TextTable};

use super::super::{
    IdmActions, InferredActions,
    recovery::{Source, WRONG},
};
use crate::{
    ActionChange, Settings,
    action_correlation::correlation,
    figures::{figure_of_units, most_changed},
};

/// Mean of Pearson's r over varying dimensions without grippers.
fn mean_r(windows: &[&InferredActions], chosen: &[usize], model: usize, from: Source) -> f64 {
    let rs = rs(windows, chosen, model, from);
    rs.iter().map(|(_, r)| r).sum::<f64>() / rs.len() as f64
}

fn rs(
    windows: &[&InferredActions],
    chosen: &[usize],
    model: usize,
    from: Source,
) -> Vec<(String, f64)> {
    let chosen = || {
        let chosen = chosen.iter().filter_map(|index| windows.get(*index));
        let chosen = chosen.filter_map(move |found| found.models.get(model));
        chosen.filter_map(|inferred| Some((inferred.inferred(from)?, &inferred.truth)))
    };
    let Some(first) = windows.first() else {
        return Vec::new();
    };
    let dimensions = first.dimensions.iter().enumerate();
    let continuous = dimensions.filter(|(_, (_, kind))| !kind.is_gripper());
    let each = continuous.filter_map(|(column, (name, _))| {
        let value = |row: &Vec<f32>| row.get(column).map(|v| f64::from(*v));
        let inferred: Vec<f64> = chosen()
            .flat_map(|(rows, _)| rows)
            .filter_map(value)
            .collect();
        let truth: Vec<f64> = chosen()
            .flat_map(|(_, rows)| rows)
            .filter_map(value)
            .collect();
        Some((name.clone(), correlation(&inferred, &truth)?))
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
    let all: Vec<usize> = (0..windows.len()).collect();
    let moving = most_changed(windows.len(), |at| {
        windows.get(at).map(|found| found.change)
    });
    let mut add = |end: &str, about: &str, better: Better, from: Source| {
        let about = format!(
            "Pearson's r of actions inferred from {about} with the true ones, mean over the dimensions; inverse dynamics \
             model of k = {k} in {space}"
        );
        let figure = |among: &[usize], about: &str| {
            figure_of_units(among.len(), settings, better, about, |chosen| {
                let chosen = chosen.iter().filter_map(|at| among.get(*at).copied());
                mean_r(windows, &chosen.collect::<Vec<_>>(), model, from)
            })
        };
        match figure(&all, &about) {
            Some(metric) => section.metric(&format!("{name}_r_{end}"), metric),
            None => section.absent(&format!("{name}_r_{end}"), "no action varies in the data"),
        }
        let about = format!("{about}, on the half of the windows that change most");
        if let Some(metric) = figure(&moving, &about) {
            section.metric(&format!("{name}_r_{end}_moving"), metric);
        }
    };
    let (real, predicted) = (Source::Frames, Source::Predictions(ActionChange::None));
    add("real", "the latents of the frames", Better::Higher, real);
    add("predicted", "predicted latents", Better::Higher, predicted);
    let models = || windows.iter().filter_map(|found| found.models.get(model));
    for change in WRONG {
        let wrong = Source::Predictions(change);
        if models().any(|inferred| inferred.inferred(wrong).is_some()) {
            let about = format!("predictions under {change} actions");
            let end = format!("predicted_{}", change.name());
            add(&end, &about, Better::Neither, wrong);
        }
    }
    let about = "real minus predicted: action information lost by the prediction";
    let drop = figure_of_units(windows.len(), settings, Better::Lower, about, |chosen| {
        mean_r(windows, chosen, model, real) - mean_r(windows, chosen, model, predicted)
    });
    if let Some(metric) = drop {
        section.metric(&format!("{name}_r_drop"), metric);
    }
    let of_dimensions = [real, predicted].map(|from| rs(windows, &all, model, from));
    let [real, predicted] = &of_dimensions;
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Protocol;
    use wm_metrics::findings::Suite;
    use wm_motion::actions::Kind;

    /// A window whose predictions under negated actions show the opposite.
    fn window(change: f64, truth: [f32; 3], real: [f32; 3]) -> InferredActions {
        let rows = |values: [f32; 3]| values.map(|value| vec![value]).to_vec();
        InferredActions {
            dimensions: vec![("dx".into(), Kind::TranslationDelta)],
            change,
            models: vec![IdmActions {
                name: "idm_k1".into(),
                k: 1,
                space: "space".into(),
                truth: rows(truth),
                real: rows(real),
                predicted: rows(truth),
                wrong: vec![(ActionChange::Negated, rows(truth.map(|value| -value)))],
            }],
        }
    }

    #[test]
    fn moving_windows_and_wrong_actions_have_figures() {
        let still = window(0.1, [0.1, 0.0, -0.1], [-0.1, 0.0, 0.1]);
        let moves = window(2.0, [1.0, 0.0, -1.0], [1.0, 0.0, -1.0]);
        let windows = [&still, &moves];
        let mut section = Section::new(Suite::Latents);
        of_model(&mut section, &windows, &Settings::of(Protocol::Quick, 0), 0);
        let r = |name: &str| {
            section
                .metrics
                .get(&format!("latents.{name}"))
                .map(|metric| metric.value)
        };
        assert!(r("idm_k1_r_real").is_some_and(|r| r < 0.999), "{section:?}");
        for (name, expected) in [
            ("idm_k1_r_real_moving", 1.0),
            ("idm_k1_r_predicted", 1.0),
            ("idm_k1_r_predicted_negated", -1.0),
            ("idm_k1_r_predicted_negated_moving", -1.0),
        ] {
            assert!(
                r(name).is_some_and(|r| (r - expected).abs() < 1e-9),
                "{name}: {section:?}"
            );
        }
        assert_eq!(r("idm_k1_r_predicted_shuffled"), None, "no window has them");
    }
}
