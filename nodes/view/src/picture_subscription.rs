//! An image topic: compressed if anyone publishes it so, otherwise raw.

use std::collections::BTreeMap;
use wm_camera::camera_frame::CameraFrame;
use wm_msgs::sensor_msgs::{CompressedImage, Image};
use wm_ros::{
    Direction, Endpoint, EndpointSpec, Error, Node, Qos, Received, Subscription, TopicInfo,
};

/// Pictures of an image topic. It subscribes to raw images only if there are no compressed ones: they are much larger
/// and cost their publishers time.
pub(crate) struct PictureSubscription {
    node: Node,
    topic: String,
    qos: Qos,
    compressed: Subscription<CompressedImage>,
    raw: Option<Subscription<Image>>,
    /// Its publishers latch it, like a goal.
    is_latched: bool,
}

/// The number of publishers per topic, by absolute name.
pub(crate) type Publishers = BTreeMap<String, usize>;

pub(crate) fn publishers(topics: Vec<TopicInfo>) -> Publishers {
    let mut publishers = Publishers::new();
    for topic in topics {
        *publishers.entry(topic.name).or_default() += topic.publishers.len();
    }
    publishers
}

impl PictureSubscription {
    /// Subscribes to the compressed sibling of `topic`.
    ///
    /// # Errors
    /// The subscription cannot be created.
    pub(crate) fn new(node: &Node, topic: &str, qos: Qos) -> Result<Self, Error> {
        Self::made(node, topic, qos, false)
    }

    /// Like [`new`](Self::new), for a latched topic: receives earlier pictures too, from publishers with any QoS.
    ///
    /// # Errors
    /// The subscription cannot be created.
    pub(crate) fn of_latched(node: &Node, topic: &str, qos: Qos) -> Result<Self, Error> {
        Self::made(node, topic, qos, true)
    }

    fn made(node: &Node, topic: &str, qos: Qos, is_latched: bool) -> Result<Self, Error> {
        let sibling = node.resolve_sibling(topic, "compressed")?;
        let compressed = match is_latched {
            true => node.subscription_to_any(&sibling, qos)?,
            false => node.subscription(&sibling, qos)?,
        };
        Ok(Self {
            node: node.clone(),
            topic: node.resolve(topic)?,
            qos,
            compressed,
            raw: None,
            is_latched,
        })
    }

    /// Publishers of both transports.
    pub(crate) fn publishers(&self, publishers: &Publishers) -> usize {
        // a topic without publishers has no entry
        let count = |topic: &str| publishers.get(topic).copied().unwrap_or(0);
        count(&self.topic) + count(self.compressed.topic())
    }

    /// Subscribes to raw images if there are no compressed ones; otherwise unsubscribes from raw images.
    ///
    /// # Errors
    /// The subscription cannot be created.
    pub(crate) fn look(&mut self, publishers: &Publishers) -> Result<(), Error> {
        let has = |topic: &str| publishers.get(topic).is_some_and(|number| *number > 0);
        let wants_raw = has(&self.topic) && !has(self.compressed.topic());
        if wants_raw && self.raw.is_none() {
            tracing::info!("{} is published only raw: encoding its images", self.topic);
            let raw = match self.is_latched {
                true => self.node.subscription_to_any(&self.topic, self.qos)?,
                false => self.node.subscription(&self.topic, self.qos)?,
            };
            self.raw = Some(raw);
        } else if !wants_raw {
            self.raw = None;
        }
        Ok(())
    }

    /// The next picture; `None` after shutdown. Cancel safe.
    pub(crate) async fn recv(&mut self) -> Option<Received<CameraFrame>> {
        let raw = async {
            match &mut self.raw {
                Some(raw) => raw.recv().await,
                None => std::future::pending().await,
            }
        };
        tokio::select! {
            received = self.compressed.recv() => received.map(|received| received.map(CameraFrame::Compressed)),
            received = raw => received.map(|received| received.map(CameraFrame::Raw)),
        }
    }
}

impl Endpoint for PictureSubscription {
    fn specs(name: &str, qos: Qos, text: &str) -> Vec<EndpointSpec> {
        let direction = Direction::Subscribed;
        let compressed = format!("{name}/compressed");
        vec![
            EndpointSpec::topic::<CompressedImage>(direction, &compressed, qos, text),
            EndpointSpec::topic::<Image>(
                direction,
                name,
                qos,
                "The same, raw, while nobody publishes it compressed.",
            ),
        ]
    }

    fn make(node: &Node, name: &str, qos: Qos) -> Result<Self, Error> {
        Self::new(node, name, qos)
    }
}
