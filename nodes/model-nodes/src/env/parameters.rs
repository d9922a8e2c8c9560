//! The env's parameters.

use std::{path::PathBuf, time::Duration};

use wm_msgs::wm_msgs::EnvResetRequest;
use wm_wire::transport::Transports;

use super::{EnvError, EnvSettings, Start, StartRoot};
use crate::chunk_merging::Merging;

wm_ros::parameters! {
    /// What the parameters say, read once at the start.
    pub(super) struct Parameters {
        /// Image transport of the observations.
        pub image_transport: Transports = "both";
        /// Bag that episodes start from, where their reset does not say it; at most one of bag, image and topic.
        bag: String = "";
        /// Image file (PNG, JPEG) that episodes start from.
        image: String = "";
        /// Camera topic whose next image episodes start from.
        topic: String = "";
        /// Folder below which bags and images are that ~/reset may name; empty: it may name none. Anybody in the ROS graph
        /// may call.
        pub start_root: String = ".";
        /// From the bag's start to the episode's [s].
        bag_offset: f64 = 0.0, in 0.0..=1e9;
        /// How long an episode waits for the image of the topic [s].
        pub start_timeout: Duration = 10.0, in 0.1..=3600.0;
        /// What the policy is to do, where neither request nor bag says it.
        instruction: String = "";
        /// Episodes that are played by topics, one after the other, after which the node ends; 0: they begin by ~/reset
        /// only.
        pub episodes: u64 = 0, in 0..=1_000_000_000;
        /// Seed of the first episode that is played by topics; each later one adds 1.
        seed: i64 = 0;
        /// Steps per second at most, by topics. 2.5: as time passes for the robot, where a model step is 0.4 s.
        rate: f64 = 2.5, in 0.001..=1000.0;
        /// Whether a policy's last action is held where none has come in time; else the env waits for it.
        pub hold: bool = false;
        /// How overlapping action chunks are merged; weighted: 0.3 of the older, 0.7 of the newer.
        pub merging as "chunk_merging": Merging = "latest";
        /// Steps of an episode.
        max_steps: u32 = 50, in 1..=1_000_000;
        /// Episodes that may be open at once.
        pub max_episodes: usize = 16, in 1..=4096;
        /// Episodes that are computed together at most.
        pub batch: usize = 8, in 1..=256;
        /// Frames, one model step apart, that an episode starts from.
        context_frames: usize = 2, in 1..=64;
        /// Euler steps per predicted frame; 0: what the model was trained for.
        pub integration_steps: usize = 0, in 0..=1000;
        /// Time from one camera-rate action to the next [s], as the model was trained.
        pub frame_period: f64 = 0.2, in 1e-3..=60.0;
        /// JPEG quality of the observations.
        jpeg_quality: u8 = 95, in 1..=100;
        /// Folder for the episodes' bags; empty: no bags.
        output: PathBuf = "out/env";
    }
}

impl Parameters {
    /// What is asked of an episode that is played by topics, and where the others begin that do not say so.
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

    /// Least time from one step to the next, of an episode that is played by topics.
    pub(super) fn period(&self) -> Duration {
        // The range keeps it within 1 ms and 1000 s.
        Duration::from_secs_f64(1.0 / self.rate)
    }

    /// Where an episode begins: as the request says, below `root`, else as the parameters do.
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

    /// Where an episode begins whose request does not say it.
    pub(super) fn own_start(&self) -> Result<Start, EnvError> {
        Start::of(&self.reset())?.ok_or(EnvError::Starts(0))
    }
}
