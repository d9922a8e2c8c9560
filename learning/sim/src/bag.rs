//! Writes an episode as a bag.

use std::path::Path;

use image::codecs::jpeg::JpegEncoder;
use image::codecs::png::PngEncoder;
use image::{ExtendedColorType, GrayImage, ImageEncoder, RgbImage};
use wm_bag::{BagSummary, BagWriter, QosProfile, WriterOptions};
use wm_motion::actions::ActionSpace;
use wm_msgs::builtin_interfaces::Time;
use wm_msgs::geometry_msgs::PoseStamped;
use wm_msgs::sensor_msgs::{CameraInfo, CompressedImage};
use wm_msgs::std_msgs::{Bool, Float32, Header, String as Text};
use wm_msgs::tf2_msgs::TFMessage;
use wm_msgs::vision_msgs::{LabelInfo, VisionClass};
use wm_msgs::wm_msgs::Action;

use crate::environment::joint_positions;
use crate::episode::{Episode, Frame};
use crate::error::Error;
use crate::message;
use crate::render::IMAGE_SIZE;
use crate::scene::{FIRST_OBJECT_MASK, GRIPPER_MASK};
use crate::urdf::{link_frames, urdf};

/// The camera's pictures (sensor_msgs/CompressedImage, JPEG).
pub const CAMERA_TOPIC: &str = "/camera/image_raw/compressed";
/// The calibration, with each picture (sensor_msgs/CameraInfo).
pub const CAMERA_INFO_TOPIC: &str = "/camera/camera_info";
/// The masks, on request (sensor_msgs/CompressedImage, PNG of one channel).
pub const MASK_TOPIC: &str = "/camera/mask/compressed";
/// Names of the mask values: objects as in instructions (vision_msgs/LabelInfo, latched).
pub const LABELS_TOPIC: &str = "/camera/mask/label_info";
/// The action taken at each frame (wm_msgs/Action).
pub const ACTION_TOPIC: &str = "/wm/action";
/// The tool's pose (geometry_msgs/PoseStamped).
pub const POSE_TOPIC: &str = "/arm/end_effector_pose";
/// Opening of the gripper, 0 to 1 (std_msgs/Float32).
pub const GRIPPER_TOPIC: &str = "/arm/gripper";
/// The arm's links, each in its parent's frame (tf2_msgs/TFMessage).
pub const TRANSFORMS_TOPIC: &str = "/tf";
/// The camera's optical frame (tf2_msgs/TFMessage, latched).
pub const STATIC_TRANSFORMS_TOPIC: &str = "/tf_static";
/// The arm as a URDF (std_msgs/String, latched).
pub const DESCRIPTION_TOPIC: &str = "/robot_description";
/// The instruction (std_msgs/String, latched).
pub const INSTRUCTION_TOPIC: &str = "/task/instruction";
/// Whether the task succeeded, known at the end (std_msgs/Bool, latched).
pub const SUCCESS_TOPIC: &str = "/task/success";

/// Stamp of the first frame: fixed, so that the same seed gives the same bytes.
pub const START_NS: u64 = 1_700_000_000_000_000_000;
/// Frame period: 5 Hz.
pub const FRAME_PERIOD_NS: u64 = 200_000_000;
/// JPEG quality: no visible blocks, about 20 KB per frame.
const JPEG_QUALITY: u8 = 95;
/// The frame of the pictures.
pub const CAMERA_FRAME: &str = "camera_optical_frame";
/// The frame of the tool's pose and of actions.
pub const BASE_FRAME: &str = "base_link";

/// Writes an episode as a bag to `dir`, which must be missing or empty.
///
/// # Errors
/// [`Error::Bag`] if the bag cannot be written, [`Error::Picture`] if a picture cannot be encoded.
pub fn write_bag(episode: &Episode, dir: &Path) -> Result<BagSummary, Error> {
    let mut bag = BagWriter::create(dir, WriterOptions::default())?;
    bag.note(ActionSpace::NOTE, ActionSpace::bridge().to_note()?);
    bag.add_topic::<CompressedImage>(CAMERA_TOPIC, QosProfile::reliable())?;
    bag.add_topic::<CameraInfo>(CAMERA_INFO_TOPIC, QosProfile::reliable())?;
    bag.add_topic::<Action>(ACTION_TOPIC, QosProfile::reliable())?;
    bag.add_topic::<PoseStamped>(POSE_TOPIC, QosProfile::reliable())?;
    bag.add_topic::<Float32>(GRIPPER_TOPIC, QosProfile::reliable())?;
    bag.add_topic::<TFMessage>(TRANSFORMS_TOPIC, QosProfile::reliable())?;
    bag.add_topic::<TFMessage>(STATIC_TRANSFORMS_TOPIC, QosProfile::latched())?;
    bag.add_topic::<Text>(DESCRIPTION_TOPIC, QosProfile::latched())?;
    bag.add_topic::<Text>(INSTRUCTION_TOPIC, QosProfile::latched())?;
    bag.add_topic::<Bool>(SUCCESS_TOPIC, QosProfile::latched())?;
    if episode.frames.iter().any(|frame| frame.mask.is_some()) {
        bag.add_topic::<CompressedImage>(MASK_TOPIC, QosProfile::reliable())?;
        bag.add_topic::<LabelInfo>(LABELS_TOPIC, QosProfile::latched())?;
        bag.write(LABELS_TOPIC, &labels(&episode.objects), START_NS)?;
    }
    let description = Text {
        data: urdf(BASE_FRAME),
    };
    bag.write(DESCRIPTION_TOPIC, &description, START_NS)?;
    let camera = message::transform(
        &episode.camera.base_from_optical(),
        header(START_NS, BASE_FRAME),
        CAMERA_FRAME,
    );
    let transforms = vec![camera];
    bag.write(STATIC_TRANSFORMS_TOPIC, &TFMessage { transforms }, START_NS)?;
    let instruction = Text {
        data: episode.instruction.clone(),
    };
    bag.write(INSTRUCTION_TOPIC, &instruction, START_NS)?;
    let mut stamp_ns = START_NS;
    for (index, frame) in episode.frames.iter().enumerate() {
        // No overflow: at most FRAMES frames.
        stamp_ns = START_NS + index as u64 * FRAME_PERIOD_NS;
        write_frame(&mut bag, frame, stamp_ns)?;
        let info = message::camera_info(&episode.camera, header(stamp_ns, CAMERA_FRAME));
        bag.write(CAMERA_INFO_TOPIC, &info, stamp_ns)?;
    }
    bag.write(
        SUCCESS_TOPIC,
        &Bool {
            data: episode.success,
        },
        stamp_ns,
    )?;
    Ok(bag.finish()?)
}

fn header(stamp_ns: u64, frame_id: &str) -> Header {
    Header {
        // Fits: stamps are of this century.
        stamp: Time::from_nanos(stamp_ns as i64),
        frame_id: frame_id.to_owned(),
    }
}

/// The transforms of the links; `None` if the tool is out of reach.
fn transforms(frame: &Frame, stamp_ns: u64) -> Option<TFMessage> {
    let positions = joint_positions(&frame.tool, frame.opening)?;
    let links = link_frames(BASE_FRAME, &positions).into_iter();
    let transforms = links.map(|link| {
        let header = header(stamp_ns, &link.parent);
        message::transform(&link.frame, header, link.link)
    });
    Some(TFMessage {
        transforms: transforms.collect(),
    })
}

fn labels(objects: &[String]) -> LabelInfo {
    let gripper = (GRIPPER_MASK, "gripper".to_owned());
    let objects = (FIRST_OBJECT_MASK..).zip(objects.iter().cloned());
    let classes = std::iter::once(gripper).chain(objects);
    LabelInfo {
        header: header(START_NS, CAMERA_FRAME),
        class_map: classes
            .map(|(value, class_name)| VisionClass {
                class_id: value.into(),
                class_name,
            })
            .collect(),
        // The simulator's masks are exact.
        threshold: 1.0,
    }
}

fn write_frame(bag: &mut BagWriter, frame: &Frame, stamp_ns: u64) -> Result<(), Error> {
    let header = |frame_id: &str| header(stamp_ns, frame_id);
    let pose = PoseStamped {
        header: header(BASE_FRAME),
        pose: message::pose(&frame.tool.frame()),
    };
    bag.write(POSE_TOPIC, &pose, stamp_ns)?;
    if let Some(transforms) = transforms(frame, stamp_ns) {
        bag.write(TRANSFORMS_TOPIC, &transforms, stamp_ns)?;
    }
    // The message has single precision.
    bag.write(
        GRIPPER_TOPIC,
        &Float32 {
            data: frame.opening as f32,
        },
        stamp_ns,
    )?;
    if let Some(mask) = &frame.mask {
        let picture = CompressedImage {
            header: header(CAMERA_FRAME),
            format: "png".to_owned(),
            data: png(mask)?,
        };
        bag.write(MASK_TOPIC, &picture, stamp_ns)?;
    }
    let picture = CompressedImage {
        header: header(CAMERA_FRAME),
        format: "jpeg".to_owned(),
        data: jpeg(&frame.image)?,
    };
    bag.write(CAMERA_TOPIC, &picture, stamp_ns)?;
    let action = Action {
        header: header(BASE_FRAME),
        values: frame.action.to_vec(),
    };
    bag.write(ACTION_TOPIC, &action, stamp_ns)?;
    Ok(())
}

fn jpeg(picture: &RgbImage) -> Result<Vec<u8>, Error> {
    let mut bytes = Vec::new();
    JpegEncoder::new_with_quality(&mut bytes, JPEG_QUALITY).write_image(
        picture.as_raw(),
        IMAGE_SIZE,
        IMAGE_SIZE,
        ExtendedColorType::Rgb8,
    )?;
    Ok(bytes)
}

fn png(mask: &GrayImage) -> Result<Vec<u8>, Error> {
    let mut bytes = Vec::new();
    PngEncoder::new(&mut bytes).write_image(
        mask.as_raw(),
        IMAGE_SIZE,
        IMAGE_SIZE,
        ExtendedColorType::L8,
    )?;
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::episode_options::EpisodeOptions;
    use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion};
    use wm_bag::BagReader;
    use wm_msgs::geometry_msgs::{Transform, TransformStamped};

    fn isometry(transform: &Transform) -> Isometry3<f64> {
        let (at, turn) = (transform.translation, transform.rotation);
        let turn = Quaternion::new(turn.w, turn.x, turn.y, turn.z);
        Isometry3::from_parts(
            Translation3::new(at.x, at.y, at.z),
            UnitQuaternion::from_quaternion(turn),
        )
    }

    #[test]
    fn bag_has_the_episode() {
        let scratch = tempfile::tempdir().expect("a temporary directory");
        let options = EpisodeOptions {
            frames: 3,
            masks: true,
            ..EpisodeOptions::default()
        };
        let episode = Episode::generate(11, &options).expect("valid options");
        let dir = scratch.path().join("episode");
        write_bag(&episode, &dir).expect("written");
        let reader = BagReader::open(&dir).expect("a bag");
        assert_eq!(reader.start_ns(), START_NS);
        assert_eq!(reader.end_ns(), START_NS + 2 * FRAME_PERIOD_NS);
        let mut actions = Vec::new();
        let mut pictures = 0;
        let (mut masks, mut labelled) = (0, false);
        let (mut infos, mut tools, mut camera_frames) = (Vec::new(), Vec::new(), Vec::new());
        for message in reader.messages() {
            let message = message.expect("readable");
            match &*message.topic {
                ACTION_TOPIC => actions.push(message.decode::<Action>().expect("an action")),
                INSTRUCTION_TOPIC => {
                    assert_eq!(
                        message.decode::<Text>().expect("text").data,
                        episode.instruction
                    );
                }
                SUCCESS_TOPIC => {
                    assert_eq!(
                        message.decode::<Bool>().expect("a flag").data,
                        episode.success
                    );
                }
                CAMERA_TOPIC => {
                    let data = message.decode::<CompressedImage>().expect("a picture").data;
                    let decoded = image::load_from_memory(&data).expect("a JPEG").to_rgb8();
                    let original = &episode.frames[pictures].image;
                    let error: u32 = decoded
                        .iter()
                        .zip(original.iter())
                        .map(|(a, b)| u32::from(a.abs_diff(*b)))
                        .sum();
                    assert!(error < 3 * decoded.len() as u32);
                    pictures += 1;
                }
                CAMERA_INFO_TOPIC => {
                    infos.push(message.decode::<CameraInfo>().expect("a camera"));
                }
                TRANSFORMS_TOPIC => {
                    let links = message.decode::<TFMessage>().expect("frames").transforms;
                    let frame = |name: &str| {
                        let of_name = |link: &&TransformStamped| link.child_frame_id == name;
                        links.iter().find(of_name).expect("every link")
                    };
                    let (mut at, mut link) = (Isometry3::identity(), "ee_gripper_link");
                    while link != BASE_FRAME {
                        at = isometry(&frame(link).transform) * at;
                        link = &frame(link).header.frame_id;
                    }
                    tools.push(at);
                }
                STATIC_TRANSFORMS_TOPIC => {
                    camera_frames = message.decode::<TFMessage>().expect("frames").transforms;
                }
                DESCRIPTION_TOPIC => {
                    let text = message.decode::<Text>().expect("text").data;
                    assert!(text.contains("<link name=\"ee_gripper_link\""), "{text}");
                }
                MASK_TOPIC => {
                    let data = message.decode::<CompressedImage>().expect("a mask").data;
                    let decoded = image::load_from_memory(&data).expect("a PNG").to_luma8();
                    assert_eq!(Some(&decoded), episode.frames[masks].mask.as_ref());
                    masks += 1;
                }
                LABELS_TOPIC => {
                    let labels = message.decode::<LabelInfo>().expect("labels").class_map;
                    let names = labels.iter().map(|class| class.class_name.clone());
                    let names: Vec<String> = names.collect();
                    assert_eq!(names.first().map(String::as_str), Some("gripper"));
                    assert_eq!(names.get(1..), Some(&*episode.objects));
                    assert!(
                        labels
                            .iter()
                            .map(|class| class.class_id)
                            .eq(1..=names.len() as u16)
                    );
                    labelled = true;
                }
                _ => {}
            }
        }
        assert_eq!((actions.len(), pictures, masks), (3, 3, 3));
        assert!(labelled);
        // The links put the tool at its pose.
        assert_eq!((infos.len(), tools.len()), (3, 3));
        for (tool, frame) in tools.iter().zip(&episode.frames) {
            let apart = tool.translation.vector - frame.tool.position;
            assert!(apart.norm() < 1e-9, "{apart}");
        }
        let [camera] = &camera_frames[..] else {
            panic!("{camera_frames:?}")
        };
        let eye = episode.camera.eye().cast::<f64>();
        assert_eq!(camera.child_frame_id, CAMERA_FRAME);
        assert!((isometry(&camera.transform).translation.vector - eye).norm() < 1e-9);
        assert!(
            infos
                .iter()
                .all(|info| info.header.frame_id == CAMERA_FRAME)
        );
        for (action, frame) in actions.iter().zip(&episode.frames) {
            assert_eq!(action.values, frame.action);
        }
    }
}
