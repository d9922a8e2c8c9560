//! Shape of an autoencoder.

use serde::{Deserialize, Serialize};

use super::network::Stage;
use crate::ops::ConvShape;
use crate::{Error, Fit, Framing, PictureSize, Result};

/// Shape of a convolutional autoencoder of the TAESD family.
///
/// The encoder is, at each level from the finest, some residual blocks and a step down to half the
/// size; the decoder is the same in reverse, with a step up by nearest neighbour.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AutoencoderConfig {
    /// Name of the latent space.
    pub name: String,
    /// Rows of the images.
    pub height: usize,
    /// Columns of the images.
    pub width: usize,
    /// Channels at each level, finest first; each further level halves the size.
    pub widths: Vec<usize>,
    /// Residual blocks of the encoder at each level, finest first.
    pub encoder_blocks: Vec<usize>,
    /// Residual blocks of the decoder at each level, finest first.
    pub decoder_blocks: Vec<usize>,
    /// Channels of a latent.
    pub latent_channels: usize,
    /// Whether the blocks of the coarsest level have a branch with group normalisation, which sees
    /// the whole image.
    pub branch: bool,
    /// How a camera's picture becomes an image of this size.
    #[serde(default, skip_serializing_if = "Fit::is_stretch")]
    pub fit: Fit,
    /// Size of the camera's pictures that it was trained on, if they had one size.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub trained_on: Option<PictureSize>,
}

impl AutoencoderConfig {
    /// The shape of the bundled default: 128x128 images, 16x16x12 latents.
    pub fn tiny() -> Self {
        Self {
            name: "tiny".to_owned(),
            height: 128,
            width: 128,
            widths: vec![16, 32, 64, 96],
            encoder_blocks: vec![0, 1, 2, 2],
            decoder_blocks: vec![1, 2, 2, 2],
            latent_channels: 12,
            branch: false,
            fit: Fit::Stretch,
            trained_on: None,
        }
    }

    /// The shape of TAEF2 (the tiny autoencoder for FLUX.2) for images of `height` x `width`.
    pub fn taef2(height: usize, width: usize) -> Self {
        Self {
            name: "taef2".to_owned(),
            height,
            width,
            widths: vec![64; 4],
            encoder_blocks: vec![1, 3, 3, 3],
            decoder_blocks: vec![1, 3, 3, 3],
            latent_channels: 32,
            branch: true,
            fit: Fit::Stretch,
            trained_on: None,
        }
    }

    /// How many pixels in each direction one place of the latent grid stands for.
    pub fn downsampling(&self) -> usize {
        1 << self.widths.len().saturating_sub(1)
    }

    /// Size (rows, columns) of the latent grid.
    pub fn grid(&self) -> (usize, usize) {
        let factor = self.downsampling();
        (self.height / factor, self.width / factor)
    }

    /// How the encoder takes pictures.
    pub fn framing(&self) -> Framing {
        Framing::new((self.height, self.width), self.fit)
    }

    /// Checks that the shape makes sense.
    ///
    /// # Errors
    /// [`Error::Config`] that names the field.
    pub fn validate(&self) -> Result<()> {
        let levels = self.widths.len();
        if levels == 0 || levels > 8 || self.widths.contains(&0) {
            return Err(Error::config(
                "widths",
                format!("{:?}: expected 1 to 8 positive widths", self.widths),
            ));
        }
        for (field, blocks) in [
            ("encoder_blocks", &self.encoder_blocks),
            ("decoder_blocks", &self.decoder_blocks),
        ] {
            if blocks.len() != levels {
                return Err(Error::config(
                    field,
                    format!("{blocks:?}: expected one number for each of {levels} levels"),
                ));
            }
        }
        if self.latent_channels == 0 {
            return Err(Error::config("latent_channels", "0: expected at least 1"));
        }
        let factor = self.downsampling();
        for (field, size) in [("height", self.height), ("width", self.width)] {
            if size == 0 || !size.is_multiple_of(factor) {
                return Err(Error::config(
                    field,
                    format!("{size}: expected a positive multiple of {factor}"),
                ));
            }
        }
        Ok(())
    }

    /// The layers of the encoder, in order.
    pub(super) fn encoder_stages(&self) -> Vec<Stage> {
        let mut stages = Stages::default();
        let levels = self.widths.len();
        let mut from = 3;
        for (level, (&width, &blocks)) in self.widths.iter().zip(&self.encoder_blocks).enumerate() {
            if level == 0 {
                stages.conv(ConvShape::same(from, width, 3), true, false);
            } else {
                stages.conv(ConvShape::down(from, width), false, false);
            }
            let branch = self.branch && level + 1 == levels;
            stages.blocks(width, blocks, branch);
            from = width;
        }
        stages.conv(ConvShape::same(from, self.latent_channels, 3), true, false);
        stages.list
    }

    /// The layers of the decoder, in order.
    pub(super) fn decoder_stages(&self) -> Vec<Stage> {
        let mut stages = Stages::default();
        // Position 0 is the clamp of the latent, which has no weights.
        stages.skip();
        let levels = self.widths.len();
        let mut from = self.latent_channels;
        let coarsest_first = self.widths.iter().zip(&self.decoder_blocks).rev();
        for (i, (&width, &blocks)) in coarsest_first.enumerate() {
            if i == 0 {
                stages.conv(ConvShape::same(from, width, 3), true, true);
                // The ReLU has a position of its own.
                stages.skip();
            } else {
                stages.skip();
                stages.conv(ConvShape::up(from, width), false, false);
            }
            let branch = self.branch && i == 0 && levels > 0;
            stages.blocks(width, blocks, branch);
            from = width;
        }
        stages.conv(ConvShape::same(from, 3, 3), true, false);
        stages.list
    }
}

/// Collects layers, numbered by their position in the published sequential networks.
#[derive(Default)]
struct Stages {
    list: Vec<Stage>,
    position: usize,
}

impl Stages {
    fn skip(&mut self) {
        self.position += 1;
    }

    fn conv(&mut self, shape: ConvShape, bias: bool, relu: bool) {
        self.list.push(Stage::Conv {
            name: self.position.to_string(),
            shape,
            bias,
            relu,
        });
        self.position += 1;
    }

    fn blocks(&mut self, width: usize, count: usize, branch: bool) {
        for _ in 0..count {
            self.list.push(Stage::Block {
                name: self.position.to_string(),
                width,
                branch,
            });
            self.position += 1;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(stages: &[Stage]) -> Vec<&str> {
        stages
            .iter()
            .map(|stage| match stage {
                Stage::Conv { name, .. } | Stage::Block { name, .. } => name.as_str(),
            })
            .collect()
    }

    #[test]
    fn taef2_layers_have_their_published_positions() {
        let config = AutoencoderConfig::taef2(256, 256);
        config.validate().unwrap();
        assert_eq!(config.grid(), (32, 32));
        assert_eq!(
            names(&config.encoder_stages()),
            (0..15).map(|i| i.to_string()).collect::<Vec<_>>()
        );
        let expected = [1, 3, 4, 5, 7, 8, 9, 10, 12, 13, 14, 15, 17, 18, 19];
        assert_eq!(
            names(&config.decoder_stages()),
            expected.map(|i| i.to_string())
        );
    }

    #[test]
    fn senseless_shapes_are_refused_by_field() {
        let fault = |change: &dyn Fn(&mut AutoencoderConfig)| {
            let mut config = AutoencoderConfig::tiny();
            change(&mut config);
            config.validate().unwrap_err().to_string()
        };
        assert!(fault(&|c| c.height = 100).starts_with("height: 100"));
        assert!(fault(&|c| c.width = 0).starts_with("width: 0"));
        assert!(fault(&|c| c.widths.clear()).starts_with("widths: []"));
        assert!(fault(&|c| c.decoder_blocks = vec![1]).starts_with("decoder_blocks: [1]"));
        assert!(fault(&|c| c.latent_channels = 0).starts_with("latent_channels: 0"));
    }
}
