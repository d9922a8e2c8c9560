//! v2.x: a table and a video per episode, `meta/tasks.jsonl` and `meta/episodes.jsonl`.

use std::{collections::BTreeMap, fs, path::Path};

use serde::{Deserialize, de::DeserializeOwned};

use super::{Clip, EpisodeEntry, fill_path, video_path};
use crate::lerobot::{LeRobotError, info::Info};

const TASKS: &str = "meta/tasks.jsonl";
const EPISODES: &str = "meta/episodes.jsonl";

#[derive(Deserialize)]
struct Task {
    task_index: i64,
    task: String,
}

#[derive(Deserialize)]
struct Episode {
    episode_index: i64,
    length: u64,
}

pub(super) fn read(
    root: &Path,
    info: &Info,
) -> Result<(BTreeMap<i64, String>, Vec<EpisodeEntry>), LeRobotError> {
    let tasks = lines::<Task>(&root.join(TASKS))?;
    let mut episodes = Vec::new();
    for episode in lines::<Episode>(&root.join(EPISODES))? {
        let index = episode.episode_index;
        // Never saturates: JSON numbers of this file are i64.
        let chunk = index.div_euclid(i64::try_from(info.chunks_size).unwrap_or(i64::MAX));
        let numbers = [("episode_chunk", chunk), ("episode_index", index)];
        let mut videos = BTreeMap::new();
        for (key, _) in info
            .features
            .iter()
            .filter(|(_, feature)| feature.is_video())
        {
            let file = fill_path(
                root,
                video_path(root, info)?,
                &[("video_key", key)],
                &numbers,
            )?;
            videos.insert(key.clone(), Clip { file, from_s: 0.0 });
        }
        episodes.push(EpisodeEntry {
            index,
            length: episode.length,
            data: fill_path(root, &info.data_path, &[], &numbers)?,
            videos,
            start_ns: None,
        });
    }
    let tasks = tasks.into_iter().map(|task| (task.task_index, task.task));
    Ok((tasks.collect(), episodes))
}

/// Parses a JSON value per line.
fn lines<T: DeserializeOwned>(path: &Path) -> Result<Vec<T>, LeRobotError> {
    let text = fs::read_to_string(path).map_err(|source| LeRobotError::io(path, source))?;
    let lines = (1..)
        .zip(text.lines())
        .filter(|(_, line)| !line.trim().is_empty());
    lines
        .map(|(number, line)| {
            serde_json::from_str(line)
                .map_err(|error| LeRobotError::corrupt(path, format!("line {number}: {error}")))
        })
        .collect()
}
