//! The env's parameters.

use std::{path::PathBuf, time::Duration};

use wm_msgs::wm_msgs::EnvResetRequest;
use wm_wire::transport::Transports;

use super::{EnvError, EnvSettings, Start, StartRoot};
use crate::chunk_merging::Merging;

wm_ros::parameters! {
    /// The node's parameters, read once at the start.
    pub(super) struct Parameters {
        /// Image transport of the observations.
        pub image_transport: Transports = "both";
        /// Bag that episodes start from, unless their reset names another start. Set at most one of bag, image and
        /// topic.
        bag: String = "";
        /// Image file (PNG, JPEG) that episodes start from.
        image: String = "";
        /// Camera topic whose next image episodes start from.
        topic: String = "";
        /// Calls of ~/reset may name bags and images only below this folder; empty: they may name none. Anybody in the
        /// ROS graph can call.
        pub start_root: String = ".";
        /// Time from the start of the bag to the start of the episode [s].
        bag_offset: f64 = 0.0, in 0.0..=1e9;
        /// How long an episode waits for an image on the topic [s].
        pub start_timeout: Duration = 10.0, in 0.1..=3600.0;
        /// The policy's task in words, if neither the request nor the bag has an instruction.
        instruction: String = "";
        /// Number of episodes to play through topics, one after the other, before the node ends; 0: episodes begin only
        /// with ~/reset.
        pub episodes: u64 = 0, in 0..=1_000_000_000;
        /// Seed of the first episode that is played through topics; each later episode adds 1.
        seed: i64 = 0;
        /// Maximum steps per second of an episode that is played through topics. With a model step of 0.4 s, 2.5 is
        /// real time. Faster, the stamps run ahead of the clock, and encoder and evaluator refuse them.
        rate: f64 = 2.5, in 0.001..=1000.0;
        /// Whether the policy's last action is held if the next one is late. If false, the env waits for it.
        pub hold: bool = false;
        /// How overlapping action chunks are merged; weighted: 0.3 of the older and 0.7 of the newer chunk.
        pub merging as "chunk_merging": Merging = "latest";
        /// Maximum number of steps of an episode.
        max_steps: u32 = 50, in 1..=1_000_000;
        /// Maximum number of open episodes.
        pub max_episodes: usize = 16, in 1..=4096;
        /// Maximum number of episodes that are computed in one batch.
        pub batch: usize = 8, in 1..=256;
        /// Number of frames that an episode starts from, one model step apart.
        context_frames: usize = 2, in 1..=64;
        /// Euler steps per predicted frame; 0: the model's own number.
        pub integration_steps: usize = 0, in 0..=1000;
        /// Period of the policy's actions at the camera's frame rate [s]; 0: as in the model's training.
        pub frame_period: f64 = 0.0, in 0.0..=60.0;
        /// JPEG quality of the observations.
        jpeg_quality: u8 = 95, in 1..=100;
        /// Folder for the bags of the episodes; empty: no bags.
        output: PathBuf = "out/env";
    }
}

impl Parameters {
    /// Settings of an episode that is played through topics, and the default start of others.
    pub(super) fn reset(&self) -> EnvResetRequest {
        EnvResetRequest {
            bag: self.bag.clone(),
            bag_offset: self.bag_offset,
            image: self.image.clone(),
            topic: self.topic.clone(),
            // Any 64 bits are a seed.
            seed: self.seed as u64,
            ..EnvResetRequest::default()
        }
    }

    /// Settings of the state.
    pub(super) fn settings(&self) -> EnvSettings {
        EnvSettings {
            max_episodes: self.max_episodes,
            max_steps: self.max_steps,
            context_frames: self.context_frames,
            jpeg_quality: self.jpeg_quality,
            instruction: self.instruction.clone(),
            output: Some(self.output.clone()).filter(|output| !output.as_os_str().is_empty()),
        }
    }

    /// Least time from one step to the next, of an episode that is played through topics.
    pub(super) fn period(&self) -> Duration {
        // The range keeps it within 1 ms and 1000 s.
        Duration::from_secs_f64(1.0 / self.rate)
    }

    /// The start of an episode: from the request, below `root`, else from the parameters.
    pub(super) fn start(
        &self,
        request: &EnvResetRequest,
        root: &StartRoot,
    ) -> Result<Start, EnvError> {
        match Start::of(request)? {
            Some(start) => root.admit(start),
            None => self.own_start(),
        }
    }

    /// The start of an episode if its request names none.
    pub(super) fn own_start(&self) -> Result<Start, EnvError> {
        Start::of(&self.reset())?.ok_or(EnvError::Starts(0))
    }
}
