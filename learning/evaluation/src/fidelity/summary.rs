use wm_metrics::findings::{Better, Curve, Picture, Section, Series, Suite};

use super::{EpisodeFidelity, Similarity, StepFidelity};
use crate::{Settings, figures::mean_over_units, perception};

type Of = fn(&StepFidelity) -> &Similarity;
type Figure = fn(&Similarity) -> f64;

/// Findings of all episodes, in order.
#[must_use]
pub fn summarise(episodes: &[(String, EpisodeFidelity)], settings: &Settings) -> Section {
    let mut section = Section::new(Suite::Fidelity);
    if episodes.is_empty() {
        section.absent(
            "psnr",
            "the model has no decoder, or no episode is long enough to predict a step",
        );
        return section;
    }
    let pictures: [(&str, &str, Of); 3] = [
        ("", "decoded predictions", |step| &step.predicted),
        (
            "_ceiling",
            "frames encoded and decoded, without a prediction",
            |step| &step.reconstructed,
        ),
        (
            "_persistence",
            "the last observed frame, repeated",
            |step| &step.held,
        ),
    ];
    let figures: [(&str, &str, &str, Figure); 3] = [
        ("psnr", "PSNR", "dB", |s| s.psnr),
        (
            "ssim",
            "SSIM of the luminance, 11x11 Gaussian window (the paper's)",
            "",
            |s| s.ssim,
        ),
        (
            "ssim_colour",
            "SSIM of the colours, 7x7 uniform window (the reference's)",
            "",
            |s| s.ssim_colour,
        ),
    ];
    for (name, about, unit, figure) in figures {
        for (end, what, of) in pictures {
            let values = per_episode(episodes, |step| figure(of(step)));
            let about = format!("{about}: {what}; mean over frames, then episodes");
            // Persistence depends only on the data.
            let better = match end {
                "_persistence" => Better::Neither,
                _ => Better::Higher,
            };
            let metric = mean_over_units(&values, settings, better, &about);
            if let Some(metric) = metric {
                section.metric(&format!("{name}{end}"), metric.in_unit(unit));
            }
        }
        let gaps = per_episode(episodes, |step| {
            figure(&step.reconstructed) - figure(&step.predicted)
        });
        let about = format!("{about}: ceiling minus predictions: the loss by the transition model");
        if let Some(metric) = mean_over_units(&gaps, settings, Better::Lower, &about) {
            section.metric(&format!("{name}_gap"), metric.in_unit(unit));
        }
        section
            .curves
            .push(by_step(name, unit, episodes, figure, &pictures));
        section.curves.push(Curve {
            title: format!("Gap of {} by step", name.to_uppercase()),
            x: "predicted step k".into(),
            y: y_of(name, unit),
            series: vec![series("ceiling minus predictions", episodes, |step| {
                figure(&step.reconstructed) - figure(&step.predicted)
            })],
        });
    }
    let shown = episodes.iter().filter_map(|(name, episode)| {
        Some(Picture {
            caption: format!(
                "{name}: true frames, predictions from the first two frames and all actions, and the frames \
                 encoded and decoded; evenly spaced from step 1 to step {}",
                episode.steps.len()
            ),
            png: episode.strip.clone()?,
        })
    });
    section.pictures.extend(shown);
    let lengths = episodes.iter().map(|(_, episode)| episode.steps.len());
    if let (Some(least), Some(most)) = (lengths.clone().min(), lengths.max()) {
        section.notes.push(format!(
            "Rollouts of {least} to {most} steps from two observed frames; the paper's have 45. One cut short by its \
             episode counts for its own steps."
        ));
    }
    let found = episodes.iter();
    let found: Vec<_> = found
        .map(|(name, episode)| (&**name, &episode.perception))
        .collect();
    perception::summarise(&mut section, &found, settings);
    section
}

fn y_of(name: &str, unit: &str) -> String {
    let name = name.to_uppercase();
    if unit.is_empty() {
        name
    } else {
        format!("{name} [{unit}]")
    }
}

/// The mean over an episode's steps.
fn per_episode(
    episodes: &[(String, EpisodeFidelity)],
    figure: impl Fn(&StepFidelity) -> f64,
) -> Vec<(String, f64)> {
    let with_steps = episodes.iter().filter(|(_, found)| !found.steps.is_empty());
    with_steps
        .map(|(name, found)| {
            let sum: f64 = found.steps.iter().map(&figure).sum();
            (name.clone(), sum / found.steps.len() as f64)
        })
        .collect()
}

fn by_step(
    name: &str,
    unit: &str,
    episodes: &[(String, EpisodeFidelity)],
    figure: Figure,
    pictures: &[(&str, &str, Of); 3],
) -> Curve {
    let names = ["predictions", "ceiling", "persistence"];
    let lines = names.into_iter().zip(pictures);
    Curve {
        title: format!("{} by step", name.to_uppercase()),
        x: "predicted step k".into(),
        y: y_of(name, unit),
        series: lines
            .map(|(name, (_, _, of))| series(name, episodes, |step| figure(of(step))))
            .collect(),
    }
}

/// Mean over the episodes with this step, for every step.
fn series(
    name: &str,
    episodes: &[(String, EpisodeFidelity)],
    figure: impl Fn(&StepFidelity) -> f64,
) -> Series {
    let longest = episodes.iter().map(|(_, found)| found.steps.len()).max();
    // Without episodes the curve has no points.
    let points = (0..longest.unwrap_or(0)).filter_map(|k| {
        let at: Vec<f64> = episodes
            .iter()
            .filter_map(|(_, found)| found.steps.get(k).map(&figure))
            .collect();
        let mean = at.iter().sum::<f64>() / at.len() as f64;
        (!at.is_empty()).then_some([(k + 1) as f64, mean])
    });
    Series {
        name: name.into(),
        points: points.collect(),
        band: Vec::new(),
    }
}
