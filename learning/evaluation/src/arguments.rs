//! `wm eval SUITE`.

use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
    sync::Arc,
};

use anyhow::{Context as _, Result, ensure};
use clap::Args;
use wm_dataset::HeldOutArgs;
use wm_metrics::findings::Suite;
use wm_zoo::ModelFolder;

use crate::control::SearchedDimensions;
use crate::families;
use crate::{
    OutputArgs, Perception, PerceptionArgs, PolicyArgs, Protocol, ReaderArgs, Readers, Settings,
    Shard, Subject,
    merge::of_files,
    open_model,
    policy::{JudgeInputs, Setup},
    run,
};

/// Measure one or several models on bags
#[derive(Clone, Debug, Args)]
pub struct SuiteArgs {
    /// Model: tiny, or a model's folder
    #[arg(long)]
    pub model: String,
    /// Models to compare with --model, with paired statistics
    #[arg(long, num_args = 1.., value_name = "MODEL")]
    pub compare: Vec<String>,
    /// Held-out data.
    #[command(flatten)]
    pub on: HeldOutArgs,
    /// Suites to skip, such as cost, the only one whose figures vary between runs
    #[arg(long, value_enum, num_args = 1.., value_name = "SUITE")]
    pub skip: Vec<Suite>,
    /// Extent of the measurement
    #[arg(long, value_enum, default_value_t)]
    pub protocol: Protocol,
    /// YAML or JSON file with changes to the protocol's settings, named as in the JSON of a result, such as `control:
    /// {population: 1000}`
    #[arg(long, value_name = "FILE")]
    pub settings: Option<PathBuf>,
    /// Most episodes for suites that measure whole episodes
    #[arg(long)]
    pub episodes: Option<usize>,
    /// Most windows for suites that measure windows; searches (control) take by far the longest
    #[arg(long)]
    pub windows: Option<usize>,
    /// Dimensions of the actions that searches recover (control): all, as in the paper, effective (those with an effect on
    /// predictions), translations, or names such as dx,dy [default: effective;
    /// all in --protocol paper]
    #[arg(long, value_name = "DIMENSIONS")]
    pub search_dims: Option<SearchedDimensions>,
    /// Search all dimensions unless an option or a setting says otherwise.
    #[arg(skip)]
    pub(crate) searches_all: bool,
    /// Most predicted steps of a decoded rollout
    #[arg(long)]
    pub steps: Option<usize>,
    /// Seed of all random numbers
    #[arg(long, default_value_t = 0)]
    pub seed: u64,
    /// Euler steps per predicted frame, instead of the model's own
    #[arg(long, value_name = "N")]
    pub sampling_steps: Option<usize>,
    /// Further models that read latents.
    #[command(flatten)]
    pub readers: ReaderArgs,
    /// Networks of the user.
    #[command(flatten)]
    pub perception: PerceptionArgs,
    /// Measure part I of N, from 0; join the parts with `wm eval merge`
    #[arg(long, value_name = "I/N", requires = "records", conflicts_with_all = ["report", "json", "csv", "card", "paper"])]
    pub shard: Option<Shard>,
    /// Folder for measurements by unit, from which an interrupted run resumes [default: in the report's folder, or
    /// beside the file of the figures]
    #[arg(long, value_name = "DIR")]
    pub records: Option<PathBuf>,
    /// Number of threads, without effect on the figures [default: all of the machine]
    #[arg(long)]
    pub threads: Option<usize>,
    /// Outputs.
    #[command(flatten)]
    pub output: OutputArgs,
    /// Policy in the imagined environment.
    #[command(flatten, next_help_heading = "Policy")]
    pub policy: PolicyArgs,
}

/// Rejects a model given twice.
fn require_different(folders: &[ModelFolder]) -> Result<()> {
    if folders.len() < 2 {
        return Ok(());
    }
    let mut names_by_hash: BTreeMap<String, String> = BTreeMap::new();
    for folder in folders {
        let world = folder.world_model()?;
        let other = names_by_hash.insert(world.hash, folder.name());
        ensure!(
            other.is_none(),
            "{} has the same weights as {}: nothing to compare",
            folder.name(),
            other.unwrap_or_default()
        );
    }
    Ok(())
}

impl SuiteArgs {
    /// Measures `suites` and writes the findings; a shard writes records only.
    ///
    /// # Errors
    /// If a model, data or file is unusable.
    pub fn run(&self, suites: &[Suite]) -> Result<()> {
        self.output.require_free()?;
        ensure!(
            self.episodes != Some(0) && self.windows != Some(0) && self.steps != Some(0),
            "--episodes, --windows and --steps are at least 1"
        );
        if let Some(threads) = self.threads {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads);
            pool.build_global().context("--threads")?;
        }
        ensure!(
            self.sampling_steps != Some(0),
            "--sampling-steps is at least 1"
        );
        let temporary;
        let default = self.output.records();
        let folder: &Path = match self.records.as_ref().or(default.as_ref()) {
            Some(folder) => folder,
            None => {
                temporary = tempfile::tempdir().context("a folder for records")?;
                temporary.path()
            }
        };
        let suites: Vec<Suite> = suites
            .iter()
            .copied()
            .filter(|s| !self.skip.contains(s))
            .collect();
        ensure!(!suites.is_empty(), "--skip leaves no suite");
        ensure!(
            self.perception.is_empty() || suites.contains(&Suite::Fidelity),
            "--networks and --lpips apply only to the suite fidelity"
        );
        ensure!(
            self.policy.is_default() || suites.contains(&Suite::Policy),
            "--policy, --tasks, --trials, --ood, --start-images, --judges and --prompts apply only to the suite policy"
        );
        let perception = Arc::new(Perception::open(&self.perception)?);
        let shard = self.shard.unwrap_or(Shard::WHOLE);
        let setup = Setup::new(&self.policy)?;
        let models = || std::iter::once(&self.model).chain(&self.compare);
        // Before hours of measurements.
        let names: Vec<&str> = models().map(String::as_str).collect();
        families::members(&self.output.families, &names)?;
        let folders: Vec<ModelFolder> = models()
            .map(|model| open_model(model))
            .collect::<Result<_>>()?;
        require_different(&folders)?;
        self.readers.require_models(&folders)?;
        let setup = match setup.has_probes_judge() {
            true => setup.with_probes(self.judges(&folders)?)?,
            false => setup,
        };
        drop(folders);
        let mut settings = self.settings(&setup)?;
        settings.networks = perception.description().cloned();
        let mut files = Vec::new();
        for (position, model) in models().enumerate() {
            let mut subject = Subject::open(model, &self.on, &self.readers)
                .with_context(|| format!("model {model}"))?;
            subject.perception = Arc::clone(&perception);
            if let Some(steps) = self.sampling_steps {
                subject.sampler.steps = steps;
                subject.sampler.validate().context("--sampling-steps")?;
            }
            let records = (folder, shard);
            files.push(run::measure(
                &subject,
                (&self.on.data, position),
                &suites,
                &settings,
                &setup,
                records,
            )?);
        }
        if shard.is_part() {
            for file in files {
                println!("wrote {}", file.display());
            }
            return Ok(());
        }
        self.output.write(&of_files(&files)?)
    }

    /// The success probes as judges, of which each model has the same.
    fn judges(&self, folders: &[ModelFolder]) -> Result<Vec<JudgeInputs>> {
        let mut judges: Option<(String, Vec<JudgeInputs>)> = None;
        for folder in folders {
            let own = Readers::open(folder, &self.readers)?.judges();
            let Some((first, of_first)) = &judges else {
                judges = Some((folder.name(), own));
                continue;
            };
            let names = |judges: &[JudgeInputs]| {
                let names: Vec<&str> = judges.iter().map(|judge| &*judge.name).collect();
                names.join(", ")
            };
            ensure!(
                *of_first == own,
                "--judges probes: {first} has {}, {} has {}; expected the same kinds of probes",
                names(of_first),
                folder.name(),
                names(&own)
            );
        }
        Ok(judges.map(|(_, judges)| judges).unwrap_or_default())
    }

    fn settings(&self, setup: &Setup) -> Result<Settings> {
        let mut settings = Settings::of(self.protocol, self.seed);
        if self.searches_all {
            settings.control.searched = SearchedDimensions::All;
        }
        if let Some(path) = &self.settings {
            let name = || path.display().to_string();
            let text = std::fs::read_to_string(path).with_context(name)?;
            settings = settings.with(&text).with_context(name)?;
        }
        if let Some(episodes) = self.episodes {
            settings.fidelity.episodes = episodes;
            settings.latents.judged_episodes = episodes;
            settings.policy.tasks = episodes;
        }
        if let Some(windows) = self.windows {
            for search in &mut settings.control.searches {
                search.windows = windows;
            }
            settings.control.response_windows = windows;
            settings.latents.windows = windows;
            settings.robustness.windows = windows;
        }
        if let Some(searched) = &self.search_dims {
            settings.control.searched = searched.clone();
        }
        if let Some(steps) = self.steps {
            settings.fidelity.steps = steps;
            settings.policy.steps = steps;
        }
        if let Some(trials) = self.policy.trials {
            settings.policy.trials = trials;
        }
        settings.policy.inputs = setup.inputs().clone();
        Ok(settings)
    }
}
