//! A small convolutional inverse dynamics model.
//!
//! Not the paper's. A transformer must first learn to compare the same place in two latents, which takes it many more
//! samples than a simulator on a laptop gives; here consecutive latents lie on each other as channels, so that a
//! convolution sees both at once.
//!
//! Five 3x3 convolutions with ReLU, of which the third and the fifth halve the size, then two layers over what all
//! places hold. Names: `convs.{i}.*`, `head.{0,1}.*`. After the convolutions, values are in the order row, column, channel.

use candle_core::{DType, Device, Tensor};
use serde::{Deserialize, Serialize};

use crate::layers::{Conv2d, ConvSpec, Dropout, Linear, Padding};
use crate::sizes::{check_sizes, shape_error};
use crate::{Loader, Result};

/// Sizes of the convolutional model.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ConvolutionalIdmConfig {
    /// Channels of the latents.
    pub features: usize,
    /// Number k of actions between k + 1 latents.
    pub horizon: usize,
    /// Rows and columns of the latents.
    pub grid: [usize; 2],
    /// Channels of the first two convolutions; the others have twice as many.
    pub width: usize,
    /// Width of the layer before the last.
    pub hidden: usize,
    /// Components of an action.
    pub actions: usize,
}

impl ConvolutionalIdmConfig {
    /// Channels into and out of each convolution, and its stride.
    fn convs(&self) -> [(usize, usize, usize); 5] {
        let (inputs, narrow) = ((self.horizon + 1) * self.features, self.width);
        let wide = 2 * narrow;
        [
            (inputs, narrow, 1),
            (narrow, narrow, 1),
            (narrow, wide, 2),
            (wide, wide, 1),
            (wide, wide, 2),
        ]
    }

    /// Values after the convolutions.
    fn values(&self) -> usize {
        let places: usize = self.grid.iter().map(|side| side.div_ceil(4)).product();
        2 * self.width * places
    }
}

/// The convolutional inverse dynamics model.
#[derive(Clone, Debug)]
pub struct ConvolutionalIdm {
    config: ConvolutionalIdmConfig,
    convs: Vec<Conv2d>,
    head: [Linear; 2],
    device: Device,
    dtype: DType,
}

impl ConvolutionalIdm {
    /// Loads the model.
    ///
    /// # Errors
    /// If the configuration cannot be built; [`Loader::finish`] reports missing tensors.
    pub fn load(config: &ConvolutionalIdmConfig, loader: &Loader<'_>) -> Result<Self> {
        let [rows, columns] = config.grid;
        check_sizes(&[
            ("features", config.features),
            ("horizon", config.horizon),
            ("grid", rows),
            ("grid", columns),
            ("width", config.width),
            ("hidden", config.hidden),
            ("actions", config.actions),
        ])?;
        let convs = config.convs().into_iter().enumerate();
        let convs = convs.map(|(i, (inputs, outputs, stride))| {
            let spec = ConvSpec {
                inputs,
                outputs,
                kernel: 3,
                stride,
                padding: Padding::same(3),
            };
            loader.conv2d(&format!("convs.{i}"), spec)
        });
        Ok(Self {
            convs: convs.collect::<Result<_>>()?,
            head: [
                loader.linear("head.0", config.values(), config.hidden)?,
                loader.sensitive().linear(
                    "head.1",
                    config.hidden,
                    config.horizon * config.actions,
                )?,
            ],
            config: config.clone(),
            device: loader.device().clone(),
            dtype: loader.dtype(),
        })
    }

    /// The configuration.
    pub fn config(&self) -> &ConvolutionalIdmConfig {
        &self.config
    }

    /// Latents (B, horizon + 1, h, w, features) to the actions between them (B, horizon, actions), f32, in the normalised
    /// units that the model was trained on; `dropout` drops values before the last layer.
    ///
    /// # Errors
    /// If the latents have another shape.
    pub fn forward_dropping(&self, latents: &Tensor, dropout: &mut Dropout<'_>) -> Result<Tensor> {
        let c = &self.config;
        let [_, last] = &self.head;
        let hidden = self.hidden(latents)?;
        let actions = last.forward(&dropout.apply(&hidden)?)?;
        let b = hidden.dim(0)?;
        let actions = actions.reshape((b, c.horizon, c.actions))?;
        Ok(actions.to_dtype(DType::F32)?)
    }

    /// Latents (B, horizon + 1, h, w, features) to what the last layer reads, which is the same for each action
    /// (B, horizon, hidden), f32.
    ///
    /// # Errors
    /// If the latents have another shape.
    pub fn features(&self, latents: &Tensor) -> Result<Tensor> {
        let hidden = self.hidden(latents)?.to_dtype(DType::F32)?;
        let (b, width) = hidden.dims2()?;
        let each = hidden
            .unsqueeze(1)?
            .expand((b, self.config.horizon, width))?;
        Ok(each.contiguous()?)
    }

    /// (B, hidden).
    fn hidden(&self, latents: &Tensor) -> Result<Tensor> {
        let c = &self.config;
        let ([rows, columns], frames) = (c.grid, c.horizon + 1);
        let expected = [frames, rows, columns, c.features];
        let b = match latents.dims() {
            &[b, ..] if latents.dims().get(1..) == Some(&expected) => b,
            _ => {
                let expected = format!("(B, {frames}, {rows}, {columns}, {})", c.features);
                return Err(shape_error("the latents", expected, latents));
            }
        };
        let [first, _] = &self.head;
        let latents = latents.to_device(&self.device)?.to_dtype(self.dtype)?;
        let together = latents.permute((0, 2, 3, 1, 4))?.contiguous()?;
        let mut x = together.reshape((b, rows, columns, frames * c.features))?;
        for conv in &self.convs {
            x = conv.forward(&x)?.relu()?;
        }
        Ok(first.forward(&x.flatten_from(1)?)?.relu()?)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use wm_model::Kernels;

    fn config() -> ConvolutionalIdmConfig {
        ConvolutionalIdmConfig {
            features: 12,
            horizon: 1,
            grid: [16, 16],
            width: 64,
            hidden: 128,
            actions: 7,
        }
    }

    #[test]
    fn that_of_the_bundled_model_is_small() {
        let loader = Loader::skeleton(Kernels::Cpu);
        ConvolutionalIdm::load(&config(), &loader).unwrap();
        assert_eq!(loader.parameters(), 683_015);
    }

    #[test]
    fn odd_grids_and_several_actions_fit_other_latents_fail() {
        let config = ConvolutionalIdmConfig {
            grid: [5, 6],
            horizon: 3,
            ..config()
        };
        let model = ConvolutionalIdm::load(&config, &Loader::skeleton(Kernels::Candle)).unwrap();
        let latents = |frames| Tensor::zeros((2, frames, 5, 6, 12), DType::F32, &Device::Cpu);
        let actions = model.forward_dropping(&latents(4).unwrap(), &mut Dropout::none());
        assert_eq!(actions.unwrap().dims(), [2, 3, 7]);
        let features = model.features(&latents(4).unwrap()).unwrap();
        assert_eq!(features.dims(), [2, 3, 128]);
        let error = model.forward_dropping(&latents(3).unwrap(), &mut Dropout::none());
        let error = error.unwrap_err().to_string();
        assert!(error.contains("(B, 4, 5, 6, 12)"), "{error}");
    }
}
