//! Synthetic episodes as bags, and reading them back.

use std::path::Path;

use image::{ExtendedColorType, ImageEncoder as _, Rgb, RgbImage, codecs::png::PngEncoder};
use wm_bag::{BagReader, BagWriter, QosProfile, WriterOptions};
use wm_motion::actions::ActionSpace;
use wm_msgs::{
    Message,
    builtin_interfaces::Time,
    geometry_msgs::{Point, Pose, PoseStamped, Quaternion},
    sensor_msgs::{CompressedImage, JointState},
    std_msgs::{Bool, Float32, Header, String as Text},
    wm_msgs::Action,
};

pub const START_NS: u64 = 1_750_000_000_123_456_789;
pub const SIZE: (u32, u32) = (64, 48);
pub const CAMERAS: [&str; 2] = ["front", "wrist"];

/// An episode.
#[derive(Clone, Debug, PartialEq)]
pub struct Episode {
    pub stamps: Vec<u64>,
    pub actions: Vec<Vec<f32>>,
    pub joints: Vec<Vec<f32>>,
    pub grippers: Vec<f32>,
    pub task: String,
    pub success: bool,
}

impl Episode {
    /// An episode with these actions at 5 Hz.
    pub fn of(actions: Vec<Vec<f32>>, task: &str, success: bool) -> Self {
        let frames = actions.len();
        Self {
            stamps: (0..frames as u64)
                .map(|frame| START_NS + frame * 200_000_000)
                .collect(),
            joints: actions
                .iter()
                .map(|action| vec![action[0] * 0.5, 0.25])
                .collect(),
            grippers: (0..frames).map(|frame| frame as f32 / 8.0).collect(),
            actions,
            task: task.into(),
            success,
        }
    }

    /// An episode of `frames` frames with possible actions.
    pub fn made(frames: usize, seed: f32) -> Self {
        let action = |frame: usize| {
            (0..7)
                .map(|axis| seed * 0.02 + (frame * 7 + axis) as f32 * 0.001)
                .collect()
        };
        Self::of((0..frames).map(action).collect(), "lift the lid", true)
    }

    pub fn write(&self, bag: &Path) {
        self.write_with(bag, None);
    }

    /// Writes it with an action space.
    pub fn write_with(&self, bag: &Path, actions: Option<&ActionSpace>) {
        let mut writer = BagWriter::create(bag, WriterOptions::default()).unwrap();
        if let Some(space) = actions {
            writer.note(ActionSpace::NOTE, space.to_note().unwrap());
        }
        writer
            .add_topic::<Text>("/task/instruction", QosProfile::latched())
            .unwrap();
        let text = Text {
            data: self.task.clone(),
        };
        writer
            .write("/task/instruction", &text, self.stamps[0])
            .unwrap();
        for (frame, stamp_ns) in self.stamps.iter().enumerate() {
            let header = Header {
                stamp: Time::from_nanos(*stamp_ns as i64),
                frame_id: "base_link".into(),
            };
            for (number, camera) in CAMERAS.iter().enumerate() {
                let image = CompressedImage {
                    header: header.clone(),
                    format: "png".into(),
                    data: png(&picture(number, frame)),
                };
                writer
                    .write(
                        &format!("/{camera}/image_raw/compressed"),
                        &image,
                        *stamp_ns,
                    )
                    .unwrap();
            }
            let joints = JointState {
                header: header.clone(),
                name: vec!["shoulder".into(), "elbow".into()],
                position: self.joints[frame]
                    .iter()
                    .map(|angle| f64::from(*angle))
                    .collect(),
                ..JointState::default()
            };
            writer.write("/joint_states", &joints, *stamp_ns).unwrap();
            let pose = PoseStamped {
                header: header.clone(),
                pose: pose(frame),
            };
            writer
                .write("/arm/end_effector_pose", &pose, *stamp_ns)
                .unwrap();
            writer
                .write(
                    "/arm/gripper",
                    &Float32 {
                        data: self.grippers[frame],
                    },
                    *stamp_ns,
                )
                .unwrap();
            let action = Action {
                header,
                values: self.actions[frame].clone(),
            };
            writer.write("/wm/action", &action, *stamp_ns).unwrap();
        }
        let last = self.stamps[self.stamps.len() - 1];
        writer
            .write("/task/success", &Bool { data: self.success }, last)
            .unwrap();
        writer.finish().unwrap();
    }

    /// Reads a bag; checks its poses.
    pub fn read(bag: &Path) -> Self {
        let joints: Vec<JointState> = messages(bag, "/joint_states");
        for state in &joints {
            assert_eq!(state.name, ["shoulder", "elbow"]);
        }
        let poses: Vec<PoseStamped> = messages(bag, "/arm/end_effector_pose");
        for (frame, got) in poses.iter().enumerate() {
            let expected = pose(frame);
            assert_eq!(got.pose.position.x, f64::from(expected.position.x as f32));
            assert_eq!(
                got.pose.orientation.w,
                f64::from(expected.orientation.w as f32)
            );
        }
        let actions: Vec<Action> = messages(bag, "/wm/action");
        assert_eq!(poses.len(), actions.len());
        Self {
            stamps: actions
                .iter()
                .map(|action| action.header.stamp.to_nanos() as u64)
                .collect(),
            actions: actions.into_iter().map(|action| action.values).collect(),
            joints: joints
                .into_iter()
                .map(|state| {
                    state
                        .position
                        .into_iter()
                        .map(|angle| angle as f32)
                        .collect()
                })
                .collect(),
            grippers: messages::<Float32>(bag, "/arm/gripper")
                .iter()
                .map(|gripper| gripper.data)
                .collect(),
            task: messages::<Text>(bag, "/task/instruction")[0].data.clone(),
            success: messages::<Bool>(bag, "/task/success")[0].data,
        }
    }
}

fn pose(frame: usize) -> Pose {
    let step = frame as f64;
    Pose {
        position: Point {
            x: 0.3 + step / 3.0,
            y: -0.1,
            z: 0.2,
        },
        orientation: Quaternion {
            x: 0.6,
            y: 0.0,
            z: 0.0,
            w: 0.8,
        },
    }
}

pub fn messages<M: Message>(bag: &Path, topic: &str) -> Vec<M> {
    let messages = BagReader::open(bag)
        .unwrap()
        .messages()
        .only_topics([topic]);
    messages
        .map(|message| message.unwrap().decode().unwrap())
        .collect()
}

/// A square that moves over a gradient, different in each camera.
pub fn picture(camera: usize, frame: usize) -> RgbImage {
    RgbImage::from_fn(SIZE.0, SIZE.1, |x, y| {
        if ((x / 16) as usize, (y / 16) as usize) == (frame % 4, camera) {
            Rgb([240, 210, 50])
        } else {
            Rgb([40 + (frame as u8 % 16) * 8, (x * 3) as u8, 120])
        }
    })
}

fn png(picture: &RgbImage) -> Vec<u8> {
    let mut bytes = Vec::new();
    PngEncoder::new(&mut bytes)
        .write_image(picture.as_raw(), SIZE.0, SIZE.1, ExtendedColorType::Rgb8)
        .unwrap();
    bytes
}

/// Peak signal-to-noise ratio over RGB in dB.
pub fn psnr(a: &RgbImage, b: &RgbImage) -> f64 {
    assert_eq!(a.dimensions(), b.dimensions());
    let squares = a.as_raw().iter().zip(b.as_raw());
    let sum: f64 = squares
        .map(|(a, b)| (f64::from(*a) - f64::from(*b)).powi(2))
        .sum();
    10.0 * (255.0 * 255.0 * a.as_raw().len() as f64 / sum.max(1e-9)).log10()
}
