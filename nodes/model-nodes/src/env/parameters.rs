//! The env's parameters.

use std::{path::PathBuf, time::Duration};

use anyhow::Result;
use wm_msgs::wm_msgs::EnvResetRequest;
use wm_ros::{Descriptor, Node};

use super::{EnvError, EnvSettings, Start, StartRoot};
use crate::{chunk_merging, timeline::ChunkMerging};

/// What the parameters say, read once at the start.
#[derive(Clone, Debug)]
pub(super) struct Parameters {
    /// What is asked of an episode that is played by topics, and where the others begin that do not say so.
    pub reset: EnvResetRequest,
    /// Where the bags and images are that a call may name.
    pub start_root: StartRoot,
    /// Settings of the state.
    pub settings: EnvSettings,
    /// Episodes computed together at most.
    pub batch: usize,
    /// Episodes that are played by topics, one after the other.
    pub episodes: u64,
    /// Least time from one step to the next, of an episode that is played by topics.
    pub period: Duration,
    /// Whether the last action is held where none comes in time.
    pub hold: bool,
    /// How overlapping chunks are merged.
    pub merging: ChunkMerging,
    /// Euler steps a predicted frame; 0: what the model was trained for.
    pub integration_steps: usize,
    /// From one camera frame, and one action, to the next \[s\].
    pub frame_period: f64,
    /// How long an episode waits for the image that it starts from.
    pub start_timeout: Duration,
}

impl Parameters {
    pub(super) fn declare(node: &Node) -> Result<Self> {
        let text = |name: &str, default: &str, text: &str| -> Result<String> {
            let descriptor = Descriptor::new(text).read_only();
            Ok(node.declare(name, default.to_owned(), descriptor)?.get())
        };
        let count =
            |name: &str, default: i64, (least, most): (i64, i64), text: &str| -> Result<i64> {
                let descriptor = Descriptor::new(text).integers(least, most).read_only();
                Ok(node.declare(name, default, descriptor)?.get())
            };
        let number =
            |name: &str, default: f64, (least, most): (f64, f64), text: &str| -> Result<f64> {
                let descriptor = Descriptor::new(text).floats(least, most).read_only();
                Ok(node.declare(name, default, descriptor)?.get())
            };
        let seed = Descriptor::new(
            "seed of the first episode that is played by topics; each later one adds 1",
        );
        let hold = Descriptor::new(
            "whether a policy's last action is held where none has come in time; else the env waits for it",
        );
        let output = text(
            "output",
            "out/env",
            "folder for the episodes' bags; empty: no bags",
        )?;
        // The descriptors keep the numbers within the types that they are cast to; a seed is any 64 bits.
        Ok(Self {
            reset: EnvResetRequest {
                bag: text("bag", "", "bag that episodes start from")?,
                bag_offset: number(
                    "bag_offset",
                    0.0,
                    (0.0, 1e9),
                    "from the bag's start to the episode's [s]",
                )?,
                image: text(
                    "image",
                    "",
                    "image file (PNG, JPEG) that episodes start from",
                )?,
                topic: text(
                    "topic",
                    "",
                    "camera topic whose next image episodes start from",
                )?,
                seed: node.declare("seed", 0_i64, seed.read_only())?.get() as u64,
                ..EnvResetRequest::default()
            },
            start_root: StartRoot::new(&text(
                "start_root",
                ".",
                "folder below which bags and images are that ~/reset may name; empty: it may name none",
            )?)?,
            settings: EnvSettings {
                max_episodes: count(
                    "max_episodes",
                    16,
                    (1, 4096),
                    "episodes that may be open at once",
                )? as usize,
                max_steps: count("max_steps", 50, (1, 1_000_000), "steps of an episode")? as u32,
                context_frames: count(
                    "context_frames",
                    2,
                    (1, 64),
                    "frames, one model step apart, that an episode starts from",
                )? as usize,
                jpeg_quality: count("jpeg_quality", 95, (1, 100), "JPEG quality of observations")?
                    as u8,
                instruction: text(
                    "instruction",
                    "",
                    "what the policy is to do, where a bag does not say it",
                )?,
                output: (!output.is_empty()).then(|| PathBuf::from(output)),
            },
            batch: count(
                "batch",
                8,
                (1, 256),
                "episodes that are computed together at most",
            )? as usize,
            episodes: count(
                "episodes",
                0,
                (0, 1_000_000_000),
                "episodes played by topics, after which the env ends; 0: episodes begin by ~/reset only",
            )? as u64,
            period: Duration::from_secs_f64(
                1.0 / number(
                    "rate",
                    2.5,
                    (0.001, 1000.0),
                    "steps a second at most, by topics",
                )?,
            ),
            hold: node.declare("hold", false, hold.read_only())?.get(),
            merging: chunk_merging::declare(node)?,
            integration_steps: count(
                "integration_steps",
                0,
                (0, 1000),
                "Euler steps a frame; 0: what the model was trained for",
            )? as usize,
            frame_period: number(
                "frame_period",
                0.2,
                (1e-3, 60.0),
                "time from one camera-rate action to the next [s], as the model was trained",
            )?,
            start_timeout: Duration::from_secs_f64(number(
                "start_timeout",
                10.0,
                (0.1, 3600.0),
                "how long an episode waits for the image that it starts from [s]",
            )?),
        })
    }

    /// Where an episode begins: as the request says, else as the parameters do.
    pub(super) fn start(&self, request: &EnvResetRequest) -> Result<Start, EnvError> {
        match Start::of(request)? {
            Some(start) => self.start_root.admit(start),
            None => Start::of(&self.reset)?.ok_or(EnvError::Starts(0)),
        }
    }
}
