//! A small evaluation with readers of its results.

use std::{
    fs,
    path::{Path, PathBuf},
};

use clap::Parser;
use serde_json::Value;
use wm_evaluation::SuiteArgs;
use wm_metrics::findings::Suite;
use wm_sim::{EpisodeOptions, generate_bags};

#[derive(Parser)]
pub struct Eval {
    #[command(flatten)]
    pub arguments: SuiteArgs,
}

/// A folder with two episodes of 18 predicted frames and one of 4.
pub struct Bench {
    pub dir: tempfile::TempDir,
}

impl Bench {
    pub fn new() -> Self {
        let dir = tempfile::tempdir().unwrap();
        for (frames, episodes) in [(40, 2), (12, 1)] {
            let options = EpisodeOptions {
                frames,
                ..EpisodeOptions::default()
            };
            let bags = dir.path().join("bags").join(frames.to_string());
            fs::create_dir_all(&bags).unwrap();
            generate_bags(&bags, (episodes, wm_bag::Shard::WHOLE), 5, &options, |_| {
                Ok(())
            })
            .unwrap();
        }
        fs::write(
            dir.path().join("settings.yaml"),
            "resamples: 100\nfidelity: {episodes: 3, steps: 18, strips: 0}",
        )
        .unwrap();
        Self { dir }
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.dir.path().join(name)
    }

    pub fn eval(&self, more: &[(&str, &Path)]) -> anyhow::Result<()> {
        let mut line = vec!["eval".to_owned(), "--model".into(), "tiny".into()];
        let (bags, cache, settings) = (
            self.path("bags"),
            self.path("cache"),
            self.path("settings.yaml"),
        );
        let own: [(&str, &Path); 3] = [
            ("--bags", &bags),
            ("--cache", &cache),
            ("--settings", &settings),
        ];
        for (flag, path) in own.iter().chain(more) {
            line.extend([(*flag).to_owned(), path.display().to_string()]);
        }
        Eval::parse_from(line).arguments.run(&[Suite::Fidelity])
    }

    pub fn figures(&self, name: &str, more: &[(&str, &Path)]) -> Value {
        let json = self.path(name);
        self.eval(&[&[("--json", &*json)], more].concat()).unwrap();
        serde_json::from_str(&fs::read_to_string(json).unwrap()).unwrap()
    }
}

pub fn value(figures: &Value, name: &str) -> f64 {
    let value = figures["metrics"][format!("fidelity.{name}")]["value"].as_f64();
    value.unwrap_or_else(|| panic!("no {name}: {figures:#}"))
}

pub fn why(figures: &Value, name: &str) -> String {
    let why = figures["absent"][format!("fidelity.{name}")].as_str();
    why.unwrap_or_else(|| panic!("{name} is not absent: {figures:#}"))
        .to_owned()
}

/// An AlexNet with few channels, and heads, as in the tests of adapter training.
pub fn alexnet() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../training/tests/fixtures/adapter")
}

pub const METRICS: [&str; 17] = [
    "lpips",
    "t_lpips",
    "image_quality",
    "aesthetic_quality",
    "subject_consistency",
    "background_consistency",
    "dynamic_degree",
    "dynamic_degree_soft",
    "flow_score",
    "flow_mean",
    "photometric_consistency",
    "depth_abs_rel",
    "pck_coverage",
    "fid",
    "fvd",
    "jepa_similarity",
    "jepa_mmd",
];
