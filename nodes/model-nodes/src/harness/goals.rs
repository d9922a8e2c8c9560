//! Goal images, encoded beside the message loop.

use std::sync::{Arc, Mutex};

use anyhow::{Context as _, Result};
use wm_camera::camera_frame::CameraFrame;
use wm_ros::{Received, complaints::Complaints};
use wm_wire::transport::ImageSubscription;

use crate::{
    encoder::{EncoderError, EncoderStep},
    history::seconds,
    planner::Goal,
    pool::Pool,
    work::Work,
};

/// Makes goals of images. The newest is enough: one may wait.
pub struct Goals(Work<CameraFrame, Result<Goal, EncoderError>>);

impl Goals {
    /// Goals by this encoder, computed on these threads.
    pub fn new(encoder: &Arc<Mutex<EncoderStep>>, pool: &Pool) -> Self {
        Self(Goal::work(encoder, pool))
    }

    /// The next goal; `None` at the shutdown. Cancel safe.
    ///
    /// # Errors
    /// The encoder panicked.
    pub async fn next(
        &mut self,
        images: &mut ImageSubscription,
        complaints: &mut Complaints,
    ) -> Result<Option<Goal>> {
        loop {
            tokio::select! {
                biased;
                finished = self.0.finished() => match finished.context("the goal's thread")? {
                    Ok(goal) => {
                        tracing::info!("goal set: the image of {}", seconds(goal.stamp));
                        return Ok(Some(goal));
                    }
                    Err(error) => complaints.left_out("bad_goal", &format_args!("goal image: {error}")),
                },
                received = images.recv() => {
                    let Some(Received { message, .. }) = received else { return Ok(None) };
                    if self.0.submit(message).is_some() {
                        complaints.left_out("superseded_goal", &"a newer goal arrived before this one was encoded");
                    }
                }
            }
        }
    }
}
