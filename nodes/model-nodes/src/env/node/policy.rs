//! The policy that plays an episode through topics.

use std::time::Duration;

use anyhow::{Context as _, Result};
use tokio::time::Instant;
use wm_msgs::builtin_interfaces::Time;

use super::{
    super::{EnvError, Moved, Observation},
    EnvNode,
    active::{Active, InFlight, RESEND},
};
use crate::history::{HistoryError, seconds};
use wm_camera::image_message::encode_image;
use wm_wire::transport::Pictures;

/// How long a policy may take before the env warns.
const PATIENCE: Duration = Duration::from_secs(5);

pub(super) fn has_policy(node: &EnvNode) -> bool {
    let endpoints = &node.endpoints;
    is_seen(node) && endpoints.actions.publishers() + endpoints.chunks.publishers() > 0
}

fn is_seen(node: &EnvNode) -> bool {
    node.endpoints.pictures.subscribers() > 0
}

fn action_topics(node: &EnvNode) -> String {
    let endpoints = &node.endpoints;
    [endpoints.chunks.topic(), endpoints.actions.topic()].join(" or ")
}

/// What is missing of a policy, as a word and as a sentence.
pub(super) fn missing(node: &EnvNode) -> (&'static str, String) {
    if is_seen(node) {
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

impl Active {
    /// Sends an unanswered observation again, and warns.
    pub(super) fn remind(&mut self, now: Instant, node: &EnvNode) -> Result<()> {
        if let Some(played) = &mut self.played
            && !played.is_over
            && now.duration_since(played.published) >= RESEND
            && matches!(self.in_flight, InFlight::Nothing)
        {
            played.published = now;
            let observation = played.observation.clone();
            let is_long = now.duration_since(played.shown) >= PATIENCE;
            publish(&observation, node)?;
            if is_long {
                let stamp = seconds(observation.jpeg.header.stamp);
                let topics = action_topics(node);
                self.complaints.waiting(
                    "actions",
                    false,
                    &format!("no actions on {topics} for the image of {stamp}"),
                );
            }
        }
        Ok(())
    }

    /// Handles a step or the end of the episode.
    pub(super) fn stepped(&mut self, moved: Result<Moved, EnvError>, node: &EnvNode) -> Result<()> {
        let moved = moved.context("the episode played through topics")?;
        let Some(mut played) = self.played.take() else {
            return Ok(());
        };
        if played.is_over && moved.observations.is_empty() {
            let name = played.attached.episode_id();
            match &moved.bag {
                Some(bag) => tracing::info!(
                    "episode {name} ends after {} steps: {}",
                    moved.steps,
                    bag.display()
                ),
                None => tracing::info!("episode {name} ends after {} steps", moved.steps),
            }
            return Ok(());
        }
        for observation in moved.observations {
            played.attached.observed(observation.jpeg.header.stamp);
            publish(&observation, node)?;
            played.observation = observation;
        }
        let now = Instant::now();
        self.complaints
            .working("an episode is played through topics");
        played.published = now;
        played.shown = now;
        played.due = (played.due + node.parameters.period()).max(now);
        played.is_over |= moved.truncated;
        self.played = Some(played);
        Ok(())
    }

    /// Reports the fate of an action or a chunk of this stamp; `None`: there is no episode for it.
    pub(super) fn note(&mut self, taken: Option<Result<bool, HistoryError>>, stamp: Time) {
        let shown = self.played.as_ref();
        let shown = shown.map(|played| seconds(played.observation.jpeg.header.stamp));
        match taken {
            Some(Ok(true)) => {}
            Some(Ok(false)) => self.complaints.left_out(
                "untimely_action",
                &format_args!(
                    "the action of {} does not answer the current image: stamp it with the stamp of the image that it \
                     answers; the newest image is that of {}",
                    seconds(stamp),
                    shown.as_deref().unwrap_or("none")
                ),
            ),
            Some(Err(error)) => self.complaints.left_out("malformed_action", &error),
            None => self.complaints.left_out(
                "no_episode",
                &"an action arrived while no episode is played through topics",
            ),
        }
    }
}
