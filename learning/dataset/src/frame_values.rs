use anyhow::{Context as _, Result};

use crate::{Dataset, Episode, Latents};

/// Episodes with values for each frame, which clips are cut from: pictures, or latents of a frozen encoder.
pub trait FrameValues: Sync {
    /// Episodes by frame.
    fn episodes(&self) -> &[Episode];

    /// Rows, columns and channels of a frame.
    fn shape(&self) -> (usize, usize, usize);

    /// Appends the values of frame `index` to `out`, row-major.
    ///
    /// # Errors
    /// For an unknown index.
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
