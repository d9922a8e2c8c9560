use std::hash::{DefaultHasher, Hasher as _};

use wm_bag::{BagMessage, BagReader};
use wm_camera::{
    camera_frame::CameraFrame,
    transport::Transport,
    video::{VideoError, VideoPacket, has_keyframe},
};
use wm_msgs::std_msgs::Header;

/// First search distance for a keyframe \[ns\]: encoders usually send one every second.
const NEAR_NS: u64 = 10_000_000_000;

/// A message of a camera topic.
#[derive(Debug)]
pub(super) enum CameraMessage {
    /// An independent picture.
    Still(CameraFrame),
    /// A video packet.
    Packet(VideoPacket),
}

/// Whether a topic has compressed video.
pub(super) fn is_video(reader: &BagReader, topic: &str) -> bool {
    let info = reader.topic(topic);
    info.is_some_and(|info| Transport::of(topic, &info.type_name) == Some(Transport::Video))
}

impl CameraMessage {
    pub fn of_bag(message: &BagMessage) -> Result<Self, String> {
        match Transport::of(&message.topic, &message.type_name) {
            Some(Transport::Video) => {
                let packet = VideoPacket::of_bag(message).map_err(|error| error.to_string())?;
                Ok(Self::Packet(packet))
            }
            _ => {
                let frame = CameraFrame::of_bag(message).map_err(|error| error.to_string())?;
                Ok(Self::Still(frame))
            }
        }
    }

    pub fn header(&self) -> &Header {
        match self {
            Self::Still(frame) => frame.header(),
            Self::Packet(packet) => &packet.header,
        }
    }

    /// Equal for byte-identical pictures. Video packets are rarely identical.
    pub fn fingerprint(&self) -> u64 {
        match self {
            Self::Still(frame) => frame.fingerprint(),
            Self::Packet(packet) => {
                let mut hasher = DefaultHasher::new();
                hasher.write(&packet.data);
                hasher.finish()
            }
        }
    }

    /// Width and height \[px\] from the header; `None` for a video or an unknown format.
    pub fn size(&self) -> Option<(u32, u32)> {
        match self {
            Self::Still(frame) => frame.size(),
            Self::Packet(_) => None,
        }
    }

    /// Rejects formats that no picture of the topic can have.
    pub fn check_format(&self) -> Result<(), String> {
        match self {
            Self::Still(frame) => match frame.decode() {
                Err(error) if error.is_of_format() => Err(error.to_string()),
                _ => Ok(()),
            },
            Self::Packet(packet) if packet.is_h264() => Ok(()),
            Self::Packet(packet) => Err(VideoError::Codec(packet.codec.clone()).to_string()),
        }
    }

    /// Whether it decodes without earlier packets.
    pub fn begins(&self) -> bool {
        match self {
            Self::Still(_) => true,
            Self::Packet(packet) => has_keyframe(&packet.data),
        }
    }
}

/// The log time to start at for all pictures from `from_ns` on; for a video, that of a keyframe.
pub(super) fn first_needed(reader: &BagReader, topic: &str, from_ns: u64) -> u64 {
    if !is_video(reader, topic) {
        return from_ns;
    }
    let mut back_ns = NEAR_NS;
    loop {
        let start_ns = from_ns.saturating_sub(back_ns);
        let messages = reader.messages().only_topics([topic]).starting_at(start_ns);
        let keyframes = messages
            .flatten()
            .take_while(|message| message.log_time_ns <= from_ns)
            .filter(|message| CameraMessage::of_bag(message).is_ok_and(|m| m.begins()));
        if let Some(last) = keyframes.last() {
            return last.log_time_ns;
        }
        if start_ns <= reader.start_ns() {
            return start_ns;
        }
        back_ns = back_ns.saturating_mul(4);
    }
}
