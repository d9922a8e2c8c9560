//! Where the rows of each episode are.

use std::{
    collections::{BTreeMap, BTreeSet, HashMap},
    ops::Range,
    path::{Path, PathBuf},
    rc::Rc,
};

use super::{Dataset, Entry, v30::tables};
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
    /// Whether it is another file than `meta` says.
    pub is_elsewhere: bool,
}

/// Finds rows by the column `episode_index`: `dataset_from_index` of `meta/episodes` is wrong in filtered and merged
/// datasets, and so is `data/file_index` in some.
#[derive(Default)]
pub(crate) struct Rows {
    known: HashMap<PathBuf, Rc<Places>>,
}

/// The rows of each episode in a file.
type Places = BTreeMap<i64, Vec<Range<u64>>>;

impl Rows {
    /// The rows of an episode.
    ///
    /// # Errors
    /// Its file cannot be read, no file has rows of it, or not as many as `meta` says in one piece.
    pub fn find(&mut self, dataset: &Dataset, entry: &Entry) -> Result<RowRange, LeRobotError> {
        let own = self.places(&entry.data);
        if let Ok(places) = &own
            && let Some(pieces) = places.get(&entry.index)
        {
            return whole(&entry.data, pieces, entry, false);
        }
        let mut files: BTreeSet<PathBuf> = dataset
            .episodes
            .iter()
            .map(|other| other.data.clone())
            .collect();
        // A folder that cannot be read has no more files; the episode's own file is named then.
        files.extend(tables(&dataset.root.join(DATA)).into_iter().flatten());
        files.remove(&entry.data);
        for file in files {
            // A file that cannot be read is named by its own episodes.
            let Ok(places) = self.places(&file) else {
                continue;
            };
            if let Some(pieces) = places.get(&entry.index) {
                return whole(&file, pieces, entry, true);
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

fn whole(
    file: &Path,
    pieces: &[Range<u64>],
    entry: &Entry,
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
