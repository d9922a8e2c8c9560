//! Bags for tests, message by message.

use std::path::{Path, PathBuf};

use image::{Rgb, RgbImage};
use wm_bag::{BagWriter, WriterOptions};
use wm_motion::actions::ActionSpace;
use wm_msgs::{
    builtin_interfaces::Time,
    sensor_msgs::{CompressedImage, JointState},
    std_msgs::{Bool, Header, String as Text},
    wm_msgs::Action,
};

use super::super::{Data, DataOptions, DatasetError, Episode, Manifest, store::read_manifest};

pub(super) const CAMERA: &str = "/camera/image_raw/compressed";
pub(super) const MS: i64 = 1_000_000;
/// As the recordings of robots have it: far from 0.
pub(super) const START_NS: i64 = 1_700_000_000_000_000_000;

/// Writes a bag. Times are \[ms\] since its start.
pub(super) struct Recorder {
    writer: BagWriter,
}

impl Recorder {
    pub fn new(bag: &Path) -> Self {
        let writer = BagWriter::create(bag, WriterOptions::default()).unwrap();
        Self { writer }
    }

    pub fn with_space(bag: &Path, space: &ActionSpace) -> Self {
        let mut recorder = Self::new(bag);
        let note = space.to_note().unwrap();
        recorder.writer.note(ActionSpace::NOTE, note);
        recorder
    }

    fn header(ms: i64) -> Header {
        Header {
            stamp: Time::from_nanos(START_NS + ms * MS),
            frame_id: String::new(),
        }
    }

    fn logged(ms: i64) -> u64 {
        (START_NS + ms * MS) as u64
    }

    /// A picture of one colour.
    pub fn frame(&mut self, topic: &str, ms: i64, red: u8) {
        let picture = RgbImage::from_pixel(32, 32, Rgb([red, 20, 30]));
        self.picture(topic, ms, super::png(picture.into()));
    }

    pub fn picture(&mut self, topic: &str, ms: i64, data: Vec<u8>) {
        self.picture_late(topic, ms, ms, data);
    }

    /// A picture whose stamp is not the time of its recording.
    pub fn picture_late(&mut self, topic: &str, ms: i64, logged_ms: i64, data: Vec<u8>) {
        let picture = CompressedImage {
            header: Self::header(ms),
            format: "png".into(),
            data,
        };
        self.writer
            .write(topic, &picture, Self::logged(logged_ms))
            .unwrap();
    }

    /// An action of Bridge V2's that moves by `dx`.
    pub fn action(&mut self, ms: i64, dx: f32) {
        self.values(ms, vec![dx, 0., 0., 0., 0., 0., 1.]);
    }

    pub fn values(&mut self, ms: i64, values: Vec<f32>) {
        let action = Action {
            header: Self::header(ms),
            values,
        };
        self.writer
            .write("/wm/action", &action, Self::logged(ms))
            .unwrap();
    }

    pub fn joints(&mut self, ms: i64, names: &[&str], position: Vec<f64>, velocity: Vec<f64>) {
        let state = JointState {
            header: Self::header(ms),
            name: names.iter().map(|name| (*name).to_owned()).collect(),
            position,
            velocity,
            ..JointState::default()
        };
        let at = Self::logged(ms);
        self.writer.write("/joint_states", &state, at).unwrap();
    }

    pub fn text(&mut self, topic: &str, ms: i64, text: &str) {
        let text = Text { data: text.into() };
        self.writer.write(topic, &text, Self::logged(ms)).unwrap();
    }

    pub fn success(&mut self, ms: i64, data: bool) {
        let at = Self::logged(ms);
        self.writer
            .write("/task/success", &Bool { data }, at)
            .unwrap();
    }

    /// Frames and actions every 200 ms, which are 5 Hz.
    pub fn run(&mut self, frames: std::ops::Range<i64>) {
        for frame in frames {
            self.frame(CAMERA, frame * 200, frame as u8);
            self.action(frame * 200, 0.01);
        }
    }

    pub fn finish(self) {
        self.writer.finish().unwrap();
    }
}

/// What comes of bags with some options.
pub(super) struct Outcome {
    pub data: Data,
    pub manifest: Manifest,
}

impl Outcome {
    /// Opens `bags` at 16x16 without validation, and a new cache.
    pub fn of(bags: &Path, options: DataOptions) -> Result<Self, DatasetError> {
        let cache = tempfile::tempdir().unwrap();
        let options = DataOptions {
            validation: options.validation.or(Some(0.0)),
            ..options
        };
        let paths = [bags.to_owned()];
        let data = Data::open(&paths, (16, 16), cache.path(), &options)?;
        let entries = std::fs::read_dir(cache.path()).unwrap();
        let made: Vec<PathBuf> = entries.map(|entry| entry.unwrap().path()).collect();
        let manifest = read_manifest(&made[0])?;
        Ok(Self { data, manifest })
    }

    pub fn episodes(&self) -> &[Episode] {
        self.data.training.episodes()
    }

    pub fn lengths(&self) -> Vec<usize> {
        self.episodes().iter().map(|e| e.frame_count).collect()
    }

    /// What was left out, a line each.
    pub fn left_out(&self) -> String {
        let left = self.manifest.left_out.iter();
        left.map(|left| format!("{left}\n")).collect()
    }

    /// The red of each frame, which is its number in the recording.
    pub fn reds(&self) -> Vec<u8> {
        let training = &self.data.training;
        (0..training.frame_count())
            .map(|frame| training.frame(frame).unwrap()[0])
            .collect()
    }
}
