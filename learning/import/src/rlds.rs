//! RLDS: TFRecord files of `tf.train.Example`, one example an episode, its steps flattened into lists.
//!
//! Features, as TensorFlow Datasets names them: `steps/action` (T x 7 float), `steps/observation/image_N` (T encoded
//! images), `steps/observation/state` (T x 7 float), `steps/language_instruction` (T texts), `steps/reward` (T float). In
//! Bridge V2 the state is the pose of the end effector (x y z in m, roll pitch yaw in rad) and the gripper (0 closed to 1
//! open), whatever the template text in `features.json` says; its differences are the actions.
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
    ActionMapping, ImportError, ValueSource,
    episode::{BRIDGE_PERIOD_NS, Camera, Episode, Found, Recorded, Unread, bridge_cameras},
    mapping::VALUES,
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
/// Of SOAR and others, whose episodes are not all demonstrations.
const SUCCESS: &str = "episode_metadata/success";

/// The episodes of these files.
pub(crate) fn episodes(files: Vec<PathBuf>, jpeg_quality: u8) -> impl Iterator<Item = Found> {
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
    /// Whether the count was compared.
    is_checked: bool,
}

impl Iterator for Episodes {
    type Item = Found;

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
        // The records after a damaged length cannot be found, and their number is part of that error.
        self.is_checked |= record.is_err();
        Some(record.map(|record| {
            let unread: Box<dyn Unread> = Box::new(InFile {
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
    /// Compares the count with the data set's own description: a file cut between two records looks whole otherwise.
    fn check_count(&self) -> Result<(), ImportError> {
        match split::expected_records(&self.file)? {
            Some(expected) if expected != self.found => Err(ImportError::corrupt(
                &*self.file,
                format!(
                    "expected {expected} episodes, as dataset_info.json says, got {}",
                    self.found
                ),
            )),
            _ => Ok(()),
        }
    }
}

/// An episode of a file, not read yet.
struct InFile {
    file: Rc<Path>,
    number: u64,
    record: Record,
    jpeg_quality: u8,
}

/// What an example has beside its pictures.
struct Content {
    recorded: Recorded,
    joints: Option<Vec<Vec<f64>>>,
}

impl Unread for InFile {
    fn recorded(&self, mapping: &ActionMapping) -> Result<Recorded, ImportError> {
        let record = self.record.read()?;
        let content = Example::parse(&record).and_then(|example| content(&example, mapping));
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

impl InFile {
    fn corrupt(&self, reason: &str) -> ImportError {
        ImportError::corrupt(&*self.file, format!("episode {}: {reason}", self.number))
    }

    fn episode(&self, example: &Example, mapping: &ActionMapping) -> Result<Episode, String> {
        let content = content(example, mapping)?;
        let mut notes = Vec::new();
        let cameras = match droid::is_droid(example) {
            true => droid::cameras(example, self.jpeg_quality, &mut notes)?,
            false => cameras(example, self.jpeg_quality, &mut notes)?,
        };
        Ok(Episode {
            source: self.file.to_path_buf(),
            record: Some(self.number),
            cameras,
            recorded: content.recorded,
            joints: content.joints.map(crate::droid::states::joints),
            instruction: instruction(example)?,
            success: success(example)?,
            notes,
        })
    }
}

/// Actions, states and joints.
fn content(example: &Example, mapping: &ActionMapping) -> Result<Content, String> {
    if droid::is_droid(example) {
        return droid::content(example, mapping);
    }
    let mut actions = rows(example, ACTION)?;
    let states = if example.has(STATE) {
        rows(example, STATE)?
    } else {
        Vec::new()
    };
    mapping.apply(&mut actions, &states, BRIDGE_PERIOD_NS as f64 / 1e9);
    Ok(Content {
        recorded: Recorded {
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

/// Bridge V2's cameras, by their numbers. One that was not there has one flat colour: it is left out, and named.
fn cameras(
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

/// Whether the task was done: what the metadata say, else the reward of the last step, 1 for a demonstration. None if the
/// example ends before the episode does.
fn success(example: &Example) -> Result<Option<bool>, String> {
    if example.has(SUCCESS) {
        return Ok(example.truths(SUCCESS)?.last().copied());
    }
    let is_cut = example.has(IS_LAST) && example.truths(IS_LAST)?.last() != Some(&true);
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

/// The instruction, which RLDS repeats at each step: the first that is not empty, of DROID's three too.
fn instruction(example: &Example) -> Result<Option<String>, String> {
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
