//! Paths of told actions.

use wm_findings::{Better, Metric, Section, Trajectories};
use wm_metrics::{
    Table,
    correlation::{CanonicalCorrelation, Regularisation},
};

use super::super::ToldActions;
use super::actions::Rows;

/// Paths that a report draws.
const PATHS: usize = 12;

/// Paths of the told actions in the plane of the two leading canonical directions (the paper's figure of action
/// trajectories).
pub(super) fn of_model(section: &mut Section, windows: &[&ToldActions], model: usize) {
    let models = || windows.iter().filter_map(|found| found.models.get(model));
    let Some(name) = models().next().map(|told| &told.name) else {
        return;
    };
    // What never varies, as the gripper of a short recording, correlates with nothing.
    let varies = |column: &usize| {
        let mut values = models()
            .flat_map(|t| &t.truth)
            .filter_map(|row| row.get(*column));
        let first = values.next();
        values.any(|value| Some(value) != first)
    };
    let width = models().find_map(|told| Some(told.truth.first()?.len()));
    let columns: Vec<usize> = (0..width.unwrap_or(0)).filter(varies).collect();
    let table = |of: Rows| {
        let rows = models().flat_map(of).map(|row| {
            let values = columns.iter().filter_map(|column| row.get(*column));
            values.map(|value| f64::from(*value)).collect::<Vec<_>>()
        });
        Table::from_rows(rows)
    };
    for (source, of) in [
        ("real", (|told| &told.real) as Rows),
        ("predicted", |told| &told.predicted),
    ] {
        let fitted = table(of).and_then(|features| {
            let actions = table(|told| &told.truth)?;
            let found =
                CanonicalCorrelation::fit(&features, &actions, Regularisation::Ridge(1e-6))?;
            let projected = found.project_features(&features, 2)?;
            Ok((found, projected))
        });
        let Ok((found, projected)) = fitted else {
            section.absent(
                &format!("{name}_cca_{source}"),
                "too few steps, or actions that never vary, for canonical correlations",
            );
            continue;
        };
        let mut rows = projected.iter();
        let mut paths = Vec::new();
        for told in models() {
            let mut at = [0.0, 0.0];
            // Actions are changes: their sum is the path.
            let steps = of(told).iter().filter_map(|_| rows.next());
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
        let correlations = found.correlations();
        let rho = |i: usize| correlations.get(i).copied().unwrap_or(0.0);
        let steps = models().map(|told| told.truth.len()).sum();
        let about = "canonical correlation of told with true actions";
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
        section.trajectories.push(Trajectories {
            title: format!("Action trajectories, {name}, {source} latents"),
            caption: format!(
                "Told actions, added up, in the plane of the two leading canonical correlations with the true ones: rho1 = \
                 {:.2}, rho2 = {:.2}, eta = {:.2}. A path is a window.",
                rho(0),
                rho(1),
                found.eta()
            ),
            paths,
        });
    }
}
