//! `wm eval merge`.

use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result, ensure};
use clap::Args;
use wm_metrics::findings::ModelFindings;

use crate::{OutputArgs, policy::with_borda, records, run};

/// Folder of the records within a report's folder.
pub(crate) const RECORDS: &str = "records";

/// Merge the records of shards, of one or several models
#[derive(Clone, Debug, Args)]
pub struct MergeArgs {
    /// Records written by `wm eval SUITE --records DIR`, or folders of them
    #[arg(required = true, value_name = "PATH")]
    pub paths: Vec<PathBuf>,
    /// Outputs.
    #[command(flatten)]
    pub output: OutputArgs,
}

impl MergeArgs {
    /// Writes the findings of the records.
    ///
    /// # Errors
    /// If records are missing or of different evaluations, or files cannot be written.
    pub fn run(&self) -> Result<()> {
        self.output.require_free()?;
        let mut files = Vec::new();
        for path in &self.paths {
            if !path.is_dir() {
                files.push(path.clone());
                continue;
            }
            let mut found = in_folder(path)?;
            // A report has its records in a subfolder.
            let inner = path.join(RECORDS);
            if found.is_empty() && inner.is_dir() {
                found = in_folder(&inner)?;
            }
            ensure!(
                !found.is_empty(),
                "{}: no records (files that end in .jsonl)",
                path.display()
            );
            files.extend(found);
        }
        self.output.write(&of_files(&files)?)
    }
}

/// The record files of a folder, by name.
fn in_folder(folder: &Path) -> Result<Vec<PathBuf>> {
    let name = || folder.display().to_string();
    let mut found = Vec::new();
    for entry in folder.read_dir().with_context(name)? {
        let path = entry.with_context(name)?.path();
        if path.extension().is_some_and(|end| end == "jsonl") {
            found.push(path);
        }
    }
    found.sort();
    Ok(found)
}

/// Findings of record files, by model in the order of its command line, then by name.
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
    // Two runs of one model: the one with its own sampler has the shorter name, and comes first.
    models.sort_by_key(|files| {
        let first = files.first().map(|(_, heading, _)| heading);
        first.map(|heading| (heading.position, heading.header.model.clone()))
    });
    let findings = models.into_iter().map(|files| {
        let (heading, found) = records::merge(files)?;
        run::findings(heading, found)
    });
    Ok(with_borda(findings.collect::<Result<_>>()?))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Protocol, Settings, records::Heading};

    /// A heading of model `name` at this position of the command line.
    fn heading(name: &str, position: usize) -> Heading {
        let mut header =
            wm_metrics::findings::Header::of(name, &format!("hash of {name}"), "space");
        header.settings = serde_json::to_value(Settings::of(Protocol::Quick, 0)).unwrap();
        Heading {
            position,
            absent: [(wm_metrics::findings::Suite::Control, "too short".to_owned())].into(),
            header,
            units: std::collections::BTreeMap::new(),
        }
    }

    #[test]
    fn models_keep_the_order_of_the_command_line() {
        let dir = tempfile::tempdir().unwrap();
        for (name, position) in [("a", 1), ("b", 0)] {
            let path = dir.path().join(format!("{name}.jsonl"));
            records::Records::open(&path, &heading(name, position)).unwrap();
        }
        let found = of_files(&in_folder(dir.path()).unwrap()).unwrap();
        let names: Vec<&str> = found.iter().map(|own| &*own.header.model).collect();
        assert_eq!(names, ["b", "a"]);
        // Unmeasured suites are reported.
        let (_, why) = found[0].absent().into_iter().next().unwrap();
        assert_eq!(why, "too short");
    }

    #[test]
    fn folder_without_records_is_rejected_by_name() {
        let dir = tempfile::tempdir().unwrap();
        let merge = MergeArgs {
            paths: vec![dir.path().to_owned()],
            output: OutputArgs::default(),
        };
        let error = merge.run().unwrap_err().to_string();
        assert!(error.contains("no records"), "{error}");
    }
}
