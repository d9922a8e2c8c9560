//! An episode as a bag.

use std::path::Path;

use image::codecs::jpeg::JpegEncoder;
use image::codecs::png::PngEncoder;
use image::{ExtendedColorType, GrayImage, ImageEncoder, RgbImage};
use wm_bag::{BagSummary, BagWriter, QosProfile, WriterOptions};
use wm_motion::actions::ActionSpace;
use wm_msgs::builtin_interfaces::Time;
use wm_msgs::geometry_msgs::{Point, Pose, PoseStamped, Quaternion};
use wm_msgs::sensor_msgs::CompressedImage;
use wm_msgs::std_msgs::{Bool, Float32, Header, String as Text};
use wm_msgs::vision_msgs::{LabelInfo, VisionClass};
use wm_msgs::wm_msgs::Action;

use crate::arm::ToolPose;
use crate::episode::{Episode, Frame};
use crate::error::Error;
use crate::render::IMAGE_SIZE;
use crate::scene::{FIRST_OBJECT_MASK, GRIPPER_MASK};

/// The camera's pictures (sensor_msgs/CompressedImage, JPEG).
pub const CAMERA_TOPIC: &str = "/camera/image_raw/compressed";
/// The masks, on request (sensor_msgs/CompressedImage, PNG of one channel).
pub const MASK_TOPIC: &str = "/camera/mask/compressed";
/// What the masks' values mean: objects by the names that instructions use (vision_msgs/LabelInfo, latched).
pub const LABELS_TOPIC: &str = "/camera/mask/label_info";
/// The action taken at each frame (wm_msgs/Action).
pub const ACTION_TOPIC: &str = "/wm/action";
/// The tool's pose (geometry_msgs/PoseStamped).
pub const POSE_TOPIC: &str = "/arm/end_effector_pose";
/// How far the gripper is open, 0 to 1 (std_msgs/Float32).
pub const GRIPPER_TOPIC: &str = "/arm/gripper";
/// The instruction (std_msgs/String, latched).
pub const INSTRUCTION_TOPIC: &str = "/task/instruction";
/// Whether it was carried out, known at the end (std_msgs/Bool, latched).
pub const SUCCESS_TOPIC: &str = "/task/success";

/// Stamp of the first frame of every episode: fixed, so that the same seed gives the same bytes.
pub const START_NS: u64 = 1_700_000_000_000_000_000;
/// Time between frames: 5 Hz.
pub const FRAME_PERIOD_NS: u64 = 200_000_000;
/// JPEG quality of the pictures: no visible blocks, about 20 KB a frame.
const JPEG_QUALITY: u8 = 95;
/// The frame of the pictures.
pub const CAMERA_FRAME: &str = "camera_optical_frame";
/// The frame of the tool's pose and of actions.
pub const BASE_FRAME: &str = "base_link";

/// Writes an episode as a bag into the directory `dir`, which must not exist yet or be empty.
///
/// # Errors
/// [`Error::Bag`] if the bag cannot be written, [`Error::Picture`] if a picture cannot be encoded.
pub fn write_bag(episode: &Episode, dir: &Path) -> Result<BagSummary, Error> {
    let mut bag = BagWriter::create(dir, WriterOptions::default())?;
    bag.note(ActionSpace::NOTE, ActionSpace::bridge().to_note()?);
    bag.add_topic::<CompressedImage>(CAMERA_TOPIC, QosProfile::reliable())?;
    bag.add_topic::<Action>(ACTION_TOPIC, QosProfile::reliable())?;
    bag.add_topic::<PoseStamped>(POSE_TOPIC, QosProfile::reliable())?;
    bag.add_topic::<Float32>(GRIPPER_TOPIC, QosProfile::reliable())?;
    bag.add_topic::<Text>(INSTRUCTION_TOPIC, QosProfile::latched())?;
    bag.add_topic::<Bool>(SUCCESS_TOPIC, QosProfile::latched())?;
    if episode.frames.iter().any(|frame| frame.mask.is_some()) {
        bag.add_topic::<CompressedImage>(MASK_TOPIC, QosProfile::reliable())?;
        bag.add_topic::<LabelInfo>(LABELS_TOPIC, QosProfile::latched())?;
        bag.write(LABELS_TOPIC, &labels(&episode.objects), START_NS)?;
    }
    let instruction = Text {
        data: episode.instruction.clone(),
    };
    bag.write(INSTRUCTION_TOPIC, &instruction, START_NS)?;
    let mut stamp_ns = START_NS;
    for (index, frame) in episode.frames.iter().enumerate() {
        // At most FRAMES frames, so the product is far from overflow.
        stamp_ns = START_NS + index as u64 * FRAME_PERIOD_NS;
        write_frame(&mut bag, frame, stamp_ns)?;
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

fn labels(objects: &[String]) -> LabelInfo {
    let gripper = (GRIPPER_MASK, "gripper".to_owned());
    let objects = (FIRST_OBJECT_MASK..).zip(objects.iter().cloned());
    let classes = std::iter::once(gripper).chain(objects);
    LabelInfo {
        header: Header {
            stamp: Time::from_nanos(START_NS as i64),
            frame_id: CAMERA_FRAME.to_owned(),
        },
        class_map: classes
            .map(|(value, class_name)| VisionClass {
                class_id: value.into(),
                class_name,
            })
            .collect(),
        // The simulator knows.
        threshold: 1.0,
    }
}

fn write_frame(bag: &mut BagWriter, frame: &Frame, stamp_ns: u64) -> Result<(), Error> {
    let header = |frame_id: &str| Header {
        // The stamps are of this century, far below the limit of i64.
        stamp: Time::from_nanos(stamp_ns as i64),
        frame_id: frame_id.to_owned(),
    };
    let pose = PoseStamped {
        header: header(BASE_FRAME),
        pose: pose_message(&frame.tool),
    };
    bag.write(POSE_TOPIC, &pose, stamp_ns)?;
    // Single precision is what the message carries.
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

/// The tool's pose as a message, in the base frame.
pub fn pose_message(tool: &ToolPose) -> Pose {
    let frame = tool.frame();
    let (position, rotation) = (frame.translation.vector, frame.rotation);
    Pose {
        position: Point {
            x: position.x,
            y: position.y,
            z: position.z,
        },
        orientation: Quaternion {
            x: rotation.i,
            y: rotation.j,
            z: rotation.k,
            w: rotation.w,
        },
    }
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
    use crate::episode::EpisodeOptions;
    use wm_bag::BagReader;

    #[test]
    fn a_bag_holds_the_episode() {
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
        for (action, frame) in actions.iter().zip(&episode.frames) {
            assert_eq!(action.values, frame.action);
        }
    }
}
