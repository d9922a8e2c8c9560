//! A small model, and a camera with 5 frames a second, for the tests of steps.

#![allow(clippy::unwrap_used, reason = "a test's helpers may fail the test")]

use wm_model::{
    LatentSpace, WorldModel,
    transition::{Transition, TransitionConfig},
};
use wm_motion::actions::ActionEncoding;
use wm_msgs::{builtin_interfaces::Time, std_msgs::Header, wm_msgs::Latent};
use wm_wire::latent_message::{LatentDtype, encode_latent};

use crate::history::{ChunkMerging, History, HistorySettings, Timing};

/// Between two frames \[ns\].
pub(crate) const PERIOD: i64 = 200_000_000;
/// Stamp of frame 0 \[ns\].
pub(crate) const START: i64 = 1_700_000_000_000_000_000;

pub(crate) fn space() -> LatentSpace {
    LatentSpace {
        name: "test".into(),
        hash: "00ff".into(),
        height: 4,
        width: 4,
        channels: 4,
    }
}

/// The space of another model.
pub(crate) fn other_space() -> LatentSpace {
    LatentSpace {
        hash: "0100".into(),
        ..space()
    }
}

/// A model of random weights.
pub(crate) fn world_model() -> WorldModel {
    let config = TransitionConfig {
        hidden: 64,
        depth: 1,
        heads: 2,
        ..TransitionConfig::preset("tiny", (4, 4, 4), 2, 7).unwrap()
    };
    WorldModel {
        transition: Transition::random(config, 3).unwrap().pack().unwrap(),
        name: "test".into(),
        hash: "beef".into(),
        space: space(),
        encoding: ActionEncoding::default(),
    }
}

/// An empty history with a context of two frames, and two frames in a model step.
pub(crate) fn history() -> History {
    history_of(space())
}

/// The same, of another space.
pub(crate) fn history_of(space: LatentSpace) -> History {
    let settings = HistorySettings {
        timing: Timing::new(PERIOD, 2),
        context_frames: 2,
        merging: ChunkMerging::Latest,
    };
    let encoding = ActionEncoding::default();
    History::new(settings, space, encoding, Time::default())
}

/// Stamp of frame `index`.
pub(crate) fn stamp(index: i64) -> Time {
    Time::from_nanos(START + index * PERIOD)
}

/// The values of frame `index`.
pub(crate) fn values(index: i64) -> Vec<f32> {
    (0..64)
        .map(|i| ((i + 7 * index) as f32 * 0.3).sin())
        .collect()
}

/// The latent of frame `index`.
pub(crate) fn latent(index: i64) -> Latent {
    latent_of(index, &space())
}

/// The same in another space.
pub(crate) fn latent_of(index: i64, space: &LatentSpace) -> Latent {
    let header = Header {
        stamp: stamp(index),
        frame_id: "camera".into(),
    };
    encode_latent(&values(index), space, LatentDtype::F32, header).unwrap()
}
