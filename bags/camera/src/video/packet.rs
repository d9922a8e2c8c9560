//! Messages of compressed video, as recorders and image_transport write them.

use crate::transport::{FFMPEG, FOXGLOVE};
use prost::Message as _;
use serde::Deserialize;
use thiserror::Error;
use wm_bag::{BagError, BagMessage};
use wm_msgs::{
    builtin_interfaces::Time,
    cdr::{self, CdrError},
    std_msgs::Header,
};

/// A picture of a video, or a part of one.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct VideoPacket {
    /// Capture time and optical frame.
    pub header: Header,
    /// The codec as the message has it: `h264`, or the name of an encoder such as `libx264`.
    pub codec: String,
    /// Coded bytes.
    pub data: Vec<u8>,
    /// When it was recorded, in ns since the epoch.
    pub log_time_ns: u64,
    /// When it was published, in ns since the epoch.
    pub publish_time_ns: u64,
}

/// Why a message is no packet of a video.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum PacketError {
    /// A message of another type.
    #[error(transparent)]
    Bag(#[from] BagError),
    /// The bytes are not of the message's type.
    #[error("{type_name}: {reason}")]
    Cdr {
        /// The message's type.
        type_name: String,
        /// What is wrong.
        reason: CdrError,
    },
    /// The bytes are no protobuf message of the type.
    #[error("{type_name}: {reason}")]
    Protobuf {
        /// The message's type.
        type_name: String,
        /// What is wrong.
        reason: prost::DecodeError,
    },
}

#[derive(Deserialize)]
struct CompressedVideo {
    timestamp: Time,
    frame_id: String,
    #[serde(with = "serde_bytes")]
    data: Vec<u8>,
    format: String,
}

/// foxglove.CompressedVideo in protobuf.
#[derive(Clone, PartialEq, prost::Message)]
pub(super) struct ProtobufVideo {
    #[prost(message, optional, tag = "1")]
    pub(super) timestamp: Option<Timestamp>,
    #[prost(string, tag = "2")]
    pub(super) frame_id: String,
    #[prost(bytes = "vec", tag = "3")]
    pub(super) data: Vec<u8>,
    #[prost(string, tag = "4")]
    pub(super) format: String,
}

/// google.protobuf.Timestamp.
#[derive(Clone, PartialEq, prost::Message)]
pub(super) struct Timestamp {
    #[prost(int64, tag = "1")]
    pub(super) seconds: i64,
    #[prost(int32, tag = "2")]
    pub(super) nanos: i32,
}

impl ProtobufVideo {
    fn header(&mut self) -> Header {
        let time = self.timestamp.take().unwrap_or_default();
        let nanoseconds = time.seconds.saturating_mul(1_000_000_000);
        Header {
            stamp: Time::from_nanos(nanoseconds.saturating_add(i64::from(time.nanos))),
            frame_id: std::mem::take(&mut self.frame_id),
        }
    }
}

#[derive(Deserialize)]
struct FfmpegPacket {
    header: Header,
    _width: i32,
    _height: i32,
    encoding: String,
    _pts: u64,
    _flags: u8,
    _is_bigendian: bool,
    #[serde(with = "serde_bytes")]
    data: Vec<u8>,
}

impl VideoPacket {
    /// The packet of a bag's message.
    ///
    /// # Errors
    /// The type is no video's, or the bytes are not of the type.
    pub fn of_bag(message: &BagMessage) -> Result<Self, PacketError> {
        let type_name = &*message.type_name;
        let wrong = |reason| PacketError::Cdr {
            type_name: type_name.to_owned(),
            reason,
        };
        let (header, codec, data) = match type_name {
            FFMPEG => {
                let packet: FfmpegPacket = cdr::from_bytes(&message.data).map_err(wrong)?;
                (packet.header, packet.encoding, packet.data)
            }
            // A protobuf type has a dot; CDR begins with 0, which no protobuf message does.
            _ if FOXGLOVE.contains(&type_name) && message.data.first() != Some(&0) => {
                let video = ProtobufVideo::decode(&*message.data);
                let mut video = video.map_err(|reason| PacketError::Protobuf {
                    type_name: type_name.to_owned(),
                    reason,
                })?;
                (video.header(), video.format, video.data)
            }
            _ if FOXGLOVE.contains(&type_name) => {
                let video: CompressedVideo = cdr::from_bytes(&message.data).map_err(wrong)?;
                let header = Header {
                    stamp: video.timestamp,
                    frame_id: video.frame_id,
                };
                (header, video.format, video.data)
            }
            _ => {
                return Err(PacketError::Bag(BagError::WrongType {
                    topic: message.topic.to_string(),
                    expected: FOXGLOVE[0].to_owned(),
                    actual: type_name.to_owned(),
                }));
            }
        };
        Ok(Self {
            header,
            codec,
            data,
            log_time_ns: message.log_time_ns,
            publish_time_ns: message.publish_time_ns,
        })
    }

    /// Whether the codec is h264, by its name or that of an encoder.
    pub fn is_h264(&self) -> bool {
        // ffmpeg_image_transport adds pixel formats after a semicolon.
        let codec = self.codec.split([';', ',']).next().unwrap_or_default();
        let codec = codec.trim().to_ascii_lowercase();
        codec.contains("264") || codec == "avc" || codec == "avc1"
    }
}
