use anyhow::{Context as _, Result, ensure};
use candle_core::{Device, Tensor};
use wm_dataset::{Dataset, Latents};
use wm_model::LatentSpace;

/// Frames of bags with their features from a frozen encoder.
#[derive(Clone, Copy, Debug)]
pub struct Frames<'a> {
    pictures: &'a Dataset,
    features: &'a Latents,
}

/// Size of one view.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct View {
    /// Rows of the features.
    pub rows: usize,
    pub columns: usize,
    pub channels: usize,
    /// Height of the picture.
    pub height: usize,
    pub width: usize,
}

impl<'a> Frames<'a> {
    /// `features` must belong to `pictures`.
    ///
    /// # Errors
    /// If they belong to other frames, or are empty.
    pub fn new(pictures: &'a Dataset, features: &'a Latents) -> Result<Self> {
        ensure!(
            pictures.digest() == features.digest(),
            "the features are of other frames than the pictures"
        );
        ensure!(pictures.frame_count() > 0, "no frames");
        Ok(Self { pictures, features })
    }

    /// Number of frames.
    #[must_use]
    pub fn count(&self) -> usize {
        self.pictures.frame_count()
    }

    /// Number of episodes.
    #[must_use]
    pub fn episodes(&self) -> usize {
        self.pictures.episodes().len()
    }

    /// Digest of the inputs.
    #[must_use]
    pub fn digest(&self) -> &str {
        self.pictures.digest()
    }

    /// Space of the features.
    #[must_use]
    pub fn space(&self) -> &LatentSpace {
        self.features.space()
    }

    /// At most `most` evenly spread frames.
    pub(super) fn spread(&self, most: usize) -> Vec<usize> {
        let stride = self.count().div_ceil(most.max(1)).max(1);
        (0..self.count()).step_by(stride).collect()
    }

    /// Size of one of `views` side by side.
    pub(super) fn view(&self, views: usize) -> Result<View> {
        let (rows, columns, channels) = self.space().shape();
        let (height, width) = self.pictures.size();
        ensure!(
            views > 0 && columns.is_multiple_of(views) && width.is_multiple_of(views),
            "views is {views}, which does not divide features and frames that are {columns} and {width} wide"
        );
        let (columns, width) = (columns / views, width / views);
        Ok(View {
            rows,
            columns,
            channels,
            height,
            width,
        })
    }

    /// Features (V N, h, w, D) and pictures (V N, H, W, 3) in 0..1 of these frames: the first view of all, the second
    /// of all, and so on.
    pub(super) fn of(&self, frames: &[usize], views: usize) -> Result<(Tensor, Tensor)> {
        let (mut features, mut pictures) = (Vec::new(), Vec::new());
        for frame in frames {
            self.features.read(*frame, &mut features)?;
            let picture = self.pictures.frame(*frame);
            let picture = picture.with_context(|| format!("no frame {frame}"))?;
            pictures.extend(picture.iter().map(|value| f32::from(*value) / 255.0));
        }
        let (rows, columns, channels) = self.space().shape();
        let (height, width) = self.pictures.size();
        let features = Tensor::from_vec(features, ((), rows, columns, channels), &Device::Cpu)?;
        let pictures = Tensor::from_vec(pictures, ((), height, width, 3), &Device::Cpu)?;
        Ok((apart(&features, views)?, apart(&pictures, views)?))
    }
}

/// (N, h, V w, C) to (V N, h, w, C).
fn apart(x: &Tensor, views: usize) -> Result<Tensor> {
    Ok(match views {
        1 => x.clone(),
        _ => Tensor::cat(&x.chunk(views, 2)?, 0)?,
    })
}
