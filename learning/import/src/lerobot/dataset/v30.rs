//! v3.x: tables and videos with many episodes; `meta/episodes/chunk-NNN/file-NNN.parquet` has the start of each, and
//! `meta/tasks.parquet` the tasks.

use std::{collections::BTreeMap, fs, path::Path, path::PathBuf};

use super::{Clip, EpisodeEntry, fill_path, video_path};
use crate::lerobot::{
    LeRobotError,
    info::{EPISODE_INDEX, Info, START_STAMP, TASK_INDEX},
    table::{Table, integer, number, text},
};

const TASKS: &str = "meta/tasks.parquet";
const EPISODES: &str = "meta/episodes";

pub(super) fn read(
    root: &Path,
    info: &Info,
) -> Result<(BTreeMap<i64, String>, Vec<EpisodeEntry>), LeRobotError> {
    let tasks = read_tasks(&root.join(TASKS))?;
    let videos: Vec<&String> = info
        .features
        .iter()
        .filter_map(|(key, feature)| feature.is_video().then_some(key))
        .collect();
    let mut episodes = Vec::new();
    for file in list_tables(&root.join(EPISODES))? {
        let table = Table::open(&file)?;
        let mut columns: Vec<String> = [
            EPISODE_INDEX,
            "length",
            "data/chunk_index",
            "data/file_index",
        ]
        .map(str::to_owned)
        .to_vec();
        for key in &videos {
            let parts = ["chunk_index", "file_index", "from_timestamp"];
            columns.extend(parts.map(|part| format!("videos/{key}/{part}")));
        }
        if table.has(START_STAMP) {
            columns.push(START_STAMP.to_owned());
        }
        let columns: Vec<&str> = columns.iter().map(String::as_str).collect();
        let mut rows = Vec::new();
        table.rows(&columns, 0..table.row_count(), |_, cells| {
            let whole = |column: &str| {
                let at = columns.iter().position(|name| *name == column);
                integer(column, at.and_then(|at| cells.get(at)))
            };
            let mut clips = Vec::new();
            for key in &videos {
                let column = format!("videos/{key}/from_timestamp");
                let at = columns.iter().position(|name| *name == column);
                clips.push((
                    (*key).clone(),
                    whole(&format!("videos/{key}/chunk_index"))?,
                    whole(&format!("videos/{key}/file_index"))?,
                    number(&column, at.and_then(|at| cells.get(at)))?,
                ));
            }
            rows.push(Row {
                index: whole(EPISODE_INDEX)?,
                length: natural("length", whole("length")?)?,
                data: (whole("data/chunk_index")?, whole("data/file_index")?),
                start_ns: whole(START_STAMP).ok().and_then(|ns| ns.try_into().ok()),
                clips,
            });
            Ok(())
        })?;
        episodes.extend(rows);
    }
    let entries = episodes.into_iter().map(|row| {
        let numbers = |(chunk, file)| [("chunk_index", chunk), ("file_index", file)];
        let mut videos = BTreeMap::new();
        for (key, chunk, file, from_s) in row.clips {
            let texts = [("video_key", &*key)];
            let file = fill_path(
                root,
                video_path(root, info)?,
                &texts,
                &numbers((chunk, file)),
            )?;
            videos.insert(key, Clip { file, from_s });
        }
        Ok(EpisodeEntry {
            index: row.index,
            length: row.length,
            data: fill_path(root, &info.data_path, &[], &numbers(row.data))?,
            videos,
            start_ns: row.start_ns,
        })
    });
    Ok((tasks, entries.collect::<Result<_, LeRobotError>>()?))
}

struct Row {
    index: i64,
    length: u64,
    /// Chunk and file.
    data: (i64, i64),
    start_ns: Option<u64>,
    /// Feature, chunk, file, and start in s.
    clips: Vec<(String, i64, i64, f64)>,
}

fn natural(name: &str, value: i64) -> Result<u64, String> {
    u64::try_from(value).map_err(|_| format!("{name}: expected at least 0, got {value}"))
}

/// Reads the tasks; their texts are the index of a pandas table, under any name.
fn read_tasks(path: &Path) -> Result<BTreeMap<i64, String>, LeRobotError> {
    let table = Table::open(path)?;
    let texts = table.text_column().ok_or_else(|| {
        LeRobotError::corrupt(path, "expected a text column with the tasks, got none")
    })?;
    let mut tasks = BTreeMap::new();
    table.rows(&[TASK_INDEX, texts], 0..table.row_count(), |_, cells| {
        let number = integer(TASK_INDEX, cells.first())?;
        tasks.insert(number, text(texts, cells.get(1))?);
        Ok(())
    })?;
    Ok(tasks)
}

/// The tables `chunk-NNN/file-NNN.parquet` of a folder, sorted.
pub(super) fn list_tables(dir: &Path) -> Result<Vec<PathBuf>, LeRobotError> {
    let entries = |dir: &Path| -> Result<Vec<PathBuf>, LeRobotError> {
        let mut found = Vec::new();
        for entry in fs::read_dir(dir).map_err(|source| LeRobotError::io(dir, source))? {
            found.push(
                entry
                    .map_err(|source| LeRobotError::io(dir, source))?
                    .path(),
            );
        }
        found.sort();
        Ok(found)
    };
    let mut tables = Vec::new();
    for chunk in entries(dir)?.into_iter().filter(|path| path.is_dir()) {
        tables.extend(entries(&chunk)?);
    }
    tables.retain(|path| {
        path.extension()
            .is_some_and(|extension| extension == "parquet")
    });
    if tables.is_empty() {
        return Err(LeRobotError::corrupt(
            dir,
            "expected chunk-NNN/file-NNN.parquet, got none",
        ));
    }
    Ok(tables)
}
