//! Pictures in Foxglove's types (<https://docs.foxglove.dev/docs/sdk/schemas>): in protobuf; CompressedVideo also in CDR.

use wm_bag::{BagError, BagMessage, MessageEncoding};
use wm_msgs::{
    builtin_interfaces::Time, cdr, foxglove_msgs::CompressedVideo, sensor_msgs, std_msgs::Header,
};

/// The protobuf type of sensor_msgs/CompressedImage.
pub(crate) const COMPRESSED_IMAGE: &str = "foxglove.CompressedImage";
/// The protobuf type of sensor_msgs/Image.
pub(crate) const RAW_IMAGE: &str = "foxglove.RawImage";
/// The protobuf type of [`CompressedVideo`].
pub(crate) const PROTOBUF_VIDEO: &str = "foxglove.CompressedVideo";
/// The ROS types with the fields of [`CompressedVideo`]; the first is that of foxglove_msgs.
pub(crate) const ROS_VIDEO: [&str; 2] = [
    "foxglove_msgs/msg/CompressedVideo",
    "foxglove/msg/CompressedVideo",
];

/// The packet of video that a bag's message holds, in either encoding.
///
/// # Errors
/// The message has another type, or its bytes do not fit the type.
pub fn compressed_video(message: &BagMessage) -> Result<CompressedVideo, BagError> {
    let type_name = &*message.type_name;
    match message.encoding {
        MessageEncoding::Protobuf => protobuf::<Video>(message)?.into_ros(message),
        MessageEncoding::Cdr if ROS_VIDEO.contains(&type_name) => cdr::from_bytes(&message.data)
            .map_err(|reason| BagError::Cdr {
                topic: message.topic.to_string(),
                reason,
            }),
        MessageEncoding::Cdr => Err(wrong_type(message, ROS_VIDEO[0])),
    }
}

/// The picture of a [`COMPRESSED_IMAGE`].
///
/// # Errors
/// The type is another one, or the bytes are not of it.
pub(crate) fn compressed_image(
    message: &BagMessage,
) -> Result<sensor_msgs::CompressedImage, BagError> {
    protobuf::<CompressedImage>(message)?.into_ros(message)
}

/// The picture of a [`RAW_IMAGE`].
///
/// # Errors
/// The type is another one, or the bytes are not of it.
pub(crate) fn raw_image(message: &BagMessage) -> Result<sensor_msgs::Image, BagError> {
    protobuf::<RawImage>(message)?.into_ros(message)
}

/// A protobuf type with the ROS type of the same contents.
trait Foxglove: prost::Message + Default {
    const NAME: &str;
    type Ros;

    fn into_ros(self, message: &BagMessage) -> Result<Self::Ros, BagError>;
}

/// google.protobuf.Timestamp.
#[derive(Clone, Copy, PartialEq, prost::Message)]
struct Timestamp {
    #[prost(int64, tag = "1")]
    seconds: i64,
    #[prost(int32, tag = "2")]
    nanos: i32,
}

#[derive(Clone, PartialEq, prost::Message)]
struct CompressedImage {
    #[prost(message, optional, tag = "1")]
    timestamp: Option<Timestamp>,
    #[prost(bytes = "vec", tag = "2")]
    data: Vec<u8>,
    #[prost(string, tag = "3")]
    format: String,
    #[prost(string, tag = "4")]
    frame_id: String,
}

#[derive(Clone, PartialEq, prost::Message)]
struct RawImage {
    #[prost(message, optional, tag = "1")]
    timestamp: Option<Timestamp>,
    #[prost(fixed32, tag = "2")]
    width: u32,
    #[prost(fixed32, tag = "3")]
    height: u32,
    #[prost(string, tag = "4")]
    encoding: String,
    #[prost(fixed32, tag = "5")]
    step: u32,
    #[prost(bytes = "vec", tag = "6")]
    data: Vec<u8>,
    #[prost(string, tag = "7")]
    frame_id: String,
}

#[derive(Clone, PartialEq, prost::Message)]
struct Video {
    #[prost(message, optional, tag = "1")]
    timestamp: Option<Timestamp>,
    #[prost(string, tag = "2")]
    frame_id: String,
    #[prost(bytes = "vec", tag = "3")]
    data: Vec<u8>,
    #[prost(string, tag = "4")]
    format: String,
}

impl Foxglove for CompressedImage {
    const NAME: &str = COMPRESSED_IMAGE;
    type Ros = sensor_msgs::CompressedImage;

    fn into_ros(self, message: &BagMessage) -> Result<Self::Ros, BagError> {
        Ok(Self::Ros {
            header: Header {
                stamp: time(message, self.timestamp)?,
                frame_id: self.frame_id,
            },
            format: self.format,
            data: self.data,
        })
    }
}

impl Foxglove for RawImage {
    const NAME: &str = RAW_IMAGE;
    type Ros = sensor_msgs::Image;

    fn into_ros(self, message: &BagMessage) -> Result<Self::Ros, BagError> {
        Ok(Self::Ros {
            header: Header {
                stamp: time(message, self.timestamp)?,
                frame_id: self.frame_id,
            },
            height: self.height,
            width: self.width,
            encoding: self.encoding,
            // foxglove.RawImage is always little-endian.
            is_bigendian: 0,
            step: self.step,
            data: self.data,
        })
    }
}

impl Foxglove for Video {
    const NAME: &str = PROTOBUF_VIDEO;
    type Ros = CompressedVideo;

    fn into_ros(self, message: &BagMessage) -> Result<Self::Ros, BagError> {
        Ok(Self::Ros {
            timestamp: time(message, self.timestamp)?,
            frame_id: self.frame_id,
            data: self.data,
            format: self.format,
        })
    }
}

fn protobuf<M: Foxglove>(message: &BagMessage) -> Result<M, BagError> {
    if message.encoding != MessageEncoding::Protobuf || *message.type_name != *M::NAME {
        return Err(wrong_type(message, M::NAME));
    }
    M::decode(&*message.data).map_err(|error| malformed(message, &error))
}

/// Converts a time; without one it is 0, as in ROS.
fn time(message: &BagMessage, timestamp: Option<Timestamp>) -> Result<Time, BagError> {
    let Some(Timestamp { seconds, nanos }) = timestamp else {
        return Ok(Time::default());
    };
    let sec = i32::try_from(seconds).ok();
    let nanosec = u32::try_from(nanos).ok();
    let nanosec = nanosec.filter(|nanosec| *nanosec < 1_000_000_000);
    let time = sec.zip(nanosec).map(|(sec, nanosec)| Time { sec, nanosec });
    let wrong = format!("a time of {seconds} s and {nanos} ns");
    time.ok_or_else(|| malformed(message, &wrong))
}

fn malformed(message: &BagMessage, reason: &dyn std::fmt::Display) -> BagError {
    BagError::Protobuf {
        topic: message.topic.to_string(),
        type_name: message.type_name.to_string(),
        reason: reason.to_string(),
    }
}

fn wrong_type(message: &BagMessage, expected: &str) -> BagError {
    BagError::WrongType {
        topic: message.topic.to_string(),
        expected: expected.to_owned(),
        actual: message.type_name.to_string(),
    }
}

#[cfg(test)]
mod tests;
