//! Bags as a LeRobot v3.0 dataset.

mod dataset;
mod episode;
mod meta;
mod place;
mod recording;
mod video;

use std::{
    fs,
    io::ErrorKind,
    path::{Path, PathBuf},
};

use crate::LeRobotError;
use dataset::DatasetWriter;
use episode::Episode;
use recording::Recording;

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
}

/// Writes bags as a LeRobot v3.0 dataset: one episode a bag, or several where the bag says `/task/success` several times,
/// each of which ends one.
///
/// The frames of an episode are `1 / fps` apart, from when every topic has a message until one has none any more; each
/// takes the message of every topic that is nearest in time (the header's stamp; for messages without, when they were
/// recorded).
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
    let mut resampled = Vec::new();
    for bag in bags {
        let recording = Recording::read(bag, &options.cameras)?;
        let fps = match (&writer, options.fps) {
            (Some(writer), _) => writer.fps(),
            (None, Some(fps)) => fps,
            (None, None) => recording.fps()?,
        };
        for part in recording.parts() {
            let episode = Episode::sample(&recording, part, fps, &options.task)?;
            resampled.extend(episode.resampled());
            let writer = match &mut writer {
                Some(writer) => writer,
                none => none.insert(DatasetWriter::create(
                    out, fps, &recording, &episode, options,
                )?),
            };
            writer.write(&recording, &episode)?;
            tracing::info!(bag = %bag.display(), frames = episode.frames(), "exported");
        }
    }
    let writer = writer.ok_or_else(|| LeRobotError::Nothing("no bag was given".to_owned()))?;
    let mut exported = writer.finish()?;
    exported.resampled = resampled;
    Ok(exported)
}
