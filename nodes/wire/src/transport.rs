//! The two transports of an image topic: raw, and compressed on the sibling `<topic>/compressed`.

use anyhow::bail;
use wm_msgs::sensor_msgs::{CompressedImage, Image};
use wm_ros::{Descriptor, Node, Publisher, Qos, Received, Subscription};

use crate::camera_frame::CameraFrame;

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

/// The topic that carries the compressed images of `topic`. It is remapped with it.
fn compressed_of(node: &Node, topic: &str) -> Result<String, wm_ros::Error> {
    node.resolve_sibling(topic, "compressed")
}

/// Publishers of an image topic and its sibling, as far as they are used.
pub type ImagePublishers = (Option<Publisher<Image>>, Option<Publisher<CompressedImage>>);

/// Publishes `topic` and its sibling.
///
/// # Errors
/// The graph refuses.
pub fn publish_images(
    node: &Node,
    topic: &str,
    transports: Transports,
    qos: Qos,
) -> Result<ImagePublishers, wm_ros::Error> {
    let Transports { raw, compressed } = transports;
    let raw = raw.then(|| node.publisher(topic, qos));
    let compressed = compressed.then(|| node.publisher(&compressed_of(node, topic)?, qos));
    Ok((raw.transpose()?, compressed.transpose()?))
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
        let Transports { raw, compressed } = transports;
        let raw = raw.then(|| node.subscription(topic, qos));
        let compressed = compressed.then(|| node.subscription(&compressed_of(node, topic)?, qos));
        Self::of(raw, compressed)
    }

    /// Subscribes `topic` and its sibling for an image that holds until the next, as a goal does: one that was latched
    /// before comes too.
    ///
    /// # Errors
    /// The graph refuses.
    pub fn catching_up(
        node: &Node,
        topic: &str,
        transports: Transports,
        qos: Qos,
    ) -> Result<Self, wm_ros::Error> {
        let Transports { raw, compressed } = transports;
        let raw = raw.then(|| node.subscription_catching_up(topic, qos));
        let compressed =
            compressed.then(|| node.subscription_catching_up(&compressed_of(node, topic)?, qos));
        Self::of(raw, compressed)
    }

    fn of(
        raw: Option<Result<Subscription<Image>, wm_ros::Error>>,
        compressed: Option<Result<Subscription<CompressedImage>, wm_ros::Error>>,
    ) -> Result<Self, wm_ros::Error> {
        let (raw, compressed) = (raw.transpose()?, compressed.transpose()?);
        Ok(Self { raw, compressed })
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
            received = recv_from(&mut self.raw) => received.map(|received| received.map(CameraFrame::Raw)),
            received = recv_from(&mut self.compressed) => {
                received.map(|received| received.map(CameraFrame::Compressed))
            }
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
