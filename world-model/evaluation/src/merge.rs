//! `wm eval merge`.

use std::path::PathBuf;

use anyhow::{Context as _, Result};
use clap::Args;
use wm_findings::ModelFindings;

use crate::{OutputArgs, policy::with_borda, records, run};

/// Puts the records of shards together, of one model or of several to be compared.
#[derive(Clone, Debug, Args)]
pub struct MergeArgs {
    /// Records that `wm eval SUITE --records DIR` wrote, or folders of them.
    #[arg(required = true, value_name = "PATH")]
    pub paths: Vec<PathBuf>,
    /// Where the findings go.
    #[command(flatten)]
    pub output: OutputArgs,
}

impl MergeArgs {
    /// Writes what the records say.
    ///
    /// # Errors
    /// If records are missing, are of different evaluations, or files cannot be written.
    pub fn run(&self) -> Result<()> {
        self.output.require_free()?;
        let mut files = Vec::new();
        for path in &self.paths {
            if !path.is_dir() {
                files.push(path.clone());
                continue;
            }
            let entries = path
                .read_dir()
                .with_context(|| path.display().to_string())?;
            let mut found = Vec::new();
            for entry in entries {
                let path = entry.with_context(|| path.display().to_string())?.path();
                if path.extension().is_some_and(|end| end == "jsonl") {
                    found.push(path);
                }
            }
            found.sort();
            files.extend(found);
        }
        self.output.write(&of_files(&files)?)
    }
}

/// The findings of files of records, model by model in the order in which they come.
pub(crate) fn of_files(paths: &[PathBuf]) -> Result<Vec<ModelFindings>> {
    let mut models: Vec<Vec<(PathBuf, records::Heading, Vec<records::Record>)>> = Vec::new();
    for path in paths {
        let (heading, found) = records::read(path)?;
        let of_model = models.iter_mut().find(|model| {
            let first = model.first().map(|(_, first, _)| &first.header);
            let own = &heading.header;
            first.is_some_and(|first| first.hash == own.hash && first.sampler == own.sampler)
        });
        let file = (path.clone(), heading, found);
        match of_model {
            Some(model) => model.push(file),
            None => models.push(vec![file]),
        }
    }
    let findings = models.into_iter().map(|files| {
        let (heading, found) = records::merge(files)?;
        run::findings(heading, found)
    });
    Ok(with_borda(findings.collect::<Result<_>>()?))
}
