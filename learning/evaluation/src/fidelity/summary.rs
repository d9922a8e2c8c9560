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
    let is_moving = moving(episodes);
    for (name, about, unit, figure) in figures {
        for (end, what, of) in pictures {
            // Persistence depends only on the data.
            let better = match end {
                "_persistence" => Better::Neither,
                _ => Better::Higher,
            };
            let mut add = |end: &str, values: &[(String, f64)], frames: &str| {
                let about = format!("{about}: {what}; mean over {frames}, then episodes");
                if let Some(metric) = mean_over_units(values, settings, better, &about) {
                    section.metric(&format!("{name}{end}"), metric.in_unit(unit));
                }
            };
            let figure = |step: &StepFidelity| figure(of(step));
            add(end, &per_episode(episodes, |_| true, figure), "frames");
            let moving = per_episode(episodes, &is_moving, figure);
            let half = "the half of the frames that differ most from the last observed one";
            add(&format!("{end}_moving"), &moving, half);
        }
        let gap = |step: &StepFidelity| figure(&step.reconstructed) - figure(&step.predicted);
        let gaps = per_episode(episodes, |_| true, gap);
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
            series: vec![series("ceiling minus predictions", episodes, gap)],
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

/// The mean over those of an episode's steps that are `chosen`; episodes without any are left out.
fn per_episode(
    episodes: &[(String, EpisodeFidelity)],
    chosen: impl Fn(&StepFidelity) -> bool,
    figure: impl Fn(&StepFidelity) -> f64,
) -> Vec<(String, f64)> {
    let means = episodes.iter().filter_map(|(name, found)| {
        let steps = found.steps.iter().filter(|step| chosen(step));
        let values: Vec<f64> = steps.map(&figure).collect();
        let mean = values.iter().sum::<f64>() / values.len() as f64;
        (!values.is_empty()).then(|| (name.clone(), mean))
    });
    means.collect()
}

/// Whether a step is of the half of all steps whose frames differ most from the last observed one.
fn moving(episodes: &[(String, EpisodeFidelity)]) -> impl Fn(&StepFidelity) -> bool {
    let steps = episodes.iter().flat_map(|(_, found)| &found.steps);
    let mut held: Vec<f64> = steps.map(|step| step.held.psnr).collect();
    held.sort_by(f64::total_cmp);
    let median = held.get(held.len().saturating_sub(1) / 2).copied();
    move |step| median.is_some_and(|median| step.held.psnr <= median)
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Protocol, perception::EpisodePerception};

    #[test]
    fn moving_frames_differ_most_from_the_last_observed() {
        let similarity = |psnr: f64| Similarity {
            psnr,
            ssim: 0.5,
            ssim_colour: 0.5,
        };
        let episode = |steps: &[(f64, f64)]| EpisodeFidelity {
            steps: steps
                .iter()
                .map(|(predicted, held)| StepFidelity {
                    predicted: similarity(*predicted),
                    reconstructed: similarity(40.0),
                    held: similarity(*held),
                })
                .collect(),
            strip: None,
            perception: EpisodePerception::default(),
        };
        let episodes = [
            (
                "moves".to_owned(),
                episode(&[(20.0, 30.0), (16.0, 10.0), (18.0, 12.0)]),
            ),
            ("still".to_owned(), episode(&[(30.0, 50.0), (28.0, 45.0)])),
        ];
        let section = summarise(&episodes, &Settings::of(Protocol::Quick, 0));
        let value = |name: &str| {
            let metric = &section.metrics[&format!("fidelity.{name}")];
            (metric.value, metric.n)
        };
        assert_eq!(value("psnr"), (23.5, 2));
        // The three frames with the lowest PSNR of persistence are all of the first episode.
        assert_eq!(value("psnr_moving"), (18.0, 1));
        assert_eq!(value("psnr_persistence_moving"), (52.0 / 3.0, 1));
        assert_eq!(value("psnr_ceiling_moving"), (40.0, 1));
    }
}
