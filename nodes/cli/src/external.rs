//! Commands that are separate programs, since their dependencies would slow the build of `wm`. `wm bridge` runs the
//! program `wm-bridge`, as in git and cargo. Completions and man pages query those programs that describe their
//! arguments.

use anyhow::{Context as _, Result, bail};
use clap::Args;
use std::{
    ffi::OsString,
    os::unix::process::CommandExt as _,
    path::{Path, PathBuf},
    process::{Command, ExitCode},
};

/// Arguments that are passed on unread.
#[derive(Args, Debug)]
pub(crate) struct Arguments {
    /// Arguments of the program; its `--help` lists them once it is built
    #[arg(trailing_var_arg = true, allow_hyphen_values = true)]
    own: Vec<OsString>,
}

impl Arguments {
    /// Replaces this process by the program. The words `before` and `after` surround the arguments.
    ///
    /// # Errors
    /// The program is missing (the error contains the build command), or cannot be started.
    pub(crate) fn exec<const N: usize>(
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

/// A command that a program describes.
struct DescribedCommand {
    program: &'static str,
    /// The words after `wm`, and after the program's name.
    words: &'static [&'static str],
}

const fn described_command(
    program: &'static str,
    words: &'static [&'static str],
) -> DescribedCommand {
    DescribedCommand { program, words }
}

/// The commands with self-describing programs.
const DESCRIBED_COMMANDS: [DescribedCommand; 5] = [
    described_command("wm-training", &["sim"]),
    described_command("wm-training", &["dataset"]),
    described_command("wm-training", &["train"]),
    described_command("wm-training", &["eval"]),
    described_command("wm-training", &["model", "calibrate"]),
];

/// A command line, and the programs missing from it.
pub(crate) struct Described {
    /// With the arguments of the available programs.
    pub command: clap::Command,
    /// Programs that are missing or failed, each with a remedy.
    pub left_out: Vec<String>,
}

/// Adds the arguments of separate programs to a definition of `wm`. They are searched where they would be run.
///
/// # Errors
/// The folder of this program is unknown.
pub(crate) fn described(command: clap::Command) -> Result<Described> {
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
    let mut programs: Vec<&str> = DESCRIBED_COMMANDS
        .iter()
        .map(|command| command.program)
        .collect();
    programs.dedup();
    for program in programs {
        let Some(found) = find(program, folders) else {
            let way = way_to(program, beside);
            left_out.push(format!("{program} is missing ({way})"));
            continue;
        };
        match asked(&found) {
            Ok(own) => {
                let of_it = DESCRIBED_COMMANDS
                    .iter()
                    .filter(|command| command.program == program);
                for DescribedCommand { words, .. } in of_it {
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

/// The subcommand with these words.
fn at<'a>(command: &'a clap::Command, words: &[&str]) -> Option<&'a clap::Command> {
    let mut words = words.iter();
    words.try_fold(command, |command, word| command.find_subcommand(word))
}

/// The definition with `own` in place of the subcommand with these words, which stay.
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

/// The path of a program next to this one or on the PATH.
///
/// # Errors
/// The folder of this program is unknown.
pub(crate) fn program(name: &str) -> Result<Option<PathBuf>> {
    let beside = std::env::current_exe()?;
    Ok(find(name, &folders(&beside)))
}

/// The folders with programs: this program's, then the PATH.
fn folders(beside: &Path) -> Vec<PathBuf> {
    let path = std::env::var_os("PATH").unwrap_or_default();
    let own = beside.parent().map(Path::to_path_buf).into_iter();
    own.chain(std::env::split_paths(&path)).collect()
}

/// Replaces this process by the program, from the folder of this one or the PATH.
///
/// # Errors
/// It is missing (the error contains the build command), or cannot be started.
pub(crate) fn exec(program: &str, args: impl IntoIterator<Item = OsString>) -> Result<ExitCode> {
    let beside = std::env::current_exe()?;
    let Some(found) = find(program, &folders(&beside)) else {
        bail!(
            "the program {program} was found neither next to {} nor on the PATH; in the repository of wm,\n    {}",
            beside.display(),
            way_to(program, &beside)
        );
    };
    let error = Command::new(&found).args(args).exec();
    Err(error).with_context(|| format!("start {}", found.display()))
}

/// The command that puts the program next to this one, by cargo build or cargo install.
fn way_to(program: &str, beside: &Path) -> String {
    let name = match program.trim_start_matches("wm-") {
        "datasets" => "import",
        name => name,
    };
    if beside.iter().any(|part| part == "target") {
        return format!("cargo build --release -p wm_{}", name.replace('-', "_"));
    }
    let folder = match name {
        "training" | "import" => "learning",
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
    fn first_folder_with_the_program_counts() {
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
    fn program_next_to_an_installed_one_is_installed() {
        let way = |program| way_to(program, Path::new("/home/me/.cargo/bin/wm"));
        assert_eq!(way("wm-datasets"), "cargo install --path learning/import");
        assert_eq!(way("wm-bridge"), "cargo install --path nodes/bridge");
    }

    #[test]
    fn missing_program_is_reported_with_its_build_command() {
        let error = exec("wm-is-not-there", []).unwrap_err().to_string();
        assert!(
            error.contains("cargo build --release -p wm_is_not_there"),
            "{error}"
        );
    }
    /// A program that describes only the command `eval`.
    #[test]
    fn self_describing_program_replaces_its_commands() {
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
        let way = "wm-training is missing (cargo build --release -p wm_training)";
        assert_eq!(none.left_out, [way]);
        assert!(at(&none.command, &["eval", "all"]).is_none());

        std::fs::write(&program, "").unwrap();
        let described = described_by(wm(), beside, &folders, tells);
        assert_eq!(described.left_out, Vec::<String>::new());
        assert!(at(&described.command, &["eval", "all"]).is_some());
        let about = |words| {
            let command = at(&described.command, words).unwrap();
            command.get_about().unwrap().to_string()
        };
        assert!(about(&["eval"]).contains("runs wm-training"));
        assert!(about(&["train"]).contains("runs wm-training"));

        // of another version
        let left_out = described_by(wm(), beside, &folders, |program| {
            Err(wm_program::command_line::Error::InvalidDescription {
                program: program.to_owned(),
                reason: "exit status: 2".to_owned(),
            })
        });
        assert!(left_out.left_out[0].contains("does not describe"));
        assert!(at(&left_out.command, &["eval", "all"]).is_none());
    }

    /// other commands would never be added
    #[test]
    fn every_described_command_exists_in_wm() {
        for command in DESCRIBED_COMMANDS {
            assert!(at(&crate::cli::definition(), command.words).is_some());
        }
    }
}
