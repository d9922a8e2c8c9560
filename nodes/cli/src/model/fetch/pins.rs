//! The revision and the hashes of a model's files in a folder: `fetched.json`.
//!
//! The first download writes it. Later ones of the same folder request that revision and accept only these hashes. On
//! another machine, a copy makes `wm model fetch` return the same files or fail.

use anyhow::{Context as _, Result};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io::{ErrorKind, Write as _};
use std::path::{Path, PathBuf};

const FILE: &str = "fetched.json";

/// The revision and files of a downloaded model.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Pin {
    /// Commit of the Hugging Face repository; `None` for other servers.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub revision: Option<String>,
    /// Hexadecimal SHA-256 of each file, by its name in the folder.
    pub sha256: BTreeMap<String, String>,
}

/// The pins of a folder, by the name of the model.
#[derive(Debug)]
pub(super) struct Pins {
    path: PathBuf,
    models: BTreeMap<String, Pin>,
}

impl Pins {
    /// The pins of `folder`; none before the first download.
    pub(super) fn read(folder: &Path) -> Result<Self> {
        let path = folder.join(FILE);
        let models = match fs::read_to_string(&path) {
            Ok(text) => serde_json::from_str(&text).with_context(|| path.display().to_string())?,
            Err(error) if error.kind() == ErrorKind::NotFound => BTreeMap::new(),
            Err(error) => return Err(error).with_context(|| path.display().to_string()),
        };
        Ok(Self { path, models })
    }

    pub(super) fn of(&self, model: &str) -> Option<&Pin> {
        self.models.get(model)
    }

    /// Adds the pin of a model, and replaces the file atomically.
    pub(super) fn write(&mut self, model: &str, pin: &Pin) -> Result<()> {
        self.models.insert(model.to_owned(), pin.clone());
        let text = serde_json::to_string_pretty(&self.models)? + "\n";
        let partial = self.path.with_extension("json.part");
        File::create(&partial)
            .and_then(|mut file| {
                file.write_all(text.as_bytes())?;
                file.sync_all()
            })
            .and_then(|()| fs::rename(&partial, &self.path))
            .with_context(|| self.path.display().to_string())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pins_of_several_models_are_kept() {
        let folder = tempfile::tempdir().unwrap();
        let mut pins = Pins::read(folder.path()).unwrap();
        assert_eq!(pins.of("web-dino"), None);
        let pin = |commit: &str| Pin {
            revision: Some(commit.to_owned()),
            sha256: [("model.safetensors".to_owned(), "ab".repeat(32))].into(),
        };
        pins.write("web-dino", &pin("c0ffee")).unwrap();
        Pins::read(folder.path())
            .unwrap()
            .write("siglip2", &pin("beef"))
            .unwrap();
        let pins = Pins::read(folder.path()).unwrap();
        assert_eq!(pins.of("web-dino"), Some(&pin("c0ffee")));
        assert_eq!(pins.of("siglip2"), Some(&pin("beef")));

        fs::write(folder.path().join(FILE), "{").unwrap();
        let error = Pins::read(folder.path()).unwrap_err().to_string();
        assert!(error.contains(FILE), "{error}");
    }
}
