//! Writer of a data set.

use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
};

use image::RgbImage;
use serde_json::{Value, json};
use wm_bag::{BagMessage, BagReader};
use wm_camera::camera_frame::CameraFrame;

use super::{
    ExportOptions, ExportReport,
    episode::Episode,
    meta::{double, int, write_json, write_tasks},
    place::{DATA, Place, VIDEO},
    recording::Recording,
    video::VideoWriter,
};
use crate::lerobot::{
    LeRobotError,
    info::{
        ACTION, EPISODE_INDEX, FRAME_INDEX, Feature, INDEX, INFO, Info, START_STAMP, STATE,
        SUCCESS, TASK_INDEX, TIMESTAMP, chunks_size,
    },
    stats::{Histogram, Stats},
    table::{Column, TableWriter},
};

const EPISODES: &str = "meta/episodes/chunk-000/file-000.parquet";

struct Camera {
    feature: String,
    size: (u32, u32),
    place: Place,
    video: VideoWriter,
}

pub(super) struct DatasetWriter {
    root: PathBuf,
    info: Info,
    fps: u32,
    options: ExportOptions,
    cameras: Vec<Camera>,
    data_place: Place,
    data: Option<TableWriter>,
    tasks: Vec<String>,
    episodes: Vec<Vec<(String, Column)>>,
    stats: Vec<BTreeMap<String, Stats>>,
}

impl DatasetWriter {
    /// Creates a data set with the features of a first episode.
    pub fn create(
        root: &Path,
        fps: u32,
        recording: &Recording,
        episode: &Episode,
        options: &ExportOptions,
    ) -> Result<Self, LeRobotError> {
        let mut features: BTreeMap<String, Feature> = BTreeMap::new();
        let names = &recording.action_names;
        features.insert(
            ACTION.to_owned(),
            Feature::column("float32", names.len(), Some(names)),
        );
        if !recording.state_names.is_empty() {
            let names = &recording.state_names;
            let state = Feature::column("float32", names.len(), Some(names));
            features.insert(STATE.to_owned(), state);
        }
        if episode.success.is_some() {
            features.insert(SUCCESS.to_owned(), Feature::column("bool", 1, None));
        }
        features.insert(TIMESTAMP.to_owned(), Feature::column("float32", 1, None));
        for name in [FRAME_INDEX, EPISODE_INDEX, INDEX, TASK_INDEX] {
            features.insert(name.to_owned(), Feature::column("int64", 1, None));
        }
        let mut cameras = Vec::new();
        for (camera, (width, height)) in recording.cameras.iter().zip(picture_sizes(recording)?) {
            let key = Recording::feature(&camera.topic);
            let video = json!({
                "video.height": height, "video.width": width, "video.codec": "h264",
                "video.pix_fmt": "yuv420p", "video.is_depth_map": false, "video.fps": fps,
                "video.channels": 3, "has_audio": false,
            });
            let feature = Feature {
                dtype: "video".to_owned(),
                shape: vec![u64::from(height), u64::from(width), 3],
                names: json!(["height", "width", "channels"]),
                info: Some(video),
            };
            if features.insert(key.clone(), feature).is_some() {
                return Err(LeRobotError::unsuited(
                    &recording.bag,
                    format!("{}: another camera already has the key {key}", camera.topic),
                ));
            }
            let place = Place::default();
            cameras.push(Camera {
                video: VideoWriter::create(&place.path(root, VIDEO, &key)?, fps, (width, height))?,
                feature: key,
                size: (width, height),
                place,
            });
        }
        let info = Info {
            codebase_version: "v3.0".to_owned(),
            robot_type: options.robot_type.clone(),
            total_episodes: 0,
            total_frames: 0,
            total_tasks: 0,
            chunks_size: chunks_size(),
            data_files_size_in_mb: (options.data_file_bytes >> 20).max(1),
            video_files_size_in_mb: (options.video_file_bytes >> 20).max(1),
            fps: f64::from(fps),
            splits: BTreeMap::new(),
            data_path: DATA.to_owned(),
            video_path: Some(VIDEO.to_owned()),
            features,
        };
        Ok(Self {
            root: root.to_owned(),
            info,
            fps,
            options: options.clone(),
            cameras,
            data_place: Place::default(),
            data: None,
            tasks: Vec::new(),
            episodes: Vec::new(),
            stats: Vec::new(),
        })
    }

    pub const fn fps(&self) -> u32 {
        self.fps
    }

    /// Adds an episode, which must have the features of the first.
    pub fn write(&mut self, recording: &Recording, episode: &Episode) -> Result<(), LeRobotError> {
        self.check(recording, episode)?;
        let frames = episode.frames() as u64;
        let (number, first) = (self.info.total_episodes, self.info.total_frames);
        let mut stats = BTreeMap::new();
        let mut row = vec![
            int("episode_index", number),
            (
                "tasks".to_owned(),
                Column::TextLists(vec![deduplicate(&episode.tasks)]),
            ),
            int("length", frames),
        ];
        let columns = self.make_columns(recording, episode, &mut stats);
        let place = self.write_data(&columns)?;
        row.extend([
            int("data/chunk_index", place.chunk),
            int("data/file_index", place.file),
            int("dataset_from_index", first),
            int("dataset_to_index", first + frames),
        ]);
        for at in 0..self.cameras.len() {
            let (from, histogram) = self.write_video(recording, episode, at)?;
            if let Some(camera) = self.cameras.get(at) {
                let key = &camera.feature;
                let seconds = |frames: u64| frames as f64 / f64::from(self.fps);
                row.extend([
                    int(&format!("videos/{key}/chunk_index"), camera.place.chunk),
                    int(&format!("videos/{key}/file_index"), camera.place.file),
                    double(&format!("videos/{key}/from_timestamp"), seconds(from)),
                    double(
                        &format!("videos/{key}/to_timestamp"),
                        seconds(from + frames),
                    ),
                ]);
                stats.insert(key.clone(), histogram.stats());
            }
        }
        for (feature, of_feature) in &stats {
            let depth = of_feature.depth;
            for (name, values) in of_feature.named() {
                let rows = vec![values.clone()];
                let name = format!("stats/{feature}/{name}");
                row.push((name, Column::DoubleLists { depth, rows }));
            }
            let count = vec![i64::try_from(of_feature.count).unwrap_or(i64::MAX)];
            row.push((
                format!("stats/{feature}/count"),
                Column::IntegerLists(vec![count]),
            ));
        }
        row.push(int("meta/episodes/chunk_index", 0));
        row.push(int("meta/episodes/file_index", 0));
        row.push(int(START_STAMP, episode.start_ns));
        self.episodes.push(row);
        self.stats.push(stats);
        self.info.total_episodes += 1;
        self.info.total_frames += frames;
        Ok(())
    }

    fn check(&self, recording: &Recording, episode: &Episode) -> Result<(), LeRobotError> {
        let unsuited = |reason: String| Err(LeRobotError::unsuited(&recording.bag, reason));
        for (feature, got) in [
            (ACTION, &recording.action_names),
            (STATE, &recording.state_names),
        ] {
            let expected = self.info.features.get(feature).map(Feature::value_names);
            let expected = expected.unwrap_or_default();
            if expected != *got {
                return unsuited(format!(
                    "{feature}: expected {expected:?} as in the first bag, got {got:?}"
                ));
            }
        }
        if episode.success.is_some() != self.info.features.contains_key(SUCCESS) {
            return unsuited(format!(
                "{SUCCESS}: expected /task/success in all bags or in none"
            ));
        }
        let cameras: Vec<String> = recording
            .cameras
            .iter()
            .map(|camera| Recording::feature(&camera.topic))
            .collect();
        let known: Vec<&String> = self.cameras.iter().map(|camera| &camera.feature).collect();
        if !known.iter().copied().eq(cameras.iter()) {
            return unsuited(format!(
                "expected the cameras {known:?} as in the first bag, got {cameras:?}"
            ));
        }
        Ok(())
    }

    /// The columns of an episode's frames, and their statistics.
    fn make_columns(
        &mut self,
        recording: &Recording,
        episode: &Episode,
        stats: &mut BTreeMap<String, Stats>,
    ) -> Vec<(String, Column)> {
        let frames = episode.frames();
        let (number, first) = (self.info.total_episodes, self.info.total_frames);
        // In range: picks are rows of their stream.
        let row_of = |values: &[Vec<f32>], at: &usize| values.get(*at).cloned().unwrap_or_default();
        let actions: Vec<f32> = episode
            .actions
            .numbers
            .iter()
            .flat_map(|at| row_of(&recording.actions.values, at))
            .collect();
        let mut columns = vec![(
            ACTION.to_owned(),
            vector_column(recording.action_names.len(), actions),
        )];
        if !recording.state_names.is_empty() {
            let mut values = Vec::with_capacity(frames * recording.state_names.len());
            for frame in 0..frames {
                for (stream, picks) in recording.states.iter().zip(&episode.states) {
                    // In range: every stream has one pick per frame.
                    let at = picks.numbers.get(frame).copied().unwrap_or(0);
                    values.extend(row_of(&stream.values, &at));
                }
            }
            let width = recording.state_names.len();
            columns.push((STATE.to_owned(), vector_column(width, values)));
        }
        if let Some(success) = episode.success {
            let booleans = (1..=frames)
                .map(|frame| success && frame == frames)
                .collect();
            columns.push((SUCCESS.to_owned(), Column::Booleans(booleans)));
        }
        // As LeRobot's own timestamps: rounded to single precision.
        let timestamps = (0..frames).map(|frame| (frame as f64 / f64::from(self.fps)) as f32);
        columns.push((TIMESTAMP.to_owned(), Column::Floats(timestamps.collect())));
        let whole = |value: u64| i64::try_from(value).unwrap_or(i64::MAX);
        let count = frames as u64;
        let tasks = episode
            .tasks
            .iter()
            .map(|task| self.task_index(task))
            .collect();
        for (name, values) in [
            (FRAME_INDEX, (0..count).map(whole).collect()),
            (EPISODE_INDEX, vec![whole(number); frames]),
            (INDEX, (first..first + count).map(whole).collect()),
            (TASK_INDEX, tasks),
        ] {
            columns.push((name.to_owned(), Column::Integers(values)));
        }
        for (name, column) in &columns {
            let single = |values: &[f32]| values.iter().map(|value| f64::from(*value)).collect();
            let (values, width): (Vec<f64>, usize) = match column {
                Column::FloatRows { width, values } => (single(values), *width),
                Column::Floats(values) => (single(values), 1),
                Column::Integers(values) => (values.iter().map(|value| *value as f64).collect(), 1),
                Column::Booleans(values) => {
                    (values.iter().map(|value| f64::from(*value)).collect(), 1)
                }
                _ => continue,
            };
            stats.insert(name.clone(), Stats::of_rows(&values, width));
        }
        columns
    }

    fn task_index(&mut self, task: &str) -> i64 {
        let known = self.tasks.iter().position(|known| known == task);
        let at = known.unwrap_or_else(|| {
            self.tasks.push(task.to_owned());
            self.tasks.len() - 1
        });
        // Fits: a count of texts in memory.
        at as i64
    }

    fn write_data(&mut self, columns: &[(String, Column)]) -> Result<Place, LeRobotError> {
        let is_full = |table: &TableWriter| table.bytes() >= self.options.data_file_bytes;
        if self.data.as_ref().is_some_and(is_full)
            && let Some(full) = self.data.take()
        {
            full.finish()?;
            self.data_place = self.data_place.next();
        }
        let table = match &mut self.data {
            Some(table) => table,
            none => {
                let path = self.data_place.path(&self.root, DATA, "")?;
                none.insert(TableWriter::create(&path, columns, &[])?)
            }
        };
        table.write(columns)?;
        Ok(self.data_place)
    }

    /// Adds an episode's frames to a camera's video; returns the index of the first frame in the file.
    fn write_video(
        &mut self,
        recording: &Recording,
        episode: &Episode,
        at: usize,
    ) -> Result<(u64, Histogram), LeRobotError> {
        let mut histogram = Histogram::default();
        let (Some(camera), Some(stream), Some(picks)) = (
            self.cameras.get_mut(at),
            recording.cameras.get(at),
            episode.cameras.get(at),
        ) else {
            return Ok((0, histogram));
        };
        if camera.video.bytes() >= self.options.video_file_bytes {
            camera.place = camera.place.next();
            let path = camera.place.path(&self.root, VIDEO, &camera.feature)?;
            let next = VideoWriter::create(&path, self.fps, camera.size)?;
            std::mem::replace(&mut camera.video, next).finish()?;
        }
        let from = camera.video.frames();
        camera.video.begin_episode();
        let mut wanted = picks
            .numbers
            .iter()
            .filter_map(|number| stream.values.get(*number))
            .peekable();
        let reader = BagReader::open(&recording.bag)?;
        for (number, message) in
            (0u64..).zip(reader.messages().only_topics([stream.topic.as_str()]))
        {
            if wanted.peek().is_none() {
                break;
            }
            let message = message?;
            if wanted.peek() != Some(&&number) {
                continue;
            }
            let unsuited = |reason: String| {
                LeRobotError::unsuited(
                    &recording.bag,
                    format!("{}, message {number}: {reason}", stream.topic),
                )
            };
            let frame = decode_picture(&message).map_err(unsuited)?;
            if frame.dimensions() != camera.size {
                return Err(unsuited(format!(
                    "expected {:?} pixels as in the first, got {:?}",
                    camera.size,
                    frame.dimensions()
                )));
            }
            while wanted.next_if(|next| **next == number).is_some() {
                histogram.add(frame.as_raw());
                camera.video.write(&frame)?;
            }
        }
        Ok((from, histogram))
    }

    /// Closes all files and writes the metadata.
    pub fn finish(mut self) -> Result<ExportReport, LeRobotError> {
        if let Some(data) = self.data.take() {
            data.finish()?;
        }
        for camera in self.cameras.drain(..) {
            camera.video.finish()?;
        }
        self.write_episodes()?;
        write_tasks(&self.root, &self.tasks)?;
        let mut of_all = serde_json::Map::new();
        for feature in self.info.features.keys() {
            let parts: Vec<&Stats> = self.stats.iter().filter_map(|s| s.get(feature)).collect();
            if let Some(stats) = Stats::aggregate(&parts) {
                of_all.insert(feature.clone(), stats.to_json());
            }
        }
        write_json(&self.root.join("meta/stats.json"), &Value::Object(of_all))?;
        self.info.total_tasks = self.tasks.len() as u64;
        let train = format!("0:{}", self.info.total_episodes);
        self.info.splits = BTreeMap::from([("train".to_owned(), train)]);
        let path = self.root.join(INFO);
        let mut info = serde_json::to_value(&self.info)
            .map_err(|error| LeRobotError::corrupt(&path, error.to_string()))?;
        // A whole number, as in LeRobot.
        if let Some(fps) = info.get_mut("fps") {
            *fps = json!(self.fps);
        }
        // Last, so that an incomplete data set lacks it.
        write_json(&path, &info)?;
        Ok(ExportReport {
            episodes: self.info.total_episodes,
            frames: self.info.total_frames,
            fps: self.fps,
            ..ExportReport::default()
        })
    }

    fn write_episodes(&self) -> Result<(), LeRobotError> {
        let Some(first) = self.episodes.first() else {
            return Ok(());
        };
        let mut table = TableWriter::create(&self.root.join(EPISODES), first, &[])?;
        for row in &self.episodes {
            table.write(row)?;
        }
        table.finish()
    }
}

/// Vectors of this width; as in LeRobot, those of width 1 become numbers (`get_hf_features_from_features`).
fn vector_column(width: usize, values: Vec<f32>) -> Column {
    match width {
        1 => Column::Floats(values),
        _ => Column::FloatRows { width, values },
    }
}

fn decode_picture(message: &BagMessage) -> Result<RgbImage, String> {
    let frame = CameraFrame::of_bag(message).map_err(|error| error.to_string())?;
    frame.decode().map_err(|error| error.to_string())
}

/// The size of each camera's first picture; h264 with 4:2:0 chroma needs even sides.
fn picture_sizes(recording: &Recording) -> Result<Vec<(u32, u32)>, LeRobotError> {
    let reader = BagReader::open(&recording.bag)?;
    let size = |topic: &str| {
        let unsuited =
            |reason: String| LeRobotError::unsuited(&recording.bag, format!("{topic}: {reason}"));
        let mut messages = reader.messages().only_topics([topic]);
        let first = messages
            .next()
            .ok_or_else(|| unsuited("expected pictures, got none".to_owned()))??;
        let (width, height) = decode_picture(&first).map_err(unsuited)?.dimensions();
        let is_even = |side: u32| side > 0 && side.is_multiple_of(2);
        if is_even(width) && is_even(height) {
            Ok((width, height))
        } else {
            Err(unsuited(format!(
                "expected pictures with even width and height for h264, got {width} x {height}"
            )))
        }
    };
    recording
        .cameras
        .iter()
        .map(|camera| size(&camera.topic))
        .collect()
}

/// The distinct texts, in order.
fn deduplicate(texts: &[String]) -> Vec<String> {
    let mut found: Vec<String> = Vec::new();
    for text in texts {
        if !found.contains(text) {
            found.push(text.clone());
        }
    }
    found
}
