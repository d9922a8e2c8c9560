use std::{
    collections::BTreeMap,
    fmt,
    path::{Path, PathBuf},
};

/// What an import made, and what it could not.
#[derive(Debug, Default)]
pub struct Imported {
    /// The bags, in order.
    pub bags: Vec<PathBuf>,
    /// Why episodes were left out: each text names the file and the episode.
    pub skipped: Vec<String>,
    /// The measured ranges of the actions, in words; none without actions.
    pub ranges: Option<String>,
    /// Peculiarities of the data.
    pub notes: Notes,
}

impl Imported {
    /// Takes note of an episode that is left out.
    pub fn skip(&mut self, reason: &dyn fmt::Display) {
        let reason = reason.to_string();
        tracing::debug!(reason, "episode left out");
        self.skipped.push(reason);
    }
}

/// Remarks on the data, each with the number of episodes that it is about.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Notes {
    by_text: BTreeMap<String, usize>,
    whole: Vec<String>,
}

impl Notes {
    /// A remark on an episode: equal ones are counted.
    pub fn of_episode(&mut self, text: impl Into<String>) {
        *self.by_text.entry(text.into()).or_default() += 1;
    }

    /// A remark on the whole data set.
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

/// Makes the bag `bag` whole or not at all: `write` makes it at another path, from which it is moved.
///
/// # Errors
/// Something already exists at `bag`, `write` fails, or the file system does; then nothing is left.
pub fn write_whole<E: From<wm_bag::BagError>>(
    bag: &Path,
    write: impl FnOnce(&Path) -> Result<(), E>,
) -> Result<(), E> {
    let io = |path: &Path, reason| wm_bag::BagError::Io {
        path: path.to_owned(),
        reason,
    };
    let name = bag.file_name().unwrap_or_default();
    let mut partial = name.to_owned();
    partial.push(format!(".partial-{}", std::process::id()));
    let partial = bag.with_file_name(partial);
    let is_taken = match std::fs::read_dir(bag) {
        Ok(mut entries) => entries.next().is_some(),
        Err(error) => error.kind() != std::io::ErrorKind::NotFound,
    };
    if is_taken {
        return Err(wm_bag::BagError::Exists(bag.to_owned()).into());
    }
    // A bag's files are named after its folder, so that the folder within has the final name.
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

#[cfg(test)]
mod tests {
    use std::fs;

    use wm_bag::BagError;

    use super::*;

    #[test]
    fn failed_bag_leaves_nothing_and_other_files_stay() {
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
