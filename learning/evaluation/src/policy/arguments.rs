use std::path::PathBuf;

use clap::{Args, ValueEnum};

/// Who acts in the imagined environment, on what, and who judges.
#[derive(Clone, Debug, Default, Args)]
pub struct PolicyArgs {
    /// Who acts in the imagined environment; --policy-command names a program instead.
    #[arg(long, value_enum, default_value_t)]
    pub policy: BuiltIn,
    /// The policy as a program that answers JSON lines, as 'python3 examples/imagined_policy/policy.py'. No shell: quotes are
    /// understood, nothing is expanded.
    #[arg(long, value_name = "COMMAND", conflicts_with = "policy")]
    pub policy_command: Option<String>,
    /// Most seconds for an answer of the program; its first has to load the policy too.
    #[arg(
        long,
        value_name = "SECONDS",
        default_value_t = 600,
        value_parser = clap::value_parser!(u64).range(1..=86_400)
    )]
    pub policy_timeout: u64,
    /// Tasks (YAML): only episodes with one of these instructions, and the level of each. bridge_v2: the paper's twenty.
    #[arg(long, value_name = "FILE")]
    pub tasks: Option<PathBuf>,
    /// Trials of each task, which differ in the noise.
    #[arg(long)]
    pub trials: Option<usize>,
    /// Besides, trials out of distribution: under the other instruction that the file of tasks gives.
    #[arg(long, value_enum, requires = "tasks")]
    pub ood: Option<OutOfDistribution>,
    /// Besides, trials that begin with another first frame: pictures (PNG, JPEG) named as their episode, as with things that
    /// distract.
    #[arg(long, value_name = "DIR")]
    pub start_images: Option<PathBuf>,
    /// Vision-language models that judge the imagined episodes (YAML, as learning/evaluation/judges.yaml). Their answers are
    /// kept beside the records.
    #[arg(long, value_name = "FILE")]
    pub judges: Option<PathBuf>,
    /// What they are asked (YAML); the paper's prompts by default.
    #[arg(long, value_name = "FILE", requires = "judges")]
    pub prompts: Option<PathBuf>,
}

impl PolicyArgs {
    /// Whether nothing was asked for.
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

/// A policy that takes no program.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum BuiltIn {
    /// The episode's own actions, then no motion: what the world model makes of a known outcome, and the most to hope for.
    #[default]
    Recorded,
    /// No motion, the gripper as it is: the least.
    Still,
}

/// What is out of distribution.
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
    fn the_recorded_policy_acts_unless_another_is_named() {
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
