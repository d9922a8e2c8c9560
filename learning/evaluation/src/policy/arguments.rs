use std::path::PathBuf;

use clap::{Args, ValueEnum};

/// Policy, tasks and judges of imagined episodes.
#[derive(Clone, Debug, Default, Args)]
pub struct PolicyArgs {
    /// Policy in the imagined environment; --policy-command names a program instead
    #[arg(long, value_enum, default_value_t)]
    pub policy: BuiltIn,
    /// Program that answers JSON lines as the policy, such as 'python3 examples/imagined_policy/policy.py'; quotes work
    /// as in a shell, without expansion
    #[arg(long, value_name = "COMMAND", conflicts_with = "policy")]
    pub policy_command: Option<String>,
    /// Time limit for an answer of the program \[s\]; its first answer includes loading the policy
    #[arg(
        long,
        value_name = "SECONDS",
        default_value_t = 600,
        value_parser = clap::value_parser!(u64).range(1..=86_400)
    )]
    pub policy_timeout: u64,
    /// Tasks (YAML): only episodes with these instructions, with their levels. bridge_v2: the paper's twenty
    #[arg(long, value_name = "FILE")]
    pub tasks: Option<PathBuf>,
    /// Trials per task, which differ in the noise
    #[arg(long)]
    pub trials: Option<usize>,
    /// Add out-of-distribution trials, with the other instruction of the tasks file
    #[arg(long, value_enum, requires = "tasks")]
    pub ood: Option<OutOfDistribution>,
    /// Add trials with other first frames: pictures (PNG, JPEG) named as their episode, for example with distractors
    #[arg(long, value_name = "DIR")]
    pub start_images: Option<PathBuf>,
    /// Vision-language models that judge the imagined episodes (YAML, as learning/evaluation/judges.yaml). Their
    /// answers are stored beside the records. probes: no language models, but the success probes of the model and of
    /// --probe
    #[arg(long, value_name = "FILE")]
    pub judges: Option<PathBuf>,
    /// Prompts of the judges (YAML); the paper's by default
    #[arg(long, value_name = "FILE", requires = "judges")]
    pub prompts: Option<PathBuf>,
}

impl PolicyArgs {
    /// Whether no option was given.
    pub(crate) fn is_default(&self) -> bool {
        self.policy == BuiltIn::default()
            && self.policy_command.is_none()
            && self.tasks.is_none()
            && self.trials.is_none()
            && self.ood.is_none()
            && self.start_images.is_none()
            && self.judges.is_none()
            && self.prompts.is_none()
    }
}

/// A built-in policy.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum BuiltIn {
    /// The episode's own actions, then no motion: the model's view of a known outcome, and an upper bound
    #[default]
    Recorded,
    /// No motion, the gripper as it is: a lower bound
    Still,
}

/// An out-of-distribution condition.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum OutOfDistribution {
    /// The instruction.
    Instruction,
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use clap::{Command, FromArgMatches as _};

    use super::*;
    use crate::SuiteArgs;

    fn parse(more: &[&str]) -> Result<PolicyArgs, clap::Error> {
        let command = SuiteArgs::augment_args(Command::new("policy"));
        command.clone().debug_assert();
        let first = ["policy", "--model", "tiny", "--data", "bags"];
        let matches = command.try_get_matches_from([&first, more].concat())?;
        Ok(SuiteArgs::from_arg_matches(&matches)?.policy)
    }

    #[test]
    fn recorded_policy_is_the_default() {
        let plain = parse(&[]).unwrap();
        assert_eq!(plain.policy, BuiltIn::Recorded);
        assert_eq!(plain.policy_timeout, 600);
        let command = parse(&["--policy-command", "python3 policy.py"]).unwrap();
        assert_eq!(command.policy_command.unwrap(), "python3 policy.py");
        for wrong in [
            &["--policy", "still", "--policy-command", "cat"][..],
            &["--ood", "instruction"],
            &["--prompts", "prompts.yaml"],
            &["--policy-timeout", "0"],
        ] {
            assert!(parse(wrong).is_err(), "{wrong:?}");
        }
    }
}
