//! Commands that are separate programs, because what they link would make the build of `wm` long: `wm bridge` runs the
//! program `wm-bridge`, as git and cargo do. Completions and man pages ask those programs that tell what they take.

use anyhow::{Context as _, Result, bail};
use clap::Args;
use std::{
    ffi::OsString,
    os::unix::process::CommandExt as _,
    path::{Path, PathBuf},
    process::{Command, ExitCode},
};

/// What a program of its own takes, unread.
#[derive(Args, Debug)]
pub struct Arguments {
    /// Arguments of the program; its `--help` lists them once it is built
    #[arg(trailing_var_arg = true, allow_hyphen_values = true)]
    own: Vec<OsString>,
}

impl Arguments {
    /// Becomes the program, with these arguments between words `before` and `after` them.
    ///
    /// # Errors
    /// It is not there (the error says how to build it), or cannot be started.
    pub fn exec<const N: usize>(
        self,
        program: &str,
        before: [&str; N],
        after: Vec<String>,
    ) -> Result<ExitCode> {
        let before = before.into_iter().map(OsString::from);
        let after = after.into_iter().map(OsString::from);
        exec(program, before.chain(self.own).chain(after))
    }
}

/// A command that a program tells of.
struct Told {
    program: &'static str,
    /// The words after `wm`, and after the program's name.
    words: &'static [&'static str],
}

const fn told(program: &'static str, words: &'static [&'static str]) -> Told {
    Told { program, words }
}

/// The commands whose programs tell of them.
const TOLD: [Told; 5] = [
    told("wm-training", &["sim"]),
    told("wm-training", &["dataset"]),
    told("wm-training", &["train"]),
    told("wm-training", &["eval"]),
    told("wm-training", &["model", "calibrate"]),
];

/// A command line, and what could not be put into it.
pub struct Described {
    /// With what the programs tell that are there.
    pub command: clap::Command,
    /// The programs that are not, or that do not tell, each with what to do.
    pub left_out: Vec<String>,
}

/// Puts what separate programs take into a definition of `wm`. They are looked for where they would be run.
///
/// # Errors
/// The folder of this program is unknown.
pub fn described(command: clap::Command) -> Result<Described> {
    let beside = std::env::current_exe()?;
    let asked = |program: &Path| wm_program::command_line::query(program);
    Ok(described_by(command, &beside, &folders(&beside), asked))
}

fn described_by(
    mut command: clap::Command,
    beside: &Path,
    folders: &[PathBuf],
    asked: impl Fn(&Path) -> Result<clap::Command, wm_program::command_line::Error>,
) -> Described {
    let mut left_out = Vec::new();
    let mut programs: Vec<&str> = TOLD.iter().map(|told| told.program).collect();
    programs.dedup();
    for program in programs {
        let Some(found) = find(program, folders) else {
            let way = way_to(program, beside);
            left_out.push(format!("{program} is not there ({way})"));
            continue;
        };
        match asked(&found) {
            Ok(own) => {
                let of_it = TOLD.iter().filter(|told| told.program == program);
                for Told { words, .. } in of_it {
                    if let Some(own) = at(&own, words) {
                        command = replaced(command, words, own);
                    }
                }
            }
            Err(error) => left_out.push(error.to_string()),
        }
    }
    Described { command, left_out }
}

/// The command of these words in a definition.
fn at<'a>(command: &'a clap::Command, words: &[&str]) -> Option<&'a clap::Command> {
    let mut words = words.iter();
    words.try_fold(command, |command, word| command.find_subcommand(word))
}

/// A definition whose command of these words is `own`, under the words that `wm` has for it: they name the program.
fn replaced(command: clap::Command, words: &[&str], own: &clap::Command) -> clap::Command {
    match words.split_first() {
        None => match command.get_about() {
            Some(about) => own.clone().about(about.clone()),
            None => own.clone(),
        },
        Some((first, rest)) => {
            command.mut_subcommand(first, |command| replaced(command, rest, own))
        }
    }
}

/// Where a program is, if it is beside this one or on the PATH.
///
/// # Errors
/// The folder of this program is unknown.
pub fn program(name: &str) -> Result<Option<PathBuf>> {
    let beside = std::env::current_exe()?;
    Ok(find(name, &folders(&beside)))
}

/// Where programs are looked for: beside this one, and then on the PATH.
fn folders(beside: &Path) -> Vec<PathBuf> {
    let path = std::env::var_os("PATH").unwrap_or_default();
    let own = beside.parent().map(Path::to_path_buf).into_iter();
    own.chain(std::env::split_paths(&path)).collect()
}

/// Becomes the program, which is looked for beside this one and then on the PATH.
///
/// # Errors
/// It is not there (the error says how to build it), or cannot be started.
pub fn exec(program: &str, args: impl IntoIterator<Item = OsString>) -> Result<ExitCode> {
    let beside = std::env::current_exe()?;
    let Some(found) = find(program, &folders(&beside)) else {
        bail!(
            "the program {program} was found neither next to {} nor on the PATH; in the repository of wm,\n    {}",
            beside.display(),
            way_to(program, &beside)
        );
    };
    let error = Command::new(&found).args(args).exec();
    Err(error).with_context(|| format!("starting {}", found.display()))
}

/// The command that puts the program beside this one: where cargo builds, or where it installs.
fn way_to(program: &str, beside: &Path) -> String {
    if beside.iter().any(|part| part == "target") {
        return format!("cargo build --release -p {}", program.replace('-', "_"));
    }
    let name = program.trim_start_matches("wm-");
    let folder = match name {
        "training" => "world-model",
        "datasets" => "bags",
        _ => "nodes",
    };
    format!("cargo install --path {folder}/{name}")
}

fn find(program: &str, folders: &[PathBuf]) -> Option<PathBuf> {
    let mut files = folders.iter().map(|folder| folder.join(program));
    files.find(|file| file.is_file())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_folder_that_has_it_holds() {
        let folders: Vec<_> = (0..3).map(|_| tempfile::tempdir().unwrap()).collect();
        let paths: Vec<_> = folders
            .iter()
            .map(|folder| folder.path().to_path_buf())
            .collect();
        assert_eq!(find("wm-x", &paths), None);
        for folder in &folders[1..] {
            std::fs::write(folder.path().join("wm-x"), "").unwrap();
        }
        assert_eq!(find("wm-x", &paths), Some(folders[1].path().join("wm-x")));
    }

    #[test]
    fn a_program_beside_an_installed_one_is_installed() {
        let way = |program| way_to(program, Path::new("/home/me/.cargo/bin/wm"));
        assert_eq!(way("wm-datasets"), "cargo install --path learning/import");
        assert_eq!(way("wm-bridge"), "cargo install --path nodes/bridge");
    }

    #[test]
    fn what_is_missing_is_said_with_how_to_build_it() {
        let error = exec("wm-is-not-there", []).unwrap_err().to_string();
        assert!(
            error.contains("cargo build --release -p wm_is_not_there"),
            "{error}"
        );
    }
    /// A program that tells of a command `eval` alone: what it says stands in for the whole, and the rest stays.
    #[test]
    fn a_program_that_tells_is_described_by_itself() {
        let beside = Path::new("/repository/target/release/wm");
        let wm = || crate::cli::definition();
        let folder = tempfile::tempdir().unwrap();
        let folders = [folder.path().to_path_buf()];
        let program = folder.path().join("wm-training");
        let tells = |asked: &Path| {
            assert_eq!(asked, program);
            let eval = clap::Command::new("eval").subcommand(clap::Command::new("all"));
            Ok(clap::Command::new("wm-training").subcommand(eval))
        };
        let none = described_by(wm(), beside, &folders, tells);
        let way = "wm-training is not there (cargo build --release -p wm_training)";
        assert_eq!(none.left_out, [way]);
        assert!(at(&none.command, &["eval", "all"]).is_none());

        std::fs::write(&program, "").unwrap();
        let told = described_by(wm(), beside, &folders, tells);
        assert_eq!(told.left_out, Vec::<String>::new());
        assert!(at(&told.command, &["eval", "all"]).is_some());
        let about = |words| {
            let command = at(&told.command, words).unwrap();
            command.get_about().unwrap().to_string()
        };
        assert!(about(&["eval"]).contains("runs wm-training"));
        assert!(about(&["train"]).contains("runs wm-training"));

        // Of another version.
        let left_out = described_by(wm(), beside, &folders, |program| {
            Err(wm_program::command_line::Error::InvalidDescription {
                program: program.to_owned(),
                reason: "exit status: 2".to_owned(),
            })
        });
        assert!(left_out.left_out[0].contains("does not describe"));
        assert!(at(&left_out.command, &["eval", "all"]).is_none());
    }

    /// Else they would never be put in.
    #[test]
    fn every_command_that_is_told_is_one_of_wm() {
        for told in TOLD {
            assert!(at(&crate::cli::definition(), told.words).is_some());
        }
    }
}
