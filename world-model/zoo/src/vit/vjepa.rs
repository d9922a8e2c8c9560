//! V-JEPA 2.1, the image path of its encoder.
//!
//! Paper: "V-JEPA 2.1" (Meta); code and checkpoints: <https://github.com/facebookresearch/vjepa2>,
//! `app/vjepa_2_1`, hub entry `vjepa2_1_vit_large_384`; here ViT-L/16 at 256x256 (`docs/architecture.md#encoders`), 304.681 M parameters, feature 16x16x1024.
//!
//! A picture is a clip of one frame: its own patch embedding, `img_mod_embed`, then pre-norm blocks
//! with rotary embedding in every layer and no other position, then the last of the output norms.
//! The video's patch embedding and modality embedding and the other output norms belong to the
//! checkpoint, and are loaded to be counted and checked, but not used.
//!
//! Names: `patch_embed.proj.*`, `patch_embed_img.proj.*`, `img_mod_embed`, `video_mod_embed`,
//! `blocks.{i}.{norm1,norm2}.*`, `blocks.{i}.attn.{qkv,proj}.*`, `blocks.{i}.mlp.{fc1,fc2}.*`,
//! `norms_block.{0-3}.*`.
//!
//! Configuration (JSON; all but the first four have defaults):
//! `{"hidden": 1024, "depth": 24, "heads": 16, "patch": 16, "image_size": 256, "mlp": 4096,
//! "tubelet": 2, "output_norms": 4, "interpolate_rotary": false}`.

use candle_core::{DType, Device, Tensor};
use serde::{Deserialize, Serialize};

use super::preprocess::{Normalisation, resize_bicubic};
use super::{Block, BlockNames, PatchEmbedding, Rotary};
use crate::Result;
use crate::cost::{self, Cost};
use crate::kinds::encoder::{Apply, EncoderConfig, apply};
use crate::layers::LayerNorm;
use crate::loader::Loader;
use crate::sizes::{check_counts, check_multiple, check_sizes};

/// Epsilon of every LayerNorm.
const LAYER_NORM_EPS: f64 = 1e-6;

/// Side in pixels of the pictures that the rotary positions were trained on.
const TRAINED_SIZE: usize = 256;

/// Sizes of the encoder.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct VjepaConfig {
    /// Width of the tokens.
    pub(crate) hidden: usize,
    /// Number of blocks.
    pub(crate) depth: usize,
    /// Attention heads; each turns 3 x 2 x (d / 3 / 2) of its d = hidden / heads channels.
    pub(crate) heads: usize,
    /// Side of a patch in pixels.
    pub(crate) patch: usize,
    /// Side in pixels of the picture that is encoded; others are resized to it first.
    #[serde(default = "default_image_size")]
    pub(crate) image_size: usize,
    /// Hidden width of the feed-forward networks; four times `hidden` if it is not given.
    #[serde(default)]
    pub(crate) mlp: Option<usize>,
    /// Frames that a video patch spans: a size of `patch_embed.proj.weight`, otherwise unused.
    #[serde(default = "default_tubelet")]
    pub(crate) tubelet: usize,
    /// Number of output norms; the feature is behind the last.
    #[serde(default = "default_output_norms")]
    pub(crate) output_norms: usize,
    /// Whether the grid's positions are stretched to the range of the grid that a 256x256 picture
    /// has, as the upstream hub entries do for pictures of 384. At 256 it changes nothing.
    #[serde(default)]
    pub(crate) interpolate_rotary: bool,
}

fn default_image_size() -> usize {
    TRAINED_SIZE
}

fn default_tubelet() -> usize {
    2
}

fn default_output_norms() -> usize {
    4
}

impl VjepaConfig {
    /// ViT-L/16 at 256x256, as the paper uses it.
    pub(crate) fn vit_large() -> Self {
        Self {
            hidden: 1024,
            depth: 24,
            heads: 16,
            patch: 16,
            image_size: default_image_size(),
            mlp: None,
            tubelet: default_tubelet(),
            output_norms: default_output_norms(),
            interpolate_rotary: false,
        }
    }

    /// Hidden width of the feed-forward networks.
    pub(crate) fn mlp_width(&self) -> usize {
        self.mlp.unwrap_or(4 * self.hidden)
    }

    /// Patches along one side of the picture.
    pub(crate) fn grid(&self) -> usize {
        self.image_size / self.patch.max(1)
    }

    fn validate(&self) -> Result<()> {
        check_sizes(&[
            ("hidden", self.hidden),
            ("heads", self.heads),
            ("patch", self.patch),
            ("image_size", self.image_size),
            ("mlp", self.mlp.unwrap_or(1)),
            ("tubelet", self.tubelet),
        ])?;
        check_counts(&[("depth", self.depth), ("output_norms", self.output_norms)])?;
        check_multiple(("hidden", self.hidden), ("heads", self.heads))?;
        check_multiple(("image_size", self.image_size), ("patch", self.patch))
    }

    /// Positions from one patch to the next, along rows and columns.
    fn rotary_step(&self) -> (f64, f64) {
        let (trained, grid) = (TRAINED_SIZE / self.patch, self.grid());
        // A grid of one patch has no step.
        let step = if self.interpolate_rotary && grid > 1 && trained > 1 {
            (trained - 1) as f64 / (grid - 1) as f64
        } else {
            1.0
        };
        (step, step)
    }
}

impl EncoderConfig for VjepaConfig {
    fn load(&self, loader: &Loader<'_>) -> Result<Apply> {
        Ok(apply(Vjepa::load(self, loader)?, Vjepa::encode))
    }

    fn features(&self, _: [usize; 2]) -> Result<[usize; 3]> {
        Ok([self.grid(), self.grid(), self.hidden])
    }

    fn cost(&self) -> Result<Cost> {
        cost::vjepa(self)
    }
}

/// The encoder.
#[derive(Clone, Debug)]
pub(crate) struct Vjepa {
    config: VjepaConfig,
    patches: PatchEmbedding,
    /// `img_mod_embed`, (1, 1, hidden).
    modality: Tensor,
    blocks: Vec<Block>,
    norm: LayerNorm,
    rotary: Rotary,
}

impl Vjepa {
    /// Loads the encoder.
    ///
    /// # Errors
    /// If the configuration cannot be built; [`Loader::finish`] reports missing tensors.
    pub(crate) fn load(config: &VjepaConfig, loader: &Loader<'_>) -> Result<Self> {
        config.validate()?;
        // A sine table that older files hold beside the rotary embedding.
        loader.ignore("pos_embed");
        let width = config.hidden;
        let size = (width, config.patch);
        // The video's half of the checkpoint, and the norms of earlier layers: checked, not kept.
        PatchEmbedding::load(loader, "patch_embed.proj", size, Some(config.tubelet))?;
        loader.tensor("video_mod_embed", &[1, 1, width])?;
        let mut norm = None;
        for i in 0..config.output_norms {
            let name = format!("norms_block.{i}");
            norm = Some(loader.layer_norm(&name, width, LAYER_NORM_EPS)?);
        }
        let norm = norm.ok_or_else(|| wm_model::Error::config("output_norms", "0"))?;

        let patches = PatchEmbedding::load(loader, "patch_embed_img.proj", size, Some(1))?;
        let modality = loader.tensor("img_mod_embed", &[1, 1, width])?;
        let rotary = rotary(config, patches.dtype(), modality.device())?;
        let blocks = (0..config.depth)
            .map(|i| block(config, &loader.at(format!("blocks.{i}"))))
            .collect::<Result<_>>()?;
        Ok(Self {
            config: config.clone(),
            patches,
            modality,
            blocks,
            norm,
            rotary,
        })
    }

    /// Encodes `image` (N, H, W, 3), f32 in 0..1, to (N, grid, grid, hidden), f32.
    ///
    /// A picture of another size than the configuration's is resized (bicubic); values are then
    /// clamped to 0..1 and normalised with ImageNet's mean and standard deviation.
    ///
    /// # Errors
    /// If the picture has another shape.
    pub(crate) fn encode(&self, image: &Tensor) -> Result<Tensor> {
        let image = resize_bicubic(image, self.config.image_size)?.clamp(0.0, 1.0)?;
        let image = Normalisation::IMAGENET.apply(&image)?;
        let mut x = self
            .patches
            .forward(&image)?
            .broadcast_add(&self.modality)?;
        for block in &self.blocks {
            x = block.forward(&x, None, Some(&self.rotary))?;
        }
        let feature = self.norm.forward(&x)?.to_dtype(DType::F32)?;
        let (n, grid) = (image.dim(0)?, self.config.grid());
        Ok(feature.reshape((n, grid, grid, self.config.hidden))?)
    }
}

fn rotary(config: &VjepaConfig, dtype: DType, device: &Device) -> Result<Rotary> {
    let grid = (config.grid(), config.grid());
    let head_dim = config.hidden / config.heads;
    Rotary::picture(grid, head_dim, config.rotary_step(), (dtype, device))
}

fn block(config: &VjepaConfig, loader: &Loader<'_>) -> Result<Block> {
    let sizes = (config.hidden, config.heads, config.mlp_width());
    Block::load(loader, &BlockNames::TIMM, sizes, LAYER_NORM_EPS)
}

#[cfg(test)]
mod tests {
    use super::*;
    use wm_model::Kernels;

    fn small() -> VjepaConfig {
        let json = r#"{"hidden": 48, "depth": 2, "heads": 3, "patch": 8, "image_size": 32}"#;
        serde_json::from_str(json).unwrap()
    }

    #[test]
    fn vit_large_has_the_published_size() {
        let loader = Loader::skeleton(Kernels::Candle);
        Vjepa::load(&VjepaConfig::vit_large(), &loader).unwrap();
        assert_eq!(loader.parameters(), 304_680_960);
    }

    #[test]
    fn a_small_one_has_the_shape_of_its_configuration() {
        let model = Vjepa::load(&small(), &Loader::skeleton(Kernels::Candle)).unwrap();
        let image = Tensor::zeros((2, 40, 64, 3), DType::F32, &Device::Cpu).unwrap();
        let feature = model.encode(&image).unwrap();
        assert_eq!(feature.dims(), [2, 4, 4, 48]);
        assert_eq!(feature.dtype(), DType::F32);
    }

    #[test]
    fn positions_are_whole_numbers_unless_stretched() {
        let mut config = small();
        assert_eq!(config.rotary_step(), (1.0, 1.0));
        config.interpolate_rotary = true;
        // 256 / 8 = 32 patches a side were trained, 4 are there.
        assert_eq!(config.rotary_step(), (31.0 / 3.0, 31.0 / 3.0));
        let at_trained_size = VjepaConfig {
            interpolate_rotary: true,
            ..VjepaConfig::vit_large()
        };
        assert_eq!(at_trained_size.rotary_step(), (1.0, 1.0));
    }

    #[test]
    fn what_cannot_be_built_is_named() {
        let config = VjepaConfig {
            heads: 5,
            ..small()
        };
        let fault = Vjepa::load(&config, &Loader::skeleton(Kernels::Candle)).unwrap_err();
        assert!(fault.to_string().contains("heads = 5"), "{fault}");
        let unknown = r#"{"hidden": 48, "depth": 2, "heads": 3, "patch": 8, "layers": 2}"#;
        assert!(serde_json::from_str::<VjepaConfig>(unknown).is_err());
    }
}
