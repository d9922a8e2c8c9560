//! Resolves the arguments.

use std::{fs, path::Path, sync::Arc, time::Duration};

use crate::judges::{PanelSettings, Prompts, Tasks, tasks::BRIDGE_V2_YAML};
use anyhow::{Context as _, Result, ensure};
use sha2::{Digest as _, Sha256};

use super::{
    JudgeInputs, PolicyArgs, PolicyInputs,
    arguments::{BuiltIn, OutOfDistribution},
    process::PolicyProcess,
    start_images::StartImages,
};

/// Name of the embedded tasks.
const EMBEDDED_TASKS: &str = "bridge_v2";
/// Name of the success probes as judges.
const PROBES: &str = "probes";

/// A policy.
#[derive(Debug)]
pub(crate) enum Policy {
    /// The episode's own actions, then none.
    Recorded,
    /// No motion.
    Still,
    /// A program.
    Command(PolicyProcess),
}

/// Policy, tasks and judges: files are read, programs not yet started.
#[derive(Debug)]
pub struct Setup {
    pub(super) policy: Policy,
    pub(super) tasks: Option<Tasks>,
    pub(super) other_instructions: bool,
    pub(super) start_images: Option<StartImages>,
    pub(super) judges: Option<(PanelSettings, Arc<Prompts>)>,
    /// Whether success probes are the judges.
    has_probes_judge: bool,
    inputs: PolicyInputs,
}

impl Policy {
    /// Name in the settings.
    fn name(&self) -> &str {
        match self {
            Self::Recorded => "recorded",
            Self::Still => "still",
            Self::Command(process) => process.command(),
        }
    }
}

impl Setup {
    /// Reads the files of the arguments.
    ///
    /// # Errors
    /// If a file cannot be read, or is invalid.
    pub fn new(arguments: &PolicyArgs) -> Result<Self> {
        ensure!(arguments.trials != Some(0), "--trials is at least 1");
        let limit = Duration::from_secs(arguments.policy_timeout);
        let policy = match (&arguments.policy_command, arguments.policy) {
            (Some(command), _) => {
                let process = PolicyProcess::new(command, limit).context("--policy-command")?;
                Policy::Command(process)
            }
            (None, BuiltIn::Recorded) => Policy::Recorded,
            (None, BuiltIn::Still) => Policy::Still,
        };
        let tasks = arguments.tasks.as_deref().map(tasks_text).transpose()?;
        let prompts = arguments.prompts.as_deref().map(text).transpose()?;
        let judges = arguments.judges.as_deref();
        let has_probes_judge = judges.is_some_and(|path| is_builtin(path, PROBES));
        ensure!(
            !has_probes_judge || prompts.is_none(),
            "--prompts are for vision-language models, but --judges {PROBES} are none"
        );
        let judges = match judges.filter(|_| !has_probes_judge) {
            Some(path) => {
                let panel = PanelSettings::read(path);
                let panel = panel.with_context(|| path.display().to_string())?;
                let words = match &prompts {
                    Some(text) => Prompts::parse(text).context("--prompts")?,
                    None => Prompts::paper()?,
                };
                Some((panel, Arc::new(words)))
            }
            None => None,
        };
        let start_images = arguments.start_images.as_deref().map(StartImages::open);
        let start_images = start_images.transpose().context("--start-images")?;
        let other_instructions = arguments.ood == Some(OutOfDistribution::Instruction);
        let panel = judges.as_ref().map(|(panel, _)| panel);
        let inputs = PolicyInputs {
            policy: policy.name().to_owned(),
            tasks: tasks.as_deref().map(digest),
            other_instructions,
            start_images: start_images
                .as_ref()
                .map(|images| images.digest().to_owned()),
            prompts: prompts.as_deref().map(digest),
            frames: panel.map(|panel| panel.frames),
            judges: panel.map_or_else(Vec::new, judge_inputs),
        };
        Ok(Self {
            tasks: tasks
                .map(|text| Tasks::parse(&text))
                .transpose()
                .context("--tasks")?,
            policy,
            other_instructions,
            start_images,
            judges,
            has_probes_judge,
            inputs,
        })
    }

    /// Whether success probes are the judges.
    #[must_use]
    pub fn has_probes_judge(&self) -> bool {
        self.has_probes_judge
    }

    /// With these success probes as the judges.
    ///
    /// # Errors
    /// If there is none.
    pub fn with_probes(mut self, judges: Vec<JudgeInputs>) -> Result<Self> {
        ensure!(
            !judges.is_empty(),
            "--judges {PROBES}: the model has no success probe; train one with wm train probe"
        );
        self.inputs.judges = judges;
        Ok(self)
    }

    /// Inputs that affect the results.
    #[must_use]
    pub fn inputs(&self) -> &PolicyInputs {
        &self.inputs
    }
}

fn judge_inputs(panel: &PanelSettings) -> Vec<JudgeInputs> {
    let judges = panel.judges.iter().map(|judge| JudgeInputs {
        name: judge.name.clone(),
        model: judge.model.clone(),
        temperature: judge.temperature,
        seed: judge.seed,
    });
    judges.collect()
}

fn tasks_text(path: &Path) -> Result<String> {
    if is_builtin(path, EMBEDDED_TASKS) {
        return Ok(BRIDGE_V2_YAML.to_owned());
    }
    text(path)
}

/// Whether a path is a name of this program's own, and of no file.
fn is_builtin(path: &Path, name: &str) -> bool {
    path.as_os_str() == name && !path.is_file()
}

fn text(path: &Path) -> Result<String> {
    fs::read_to_string(path).with_context(|| path.display().to_string())
}

fn digest(text: &str) -> String {
    format!("{:x}", Sha256::digest(text))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_a_file_hides_a_builtin_name() {
        assert!(is_builtin(Path::new("probes"), "probes"));
        assert!(is_builtin(Path::new("src"), "src"), "a folder");
        assert!(!is_builtin(Path::new("Cargo.toml"), "Cargo.toml"));
    }
}
