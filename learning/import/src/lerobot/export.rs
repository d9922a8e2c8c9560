//! Bags as a LeRobot v3.0 dataset.

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

/// How bags are exported.
#[derive(Clone, Debug)]
pub struct ExportOptions {
    /// Frames a second; none takes the rate of `/wm/action` in the first bag, to the nearest whole number.
    pub fps: Option<u32>,
    /// `robot_type` of the dataset.
    pub robot_type: Option<String>,
    /// The cameras' topics; none takes every `.../image_raw` and `.../image_raw/compressed`.
    pub cameras: Vec<String>,
    /// The task of episodes without `/task/instruction`.
    pub task: String,
    /// The next file of the tables starts when this one has reached this many bytes.
    pub data_file_bytes: u64,
    /// The same of the videos.
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

/// What was exported.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Exported {
    /// Episodes.
    pub episodes: u64,
    /// Frames of all episodes.
    pub frames: u64,
    /// Frames a second.
    pub fps: u32,
    /// What the bags' times did not allow: topic, and how many frames repeat a message or messages are left out.
    pub resampled: Vec<String>,
    /// Bags that are split into several episodes because of gaps, or because the clock was set back, in words.
    pub split: Vec<String>,
    /// Parts of bags that are in no episode, and why, in words.
    pub left_out: Vec<String>,
}

/// Writes bags as a LeRobot v3.0 dataset: one episode a bag, or several where the bag says `/task/success` several times,
/// each of which ends one.
///
/// The frames of an episode are `1 / fps` apart, from when every topic has a message until one has none any more; each
/// takes the message of every topic that is nearest in time (the header's stamp; for messages without, when they were
/// recorded).
///
/// No episode goes over a gap: a new one begins after ten seconds without a message, where the recorder's clock is set back,
/// and where a camera, the actions, joints or the pose are silent for longer than ten of their periods, at least a second.
/// What was recorded twice because the clock was set back is in no episode.
///
/// # Errors
/// A bag cannot be read, has no camera or no `/wm/action`, or another state, action or picture size than the first; a
/// number is not finite; a picture is not JPEG, PNG or RGB, or of an odd size; or `out` is not empty. Nothing is at `out`
/// then that was not there before.
pub fn export(
    bags: &[PathBuf],
    out: &Path,
    options: &ExportOptions,
) -> Result<Exported, LeRobotError> {
    let unfinished = Unfinished::begin(out)?;
    let exported = write(bags, &unfinished.folder, options)?;
    unfinished.finish()?;
    Ok(exported)
}

/// A dataset that is being written, beside where it is to be: a refusal leaves nothing of it.
struct Unfinished<'a> {
    folder: PathBuf,
    out: &'a Path,
}

impl<'a> Unfinished<'a> {
    /// # Errors
    /// There is something at `out`, or no folder can be made beside it.
    fn begin(out: &'a Path) -> Result<Self, LeRobotError> {
        let is_free = match fs::read_dir(out) {
            Ok(mut entries) => entries.next().is_none(),
            Err(error) => error.kind() == ErrorKind::NotFound,
        };
        let name = out.file_name().filter(|_| is_free);
        let name = name.ok_or_else(|| LeRobotError::Exists(out.to_owned()))?;
        // Of this process, so that two exports do not meet. What a killed one leaves tells what it is.
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

impl Drop for Unfinished<'_> {
    fn drop(&mut self) {
        // After a success it is not there any more.
        fs::remove_dir_all(&self.folder).ok();
    }
}

fn write(bags: &[PathBuf], out: &Path, options: &ExportOptions) -> Result<Exported, LeRobotError> {
    let mut writer: Option<DatasetWriter> = None;
    let mut found = Exported::default();
    for bag in bags {
        let read = BagContent::read(bag, &options.cameras)?;
        let fps = match (&writer, options.fps) {
            (Some(writer), _) => writer.fps(),
            (None, Some(fps)) => fps,
            (None, None) => Recording::fps(&read.recordings, bag)?,
        };
        let silences: Vec<Vec<Silence>> = read.recordings.iter().map(Recording::silences).collect();
        let parts = parts(&read.recordings, &silences);
        let mut written = 0;
        let mut first_error = None;
        for (recording, part) in &parts {
            let sampled = Episode::sample(recording, part, fps, &options.task);
            let episode = match sampled {
                Ok(episode) if parts.len() == 1 || episode.frames() > 1 => episode,
                Ok(_) => {
                    found.left_out.push(left_out(recording, part, "one frame"));
                    continue;
                }
                Err(error) => {
                    let reason = error.reason();
                    found.left_out.push(left_out(recording, part, &reason));
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
        found.split.extend(split(bag, &read.recordings, &silences));
    }
    let writer = writer.ok_or_else(|| LeRobotError::Nothing("no bag was given".to_owned()))?;
    let exported = writer.finish()?;
    Ok(Exported {
        episodes: exported.episodes,
        frames: exported.frames,
        fps: exported.fps,
        ..found
    })
}

/// The parts of a bag's spans that hold something.
fn parts<'a>(recordings: &'a [Recording], silences: &[Vec<Silence>]) -> Vec<(&'a Recording, Part)> {
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

fn left_out(recording: &Recording, part: &Part, reason: &str) -> String {
    let (actions, pictures) = recording.count(part);
    format!(
        "{}: {actions} action(s) and {pictures} picture(s) between two gaps: {reason}",
        recording.bag.display()
    )
}

/// Why a bag is split, in words.
fn split(bag: &Path, recordings: &[Recording], silences: &[Vec<Silence>]) -> Vec<String> {
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
