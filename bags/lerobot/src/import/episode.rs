use image::ImageFormat;
use wm_import::video::Video;

use crate::{
    LeRobotError,
    dataset::{Clip, Dataset, Entry},
    info::{
        ACTION, EPISODE_INDEX, FRAME_INDEX, IMAGES, INDEX, STATE, SUCCESS, TASK_INDEX, TIMESTAMP,
    },
    table::{Table, image_bytes, integer, number, numbers, truth},
};

/// How far a row's `timestamp` may be from `frame_index / fps`, in s: LeRobot's own `tolerance_s`.
const TOLERANCE_S: f64 = 1e-4;

/// An episode, decoded.
#[derive(Debug)]
pub(super) struct Episode {
    pub fps: f64,
    pub frames: u64,
    pub cameras: Vec<Camera>,
    /// One row a frame, or none at all.
    pub actions: Vec<Vec<f32>>,
    pub state_names: Vec<String>,
    /// One row a frame, or none at all.
    pub states: Vec<Vec<f64>>,
    /// The frame from which each task holds.
    pub tasks: Vec<(u64, String)>,
    pub success: Option<bool>,
}

/// The frames of a camera.
#[derive(Debug)]
pub(super) struct Camera {
    /// The namespace of its topics.
    pub name: String,
    /// `jpeg` or `png`.
    pub format: &'static str,
    pub frames: Vec<Vec<u8>>,
}

/// Whether a column becomes a topic, or says where a row belongs.
pub(super) fn is_read(feature: &str) -> bool {
    [
        ACTION,
        STATE,
        SUCCESS,
        TIMESTAMP,
        FRAME_INDEX,
        EPISODE_INDEX,
        INDEX,
        TASK_INDEX,
    ]
    .contains(&feature)
}

pub(super) fn read(
    dataset: &Dataset,
    entry: &Entry,
    jpeg_quality: u8,
) -> Result<Episode, LeRobotError> {
    let features = &dataset.info.features;
    let table = Table::open(&entry.data)?;
    let images: Vec<&str> = features
        .iter()
        .filter_map(|(key, feature)| feature.is_image().then_some(key.as_str()))
        .collect();
    let mut columns = vec![TIMESTAMP, FRAME_INDEX, EPISODE_INDEX, TASK_INDEX];
    let optional = [ACTION, STATE, SUCCESS];
    columns.extend(optional.iter().filter(|name| features.contains_key(**name)));
    columns.extend(&images);
    let mut episode = Episode {
        fps: dataset.info.fps,
        frames: entry.length,
        cameras: Vec::new(),
        actions: Vec::new(),
        state_names: features
            .get(STATE)
            .map_or(Vec::new(), |state| state.value_names()),
        states: Vec::new(),
        tasks: Vec::new(),
        success: None,
    };
    let mut pictures: Vec<Vec<Vec<u8>>> = vec![Vec::new(); images.len()];
    let range = entry.first_row..entry.first_row.saturating_add(entry.length);
    table.rows(&columns, range, |row, cells| {
        let cell = |name: &str| {
            let at = columns.iter().position(|column| *column == name);
            at.and_then(|at| cells.get(at))
        };
        let frame = row - entry.first_row;
        let episode_index = integer(EPISODE_INDEX, cell(EPISODE_INDEX))?;
        if episode_index != entry.index {
            return Err(format!(
                "{EPISODE_INDEX}: expected {}, got {episode_index}",
                entry.index
            ));
        }
        let frame_index = integer(FRAME_INDEX, cell(FRAME_INDEX))?;
        if u64::try_from(frame_index) != Ok(frame) {
            return Err(format!(
                "{FRAME_INDEX}: expected {frame}, got {frame_index}"
            ));
        }
        let (expected, got) = (
            frame as f64 / episode.fps,
            number(TIMESTAMP, cell(TIMESTAMP))?,
        );
        // It is single: beside the tolerance, what that rounds.
        if (got - expected).abs() > TOLERANCE_S + expected * f64::from(f32::EPSILON) {
            return Err(format!(
                "{TIMESTAMP}: expected {expected} s, for frame {frame} at {} per second, got {got} s",
                episode.fps
            ));
        }
        let task = integer(TASK_INDEX, cell(TASK_INDEX))?;
        let task = dataset.tasks.get(&task).ok_or_else(|| {
            format!(
                "{TASK_INDEX}: there is no task {task} among {}",
                dataset.tasks.len()
            )
        })?;
        if episode.tasks.last().is_none_or(|(_, last)| last != task) {
            episode.tasks.push((frame, task.clone()));
        }
        if let Some(feature) = features.get(ACTION) {
            let values = numbers(ACTION, cell(ACTION), feature.width())?;
            // What the message carries; LeRobot's own are single too.
            let values = values.into_iter().map(|value| value as f32).collect();
            episode.actions.push(values);
        }
        if let Some(feature) = features.get(STATE) {
            episode
                .states
                .push(numbers(STATE, cell(STATE), feature.width())?);
        }
        if features.contains_key(SUCCESS) {
            episode.success = Some(truth(SUCCESS, cell(SUCCESS))?);
        }
        for (name, frames) in images.iter().zip(&mut pictures) {
            frames.push(image_bytes(name, cell(name))?);
        }
        Ok(())
    })?;
    for (name, frames) in images.iter().zip(pictures) {
        let format = picture_format(&frames)
            .map_err(|reason| LeRobotError::corrupt(table.path(), format!("{name}: {reason}")))?;
        episode.cameras.push(Camera {
            name: namespace(name),
            format,
            frames,
        });
    }
    for (key, clip) in &entry.videos {
        episode.cameras.push(Camera {
            name: namespace(key),
            format: "jpeg",
            frames: frames(key, clip, entry.length, episode.fps, jpeg_quality)?,
        });
    }
    Ok(episode)
}

/// The frames of an episode's part of a video, as JPEG. Each must be within a quarter of a frame of its time: which one
/// is meant is certain then, and videos that were put together from many carry the rounding of each one's length.
fn frames(
    key: &str,
    clip: &Clip,
    length: u64,
    fps: f64,
    quality: u8,
) -> Result<Vec<Vec<u8>>, LeRobotError> {
    let video = Video::open(&clip.file)?;
    let corrupt = |reason: String| LeRobotError::corrupt(&clip.file, format!("{key}: {reason}"));
    let mut first = None;
    for frame in 0..length {
        let expected_s = clip.from_s + frame as f64 / fps;
        let (nearest, got_s) = video
            .nearest(expected_s)
            .ok_or_else(|| corrupt("it has no frames".to_owned()))?;
        let begin = *first.get_or_insert(nearest);
        let is_next = usize::try_from(frame).ok().map(|frame| begin + frame) == Some(nearest);
        if !is_next || (got_s - expected_s).abs() > 0.25 / fps {
            return Err(corrupt(format!(
                "expected frame {frame} of {length} at {expected_s} s, the nearest is at {got_s} s"
            )));
        }
    }
    let begin = first.unwrap_or(0);
    // As many frames as were just found.
    let end = begin + usize::try_from(length).unwrap_or(usize::MAX);
    Ok(video.jpegs(begin..end, quality)?)
}

/// The format that all pictures of a camera are in.
fn picture_format(frames: &[Vec<u8>]) -> Result<&'static str, String> {
    let mut found = None;
    for (number, bytes) in frames.iter().enumerate() {
        let format = match image::guess_format(bytes) {
            Ok(ImageFormat::Jpeg) => "jpeg",
            Ok(ImageFormat::Png) => "png",
            other => {
                return Err(format!(
                    "frame {number}: expected JPEG or PNG, got {other:?}"
                ));
            }
        };
        if *found.get_or_insert(format) != format {
            return Err(format!(
                "frame {number}: a picture in {format} among pictures in another format"
            ));
        }
    }
    Ok(found.unwrap_or("png"))
}

/// A camera's feature as a ROS namespace: `observation.images.top-left` becomes `top_left`.
fn namespace(feature: &str) -> String {
    let name = feature.strip_prefix(IMAGES).unwrap_or(feature);
    let name = name.strip_prefix("observation.").unwrap_or(name);
    let letters = name
        .chars()
        .map(|c| if c.is_ascii_alphanumeric() { c } else { '_' });
    let name: String = letters.collect();
    match name.chars().next() {
        // A token of a topic's name does not begin with a digit (design.ros2.org, topic and service names).
        Some(first) if first.is_ascii_digit() => format!("camera_{name}"),
        Some(_) => name,
        None => "camera".to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cameras_get_names_that_ros_allows() {
        for (feature, name) in [
            ("observation.images.front", "front"),
            ("observation.images.cam-high.left", "cam_high_left"),
            ("observation.image", "image"),
            ("observation.images.0", "camera_0"),
            ("observation.images.", "camera"),
        ] {
            assert_eq!(namespace(feature), name, "{feature}");
        }
    }
}
