//! The policy that plays an episode by topics.

use std::time::Duration;

use anyhow::{Context as _, Result};
use tokio::time::Instant;
use wm_msgs::builtin_interfaces::Time;
use wm_ros::Publisher;

use super::{
    super::{EnvError, Moved, Observation},
    EnvNode,
    active::{Active, InFlight, RESEND},
};
use crate::history::{HistoryError, seconds};
use wm_wire::image_message::encode_image;

/// How long a policy may take before it is asked after.
const PATIENCE: Duration = Duration::from_secs(5);

impl Active {
    pub(super) fn has_policy(&self) -> bool {
        self.is_seen() && self.actions.publishers() + self.chunks.publishers() > 0
    }

    fn is_seen(&self) -> bool {
        let raws = self.raws.as_ref().map_or(0, Publisher::subscribers);
        raws + self.jpegs.as_ref().map_or(0, Publisher::subscribers) > 0
    }

    /// What a policy still lacks, in a word and in words.
    pub(super) fn missing(&self) -> (&'static str, String) {
        if self.is_seen() {
            let topics = [self.chunks.topic(), self.actions.topic()].join(" or ");
            (
                "policy's actions",
                format!("no policy yet: nobody publishes {topics}"),
            )
        } else {
            let topics = [
                self.jpegs.as_ref().map(Publisher::topic),
                self.raws.as_ref().map(Publisher::topic),
            ];
            let topics: Vec<_> = topics.into_iter().flatten().collect();
            let topics = topics.join(" or ");
            (
                "policy",
                format!("no policy yet: nobody subscribes to {topics}"),
            )
        }
    }

    /// Sends the observation again that the policy does not answer, and asks after it.
    pub(super) fn remind(&mut self, now: Instant) -> Result<()> {
        if let Some(played) = &mut self.played
            && !played.is_over
            && now.duration_since(played.published) >= RESEND
            && matches!(self.in_flight, InFlight::Nothing)
        {
            played.published = now;
            let observation = played.observation.clone();
            let is_long = now.duration_since(played.shown) >= PATIENCE;
            self.publish(&observation)?;
            if is_long {
                let stamp = seconds(observation.jpeg.header.stamp);
                let topics = [self.chunks.topic(), self.actions.topic()].join(" or ");
                self.complaints.waiting(
                    "actions",
                    false,
                    &format!("no actions on {topics} for the image of {stamp}"),
                );
            }
        }
        Ok(())
    }

    /// The played episode has taken a step, or has ended.
    pub(super) fn stepped(&mut self, moved: Result<Moved, EnvError>, node: &EnvNode) -> Result<()> {
        let moved = moved.context("the episode played by topics")?;
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
            self.publish(&observation)?;
            played.observation = observation;
        }
        let now = Instant::now();
        self.complaints.working("an episode is played by topics");
        played.published = now;
        played.shown = now;
        played.due = (played.due + node.parameters.period).max(now);
        played.is_over |= moved.truncated;
        self.played = Some(played);
        Ok(())
    }

    pub(super) fn publish(&self, observation: &Observation) -> Result<()> {
        if let Some(raws) = &self.raws {
            let header = observation.jpeg.header.clone();
            raws.publish(&encode_image(&observation.picture, header))?;
        }
        if let Some(jpegs) = &self.jpegs {
            jpegs.publish(&observation.jpeg)?;
        }
        Ok(())
    }

    /// Reports what became of an action or a chunk of this stamp; none: there is no episode that it could be for.
    pub(super) fn note(&mut self, taken: Option<Result<bool, HistoryError>>, stamp: Time) {
        let shown = self.played.as_ref();
        let shown = shown.map(|played| seconds(played.observation.jpeg.header.stamp));
        match taken {
            Some(Ok(true)) => {}
            Some(Ok(false)) => self.complaints.left_out(
                "untimely_action",
                &format_args!(
                    "the action of {} is not of this moment: stamp it with the stamp of the image that it answers, the newest \
                     is that of {}",
                    seconds(stamp),
                    shown.as_deref().unwrap_or("none")
                ),
            ),
            Some(Err(error)) => self.complaints.left_out("malformed_action", &error),
            None => self.complaints.left_out(
                "no_episode",
                &"an action came while no episode is played by topics",
            ),
        }
    }
}
