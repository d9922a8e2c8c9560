//! Goals, encoded off the message loop.

use std::sync::Arc;

use anyhow::{Context as _, Result};
use wm_camera::camera_frame::CameraFrame;
use wm_msgs::{builtin_interfaces::Time, wm_msgs::Goal as GoalMessage};
use wm_ros::{Node, Qos, Received, Subscription, complaints::Complaints};
use wm_wire::transport::ImageSubscription;

use crate::{
    history::seconds,
    planner::{Goal, GoalError, GoalReader},
    pool::Pool,
    work::Work,
};

wm_ros::endpoints! {
    /// What says what to reach.
    pub struct GoalInputs {
        /// The goal image, volatile or latched.
        images: ImageSubscription = "goal/image", made(ImageSubscription::catching_up);
        /// Goals of other kinds: several images or latents, a region, words. The newest message of both topics counts;
        /// of two with one stamp, this one.
        messages: Subscription<GoalMessage> = "goal", qos(Qos::reliable(2)), made(Node::subscription_catching_up);
    }
}

/// Why a goal is forgotten.
pub(crate) const OTHER_SPACE: &str = "the goal is a latent of the previous model, and the new one has another latent space: \
                                      the goal is forgotten; send it again";

/// A goal as it was received.
enum Source {
    Picture(CameraFrame),
    Message(GoalMessage),
}

impl Source {
    /// Whether only the model that made its latents can read it.
    fn is_latent(&self) -> bool {
        match self {
            Self::Picture(_) => false,
            Self::Message(message) => !message.latents.is_empty(),
        }
    }
}

/// Makes goals of messages. Only the newest counts, so one may wait.
pub struct Goals {
    work: Work<Arc<Source>, Result<Goal, GoalError>>,
    /// The newest one, for another model; `None` if the node stays with its model.
    newest: Option<Arc<Source>>,
    is_kept: bool,
    /// Stamp of the newest goal of the topic `goal`.
    message_stamp: Option<Time>,
}

impl Goals {
    /// Goals that `reader` makes on the threads of `pool`. If the newest one `is_kept`, another model can read it.
    pub fn new(reader: GoalReader, pool: &Pool, is_kept: bool) -> Self {
        let read = move |source: Arc<Source>, _: &_| match &*source {
            Source::Picture(frame) => reader.of_picture(frame),
            Source::Message(message) => reader.of_message(message),
        };
        Self {
            work: Work::new(1, read).on(pool),
            newest: None,
            is_kept,
            message_stamp: None,
        }
    }

    /// Continues from the goals of the model `before`, of which the newest one `is_set`. It is read again if the new model
    /// has another latent space, or if it was still being read. Returns false if it cannot be read again.
    pub fn continue_from(&mut self, before: &Self, is_set: bool, is_same_space: bool) -> bool {
        self.newest.clone_from(&before.newest);
        self.message_stamp = before.message_stamp;
        let is_wanted = before.work.is_running() || (is_set && !is_same_space);
        let Some(source) = self.newest.clone().filter(|_| is_wanted) else {
            return !is_wanted;
        };
        let is_readable = is_same_space || !source.is_latent();
        if is_readable {
            // The new model has read none yet.
            let _ = self.work.submit(source);
        }
        is_readable
    }

    /// The next goal; `None` at the shutdown. Cancel safe.
    ///
    /// # Errors
    /// The encoder panicked.
    pub async fn next(
        &mut self,
        inputs: &mut GoalInputs,
        complaints: &mut Complaints,
    ) -> Result<Option<Goal>> {
        loop {
            let source = tokio::select! {
                biased;
                finished = self.work.finished() => match finished.context("the goal's thread")? {
                    Ok(goal) => {
                        tracing::info!("goal set: that of {}", seconds(goal.stamp));
                        return Ok(Some(goal));
                    }
                    Err(error) => {
                        complaints.left_out("bad_goal", &format_args!("goal: {error}"));
                        continue;
                    }
                },
                received = inputs.images.recv() => {
                    let Some(Received { message, .. }) = received else { return Ok(None) };
                    if self.message_stamp == Some(message.header().stamp) {
                        // The same goal; the message has more of it.
                        continue;
                    }
                    Source::Picture(message)
                }
                received = inputs.messages.recv() => {
                    let Some(Received { message, .. }) = received else { return Ok(None) };
                    self.message_stamp = Some(message.header.stamp).filter(|stamp| *stamp != Time::default());
                    Source::Message(message)
                }
            };
            if !self.take(source) {
                complaints.left_out(
                    "superseded_goal",
                    &"a newer goal arrived before this one was encoded",
                );
            }
        }
    }

    /// Begins to read a goal; returns false if that drops an earlier one.
    fn take(&mut self, source: Source) -> bool {
        let source = Arc::new(source);
        self.newest = self.is_kept.then(|| Arc::clone(&source));
        self.work.submit(source).is_none()
    }
}

#[cfg(test)]
mod tests;
