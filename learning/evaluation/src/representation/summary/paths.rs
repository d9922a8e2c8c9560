//! Paths of inferred actions.

use wm_metrics::findings::{Better, Metric, Section, Trajectories};
use wm_metrics::{
    Table,
    correlation::{CanonicalCorrelation, Regularisation},
};

use super::super::InferredActions;
use super::actions::Rows;

/// Paths in a report.
const PATHS: usize = 12;

/// Paths of inferred actions in the plane of the two leading canonical directions (the paper's figure of action
/// trajectories).
pub(super) fn of_model(section: &mut Section, windows: &[&InferredActions], model: usize) {
    let models = || windows.iter().filter_map(|found| found.models.get(model));
    let Some(name) = models().next().map(|inferred| &inferred.name) else {
        return;
    };
    // Constant values, such as the gripper of a short recording, have no correlation.
    let varies = |column: &usize| {
        let mut values = models()
            .flat_map(|t| &t.truth)
            .filter_map(|row| row.get(*column));
        let first = values.next();
        values.any(|value| Some(value) != first)
    };
    let width = models().find_map(|inferred| Some(inferred.truth.first()?.len()));
    // Without readers the table has no columns.
    let columns: Vec<usize> = (0..width.unwrap_or(0)).filter(varies).collect();
    let table = |of: Rows| {
        let rows = models().flat_map(of).map(|row| {
            let values = columns.iter().filter_map(|column| row.get(*column));
            values.map(|value| f64::from(*value)).collect::<Vec<_>>()
        });
        Table::from_rows(rows)
    };
    let fit = |of: Rows| {
        let actions = table(|inferred| &inferred.truth)?;
        CanonicalCorrelation::fit(&table(of)?, &actions, Regularisation::Ridge(1e-6))
    };
    let steps = models().map(|inferred| inferred.truth.len()).sum();
    let mut plane = None;
    for (source, of) in [
        ("real", (|inferred| &inferred.real) as Rows),
        ("predicted", |inferred| &inferred.predicted),
    ] {
        let Ok(found) = fit(of) else {
            section.absent(
                &format!("{name}_cca_{source}"),
                "too few steps, or actions that never vary, for canonical correlations",
            );
            continue;
        };
        let correlations = found.correlations();
        // A missing direction has no correlation.
        let rho = |i: usize| correlations.get(i).copied().unwrap_or(0.0);
        let about = "canonical correlation of inferred with true actions";
        section.metric(
            &format!("{name}_cca_rho1_{source}"),
            Metric::plain(rho(0), steps, Better::Higher, about),
        );
        section.metric(
            &format!("{name}_cca_rho2_{source}"),
            Metric::plain(rho(1), steps, Better::Higher, about),
        );
        section.metric(
            &format!("{name}_cca_eta_{source}"),
            Metric::plain(
                found.eta(),
                steps,
                Better::Higher,
                "root of the mean squared canonical correlation (Hooper's trace correlation)",
            ),
        );
        let (first, second) = (rho(0), rho(1));
        plane = plane.or(Some((found, first, second)));
    }
    let Some((plane, first, second)) = plane else {
        return;
    };
    // All in one comparable plane: true and inferred actions have the same dimensions.
    let drawn: [(&str, Rows); 3] = [
        ("true actions", |inferred| &inferred.truth),
        ("inferred from real latents", |inferred| &inferred.real),
        ("inferred from predicted latents", |inferred| {
            &inferred.predicted
        }),
    ];
    for (what, of) in drawn {
        let Ok(projected) = table(of).and_then(|rows| plane.project_features(&rows, 2)) else {
            continue;
        };
        let mut rows = projected.iter();
        let mut paths = Vec::new();
        for inferred in models() {
            let mut at = [0.0, 0.0];
            // Actions are changes: their sum is the path.
            let steps = of(inferred).iter().filter_map(|_| rows.next());
            let path = steps.filter_map(|row| match row {
                [x, y, ..] => {
                    at = [at[0] + x, at[1] + y];
                    Some(at)
                }
                _ => None,
            });
            paths.push(std::iter::once([0.0, 0.0]).chain(path).collect());
        }
        paths.truncate(PATHS);
        section.trajectories.push(Trajectories {
            title: format!("Action trajectories, {name}, {what}"),
            caption: format!(
                "Actions, added up, in the plane of the two leading canonical correlations of those inferred from real latents \
                 with true ones (rho1 = {first:.2}, rho2 = {second:.2}). Each path is a window.",
            ),
            paths,
        });
    }
}
