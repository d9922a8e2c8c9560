use std::path::{Path, PathBuf};

use wm_bag::{BagWriter, ORIGIN, QosProfile, WriterOptions};
use wm_motion::actions::{ActionError, ActionSpace, ActionSurvey};
use wm_msgs::{
    builtin_interfaces::Time,
    geometry_msgs::{Point, Pose, PoseStamped, Quaternion},
    sensor_msgs::{CompressedImage, JointState},
    std_msgs::{Bool, Float32, Header, String as Text},
    wm_msgs::Action,
};

use crate::{
    ActionMapping, ImportError, imported::write_whole, mapping::VALUES, remedy::ValueSource,
};

/// Bridge V2 is controlled and recorded at 5 Hz (BridgeData V2, arXiv 2308.12952, section 3).
pub(crate) const BRIDGE_PERIOD_NS: u64 = 200_000_000;
/// The base frame of the robot (REP-105).
const BASE_FRAME: &str = "base_link";

/// An episode that has not been read.
pub(crate) trait UnreadEpisode {
    /// The origin for the bag's notes, for a data set at `src`.
    fn origin(&self, src: &Path) -> String;
    /// Reads actions and states, without pictures.
    fn recorded(&self, mapping: &ActionMapping) -> Result<Trajectory, ImportError>;
    fn read(&self, mapping: &ActionMapping) -> Result<Episode, ImportError>;
}

/// An episode, or the fault of a part of the data set.
pub(crate) type FoundEpisode = Result<Box<dyn UnreadEpisode>, ImportError>;

/// Actions and states of an episode.
#[derive(Clone, Debug, Default)]
pub(crate) struct Trajectory {
    /// Frame period.
    pub period_ns: u64,
    /// By frame: dx dy dz in m, droll dpitch dyaw in rad, gripper 0 closed to 1 open.
    pub actions: Vec<[f32; VALUES]>,
    /// By frame, or empty: x y z in m, roll pitch yaw in rad, gripper 0 closed to 1 open.
    pub states: Vec<[f32; VALUES]>,
    /// Origin of the actions. Actions that were computed from the states cannot be checked against them.
    pub source: ValueSource,
}

impl Trajectory {
    /// Adds it to a survey of Bridge V2's kinds of values.
    pub fn survey(&self, survey: &mut ActionSurvey) {
        match self.source.is_of_states {
            true => survey.add(&self.actions, &[] as &[[f32; VALUES]]),
            false => survey.add(&self.actions, &self.states),
        }
    }

    /// A survey of this episode alone.
    pub fn alone(&self) -> ActionSurvey {
        let mut survey = ActionSurvey::new(ActionSpace::bridge(), self.rate());
        self.survey(&mut survey);
        survey
    }

    /// Bridge V2's actions. A faster camera is subsampled to their rate; a slower one sets it.
    ///
    /// # Errors
    /// [`ActionError::Space`] if the frames are more than 100 s apart.
    pub fn space(&self) -> Result<ActionSpace, ActionError> {
        let bridge = ActionSpace::bridge();
        match bridge.is_fast_enough(self.rate()) {
            true => Ok(bridge),
            // Videos of one data set differ by rounding.
            false => bridge.at_rate((self.rate() * 100.0).round() / 100.0),
        }
    }

    /// Frames per second.
    pub fn rate(&self) -> f64 {
        1e9 / self.period_ns.max(1) as f64
    }
}

/// The frames of a camera.
#[derive(Debug)]
pub(crate) struct Camera {
    /// Namespace of its topics.
    pub name: String,
    /// JPEG.
    pub frames: Vec<Vec<u8>>,
}

#[derive(Debug)]
pub(crate) struct Joints {
    pub names: Vec<String>,
    /// By frame and name, in rad.
    pub positions: Vec<Vec<f64>>,
}

#[derive(Debug, Default)]
pub(crate) struct Episode {
    /// The source file.
    pub source: PathBuf,
    pub recorded: Trajectory,
    /// Each has one frame per action.
    pub cameras: Vec<Camera>,
    pub joints: Option<Joints>,
    pub instruction: Option<String>,
    /// Whether the task succeeded, if known.
    pub success: Option<bool>,
    /// Remarks, with equal texts for equal causes.
    pub notes: Vec<String>,
}

impl Episode {
    /// Checks the parts against each other, and the actions against the limits of an arm.
    pub fn check(self) -> Result<Self, ImportError> {
        let Trajectory {
            actions, states, ..
        } = &self.recorded;
        let frames = actions.len();
        let corrupt = |reason: String| Err(ImportError::corrupt(&self.source, reason));
        if frames == 0 || self.cameras.is_empty() {
            return corrupt(format!(
                "the episode has {frames} actions and {} cameras",
                self.cameras.len()
            ));
        }
        for camera in &self.cameras {
            if camera.frames.len() != frames {
                return corrupt(format!(
                    "camera {:?} has {} frames for {frames} actions",
                    camera.name,
                    camera.frames.len()
                ));
            }
        }
        if !states.is_empty() && states.len() != frames {
            return corrupt(format!("{} states for {frames} actions", states.len()));
        }
        if let Some(joints) = &self.joints {
            if joints.positions.len() != frames {
                return corrupt(format!(
                    "{} rows of joints for {frames} actions",
                    joints.positions.len()
                ));
            }
            if let Some(row) = joints.positions.iter().position(|row| {
                row.len() != joints.names.len() || row.iter().any(|value| !value.is_finite())
            }) {
                return corrupt(format!(
                    "joints {row}: expected {} finite values, got {:?}",
                    joints.names.len(),
                    joints.positions.get(row)
                ));
            }
        }
        for (what, rows) in [("action", actions), ("state", states)] {
            if let Some(row) = rows
                .iter()
                .position(|row| row.iter().any(|value| !value.is_finite()))
            {
                return corrupt(format!("{what} {row} is not finite: {:?}", rows.get(row)));
            }
        }
        if let Some(reason) = self.recorded.source.contradiction(&self.recorded.alone()) {
            return corrupt(reason);
        }
        Ok(self)
    }

    /// Writes the episode as a bag with its first frame at `start_ns`; an incomplete bag is removed.
    pub fn write(&self, bag: &Path, start_ns: u64, origin: &str) -> Result<(), ImportError> {
        write_whole(bag, |bag| self.write_to(bag, start_ns, origin))
    }

    fn write_to(&self, bag: &Path, start_ns: u64, origin: &str) -> Result<(), ImportError> {
        let mut writer = BagWriter::create(bag, WriterOptions::default())?;
        writer.note(ORIGIN, origin);
        writer.note(ActionSpace::NOTE, self.recorded.space()?.to_note()?);
        let cameras: Vec<(String, String)> = self
            .cameras
            .iter()
            .map(|camera| (image_topic(&camera.name), optical_frame(&camera.name)))
            .collect();
        for (topic, _) in &cameras {
            writer.add_topic::<CompressedImage>(topic, QosProfile::sensor_data())?;
        }
        if let Some(instruction) = &self.instruction {
            let topic = "/task/instruction";
            writer.add_topic::<Text>(topic, QosProfile::latched())?;
            writer.write(
                topic,
                &Text {
                    data: instruction.clone(),
                },
                start_ns,
            )?;
        }
        let mut stamp_ns = start_ns;
        for (step, action) in self.recorded.actions.iter().enumerate() {
            stamp_ns = start_ns + step as u64 * self.recorded.period_ns;
            // BagWriter rejects times past i64, and names the topic.
            let stamp = Time::from_nanos(i64::try_from(stamp_ns).unwrap_or(i64::MAX));
            for ((topic, frame_id), camera) in cameras.iter().zip(&self.cameras) {
                let Some(data) = camera.frames.get(step) else {
                    continue;
                };
                let header = Header {
                    stamp,
                    frame_id: frame_id.clone(),
                };
                let image = CompressedImage {
                    header,
                    format: "jpeg".to_owned(),
                    data: data.clone(),
                };
                writer.write(topic, &image, stamp_ns)?;
            }
            let header = Header {
                stamp,
                frame_id: BASE_FRAME.to_owned(),
            };
            if let Some([x, y, z, roll, pitch, yaw, gripper]) = self.recorded.states.get(step) {
                let pose = Pose {
                    position: Point {
                        x: f64::from(*x),
                        y: f64::from(*y),
                        z: f64::from(*z),
                    },
                    orientation: orientation([*roll, *pitch, *yaw]),
                };
                let pose = PoseStamped {
                    header: header.clone(),
                    pose,
                };
                writer.write("/arm/end_effector_pose", &pose, stamp_ns)?;
                writer.write("/arm/gripper", &Float32 { data: *gripper }, stamp_ns)?;
            }
            let joints = self.joints.as_ref();
            if let Some((joints, position)) =
                joints.and_then(|joints| Some((joints, joints.positions.get(step)?)))
            {
                let state = JointState {
                    header: header.clone(),
                    name: joints.names.clone(),
                    position: position.clone(),
                    ..JointState::default()
                };
                writer.write("/joint_states", &state, stamp_ns)?;
            }
            writer.write(
                "/wm/action",
                &Action {
                    header,
                    values: action.to_vec(),
                },
                stamp_ns,
            )?;
        }
        if let Some(success) = self.success {
            let topic = "/task/success";
            writer.add_topic::<Bool>(topic, QosProfile::latched())?;
            writer.write(topic, &Bool { data: success }, stamp_ns)?;
        }
        writer.finish()?;
        Ok(())
    }
}

/// Bridge V2's cameras, named by their numbers.
pub(crate) fn bridge_cameras(cameras: Vec<Vec<Vec<u8>>>) -> Vec<Camera> {
    let named = cameras.into_iter().enumerate().map(|(number, frames)| {
        let name = match number {
            0 => "camera".to_owned(),
            _ => format!("camera_{number}"),
        };
        Camera { name, frames }
    });
    named.collect()
}

/// The topic of a camera's compressed frames.
fn image_topic(camera: &str) -> String {
    format!("/{camera}/image_raw/compressed")
}

fn optical_frame(camera: &str) -> String {
    format!("{camera}_optical_frame")
}

/// Converts roll, pitch and yaw about fixed axes (REP-103), in rad, to a unit quaternion.
fn orientation(roll_pitch_yaw: [f32; 3]) -> Quaternion {
    let [(sr, cr), (sp, cp), (sy, cy)] =
        roll_pitch_yaw.map(|angle| (f64::from(angle) / 2.0).sin_cos());
    Quaternion {
        x: sr * cp * cy - cr * sp * sy,
        y: cr * sp * cy + sr * cp * sy,
        z: cr * cp * sy - sr * sp * cy,
        w: cr * cp * cy + sr * sp * sy,
    }
}

#[cfg(test)]
mod tests {
    use std::f32::consts::FRAC_PI_2;

    use wm_bag::{BagReader, Durability};

    use super::*;

    fn episode(frames: usize) -> Episode {
        Episode {
            source: "made.up".into(),
            cameras: bridge_cameras(vec![vec![vec![1, 2, 3]; frames], vec![vec![4]; frames]]),
            recorded: Trajectory {
                period_ns: BRIDGE_PERIOD_NS,
                actions: (0..frames)
                    .map(|step| [step as f32 * 0.01; VALUES])
                    .collect(),
                states: vec![[0.1, 0.2, 0.3, 0.0, 0.0, FRAC_PI_2, 1.0]; frames],
                source: ValueSource::default(),
            },
            joints: Some(Joints {
                names: vec!["shoulder".into(), "elbow".into()],
                positions: (0..frames).map(|step| vec![step as f64, -0.5]).collect(),
            }),
            instruction: Some("lift the lid".into()),
            success: Some(true),
            ..Episode::default()
        }
    }

    #[test]
    fn episode_becomes_the_documented_topics() {
        let dir = tempfile::tempdir().unwrap();
        let bag = dir.path().join("episode_000000");
        episode(3)
            .check()
            .unwrap()
            .write(&bag, 1_000_000_000, "made.up")
            .unwrap();
        let reader = BagReader::open(&bag).unwrap();
        assert_eq!(reader.note(ORIGIN), Some("made.up"));
        let topics: Vec<(&str, &str, u64)> = reader
            .topics()
            .iter()
            .map(|topic| (&*topic.name, &*topic.type_name, topic.message_count))
            .collect();
        assert_eq!(
            topics,
            [
                ("/arm/end_effector_pose", "geometry_msgs/msg/PoseStamped", 3),
                ("/arm/gripper", "std_msgs/msg/Float32", 3),
                (
                    "/camera/image_raw/compressed",
                    "sensor_msgs/msg/CompressedImage",
                    3
                ),
                (
                    "/camera_1/image_raw/compressed",
                    "sensor_msgs/msg/CompressedImage",
                    3
                ),
                ("/joint_states", "sensor_msgs/msg/JointState", 3),
                ("/task/instruction", "std_msgs/msg/String", 1),
                ("/task/success", "std_msgs/msg/Bool", 1),
                ("/wm/action", "wm_msgs/msg/Action", 3),
            ]
        );
        assert_eq!(
            reader
                .topic("/task/instruction")
                .unwrap()
                .qos()
                .unwrap()
                .durability,
            Durability::TransientLocal
        );
        let actions: Vec<Action> = reader
            .messages()
            .only_topics(["/wm/action"])
            .map(|message| message.unwrap().decode().unwrap())
            .collect();
        assert_eq!(
            actions[2].header.stamp,
            Time {
                sec: 1,
                nanosec: 400_000_000
            }
        );
        assert_eq!(actions[2].values, [0.02; VALUES]);
        let pose = reader
            .messages()
            .find(|message| &*message.as_ref().unwrap().topic == "/arm/end_effector_pose");
        let pose: PoseStamped = pose.unwrap().unwrap().decode().unwrap();
        let turn = pose.pose.orientation;
        assert!(
            (turn.z - 0.5f64.sqrt()).abs() < 1e-6 && (turn.w - 0.5f64.sqrt()).abs() < 1e-6,
            "{turn:?}"
        );
        assert!((pose.pose.position.y - 0.2).abs() < 1e-6);
    }

    #[test]
    fn inconsistent_parts_are_named() {
        let reason = |change: fn(&mut Episode)| {
            let mut changed = episode(3);
            change(&mut changed);
            changed.check().unwrap_err().to_string()
        };
        assert!(
            reason(|episode| episode.cameras[1].frames.truncate(2))
                .contains("camera \"camera_1\" has 2 frames for 3 actions")
        );
        assert!(
            reason(|episode| episode.recorded.states.truncate(2))
                .contains("2 states for 3 actions")
        );
        assert!(
            reason(|episode| episode.recorded.actions[1][2] = f32::NAN)
                .contains("action 1 is not finite")
        );
        assert!(
            reason(|episode| episode.joints.as_mut().unwrap().positions[2].clear())
                .contains("joints 2: expected 2 finite values")
        );
        assert!(reason(|episode| episode.recorded.actions.clear()).contains("0 actions"));
        let jump = reason(|episode| episode.recorded.actions[1][0] = 0.6);
        assert!(
            jump.contains("dx: measured 0 to 0.6 m; a translation delta at 5 Hz is at most 0.5 m"),
            "{jump}"
        );
    }
}
