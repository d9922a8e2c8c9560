//! Goals, encoded off the message loop.

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

/// A goal as it was received.
enum Source {
    Picture(CameraFrame),
    Message(GoalMessage),
}

/// Makes goals of messages. Only the newest counts, so one may wait.
pub struct Goals {
    work: Work<Source, Result<Goal, GoalError>>,
    /// Stamp of the newest goal of the topic `goal`.
    message_stamp: Option<Time>,
}

impl Goals {
    /// Goals that `reader` makes on the threads of `pool`.
    pub fn new(reader: GoalReader, pool: &Pool) -> Self {
        let read = move |source: Source, _: &_| match source {
            Source::Picture(frame) => reader.of_picture(&frame),
            Source::Message(message) => reader.of_message(&message),
        };
        Self {
            work: Work::new(1, read).on(pool),
            message_stamp: None,
        }
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
            if self.work.submit(source).is_some() {
                complaints.left_out(
                    "superseded_goal",
                    &"a newer goal arrived before this one was encoded",
                );
            }
        }
    }
}
