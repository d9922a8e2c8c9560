//! Action trajectories.

use wm_metrics::findings::{Better, Metric, Section, Trajectories};
use wm_metrics::{
    Table,
    correlation::{CanonicalCorrelation, Regularisation, trace_correlation},
};

use super::super::{EpisodeFeatures, IdmFeatures};

/// Trajectories in a report.
const SHOWN: usize = 12;
/// Added to the variance of each feature, which is 1: some features never vary.
const RIDGE: f64 = 1e-6;

type Rows = fn(&IdmFeatures) -> &Vec<Vec<f32>>;

/// Latents by their name in figures, with the features from them.
const SOURCES: [(&str, Rows); 2] = [
    ("real", |found| &found.real),
    ("predicted", |found| &found.predicted),
];

/// Canonical correlations of the features of one inverse dynamics model with the true actions, over episodes, and the
/// episodes in the plane of the two leading directions (the paper's figures "Action trajectories induced by encoder spaces").
pub(super) fn of_model(section: &mut Section, episodes: &[&EpisodeFeatures], model: usize) {
    let found: Vec<&IdmFeatures> = episodes
        .iter()
        .filter_map(|own| own.models.get(model))
        .collect();
    let Some(name) = found.first().map(|own| &own.name) else {
        return;
    };
    let columns = varying(&found);
    let steps = found.iter().map(|own| own.actions.len()).sum();
    let mut plane = None;
    for (source, of) in SOURCES {
        let name = format!("{name}_cca");
        let Some(fitted) = fit(&found, &columns, of) else {
            section.absent(
                &format!("{name}_{source}"),
                "too few steps, or actions that never vary, for canonical correlations",
            );
            continue;
        };
        let mut figure = |kind: &str, (value, steps), about: &str| {
            let name = format!("{name}_{kind}_{source}");
            section.metric(&name, Metric::plain(value, steps, Better::Higher, about));
        };
        let about = format!(
            "canonical correlation of the inverse dynamics model's features with true actions, over {} episodes",
            found.len()
        );
        // A missing direction has no correlation.
        let rho = |i: usize| fitted.correlations().get(i).copied().unwrap_or(0.0);
        figure("rho1", (rho(0), steps), &about);
        figure("rho2", (rho(1), steps), &about);
        figure(
            "eta",
            (fitted.eta(), steps),
            "root of the mean squared canonical correlation (Hooper's trace correlation)",
        );
        match held_out(&found, &columns, of) {
            Some(found) => figure(
                "eta_held_out",
                found,
                "the same on every second episode, with the directions of the others",
            ),
            None => section.absent(
                &format!("{name}_eta_held_out_{source}"),
                "too few episodes to hold any out",
            ),
        }
        plane = plane.or(Some(fitted));
    }
    if let Some(plane) = plane {
        draw(section, &found, &columns, &plane);
    }
}

/// Dimensions of the actions that vary: constant ones, such as the gripper of a short recording, have no correlation.
fn varying(episodes: &[&IdmFeatures]) -> Vec<usize> {
    let rows = || episodes.iter().flat_map(|own| &own.actions);
    let width = rows().next().map_or(0, Vec::len);
    let varies = |column: &usize| {
        let mut values = rows().filter_map(|row| row.get(*column));
        let first = values.next();
        values.any(|value| Some(value) != first)
    };
    (0..width).filter(varies).collect()
}

/// Columns of all rows.
fn actions(episodes: &[&IdmFeatures], columns: &[usize]) -> Option<Table> {
    let rows = episodes.iter().flat_map(|own| &own.actions).map(|row| {
        let values = columns.iter().filter_map(|column| row.get(*column));
        values.map(|value| f64::from(*value)).collect::<Vec<_>>()
    });
    Table::from_rows(rows).ok()
}

fn features(episodes: &[&IdmFeatures], of: Rows) -> Option<Table> {
    let rows = episodes.iter().flat_map(|own| of(own));
    Table::from_rows(rows.map(|row| {
        row.iter()
            .map(|value| f64::from(*value))
            .collect::<Vec<_>>()
    }))
    .ok()
}

fn fit(episodes: &[&IdmFeatures], columns: &[usize], of: Rows) -> Option<CanonicalCorrelation> {
    let (features, actions) = (features(episodes, of)?, actions(episodes, columns)?);
    CanonicalCorrelation::fit(&features, &actions, Regularisation::Ridge(RIDGE)).ok()
}

/// Trace correlation on every second episode, with the directions of the others, and the number of its steps.
fn held_out(episodes: &[&IdmFeatures], columns: &[usize], of: Rows) -> Option<(f64, usize)> {
    let half =
        |first| -> Vec<&IdmFeatures> { episodes.iter().skip(first).step_by(2).copied().collect() };
    let (fitted_on, others) = (half(0), half(1));
    let fitted = fit(&fitted_on, columns, of)?;
    let (features, actions) = (features(&others, of)?, actions(&others, columns)?);
    let correlations = fitted.correlations_of(&features, &actions).ok()?;
    Some((trace_correlation(&correlations), actions.rows()))
}

/// Draws the episodes in the plane of the two leading directions.
fn draw(
    section: &mut Section,
    episodes: &[&IdmFeatures],
    columns: &[usize],
    plane: &CanonicalCorrelation,
) {
    let Some(name) = episodes.first().map(|own| &own.name) else {
        return;
    };
    let rho = |i: usize| plane.correlations().get(i).copied().unwrap_or(0.0);
    let of_actions =
        actions(episodes, columns).and_then(|rows| plane.project_actions(&rows, 2).ok());
    let mut drawn = vec![("true actions".to_owned(), of_actions)];
    for (source, of) in SOURCES {
        let rows = features(episodes, of);
        drawn.push((
            format!("features of {source} latents"),
            rows.and_then(|rows| plane.project_features(&rows, 2).ok()),
        ));
    }
    for (what, projected) in drawn {
        let Some(projected) = projected else { continue };
        let mut rows = projected.iter();
        let paths = episodes.iter().map(|own| {
            let rows = rows.by_ref().take(own.actions.len());
            let points = rows.filter_map(|row| match row {
                [x, y, ..] => Some([*x, *y]),
                _ => None,
            });
            points.collect()
        });
        let mut paths: Vec<Vec<[f64; 2]>> = paths.collect();
        paths.truncate(SHOWN);
        section.trajectories.push(Trajectories {
            title: format!("Action trajectories, {name}, {what}"),
            caption: format!(
                "Steps of episodes in the plane of the two leading canonical correlations of the features of real latents with \
                 true actions (rho1 = {:.2}, rho2 = {:.2}). Each path is an episode.",
                rho(0),
                rho(1)
            ),
            paths,
        });
    }
}

#[cfg(test)]
mod tests {
    use rand::{Rng as _, SeedableRng as _};
    use rand_chacha::ChaCha8Rng;
    use wm_metrics::findings::Suite;

    use super::*;

    /// Episodes of 20 steps, whose first two features show two actions and whose others are noise.
    fn episodes(count: usize, noise: f32) -> Vec<EpisodeFeatures> {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let mut episode = || {
            let mut found = IdmFeatures {
                name: "idm_k1".into(),
                actions: Vec::new(),
                real: Vec::new(),
                predicted: Vec::new(),
            };
            for _ in 0..20 {
                let mut random = || rng.random_range(-1.0..1.0_f32);
                let (x, y) = (random(), random());
                found.actions.push(vec![x, y, 1.0]);
                let shown = vec![
                    x + y + noise * random(),
                    x - y + noise * random(),
                    random(),
                    0.0,
                ];
                found.real.push(shown);
                found.predicted.push((0..4).map(|_| random()).collect());
            }
            EpisodeFeatures {
                models: vec![found],
            }
        };
        (0..count).map(|_| episode()).collect()
    }

    fn section(episodes: &[EpisodeFeatures]) -> Section {
        let mut section = Section::new(Suite::Latents);
        of_model(&mut section, &episodes.iter().collect::<Vec<_>>(), 0);
        section
    }

    #[test]
    fn features_that_show_the_actions_correlate() {
        let found = section(&episodes(10, 0.0));
        let value = |name: &str| found.metrics[&format!("latents.idm_k1_cca_{name}")].value;
        for name in ["rho1_real", "rho2_real", "eta_real", "eta_held_out_real"] {
            assert!((value(name) - 1.0).abs() < 1e-4, "{name}: {}", value(name));
        }
        // Noise correlates on the fitted episodes only.
        assert!(
            value("eta_held_out_predicted").abs() < 0.2,
            "{}",
            value("eta_held_out_predicted")
        );
        assert_eq!(found.metrics["latents.idm_k1_cca_eta_real"].n, 200);
        assert_eq!(found.metrics["latents.idm_k1_cca_eta_held_out_real"].n, 100);
        let titles: Vec<&str> = found.trajectories.iter().map(|own| &*own.title).collect();
        assert_eq!(titles.len(), 3, "{titles:?}");
        assert!(
            found
                .trajectories
                .iter()
                .all(|own| own.paths.len() == 10 && own.paths[0].len() == 20)
        );
    }

    #[test]
    fn one_episode_cannot_be_held_out() {
        let found = section(&episodes(1, 0.1));
        assert!(found.metrics.contains_key("latents.idm_k1_cca_eta_real"));
        let absent: Vec<&str> = found.absent.iter().map(|own| &*own.metric).collect();
        assert!(
            absent.contains(&"latents.idm_k1_cca_eta_held_out_real"),
            "{absent:?}"
        );
        assert!(section(&[]).metrics.is_empty());
    }
}
