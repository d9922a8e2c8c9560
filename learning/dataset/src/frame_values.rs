use anyhow::{Context as _, Result};

use crate::{Dataset, Episode, Latents};

/// Episodes with some values for each frame, which clips are cut from: the pictures themselves, or what a frozen encoder
/// makes of them.
pub trait FrameValues: Sync {
    /// The episodes, in the order of their frames.
    fn episodes(&self) -> &[Episode];

    /// Rows, columns and channels of a frame's values.
    fn shape(&self) -> (usize, usize, usize);

    /// Appends the values of frame `index`, in row-major order, to `out`.
    ///
    /// # Errors
    /// When there is no such frame.
    fn read(&self, index: usize, out: &mut Vec<f32>) -> Result<()>;
}

impl FrameValues for Latents {
    fn episodes(&self) -> &[Episode] {
        self.episodes()
    }

    fn shape(&self) -> (usize, usize, usize) {
        self.space().shape()
    }

    fn read(&self, index: usize, out: &mut Vec<f32>) -> Result<()> {
        self.read(index, out)
    }
}

/// Red, green and blue in 0..1.
impl FrameValues for Dataset {
    fn episodes(&self) -> &[Episode] {
        self.episodes()
    }

    fn shape(&self) -> (usize, usize, usize) {
        let (height, width) = self.size();
        (height, width, 3)
    }

    fn read(&self, index: usize, out: &mut Vec<f32>) -> Result<()> {
        let frame = self
            .frame(index)
            .with_context(|| format!("no frame {index}"))?;
        out.extend(frame.iter().map(|value| f32::from(*value) / 255.0));
        Ok(())
    }
}
