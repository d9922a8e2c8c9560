//! Commands that are separate programs, because what they link would make the build of `wm` long: `wm bridge` runs the
//! program `wm-bridge`, as git and cargo do.

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

/// Becomes the program, which is looked for beside this one and then on the PATH.
fn exec(program: &str, args: impl IntoIterator<Item = OsString>) -> Result<ExitCode> {
    let beside = std::env::current_exe()?;
    let path = std::env::var_os("PATH").unwrap_or_default();
    let folders = beside.parent().map(Path::to_path_buf).into_iter();
    let Some(found) = find(program, folders.chain(std::env::split_paths(&path))) else {
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

fn find(program: &str, folders: impl IntoIterator<Item = PathBuf>) -> Option<PathBuf> {
    let mut files = folders.into_iter().map(|folder| folder.join(program));
    files.find(|file| file.is_file())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_folder_that_has_it_holds() {
        let folders: Vec<_> = (0..3).map(|_| tempfile::tempdir().unwrap()).collect();
        let paths = || folders.iter().map(|folder| folder.path().to_path_buf());
        assert_eq!(find("wm-x", paths()), None);
        for folder in &folders[1..] {
            std::fs::write(folder.path().join("wm-x"), "").unwrap();
        }
        assert_eq!(find("wm-x", paths()), Some(folders[1].path().join("wm-x")));
    }

    #[test]
    fn a_program_beside_an_installed_one_is_installed() {
        let way = |program| way_to(program, Path::new("/home/me/.cargo/bin/wm"));
        assert_eq!(way("wm-datasets"), "cargo install --path bags/datasets");
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
}
