use crate::onnx::{ClipFeatures, Features, Network, Networks, Role};
use anyhow::Result;
use image::RgbImage;

/// A network for features of frames or of clips.
#[derive(Debug)]
pub(super) enum FrameFeatures {
    Frames(Features),
    Clips(ClipFeatures),
}

impl FrameFeatures {
    pub(super) fn open(networks: &Networks, role: Role) -> Result<Self> {
        let takes_clips = networks
            .spec(role)
            .is_some_and(|spec| spec.input.frames.is_some());
        Ok(if takes_clips {
            Self::Clips(networks.clip_features(role)?)
        } else {
            Self::Frames(networks.features(role)?)
        })
    }

    pub(super) fn network(&self) -> &Network {
        match self {
            Self::Frames(features) => features.network(),
            Self::Clips(features) => features.network(),
        }
    }

    /// The reason if a video of `frames` is too short.
    pub(super) fn too_few(&self, frames: usize) -> Option<String> {
        match self {
            Self::Clips(features) if frames < features.frames() => Some(format!(
                "{frames} predicted frames, but a clip has {}",
                features.frames()
            )),
            _ => None,
        }
    }

    /// Vectors of the frames, or of consecutive clips; a rest is ignored.
    pub(super) fn of(&self, video: &[RgbImage]) -> Result<Vec<Vec<f32>>> {
        Ok(match self {
            Self::Frames(features) => features.of(video)?,
            Self::Clips(features) => features.of(&clips(video, features.frames()))?,
        })
    }
}

/// Consecutive clips without overlap.
fn clips<T>(video: &[T], frames: usize) -> Vec<&[T]> {
    video.chunks_exact(frames.max(1)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn clips_do_not_overlap_and_a_rest_is_ignored() {
        let frames: Vec<u8> = (0..45).collect();
        let clips = clips(&frames, 16);
        assert_eq!(clips, [&frames[..16], &frames[16..32]]);
        assert!(super::clips(&frames, 46).is_empty());
    }
}
