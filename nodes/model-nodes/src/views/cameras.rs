//! The subscriptions to the cameras.

use std::{future::poll_fn, task::Poll};

use wm_camera::camera_frame::CameraFrame;
use wm_ros::{Endpoint, EndpointSpec, Error, Node, Qos, Received};
use wm_wire::transport::{ImageSubscription, Transports};

/// Subscriptions to the image topics of the parameter `cameras`, in their order.
pub(super) struct Cameras {
    subscriptions: Vec<ImageSubscription>,
    /// The camera whose frames are looked for first.
    next: usize,
}

impl Endpoint for Cameras {
    fn specs(name: &str, qos: Qos, text: &str) -> Vec<EndpointSpec> {
        ImageSubscription::specs(name, qos, text)
    }

    fn make(node: &Node, _: &str, qos: Qos) -> Result<Self, Error> {
        let topics: Vec<String> = node.parameter("cameras")?;
        let topics = topics.iter().filter(|topic| !topic.is_empty());
        let subscribe =
            |topic: &String| ImageSubscription::new(node, topic, Transports::of(node), qos);
        Ok(Self {
            subscriptions: topics.map(subscribe).collect::<Result<_, _>>()?,
            next: 0,
        })
    }
}

impl Cameras {
    /// The absolute topics of each camera.
    pub fn topics(&self) -> Vec<Vec<&str>> {
        let subscriptions = self.subscriptions.iter();
        subscriptions.map(ImageSubscription::topics).collect()
    }

    /// The next frame, with the index of its camera; `None` after shutdown. Cancel safe. No camera delays the others: they
    /// take turns.
    pub async fn recv(&mut self) -> Option<(usize, Received<CameraFrame>)> {
        let count = self.subscriptions.len();
        let first = self.next;
        let mut receiving = Vec::with_capacity(count);
        for subscription in &mut self.subscriptions {
            receiving.push(Box::pin(subscription.recv()));
        }
        let received = poll_fn(|context| {
            for turn in 0..count {
                let camera = (first + turn) % count;
                let Some(receiving) = receiving.get_mut(camera) else {
                    continue;
                };
                if let Poll::Ready(received) = receiving.as_mut().poll(context) {
                    return Poll::Ready(received.map(|received| (camera, received)));
                }
            }
            Poll::Pending
        })
        .await;
        drop(receiving);
        if let Some((camera, _)) = &received {
            self.next = (camera + 1) % count;
        }
        received
    }
}
