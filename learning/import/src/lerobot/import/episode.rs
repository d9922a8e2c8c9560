//! Reads an episode's rows and pictures.

use std::{
    fs::File,
    io::Read as _,
    path::{Component, Path},
};

use wm_camera::{format::Format, image_message::check_compressed};
use wm_msgs::sensor_msgs::CompressedImage;

use super::{timing::Timing, videos::Videos};
use crate::lerobot::{
    LeRobotError,
    dataset::{Dataset, EpisodeEntry, Rows},
    info::{
        ACTION, EPISODE_INDEX, FRAME_INDEX, IMAGES, INDEX, STATE, SUCCESS, TASK_INDEX, TIMESTAMP,
    },
    table::{Picture, Table, boolean, integer, number, numbers, picture},
};

/// Limit of a picture's file, larger than any camera's frame \[bytes\].
const PICTURE_BYTES_LIMIT: u64 = 64 << 20;

#[derive(Debug)]
pub(super) struct Episode {
    pub timing: Timing,
    pub cameras: Vec<Camera>,
    /// One row a frame, or none at all.
    pub actions: Vec<Vec<f32>>,
    pub state_names: Vec<String>,
    /// One row a frame, or none at all.
    pub states: Vec<Vec<f64>>,
    /// Tasks with their first frames.
    pub tasks: Vec<(u64, String)>,
    pub success: Option<bool>,
    /// Remarks.
    pub notes: Vec<String>,
}

/// The frames of a camera.
#[derive(Debug)]
pub(super) struct Camera {
    /// Namespace of its topics.
    pub name: String,
    /// `jpeg` or `png`.
    pub format: &'static str,
    pub frames: Vec<Vec<u8>>,
}

/// Whether a column becomes a topic, or locates a row.
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

/// Options of reading an episode.
#[derive(Clone, Copy, Debug)]
pub(super) struct ReadOptions {
    /// JPEG quality of video frames, 1 to 100.
    pub jpeg_quality: u8,
    /// Whether frames are stamped by the rate, ignoring time stamps.
    pub is_nominal: bool,
}

/// Actions and states of an episode, (T, values) each; empty without such a feature.
pub(super) type Values = (Vec<Vec<f32>>, Vec<Vec<f64>>);

/// Reads only the actions and the states of an episode.
pub(super) fn read_values(
    dataset: &Dataset,
    entry: &EpisodeEntry,
    rows: &mut Rows,
) -> Result<Values, LeRobotError> {
    let (mut actions, mut states) = (Vec::new(), Vec::new());
    let features = [ACTION, STATE].map(|name| Some((name, dataset.info.features.get(name)?)));
    let features: Vec<_> = features.into_iter().flatten().collect();
    let columns: Vec<&str> = features.iter().map(|(name, _)| *name).collect();
    let found = rows.find(dataset, entry)?;
    let table = Table::open(&found.file)?;
    table.rows(&columns, found.rows, |_, cells| {
        for ((name, feature), cell) in features.iter().zip(cells) {
            let values = numbers(name, Some(cell), feature.width())?;
            match *name {
                ACTION => actions.push(to_single(values)),
                _ => states.push(values),
            }
        }
        Ok(())
    })?;
    Ok((actions, states))
}

pub(super) fn read(
    dataset: &Dataset,
    entry: &EpisodeEntry,
    rows: &mut Rows,
    videos: &mut Videos,
    reading: ReadOptions,
) -> Result<Episode, LeRobotError> {
    let features = &dataset.info.features;
    let found = rows.find(dataset, entry)?;
    let table = Table::open(&found.file)?;
    let images: Vec<&str> = features
        .iter()
        .filter_map(|(key, feature)| feature.is_image().then_some(key.as_str()))
        .collect();
    let mut columns = vec![TIMESTAMP, FRAME_INDEX, TASK_INDEX];
    let optional = [ACTION, STATE, SUCCESS];
    columns.extend(optional.iter().filter(|name| features.contains_key(**name)));
    columns.extend(&images);
    let mut episode = Episode {
        timing: Timing::default(),
        cameras: Vec::new(),
        actions: Vec::new(),
        state_names: features
            .get(STATE)
            .map_or(Vec::new(), |state| state.value_names()),
        states: Vec::new(),
        tasks: Vec::new(),
        success: None,
        notes: Vec::new(),
    };
    if found.is_elsewhere {
        let text = "the rows are in another data file than meta says";
        episode.notes.push(text.to_owned());
    }
    let mut pictures: Vec<Vec<Vec<u8>>> = vec![Vec::new(); images.len()];
    let mut times_s = Vec::new();
    let first_row = found.rows.start;
    table.rows(&columns, found.rows, |row, cells| {
        let cell = |name: &str| {
            let at = columns.iter().position(|column| *column == name);
            at.and_then(|at| cells.get(at))
        };
        let frame = row - first_row;
        let frame_index = integer(FRAME_INDEX, cell(FRAME_INDEX))?;
        if u64::try_from(frame_index) != Ok(frame) {
            return Err(format!(
                "{FRAME_INDEX}: expected {frame}, got {frame_index}"
            ));
        }
        times_s.push(number(TIMESTAMP, cell(TIMESTAMP))?);
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
            episode.actions.push(to_single(values));
        }
        if let Some(feature) = features.get(STATE) {
            episode
                .states
                .push(numbers(STATE, cell(STATE), feature.width())?);
        }
        if features.contains_key(SUCCESS) {
            episode.success = Some(boolean(SUCCESS, cell(SUCCESS))?);
        }
        for (name, frames) in images.iter().zip(&mut pictures) {
            frames.push(match picture(name, cell(name))? {
                Picture::Bytes(bytes) => bytes,
                Picture::Path(path) => read_file(&dataset.root, Path::new(&path))
                    .map_err(|reason| format!("{name}: {reason}"))?,
            });
        }
        Ok(())
    })?;
    let corrupt = |reason: String| {
        let reason = format!("episode {}: {reason}", entry.index);
        LeRobotError::corrupt(table.path(), reason)
    };
    let fps = dataset.info.fps;
    let timing = match reading.is_nominal {
        true => Ok(Timing::nominal(times_s.len(), fps)),
        false => Timing::of(&times_s, fps),
    };
    episode.timing = timing.map_err(|reason| corrupt(format!("{TIMESTAMP}: {reason}")))?;
    for (name, frames) in images.iter().zip(pictures) {
        let format =
            picture_format(&frames).map_err(|reason| corrupt(format!("{name}: {reason}")))?;
        episode.cameras.push(Camera {
            name: namespace(name),
            format,
            frames,
        });
    }
    for (key, clip) in &entry.videos {
        let (frames, note) =
            videos.frames(dataset, key, clip, entry.index, reading.jpeg_quality)?;
        episode.cameras.push(Camera {
            name: namespace(key),
            format: "jpeg",
            frames,
        });
        episode
            .notes
            .extend(note.map(|note| format!("{key}: {note}")));
    }
    Ok(episode)
}

/// Converts to the messages' single precision, which LeRobot has too.
fn to_single(values: Vec<f64>) -> Vec<f32> {
    values.into_iter().map(|value| value as f32).collect()
}

/// Reads a file of the data set.
fn read_file(root: &Path, path: &Path) -> Result<Vec<u8>, String> {
    let mut parts = path.components();
    if !parts.all(|part| matches!(part, Component::Normal(_))) {
        return Err(format!(
            "expected a path inside the data set, got {}",
            path.display()
        ));
    }
    let wrong = |error| format!("{}: {error}", path.display());
    let file = File::open(root.join(path)).map_err(wrong)?;
    let mut bytes = Vec::new();
    file.take(PICTURE_BYTES_LIMIT + 1)
        .read_to_end(&mut bytes)
        .map_err(wrong)?;
    if bytes.len() as u64 > PICTURE_BYTES_LIMIT {
        return Err(format!(
            "{}: expected at most {PICTURE_BYTES_LIMIT} bytes",
            path.display()
        ));
    }
    Ok(bytes)
}

/// The format of a camera's pictures, which must be complete and have one format.
fn picture_format(frames: &[Vec<u8>]) -> Result<&'static str, String> {
    let mut found = None;
    for (number, bytes) in frames.iter().enumerate() {
        let image = CompressedImage {
            data: bytes.clone(),
            ..CompressedImage::default()
        };
        let checked = check_compressed(&image);
        let (format, _) = checked.map_err(|error| format!("frame {number}: {error}"))?;
        let format = match format {
            Format::Jpeg => "jpeg",
            Format::Png => "png",
        };
        if *found.get_or_insert(format) != format {
            return Err(format!(
                "frame {number}: a picture in {format} among pictures in another format"
            ));
        }
    }
    Ok(found.unwrap_or("png"))
}

/// The ROS namespace of a camera's feature: `observation.images.top-left` becomes `top_left`.
fn namespace(feature: &str) -> String {
    let name = feature.strip_prefix(IMAGES).unwrap_or(feature);
    let name = name.strip_prefix("observation.").unwrap_or(name);
    let letters = name
        .chars()
        .map(|c| if c.is_ascii_alphanumeric() { c } else { '_' });
    let name: String = letters.collect();
    match name.chars().next() {
        // Tokens of topic names do not begin with a digit (design.ros2.org, topic and service names).
        Some(first) if first.is_ascii_digit() => format!("camera_{name}"),
        Some(_) => name,
        None => "camera".to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn incomplete_picture_is_an_error_that_names_its_frame() {
        let coded = |format| {
            let mut bytes = std::io::Cursor::new(Vec::new());
            let picture =
                image::RgbImage::from_fn(16, 16, |x, y| image::Rgb([x as u8 * 9, y as u8, 3]));
            picture.write_to(&mut bytes, format).unwrap();
            bytes.into_inner()
        };
        let (png, jpeg) = (
            coded(image::ImageFormat::Png),
            coded(image::ImageFormat::Jpeg),
        );
        for (whole, name) in [(&png, "png"), (&jpeg, "jpeg")] {
            assert_eq!(picture_format(std::slice::from_ref(whole)), Ok(name));
            let cut = whole[..whole.len() - 40].to_vec();
            let error = picture_format(&[whole.clone(), cut]).unwrap_err();
            assert!(error.starts_with("frame 1: "), "{error}");
        }
        let error = picture_format(&[png, jpeg]).unwrap_err();
        assert!(error.contains("another format"), "{error}");
    }

    #[test]
    fn cameras_get_valid_ros_names() {
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
