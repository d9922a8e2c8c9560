//! The network of subgoals.

use candle_core::{DType, Device, Tensor};

use super::SubgoalConfig;
use crate::layers::{Conv2d, ConvSpec, Linear, Padding, upsample_nearest_2x};
use crate::sizes::{check_sizes, shape_error};
use crate::{Loader, Result};

/// Two 3x3 convolutions whose result is added to their input.
#[derive(Clone, Debug)]
struct Residual([Conv2d; 2]);

impl Residual {
    fn load(name: &str, channels: usize, loader: &Loader<'_>) -> Result<Self> {
        let conv = |i: usize| loader.conv2d(&format!("{name}.{i}"), spec(channels, channels, 1));
        Ok(Self([conv(0)?, conv(1)?]))
    }

    fn forward(&self, x: &Tensor) -> Result<Tensor> {
        let [first, second] = &self.0;
        let change = second.forward(&first.forward(&x.relu()?)?.relu()?)?;
        Ok((x + change)?)
    }
}

/// A convolutional network of three levels, each of half the size of the one before (a U-Net). At the smallest, two dense
/// layers join all places: how an object has to move decides where the hand has to go.
///
/// Names: `enter`, `down.{0,1}`, `up.{0,1}`, `leave` (3x3 convolutions), `{full,half,quarter,half_up,full_up}.{0,1}`
/// (residual blocks), `all.{0,1}` (dense layers over values in the order row, column, channel).
#[derive(Clone, Debug)]
pub struct SubgoalNetwork {
    config: SubgoalConfig,
    enter: Conv2d,
    down: [Conv2d; 2],
    up: [Conv2d; 2],
    leave: Conv2d,
    full: Residual,
    half: Residual,
    quarter: Residual,
    half_up: Residual,
    full_up: Residual,
    all: [Linear; 2],
    device: Device,
    dtype: DType,
}

fn spec(inputs: usize, outputs: usize, stride: usize) -> ConvSpec {
    ConvSpec {
        inputs,
        outputs,
        kernel: 3,
        stride,
        padding: Padding::same(3),
    }
}

impl SubgoalNetwork {
    /// Loads the network.
    ///
    /// # Errors
    /// If the configuration is invalid; [`Loader::finish`] reports missing tensors.
    pub fn load(config: &SubgoalConfig, loader: &Loader<'_>) -> Result<Self> {
        config.validate()?;
        let [rows, columns] = config.grid;
        check_sizes(&[
            ("features", config.features),
            ("grid", rows),
            ("grid", columns),
            ("width", config.width),
            ("hidden", config.hidden),
            ("frame_skip", config.frame_skip),
        ])?;
        let (narrow, wide) = (config.width, 2 * config.width);
        // Present, goal, noised subgoals and their noise level.
        let inputs = (2 + config.distances.len()) * config.features + 1;
        let outputs = config.distances.len() * config.features;
        let conv = |name: &str, spec| loader.conv2d(name, spec);
        let residual = |name, channels| Residual::load(name, channels, loader);
        let places: usize = config.grid.iter().map(|side| side.div_ceil(4)).product();
        let values = wide * places;
        Ok(Self {
            enter: conv("enter", spec(inputs, narrow, 1))?,
            down: [
                conv("down.0", spec(narrow, wide, 2))?,
                conv("down.1", spec(wide, wide, 2))?,
            ],
            up: [
                conv("up.0", spec(wide, wide, 1))?,
                conv("up.1", spec(wide, narrow, 1))?,
            ],
            leave: conv("leave", spec(narrow, outputs, 1))?,
            full: residual("full", narrow)?,
            half: residual("half", wide)?,
            quarter: residual("quarter", wide)?,
            half_up: residual("half_up", wide)?,
            full_up: residual("full_up", narrow)?,
            all: [
                loader.linear("all.0", values, config.hidden)?,
                loader.linear("all.1", config.hidden, values)?,
            ],
            config: config.clone(),
            device: loader.device().clone(),
            dtype: loader.dtype(),
        })
    }

    /// The configuration.
    pub fn config(&self) -> &SubgoalConfig {
        &self.config
    }

    /// The clean subgoals (B, K, h, w, C) on the way from the present latents to the goals, both (B, h, w, C), where
    /// `noised` (B, K, h, w, C) are the subgoals at noise levels `tau` (B). Zeros of level 1 give the expected subgoals.
    /// All are f32, normalised.
    ///
    /// # Errors
    /// If a shape does not fit.
    pub fn forward(
        &self,
        (present, goal): (&Tensor, &Tensor),
        (noised, tau): (&Tensor, &Tensor),
    ) -> Result<Tensor> {
        let c = &self.config;
        let ([h, w], k) = (c.grid, c.distances.len());
        let b = present.dim(0)?;
        for (what, latent) in [("the present latent", present), ("the goal", goal)] {
            if latent.dims() != [b, h, w, c.features] {
                let expected = format!("({b}, {h}, {w}, {})", c.features);
                return Err(shape_error(what, expected, latent));
            }
        }
        if noised.dims() != [b, k, h, w, c.features] {
            let expected = format!("({b}, {k}, {h}, {w}, {})", c.features);
            return Err(shape_error("the noised subgoals", expected, noised));
        }
        let stacked = noised.permute((0, 2, 3, 1, 4))?.contiguous()?;
        let stacked = stacked.reshape((b, h, w, k * c.features))?;
        let level = tau.reshape((b, 1, 1, 1))?.broadcast_as((b, h, w, 1))?;
        let inputs = Tensor::cat(&[present, goal, &stacked, &level.contiguous()?], 3)?;
        let inputs = inputs.to_device(&self.device)?.to_dtype(self.dtype)?;
        let full = self.full.forward(&self.enter.forward(&inputs)?.relu()?)?;
        let [to_half, to_quarter] = &self.down;
        let half = self.half.forward(&to_half.forward(&full)?.relu()?)?;
        let quarter = to_quarter.forward(&half)?.relu()?;
        let quarter = self.quarter.forward(&self.join(&quarter)?)?;
        let [from_quarter, from_half] = &self.up;
        let up = from_quarter.forward(&enlarged(&quarter, &half)?)?.relu()?;
        let up = self.half_up.forward(&(up + half)?)?;
        let up = from_half.forward(&enlarged(&up, &full)?)?.relu()?;
        let up = self.full_up.forward(&(up + full)?)?;
        let change = self.leave.forward(&up.relu()?)?.to_dtype(DType::F32)?;
        let change = change
            .reshape((b, h, w, k, c.features))?
            .permute((0, 3, 1, 2, 4))?;
        let present = present.to_device(&self.device)?.unsqueeze(1)?;
        Ok(change.broadcast_add(&present)?.contiguous()?)
    }

    /// `x` (B, h, w, C) with a contribution of all places to each.
    fn join(&self, x: &Tensor) -> Result<Tensor> {
        let [first, last] = &self.all;
        let hidden = first.forward(&x.flatten_from(1)?)?.relu()?;
        Ok((x + last.forward(&hidden)?.reshape(x.shape())?)?)
    }
}

/// `x` of twice the size, cut to the rows and columns of `like`: an odd side was rounded up on the way down.
fn enlarged(x: &Tensor, like: &Tensor) -> Result<Tensor> {
    let (_, rows, columns, _) = like.dims4()?;
    let twice = upsample_nearest_2x(x)?;
    Ok(twice
        .narrow(1, 0, rows)?
        .narrow(2, 0, columns)?
        .contiguous()?)
}
