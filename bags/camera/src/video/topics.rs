//! Conversion of a bag's video topics to JPEG pictures.

use std::collections::BTreeMap;

use wm_bag::{
    BagMessage, BagReader, NewMessage, NewTopic, Omission, TopicInfo, TopicTransform, Transform,
    type_schema,
};
use wm_msgs::{Message as _, cdr, sensor_msgs::CompressedImage};

use super::{VideoPacket, VideoPicture, VideoStream, has_keyframe};
use crate::{
    image_message::encode_jpeg,
    transport::{COMPRESSED, Transport, base},
};

/// Converts the h264 topics of a bag to topics of sensor_msgs/CompressedImage.
///
/// `/camera/image_raw/ffmpeg` becomes `/camera/image_raw/compressed`, or `/camera/image_raw/ffmpeg/compressed` if the bag
/// has the first already. Stamps, `frame_id`, times and QoS stay.
#[derive(Debug)]
pub struct VideoTopics {
    quality: u8,
    /// New names, by old name.
    names: BTreeMap<String, String>,
    skipped: Vec<(String, String)>,
}

impl VideoTopics {
    /// Selects the decodable video topics of a bag, by reading each up to its first keyframe. `quality` is that of the JPEGs,
    /// 1 to 100.
    #[must_use]
    pub fn of(reader: &BagReader, quality: u8) -> Self {
        let mut topics = Self {
            quality,
            names: BTreeMap::new(),
            skipped: Vec::new(),
        };
        let is_video = |topic: &&TopicInfo| {
            let transport = Transport::of(&topic.name, &topic.type_name);
            transport == Some(Transport::Video) && topic.message_count > 0
        };
        for topic in reader.topics().iter().filter(is_video) {
            let topic = topic.name.to_string();
            let found = check(reader, &topic).and_then(|()| topics.free_name(reader, &topic));
            match found {
                Ok(name) => {
                    topics.names.insert(topic, name);
                }
                Err(reason) => topics.skipped.push((topic, reason)),
            }
        }
        topics
    }

    /// The video topics that are copied unchanged, with the reason.
    #[must_use]
    pub fn skipped(&self) -> &[(String, String)] {
        &self.skipped
    }

    fn free_name(&self, reader: &BagReader, topic: &str) -> Result<String, String> {
        let names = [base(topic), topic].map(|name| format!("{name}{COMPRESSED}"));
        let is_free = |name: &String| {
            reader.topic(name).is_none() && !self.names.values().any(|taken| taken == name)
        };
        let wanted = names.join(" and ");
        let mut names = names.into_iter();
        let free = names.find(is_free);
        free.ok_or_else(|| format!("the bag already has {wanted}"))
    }
}

/// Checks that a topic can be decoded.
fn check(reader: &BagReader, topic: &str) -> Result<(), String> {
    let mut stream = VideoStream::new();
    let mut unreadable = None;
    // The conversion reports damaged chunks.
    for message in reader.messages().only_topics([topic]).flatten() {
        let packet = match VideoPacket::of_bag(&message) {
            Ok(packet) => packet,
            Err(error) => {
                unreadable.get_or_insert(error.to_string());
                continue;
            }
        };
        stream.feed(&packet).map_err(|error| error.to_string())?;
        if has_keyframe(&packet.data) {
            return Ok(());
        }
    }
    Err(unreadable.unwrap_or_else(|| "no packet has a keyframe".to_owned()))
}

impl Transform for VideoTopics {
    fn of_topic(&mut self, topic: &TopicInfo) -> Option<Box<dyn TopicTransform>> {
        let name = self.names.get(&*topic.name)?;
        Some(Box::new(PictureTopic {
            topic: NewTopic {
                name: name.clone(),
                type_name: CompressedImage::ros_name(),
                schema: type_schema::<CompressedImage>(),
                qos_yaml: topic.qos_yaml.to_string(),
            },
            quality: self.quality,
            stream: VideoStream::new(),
        }))
    }
}

/// The conversion of a video topic.
struct PictureTopic {
    topic: NewTopic,
    quality: u8,
    stream: VideoStream,
}

impl PictureTopic {
    fn messages(&self, shown: Vec<VideoPicture>) -> Result<Vec<NewMessage>, String> {
        let message = |shown: VideoPicture| {
            let image = encode_jpeg(&shown.picture, shown.header, self.quality);
            let image = image.map_err(|error| error.to_string())?;
            let data = cdr::to_bytes(&image).map_err(|error| error.to_string())?;
            Ok(NewMessage {
                log_time_ns: shown.log_time_ns,
                publish_time_ns: shown.publish_time_ns,
                data: data.into(),
            })
        };
        shown.into_iter().map(message).collect()
    }
}

impl TopicTransform for PictureTopic {
    fn topic(&self) -> NewTopic {
        self.topic.clone()
    }

    fn convert(&mut self, message: &BagMessage) -> Result<Vec<NewMessage>, String> {
        let packet = VideoPacket::of_bag(message).map_err(|error| error.to_string())?;
        let shown = self.stream.feed(&packet);
        self.messages(shown.map_err(|error| error.to_string())?)
    }

    fn finish(&mut self) -> Result<Vec<NewMessage>, String> {
        let shown = self.stream.finish();
        self.messages(shown)
    }

    fn omissions(&self) -> Vec<Omission> {
        let dropped = self.stream.dropped();
        let causes = [
            (
                dropped.before_keyframe,
                "they come before the first keyframe".to_owned(),
            ),
            (dropped.damaged, "they are damaged".to_owned()),
            (
                dropped.dependent,
                format!(
                    "they depend on damaged or missing packets, up to the next keyframe (packets are missing in {} \
                     place(s))",
                    dropped.gaps
                ),
            ),
        ];
        let causes = causes.into_iter().filter(|(messages, _)| *messages > 0);
        let omission = |(messages, reason)| Omission { messages, reason };
        causes.map(omission).collect()
    }
}

#[cfg(test)]
mod tests;
