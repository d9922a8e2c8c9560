//! Conversion of a bag's protobuf topics to ROS messages.

use serde::Serialize;
use wm_bag::{
    BagMessage, MessageEncoding, NewMessage, NewTopic, Schema, TopicInfo, TopicTransform,
    Transform, type_schema,
};
use wm_msgs::{
    Message as _, cdr,
    foxglove_msgs::CompressedVideo,
    sensor_msgs::{CompressedImage, Image},
};

use crate::foxglove;

/// Converts protobuf pictures to ROS messages on topics of the same names: `foxglove.CompressedImage` and
/// `foxglove.RawImage` to sensor_msgs, `foxglove.CompressedVideo` to foxglove_msgs.
#[derive(Debug)]
pub struct ProtobufTopics;

/// The conversion of a protobuf topic.
struct RosTopic {
    topic: NewTopic,
    data: fn(&BagMessage) -> Result<Vec<u8>, String>,
}

impl Transform for ProtobufTopics {
    fn of_topic(&mut self, topic: &TopicInfo) -> Option<Box<dyn TopicTransform>> {
        if topic.encoding != MessageEncoding::Protobuf {
            return None;
        }
        let (type_name, schema, data): (String, Schema, fn(&BagMessage) -> _) =
            match &*topic.type_name {
                foxglove::COMPRESSED_IMAGE => (
                    CompressedImage::ros_name(),
                    type_schema::<CompressedImage>(),
                    |message| bytes(foxglove::compressed_image(message)),
                ),
                foxglove::RAW_IMAGE => (Image::ros_name(), type_schema::<Image>(), |message| {
                    bytes(foxglove::raw_image(message))
                }),
                foxglove::PROTOBUF_VIDEO => (
                    foxglove::ROS_VIDEO[0].to_owned(),
                    type_schema::<CompressedVideo>(),
                    |message| bytes(foxglove::compressed_video(message)),
                ),
                _ => return None,
            };
        Some(Box::new(RosTopic {
            topic: NewTopic {
                name: topic.name.to_string(),
                type_name,
                schema,
                qos_yaml: topic.qos_yaml.to_string(),
            },
            data,
        }))
    }
}

fn bytes(message: Result<impl Serialize, wm_bag::BagError>) -> Result<Vec<u8>, String> {
    let message = message.map_err(|error| error.to_string())?;
    cdr::to_bytes(&message).map_err(|error| error.to_string())
}

impl TopicTransform for RosTopic {
    fn topic(&self) -> NewTopic {
        self.topic.clone()
    }

    fn convert(&mut self, message: &BagMessage) -> Result<Vec<NewMessage>, String> {
        Ok(vec![NewMessage {
            log_time_ns: message.log_time_ns,
            publish_time_ns: message.publish_time_ns,
            data: (self.data)(message)?.into(),
        }])
    }
}
