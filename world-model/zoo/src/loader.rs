//! Tensors of a checkpoint for a model.

use std::cell::RefCell;
use std::collections::BTreeSet;
use std::fmt::{self, Display};
use std::rc::Rc;

use candle_core::{DType, Device, Tensor};
use wm_model::ops::PackedLinear;
use wm_model::transition::PackedSource;
use wm_model::{Compute, Kernels, NumberFormat, Weights};

use crate::calibration::{InputRanges, RangeRecorder};
use crate::layers::{Conv2d, ConvSpec, GroupNorm, LayerNorm, Linear};
use crate::packed_cache::{PackedCache, Session};
use crate::{Checkpoint, Error, Misshapen, Result};

/// Gives tensors by name and shape, below one place in the checkpoint's tree of names.
///
/// Clones and descendants share one account of the requests. A tensor that is missing or has another shape is noted
/// there and replaced by zeros. [`Loader::finish`] reports all of them at once: call it before the model is used.
///
/// On the CPU a loader for bf16 gives the rounded values as f32, which the kernels pack as bf16 again where that halves
/// the memory that is read; sums and activations are f32. Vectors (biases, scales, statistics) are not rounded there:
/// they are a hundredth of the values, and each is off in all places of an output alike. On other devices it gives bf16
/// tensors.
///
/// A loader for int8 rounds the matrix of a Linear, when it is packed, to 8 bits, or to bf16 if it is
/// [sensitive](Loader::sensitive). Tensors it gives as f32.
#[derive(Clone, Debug)]
pub struct Loader<'a> {
    source: Source<'a>,
    /// Where in the tree, with a dot at the end; empty at the root.
    prefix: String,
    kernels: Kernels,
    /// Format that values are rounded to.
    format: NumberFormat,
    device: Device,
    /// Whether values are read from `source`, or only names and shapes.
    reads: bool,
    /// Whether its Linears are sensitive to rounding.
    is_sensitive: bool,
    /// Where packed weights are looked up and kept.
    session: Option<Rc<RefCell<Session>>>,
    /// Calibrated ranges of the inputs of its Linears.
    ranges: Option<&'a InputRanges>,
    /// Records the inputs of its Linears.
    recorder: Option<(&'a RangeRecorder, &'static str)>,
    account: Rc<RefCell<Account>>,
}

/// A source of tensors other than a checkpoint, as the variables of a training.
pub trait Supply {
    /// Tensor `name` of `shape`: f32, where the model is to compute.
    ///
    /// # Errors
    /// If the source has no such tensor.
    fn supply(&self, name: &str, shape: &[usize]) -> Result<Tensor>;

    /// Where its tensors are: networks move their inputs there.
    fn device(&self) -> Device {
        Device::Cpu
    }
}

/// Weights that the training wrote, as a supply.
#[derive(Debug)]
pub struct OfWeights<'a>(pub &'a Weights);

impl Supply for OfWeights<'_> {
    fn supply(&self, name: &str, shape: &[usize]) -> Result<Tensor> {
        Ok(self.0.tensor(name, shape)?)
    }
}

#[derive(Clone, Copy)]
enum Source<'a> {
    Checkpoint(&'a Checkpoint),
    Supply(&'a dyn Supply),
    /// A skeleton's.
    Nothing,
}

impl fmt::Debug for Source<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Checkpoint(checkpoint) => checkpoint.fmt(f),
            Self::Supply(_) => f.write_str("Supply"),
            Self::Nothing => f.write_str("Nothing"),
        }
    }
}

/// A tensor that a model requested.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Requested {
    /// Its name, from the root.
    pub name: String,
    /// Its shape.
    pub shape: Vec<usize>,
}

impl Requested {
    /// Number of its values.
    pub fn count(&self) -> usize {
        self.shape.iter().product()
    }
}

/// The requests so far.
#[derive(Debug, Default)]
struct Account {
    used: BTreeSet<String>,
    /// The tensors of `used`, in order.
    requested: Vec<Requested>,
    ignored: Vec<String>,
    missing: Vec<String>,
    misshapen: Vec<Misshapen>,
}

impl Account {
    /// Notes a request of the tensor `path`.
    fn note(&mut self, path: &str, shape: &[usize]) {
        // Twice the same tensor counts once: networks may share weights.
        if self.used.insert(path.to_owned()) {
            self.requested.push(Requested {
                name: path.to_owned(),
                shape: shape.to_vec(),
            });
        }
    }
}

impl PackedSource for Loader<'_> {
    fn linear(
        &self,
        name: &str,
        shape: (usize, usize),
        is_biased: bool,
        format: NumberFormat,
    ) -> wm_model::Result<PackedLinear> {
        Ok(self.packed_linear(name, shape, is_biased, format)?)
    }

    fn values(&self, name: &str, shape: &[usize]) -> wm_model::Result<Vec<f32>> {
        Ok(self.values(name, shape)?)
    }

    fn format(&self) -> NumberFormat {
        self.matrix_format()
    }
}

impl<'a> Loader<'a> {
    /// Gives `source`'s tensors on the device of `compute`, rounded to its number format.
    ///
    /// # Errors
    /// If the device cannot be opened.
    pub fn new(source: &'a Checkpoint, compute: &Compute) -> Result<Self> {
        let loader = Self {
            source: Source::Checkpoint(source),
            prefix: String::new(),
            kernels: compute.kernels(),
            format: compute.format(),
            device: compute.device()?.clone(),
            reads: true,
            is_sensitive: false,
            session: None,
            ranges: None,
            recorder: None,
            account: Rc::default(),
        };
        Ok(match PackedCache::of_process() {
            Some(cache) => loader.cached(cache),
            None => loader,
        })
    }

    /// The same, with packed weights from `cache`, and kept there.
    pub(crate) fn cached(self, cache: PackedCache) -> Self {
        let session = match self.source {
            Source::Checkpoint(source) if self.kernels == Kernels::Cpu && self.device.is_cpu() => {
                Session::new(cache, source, self.format)
            }
            _ => None,
        };
        Self {
            session: session.map(|session| Rc::new(RefCell::new(session))),
            ..self
        }
    }

    /// The same, whose Linears are quantised with calibrated ranges of their inputs, for [`NumberFormat::Int8`].
    pub(crate) fn with_ranges(self, ranges: &'a InputRanges) -> Self {
        if let Some(session) = &self.session {
            session.borrow_mut().distinguish(ranges);
        }
        Self {
            ranges: Some(ranges),
            ..self
        }
    }

    /// The same, whose Linears record their inputs in `recorder` under `part` when they compute.
    pub(crate) fn recorded(self, recorder: &'a RangeRecorder, part: &'static str) -> Self {
        Self {
            recorder: Some((recorder, part)),
            ..self
        }
    }

    /// Looks at names and shapes of `source`'s tensors and gives zeros, as a [`Loader::skeleton`] does: the tensors that a
    /// model needs and, by [`Loader::finish`], whether the checkpoint has them, without reading a value.
    pub(crate) fn survey(source: &'a Checkpoint) -> Self {
        Self {
            source: Source::Checkpoint(source),
            ..Self::skeleton(Kernels::Candle)
        }
    }

    /// A loader without a checkpoint. Each tensor is one repeated zero, which takes no memory.
    pub fn skeleton(kernels: Kernels) -> Loader<'static> {
        Loader {
            source: Source::Nothing,
            prefix: String::new(),
            kernels,
            format: NumberFormat::F32,
            device: Device::Cpu,
            reads: false,
            is_sensitive: false,
            session: None,
            ranges: None,
            recorder: None,
            account: Rc::default(),
        }
    }

    /// Gives the tensors of `supply`, on its device, in f32. Plain operations ([`Kernels::Candle`]) propagate
    /// gradients to it. Names are those of the published checkpoints.
    pub fn supplied(supply: &'a dyn Supply, kernels: Kernels) -> Self {
        Self {
            source: Source::Supply(supply),
            device: supply.device(),
            reads: true,
            ..Self::skeleton(kernels)
        }
    }

    /// The place `name` below this one; `name` may have dots in it.
    pub fn at(&self, name: impl Display) -> Self {
        Self {
            prefix: format!("{}{name}.", self.prefix),
            ..self.clone()
        }
    }

    /// The same place, for tensors that are to keep the values of the checkpoint: given as f32, not rounded.
    pub(crate) fn unrounded(&self) -> Self {
        Self {
            format: NumberFormat::F32,
            ..self.clone()
        }
    }

    /// The same place, for [sensitive](NumberFormat::sensitive) Linears.
    pub fn sensitive(&self) -> Self {
        Self {
            is_sensitive: true,
            ..self.clone()
        }
    }

    /// The kernels of the model.
    pub fn kernels(&self) -> Kernels {
        self.kernels
    }

    /// The format of the tensors that it gives, and that layers take and give.
    pub fn dtype(&self) -> DType {
        if self.device.is_cpu() {
            DType::F32
        } else {
            self.format.dtype()
        }
    }

    /// The format in which the CPU's kernels pack the weights that it gives as tensors.
    pub(crate) fn format(&self) -> NumberFormat {
        self.format.sensitive()
    }

    /// The format of the matrices of its Linears.
    fn matrix_format(&self) -> NumberFormat {
        match self.is_sensitive {
            true => self.format.sensitive(),
            false => self.format,
        }
    }

    /// Where the tensors that it gives are.
    pub fn device(&self) -> &Device {
        &self.device
    }

    /// Whether the checkpoint has a tensor `name` here. A skeleton has no tensor; a supply has each.
    pub fn has(&self, name: &str) -> bool {
        match self.source {
            Source::Checkpoint(source) => source.contains(&self.path(name)),
            Source::Supply(_) => true,
            Source::Nothing => false,
        }
    }

    /// Shape of the checkpoint's tensor `name` here, if the checkpoint has it.
    pub fn shape(&self, name: &str) -> Option<&'a [usize]> {
        match self.source {
            Source::Checkpoint(source) => source.shape(&self.path(name)),
            Source::Supply(_) | Source::Nothing => None,
        }
    }

    /// Tensor `name`, which has to be of `shape`.
    ///
    /// # Errors
    /// If its values cannot be read, or one is not finite. [`Loader::finish`] reports missing tensors and other shapes.
    pub fn tensor(&self, name: &str, shape: &[usize]) -> Result<Tensor> {
        let path = self.path(name);
        let mut account = self.account.borrow_mut();
        account.note(&path, shape);
        let source = match self.source {
            Source::Checkpoint(source) => source,
            Source::Supply(supply) => return supply.supply(&path, shape),
            Source::Nothing => return self.zeros(shape),
        };
        match source.shape(&path) {
            Some(found) if found == shape && !self.reads => self.zeros(shape),
            Some(found) if found == shape => {
                let tensor = source.tensor(&path, self.dtype_of(shape))?;
                Ok(tensor.to_device(&self.device)?.to_dtype(self.dtype())?)
            }
            Some(found) => {
                account.misshapen.push(Misshapen {
                    name: path,
                    expected: shape.to_vec(),
                    found: found.to_vec(),
                });
                self.zeros(shape)
            }
            None => {
                account.missing.push(format!("{path} {shape:?}"));
                self.zeros(shape)
            }
        }
    }

    /// The Linear `name`: `name.weight` (outputs, inputs) and `name.bias` (outputs).
    ///
    /// # Errors
    /// As [`Loader::tensor`].
    pub(crate) fn linear(&self, name: &str, inputs: usize, outputs: usize) -> Result<Linear> {
        self.linear_with(name, (outputs, inputs), true)
    }

    /// The Linear `name` that has no bias.
    ///
    /// # Errors
    /// As [`Loader::tensor`].
    pub(crate) fn linear_no_bias(
        &self,
        name: &str,
        inputs: usize,
        outputs: usize,
    ) -> Result<Linear> {
        self.linear_with(name, (outputs, inputs), false)
    }

    fn linear_with(&self, name: &str, shape: (usize, usize), is_biased: bool) -> Result<Linear> {
        let weight = format!("{name}.weight");
        let weight_shape = [shape.0, shape.1];
        if let Some(source) = self.packs(&weight, &weight_shape) {
            return self
                .pack(source, name, shape, is_biased, self.matrix_format())
                .map(Linear::packed);
        }
        let weight = self.tensor(&weight, &weight_shape)?;
        let bias = is_biased.then(|| self.tensor(&format!("{name}.bias"), &[shape.0]));
        Linear::new(
            weight,
            bias.transpose()?,
            self.kernels,
            self.matrix_format(),
        )
    }

    /// The Linear `name`, packed in `format`: `name.weight` of `shape` and, if `is_biased`, `name.bias`.
    fn packed_linear(
        &self,
        name: &str,
        shape: (usize, usize),
        is_biased: bool,
        format: NumberFormat,
    ) -> Result<PackedLinear> {
        let (weight, weight_shape) = (format!("{name}.weight"), [shape.0, shape.1]);
        if let Some(source) = self.packs(&weight, &weight_shape) {
            return self.pack(source, name, shape, is_biased, format);
        }
        let weight = self.values(&weight, &weight_shape)?;
        let bias = is_biased.then(|| self.values(&format!("{name}.bias"), &[shape.0]));
        let bias = bias.transpose()?;
        Ok(PackedLinear::new(&weight, bias.as_deref(), shape, format)?)
    }

    /// The checkpoint, if the matrix `name` of `shape` can be packed from where it lies there.
    fn packs(&self, name: &str, shape: &[usize]) -> Option<&'a Checkpoint> {
        let Source::Checkpoint(source) = self.source else {
            return None;
        };
        let is_packed = self.reads && self.kernels == Kernels::Cpu && self.device.is_cpu();
        let fits = source.shape(&self.path(name)) == Some(shape);
        (is_packed && fits).then_some(source)
    }

    /// Packs the Linear `name` from where its values lie in the file.
    fn pack(
        &self,
        source: &Checkpoint,
        name: &str,
        shape: (usize, usize),
        is_biased: bool,
        format: NumberFormat,
    ) -> Result<PackedLinear> {
        let weight = self.path(&format!("{name}.weight"));
        self.account.borrow_mut().note(&weight, &[shape.0, shape.1]);
        let bias = is_biased.then(|| self.values(&format!("{name}.bias"), &[shape.0]));
        let bias = bias.transpose()?;
        let packed = self.pack_or_find(source, &weight, shape, bias.as_deref(), format)?;
        Ok(match self.recorder {
            Some((recorder, part)) => recorder.record((part, &weight), packed)?,
            None => packed,
        })
    }

    /// The matrix `weight` with `bias`, as it was kept or packed now.
    fn pack_or_find(
        &self,
        source: &Checkpoint,
        weight: &str,
        shape: (usize, usize),
        bias: Option<&[f32]>,
        format: NumberFormat,
    ) -> Result<PackedLinear> {
        let mut session = self.session.as_ref().map(|session| session.borrow_mut());
        if let Some(session) = &mut session
            && let Some(packed) = session.linear(weight, shape, format, bias)
        {
            return Ok(packed);
        }
        let smoothing = self.ranges.and_then(|ranges| ranges.smoothing(weight));
        let is_rounded = self.format == NumberFormat::Bf16;
        let packed = source.with_values(weight, is_rounded, |values| match smoothing {
            Some(smoothing) if format == NumberFormat::Int8 => {
                PackedLinear::quantised(values, bias, shape, Some(smoothing))
            }
            _ => PackedLinear::new(values, bias, shape, format),
        })??;
        if let Some(session) = &mut session {
            session.note(weight, &packed);
        }
        Ok(packed)
    }

    /// The values of tensor `name`.
    fn values(&self, name: &str, shape: &[usize]) -> Result<Vec<f32>> {
        let tensor = self.tensor(name, shape)?.to_dtype(DType::F32)?;
        Ok(tensor.flatten_all()?.to_vec1()?)
    }

    /// The layer normalisation `name`: `name.weight` and `name.bias` (width).
    ///
    /// # Errors
    /// As [`Loader::tensor`].
    pub(crate) fn layer_norm(&self, name: &str, width: usize, eps: f64) -> Result<LayerNorm> {
        let scale = self.tensor(&format!("{name}.weight"), &[width])?;
        let shift = self.tensor(&format!("{name}.bias"), &[width])?;
        Ok(LayerNorm::new(scale, shift, eps, self.kernels))
    }

    /// The group normalisation `name`: `name.weight` and `name.bias` (channels).
    ///
    /// # Errors
    /// As [`Loader::tensor`], or if `groups` does not divide `channels`.
    pub(crate) fn group_norm(
        &self,
        name: &str,
        groups: usize,
        channels: usize,
        eps: f64,
    ) -> Result<GroupNorm> {
        let scale = self.tensor(&format!("{name}.weight"), &[channels])?;
        let shift = self.tensor(&format!("{name}.bias"), &[channels])?;
        GroupNorm::new((scale, shift), groups, eps, self.kernels)
    }

    /// The convolution `name`: `name.weight` (outputs, inputs, kernel, kernel) and `name.bias` (outputs).
    ///
    /// # Errors
    /// As [`Loader::tensor`].
    pub(crate) fn conv2d(&self, name: &str, spec: ConvSpec) -> Result<Conv2d> {
        let weight = self.tensor(&format!("{name}.weight"), &spec.weight_shape())?;
        let bias = self.tensor(&format!("{name}.bias"), &[spec.outputs])?;
        Conv2d::new(spec, &weight, bias, self.kernels, self.format())
    }

    /// As [`Loader::conv2d`], of a picture that is first doubled in both directions ([`Conv2d::doubling`]).
    ///
    /// # Errors
    /// As [`Loader::tensor`].
    pub(crate) fn doubling_conv2d(&self, name: &str, spec: ConvSpec) -> Result<Conv2d> {
        let weight = self.tensor(&format!("{name}.weight"), &spec.weight_shape())?;
        let bias = self.tensor(&format!("{name}.bias"), &[spec.outputs])?;
        Conv2d::doubling(spec, &weight, bias, self.kernels, self.format())
    }

    /// Tensors here whose names start with `prefix` may be in the checkpoint without being used.
    pub(crate) fn ignore(&self, prefix: &str) {
        self.account.borrow_mut().ignored.push(self.path(prefix));
    }

    /// Checks that the checkpoint has each requested tensor, and that the model requested each tensor of the checkpoint.
    /// Integer tensors are buffers (counters, positions) that no model here needs: they may stay unused.
    ///
    /// # Errors
    /// [`Error::Tensors`], with all differences.
    pub fn finish(&self) -> Result<()> {
        let Source::Checkpoint(source) = self.source else {
            return Ok(());
        };
        let account = self.account.borrow();
        let is_known = |name: &str| {
            account.used.contains(name)
                || account
                    .ignored
                    .iter()
                    .any(|prefix| name.starts_with(prefix))
        };
        let unexpected: Vec<String> = source
            .float_names()
            .filter(|name| !is_known(name))
            .map(str::to_owned)
            .collect();
        let (missing, misshapen) = (account.missing.clone(), account.misshapen.clone());
        if missing.is_empty() && misshapen.is_empty() && unexpected.is_empty() {
            if let Some(session) = &self.session {
                session.borrow_mut().finish();
            }
            return Ok(());
        }
        Err(Error::Tensors {
            file: source.file().to_owned(),
            missing,
            misshapen,
            unexpected,
        })
    }

    /// Number of values that this loader, its clones and its descendants have requested so far.
    pub fn parameters(&self) -> usize {
        let account = self.account.borrow();
        account.requested.iter().map(Requested::count).sum()
    }

    /// All tensors that were requested so far, each once, in order.
    pub(crate) fn requested(&self) -> Vec<Requested> {
        self.account.borrow().requested.clone()
    }

    /// Format that the values of a tensor of this shape are rounded to.
    fn dtype_of(&self, shape: &[usize]) -> DType {
        if self.device.is_cpu() && shape.len() < 2 {
            DType::F32
        } else {
            self.format.dtype()
        }
    }

    fn path(&self, name: &str) -> String {
        format!("{}{name}", self.prefix)
    }

    fn zeros(&self, shape: &[usize]) -> Result<Tensor> {
        let zero = Tensor::zeros(1, self.dtype(), &self.device)?;
        Ok(zero.broadcast_as(shape)?)
    }
}

#[cfg(test)]
mod tests;
