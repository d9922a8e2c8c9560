mod distances;

use std::collections::BTreeMap;

use crate::onnx::Role;
use wm_metrics::findings::{Better, Curve, Section, Series};

use super::{EpisodeFigure, EpisodePerception, FeatureSpace, Values};
use crate::{Settings, figures::mean_over_units};

/// Most episodes named in a note.
const MAX_NAMED: usize = 8;

/// An episode's name and result.
type Episode<'a> = (&'a str, &'a EpisodePerception);

/// Adds findings of all episodes, in order; nothing without networks.
pub fn summarise(section: &mut Section, episodes: &[Episode<'_>], settings: &Settings) {
    if episodes.is_empty() {
        return;
    }
    for figure in EpisodeFigure::ALL {
        let predicted = per_episode(episodes, figure, |values| mean(&values.predicted));
        if predicted.is_empty() {
            section.absent(
                figure.name(),
                why_absent(episodes, figure.name(), figure.roles()),
            );
            continue;
        }
        let ceiling = per_episode(episodes, figure, |values| mean(&values.reconstructed));
        let gap = per_episode(episodes, figure, |values| {
            Some(mean(&values.predicted)? - mean(&values.reconstructed)?)
        });
        let (better, about) = (figure.better(), figure.about());
        let mut add = |end: &str, values: &[(String, f64)], better: Better, what: &str| {
            let about = format!("{about}: {what}");
            if let Some(metric) = mean_over_units(values, settings, better, &about) {
                let name = format!("{}{end}", figure.name());
                section.metric(&name, metric.in_unit(figure.unit()));
            }
        };
        add("", &predicted, better, "decoded predictions");
        add(
            "_ceiling",
            &ceiling,
            better,
            "frames encoded and decoded, without a prediction",
        );
        add(
            "_gap",
            &gap,
            Better::Lower,
            "predictions minus ceiling: the loss by the transition model",
        );
        curves(section, episodes, figure);
    }
    for space in FeatureSpace::ALL {
        let features = episodes
            .iter()
            .filter_map(|(_, found)| found.features.get(&space));
        let features: Vec<_> = features.collect();
        if features.is_empty() {
            let why = why_absent(episodes, space.name(), &[space.role()]);
            for metric in space.metrics() {
                section.absent(metric, why.clone());
            }
        } else {
            distances::add(section, space, &features);
        }
    }
    section.notes.extend(notes(episodes));
}

fn per_episode(
    episodes: &[Episode<'_>],
    figure: EpisodeFigure,
    of: impl Fn(&Values) -> Option<f64>,
) -> Vec<(String, f64)> {
    let values = episodes.iter().filter_map(|(name, found)| {
        let value = of(found.figures.get(&figure)?)?;
        Some(((*name).to_owned(), value))
    });
    values.collect()
}

fn mean(values: &[f64]) -> Option<f64> {
    (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
}

/// Why no episode has it: a missing network, or its reasons.
fn why_absent(episodes: &[Episode<'_>], name: &str, roles: &[Role]) -> String {
    if let Some(why) = episodes
        .iter()
        .find_map(|(_, found)| found.lacking.get(name))
    {
        return format!("missing in all episodes: {why}");
    }
    let absent = roles.iter().filter(|role| !is_present(episodes, **role));
    let absent: Vec<String> = absent
        .map(|role| format!("no network for `{}`", role.name()))
        .collect();
    format!("{}; see docs/evaluation.md", absent.join("; "))
}

/// Whether there was a network: its metrics exist, or have a reason for their absence.
fn is_present(episodes: &[Episode<'_>], role: Role) -> bool {
    let mut figures = EpisodeFigure::ALL.into_iter();
    figures.any(|figure| {
        figure.roles() == [role]
            && episodes.iter().any(|(_, found)| {
                found.figures.contains_key(&figure) || found.lacking.contains_key(figure.name())
            })
    })
}

fn curves(section: &mut Section, episodes: &[Episode<'_>], figure: EpisodeFigure) {
    let Some(title) = figure.curve() else { return };
    let line = |name: &str, of: &dyn Fn(&Values, usize) -> Option<f64>| -> Option<Series> {
        let values = episodes
            .iter()
            .filter_map(|(_, found)| found.figures.get(&figure));
        let values: Vec<&Values> = values.collect();
        let longest = values.iter().map(|values| values.predicted.len()).max()?;
        let points = (0..longest).filter_map(|k| {
            let at: Vec<f64> = values.iter().filter_map(|values| of(values, k)).collect();
            Some([(k + 1) as f64, mean(&at)?])
        });
        let points: Vec<[f64; 2]> = points.collect();
        (!points.is_empty()).then(|| Series {
            name: name.into(),
            points,
            band: Vec::new(),
        })
    };
    let predicted = |values: &Values, k: usize| values.predicted.get(k).copied();
    let reconstructed = |values: &Values, k: usize| values.reconstructed.get(k).copied();
    let gap = |values: &Values, k: usize| Some(predicted(values, k)? - reconstructed(values, k)?);
    let by_step = [
        line("predictions", &predicted),
        line("ceiling", &reconstructed),
    ];
    let gap = [line("predictions minus ceiling", &gap)];
    for (title_of_curve, lines) in [
        (format!("{title} by step"), by_step.to_vec()),
        (format!("Gap of {title} by step"), gap.to_vec()),
    ] {
        let series: Vec<Series> = lines.into_iter().flatten().collect();
        if !series.is_empty() {
            section.curves.push(Curve {
                title: title_of_curve,
                x: "predicted step k".into(),
                y: title.into(),
                series,
            });
        }
    }
}

/// Episodes without some figure, by network.
fn notes(episodes: &[Episode<'_>]) -> Vec<String> {
    let mut lacking: BTreeMap<&str, Vec<String>> = BTreeMap::new();
    for (episode, found) in episodes {
        for (name, why) in &found.lacking {
            let of_name = lacking.entry(name).or_default();
            of_name.push(format!("{episode} ({why})"));
        }
    }
    let notes = lacking.into_iter().map(|(name, without)| {
        let named: Vec<&str> = without.iter().take(MAX_NAMED).map(String::as_str).collect();
        let more = match without.len() - named.len() {
            0 => String::new(),
            more => format!(", and {more} more"),
        };
        format!(
            "{name} covers {} of {} episodes; missing: {}{more}.",
            episodes.len() - without.len(),
            episodes.len(),
            named.join(", ")
        )
    });
    notes.collect()
}

#[cfg(test)]
mod tests;
