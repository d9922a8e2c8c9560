//! Pictures to encode, and the last ones, which another model encodes again.

use std::{
    collections::VecDeque,
    sync::{Arc, Mutex, PoisonError},
    time::{Duration, Instant},
};

use image::RgbImage;
use wm_model::Framing;
use wm_msgs::{std_msgs::Header, wm_msgs::Latent};

use super::{EncoderError, EncoderStep, Needs};

/// Most pictures that are kept.
const MOST_KEPT: usize = 64;
/// Pictures of a camera that has been silent for longer, or for longer than two model steps, are not encoded again.
const SILENCE: Duration = Duration::from_secs(1);

/// A picture to encode.
#[derive(Clone)]
pub(super) struct Job {
    pub picture: RgbImage,
    pub header: Header,
    pub is_raw: bool,
    pub received: Instant,
    pub epoch: u64,
    pub change: f32,
    pub is_frozen: bool,
}

impl Job {
    fn latent(&self, step: &EncoderStep) -> Result<Latent, EncoderError> {
        let latent = step.encode_picture(&self.picture, &self.header)?;
        Ok(Latent {
            epoch: self.epoch,
            change: self.change,
            frozen: self.is_frozen,
            ..latent
        })
    }
}

/// The last encoded pictures, as many as a context spans, in the size of the encoder.
#[derive(Clone)]
pub(super) struct RecentPictures {
    jobs: Arc<Mutex<VecDeque<Job>>>,
    span_ns: i64,
    /// Greatest age of the newest picture.
    most_age: Duration,
    /// `None` if none are kept.
    framing: Option<Framing>,
}

impl RecentPictures {
    /// Pictures that fit the encoder by `framing`; if that is `None`, none are kept.
    pub fn new(needs: &Needs, framing: Option<Framing>) -> Self {
        let steps = needs.context_frames.saturating_sub(1);
        // Stamps are not exact.
        let tolerance = needs.frame_period / 2;
        // The parameter's range keeps a context within hours.
        let span = needs.step() * steps as u32 + tolerance;
        Self {
            jobs: Arc::default(),
            span_ns: i64::try_from(span.as_nanos()).unwrap_or(i64::MAX),
            most_age: SILENCE.max(needs.step() * 2),
            framing,
        }
    }

    /// Encodes a picture, and keeps it.
    pub fn encode(&self, mut job: Job, step: &EncoderStep) -> Result<Latent, EncoderError> {
        if self.framing.is_some() {
            // The encoder leaves a picture of its own size as it is.
            job.picture = step.framed(&job.picture)?;
            self.keep(job.clone());
        }
        job.latent(step)
    }

    fn keep(&self, job: Job) {
        let mut jobs = self.jobs.lock().unwrap_or_else(PoisonError::into_inner);
        let stamp_ns = |job: &Job| job.header.stamp.to_nanos();
        if jobs.back().is_some_and(|last| job.epoch != last.epoch) {
            jobs.clear();
        }
        let oldest_ns = stamp_ns(&job).saturating_sub(self.span_ns);
        jobs.push_back(job);
        while jobs.len() > MOST_KEPT || jobs.front().is_some_and(|job| stamp_ns(job) < oldest_ns) {
            jobs.pop_front();
        }
    }

    /// The pictures of the camera's present `epoch` for an encoder that takes pictures by `framing`, oldest first. There
    /// are none if it takes other pictures, or if the newest picture is old `now`: its latent would look fresh.
    pub fn take(&self, epoch: u64, framing: Framing, now: Instant) -> Vec<Job> {
        let mut jobs = self.jobs.lock().unwrap_or_else(PoisonError::into_inner);
        let is_present = jobs.back().is_some_and(|newest| {
            newest.epoch == epoch && now.saturating_duration_since(newest.received) <= self.most_age
        });
        match is_present && self.framing == Some(framing) {
            true => jobs.drain(..).collect(),
            false => Vec::new(),
        }
    }
}

#[cfg(test)]
mod tests;
