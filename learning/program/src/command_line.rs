//! Transfers the definition of a program's command line to another program.
//!
//! `wm` starts `wm-training` and others for some of its commands without linking them, but its completions and man pages
//! need their flags. A program whose `main` begins with [`describe_if_requested`] prints its definition as JSON, and
//! [`query`] converts it to a [`Command`].
//!
//! clap_complete's dynamic completion is not used: it is an unstable feature, starts a program at each press of Tab, and gives
//! no man pages, which need the definition anyway.
//!
//! The definition has what people read and shells complete: names, help, values and their numbers. It lacks conflicts of
//! arguments and value parsers, so the command serves only for documentation.

mod argument;
mod description;

use std::{
    io::Write as _,
    path::{Path, PathBuf},
    process,
};

use clap::{Command, CommandFactory};
use description::Description;

/// The only argument of a request.
const REQUEST: &str = "--describe-command-line";

/// A program without a description.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// It cannot be started.
    #[error("{program}: {reason}", program = .program.display())]
    Spawn {
        /// The program.
        program: PathBuf,
        /// The error. Not a `source`, since the text contains it.
        reason: std::io::Error,
    },
    /// Its output is not a description, for example of another version.
    #[error("{program} does not describe its command line like this version of wm: {reason}", program = .program.display())]
    InvalidDescription {
        /// The program.
        program: PathBuf,
        /// The fault of its output.
        reason: String,
    },
}

/// Prints the definition of `C` on standard output if [`query`] started this process; returns whether it did. The program
/// then ends.
pub fn describe_if_requested<C: CommandFactory>() -> bool {
    let mut arguments = std::env::args_os().skip(1);
    let is_requested = arguments.next().is_some_and(|first| first == REQUEST);
    if !is_requested || arguments.next().is_some() {
        return false;
    }
    let text = serialize(&C::command());
    // Without a reader, a failure does not matter.
    writeln!(std::io::stdout(), "{text}").ok();
    true
}

/// The command line of a program with a description.
///
/// # Errors
/// The program cannot be started, or does not describe itself.
pub fn query(program: &Path) -> Result<Command, Error> {
    let output = process::Command::new(program)
        .arg(REQUEST)
        .stdin(process::Stdio::null())
        .output();
    let output = output.map_err(|reason| Error::Spawn {
        program: program.to_owned(),
        reason,
    })?;
    let invalid = |reason: String| Error::InvalidDescription {
        program: program.to_owned(),
        reason,
    };
    if !output.status.success() {
        return Err(invalid(output.status.to_string()));
    }
    parse(&output.stdout).map_err(|error| invalid(error.to_string()))
}

fn serialize(command: &Command) -> String {
    serde_json::json!(Description::of(command)).to_string()
}

fn parse(text: &[u8]) -> serde_json::Result<Command> {
    Ok(serde_json::from_slice::<Description>(text)?.into_command())
}

#[cfg(test)]
mod tests;
