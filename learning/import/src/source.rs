use std::{
    fs,
    path::{Path, PathBuf},
};

use crate::ImportError;

/// The files to import, sorted by name.
#[derive(Debug, PartialEq, Eq)]
pub(crate) enum Source {
    /// Pairs of video and actions; one of a pair may be missing.
    Mp4Npz(Vec<(PathBuf, PathBuf)>),
    /// TFRecord files.
    Rlds(Vec<PathBuf>),
}

impl Source {
    /// Finds the files of a path, without subfolders.
    pub fn find(src: &Path) -> Result<Self, ImportError> {
        let found = fs::metadata(src).map_err(|source| ImportError::io(src, source))?;
        let mut files = Vec::new();
        if found.is_dir() {
            for entry in fs::read_dir(src).map_err(|source| ImportError::io(src, source))? {
                files.push(entry.map_err(|source| ImportError::io(src, source))?.path());
            }
            files.sort();
        } else {
            files.push(src.to_owned());
        }
        let shards: Vec<PathBuf> = files
            .iter()
            .filter(|file| is_tfrecord(file))
            .cloned()
            .collect();
        if !shards.is_empty() {
            return Ok(Self::Rlds(shards));
        }
        let mut videos: Vec<PathBuf> = files
            .iter()
            .filter(|file| has_extension(file, "mp4") || has_extension(file, "npz"))
            .map(|file| file.with_extension("mp4"))
            .collect();
        videos.dedup();
        if videos.is_empty() {
            return Err(ImportError::UnknownLayout {
                path: src.to_owned(),
                expected: "Bridge episodes: NAME.mp4 with NAME.npz, or *.tfrecord* files",
            });
        }
        let pairs = videos.into_iter().map(|video| {
            let arrays = video.with_extension("npz");
            (video, arrays)
        });
        Ok(Self::Mp4Npz(pairs.collect()))
    }
}

fn has_extension(file: &Path, extension: &str) -> bool {
    file.extension()
        .is_some_and(|found| found.eq_ignore_ascii_case(extension))
}

/// Whether the name is `NAME.tfrecord`, or `NAME-SPLIT.tfrecord-00000-of-00001` (TensorFlow Datasets).
fn is_tfrecord(file: &Path) -> bool {
    file.file_name()
        .and_then(|name| name.to_str())
        .is_some_and(|name| name.ends_with(".tfrecord") || name.contains(".tfrecord-"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn layouts_are_distinguished() {
        let dir = tempfile::tempdir().unwrap();
        let at = |name: &str| dir.path().join(name);
        assert!(matches!(
            Source::find(dir.path()),
            Err(ImportError::UnknownLayout { .. })
        ));
        assert!(matches!(
            Source::find(&at("absent")),
            Err(ImportError::Io { .. })
        ));
        fs::write(at("b.mp4"), "").unwrap();
        let alone = vec![(at("b.mp4"), at("b.npz"))];
        assert_eq!(Source::find(dir.path()).unwrap(), Source::Mp4Npz(alone));
        for name in ["b.npz", "a.mp4", "a.npz", "notes.txt"] {
            fs::write(at(name), "").unwrap();
        }
        let pairs = vec![(at("a.mp4"), at("a.npz")), (at("b.mp4"), at("b.npz"))];
        assert_eq!(
            Source::find(dir.path()).unwrap(),
            Source::Mp4Npz(pairs.clone())
        );
        assert_eq!(
            Source::find(&at("b.npz")).unwrap(),
            Source::Mp4Npz(pairs[1..].to_vec())
        );
        let shard = at("bridge_dataset-train.tfrecord-00000-of-00001");
        fs::write(&shard, "").unwrap();
        assert_eq!(Source::find(dir.path()).unwrap(), Source::Rlds(vec![shard]));
    }
}
