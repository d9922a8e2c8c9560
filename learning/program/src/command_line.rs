//! The command line of a program, told to another program as data.
//!
//! `wm` runs `wm-training` and others for some of its commands, and does not link them: it cannot know their flags, but
//! its completions and man pages need them. A program whose `main` begins with [`tell_if_asked`] tells its definition as
//! JSON, and [`ask`] makes a [`Command`] of it again.
//!
//! clap_complete's dynamic completion is not used: it is an unstable feature, starts a program at each press of Tab, and gives
//! no man pages, which need the definition anyway.
//!
//! What is told is what people read and shells complete: names, help, values, and how many of them. Not told: which
//! arguments exclude one another, and what parses values, so that such a command is for documentation only.

mod argument;
mod description;

use std::{
    io::Write as _,
    path::{Path, PathBuf},
    process,
};

use clap::{Command, CommandFactory};
use description::Description;

/// The argument, alone, that asks a program.
const QUESTION: &str = "--describe-command-line";

/// Why a program does not tell.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// It cannot be run.
    #[error("{program}: {reason}", program = .program.display())]
    NotRun {
        /// The program.
        program: PathBuf,
        /// Why not. No source, since the message has it.
        reason: std::io::Error,
    },
    /// It answers otherwise, as a program of another version.
    #[error("{program} does not describe its command line, as that of this version of wm would: {reason}", program = .program.display())]
    NoAnswer {
        /// The program.
        program: PathBuf,
        /// What came instead.
        reason: String,
    },
}

/// Tells the definition of `C` on standard output if this process was started by [`ask`], which then has nothing else to do:
/// returns whether it was.
pub fn tell_if_asked<C: CommandFactory>() -> bool {
    let mut arguments = std::env::args_os().skip(1);
    let is_asked = arguments.next().is_some_and(|first| first == QUESTION);
    if !is_asked || arguments.next().is_some() {
        return false;
    }
    let text = told(&C::command());
    // That nobody reads it is the reader's concern.
    writeln!(std::io::stdout(), "{text}").ok();
    true
}

/// The command line of a program that tells it.
///
/// # Errors
/// If it cannot be run, or does not tell.
pub fn ask(program: &Path) -> Result<Command, Error> {
    let output = process::Command::new(program)
        .arg(QUESTION)
        .stdin(process::Stdio::null())
        .output();
    let output = output.map_err(|reason| Error::NotRun {
        program: program.to_owned(),
        reason,
    })?;
    let no_answer = |reason: String| Error::NoAnswer {
        program: program.to_owned(),
        reason,
    };
    if !output.status.success() {
        return Err(no_answer(output.status.to_string()));
    }
    heard(&output.stdout).map_err(|error| no_answer(error.to_string()))
}

fn told(command: &Command) -> String {
    serde_json::json!(Description::of(command)).to_string()
}

fn heard(text: &[u8]) -> serde_json::Result<Command> {
    Ok(serde_json::from_slice::<Description>(text)?.into_command())
}

#[cfg(test)]
mod tests;
