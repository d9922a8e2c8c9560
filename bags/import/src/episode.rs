use std::path::{Path, PathBuf};

use image::{ExtendedColorType, RgbImage, codecs::jpeg::JpegEncoder};
use wm_bag::{BagWriter, QosProfile, WriterOptions};
use wm_msgs::{
    builtin_interfaces::Time,
    geometry_msgs::{Point, Pose, PoseStamped, Quaternion},
    sensor_msgs::CompressedImage,
    std_msgs::{Float32, Header, String as Text},
    wm_msgs::Action,
};

use crate::ImportError;

/// Numbers of an action and of a state: three of position, three of rotation, the gripper.
pub(crate) const VALUES: usize = 7;
/// Bridge V2 is controlled and recorded at 5 Hz (BridgeData V2, arXiv 2308.12952, section 3).
const PERIOD_NS: u64 = 200_000_000;
/// REP-105's name for the frame that the robot is mounted in.
const BASE_FRAME: &str = "base_link";

/// One episode, decoded.
#[derive(Debug)]
pub(crate) struct Episode {
    /// The file it came from.
    pub source: PathBuf,
    /// JPEG frames by camera, each as many as `actions`.
    pub cameras: Vec<Vec<Vec<u8>>>,
    /// dx dy dz in m, droll dpitch dyaw in rad, gripper 0 closed to 1 open; one a frame.
    pub actions: Vec<[f32; VALUES]>,
    /// x y z in m, roll pitch yaw in rad, gripper 0 closed to 1 open; one a frame, or none at all.
    pub states: Vec<[f32; VALUES]>,
    pub instruction: Option<String>,
}

impl Episode {
    /// Holds the parts against each other.
    pub fn check(self) -> Result<Self, ImportError> {
        let frames = self.actions.len();
        let corrupt = |reason: String| Err(ImportError::corrupt(&self.source, reason));
        if frames == 0 || self.cameras.is_empty() {
            return corrupt(format!(
                "the episode has {frames} actions and {} cameras",
                self.cameras.len()
            ));
        }
        for (number, camera) in self.cameras.iter().enumerate() {
            if camera.len() != frames {
                return corrupt(format!(
                    "camera {number} has {} frames for {frames} actions",
                    camera.len()
                ));
            }
        }
        if !self.states.is_empty() && self.states.len() != frames {
            return corrupt(format!("{} states for {frames} actions", self.states.len()));
        }
        for (what, rows) in [("action", &self.actions), ("state", &self.states)] {
            if let Some(row) = rows
                .iter()
                .position(|row| row.iter().any(|value| !value.is_finite()))
            {
                return corrupt(format!("{what} {row} is not finite: {:?}", rows.get(row)));
            }
        }
        Ok(self)
    }

    /// Writes the episode as a bag, its first frame at `start_ns`.
    pub fn write(&self, bag: &Path, start_ns: u64) -> Result<(), ImportError> {
        let mut writer = BagWriter::create(bag, WriterOptions::default())?;
        let cameras: Vec<(String, String)> = (0..self.cameras.len()).map(camera_names).collect();
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
        for (step, action) in self.actions.iter().enumerate() {
            let stamp_ns = start_ns + step as u64 * PERIOD_NS;
            // BagWriter refuses times past i64, and names the topic.
            let stamp = Time::from_nanos(i64::try_from(stamp_ns).unwrap_or(i64::MAX));
            for ((topic, frame_id), frames) in cameras.iter().zip(&self.cameras) {
                let Some(data) = frames.get(step) else {
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
            if let Some([x, y, z, roll, pitch, yaw, gripper]) = self.states.get(step) {
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
            writer.write(
                "/wm/action",
                &Action {
                    header,
                    values: action.to_vec(),
                },
                stamp_ns,
            )?;
        }
        writer.finish()?;
        Ok(())
    }
}

/// Topic and optical frame of a camera.
fn camera_names(number: usize) -> (String, String) {
    let name = if number == 0 {
        "camera".to_owned()
    } else {
        format!("camera_{number}")
    };
    (
        format!("/{name}/image_raw/compressed"),
        format!("{name}_optical_frame"),
    )
}

/// Roll, pitch and yaw about fixed axes, in rad (REP-103), as a unit quaternion.
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

/// A frame as JPEG.
pub(crate) fn jpeg(frame: &RgbImage, quality: u8) -> Result<Vec<u8>, image::ImageError> {
    let mut bytes = Vec::new();
    JpegEncoder::new_with_quality(&mut bytes, quality).encode(
        frame.as_raw(),
        frame.width(),
        frame.height(),
        ExtendedColorType::Rgb8,
    )?;
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use std::f32::consts::FRAC_PI_2;

    use wm_bag::{BagReader, Durability};

    use super::*;

    fn episode(frames: usize) -> Episode {
        Episode {
            source: "made.up".into(),
            cameras: vec![vec![vec![1, 2, 3]; frames], vec![vec![4]; frames]],
            actions: (0..frames)
                .map(|step| [step as f32 * 0.01; VALUES])
                .collect(),
            states: vec![[0.1, 0.2, 0.3, 0.0, 0.0, FRAC_PI_2, 1.0]; frames],
            instruction: Some("lift the lid".into()),
        }
    }

    #[test]
    fn an_episode_becomes_the_promised_topics() {
        let dir = tempfile::tempdir().unwrap();
        let bag = dir.path().join("episode_000000");
        episode(3)
            .check()
            .unwrap()
            .write(&bag, 1_000_000_000)
            .unwrap();
        let reader = BagReader::open(&bag).unwrap();
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
                ("/task/instruction", "std_msgs/msg/String", 1),
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
        // A quarter turn about z.
        assert!(
            (turn.z - 0.5f64.sqrt()).abs() < 1e-6 && (turn.w - 0.5f64.sqrt()).abs() < 1e-6,
            "{turn:?}"
        );
        assert!((pose.pose.position.y - 0.2).abs() < 1e-6);
    }

    #[test]
    fn parts_that_do_not_match_are_named() {
        let reason = |change: fn(&mut Episode)| {
            let mut changed = episode(3);
            change(&mut changed);
            changed.check().unwrap_err().to_string()
        };
        assert!(
            reason(|episode| episode.cameras[1].truncate(2))
                .contains("camera 1 has 2 frames for 3 actions")
        );
        assert!(reason(|episode| episode.states.truncate(2)).contains("2 states for 3 actions"));
        assert!(
            reason(|episode| episode.actions[1][2] = f32::NAN).contains("action 1 is not finite")
        );
        assert!(reason(|episode| episode.actions.clear()).contains("0 actions"));
    }
}
