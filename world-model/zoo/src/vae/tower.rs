//! The body that SD3's VAE, VA-VAE and Cosmos share: convolution, levels, middle, convolution.
//!
//! Source: `docs/architecture.md#encoders`; upstream `Encoder` and `Decoder` of latent diffusion. Level 0 is the
//! finest. A decoder has one residual block more in a level than the encoder.

use candle_core::Tensor;

use super::blocks::{Downsample, Family, Level, Middle, Output, Upsample, conv};
use super::seam::{check_widths, config_error};
use crate::layers::Conv2d;
use crate::sizes::check_counts;
use crate::{Loader, Result};

/// More levels than this are a mistake: the image would shrink by 2^16.
const MAX_LEVELS: usize = 16;

/// Shape of both halves.
#[derive(Clone, Debug)]
pub(super) struct Plan {
    /// Key names, groups and heads.
    pub(super) family: Family,
    /// Name of the field that the widths come from, for errors.
    pub(super) widths_field: &'static str,
    /// Channels that the encoder's first convolution makes.
    pub(super) stem: usize,
    /// Channels at each level, finest first.
    pub(super) widths: Vec<usize>,
    /// Residual blocks at each level of the encoder.
    pub(super) res_blocks: usize,
    /// Levels with attention after every residual block.
    pub(super) attending: Vec<usize>,
    /// How often the size is halved: after each of the first so many levels.
    pub(super) halvings: usize,
    /// Whether the middle has attention.
    pub(super) middle_attention: bool,
}

impl Plan {
    fn check(&self) -> Result<()> {
        let levels = self.widths.len();
        if levels > MAX_LEVELS {
            return Err(config_error(
                self.widths_field,
                format!("{levels} levels, expected at most {MAX_LEVELS}"),
            ));
        }
        if self.halvings > levels {
            return Err(config_error(
                self.widths_field,
                format!(
                    "{levels} levels cannot halve the size {} times",
                    self.halvings
                ),
            ));
        }
        check_counts(&[("residual blocks", self.res_blocks)])?;
        let Family { groups, heads, .. } = self.family;
        check_widths(self.widths_field, &self.widths, groups, heads)?;
        check_widths(self.widths_field, &[self.stem], groups, 1)
    }

    /// Channels of the coarsest level, at which the middle works.
    fn coarsest(&self) -> usize {
        // `check` refuses a plan without a level.
        self.widths.last().copied().unwrap_or(self.stem)
    }

    /// How many places of the tower's input in each direction one place of its output stands for.
    pub(super) fn downsampling(&self) -> usize {
        1 << self.halvings.min(MAX_LEVELS)
    }
}

/// The encoder's body: (N, H, W, inputs) to (N, H / s, W / s, outputs), s = [`Plan::downsampling`].
#[derive(Debug)]
pub(super) struct DownTower {
    conv_in: Conv2d,
    levels: Vec<(Level, Option<Downsample>)>,
    middle: Middle,
    output: Output,
}

impl DownTower {
    pub(super) fn load(
        plan: &Plan,
        inputs: usize,
        outputs: usize,
        loader: &Loader<'_>,
    ) -> Result<Self> {
        plan.check()?;
        let family = plan.family;
        let conv_in = loader.conv2d(family.naming.conv_in(), conv(inputs, plan.stem, 3))?;
        let mut levels = Vec::with_capacity(plan.widths.len());
        let mut before = plan.stem;
        for (at, width) in plan.widths.iter().copied().enumerate() {
            let loader = loader.at(family.naming.down(at));
            let attends = |_| plan.attending.contains(&at);
            let channels = (before, width);
            let level = Level::load(family, channels, plan.res_blocks, attends, &loader)?;
            let downsample = (at < plan.halvings)
                .then(|| Downsample::load(family, width, &loader))
                .transpose()?;
            levels.push((level, downsample));
            before = width;
        }
        Ok(Self {
            conv_in,
            levels,
            middle: Middle::load(family, plan.coarsest(), plan.middle_attention, loader)?,
            output: Output::load(family, plan.coarsest(), outputs, loader)?,
        })
    }

    pub(super) fn forward(&self, x: &Tensor) -> Result<Tensor> {
        let mut x = self.conv_in.forward(x)?;
        for (level, downsample) in &self.levels {
            x = level.forward(&x)?;
            if let Some(downsample) = downsample {
                x = downsample.forward(&x)?;
            }
        }
        self.output.forward(&self.middle.forward(&x)?)
    }
}

/// The decoder's body: (N, h, w, inputs) to (N, h * s, w * s, outputs), s = [`Plan::downsampling`].
#[derive(Debug)]
pub(super) struct UpTower {
    conv_in: Conv2d,
    middle: Middle,
    /// Coarsest first.
    levels: Vec<(Level, Option<Upsample>)>,
    output: Output,
}

impl UpTower {
    pub(super) fn load(
        plan: &Plan,
        inputs: usize,
        outputs: usize,
        loader: &Loader<'_>,
    ) -> Result<Self> {
        plan.check()?;
        let family = plan.family;
        let count = plan.widths.len();
        let mut before = plan.coarsest();
        let conv_in = loader.conv2d(family.naming.conv_in(), conv(inputs, before, 3))?;
        let middle = Middle::load(family, before, plan.middle_attention, loader)?;
        let mut levels = Vec::with_capacity(count);
        for (at, width) in plan.widths.iter().copied().enumerate().rev() {
            let loader = loader.at(family.naming.up(at, count));
            let attends = |_| plan.attending.contains(&at);
            let channels = (before, width);
            let level = Level::load(family, channels, plan.res_blocks + 1, attends, &loader)?;
            // The doublings are the coarsest levels' (Cosmos has levels that change no size).
            let upsample = (at + plan.halvings >= count)
                .then(|| Upsample::load(family, width, &loader))
                .transpose()?;
            levels.push((level, upsample));
            before = width;
        }
        Ok(Self {
            conv_in,
            middle,
            levels,
            output: Output::load(family, before, outputs, loader)?,
        })
    }

    pub(super) fn forward(&self, x: &Tensor) -> Result<Tensor> {
        let mut x = self.middle.forward(&self.conv_in.forward(x)?)?;
        for (level, upsample) in &self.levels {
            x = level.forward(&x)?;
            if let Some(upsample) = upsample {
                x = upsample.forward(&x)?;
            }
        }
        self.output.forward(&x)
    }
}
