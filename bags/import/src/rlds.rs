//! RLDS: TFRecord files of `tf.train.Example`, one example an episode, its steps flattened into lists.
//!
//! Features, as TensorFlow Datasets names them: `steps/action` (T x 7 float), `steps/observation/image_N` (T encoded
//! images), `steps/observation/state` (T x 7 float), `steps/language_instruction` (T texts). In Bridge V2 the state is
//! the pose of the end effector (x y z in m, roll pitch yaw in rad) and the gripper (0 closed to 1 open), whatever the
//! template text in `features.json` says; its differences are the actions.

mod example;
mod split;
mod tfrecord;

use std::path::{Path, PathBuf};

use image::{ImageFormat, RgbImage};

use crate::{
    ImportError,
    episode::{Episode, Unread, VALUES, bridge_cameras},
    jpeg,
};
use example::Example;
use tfrecord::TfRecords;

const ACTION: &str = "steps/action";
const STATE: &str = "steps/observation/state";
const INSTRUCTION: &str = "steps/language_instruction";
const IMAGE_PREFIX: &str = "steps/observation/image_";

/// The episodes of these files.
pub(crate) fn episodes(
    files: Vec<PathBuf>,
    jpeg_quality: u8,
) -> impl Iterator<Item = Result<Unread, ImportError>> {
    files.into_iter().flat_map(move |file| {
        let (episodes, error) = match TfRecords::open(&file) {
            Ok(records) => (
                Some(Episodes {
                    file,
                    records,
                    found: 0,
                    jpeg_quality,
                }),
                None,
            ),
            Err(error) => (None, Some(Err(error))),
        };
        error.into_iter().chain(episodes.into_iter().flatten())
    })
}

/// The episodes of one file.
struct Episodes {
    file: PathBuf,
    records: TfRecords,
    found: u64,
    jpeg_quality: u8,
}

impl Iterator for Episodes {
    type Item = Result<Unread, ImportError>;

    fn next(&mut self) -> Option<Self::Item> {
        let Some(record) = self.records.next() else {
            return self.check_count().err().map(Err);
        };
        let number = self.found;
        self.found += 1;
        let (file, quality) = (self.file.clone(), self.jpeg_quality);
        Some(record.map(|record| {
            let unread: Unread = Box::new(move || episode(&file, number, &record.read()?, quality));
            unread
        }))
    }
}

impl Episodes {
    /// Holds the count against the data set's own description: a file cut between two records looks whole otherwise.
    fn check_count(&self) -> Result<(), ImportError> {
        match split::expected_records(&self.file)? {
            Some(expected) if expected != self.found => Err(ImportError::corrupt(
                &self.file,
                format!(
                    "expected {expected} episodes, as dataset_info.json says, got {}",
                    self.found
                ),
            )),
            _ => Ok(()),
        }
    }
}

/// One episode from its record.
fn episode(
    file: &Path,
    number: u64,
    record: &[u8],
    jpeg_quality: u8,
) -> Result<Episode, ImportError> {
    let corrupt =
        |reason: String| ImportError::corrupt(file, format!("episode {number}: {reason}"));
    let example = Example::parse(record).map_err(corrupt)?;
    let actions = rows(&example, ACTION).map_err(corrupt)?;
    let states = if example.has(STATE) {
        rows(&example, STATE).map_err(corrupt)?
    } else {
        Vec::new()
    };
    let mut cameras = Vec::new();
    for name in example
        .names()
        .filter(|name| name.starts_with(IMAGE_PREFIX))
    {
        let images = example.bytes(name).map_err(corrupt)?;
        cameras.extend(
            camera(images, jpeg_quality).map_err(|reason| corrupt(format!("{name}, {reason}")))?,
        );
    }
    let instruction = match example.has(INSTRUCTION) {
        true => first_text(example.bytes(INSTRUCTION).map_err(corrupt)?).map_err(corrupt)?,
        false => None,
    };
    Episode {
        source: file.to_owned(),
        record: Some(number),
        cameras: bridge_cameras(cameras),
        actions,
        states,
        instruction,
        ..Episode::default()
    }
    .check()
    .map_err(|error| match error {
        ImportError::Corrupt { reason, .. } => corrupt(reason),
        other => other,
    })
}

/// A flattened list of floats as rows of seven.
fn rows(example: &Example, name: &str) -> Result<Vec<[f32; VALUES]>, String> {
    let values = example.floats(name)?;
    let (rows, rest) = values.as_chunks::<VALUES>();
    if rest.is_empty() {
        Ok(rows.to_vec())
    } else {
        Err(format!(
            "expected {name} as rows of {VALUES}, got {} numbers",
            values.len()
        ))
    }
}

/// The frames of a camera as JPEG; those that are JPEG already keep their bytes. None for a camera that was not
/// there: RLDS fills its images with one flat colour. (The flags `has_image_N` cannot tell: published files have them
/// all false.)
fn camera(images: &[Vec<u8>], quality: u8) -> Result<Option<Vec<Vec<u8>>>, String> {
    let mut frames = Vec::with_capacity(images.len());
    let mut shows_something = false;
    for (step, bytes) in images.iter().enumerate() {
        let wrong = |error: image::ImageError| format!("step {step}: {error}");
        let format = image::guess_format(bytes).map_err(wrong)?;
        let decoded = image::load_from_memory_with_format(bytes, format)
            .map_err(wrong)?
            .into_rgb8();
        shows_something |= !is_flat(&decoded);
        frames.push(match format {
            ImageFormat::Jpeg => bytes.clone(),
            _ => jpeg(&decoded, quality).map_err(wrong)?,
        });
    }
    Ok(shows_something.then_some(frames))
}

fn is_flat(image: &RgbImage) -> bool {
    let mut pixels = image.pixels();
    pixels
        .next()
        .is_none_or(|first| pixels.all(|pixel| pixel == first))
}

/// The instruction, which RLDS repeats at each step; none if it is empty.
fn first_text(texts: &[Vec<u8>]) -> Result<Option<String>, String> {
    let Some(text) = texts.first().filter(|text| !text.is_empty()) else {
        return Ok(None);
    };
    String::from_utf8(text.clone())
        .map(Some)
        .map_err(|error| format!("{INSTRUCTION}: {error}"))
}

#[cfg(test)]
mod tests;
