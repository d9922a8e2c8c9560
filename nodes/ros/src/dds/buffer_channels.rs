//! Samples that ROS 2 Lyrical does not publish on their topic.
//!
//! Its `rmw_fastrtps_cpp` (9.4) makes further DDS topics for each topic whose type has an array of bytes, such as an
//! image: `NAME/_buf_cpu`, and `NAME/_buf/IDENTITY_OF_THE_READER` for readers with other memory than the CPU's. A
//! publisher counts its connected readers and those that know these channels. It publishes on `NAME` only if the first
//! number is larger, and never forgets a reader that has left: after a `ros2 topic echo` of Lyrical has ended, a sole
//! reader of another distribution receives nothing on `NAME`. So a volatile reader here reads `NAME/_buf_cpu` too, if a
//! publisher has it. Its samples are those of the topic; a sample is in one of the two. The other channels have
//! descriptors of memory, and are not read.

use std::collections::BTreeSet;
use tokio::sync::watch;

/// The end of the name of a channel.
pub(super) const CPU: &str = "/_buf_cpu";
/// More than a robot has: an announced channel is remembered for the whole run.
const MOST_CHANNELS: usize = 256;

/// Whether a name, without its prefix for topics, is that of a channel of another topic.
pub(super) fn is_channel(name: &str) -> bool {
    let Some((rest, last)) = name.rsplit_once('/') else {
        return false;
    };
    let is_identity = last.len() >= 16
        && last
            .bytes()
            .all(|byte| byte.is_ascii_hexdigit() || byte == b'_');
    name.ends_with(CPU) || (is_identity && rest.ends_with("/_buf"))
}

/// The DDS topics with a channel for the CPU.
#[derive(Default)]
pub(super) struct BufferChannels {
    topics: watch::Sender<BTreeSet<String>>,
}

impl BufferChannels {
    /// A writer on this DDS topic exists.
    pub(super) fn detect(&self, topic: &str) {
        let Some(topic) = topic.strip_suffix(CPU) else {
            return;
        };
        self.topics
            .send_if_modified(|topics| topics.len() < MOST_CHANNELS && topics.insert(topic.into()));
    }

    /// The DDS topics with a channel, also later ones.
    pub(super) fn watch(&self) -> watch::Receiver<BTreeSet<String>> {
        self.topics.subscribe()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_channels_of_buffers_are_channels() {
        let [reader, writer] = ["010f27b4c3d2a19000000103", "0000000000010203"];
        for channel in [
            "_buf_cpu".to_owned(),
            format!("_buf/{reader}00000000"),
            format!("_buf/{writer}_{writer}"),
        ] {
            assert!(is_channel(&format!("/camera/image_raw/{channel}")));
        }
        for name in [
            "/camera/image_raw",
            "/camera/_buf",
            "/_buf/image_raw",
            "/camera_buf_cpu",
            "/camera/_buf_cpu/image_raw",
            "/camera/_buf/feed",
        ] {
            assert!(!is_channel(name), "{name}");
        }
    }

    #[test]
    fn announced_channels_are_bounded() {
        let channels = BufferChannels::default();
        channels.detect("rt/camera/image_raw");
        assert!(channels.topics.borrow().is_empty());
        for number in 0..2 * MOST_CHANNELS {
            channels.detect(&format!("rt/camera_{number}{CPU}"));
        }
        let topics = channels.topics.borrow();
        assert_eq!(topics.len(), MOST_CHANNELS);
        assert!(topics.contains("rt/camera_0"));
    }
}
