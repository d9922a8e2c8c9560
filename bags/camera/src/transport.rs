//! The topics of a camera, raw and by other image transports.

use wm_msgs::{
    Message as _,
    sensor_msgs::{CompressedImage, Image},
};

use crate::foxglove;

/// The type of ffmpeg_image_transport.
pub(crate) const FFMPEG: &str = "ffmpeg_image_transport_msgs/msg/FFMPEGPacket";

/// Name ending of topics with JPEG or PNG (image_transport).
pub const COMPRESSED: &str = "/compressed";
/// Name endings of video topics: ffmpeg_image_transport, foxglove_compressed_video_transport, recorders.
pub const VIDEO: [&str; 4] = ["/ffmpeg", "/foxglove", "/video", "/h264"];

/// The topic without the ending of its transport.
#[must_use]
pub fn base(topic: &str) -> &str {
    let mut transports = VIDEO.iter().chain([&COMPRESSED]);
    let base = transports.find_map(|transport| topic.strip_suffix(transport));
    base.filter(|base| !base.is_empty()).unwrap_or(topic)
}

/// The transport of a topic's pictures.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Transport {
    /// sensor_msgs/Image, or its protobuf counterpart.
    Raw,
    /// sensor_msgs/CompressedImage with JPEG or PNG, or its protobuf counterpart.
    Compressed,
    /// Compressed video, usually h264.
    Video,
    /// Distances (compressed_depth_image_transport).
    Depth,
    /// Another codec of image_transport.
    Other(&'static str),
}

impl Transport {
    /// The transport by topic name and type; `None` without pictures.
    pub fn of(topic: &str, type_name: &str) -> Option<Self> {
        let is_image = type_name == Image::ros_name() || type_name == foxglove::RAW_IMAGE;
        let is_compressed =
            [&*CompressedImage::ros_name(), foxglove::COMPRESSED_IMAGE].contains(&type_name);
        let is_video = [FFMPEG, foxglove::PROTOBUF_VIDEO].contains(&type_name)
            || foxglove::ROS_VIDEO.contains(&type_name);
        // Never empty: `rsplit` gives at least one part.
        let sibling = topic.rsplit('/').next().unwrap_or_default();
        match sibling {
            _ if is_video => Some(Self::Video),
            _ if type_name == "theora_image_transport/msg/Packet" => Some(Self::Other("Theora")),
            "compressedDepth" if is_compressed => Some(Self::Depth),
            "zstd" if is_compressed => Some(Self::Other("zstd")),
            _ if is_compressed => Some(Self::Compressed),
            _ if is_image => Some(Self::Raw),
            _ => None,
        }
    }

    /// Whether every program of the suite decodes it.
    pub fn is_read(self) -> bool {
        matches!(self, Self::Raw | Self::Compressed)
    }

    /// Advice for a topic that only some programs decode.
    pub fn advice(self, topic: &str) -> Option<String> {
        Some(match self {
            Self::Raw | Self::Compressed => return None,
            Self::Video => format!(
                "{topic} is compressed video, which only wm dataset reads; convert it to pictures: wm bag \
                 convert IN OUT --video jpeg, or publish the camera as sensor_msgs/CompressedImage (image_transport: \
                 compressed)"
            ),
            Self::Depth => {
                format!(
                    "{topic} has distances instead of colours; choose the colour camera's topic"
                )
            }
            Self::Other(codec) => format!(
                "{topic} is compressed by {codec}, which is not supported; republish it: ros2 run image_transport republish \
                 --ros-args -p in_transport:={} -p out_transport:=compressed",
                topic.rsplit('/').next().unwrap_or_default()
            ),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn base_of_a_topic_is_its_name_without_the_transport() {
        for topic in [
            "/camera/image_raw",
            "/camera/image_raw/compressed",
            "/camera/image_raw/ffmpeg",
            "/camera/image_raw/h264",
        ] {
            assert_eq!(base(topic), "/camera/image_raw");
        }
        assert_eq!(base("/video"), "/video");
    }

    #[test]
    fn transport_follows_from_name_and_type() {
        let compressed = "sensor_msgs/msg/CompressedImage";
        for (topic, type_name, expected) in [
            (
                "/camera/image_raw",
                "sensor_msgs/msg/Image",
                Some(Transport::Raw),
            ),
            (
                "/camera/image_raw/compressed",
                compressed,
                Some(Transport::Compressed),
            ),
            ("/camera/jpeg", compressed, Some(Transport::Compressed)),
            (
                "/depth/image/compressedDepth",
                compressed,
                Some(Transport::Depth),
            ),
            (
                "/camera/image_raw/zstd",
                compressed,
                Some(Transport::Other("zstd")),
            ),
            (
                "/camera/image_raw/theora",
                "theora_image_transport/msg/Packet",
                Some(Transport::Other("Theora")),
            ),
            ("/camera/image_raw/ffmpeg", FFMPEG, Some(Transport::Video)),
            (
                "/camera/video",
                "foxglove.CompressedVideo",
                Some(Transport::Video),
            ),
            (
                "/jpeg",
                "foxglove.CompressedImage",
                Some(Transport::Compressed),
            ),
            ("/raw", "foxglove.RawImage", Some(Transport::Raw)),
            ("/note", "std_msgs/msg/String", None),
        ] {
            assert_eq!(Transport::of(topic, type_name), expected, "{topic}");
            let advice = expected.and_then(|transport| transport.advice(topic));
            let is_read = expected.is_none_or(Transport::is_read);
            assert_eq!(advice.is_none(), is_read, "{topic}: {advice:?}");
        }
    }
}
