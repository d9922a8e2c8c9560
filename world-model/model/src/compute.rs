//! Device, number format and kernels of a model.

#[cfg(feature = "cuda")]
mod cuda;
#[cfg(not(feature = "cuda"))]
mod cuda {
    //! For builds without the feature `cuda`.

    use candle_core::Device;

    pub(super) fn open(_: usize) -> Result<Device, String> {
        let reason = "this was built without the cargo feature `cuda` (cargo build --release --features cuda)";
        Err(reason.to_owned())
    }
}
mod kernels;
mod number_format;

use std::fmt;
use std::str::FromStr;
use std::sync::{Arc, OnceLock};

use candle_core::{DType, Device, Tensor};

pub use kernels::Kernels;
pub use number_format::NumberFormat;

use crate::transition::{LoadedTransition, PackedTransition, TensorTransition, Transition};
use crate::{Error, Result};

/// What computes a model: a device, the number format of the weights, and the kernels.
///
/// Parsing a device name (`cpu`, `cuda`, `cuda:N`) gives the CPU's kernels, or tensor operations on that GPU, with
/// weights in f32. The device is opened at first use; clones share it.
///
/// ```
/// use wm_model::{Compute, Kernels, NumberFormat};
///
/// # fn main() -> wm_model::Result<()> {
/// let compute: Compute = "cpu".parse()?;
/// assert_eq!(compute.kernels(), Kernels::Cpu);
/// let compute = compute.with_format(NumberFormat::Int8)?;
/// assert!(compute.with_kernels(Kernels::Candle).is_err());
/// # Ok(())
/// # }
/// ```
#[derive(Clone, Debug, Default)]
pub struct Compute {
    device: Arc<LazyDevice>,
    kernels: Kernels,
    format: NumberFormat,
    records: bool,
}

/// A device that is opened once, at first use.
#[derive(Debug, Default)]
struct LazyDevice {
    /// Number of the NVIDIA GPU, as the driver counts them; `None` for the CPU.
    gpu: Option<usize>,
    opened: OnceLock<Device>,
}

impl LazyDevice {
    fn new(gpu: Option<usize>) -> Arc<Self> {
        let opened = OnceLock::new();
        Arc::new(Self { gpu, opened })
    }

    fn get(&self) -> Result<&Device> {
        if let Some(device) = self.opened.get() {
            return Ok(device);
        }
        let device = match self.gpu {
            None => Device::Cpu,
            Some(gpu) => cuda::open(gpu).map_err(|reason| Error::Device {
                device: self.to_string(),
                reason,
            })?,
        };
        // If two threads open it at once, the first opening counts for both.
        Ok(self.opened.get_or_init(|| device))
    }
}

impl fmt::Display for LazyDevice {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.gpu {
            None => f.write_str("cpu"),
            Some(gpu) => write!(f, "cuda:{gpu}"),
        }
    }
}

impl Compute {
    /// These kernels on the CPU, with weights in f32.
    pub fn on_cpu(kernels: Kernels) -> Self {
        Self {
            kernels,
            ..Self::default()
        }
    }

    /// The same with other kernels.
    ///
    /// # Errors
    /// If the kernels do not compute on the device, or not in the number format.
    pub fn with_kernels(self, kernels: Kernels) -> Result<Self> {
        Self { kernels, ..self }.checked()
    }

    /// The same with weights in `format`.
    ///
    /// # Errors
    /// If the kernels do not compute in that number format.
    pub fn with_format(self, format: NumberFormat) -> Result<Self> {
        Self { format, ..self }.checked()
    }

    /// The same that, if `records`, records passes of few tokens and repeats them: as a CUDA graph for each shape. Only
    /// tensor operations record. A device that records is for one thread at a time.
    #[must_use]
    pub fn recording(self, records: bool) -> Self {
        Self { records, ..self }
    }

    /// The same with an opening of the device of its own. A GPU then has another stream: its work does not wait for other
    /// openings, and it takes no tensors of theirs.
    #[must_use]
    pub fn apart(&self) -> Self {
        Self {
            device: LazyDevice::new(self.device.gpu),
            ..self.clone()
        }
    }

    fn checked(self) -> Result<Self> {
        if self.kernels == Kernels::Cpu && !self.is_cpu() {
            return Err(Error::KernelsDevice {
                kernels: self.kernels,
                device: self.device.to_string(),
            });
        }
        if self.kernels == Kernels::Candle && self.format == NumberFormat::Int8 {
            return Err(Error::KernelsFormat {
                kernels: self.kernels,
                format: self.format,
            });
        }
        Ok(self)
    }

    /// The kernels.
    pub fn kernels(&self) -> Kernels {
        self.kernels
    }

    /// Number format that weights are rounded to.
    pub fn format(&self) -> NumberFormat {
        self.format
    }

    /// Format of tensors of weights.
    pub fn dtype(&self) -> DType {
        self.format.dtype()
    }

    /// Whether the device is the CPU.
    pub fn is_cpu(&self) -> bool {
        self.device.gpu.is_none()
    }

    /// The device, open.
    ///
    /// # Errors
    /// [`Error::Device`] if the library was built without the feature `cuda`, a library of CUDA is missing, or the machine
    /// has no such GPU.
    pub fn device(&self) -> Result<&Device> {
        self.device.get()
    }

    /// A copy on the device of a tensor of the CPU, in `dtype`.
    ///
    /// # Errors
    /// If the device cannot be opened or has no memory for it.
    pub fn tensor(&self, tensor: &Tensor, dtype: DType) -> Result<Tensor> {
        Ok(tensor.to_device(self.device()?)?.to_dtype(dtype)?)
    }

    /// `model`, whose tensors are on the device, ready for inference; the CPU's kernels pack its weights in `format`.
    ///
    /// # Errors
    /// If its tensors cannot be read, or the device has no memory left.
    pub fn load(&self, model: Transition, format: NumberFormat) -> Result<LoadedTransition> {
        Ok(match self.kernels {
            Kernels::Cpu => PackedTransition::new(&model, format)?.into(),
            Kernels::Candle => TensorTransition::new(model, self.records)?.into(),
        })
    }
}

impl FromStr for Compute {
    type Err = Error;

    fn from_str(name: &str) -> Result<Self> {
        let gpu = match name {
            "cpu" => return Ok(Self::default()),
            "cuda" => Some(0),
            _ => name.strip_prefix("cuda:").and_then(|n| n.parse().ok()),
        };
        if gpu.is_none() {
            let reason = format!("`{name}`, expected cpu, cuda or cuda:N");
            return Err(Error::config("device", reason));
        }
        Ok(Self {
            device: LazyDevice::new(gpu),
            kernels: Kernels::Candle,
            ..Self::default()
        })
    }
}

/// The kernels, the device and the number format, for logs and tests.
impl fmt::Display for Compute {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self {
            device,
            kernels,
            format,
            ..
        } = self;
        write!(f, "{kernels} on {device} in {format}")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parsed(name: &str) -> Compute {
        name.parse().unwrap()
    }

    #[test]
    fn a_device_name_gives_device_and_kernels() {
        assert_eq!(parsed("cpu").to_string(), "cpu on cpu in f32");
        assert_eq!(parsed("cuda").to_string(), "candle on cuda:0 in f32");
        assert_eq!(parsed("cuda:3").to_string(), "candle on cuda:3 in f32");
        for wrong in ["gpu", "cuda:", "cuda:-1", "cuda:x", "cuda0", ""] {
            let message = wrong.parse::<Compute>().unwrap_err().to_string();
            let expected = format!("`{wrong}`, expected cpu, cuda or cuda:N");
            assert!(message.contains(&expected), "{message}");
        }
    }

    #[test]
    fn the_kernels_compute_on_the_cpu_only() {
        for kernels in [Kernels::Candle, Kernels::Cpu] {
            parsed("cpu").with_kernels(kernels).unwrap();
        }
        parsed("cuda:1").with_kernels(Kernels::Candle).unwrap();
        let error = parsed("cuda:1").with_kernels(Kernels::Cpu).unwrap_err();
        assert!(matches!(error, Error::KernelsDevice { .. }));
        let message = error.to_string();
        assert!(
            message.contains("cuda:1") && message.contains("--engine candle"),
            "{message}"
        );
    }

    #[test]
    fn int8_is_for_the_kernels() {
        parsed("cpu").with_format(NumberFormat::Int8).unwrap();
        let plain = Compute::on_cpu(Kernels::Candle);
        let message = plain.with_format(NumberFormat::Int8).unwrap_err();
        let message = message.to_string();
        assert!(
            message.contains("int8") && message.contains("--engine cpu"),
            "{message}"
        );
    }

    #[test]
    fn clones_share_a_device_and_apart_opens_another() {
        let compute = Compute::default();
        assert!(compute.device().unwrap().is_cpu());
        assert!(Arc::ptr_eq(&compute.device, &compute.clone().device));
        assert!(!Arc::ptr_eq(&compute.device, &compute.apart().device));
    }

    #[test]
    fn no_other_device_replaces_a_missing_one() {
        let message = parsed("cuda:77").device().unwrap_err().to_string();
        assert!(message.contains("cuda:77"), "{message}");
        assert!(cfg!(feature = "cuda") || message.contains("feature `cuda`"));
    }
}
