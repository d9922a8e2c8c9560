//! Exports bags as a LeRobot v3.0 data set.

mod dataset;
mod episode;
mod meta;
mod place;
mod reading;
mod recording;
mod video;

use std::{
    fs,
    io::ErrorKind,
    path::{Path, PathBuf},
};

use crate::lerobot::LeRobotError;
use dataset::DatasetWriter;
use episode::Episode;
use reading::BagContent;
use recording::{Part, Recording, Silence};

/// Options of an export.
#[derive(Clone, Debug)]
pub struct ExportOptions {
    /// Frames per second; `None`: the rate of `/wm/action` in the first bag, to the nearest whole number.
    pub fps: Option<u32>,
    /// `robot_type` of the data set.
    pub robot_type: Option<String>,
    /// The cameras' topics; empty: every `.../image_raw` and `.../image_raw/compressed`.
    pub cameras: Vec<String>,
    /// The task of episodes without `/task/instruction`.
    pub task: String,
    /// Size at which the next table file starts \[bytes\].
    pub data_file_bytes: u64,
    /// Size at which the next video file starts \[bytes\].
    pub video_file_bytes: u64,
}

impl Default for ExportOptions {
    fn default() -> Self {
        Self {
            fps: None,
            robot_type: None,
            cameras: Vec::new(),
            task: String::new(),
            // LeRobot's DEFAULT_DATA_FILE_SIZE_IN_MB and DEFAULT_VIDEO_FILE_SIZE_IN_MB.
            data_file_bytes: 100 << 20,
            video_file_bytes: 200 << 20,
        }
    }
}

/// The result of an export.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct ExportReport {
    /// Number of episodes.
    pub episodes: u64,
    /// Number of frames.
    pub frames: u64,
    /// Frames per second.
    pub fps: u32,
    /// Topics whose times do not fit the rate: numbers of repeated frames and of skipped messages.
    pub resampled: Vec<String>,
    /// Bags that are split into several episodes because of gaps or clock steps, in words.
    pub split: Vec<String>,
    /// Parts of bags in no episode, with the reasons.
    pub skipped: Vec<String>,
}

/// Writes bags as a LeRobot v3.0 data set: an episode per bag, or several if the bag has several messages on
/// `/task/success`, each of which ends one.
///
/// Frames are `1 / fps` apart, from the first time at which every topic has a message to the last. A frame takes the
/// nearest message of every topic in time (the header's stamp, or the log time without a header).
///
/// Episodes do not span gaps: a new one begins after ten seconds without a message, at a backward step of the recorder's
/// clock, and when a camera, the actions, joints or the pose are silent for longer than ten of their periods and a second.
/// Messages of times that the clock passed twice are in no episode.
///
/// # Errors
/// A bag cannot be read, has no camera or no `/wm/action`, or has another state, action or picture size than the first; a
/// number is not finite; a picture is not JPEG, PNG or RGB, or has an odd size; or `out` is not empty. `out` is then
/// unchanged.
pub fn export(
    bags: &[PathBuf],
    out: &Path,
    options: &ExportOptions,
) -> Result<ExportReport, LeRobotError> {
    let unfinished = PartialDataset::begin(out)?;
    let exported = write(bags, &unfinished.folder, options)?;
    unfinished.finish()?;
    Ok(exported)
}

/// A partial data set next to its final path; it is deleted on failure.
struct PartialDataset<'a> {
    folder: PathBuf,
    out: &'a Path,
}

impl<'a> PartialDataset<'a> {
    /// # Errors
    /// `out` is not empty, or no folder can be created next to it.
    fn begin(out: &'a Path) -> Result<Self, LeRobotError> {
        let is_free = match fs::read_dir(out) {
            Ok(mut entries) => entries.next().is_none(),
            Err(error) => error.kind() == ErrorKind::NotFound,
        };
        let name = out.file_name().filter(|_| is_free);
        let name = name.ok_or_else(|| LeRobotError::Exists(out.to_owned()))?;
        // Named after this process, so that exports do not collide, and the remains of a killed one are recognisable.
        let name = format!("{}.partial-{}", name.to_string_lossy(), std::process::id());
        let folder = out.with_file_name(name);
        if let Some(parent) = out.parent() {
            fs::create_dir_all(parent).map_err(|source| LeRobotError::io(parent, source))?;
        }
        fs::create_dir(&folder).map_err(|source| LeRobotError::io(&folder, source))?;
        Ok(Self { folder, out })
    }

    fn finish(self) -> Result<(), LeRobotError> {
        fs::rename(&self.folder, self.out).map_err(|source| LeRobotError::io(self.out, source))
    }
}

impl Drop for PartialDataset<'_> {
    fn drop(&mut self) {
        // After a success it does not exist.
        fs::remove_dir_all(&self.folder).ok();
    }
}

fn write(
    bags: &[PathBuf],
    out: &Path,
    options: &ExportOptions,
) -> Result<ExportReport, LeRobotError> {
    let mut writer: Option<DatasetWriter> = None;
    let mut found = ExportReport::default();
    for bag in bags {
        let read = BagContent::read(bag, &options.cameras)?;
        let fps = match (&writer, options.fps) {
            (Some(writer), _) => writer.fps(),
            (None, Some(fps)) => fps,
            (None, None) => Recording::fps(&read.recordings, bag)?,
        };
        let silences: Vec<Vec<Silence>> = read.recordings.iter().map(Recording::silences).collect();
        let parts = collect_parts(&read.recordings, &silences);
        let mut written = 0;
        let mut first_error = None;
        for (recording, part) in &parts {
            let sampled = Episode::sample(recording, part, fps, &options.task);
            let episode = match sampled {
                Ok(episode) if parts.len() == 1 || episode.frames() > 1 => episode,
                Ok(_) => {
                    found
                        .skipped
                        .push(describe_skipped(recording, part, "one frame"));
                    continue;
                }
                Err(error) => {
                    let reason = error.reason();
                    found
                        .skipped
                        .push(describe_skipped(recording, part, &reason));
                    first_error.get_or_insert(error);
                    continue;
                }
            };
            found.resampled.extend(episode.resampled());
            let writer = match &mut writer {
                Some(writer) => writer,
                none => none.insert(DatasetWriter::create(
                    out, fps, recording, &episode, options,
                )?),
            };
            writer.write(recording, &episode)?;
            written += 1;
            tracing::info!(bag = %bag.display(), frames = episode.frames(), "exported");
        }
        if written == 0 {
            let nothing =
                || LeRobotError::unsuited(bag, "no two frames without a gap between them");
            return Err(first_error.unwrap_or_else(nothing));
        }
        found.resampled.extend(read.dropped);
        found
            .split
            .extend(describe_split(bag, &read.recordings, &silences));
    }
    let writer = writer.ok_or_else(|| LeRobotError::Nothing("no bag was given".to_owned()))?;
    let exported = writer.finish()?;
    Ok(ExportReport {
        episodes: exported.episodes,
        frames: exported.frames,
        fps: exported.fps,
        ..found
    })
}

/// The parts of a bag's spans with content.
fn collect_parts<'a>(
    recordings: &'a [Recording],
    silences: &[Vec<Silence>],
) -> Vec<(&'a Recording, Part)> {
    let spans = recordings.iter().zip(silences);
    let all = spans.flat_map(|(span, silences)| {
        let parts = span.parts(silences).into_iter();
        parts.map(move |part| (span, part))
    });
    let mut all: Vec<(&Recording, Part)> = all.collect();
    if all.len() > 1 {
        all.retain(|(span, part)| span.count(part) != (0, 0));
    }
    all
}

fn describe_skipped(recording: &Recording, part: &Part, reason: &str) -> String {
    let (actions, pictures) = recording.count(part);
    format!(
        "{}: {actions} action(s) and {pictures} picture(s) between two gaps: {reason}",
        recording.bag.display()
    )
}

/// Describes why a bag is split.
fn describe_split(bag: &Path, recordings: &[Recording], silences: &[Vec<Silence>]) -> Vec<String> {
    let seconds = |(before, after): (u64, u64)| after.saturating_sub(before) as f64 / 1e9;
    let mut lines = Vec::new();
    let filled = recordings
        .iter()
        .filter(|span| !span.actions.stamps.is_empty());
    let spans = filled.count();
    if spans > 1 {
        lines.push(format!(
            "{}: split into {spans} recordings, where it has gaps of more than 10 s or its clock is set back",
            bag.display()
        ));
    }
    let longest = |silence: &&Silence| silence.time.1 - silence.time.0;
    let all = || silences.iter().flatten();
    if let Some(silence) = all().max_by_key(longest) {
        lines.push(format!(
            "{}: split at {} gap(s) of a topic, the longest of {:.3} s on {} after the stamp {} ns",
            bag.display(),
            all().count(),
            seconds(silence.time),
            silence.topic,
            silence.time.0
        ));
    }
    lines
}
