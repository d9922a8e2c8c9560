//! Test bags, message by message.

use std::path::Path;

use image::{Rgb, RgbImage};
use wm_bag::{BagWriter, WriterOptions};
use wm_motion::actions::ActionSpace;
use wm_msgs::{
    builtin_interfaces::Time,
    sensor_msgs::{CompressedImage, JointState},
    std_msgs::{Bool, Header, String as Text},
    wm_msgs::Action,
};

/// The topic of the camera.
pub const CAMERA: &str = "/camera/image_raw/compressed";
/// A millisecond in nanoseconds.
pub const MS: i64 = 1_000_000;
/// Far from 0, as in real recordings.
pub const START_NS: i64 = 1_700_000_000_000_000_000;

/// Writes a bag. Times are \[ms\] from its start.
pub struct Recorder {
    writer: BagWriter,
}

impl Recorder {
    /// Starts a bag.
    pub fn new(bag: &Path) -> Self {
        let writer = BagWriter::create(bag, WriterOptions::default()).unwrap();
        Self { writer }
    }

    /// Starts a bag that declares its action space.
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

    /// A PNG.
    pub fn picture(&mut self, topic: &str, ms: i64, data: Vec<u8>) {
        self.picture_late(topic, ms, ms, data);
    }

    /// A picture stamped earlier than recorded.
    pub fn picture_late(&mut self, topic: &str, ms: i64, logged_ms: i64, data: Vec<u8>) {
        self.picture_stamped(topic, START_NS + ms * MS, logged_ms, data);
    }

    /// A picture with any stamp \[ns\].
    pub fn picture_stamped(&mut self, topic: &str, stamp_ns: i64, logged_ms: i64, data: Vec<u8>) {
        let header = Header {
            stamp: Time::from_nanos(stamp_ns),
            frame_id: String::new(),
        };
        let picture = CompressedImage {
            header,
            format: "png".into(),
            data,
        };
        self.writer
            .write(topic, &picture, Self::logged(logged_ms))
            .unwrap();
    }

    /// A Bridge V2 action that moves by `dx`.
    pub fn action(&mut self, ms: i64, dx: f32) {
        self.values(ms, vec![dx, 0., 0., 0., 0., 0., 1.]);
    }

    /// An action.
    pub fn values(&mut self, ms: i64, values: Vec<f32>) {
        let action = Action {
            header: Self::header(ms),
            values,
        };
        self.writer
            .write("/wm/action", &action, Self::logged(ms))
            .unwrap();
    }

    /// An action and a state with an invalid nanosec (above a second).
    pub fn malformed(&mut self, ms: i64) {
        let mut header = Self::header(ms);
        header.stamp.nanosec += 1_000_000_000;
        let action = Action {
            header: header.clone(),
            values: vec![9.0; 7],
        };
        let at = Self::logged(ms);
        self.writer.write("/wm/action", &action, at).unwrap();
        let state = JointState {
            header,
            ..JointState::default()
        };
        self.writer.write("/joint_states", &state, at).unwrap();
    }

    /// A joint state.
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

    /// A string.
    pub fn text(&mut self, topic: &str, ms: i64, text: &str) {
        let text = Text { data: text.into() };
        self.writer.write(topic, &text, Self::logged(ms)).unwrap();
    }

    /// A success message.
    pub fn success(&mut self, ms: i64, data: bool) {
        let at = Self::logged(ms);
        self.writer
            .write("/task/success", &Bool { data }, at)
            .unwrap();
    }

    /// Frames and actions at 5 Hz.
    pub fn run(&mut self, frames: std::ops::Range<i64>) {
        for frame in frames {
            self.frame(CAMERA, frame * 200, frame as u8);
            self.action(frame * 200, 0.01);
        }
    }

    /// Finishes the bag.
    pub fn finish(self) {
        self.writer.finish().unwrap();
    }
}
