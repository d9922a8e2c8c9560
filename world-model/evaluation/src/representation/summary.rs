use wm_findings::{Better, Metric, Section, Suite, TextTable, Trajectories};
use wm_metrics::{
    Table,
    classification::{Confusion, roc_auc},
    correlation::{CanonicalCorrelation, Regularisation},
};

use super::{Judged, Representation, Told, ToldActions};
use crate::{Settings, action_correlation::correlation, figures::figure_of_units};

/// Paths that a report draws.
const PATHS: usize = 12;

/// The findings of all units, which are in their order.
#[must_use]
pub fn summarise(units: &[(String, Representation)], settings: &Settings) -> Section {
    let mut section = Section::new(Suite::Latents);
    let mut told = Vec::new();
    let mut judged = Vec::new();
    for (name, unit) in units {
        match unit {
            Representation::Told(found) => told.push((name.as_str(), found)),
            Representation::Judged(found) => judged.push((name.as_str(), found)),
        }
    }
    let models = told.first().map_or(0, |(_, found)| found.models.len());
    if models == 0 {
        section.absent(
            "idm_r",
            "the model has no inverse dynamics model (idm.safetensors): wm train idm",
        );
    }
    for model in 0..models {
        of_idm(&mut section, &told, settings, model);
    }
    of_probe(&mut section, &judged, settings);
    section
}

type Rows = fn(&Told) -> &Vec<Vec<f32>>;

/// Mean of Pearson's r over the dimensions that are no gripper and vary.
fn mean_r(windows: &[(&str, &ToldActions)], chosen: &[usize], model: usize, of: Rows) -> f64 {
    let rs = rs(windows, chosen, model, of);
    rs.iter().map(|(_, r)| r).sum::<f64>() / rs.len() as f64
}

fn rs(
    windows: &[(&str, &ToldActions)],
    chosen: &[usize],
    model: usize,
    of: Rows,
) -> Vec<(String, f64)> {
    let chosen = || {
        let chosen = chosen.iter().filter_map(|index| windows.get(*index));
        chosen.filter_map(move |(_, found)| found.models.get(model))
    };
    let Some((_, first)) = windows.first() else {
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

fn of_idm(
    section: &mut Section,
    windows: &[(&str, &ToldActions)],
    settings: &Settings,
    model: usize,
) {
    let Some(told) = windows
        .first()
        .and_then(|(_, found)| found.models.get(model))
    else {
        return;
    };
    let (k, space) = (told.k, &told.space);
    // The first is the model's own.
    let name = if model == 0 {
        format!("idm_k{k}")
    } else {
        format!("idm{}_k{k}", model + 1)
    };
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
    trajectories(section, windows, model, &name);
}

/// Paths of the told actions in the plane of the two leading canonical directions (the paper's figure of action
/// trajectories).
fn trajectories(section: &mut Section, windows: &[(&str, &ToldActions)], model: usize, name: &str) {
    let models = || {
        windows
            .iter()
            .filter_map(|(_, found)| found.models.get(model))
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
            title: format!("Action trajectories, {source} latents"),
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

fn of_probe(section: &mut Section, episodes: &[(&str, &Judged)], settings: &Settings) {
    if episodes.is_empty() {
        section.absent(
            "success_balanced_accuracy_real",
            "it takes a success probe (wm train probe), and episodes with an instruction that it knows \
             (/task/instruction) and an outcome (/task/success)",
        );
        return;
    }
    type Of = fn(&Judged) -> f32;
    let sources: [(&str, &str, Of); 2] = [
        ("real", "the latents of the frames", |judged| judged.real),
        (
            "predicted",
            "a rollout of the whole episode from two frames under its actions",
            |judged| judged.predicted,
        ),
    ];
    let pick = |chosen: &[usize], of: Of| -> (Vec<f64>, Vec<bool>) {
        let chosen = chosen.iter().filter_map(|index| episodes.get(*index));
        chosen
            .map(|(_, judged)| (f64::from(of(judged)), judged.success))
            .unzip()
    };
    let balanced = |chosen: &[usize], of: Of| {
        let (scores, truth) = pick(chosen, of);
        let told: Vec<bool> = scores.iter().map(|p| *p > 0.5).collect();
        let confusion = Confusion::of(&told, &truth).ok();
        confusion
            .and_then(|c| c.balanced_accuracy())
            .unwrap_or(f64::NAN)
    };
    let auc = |chosen: &[usize], of: Of| {
        let (scores, truth) = pick(chosen, of);
        roc_auc(&scores, &truth).unwrap_or(f64::NAN)
    };
    let n = episodes.len();
    for (source, about, of) in sources {
        let mut add = |name: &str, about: String, metric: Option<Metric>| {
            let name = format!("success_{name}_{source}");
            match metric {
                Some(metric) => section.metric(&name, Metric { about, ..metric }),
                None => section.absent(&name, "the episodes are all successes, or all failures"),
            }
        };
        let figure = |figure: &(dyn Fn(&[usize]) -> f64 + Sync)| {
            figure_of_units(n, settings, Better::Higher, "", figure)
        };
        add(
            "balanced_accuracy",
            format!("balanced accuracy of the success probe at one half, on {about}"),
            figure(&|chosen| balanced(chosen, of)),
        );
        add(
            "auc",
            format!("area under the ROC curve of the success probe, on {about}"),
            figure(&|chosen| auc(chosen, of)),
        );
        let all: Vec<usize> = (0..n).collect();
        let (scores, truth) = pick(&all, of);
        section
            .tables
            .push(confusion_table(source, &scores, &truth));
    }
    let about = "balanced accuracy, real minus predicted: semantic drift";
    let drop = figure_of_units(n, settings, Better::Lower, about, |chosen| {
        balanced(chosen, |judged| judged.real) - balanced(chosen, |judged| judged.predicted)
    });
    if let Some(metric) = drop {
        section.metric("success_drop", metric);
    }
    let mismatched: Vec<f32> = episodes.iter().filter_map(|(_, j)| j.mismatched).collect();
    if !mismatched.is_empty() {
        let about =
            "share of the successes that are told to fail under another episode's instruction";
        let metric = figure_of_units(
            mismatched.len(),
            settings,
            Better::Higher,
            about,
            |chosen| {
                let chosen = chosen.iter().filter_map(|index| mismatched.get(*index));
                let refused = chosen.clone().filter(|p| **p <= 0.5).count();
                refused as f64 / chosen.count() as f64
            },
        );
        if let Some(metric) = metric {
            section.metric("success_mismatches_refused", metric);
        }
    }
}

fn confusion_table(source: &str, scores: &[f64], truth: &[bool]) -> TextTable {
    let count = |told: bool, is: bool| {
        let pairs = scores.iter().zip(truth);
        let like = pairs.filter(|(score, truth)| (**score > 0.5) == told && **truth == is);
        like.count().to_string()
    };
    TextTable {
        title: format!("Success probe, {source} latents"),
        header: ["", "told: success", "told: failure"]
            .map(String::from)
            .into(),
        rows: vec![
            vec!["success".into(), count(true, true), count(false, true)],
            vec!["failure".into(), count(true, false), count(false, false)],
        ],
    }
}
