//! Launch files that a package installed with the program: in `share/wm/launch`, beside the `bin` of the program.

use std::path::{Path, PathBuf};

/// The installed launch file of this name, if the working directory has none and `given` names no folder.
pub(crate) fn launch_file(given: &Path) -> PathBuf {
    let program = std::env::current_exe().unwrap_or_default();
    beside(&program, given).unwrap_or_else(|| given.to_owned())
}

/// `None`: it is not installed, or not meant.
fn beside(program: &Path, given: &Path) -> Option<PathBuf> {
    let names_a_folder = given.components().count() > 1;
    if names_a_folder || given.exists() {
        return None;
    }
    let installed = program.parent()?.parent()?.join("share/wm/launch");
    let file = installed.join(given);
    file.is_file().then_some(file)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn installed_file_is_found_by_its_name_alone() {
        let root = tempfile::tempdir().unwrap();
        let (program, launch) = (
            root.path().join("bin/wm"),
            root.path().join("share/wm/launch"),
        );
        std::fs::create_dir_all(&launch).unwrap();
        let file = launch.join("replay.launch.yaml");
        std::fs::write(&file, "launch:\n").unwrap();
        let found = |given: &str| beside(&program, Path::new(given));
        assert_eq!(found("replay.launch.yaml"), Some(file));
        assert_eq!(found("live.launch.yaml"), None);
        assert_eq!(found("./launch/replay.launch.yaml"), None);
        assert_eq!(found("Cargo.toml"), None, "the working directory has it");
    }
}
