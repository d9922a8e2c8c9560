use std::{
    collections::BTreeMap,
    fmt,
    path::{Path, PathBuf},
};

use wm_bag::{BagError, BagReader, ORIGIN};

/// The result of an import.
#[derive(Debug, Default)]
pub struct ImportReport {
    /// The bags, in order; those of an earlier run too.
    pub bags: Vec<PathBuf>,
    /// How many of them an earlier run had made.
    pub kept: usize,
    /// Reasons of skipped episodes, with file and episode.
    pub skipped: Vec<String>,
    /// Measured ranges of the actions in words, or a derived action space as a table; `None` without actions.
    pub ranges: Option<String>,
    /// Remarks on the data.
    pub notes: Notes,
}

impl ImportReport {
    /// Records a skipped episode.
    pub fn skip(&mut self, reason: &dyn fmt::Display) {
        let reason = reason.to_string();
        tracing::debug!(reason, "skipping an episode");
        self.skipped.push(reason);
    }
}

/// Remarks on the data, with the number of episodes of each.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Notes {
    by_text: BTreeMap<String, usize>,
    whole: Vec<String>,
}

impl Notes {
    /// Adds a remark on an episode; equal ones are counted.
    pub fn of_episode(&mut self, text: impl Into<String>) {
        *self.by_text.entry(text.into()).or_default() += 1;
    }

    /// Adds a remark on the whole data set.
    pub fn of_data(&mut self, text: impl Into<String>) {
        self.whole.push(text.into());
    }

    /// The remarks, in words.
    pub fn lines(&self) -> impl Iterator<Item = String> + '_ {
        let counted = self.by_text.iter().map(|(text, count)| match count {
            1 => format!("{text} (1 episode)"),
            count => format!("{text} ({count} episodes)"),
        });
        self.whole.iter().cloned().chain(counted)
    }
}

/// Makes the bag `bag` completely or not at all: `write` makes it at another path, from which it is moved.
///
/// # Errors
/// `bag` exists, `write` fails, or the file system fails; then no files remain.
pub(crate) fn write_whole<E: From<BagError>>(
    bag: &Path,
    write: impl FnOnce(&Path) -> Result<(), E>,
) -> Result<(), E> {
    let io = |path: &Path, reason| BagError::Io {
        path: path.to_owned(),
        reason,
    };
    // Callers pass the path of a new folder, which has a name.
    let name = bag.file_name().unwrap_or_default();
    let mut partial = name.to_owned();
    partial.push(format!(".partial-{}", std::process::id()));
    let partial = bag.with_file_name(partial);
    if is_taken(bag) {
        return Err(BagError::Exists(bag.to_owned()).into());
    }
    // A bag's files have its folder's name, so the inner folder has the final name.
    let inner = partial.join(name);
    let made = write(&inner)
        .and_then(|()| std::fs::rename(&inner, bag).map_err(|source| E::from(io(bag, source))));
    let removed = match std::fs::remove_dir_all(&partial) {
        Err(error) if error.kind() != std::io::ErrorKind::NotFound => Err(io(&partial, error)),
        _ => Ok(()),
    };
    made?;
    removed.map_err(E::from)
}

/// Whether an earlier run has made `bag` of the same episode.
///
/// # Errors
/// `bag` is of another origin, or is no whole bag.
pub(crate) fn is_made(bag: &Path, origin: &str) -> Result<bool, BagError> {
    if !is_taken(bag) {
        return Ok(false);
    }
    match BagReader::open(bag)?.note(ORIGIN) == Some(origin) {
        true => Ok(true),
        false => Err(BagError::Exists(bag.to_owned())),
    }
}

/// Whether there is something at `path` already, other than an empty folder.
fn is_taken(path: &Path) -> bool {
    match std::fs::read_dir(path) {
        Ok(mut entries) => entries.next().is_some(),
        Err(error) => error.kind() != std::io::ErrorKind::NotFound,
    }
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    #[test]
    fn failed_bag_is_removed_and_other_files_stay() {
        let scratch = tempfile::tempdir().unwrap();
        let bag = scratch.path().join("episode_000003");
        let failing = |path: &Path| {
            fs::create_dir_all(path).unwrap();
            fs::write(path.join("half.mcap"), "half").unwrap();
            Err(BagError::Exists(path.to_owned()))
        };
        assert!(write_whole(&bag, failing).is_err());
        assert_eq!(fs::read_dir(scratch.path()).unwrap().count(), 0);
        let whole = |path: &Path| {
            fs::create_dir_all(path).unwrap();
            fs::write(path.join("episode_000003_0.mcap"), "whole").unwrap();
            Ok::<(), BagError>(())
        };
        write_whole(&bag, whole).unwrap();
        let error = write_whole(&bag, whole).unwrap_err();
        assert!(matches!(error, BagError::Exists(path) if path == bag));
        let left: Vec<_> = fs::read_dir(scratch.path())
            .unwrap()
            .map(Result::unwrap)
            .collect();
        assert_eq!(left.len(), 1);
        assert_eq!(
            fs::read_to_string(bag.join("episode_000003_0.mcap")).unwrap(),
            "whole"
        );
    }

    #[test]
    fn equal_notes_are_counted() {
        let mut notes = Notes::default();
        notes.of_episode("camera_1 shows one colour");
        notes.of_data("whole");
        notes.of_episode("camera_1 shows one colour");
        let lines: Vec<String> = notes.lines().collect();
        assert_eq!(lines, ["whole", "camera_1 shows one colour (2 episodes)"]);
    }
}
