//! The cost of the convolutional encoders and decoders.

use super::{Cost, FRAME_SIDE, applied, attended, count};
use crate::Result;
use crate::loader::Requested;
use crate::vae::{
    CosmosConfig, CosmosDecoder, CosmosEncoder, PixelDecoder, PixelDecoderConfig, SdVaeConfig,
    SdVaeDecoder, SdVaeEncoder, VaVaeConfig, VaVaeDecoder, VaVaeEncoder,
};

/// Counts the encoder of SD3's autoencoder, without attention products.
///
/// # Errors
/// If the configuration cannot be built.
pub(crate) fn sd3_encoder(config: &SdVaeConfig) -> Result<Cost> {
    let sizes = Sizes::of_levels(FRAME_SIDE, config.block_out_channels.len());
    count(
        |loader| SdVaeEncoder::load(config, loader),
        |weight| sizes.products(weight),
    )
}

/// Counts the decoder of SD3's autoencoder, without attention products.
///
/// # Errors
/// If the configuration cannot be built.
pub(crate) fn sd3_decoder(config: &SdVaeConfig) -> Result<Cost> {
    let sizes = Sizes::of_levels(FRAME_SIDE, config.block_out_channels.len());
    count(
        |loader| SdVaeDecoder::load(config, loader),
        |weight| sizes.products(weight),
    )
}

/// Counts the encoder of VA-VAE.
///
/// # Errors
/// If the configuration cannot be built.
pub(crate) fn va_vae_encoder(config: &VaVaeConfig) -> Result<Cost> {
    let sizes = Sizes::of_levels(FRAME_SIDE, config.multipliers.len());
    count(
        |loader| VaVaeEncoder::load(config, loader),
        |weight| sizes.products(weight) + sizes.attention(weight),
    )
}

/// Counts the decoder of VA-VAE.
///
/// # Errors
/// If the configuration cannot be built.
pub(crate) fn va_vae_decoder(config: &VaVaeConfig) -> Result<Cost> {
    let sizes = Sizes::of_levels(FRAME_SIDE, config.multipliers.len());
    count(
        |loader| VaVaeDecoder::load(config, loader),
        |weight| sizes.products(weight) + sizes.attention(weight),
    )
}

/// Counts the encoder of Cosmos.
///
/// # Errors
/// If the configuration cannot be built.
pub(crate) fn cosmos_encoder(config: &CosmosConfig) -> Result<Cost> {
    let sizes = Sizes::of_cosmos(config);
    count(
        |loader| CosmosEncoder::load(config, loader),
        |weight| sizes.products(weight) + sizes.attention(weight),
    )
}

/// Counts the decoder of Cosmos.
///
/// # Errors
/// If the configuration cannot be built.
pub(crate) fn cosmos_decoder(config: &CosmosConfig) -> Result<Cost> {
    let sizes = Sizes::of_cosmos(config);
    count(
        |loader| CosmosDecoder::load(config, loader),
        |weight| sizes.products(weight) + sizes.attention(weight),
    )
}

/// Counts the pixel decoder.
///
/// # Errors
/// If the configuration cannot be built.
pub(crate) fn pixel_decoder(config: &PixelDecoderConfig) -> Result<Cost> {
    let sizes = Sizes::of_levels(FRAME_SIDE, config.multipliers.len());
    count(
        |loader| PixelDecoder::load(config, loader),
        |weight| sizes.products(weight) + sizes.attention(weight),
    )
}

/// Sides of a network's grids.
#[derive(Clone, Copy, Debug)]
struct Sizes {
    finest: usize,
    coarsest: usize,
}

impl Sizes {
    /// The size is halved from each level to the next.
    fn of_levels(finest: usize, levels: usize) -> Self {
        Self {
            finest,
            coarsest: finest >> levels.saturating_sub(1),
        }
    }

    /// The finest grid is one of Haar patches; there may be more levels than sizes.
    fn of_cosmos(config: &CosmosConfig) -> Self {
        Self {
            finest: FRAME_SIDE / config.patch.max(1),
            coarsest: FRAME_SIDE / config.compression.max(1),
        }
    }

    /// Operations of a layer itself.
    fn products(self, weight: &Requested) -> usize {
        let side = self.side(&weight.name);
        applied(weight, side * side)
    }

    /// Operations of the products of attention, counted with the projection of the queries.
    fn attention(self, weight: &Requested) -> usize {
        let is_query = [".q.weight", ".to_q.weight"]
            .iter()
            .any(|end| weight.name.ends_with(end));
        match weight.shape.first() {
            Some(width) if is_query => {
                let side = self.side(&weight.name);
                attended(side * side, side * side, *width)
            }
            _ => 0,
        }
    }

    /// Side of the grid that a layer gives, by its name.
    fn side(self, name: &str) -> usize {
        // A level's number counts from the finest one in some networks and from the coarsest in others.
        let from_finest = |level: usize| (self.finest >> level).max(self.coarsest);
        let from_coarsest = |level: usize| (self.coarsest << level).min(self.finest);
        let is_down = name.contains("downsample");
        let is_up = name.contains("upsample");
        for (start, fine_first) in [
            ("encoder.down_blocks.", true),
            ("encoder.down.", true),
            ("decoder.up.", true),
            ("decoder.up_blocks.", false),
            ("up_levels.", false),
        ] {
            if let Some(level) = level(name, start) {
                return match (fine_first, is_down, is_up) {
                    (true, true, _) => from_finest(level + 1),
                    (true, _, true) => from_finest(level.saturating_sub(1)),
                    (true, _, _) => from_finest(level),
                    (false, _, true) => from_coarsest(level + 1),
                    (false, _, _) => from_coarsest(level),
                };
            }
        }
        match name {
            "encoder.conv_in.weight" | "decoder.conv_out.weight" | "conv_out.weight" => self.finest,
            _ => self.coarsest,
        }
    }
}

/// The number behind `start`.
fn level(name: &str, start: &str) -> Option<usize> {
    name.strip_prefix(start)?.split('.').next()?.parse().ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sides_follow_the_names() {
        let sd3 = Sizes::of_levels(256, 4);
        for (name, side) in [
            ("encoder.conv_in.weight", 256),
            ("encoder.down_blocks.1.resnets.0.conv1.weight", 128),
            ("encoder.down_blocks.2.downsamplers.0.conv.weight", 32),
            ("encoder.mid_block.attentions.0.to_q.weight", 32),
            ("encoder.conv_out.weight", 32),
            ("decoder.conv_in.weight", 32),
            ("decoder.up_blocks.0.upsamplers.0.conv.weight", 64),
            ("decoder.up_blocks.3.resnets.2.conv2.weight", 256),
            ("decoder.conv_out.weight", 256),
        ] {
            assert_eq!(sd3.side(name), side, "{name}");
        }
        let cosmos = Sizes::of_cosmos(&CosmosConfig::ci16x16());
        for (name, side) in [
            ("encoder.conv_in.weight", 64),
            ("encoder.down.2.block.0.conv1.weight", 16),
            ("decoder.up.2.upsample.conv.weight", 32),
            ("decoder.up.1.upsample.conv.weight", 64),
            ("decoder.up.0.block.1.conv1.weight", 64),
            ("quant_conv.weight", 16),
        ] {
            assert_eq!(cosmos.side(name), side, "{name}");
        }
        let pixel = Sizes::of_levels(256, 5);
        for (name, side) in [
            ("proj_in.weight", 16),
            ("up_levels.0.attn.q.weight", 16),
            ("up_levels.3.upsample.conv.weight", 256),
            ("conv_out.weight", 256),
        ] {
            assert_eq!(pixel.side(name), side, "{name}");
        }
    }
}
