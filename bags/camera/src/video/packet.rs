//! Messages of compressed video, from recorders and image_transport.

use serde::Deserialize;
use wm_bag::{BagError, BagMessage};
use wm_msgs::{cdr, std_msgs::Header};

use crate::{foxglove::compressed_video, transport::FFMPEG};

/// A picture of a video, or a part of it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct VideoPacket {
    /// Capture time and optical frame.
    pub header: Header,
    /// The codec in the message: `h264`, or an encoder such as `libx264`.
    pub codec: String,
    /// Compressed bytes.
    pub data: Vec<u8>,
    /// Time of recording, in ns since the epoch.
    pub log_time_ns: u64,
    /// Time of publication, in ns since the epoch.
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
    /// Decodes a bag's message in CDR or protobuf.
    ///
    /// # Errors
    /// The type is not a video type, or the bytes are invalid.
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

    /// Whether the codec is h264, by its name or its encoder's.
    pub fn is_h264(&self) -> bool {
        // ffmpeg_image_transport adds pixel formats after a semicolon.
        // Never empty: `split` gives at least one part.
        let codec = self.codec.split([';', ',']).next().unwrap_or_default();
        let codec = codec.trim().to_ascii_lowercase();
        codec.contains("264") || codec == "avc" || codec == "avc1"
    }
}
