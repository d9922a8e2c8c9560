use anyhow::{Result, ensure};
use candle_core::{Device, Tensor};
use rand::Rng;
use wm_motion::actions::ActionEncoding;

use crate::FrameValues;

/// Clips of model steps from episodes: random ones for training, or given ones.
pub struct ClipSource<'a> {
    values: &'a dyn FrameValues,
    encoding: &'a ActionEncoding,
    /// Frames per clip.
    frames: usize,
    /// Episodes of sufficient length.
    episodes: Vec<usize>,
    device: Device,
}

/// A clip: an episode and the first camera frame in it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Clip {
    episode: usize,
    start: usize,
}

impl Clip {
    /// Index of its episode.
    #[must_use]
    pub fn episode(&self) -> usize {
        self.episode
    }

    /// The clip of episode `episode` from camera frame `start`.
    #[must_use]
    pub fn new(episode: usize, start: usize) -> Self {
        Self { episode, start }
    }
}

impl<'a> ClipSource<'a> {
    /// Clips of `frames` frames, one model step apart; shorter episodes are skipped.
    ///
    /// # Errors
    /// If no episode is long enough.
    pub fn new(
        values: &'a dyn FrameValues,
        encoding: &'a ActionEncoding,
        frames: usize,
    ) -> Result<Self> {
        let mut source = Self {
            values,
            encoding,
            frames,
            episodes: Vec::new(),
            device: Device::Cpu,
        };
        let span = source.span();
        let episodes = values.episodes().iter().enumerate();
        source.episodes = episodes
            .filter(|(_, episode)| episode.frame_count >= span)
            .map(|(index, _)| index)
            .collect();
        ensure!(
            !source.episodes.is_empty(),
            "no episode is long enough: a clip of {frames} steps needs {span} frames"
        );
        Ok(source)
    }

    /// Moves tensors to `device`.
    #[must_use]
    pub fn on(self, device: &Device) -> Self {
        let device = device.clone();
        Self { device, ..self }
    }

    /// Number of usable episodes.
    #[must_use]
    pub fn len(&self) -> usize {
        self.episodes.len()
    }

    /// Always false: `new` rejects an empty source.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.episodes.is_empty()
    }

    /// Frames per clip.
    #[must_use]
    pub fn frames(&self) -> usize {
        self.frames
    }

    /// Encoding of the clips' actions.
    #[must_use]
    pub fn encoding(&self) -> &ActionEncoding {
        self.encoding
    }

    /// Index of a clip's first frame in the dataset.
    #[must_use]
    pub fn first_frame(&self, clip: Clip) -> usize {
        self.values.episodes()[clip.episode].first_frame + clip.start
    }

    /// Rows, columns and channels of a frame.
    #[must_use]
    pub fn shape(&self) -> (usize, usize, usize) {
        self.values.shape()
    }

    /// Values of a model action.
    #[must_use]
    pub fn action_dim(&self) -> usize {
        self.encoding.action_dim()
    }

    /// Camera frames covered by a clip.
    fn span(&self) -> usize {
        (self.frames - 1) * self.encoding.frame_skip() + 1
    }

    /// A random clip.
    pub fn draw(&self, rng: &mut impl Rng) -> Clip {
        let episode = self.episodes[rng.random_range(0..self.episodes.len())];
        let last = self.values.episodes()[episode].frame_count - self.span();
        Clip {
            episode,
            start: rng.random_range(0..=last),
        }
    }

    /// All non-overlapping clips, in order.
    #[must_use]
    pub fn all(&self) -> Vec<Clip> {
        let clips = self.episodes.iter().flat_map(|episode| {
            let starts = 0..=self.values.episodes()[*episode].frame_count - self.span();
            let episode = *episode;
            starts
                .step_by(self.span())
                .map(move |start| Clip { episode, start })
        });
        clips.collect()
    }

    /// `count` random clips as [`Self::tensors`].
    ///
    /// # Errors
    /// If frames cannot be read.
    pub fn batch(&self, count: usize, rng: &mut impl Rng) -> Result<(Tensor, Tensor)> {
        let clips: Vec<Clip> = (0..count).map(|_| self.draw(rng)).collect();
        self.tensors(&clips)
    }

    /// Values (B, frames, h, w, C) and the action of each frame (B, frames, A).
    ///
    /// # Errors
    /// If frames cannot be read.
    pub fn tensors(&self, clips: &[Clip]) -> Result<(Tensor, Tensor)> {
        let (mut values, mut actions) = (Vec::new(), Vec::new());
        for clip in clips {
            self.load(*clip, &mut values, &mut actions)?;
        }
        let (b, n, (h, w, c)) = (clips.len(), self.frames, self.shape());
        Ok((
            Tensor::from_vec(values, (b, n, h, w, c), &self.device)?,
            Tensor::from_vec(actions, (b, n, self.action_dim()), &self.device)?,
        ))
    }

    /// Appends a clip's values (frames, h, w, C) and the model action from each frame to the next (frames, A). At the
    /// end of an episode, the last action repeats.
    pub fn load(&self, clip: Clip, values: &mut Vec<f32>, actions: &mut Vec<f32>) -> Result<()> {
        let episode = &self.values.episodes()[clip.episode];
        let skip = self.encoding.frame_skip();
        for i in 0..self.frames {
            self.values
                .read(episode.first_frame + clip.start + i * skip, values)?;
        }
        for i in 0..self.frames {
            let first = clip.start + i * skip;
            // The last frames of an episode lack a whole step.
            let first = first.min(episode.actions.len().saturating_sub(skip));
            let step = self
                .encoding
                .encode_step(&episode.actions[first..first + skip])?;
            actions.extend(step.values);
        }
        Ok(())
    }
}
