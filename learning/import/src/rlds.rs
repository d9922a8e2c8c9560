//! RLDS: TFRecord files of `tf.train.Example`, one example per episode, its steps flattened into lists.
//!
//! Features, as TensorFlow Datasets names them: `steps/action` (T x 7 float), `steps/observation/image_N` (T encoded
//! images), `steps/observation/state` (T x 7 float), `steps/language_instruction` (T texts), `steps/reward` (T float). In
//! Bridge V2, the state is the pose of the end effector (x y z in m, roll pitch yaw in rad) and the gripper (0 closed to 1
//! open), unlike the template text in `features.json`; its differences are the actions.
//!
//! An example with `steps/observation/cartesian_position` is DROID's ([`droid`]).

mod droid;
mod example;
mod pictures;
mod split;
mod tfrecord;

use std::{
    path::{Path, PathBuf},
    rc::Rc,
};

use crate::{
    ActionMapping, ImportError,
    episode::{
        BRIDGE_PERIOD_NS, Camera, Episode, FoundEpisode, Trajectory, UnreadEpisode, bridge_cameras,
    },
    mapping::VALUES,
    origin::origin,
    remedy::ValueSource,
};
use example::Example;
use pictures::Pictures;
use tfrecord::{Record, TfRecords};

const ACTION: &str = "steps/action";
const STATE: &str = "steps/observation/state";
const INSTRUCTION: &str = "steps/language_instruction";
const IMAGE_PREFIX: &str = "steps/observation/image_";
const REWARD: &str = "steps/reward";
const IS_LAST: &str = "steps/is_last";
/// In SOAR and other data sets with failed episodes.
const SUCCESS: &str = "episode_metadata/success";

/// The episodes of these files.
pub(crate) fn episodes(
    files: Vec<PathBuf>,
    jpeg_quality: u8,
) -> impl Iterator<Item = FoundEpisode> {
    files.into_iter().flat_map(move |file| {
        let (episodes, error) = match TfRecords::open(&file) {
            Ok(records) => (
                Some(Episodes {
                    file: file.into(),
                    records,
                    found: 0,
                    jpeg_quality,
                    is_checked: false,
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
    file: Rc<Path>,
    records: TfRecords,
    found: u64,
    jpeg_quality: u8,
    /// Whether the count was checked.
    is_checked: bool,
}

impl Iterator for Episodes {
    type Item = FoundEpisode;

    fn next(&mut self) -> Option<Self::Item> {
        let Some(record) = self.records.next() else {
            if std::mem::replace(&mut self.is_checked, true) {
                return None;
            }
            return self.check_count().err().map(Err);
        };
        let number = self.found;
        self.found += 1;
        let (file, jpeg_quality) = (Rc::clone(&self.file), self.jpeg_quality);
        // Records after a damaged length cannot be found; that error covers their number.
        self.is_checked |= record.is_err();
        Some(record.map(|record| {
            let unread: Box<dyn UnreadEpisode> = Box::new(RldsEpisode {
                file,
                number,
                record,
                jpeg_quality,
            });
            unread
        }))
    }
}

impl Episodes {
    /// Checks the count against the data set's description: a file truncated between two records looks complete.
    fn check_count(&self) -> Result<(), ImportError> {
        match split::expected_records(&self.file)? {
            Some(expected) if expected != self.found => Err(ImportError::corrupt(
                &*self.file,
                format!(
                    "expected {expected} episodes (dataset_info.json), got {}",
                    self.found
                ),
            )),
            _ => Ok(()),
        }
    }
}

/// An episode of a file, not yet read.
struct RldsEpisode {
    file: Rc<Path>,
    number: u64,
    record: Record,
    jpeg_quality: u8,
}

/// The content of an example without its pictures.
struct Content {
    recorded: Trajectory,
    joints: Option<Vec<Vec<f64>>>,
}

impl UnreadEpisode for RldsEpisode {
    fn origin(&self, src: &Path) -> String {
        origin(src, Some(&self.file), i64::try_from(self.number).ok())
    }

    fn recorded(&self, mapping: &ActionMapping) -> Result<Trajectory, ImportError> {
        let record = self.record.read()?;
        let content = Example::parse(&record).and_then(|example| read_content(&example, mapping));
        Ok(content.map_err(|reason| self.corrupt(&reason))?.recorded)
    }

    fn read(&self, mapping: &ActionMapping) -> Result<Episode, ImportError> {
        let record = self.record.read()?;
        let example = Example::parse(&record).map_err(|reason| self.corrupt(&reason))?;
        let episode = self.episode(&example, mapping);
        let episode = episode.map_err(|reason| self.corrupt(&reason))?;
        episode.check().map_err(|error| match error {
            ImportError::Corrupt { reason, .. } => self.corrupt(&reason),
            other => other,
        })
    }
}

impl RldsEpisode {
    fn corrupt(&self, reason: &str) -> ImportError {
        ImportError::corrupt(&*self.file, format!("episode {}: {reason}", self.number))
    }

    fn episode(&self, example: &Example, mapping: &ActionMapping) -> Result<Episode, String> {
        let content = read_content(example, mapping)?;
        let mut notes = Vec::new();
        let cameras = match droid::is_droid(example) {
            true => droid::read_cameras(example, self.jpeg_quality, &mut notes)?,
            false => read_cameras(example, self.jpeg_quality, &mut notes)?,
        };
        Ok(Episode {
            source: self.file.to_path_buf(),
            cameras,
            recorded: content.recorded,
            joints: content.joints.map(crate::droid::states::joints),
            instruction: read_instruction(example)?,
            success: read_success(example)?,
            notes,
        })
    }
}

fn read_content(example: &Example, mapping: &ActionMapping) -> Result<Content, String> {
    if droid::is_droid(example) {
        return droid::read_content(example, mapping);
    }
    let mut actions = read_rows(example, ACTION)?;
    let states = if example.has(STATE) {
        read_rows(example, STATE)?
    } else {
        Vec::new()
    };
    mapping.apply(&mut actions, &states, BRIDGE_PERIOD_NS as f64 / 1e9);
    Ok(Content {
        recorded: Trajectory {
            period_ns: BRIDGE_PERIOD_NS,
            actions,
            states,
            source: ValueSource {
                gripper: mapping.gripper,
                is_of_states: false,
            },
        },
        joints: None,
    })
}

/// Bridge V2's cameras, by number. A missing camera has one flat colour: it is skipped and named.
fn read_cameras(
    example: &Example,
    jpeg_quality: u8,
    notes: &mut Vec<String>,
) -> Result<Vec<Camera>, String> {
    let mut cameras = Vec::new();
    let names = example
        .names()
        .filter(|name| name.starts_with(IMAGE_PREFIX));
    for name in names {
        let pictures = Pictures::read(example.bytes(name)?, jpeg_quality);
        let pictures = pictures.map_err(|reason| format!("{name}, {reason}"))?;
        cameras.extend(pictures.unless_flat(name, notes));
    }
    Ok(bridge_cameras(cameras))
}

/// Whether the task succeeded: from the metadata, otherwise from the reward of the last step, 1 for a demonstration. `None`
/// if the example ends before the episode.
fn read_success(example: &Example) -> Result<Option<bool>, String> {
    if example.has(SUCCESS) {
        return Ok(example.booleans(SUCCESS)?.last().copied());
    }
    let is_cut = example.has(IS_LAST) && example.booleans(IS_LAST)?.last() != Some(&true);
    if is_cut || !example.has(REWARD) {
        return Ok(None);
    }
    match example.floats(REWARD)?.last() {
        Some(reward) if !reward.is_finite() => {
            Err(format!("{REWARD}: expected a finite number, got {reward}"))
        }
        last => Ok(last.map(|reward| *reward > 0.0)),
    }
}

/// Splits a flattened list of floats into rows of seven.
fn read_rows(example: &Example, name: &str) -> Result<Vec<[f32; VALUES]>, String> {
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

/// The instruction, which RLDS repeats at each step: the first that is not empty, also of DROID's three.
fn read_instruction(example: &Example) -> Result<Option<String>, String> {
    let others = ["", "_2", "_3"].map(|suffix| format!("{INSTRUCTION}{suffix}"));
    for name in others.iter().filter(|name| example.has(name)) {
        let texts = example.bytes(name)?;
        if let Some(text) = texts.iter().find(|text| !text.is_empty()) {
            let text = String::from_utf8(text.clone());
            return text.map(Some).map_err(|error| format!("{name}: {error}"));
        }
    }
    Ok(None)
}

#[cfg(test)]
mod tests;
