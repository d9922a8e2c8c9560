use std::path::{Path, PathBuf};

use crate::lerobot::{LeRobotError, info::chunks_size, path_template::fill};

pub(super) const DATA: &str = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet";
pub(super) const VIDEO: &str =
    "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4";

/// Chunk and number of a file.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Place {
    pub chunk: u64,
    pub file: u64,
}

impl Place {
    /// The next file: LeRobot's `update_chunk_file_indices`.
    pub fn next(self) -> Self {
        if self.file + 1 == chunks_size() {
            Self {
                chunk: self.chunk + 1,
                file: 0,
            }
        } else {
            Self {
                file: self.file + 1,
                ..self
            }
        }
    }

    pub fn path(self, root: &Path, template: &str, key: &str) -> Result<PathBuf, LeRobotError> {
        let whole = |number: u64| i64::try_from(number).unwrap_or(i64::MAX);
        let numbers = [
            ("chunk_index", whole(self.chunk)),
            ("file_index", whole(self.file)),
        ];
        let filled = fill(template, &[("video_key", key)], &numbers);
        filled
            .map(|path| root.join(path))
            .map_err(|reason| LeRobotError::corrupt(root, reason))
    }
}
