use wm_metrics::findings::Suite;

use super::*;
use crate::{
    Protocol,
    perception::{BySource, Vectors},
};

fn settings() -> Settings {
    Settings {
        resamples: 100,
        ..Settings::of(Protocol::Quick, 0)
    }
}

fn summary(episodes: &[(&str, EpisodePerception)]) -> Section {
    let mut section = Section::new(Suite::Fidelity);
    let episodes: Vec<Episode<'_>> = episodes
        .iter()
        .map(|(name, found)| (*name, found))
        .collect();
    summarise(&mut section, &episodes, &settings());
    section
}

fn value(section: &Section, name: &str) -> f64 {
    section.metrics[&format!("fidelity.{name}")].value
}

fn why(section: &Section, name: &str) -> String {
    let name = format!("fidelity.{name}");
    let absent = section.absent.iter().find(|absent| absent.metric == name);
    absent.unwrap().why.clone()
}

/// Vectors of one feature.
fn line(values: &[f32]) -> Vectors {
    let vectors: Vec<Vec<f32>> = values.iter().map(|value| vec![*value]).collect();
    Vectors::of(&vectors).unwrap()
}

#[test]
fn figures_are_means_over_steps_then_episodes() {
    let lpips = |predicted: &[f64], reconstructed: &[f64]| {
        let mut found = EpisodePerception::default();
        let values = Values {
            predicted: predicted.to_vec(),
            reconstructed: reconstructed.to_vec(),
        };
        found.keep(EpisodeFigure::Lpips, Ok::<_, String>(values));
        found.keep(
            EpisodeFigure::PckCoverage,
            Ok::<_, String>(Values::of(predicted.to_vec())),
        );
        found
    };
    let section = summary(&[
        ("a", lpips(&[0.2, 0.4, 0.6], &[0.1, 0.1, 0.1])),
        ("b", lpips(&[0.5], &[0.3])),
    ]);
    assert!((value(&section, "lpips") - 0.45).abs() < 1e-12);
    assert!((value(&section, "lpips_ceiling") - 0.2).abs() < 1e-12);
    assert!((value(&section, "lpips_gap") - 0.25).abs() < 1e-12);
    assert_eq!(section.metrics["fidelity.lpips"].samples["b"], 0.5);
    assert!(
        !section
            .metrics
            .contains_key("fidelity.pck_coverage_ceiling")
    );
    let titles: Vec<&str> = section.curves.iter().map(|curve| &*curve.title).collect();
    assert_eq!(
        titles,
        [
            "LPIPS by step",
            "Gap of LPIPS by step",
            "PCK coverage by step"
        ]
    );
    // Both episodes have a first step, one has a second.
    let points = &section.curves[0].series[0].points;
    assert_eq!((points[0], points[1]), ([1.0, 0.35], [2.0, 0.4]));
    assert_eq!(section.curves[0].series.len(), 2);
}

#[test]
fn metrics_without_a_network_are_missing_by_name() {
    let section = summary(&[("a", EpisodePerception::default())]);
    assert!(section.metrics.is_empty() && section.curves.is_empty() && section.notes.is_empty());
    let figures = EpisodeFigure::ALL.into_iter().map(EpisodeFigure::name);
    let spaces = FeatureSpace::ALL
        .into_iter()
        .flat_map(FeatureSpace::metrics);
    let names: Vec<String> = figures
        .chain(spaces.copied())
        .map(|name| format!("fidelity.{name}"))
        .collect();
    let absent: Vec<&str> = section
        .absent
        .iter()
        .map(|absent| &*absent.metric)
        .collect();
    assert_eq!(absent, names);
    assert_eq!(
        why(&section, "fvd"),
        "no network for `fvd`; see docs/evaluation.md"
    );
    let both = why(&section, "t_lpips");
    assert!(
        both.contains("`lpips`") && both.contains("`flow`"),
        "{both}"
    );
}

#[test]
fn metric_of_two_networks_names_the_missing_one() {
    let mut found = EpisodePerception::default();
    found.lack("flow_score", "one predicted frame".into());
    let section = summary(&[("a", found)]);
    let lacking = why(&section, "t_lpips");
    assert!(
        lacking.contains("`lpips`") && !lacking.contains("`flow`"),
        "{lacking}"
    );
    assert_eq!(
        why(&section, "flow_score"),
        "missing in all episodes: one predicted frame"
    );
}

#[test]
fn distances_use_the_features_of_all_episodes() {
    // Together: true values have mean 2 and variance 20/3, predictions are 3 higher, reconstructions are equal.
    let truth: [&[f32]; 2] = [&[-1.0, 1.0], &[3.0, 5.0]];
    let episode = |values: &[f32]| {
        let of = |add: f32| line(&values.iter().map(|value| value + add).collect::<Vec<_>>());
        let of = BySource {
            truth: of(0.0),
            predicted: of(3.0),
            reconstructed: of(0.0),
        };
        let mut found = EpisodePerception::default();
        found.features.insert(FeatureSpace::Fid, of.clone());
        found.features.insert(FeatureSpace::Jepa, of);
        found
    };
    let mut without = EpisodePerception::default();
    without.lack("fvd", "12 predicted frames, but a clip has 16".into());
    let section = summary(&[
        ("a", episode(truth[0])),
        ("b", episode(truth[1])),
        ("c", without),
    ]);
    let near = |name: &str, expected: f64| {
        let value = value(&section, name);
        assert!((value - expected).abs() < 1e-9, "{name}: {value}");
    };
    near("fid", 9.0);
    near("fid_ceiling", 0.0);
    near("fid_gap", 9.0);
    near("jepa_similarity_ceiling", 1.0);
    // Kernel (xy)^2: the squared difference of the mean squares, 9 and 30.
    near("jepa_mmd", 21.0 * 21.0);
    near("jepa_mmd_gap", 21.0 * 21.0);
    assert!(value(&section, "jepa_similarity") < 1e-9);
    let fid = &section.metrics["fidelity.fid"];
    assert_eq!((fid.n, fid.interval), (2, None));
    assert!(fid.about.contains("No interval"), "{}", fid.about);
    assert!(
        section
            .notes
            .iter()
            .any(|note| note.starts_with("fid: 4 vectors of 1 features, of 2 episodes"))
    );
    let fvd = "fvd covers 2 of 3 episodes; missing: c (12 predicted frames, but a clip has 16).";
    assert!(
        section.notes.iter().any(|note| note == fvd),
        "{:?}",
        section.notes
    );
}

#[test]
fn single_vector_has_no_distance() {
    let of = BySource {
        truth: line(&[1.0]),
        predicted: line(&[1.0]),
        reconstructed: line(&[1.0]),
    };
    let mut found = EpisodePerception::default();
    found.features.insert(FeatureSpace::Fvd, of);
    let section = summary(&[("a", found)]);
    assert_eq!(
        why(&section, "fvd"),
        "too few feature vectors: expected at least 2, got 1"
    );
}
