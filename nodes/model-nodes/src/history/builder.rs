//! Empty histories for a model.

use wm_model::{LatentSpace, WorldModel};
use wm_motion::{actions::ActionEncoding, motion::ChunkMerging};
use wm_msgs::builtin_interfaces::Time;

use super::{History, HistorySettings, Timing};

/// Makes the empty history with which a node begins at each activation.
#[derive(Clone, Debug)]
pub struct HistoryBuilder {
    settings: HistorySettings,
    space: LatentSpace,
    encoding: ActionEncoding,
}

impl HistoryBuilder {
    /// Histories of the latents and actions of `model`, for a camera with `frame_period` \[s\] between frames.
    pub fn new(
        model: &WorldModel,
        frame_period: f64,
        context_frames: usize,
        merging: ChunkMerging,
    ) -> Self {
        Self {
            settings: HistorySettings {
                timing: Timing::of_camera(frame_period, &model.encoding),
                context_frames,
                merging,
            },
            space: model.space.clone(),
            encoding: model.encoding.clone(),
        }
    }

    /// How stamps are grouped into model steps.
    pub fn timing(&self) -> Timing {
        self.settings.timing
    }

    /// The space of the latents.
    pub fn space(&self) -> &LatentSpace {
        &self.space
    }

    /// An empty history that begins at `begin` by the node's clock.
    pub fn begin(&self, begin: Time) -> History {
        let (space, encoding) = (self.space.clone(), self.encoding.clone());
        History::new(self.settings, space, encoding, begin)
    }
}
