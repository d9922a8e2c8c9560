//! The last frame of a bag as a goal for the planner.

use thiserror::Error;
use wm_bag::{BagError, BagMessage, BagReader, TopicInfo};
use wm_msgs::sensor_msgs::CompressedImage;

use crate::{
    camera_frame::CameraFrame,
    image_message::{ImageError, decode_image, encode_jpeg},
    transport::Transport,
};

/// JPEG quality of a goal from a raw image: artefacts stay below what an encoder sees.
const QUALITY: u8 = 95;

/// The last frame is searched in this part of the bag's end first, then in all of it \[ns\].
const TAIL_NS: u64 = 5_000_000_000;

/// A bag without a goal image.
#[expect(missing_docs, reason = "the error texts describe variants and fields")]
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum GoalError {
    #[error(
        "the bag {bag} has no camera images (no topic of sensor_msgs/msg/Image or CompressedImage); its topics: {topics}{advice}"
    )]
    NoCamera {
        bag: String,
        topics: String,
        /// What to do about topics with pictures that are not read.
        advice: String,
    },
    #[error(
        "the bag {bag} has no camera images on {topic} or {topic}/compressed; it has them on: {cameras}{advice}"
    )]
    Topic {
        topic: String,
        bag: String,
        cameras: String,
        /// What to do about topics with pictures that are not read.
        advice: String,
    },
    #[error("topic {0:?} has no readable messages")]
    Empty(String),
    /// The bag cannot be read.
    #[error(transparent)]
    Bag(#[from] BagError),
    #[error("the last frame of {topic:?}: {source}")]
    Image { topic: String, source: ImageError },
}

/// Selects a camera topic of a bag: `wanted` or its sibling `/compressed`; if `wanted` is empty, the first by name, with
/// compressed topics (which are smaller) before raw ones and masks last.
///
/// # Errors
/// The bag has no such topic.
pub fn camera_topic(reader: &BagReader, wanted: &str) -> Result<String, GoalError> {
    let bag = reader.path().display().to_string();
    let mut cameras: Vec<_> = reader
        .topics()
        .iter()
        .filter(|topic| {
            let transport = Transport::of(&topic.name, &topic.type_name);
            transport.is_some_and(Transport::is_read) && topic.message_count > 0
        })
        .collect();
    cameras.sort_by_key(|topic| {
        (
            topic.name.contains("mask"),
            Transport::of(&topic.name, &topic.type_name) != Some(Transport::Compressed),
            topic.name.clone(),
        )
    });
    let advice = reader.topics().iter().filter_map(|topic| {
        let transport = Transport::of(&topic.name, &topic.type_name)?;
        transport.advice(&topic.name)
    });
    let advice: String = advice.map(|advice| format!("; {advice}")).collect();
    if cameras.is_empty() {
        let topics = names(reader.topics().iter());
        return Err(GoalError::NoCamera {
            bag,
            topics,
            advice,
        });
    }
    let is_wanted = |name: &str| {
        wanted.is_empty() || name == wanted || name.strip_suffix("/compressed") == Some(wanted)
    };
    match cameras.iter().find(|topic| is_wanted(&topic.name)) {
        Some(topic) => Ok(topic.name.to_string()),
        None => Err(GoalError::Topic {
            topic: wanted.to_owned(),
            bag,
            cameras: names(cameras.into_iter()),
            advice,
        }),
    }
}

fn names<'a>(topics: impl Iterator<Item = &'a TopicInfo>) -> String {
    let names: Vec<&str> = topics.map(|topic| topic.name.as_ref()).collect();
    names.join(", ")
}

/// The last frame of a camera topic, as JPEG or PNG. Compressed frames are not recoded.
///
/// # Errors
/// The topic has no readable message, or the last one is not an image.
pub fn last_frame(reader: &BagReader, topic: &str) -> Result<CompressedImage, GoalError> {
    let readable = |from_ns| {
        reader
            .messages()
            .only_topics([topic])
            .starting_at(from_ns)
            .flatten()
            .last()
    };
    let last = match readable(reader.end_ns().saturating_sub(TAIL_NS)) {
        Some(last) => last,
        None => readable(0).ok_or_else(|| GoalError::Empty(topic.to_owned()))?,
    };
    compressed(topic, &last)
}

fn compressed(topic: &str, message: &BagMessage) -> Result<CompressedImage, GoalError> {
    let image = match CameraFrame::of_bag(message)? {
        CameraFrame::Compressed(image) => return Ok(image),
        CameraFrame::Raw(image) => image,
    };
    let wrong = |source| GoalError::Image {
        topic: topic.to_owned(),
        source,
    };
    let rgb = decode_image(&image).map_err(wrong)?;
    encode_jpeg(&rgb, image.header, QUALITY).map_err(wrong)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image_message::encode_image;
    use wm_bag::{BagWriter, WriterOptions};
    use wm_msgs::{builtin_interfaces::Time, std_msgs};

    fn header(stamp_ns: i64) -> std_msgs::Header {
        std_msgs::Header {
            stamp: Time::from_nanos(stamp_ns),
            frame_id: "camera".to_owned(),
        }
    }

    #[test]
    fn last_frame_is_found_whatever_follows_it() {
        let folder = tempfile::tempdir().unwrap();
        let mut writer =
            BagWriter::create(folder.path().join("bag"), WriterOptions::default()).unwrap();
        for (index, level) in [(1_u64, 10), (2, 200)] {
            let rgb = image::RgbImage::from_pixel(16, 16, image::Rgb([level; 3]));
            let message = encode_image(&rgb, header(index as i64));
            writer
                .write("/camera/image_raw", &message, index * 1_000_000_000)
                .unwrap();
        }
        let text = std_msgs::String {
            data: "end".to_owned(),
        };
        writer.write("/note", &text, 60_000_000_000).unwrap();
        writer.finish().unwrap();

        let reader = BagReader::open(folder.path().join("bag")).unwrap();
        let topic = camera_topic(&reader, "").unwrap();
        assert_eq!(topic, "/camera/image_raw");
        let goal = last_frame(&reader, &topic).unwrap();
        assert_eq!(goal.header, header(2));
        let decoded = crate::image_message::decode_compressed(&goal).unwrap();
        assert!(
            decoded
                .get_pixel(8, 8)
                .0
                .iter()
                .all(|value| value.abs_diff(200) < 4)
        );
        let error = camera_topic(&reader, "/other").unwrap_err().to_string();
        assert!(
            error.contains("on /other or") && error.ends_with("on: /camera/image_raw"),
            "{error}"
        );
    }

    #[test]
    fn topics_of_other_transports_are_named() {
        let folder = tempfile::tempdir().unwrap();
        let mut writer =
            BagWriter::create(folder.path().join("bag"), WriterOptions::default()).unwrap();
        let depth = CompressedImage::default();
        writer.write("/depth/compressedDepth", &depth, 1).unwrap();
        let schema = wm_bag::Schema::ros2msg("std_msgs/Header header");
        let video = "ffmpeg_image_transport_msgs/msg/FFMPEGPacket";
        writer
            .write_raw("/camera/image_raw/ffmpeg", video, &schema, 1, &[0, 1, 0, 0])
            .unwrap();
        writer.finish().unwrap();
        let reader = BagReader::open(folder.path().join("bag")).unwrap();
        let error = camera_topic(&reader, "").unwrap_err().to_string();
        assert!(
            error.contains("/depth/compressedDepth has distances")
                && error.contains("/camera/image_raw/ffmpeg is compressed video"),
            "{error}"
        );
    }

    #[test]
    fn bag_without_camera_names_its_topics() {
        let folder = tempfile::tempdir().unwrap();
        let mut writer =
            BagWriter::create(folder.path().join("bag"), WriterOptions::default()).unwrap();
        writer
            .write("/note", &std_msgs::String::default(), 1)
            .unwrap();
        writer.finish().unwrap();
        let reader = BagReader::open(folder.path().join("bag")).unwrap();
        let error = camera_topic(&reader, "").unwrap_err().to_string();
        assert!(
            error.contains("no camera images") && error.contains("/note"),
            "{error}"
        );
    }
}
