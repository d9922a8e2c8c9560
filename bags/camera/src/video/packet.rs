//! Messages of compressed video, as recorders and image_transport write them.

use serde::Deserialize;
use wm_bag::{BagError, BagMessage};
use wm_msgs::{cdr, std_msgs::Header};

use crate::{foxglove::compressed_video, transport::FFMPEG};

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
    /// The packet that a bag's message holds, in CDR or protobuf.
    ///
    /// # Errors
    /// The type is no video's, or the bytes are not of the type.
    pub fn of_bag(message: &BagMessage) -> Result<Self, BagError> {
        let (header, codec, data) = match &*message.type_name {
            FFMPEG => {
                let packet = cdr::from_bytes(&message.data);
                let packet: FfmpegPacket = packet.map_err(|reason| BagError::Cdr {
                    topic: message.topic.to_string(),
                    reason,
                })?;
                (packet.header, packet.encoding, packet.data)
            }
            _ => {
                let video = compressed_video(message)?;
                let header = Header {
                    stamp: video.timestamp,
                    frame_id: video.frame_id,
                };
                (header, video.format, video.data)
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
