//! The mark of a model whose training has not taken its last step.

use std::fmt;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use crate::{Error, Result};

/// What follows a part's name in the name of its mark.
const ENDING: &str = ".unfinished.json";

/// How far the weights of a part are trained that lie in a model's folder. It is the file `PART.unfinished.json` beside
/// them: `{"step": 150, "steps": 4000}`. A part without one is finished.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Unfinished {
    /// The training that they are of: `autoencoder`, `transition`, ...
    pub part: String,
    /// Steps that they have taken.
    pub step: u64,
    /// Steps that they were to take.
    pub steps: u64,
}

/// The file.
#[derive(Serialize, Deserialize)]
struct Mark {
    step: u64,
    steps: u64,
}

impl Unfinished {
    /// Marks a part in `folder`. Write it before the weights: where a crash comes between, they are less trained than it
    /// says, but not taken for finished.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn write(&self, folder: &Path) -> Result<()> {
        let path = path(folder, &self.part);
        let (step, steps) = (self.step, self.steps);
        let text = serde_json::json!(Mark { step, steps });
        std::fs::write(&path, format!("{text}\n")).map_err(|error| Error::io(path, error))
    }

    /// Takes the mark of `part` away, if there is one: its weights are finished.
    ///
    /// # Errors
    /// If the file cannot be removed.
    pub fn remove(folder: &Path, part: &str) -> Result<()> {
        let path = path(folder, part);
        match std::fs::remove_file(&path) {
            Err(error) if error.kind() != ErrorKind::NotFound => Err(Error::io(path, error)),
            _ => Ok(()),
        }
    }

    /// The marks in `folder`, by name of their parts; none where there is no such folder.
    ///
    /// # Errors
    /// If a mark or the folder cannot be read.
    pub fn all(folder: &Path) -> Result<Vec<Self>> {
        let entries = match std::fs::read_dir(folder) {
            Err(error) if error.kind() == ErrorKind::NotFound => return Ok(Vec::new()),
            entries => entries.map_err(|error| Error::io(folder, error))?,
        };
        let mut found = Vec::new();
        for entry in entries {
            let entry = entry.map_err(|error| Error::io(folder, error))?;
            let name = entry.file_name().to_string_lossy().into_owned();
            let Some(part) = name.strip_suffix(ENDING) else {
                continue;
            };
            let path = entry.path();
            let text = std::fs::read_to_string(&path).map_err(|error| Error::io(&path, error))?;
            let Mark { step, steps } =
                serde_json::from_str(&text).map_err(|error| Error::ConfigFile {
                    file: path.display().to_string(),
                    reason: format!("expected {{\"step\": N, \"steps\": N}}: {error}"),
                })?;
            let part = part.to_owned();
            found.push(Self { part, step, steps });
        }
        found.sort_by(|a, b| a.part.cmp(&b.part));
        Ok(found)
    }
}

impl fmt::Display for Unfinished {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "unfinished: step {} of {}", self.step, self.steps)
    }
}

fn path(folder: &Path, part: &str) -> PathBuf {
    folder.join(format!("{part}{ENDING}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_mark_is_read_until_it_is_removed() {
        let folder = tempfile::tempdir().unwrap();
        let all = || Unfinished::all(folder.path());
        let mark = |part: &str, step| Unfinished {
            part: part.to_owned(),
            step,
            steps: 40,
        };
        assert_eq!(all().unwrap(), []);
        assert_eq!(Unfinished::all(&folder.path().join("none")).unwrap(), []);
        for mark in [mark("transition", 3), mark("idm", 4), mark("transition", 5)] {
            mark.write(folder.path()).unwrap();
        }
        std::fs::write(folder.path().join("transition.safetensors"), "").unwrap();
        assert_eq!(all().unwrap(), [mark("idm", 4), mark("transition", 5)]);
        for _ in 0..2 {
            Unfinished::remove(folder.path(), "idm").unwrap();
        }
        assert_eq!(all().unwrap(), [mark("transition", 5)]);
        assert_eq!(
            mark("transition", 5).to_string(),
            "unfinished: step 5 of 40"
        );

        std::fs::write(folder.path().join("probe.unfinished.json"), "{}").unwrap();
        let error = all().unwrap_err().to_string();
        assert!(error.contains("probe.unfinished.json: expected"), "{error}");
    }
}
