//! The two transports of an image topic: raw, and compressed on the sibling `<topic>/compressed`.

use image::RgbImage;
use wm_msgs::{
    sensor_msgs::{CompressedImage, Image},
    std_msgs::Header,
};
use wm_ros::{
    Direction, Endpoint, EndpointSpec, Field, Node, Parameter, Publisher, Qos, Received,
    Subscription,
};

use wm_camera::{
    camera_frame::CameraFrame,
    image_message::{ImageError, encode_image, encode_jpeg},
};

/// The transports that a node uses.
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

    /// From the node's parameter `image_transport`; both if it has none.
    pub fn of(node: &Node) -> Self {
        let name: Result<String, _> = node.parameter("image_transport");
        name.map_or(Self::BOTH, |name| Self::named(&name))
    }

    /// The parameter allows only these three names.
    fn named(name: &str) -> Self {
        Self {
            raw: name != "compressed",
            compressed: name != "raw",
        }
    }
}

/// The parameter `image_transport`.
impl Field for Transports {
    type Ros = String;
    const CHOICES: &'static [&'static str] = &["raw", "compressed", "both"];

    fn read(parameter: Parameter<String>) -> Option<Self> {
        Some(Self::named(&parameter.get()))
    }
}

/// The topic of the compressed images of `topic`, remapped with it.
fn compressed_of(node: &Node, topic: &str) -> Result<String, wm_ros::Error> {
    node.resolve_sibling(topic, "compressed")
}

/// A picture for each used transport.
#[derive(Clone, Debug, Default)]
pub struct Pictures {
    /// sensor_msgs/Image.
    pub raw: Option<Image>,
    /// sensor_msgs/CompressedImage.
    pub compressed: Option<CompressedImage>,
}

impl Pictures {
    /// The messages of a picture for these transports, with this header. The compressed one is a JPEG of this quality,
    /// 1 to 100.
    ///
    /// # Errors
    /// [`ImageError`]: JPEG does not allow the picture's size.
    pub fn encode(
        picture: &RgbImage,
        header: Header,
        transports: Transports,
        quality: u8,
    ) -> Result<Self, ImageError> {
        let raw = transports
            .raw
            .then(|| encode_image(picture, header.clone()));
        let compressed = transports
            .compressed
            .then(|| encode_jpeg(picture, header, quality));
        Ok(Self {
            raw,
            compressed: compressed.transpose()?,
        })
    }
}

/// Publishers of an image topic and its sibling, as selected by the parameter `image_transport`.
pub struct ImagePublisher {
    raw: Option<Publisher<Image>>,
    compressed: Option<Publisher<CompressedImage>>,
}

impl ImagePublisher {
    /// Publishes a picture by the used transports.
    ///
    /// # Errors
    /// See [`Publisher::publish`].
    pub fn publish(&self, pictures: &Pictures) -> Result<(), wm_ros::Error> {
        if let (Some(raw), Some(publisher)) = (&pictures.raw, &self.raw) {
            publisher.publish(raw)?;
        }
        if let (Some(compressed), Some(publisher)) = (&pictures.compressed, &self.compressed) {
            publisher.publish(compressed)?;
        }
        Ok(())
    }

    /// The publisher of compressed pictures, if used.
    pub fn compressed(&self) -> Option<&Publisher<CompressedImage>> {
        self.compressed.as_ref()
    }

    /// Subscriptions to either topic.
    pub fn subscribers(&self) -> usize {
        self.raw.as_ref().map_or(0, Publisher::subscribers)
            + self.compressed.as_ref().map_or(0, Publisher::subscribers)
    }

    /// The absolute topics, the compressed one first.
    pub fn topics(&self) -> Vec<&str> {
        let compressed = self.compressed.as_ref().map(Publisher::topic);
        compressed
            .into_iter()
            .chain(self.raw.as_ref().map(Publisher::topic))
            .collect()
    }
}

/// An image topic and its sibling.
fn specs(direction: Direction, name: &str, qos: Qos, text: &str) -> Vec<EndpointSpec> {
    let compressed = format!("{name}/compressed");
    vec![
        EndpointSpec::topic::<Image>(direction, name, qos, text),
        EndpointSpec::topic::<CompressedImage>(
            direction,
            &compressed,
            qos,
            "The same, compressed.",
        ),
    ]
}

impl Endpoint for ImagePublisher {
    fn specs(name: &str, qos: Qos, text: &str) -> Vec<EndpointSpec> {
        specs(Direction::Published, name, qos, text)
    }

    fn make(node: &Node, name: &str, qos: Qos) -> Result<Self, wm_ros::Error> {
        let Transports { raw, compressed } = Transports::of(node);
        let raw = raw.then(|| node.publisher(name, qos)).transpose()?;
        let compressed = compressed.then(|| node.publisher(&compressed_of(node, name)?, qos));
        Ok(Self {
            raw,
            compressed: compressed.transpose()?,
        })
    }
}

impl Endpoint for ImageSubscription {
    fn specs(name: &str, qos: Qos, text: &str) -> Vec<EndpointSpec> {
        specs(Direction::Subscribed, name, qos, text)
    }

    fn make(node: &Node, name: &str, qos: Qos) -> Result<Self, wm_ros::Error> {
        Self::new(node, name, Transports::of(node), qos)
    }
}

/// Frames of an image topic by the used transports.
pub struct ImageSubscription {
    raw: Option<Subscription<Image>>,
    compressed: Option<Subscription<CompressedImage>>,
}

impl ImageSubscription {
    /// Subscribes to `topic` and its sibling.
    ///
    /// # Errors
    /// The subscription cannot be created.
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

    /// Subscribes to `topic` and its sibling by the transports of the parameter `image_transport`. For latched images,
    /// such as goals: receives the last one too.
    ///
    /// # Errors
    /// The subscription cannot be created.
    pub fn catching_up(node: &Node, topic: &str, qos: Qos) -> Result<Self, wm_ros::Error> {
        let Transports { raw, compressed } = Transports::of(node);
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

    /// The absolute topics.
    pub fn topics(&self) -> Vec<&str> {
        let raw = self.raw.as_ref().map(Subscription::topic);
        raw.into_iter()
            .chain(self.compressed.as_ref().map(Subscription::topic))
            .collect()
    }

    /// A frame that has already arrived, by either transport.
    pub fn try_recv(&mut self) -> Option<Received<CameraFrame>> {
        let raw = self.raw.as_mut().and_then(Subscription::try_recv);
        if let Some(received) = raw {
            return Some(received.map(CameraFrame::Raw));
        }
        let compressed = self.compressed.as_mut().and_then(Subscription::try_recv);
        compressed.map(|received| received.map(CameraFrame::Compressed))
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

/// Waits forever if the transport is not used.
async fn recv_from<M: wm_msgs::Message>(
    subscription: &mut Option<Subscription<M>>,
) -> Option<Received<M>> {
    match subscription {
        Some(subscription) => subscription.recv().await,
        None => std::future::pending().await,
    }
}
