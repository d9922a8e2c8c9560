//! An episode as a bag, in the layout of the imported data sets: camera, actions, instruction, success.

use std::path::{Path, PathBuf};

use wm_bag::{BagWriter, QosProfile, WriterOptions};
use wm_msgs::{
    builtin_interfaces::Time,
    sensor_msgs::CompressedImage,
    std_msgs::{Bool, String as Text},
    wm_msgs::{Action, Prediction},
};

use super::{EnvError, start::INSTRUCTION};

const CAMERA: &str = "/camera/image_raw/compressed";
const ACTION: &str = "/wm/action";
const PREDICTED: &str = "/wm/predicted";
const SUCCESS: &str = "/task/success";
/// Most bags of one name; more are a client's mistake.
const MOST_OF_A_NAME: u32 = 100_000;

/// A bag that is being written.
pub(super) struct Recording {
    writer: BagWriter,
    path: PathBuf,
    newest_ns: u64,
}

impl Recording {
    /// Begins the bag `folder`/`name`, or `name_2`, `name_3` and so on if that already exists.
    pub fn begin(
        folder: &Path,
        name: &str,
        instruction: &str,
        begin: Time,
        notes: &[(&str, String)],
    ) -> Result<Self, EnvError> {
        let mut path = folder.join(name);
        let mut number = 2;
        while path.exists() && number < MOST_OF_A_NAME {
            path = folder.join(format!("{name}_{number}"));
            number += 1;
        }
        let mut writer = BagWriter::create(&path, WriterOptions::default())?;
        for (key, value) in notes {
            writer.note(key, value.clone());
        }
        writer.add_topic::<CompressedImage>(CAMERA, QosProfile::sensor_data())?;
        writer.add_topic::<Action>(ACTION, QosProfile::reliable())?;
        writer.add_topic::<Prediction>(PREDICTED, QosProfile::sensor_data())?;
        let newest_ns = nanos(begin);
        if !instruction.is_empty() {
            writer.add_topic::<Text>(INSTRUCTION, QosProfile::latched())?;
            let data = instruction.to_owned();
            writer.write(INSTRUCTION, &Text { data }, newest_ns)?;
        }
        Ok(Self {
            writer,
            path,
            newest_ns,
        })
    }

    pub fn observation(&mut self, image: &CompressedImage) -> Result<(), EnvError> {
        self.newest_ns = nanos(image.header.stamp);
        Ok(self.writer.write(CAMERA, image, self.newest_ns)?)
    }

    pub fn action(&mut self, action: &Action) -> Result<(), EnvError> {
        Ok(self
            .writer
            .write(ACTION, action, nanos(action.header.stamp))?)
    }

    pub fn prediction(&mut self, prediction: &Prediction) -> Result<(), EnvError> {
        let log_time_ns = nanos(prediction.header.stamp);
        Ok(self.writer.write(PREDICTED, prediction, log_time_ns)?)
    }

    /// Ends the bag; gives its path.
    pub fn finish(mut self, success: Option<bool>) -> Result<PathBuf, EnvError> {
        if let Some(data) = success {
            self.writer
                .add_topic::<Bool>(SUCCESS, QosProfile::latched())?;
            self.writer.write(SUCCESS, &Bool { data }, self.newest_ns)?;
        }
        self.writer.finish()?;
        Ok(self.path)
    }
}

/// The bag's own time; stamps before 1970 do not come from a clock.
fn nanos(stamp: Time) -> u64 {
    u64::try_from(stamp.to_nanos()).unwrap_or(0)
}
