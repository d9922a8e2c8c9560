//! Locates the rows of episodes.

use std::{
    collections::{BTreeMap, BTreeSet, HashMap},
    ops::Range,
    path::{Path, PathBuf},
    rc::Rc,
};

use super::{Dataset, EpisodeEntry, v30::list_tables};
use crate::lerobot::{
    LeRobotError,
    info::EPISODE_INDEX,
    table::{Table, integer},
};

/// The folder of the tables.
const DATA: &str = "data";

/// The rows of an episode.
#[derive(Debug)]
pub(crate) struct RowRange {
    pub file: PathBuf,
    pub rows: Range<u64>,
    /// Whether the file differs from the one in `meta`.
    pub is_elsewhere: bool,
}

/// Finds rows by the column `episode_index`, since `dataset_from_index` of `meta/episodes` is wrong in filtered and merged
/// data sets, and `data/file_index` in some.
#[derive(Default)]
pub(crate) struct Rows {
    known: HashMap<PathBuf, Rc<Places>>,
}

/// The rows of each episode in a file.
type Places = BTreeMap<i64, Vec<Range<u64>>>;

impl Rows {
    /// Finds the rows of an episode.
    ///
    /// # Errors
    /// Its file cannot be read, no file has rows of it, or they are not contiguous or not as many as in `meta`.
    pub fn find(
        &mut self,
        dataset: &Dataset,
        entry: &EpisodeEntry,
    ) -> Result<RowRange, LeRobotError> {
        let own = self.places(&entry.data);
        if let Ok(places) = &own
            && let Some(pieces) = places.get(&entry.index)
        {
            return check_whole(&entry.data, pieces, entry, false);
        }
        let mut files: BTreeSet<PathBuf> = dataset
            .episodes
            .iter()
            .map(|other| other.data.clone())
            .collect();
        // An unreadable folder has no more files; the error then names the episode's own file.
        files.extend(list_tables(&dataset.root.join(DATA)).into_iter().flatten());
        files.remove(&entry.data);
        for file in files {
            // Its own episodes name an unreadable file.
            let Ok(places) = self.places(&file) else {
                continue;
            };
            if let Some(pieces) = places.get(&entry.index) {
                return check_whole(&file, pieces, entry, true);
            }
        }
        own?;
        Err(LeRobotError::corrupt(
            &entry.data,
            format!(
                "expected {} rows of episode {}, got none, nor in the other data files",
                entry.length, entry.index
            ),
        ))
    }

    fn places(&mut self, file: &Path) -> Result<Rc<Places>, LeRobotError> {
        if let Some(known) = self.known.get(file) {
            return Ok(Rc::clone(known));
        }
        let table = Table::open(file)?;
        let mut places = Places::new();
        table.rows(&[EPISODE_INDEX], 0..table.row_count(), |row, cells| {
            let pieces = places
                .entry(integer(EPISODE_INDEX, cells.first())?)
                .or_default();
            match pieces.last_mut() {
                Some(last) if last.end == row => last.end += 1,
                _ => pieces.push(row..row + 1),
            }
            Ok(())
        })?;
        let places = Rc::new(places);
        self.known.insert(file.to_owned(), Rc::clone(&places));
        Ok(places)
    }
}

fn check_whole(
    file: &Path,
    pieces: &[Range<u64>],
    entry: &EpisodeEntry,
    is_elsewhere: bool,
) -> Result<RowRange, LeRobotError> {
    match pieces {
        [rows] if rows.end - rows.start == entry.length => Ok(RowRange {
            file: file.to_owned(),
            rows: rows.clone(),
            is_elsewhere,
        }),
        pieces => {
            let found: u64 = pieces.iter().map(|rows| rows.end - rows.start).sum();
            Err(LeRobotError::corrupt(
                file,
                format!(
                    "expected {} rows of episode {} in one piece, got {found} in {}",
                    entry.length,
                    entry.index,
                    pieces.len()
                ),
            ))
        }
    }
}
