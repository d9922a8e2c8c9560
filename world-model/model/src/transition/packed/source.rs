//! Where packed weights come from.

use std::collections::BTreeMap;

use candle_core::{DType, Device, Tensor};

use crate::ops::token_layers::LinearSource;
use crate::ops::{PackedFormat, PackedLinear};
use crate::transition::parameters;
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
        format: PackedFormat,
    ) -> Result<PackedLinear>;

    /// The values of parameter `name` in row-major order.
    ///
    /// # Errors
    /// Whatever keeps it from that.
    fn values(&self, name: &str, shape: &[usize]) -> Result<Vec<f32>>;

    /// What weights are packed in, but for [sensitive](PackedFormat::sensitive) ones.
    fn format(&self) -> PackedFormat;
}

/// The tensors of a model, as a source.
pub(super) struct OfTransition<'a> {
    pub(super) model: &'a Transition,
    pub(super) format: PackedFormat,
}

impl OfTransition<'_> {
    fn tensor(&self, name: &str) -> Result<Vec<f32>> {
        let tensor = self.model.parameters.get(name);
        numbers(tensor.ok_or_else(|| missing(name))?)
    }
}

impl PackedSource for OfTransition<'_> {
    fn linear(
        &self,
        name: &str,
        shape: (usize, usize),
        is_biased: bool,
        format: PackedFormat,
    ) -> Result<PackedLinear> {
        let weight = self.tensor(&format!("{name}.weight"))?;
        let bias = is_biased.then(|| self.tensor(&format!("{name}.bias")));
        PackedLinear::new(&weight, bias.transpose()?.as_deref(), shape, format)
    }

    fn values(&self, name: &str, _: &[usize]) -> Result<Vec<f32>> {
        self.tensor(name)
    }

    fn format(&self) -> PackedFormat {
        self.format
    }
}

/// The layers of a configuration, from a source.
pub(super) struct NamedLayers<'a> {
    config: &'a TransitionConfig,
    /// Shapes of all parameters.
    shapes: BTreeMap<String, Vec<usize>>,
    source: &'a dyn PackedSource,
}

impl<'a> NamedLayers<'a> {
    pub(super) fn new(config: &'a TransitionConfig, source: &'a dyn PackedSource) -> Self {
        let parameters = parameters::all(config).into_iter();
        Self {
            config,
            shapes: parameters.map(|p| (p.name, p.shape)).collect(),
            source,
        }
    }

    fn packed(&self, name: &str, format: PackedFormat) -> Result<PackedLinear> {
        let weight = format!("{name}.weight");
        let Some([outputs, inputs]) = self.shapes.get(&weight).map(Vec::as_slice) else {
            return Err(missing(&weight));
        };
        let is_biased = self.shapes.contains_key(&format!("{name}.bias"));
        let shape = (*outputs, *inputs);
        let linear = self.source.linear(name, shape, is_biased, format)?;
        if (linear.outputs(), linear.inputs()) != shape {
            return Err(Error::Shape {
                what: "a packed weight of a transition model",
                expected: format!("({outputs}, {inputs})"),
                found: vec![linear.outputs(), linear.inputs()],
            });
        }
        Ok(linear)
    }

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

    fn linear(&mut self, name: &str) -> Result<PackedLinear> {
        self.packed(name, self.source.format())
    }

    fn sensitive(&mut self, name: &str) -> Result<PackedLinear> {
        self.packed(name, self.source.format().sensitive())
    }
}

/// A tensor's values in row-major order.
pub(super) fn numbers(tensor: &Tensor) -> Result<Vec<f32>> {
    let tensor = tensor.to_device(&Device::Cpu)?.to_dtype(DType::F32)?;
    Ok(tensor.flatten_all()?.to_vec1()?)
}

fn missing(name: &str) -> Error {
    Error::MissingTensor {
        file: "the list of parameters".into(),
        name: name.to_owned(),
        expected: Vec::new(),
    }
}
