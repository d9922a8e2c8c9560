//! The policies to judge.

use std::{fmt, str::FromStr, time::Duration};

use anyhow::{Context as _, Error, Result, ensure};
use wm_sim::ScriptedPolicy;

use crate::policy::{Policy, PolicyProcess};

/// A policy to judge.
#[derive(Debug)]
pub enum Candidate {
    /// It acts on the simulator's state. In imagination, its commands on the arm are repeated.
    Scripted(ScriptedPolicy),
    /// It acts on pictures: on the arm the camera's, in imagination the predicted ones.
    Program {
        /// Its name in the findings.
        name: String,
        /// The program.
        policy: Policy,
    },
}

impl Candidate {
    /// A program, which is started when it has to act. `limit` bounds each answer.
    ///
    /// # Errors
    /// If the command cannot be split into words.
    pub fn program(named: &NamedCommand, limit: Duration) -> Result<Self> {
        let process = PolicyProcess::new(&named.command, limit);
        let process = process.with_context(|| format!("--policy-command {}", named.name))?;
        Ok(Self::Program {
            name: named.name.clone(),
            policy: Policy::Command(process),
        })
    }
}

impl fmt::Display for Candidate {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Scripted(policy) => policy.fmt(f),
            Self::Program { name, .. } => f.write_str(name),
        }
    }
}

/// `NAME=COMMAND`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct NamedCommand {
    /// Name of the policy.
    pub name: String,
    /// Command of its program.
    pub command: String,
}

impl FromStr for NamedCommand {
    type Err = Error;

    fn from_str(text: &str) -> Result<Self> {
        let (name, command) = text
            .split_once('=')
            .with_context(|| format!("expected NAME=COMMAND, got {text:?}"))?;
        ensure!(
            !name.is_empty() && !command.trim().is_empty(),
            "expected NAME=COMMAND, got {text:?}"
        );
        Ok(Self {
            name: name.to_owned(),
            command: command.to_owned(),
        })
    }
}
