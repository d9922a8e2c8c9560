//! The policy that plays an episode through topics.

use anyhow::Result;

use super::{super::Observation, EnvNode};
use wm_camera::image_message::encode_image;
use wm_wire::transport::Pictures;

/// Whether a policy subscribes to pictures and publishes actions.
pub(super) fn has_policy(node: &EnvNode) -> bool {
    let endpoints = &node.endpoints;
    has_subscriber(node) && endpoints.actions.publishers() + endpoints.chunks.publishers() > 0
}

fn has_subscriber(node: &EnvNode) -> bool {
    node.endpoints.pictures.subscribers() > 0
}

/// The topics of a policy's actions, for a log line.
pub(super) fn action_topics(node: &EnvNode) -> String {
    let endpoints = &node.endpoints;
    [endpoints.chunks.topic(), endpoints.actions.topic()].join(" or ")
}

/// The missing part of a policy, as a word and as a sentence.
pub(super) fn missing(node: &EnvNode) -> (&'static str, String) {
    if has_subscriber(node) {
        let topics = action_topics(node);
        (
            "policy's actions",
            format!("no policy yet: nobody publishes {topics}"),
        )
    } else {
        let topics = node.endpoints.pictures.topics().join(" or ");
        (
            "policy",
            format!("no policy yet: nobody subscribes to {topics}"),
        )
    }
}

/// Publishes the observations for the policy that is attached by topics.
pub(super) fn publish(observation: &Observation, node: &EnvNode) -> Result<()> {
    let transports = node.parameters.image_transport;
    let header = || observation.jpeg.header.clone();
    let pictures = Pictures {
        raw: transports
            .raw
            .then(|| encode_image(&observation.picture, header())),
        compressed: transports.compressed.then(|| observation.jpeg.clone()),
    };
    Ok(node.endpoints.pictures.publish(&pictures)?)
}
