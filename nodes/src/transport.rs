//! The two transports of an image topic: raw, and compressed on the sibling `<topic>/compressed`.

use anyhow::bail;
use wm_msgs::sensor_msgs::{CompressedImage, Image};
use wm_ros::{Descriptor, Node, Qos, Received, Subscription};

use crate::encoder::CameraFrame;

/// Which transports a node uses.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Transports {
    /// sensor_msgs/Image.
    pub raw: bool,
    /// sensor_msgs/CompressedImage.
    pub compressed: bool,
}

impl Transports {
    /// Both.
    pub const BOTH: Self = Self {
        raw: true,
        compressed: true,
    };

    /// By the value of a parameter: `raw`, `compressed` or `both`.
    ///
    /// # Errors
    /// Names a value that is none of these.
    pub fn parse(name: &str) -> anyhow::Result<Self> {
        Ok(match name {
            "raw" => Self {
                raw: true,
                compressed: false,
            },
            "compressed" => Self {
                raw: false,
                compressed: true,
            },
            "both" => Self::BOTH,
            other => {
                bail!("parameter image_transport is \"{other}\"; expected raw, compressed or both")
            }
        })
    }

    /// Declares the parameter `image_transport` and reads it.
    ///
    /// # Errors
    /// As [`Self::parse`], and where the parameter is of another type.
    pub fn declare(node: &Node) -> anyhow::Result<Self> {
        let descriptor = Descriptor::new("image transport: raw, compressed or both").read_only();
        Self::parse(
            &node
                .declare("image_transport", "both".to_owned(), descriptor)?
                .get(),
        )
    }
}

/// Frames of an image topic, by whichever transports are used.
pub struct ImageSubscription {
    raw: Option<Subscription<Image>>,
    compressed: Option<Subscription<CompressedImage>>,
}

impl ImageSubscription {
    /// Subscribes `topic` and its sibling.
    ///
    /// # Errors
    /// The graph refuses.
    pub fn new(
        node: &Node,
        topic: &str,
        transports: Transports,
        qos: Qos,
    ) -> Result<Self, wm_ros::Error> {
        Ok(Self {
            raw: transports
                .raw
                .then(|| node.subscription(topic, qos))
                .transpose()?,
            compressed: transports
                .compressed
                .then(|| node.subscription(&format!("{topic}/compressed"), qos))
                .transpose()?,
        })
    }

    /// The absolute topics that are subscribed.
    pub fn topics(&self) -> Vec<&str> {
        let raw = self.raw.as_ref().map(Subscription::topic);
        raw.into_iter()
            .chain(self.compressed.as_ref().map(Subscription::topic))
            .collect()
    }

    /// The next frame by either transport; `None` after shutdown. Cancel safe.
    pub async fn recv(&mut self) -> Option<Received<CameraFrame>> {
        tokio::select! {
            received = recv_from(&mut self.raw) => {
                received.map(|Received { message, received }| Received { message: CameraFrame::Raw(message), received })
            }
            received = recv_from(&mut self.compressed) => received.map(|Received { message, received }| Received {
                message: CameraFrame::Compressed(message),
                received,
            }),
        }
    }
}

/// Never, where the transport is not used.
async fn recv_from<M: wm_msgs::Message>(
    subscription: &mut Option<Subscription<M>>,
) -> Option<Received<M>> {
    match subscription {
        Some(subscription) => subscription.recv().await,
        None => std::future::pending().await,
    }
}
