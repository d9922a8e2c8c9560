//! `wm man`.

use crate::{
    external::{self, Described},
    output::print,
};
use anyhow::{Context as _, Result};
use clap::Args;
use std::path::PathBuf;

/// Writes the man pages.
#[derive(Args, Debug)]
#[command(after_help = "To read them: wm man ~/.local/share/man/man1, then man wm-encoder")]
pub(crate) struct ManCommand {
    /// Folder for the pages, wm.1 and one for each command; made if it does not exist
    folder: PathBuf,
}

impl ManCommand {
    /// Replaces pages of an older version.
    pub(crate) fn run(self, wm: clap::Command) -> Result<()> {
        let Described { command, left_out } = external::described(wm)?;
        for left in left_out {
            eprintln!("wm: without the pages of its commands: {left}; run this again then");
        }
        let failed = || format!("cannot write man pages into {}", self.folder.display());
        std::fs::create_dir_all(&self.folder).with_context(failed)?;
        clap_mangen::generate_to(command, &self.folder).with_context(failed)?;
        let pages = std::fs::read_dir(&self.folder)
            .with_context(failed)?
            .count();
        print(format_args!("{pages} pages in {}\n", self.folder.display()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_command_has_a_page() {
        let folder = tempfile::tempdir().unwrap();
        let pages = folder.path().join("man1");
        ManCommand {
            folder: pages.clone(),
        }
        .run(crate::cli::definition())
        .unwrap();
        let page = |name: &str| std::fs::read_to_string(pages.join(name)).unwrap_or_default();
        assert!(page("wm.1").contains("wm\\-doctor(1)"));
        assert!(page("wm-doctor.1").contains("\\-\\-json"));
        assert!(page("wm-bag-play.1").contains("\\-\\-loop"));
        for node in crate::node::definitions() {
            assert!(
                !page(&format!("wm-{}.1", node.name)).is_empty(),
                "{}",
                node.name
            );
        }
    }
}
