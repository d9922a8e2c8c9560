use std::path::{Path, PathBuf};

use wm_audit::Audit;

use crate::{
    Data, DataOptions, DatasetError, Episode, Manifest,
    store::{read_audit, read_manifest},
};

/// The result of preparing bags with some options.
pub(super) struct Outcome {
    pub data: Data,
    pub manifest: Manifest,
    pub audit: Audit,
}

impl Outcome {
    /// Opens `bags` at 16x16 without validation, with a new cache.
    pub fn of(bags: &Path, options: DataOptions) -> Result<Self, DatasetError> {
        let cache = tempfile::tempdir().unwrap();
        let options = DataOptions {
            validation: options.validation.or(Some(0.0)),
            ..options
        };
        let paths = [bags.to_owned()];
        let data = Data::open(&paths, (16, 16), cache.path(), &options)?;
        let entries = std::fs::read_dir(cache.path()).unwrap();
        let made: Vec<PathBuf> = entries.map(|entry| entry.unwrap().path()).collect();
        let manifest = read_manifest(&made[0])?;
        let audit = read_audit(&made[0])?.expect("every prepared folder has an audit");
        Ok(Self {
            data,
            manifest,
            audit,
        })
    }

    pub fn episodes(&self) -> &[Episode] {
        self.data.training.episodes()
    }

    pub fn lengths(&self) -> Vec<usize> {
        self.episodes().iter().map(|e| e.frame_count).collect()
    }

    /// The excluded data, one per line.
    pub fn left_out(&self) -> String {
        let left = self.manifest.left_out.iter();
        left.map(|left| format!("{left}\n")).collect()
    }

    /// The red of each frame, which is its number in the recording.
    pub fn reds(&self) -> Vec<u8> {
        let training = &self.data.training;
        (0..training.frame_count())
            .map(|frame| training.frame(frame).unwrap()[0])
            .collect()
    }
}
