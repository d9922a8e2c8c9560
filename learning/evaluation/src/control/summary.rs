use wm_metrics::correlation::spearman;
use wm_metrics::findings::{Better, Curve, Section, Series, Suite, TextTable};

use super::{RecoveredActions, Response, Start, WindowControl, recovered::Search};
use crate::{
    ActionChange, Settings,
    figures::{figure_of_units, mean_over_units, most_changed},
};

/// Findings of all windows, in order.
#[must_use]
pub fn summarise(windows: &[(String, WindowControl)], settings: &Settings) -> Section {
    let mut section = Section::new(Suite::Control);
    let searches: Vec<(&String, &RecoveredActions)> = windows
        .iter()
        .filter_map(|(name, found)| match found {
            WindowControl::Recovered(found) => Some((name, found)),
            WindowControl::Response(_) => None,
        })
        .collect();
    let responses: Vec<(&String, &Response)> = windows
        .iter()
        .filter_map(|(name, found)| match found {
            WindowControl::Response(found) => Some((name, found)),
            WindowControl::Recovered(_) => None,
        })
        .collect();
    for search in &settings.control.searches {
        of_horizon(&mut section, &searches, settings, search.k);
    }
    of_responses(&mut section, &responses, settings);
    if settings.control.searches.is_empty() {
        section.absent(
            "cem_k1_error",
            "searches take minutes and were not requested; run wm eval control",
        );
        return section;
    }
    if let Some((_, found)) = searches.first() {
        section.notes.push(searched_note(found, settings));
    }
    section.notes.push(
        "The search of the paper starts at the true actions with a deviation of a quarter of the range, so even a model \
                     that ignores actions keeps some of the truth. For comparison: the same search from zero, and the errors of a \
                     random guess, of no motion and of the inverse dynamics model."
            .into(),
    );
    section
}

/// What is searched, and why.
fn searched_note(found: &RecoveredActions, settings: &Settings) -> String {
    let searched = found.dimensions.join(", ");
    if found.effects.is_empty() {
        return format!("Searched dimensions: {searched}. The others keep their true values.");
    }
    let effects = found.effects.iter();
    let effects: Vec<String> = effects
        .map(|(name, effect)| format!("{name} {effect:.3}"))
        .collect();
    format!(
        "Searched dimensions: {searched}, whose effect on predictions is at least {}; the others keep their true values. \
         Effects: {}. The paper searches all: --search-dims all.",
        settings.control.least_effect,
        effects.join(", ")
    )
}

fn of_horizon(
    section: &mut Section,
    windows: &[(&String, &RecoveredActions)],
    settings: &Settings,
    k: usize,
) {
    let of = windows.iter().filter(|(_, found)| found.k == k);
    let of: Vec<(&String, &RecoveredActions)> = of.copied().collect();
    let values = |figure: &dyn Fn(&RecoveredActions) -> Option<f64>| -> Vec<(String, f64)> {
        let values = of
            .iter()
            .filter_map(|(name, of)| Some(((*name).clone(), figure(of)?)));
        values.collect()
    };
    let mut add = |name: &str, about: &str, figure: &dyn Fn(&RecoveredActions) -> Option<f64>| {
        // Random guess and no motion depend only on the data, and costs on the latent space: they do not rank models.
        let better = match name {
            "error" | "error_translations" | "error_from_zero" | "error_idm" => Better::Lower,
            _ => Better::Neither,
        };
        match mean_over_units(&values(figure), settings, better, about) {
            Some(metric) => section.metric(&format!("cem_k{k}_{name}"), metric),
            None => section.absent(
                &format!("cem_k{k}_{name}"),
                match name {
                    "error_translations" => "no translation is searched".to_owned(),
                    _ => {
                        format!("no inverse dynamics model of {k} steps; give its file with --idm")
                    }
                },
            ),
        }
    };
    let of_search = |start: Start, figure: fn(&Search) -> f64| {
        move |of: &RecoveredActions| {
            let search = of.searches.iter().find(|search| search.start == start)?;
            Some(figure(search))
        }
    };
    add(
        "error",
        "CEM error: distance to the true actions, search from the truth (the paper's)",
        &of_search(Start::Truth, |s| s.error),
    );
    add(
        "error_translations",
        "the same, over the translations",
        &|of| {
            let search = of
                .searches
                .iter()
                .find(|search| search.start == Start::Truth)?;
            search.translation_error
        },
    );
    add(
        "error_from_zero",
        "the same, search from zero",
        &of_search(Start::Zero, |s| s.error),
    );
    add("error_random", "distance of a random guess", &|of| {
        Some(of.random_error)
    });
    add("error_zero", "distance of no motion", &|of| {
        Some(of.zero_error)
    });
    add(
        "error_idm",
        "distance of the inverse dynamics model's actions from the same latents",
        &|of| of.told_error,
    );
    add("cost_at_truth", "cost at the true actions", &|of| {
        Some(of.cost_of_truth)
    });
    add(
        "cost_found",
        "cost of the result of the search from the truth",
        &of_search(Start::Truth, |s| s.cost),
    );

    let starts = [(Start::Truth, "from the truth"), (Start::Zero, "from zero")];
    section.curves.push(Curve {
        title: format!("Planner convergence, k = {k}"),
        x: "iteration".into(),
        y: "least cost / cost at the true actions".into(),
        series: starts
            .iter()
            .map(|(start, name)| convergence(&of, *start, name))
            .collect(),
    });
    if let Some((_, found)) = of.first() {
        let rows = found.dimensions.iter().enumerate().map(|(index, name)| {
            let mean = |start: Start| {
                let errors: Vec<f64> = of
                    .iter()
                    .flat_map(|(_, of)| &of.searches)
                    .filter(|search| search.start == start)
                    .filter_map(|search| search.by_dimension.get(index).copied())
                    .collect();
                format!(
                    "{:.3}",
                    errors.iter().sum::<f64>() / errors.len().max(1) as f64
                )
            };
            vec![name.clone(), mean(Start::Truth), mean(Start::Zero)]
        });
        section.tables.push(TextTable {
            title: format!("Mean absolute error of each dimension, k = {k} (model units)"),
            header: ["dimension", "from the truth", "from zero"]
                .map(String::from)
                .into(),
            rows: rows.collect(),
        });
    }
}

fn convergence(of: &[(&String, &RecoveredActions)], start: Start, name: &str) -> Series {
    let ratios: Vec<Vec<f64>> = of
        .iter()
        .flat_map(|(_, of)| {
            let searches = of.searches.iter().filter(move |s| s.start == start);
            searches.map(|search| {
                let costs = search.iteration_costs.iter();
                // The best cost so far, not that of this iteration.
                let mut least = f64::INFINITY;
                let best = costs.map(|cost| {
                    least = least.min(*cost);
                    least / of.cost_of_truth
                });
                best.collect()
            })
        })
        .collect();
    // Without searches the curve has no points.
    let longest = ratios.iter().map(Vec::len).max().unwrap_or(0);
    let points = (0..longest).map(|i| {
        let at: Vec<f64> = ratios.iter().filter_map(|r| r.get(i).copied()).collect();
        [
            (i + 1) as f64,
            at.iter().sum::<f64>() / at.len().max(1) as f64,
        ]
    });
    Series {
        name: name.into(),
        points: points.collect(),
        band: Vec::new(),
    }
}

/// Steps with a ratio figure; the curve has all.
const FIGURE_STEPS: [usize; 3] = [1, 4, 8];

/// Which predictions a ratio is of.
#[derive(Clone, Copy)]
enum Predictions {
    /// Under the true actions.
    TrueActions,
    /// Under the true actions, of one of several cameras.
    Camera(usize),
    /// Under wrong actions.
    WrongActions(ActionChange),
}

impl Predictions {
    /// The squared errors by step, and those of persistence.
    fn errors(self, found: &Response) -> Option<(&[f64], &[f64])> {
        match self {
            Self::TrueActions => Some((&found.told, &found.persistence)),
            Self::Camera(camera) => {
                let errors = found.cameras.get(camera)?;
                Some((&errors.told, &errors.persistence))
            }
            Self::WrongActions(change) => {
                let mut wrong = found.wrong.iter();
                let (_, errors) = wrong.find(|(own, _)| *own == change)?;
                Some((errors, &found.persistence))
            }
        }
    }

    /// End of a figure's name.
    fn end(self) -> String {
        match self {
            Self::TrueActions => String::new(),
            Self::Camera(camera) => format!("_camera{}", camera + 1),
            Self::WrongActions(change) => format!("_{}", change.name()),
        }
    }

    fn about(self) -> String {
        match self {
            Self::TrueActions => "the true actions".into(),
            Self::Camera(camera) => format!("the true actions, camera {}", camera + 1),
            Self::WrongActions(change) => format!("{change} actions"),
        }
    }

    fn better(self) -> Better {
        match self {
            Self::TrueActions | Self::Camera(_) => Better::Lower,
            Self::WrongActions(_) => Better::Higher,
        }
    }
}

/// The predictions that the windows have; what they lack is absent from the section.
fn predictions(section: &mut Section, windows: &[(&String, &Response)]) -> Vec<Predictions> {
    let cameras = windows.iter().map(|(_, found)| found.cameras.len()).max();
    let cameras = (0..cameras.unwrap_or(0)).map(Predictions::Camera);
    let mut predictions: Vec<Predictions> = std::iter::once(Predictions::TrueActions)
        .chain(cameras)
        .collect();
    for change in ActionChange::WRONG {
        let wrong = Predictions::WrongActions(change);
        if windows
            .iter()
            .any(|(_, found)| wrong.errors(found).is_some())
        {
            predictions.push(wrong);
        } else {
            section.absent(
                &format!("ratio_k1_{}", change.name()),
                match change {
                    ActionChange::Shuffled => {
                        "another window's actions: all windows are of one episode"
                    }
                    _ => "the model's actions are states, which have no opposite",
                },
            );
        }
    }
    predictions
}

fn of_responses(section: &mut Section, windows: &[(&String, &Response)], settings: &Settings) {
    let steps = windows.iter().map(|(_, found)| found.told.len()).max();
    // Without windows there are no figures.
    let steps = steps.unwrap_or(0);
    let predictions = predictions(section, windows);
    let mut curve = Curve {
        title: "Latent error / persistence by step".into(),
        x: "predicted step k".into(),
        y: "squared latent error / persistence".into(),
        series: Vec::new(),
    };
    for predicted in predictions {
        let (end, about) = (predicted.end(), predicted.about());
        let sums = |chosen: &[usize], k: usize| {
            let (mut error, mut persistence) = (0.0, 0.0);
            for index in chosen {
                let Some((_, found)) = windows.get(*index) else {
                    continue;
                };
                let Some((own, held)) = predicted.errors(found) else {
                    continue;
                };
                if let (Some(own), Some(held)) = (own.get(k), held.get(k)) {
                    error += own;
                    persistence += held;
                }
            }
            (error, persistence)
        };
        let ratio = |chosen: &[usize], k: usize| {
            let (error, persistence) = sums(chosen, k);
            error / persistence
        };
        let all: Vec<usize> = (0..windows.len()).collect();
        let points = (0..steps).map(|k| [(k + 1) as f64, ratio(&all, k)]);
        curve.series.push(Series {
            name: about.clone(),
            points: points.filter(|[_, y]| y.is_finite()).collect(),
            band: Vec::new(),
        });
        for k in FIGURE_STEPS.into_iter().filter(|k| *k <= steps) {
            let sentence = format!(
                "squared latent error over that of persistence at k = {k}, predictions under {about}"
            );
            let mut add = |name: String, sentence: &str, indices: &[usize]| {
                let metric = figure_of_units(
                    indices.len(),
                    settings,
                    predicted.better(),
                    sentence,
                    |chosen| {
                        let of_all = chosen.iter().filter_map(|i| indices.get(*i).copied());
                        ratio(&of_all.collect::<Vec<_>>(), k - 1)
                    },
                );
                if let Some(mut metric) = metric {
                    // Relative to the mean persistence, so that their mean is the figure and tests are about the figure. A
                    // window's own ratio is huge if nothing moves.
                    let persistence = sums(indices, k - 1).1 / indices.len() as f64;
                    let each = indices.iter().filter_map(|index| {
                        let (name, _) = windows.get(*index)?;
                        Some(((*name).clone(), sums(&[*index], k - 1).0 / persistence))
                    });
                    metric.samples = each.collect();
                    section.metric(&name, metric);
                }
            };
            add(format!("ratio_k{k}{end}"), &sentence, &all);
            let sentence =
                format!("{sentence}, on the half of the windows that change most until k = {k}");
            let moving = most_changed(windows.len(), |index| {
                let (_, found) = windows.get(index)?;
                found.persistence.get(k - 1).copied()
            });
            add(format!("ratio_k{k}{end}_moving"), &sentence, &moving);
        }
    }
    section.curves.push(curve);

    let about = "action following: Spearman's rank correlation of the predicted with the true size of motion (change of \
                 the latent from frame to frame), over all steps";
    let following = figure_of_units(windows.len(), settings, Better::Higher, about, |chosen| {
        let (mut predicted, mut truth) = (Vec::new(), Vec::new());
        for (_, found) in chosen.iter().filter_map(|index| windows.get(*index)) {
            predicted.extend_from_slice(&found.predicted_motion);
            truth.extend_from_slice(&found.motion);
        }
        spearman(&predicted, &truth).map_or(f64::NAN, |found| found.r)
    });
    match following {
        Some(metric) => section.metric("action_following", metric),
        None => section.absent("action_following", "nothing moves in the data"),
    }
    let about = "share of the true motion in the predictions: squared change between frames, relative to the true \
                 came";
    let share = figure_of_units(windows.len(), settings, Better::Neither, about, |chosen| {
        let (mut predicted, mut truth) = (0.0, 0.0);
        for (_, found) in chosen.iter().filter_map(|index| windows.get(*index)) {
            predicted += found.predicted_motion.iter().sum::<f64>();
            truth += found.motion.iter().sum::<f64>();
        }
        predicted / truth
    });
    if let Some(metric) = share {
        section.metric("motion_share", metric);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Protocol;

    fn response(change: f64, error: f64) -> Response {
        Response {
            persistence: vec![change],
            told: vec![error],
            wrong: Vec::new(),
            motion: vec![change],
            predicted_motion: vec![change],
            cameras: Vec::new(),
        }
    }

    #[test]
    fn still_windows_do_not_count_as_moving() {
        let windows = [(0.0, 0.0), (4.0, 1.0), (0.1, 0.1), (6.0, 4.0), (0.2, 0.2)];
        let windows: Vec<(String, WindowControl)> = (0..)
            .zip(windows)
            .map(|(index, (change, error))| {
                let response = WindowControl::Response(response(change, error));
                (format!("window {index}"), response)
            })
            .collect();
        let section = summarise(&windows, &Settings::of(Protocol::Quick, 0));
        let ratio = |name: &str| {
            let metric = section.metrics.get(&format!("control.{name}"));
            metric.map(|metric| metric.value)
        };
        assert_eq!(ratio("ratio_k1"), Some(5.3 / 10.3));
        // The three windows that change most.
        assert_eq!(ratio("ratio_k1_moving"), Some(5.2 / 10.2));
        // Models are compared by samples whose mean is the figure.
        let samples = &section.metrics["control.ratio_k1"].samples;
        let mean = samples.values().sum::<f64>() / samples.len() as f64;
        assert!((mean - 5.3 / 10.3).abs() < 1e-12, "{samples:?}");
    }
}
