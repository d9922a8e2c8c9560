//! Where packed weights come from.

use candle_core::{DType, Device, Tensor};

use crate::NumberFormat;
use crate::ops::PackedLinear;
use crate::transition::linear_layer::{LinearLayer, LinearSource};
use crate::transition::{Transition, TransitionConfig};
use crate::{Error, Result};

/// What gives a transition model's weights by the names of its [`Parameter`](crate::transition::Parameter)s.
pub trait PackedSource {
    /// The Linear `name`, packed in `format`: `name.weight` (outputs, inputs) and, if `is_biased`, `name.bias` (outputs).
    ///
    /// # Errors
    /// Whatever keeps it from that.
    fn linear(
        &self,
        name: &str,
        shape: (usize, usize),
        is_biased: bool,
        format: NumberFormat,
    ) -> Result<PackedLinear>;

    /// The values of parameter `name` in row-major order.
    ///
    /// # Errors
    /// Whatever keeps it from that.
    fn values(&self, name: &str, shape: &[usize]) -> Result<Vec<f32>>;

    /// What weights are packed in, but for [sensitive](NumberFormat::sensitive) ones.
    fn format(&self) -> NumberFormat;
}

/// The tensors of a model, as a source.
pub(super) struct OfTransition<'a> {
    pub(super) model: &'a Transition,
    pub(super) format: NumberFormat,
}

impl OfTransition<'_> {
    fn tensor(&self, name: &str) -> Result<Vec<f32>> {
        let tensor = self.model.parameters.get(name);
        numbers(tensor.ok_or_else(|| Error::MissingTensor {
            file: "the list of parameters".into(),
            name: name.to_owned(),
            expected: Vec::new(),
        })?)
    }
}

impl PackedSource for OfTransition<'_> {
    fn linear(
        &self,
        name: &str,
        shape: (usize, usize),
        is_biased: bool,
        format: NumberFormat,
    ) -> Result<PackedLinear> {
        let weight = self.tensor(&format!("{name}.weight"))?;
        let bias = is_biased.then(|| self.tensor(&format!("{name}.bias")));
        PackedLinear::new(&weight, bias.transpose()?.as_deref(), shape, format)
    }

    fn values(&self, name: &str, _: &[usize]) -> Result<Vec<f32>> {
        self.tensor(name)
    }

    fn format(&self) -> NumberFormat {
        self.format
    }
}

/// The layers of a configuration, from a source.
pub(super) struct NamedLayers<'a> {
    pub(super) config: &'a TransitionConfig,
    pub(super) source: &'a dyn PackedSource,
}

impl NamedLayers<'_> {
    /// What makes tokens of patches, whose values are in the order row, column, channel.
    pub(super) fn patches(&self) -> Result<PackedLinear> {
        let (d, p, channels) = (self.config.hidden, self.config.patch, self.config.channels);
        let weight = self.source.values("x_proj.weight", &[d, channels, p, p])?;
        let bias = self.source.values("x_proj.bias", &[d])?;
        // (d, C, p, p) to (d, p * p * C).
        let weight = Tensor::from_vec(weight, (d, channels, p, p), &Device::Cpu)?;
        let weight = numbers(&weight.permute((0, 2, 3, 1))?)?;
        let shape = (d, self.config.patch_values());
        let format = self.source.format().sensitive();
        PackedLinear::new(&weight, Some(&bias), shape, format)
    }
}

impl LinearSource for NamedLayers<'_> {
    type Linear = PackedLinear;

    fn linear(&mut self, name: &str, layer: LinearLayer) -> Result<PackedLinear> {
        let format = match layer.is_sensitive {
            true => self.source.format().sensitive(),
            false => self.source.format(),
        };
        let (shape, has_bias) = (layer.shape, layer.has_bias);
        let linear = self.source.linear(name, shape, has_bias, format)?;
        if (linear.outputs(), linear.inputs()) != shape {
            return Err(Error::Shape {
                what: "a packed weight of a transition model",
                expected: format!("{shape:?}"),
                found: vec![linear.outputs(), linear.inputs()],
            });
        }
        Ok(linear)
    }
}

/// A tensor's values in row-major order.
pub(super) fn numbers(tensor: &Tensor) -> Result<Vec<f32>> {
    let tensor = tensor.to_device(&Device::Cpu)?.to_dtype(DType::F32)?;
    Ok(tensor.flatten_all()?.to_vec1()?)
}
