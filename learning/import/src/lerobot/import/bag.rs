use std::path::Path;

use crate::imported::write_whole;
use wm_bag::{BagWriter, ORIGIN, QosProfile, WriterOptions};
use wm_motion::actions::ActionSpace;
use wm_msgs::{
    builtin_interfaces::Time,
    geometry_msgs::{Point, Pose, PoseStamped, Quaternion},
    sensor_msgs::{CompressedImage, JointState},
    std_msgs::{Bool, Float32, Header, String as Text},
    wm_msgs::Action,
};

use super::episode::Episode;
use crate::lerobot::{
    LeRobotError,
    topics::{
        ACTION_TOPIC, GRIPPER_NAME, GRIPPER_TOPIC, INSTRUCTION_TOPIC, JOINTS_TOPIC, POSE_NAMES,
        POSE_TOPIC, SUCCESS_TOPIC,
    },
};

/// The base frame of the robot (REP-105).
const BASE_FRAME: &str = "base_link";

/// Writes an episode as a bag with the note `origin` and its first frame at `start_ns`; an incomplete bag is removed.
pub(super) fn write(
    episode: &Episode,
    actions: Option<&ActionSpace>,
    bag: &Path,
    start_ns: u64,
    origin: &str,
) -> Result<(), LeRobotError> {
    write_whole(bag, |bag| write_to(episode, actions, bag, start_ns, origin))
}

fn write_to(
    episode: &Episode,
    actions: Option<&ActionSpace>,
    bag: &Path,
    start_ns: u64,
    origin: &str,
) -> Result<(), LeRobotError> {
    let mut writer = BagWriter::create(bag, WriterOptions::default())?;
    writer.note(ORIGIN, origin);
    if let Some(space) = actions {
        writer.note(ActionSpace::NOTE, space.to_note()?);
    }
    let state = StateColumns::of(&episode.state_names);
    let cameras = episode.cameras.iter().map(|camera| {
        let topic = format!("/{}/image_raw/compressed", camera.name);
        (topic, format!("{}_optical_frame", camera.name), camera)
    });
    let cameras: Vec<_> = cameras.collect();
    for (topic, _, _) in &cameras {
        writer.add_topic::<CompressedImage>(topic, QosProfile::sensor_data())?;
    }
    writer.add_topic::<Text>(INSTRUCTION_TOPIC, QosProfile::latched())?;
    let mut stamp_ns = start_ns;
    let mut tasks = episode.tasks.iter().peekable();
    for ((step, since_ns), frame) in episode.timing.stamps_ns.iter().enumerate().zip(0u64..) {
        stamp_ns = start_ns.saturating_add(*since_ns);
        let header = |frame_id: &str| Header {
            // BagWriter rejects times past i64, and names the topic.
            stamp: Time::from_nanos(i64::try_from(stamp_ns).unwrap_or(i64::MAX)),
            frame_id: frame_id.to_owned(),
        };
        if let Some((_, task)) = tasks.next_if(|(from, _)| *from <= frame) {
            let text = Text { data: task.clone() };
            writer.write(INSTRUCTION_TOPIC, &text, stamp_ns)?;
        }
        for (topic, frame_id, camera) in &cameras {
            if let Some(data) = camera.frames.get(step) {
                let image = CompressedImage {
                    header: header(frame_id),
                    format: camera.format.to_owned(),
                    data: data.clone(),
                };
                writer.write(topic, &image, stamp_ns)?;
            }
        }
        if let Some(row) = episode.states.get(step) {
            state.write(&mut writer, &episode.state_names, row, &header, stamp_ns)?;
        }
        if let Some(values) = episode.actions.get(step) {
            let action = Action {
                header: header(BASE_FRAME),
                values: values.clone(),
            };
            writer.write(ACTION_TOPIC, &action, stamp_ns)?;
        }
    }
    if let Some(data) = episode.success {
        writer.add_topic::<Bool>(SUCCESS_TOPIC, QosProfile::latched())?;
        writer.write(SUCCESS_TOPIC, &Bool { data }, stamp_ns)?;
    }
    writer.finish()?;
    Ok(())
}

/// The topics of a state's values.
struct StateColumns {
    joints: Vec<usize>,
    pose: Option<[usize; POSE_NAMES.len()]>,
    gripper: Option<usize>,
}

impl StateColumns {
    /// By our names of the pose and the gripper; all others are joints.
    fn of(names: &[String]) -> Self {
        let find = |name: &str| names.iter().position(|known| known == name);
        let pose: Option<Vec<usize>> = POSE_NAMES.iter().map(|name| find(name)).collect();
        let pose: Option<[usize; POSE_NAMES.len()]> = pose.and_then(|pose| pose.try_into().ok());
        let gripper = find(GRIPPER_NAME);
        let is_taken =
            |at: usize| gripper == Some(at) || pose.is_some_and(|pose| pose.contains(&at));
        Self {
            joints: (0..names.len()).filter(|at| !is_taken(*at)).collect(),
            pose,
            gripper,
        }
    }

    fn write(
        &self,
        writer: &mut BagWriter,
        names: &[String],
        row: &[f64],
        header: &dyn Fn(&str) -> Header,
        stamp_ns: u64,
    ) -> Result<(), LeRobotError> {
        let value = |at: &usize| row.get(*at).copied().unwrap_or(f64::NAN);
        if !self.joints.is_empty() {
            let name = self.joints.iter().filter_map(|at| names.get(*at).cloned());
            let state = JointState {
                header: header(BASE_FRAME),
                name: name.collect(),
                position: self.joints.iter().map(value).collect(),
                ..JointState::default()
            };
            writer.write(JOINTS_TOPIC, &state, stamp_ns)?;
        }
        if let Some(pose) = &self.pose {
            let [x, y, z, qx, qy, qz, qw] = pose.map(|at| value(&at));
            let orientation = Quaternion {
                x: qx,
                y: qy,
                z: qz,
                w: qw,
            };
            let pose = PoseStamped {
                header: header(BASE_FRAME),
                pose: Pose {
                    position: Point { x, y, z },
                    orientation,
                },
            };
            writer.write(POSE_TOPIC, &pose, stamp_ns)?;
        }
        if let Some(at) = &self.gripper {
            // The message has single precision.
            let gripper = Float32 {
                data: value(at) as f32,
            };
            writer.write(GRIPPER_TOPIC, &gripper, stamp_ns)?;
        }
        Ok(())
    }
}
